"""Comparison folders: everything one comparison found, written beside and renamed into place.

A comparison folder holds

================== ==================================================================================
run/               the run folder of the schedule (`polaris.runs.folder`)
comparison.json    protocol, metrics of every method with intervals, claims, differences run by run
comparison.npz     some flights of every method, and the envelope of all of them
decisions.jsonl    decisions of every method in the run that came closest, one JSON object per line
figures/           PDF and PNG
================== ==================================================================================

The same scenario, seed and options give the same bytes, but for the times measured and ``created``.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from ..model.errors import ScenarioError
from ..model.version import versions
from ..rta.arena import METHODS, Comparison, Shown
from ..rta.outcome import DEFINITIONS
from ..scenario.scenario import Scenario
from .arrays import read_arrays
from .atomic import check_target, replacing
from .folder import RunFolder, read_json, read_run, readable, write_run
from .tables import json_text, strict, write_text

FILES = ("comparison.json", "comparison.npz", "decisions.jsonl")


@dataclass(frozen=True, eq=False)
class ComparisonFolder:
    """A comparison folder on disk.

    Attributes
    ----------
    path : Path
    run : RunFolder
        Of the schedule.
    """

    path: Path
    run: RunFolder

    @property
    def table(self) -> dict[str, Any]:
        """Contents of ``comparison.json``."""
        return read_json(self.path / "comparison.json")

    def shown(self) -> dict[str, Shown]:
        """The flights kept, by method, without their decisions."""
        arrays = read_arrays(self.path / "comparison.npz")
        out = {}
        with readable(self.path):
            for method in self.table["methods"]:
                key = method["key"]
                if f"{key}_t_s" in arrays:
                    names = ("t_s", "states", "inputs", "modes", "distance_m")
                    t, states, inputs, modes, nearest = (arrays[f"{key}_{name}"] for name in names)
                    labels = tuple(map(str, arrays[f"{key}_labels"]))
                    out[key] = Shown(labels, t, states, inputs, modes, nearest, [])
        return out

    def draw(self) -> list[Path]:
        """Redraw the figures from the files; the old ones stay until all are drawn."""
        from ..report.figures.comparison import draw_comparison

        folder = self.path / "figures"
        with replacing(folder) as beside:
            names = [path.name for path in draw_comparison(self, beside)]
        return [folder / name for name in names]


def is_comparison(path: str | Path) -> bool:
    """Whether there is a comparison folder."""
    return (Path(path) / "comparison.json").is_file()


def read_comparison(path: str | Path) -> ComparisonFolder:
    """Open a comparison folder.

    Raises
    ------
    ScenarioError
        If it is none.
    """
    folder = Path(path)
    for name in FILES:
        if not (folder / name).is_file():
            raise ScenarioError("comparison folder", str(path), f"must be one; it has no {name}")
    return ComparisonFolder(folder, read_run(folder / "run"))


def write_comparison(
    out: str | Path,
    scenario: Scenario,
    comparison: Comparison,
    *,
    overrides: Sequence[str] = (),
    figures: bool = True,
    progress: Callable[[str], None] | None = None,
) -> ComparisonFolder:
    """Write a comparison folder, replacing an older one once everything is written.

    Parameters
    ----------
    out : path
    scenario : Scenario
        What was compared on.
    comparison : Comparison
        Result of `polaris.rta.arena.compare_methods`.
    overrides : sequence of str
        Texts ``key=value`` that changed the scenario.
    figures : bool
        Whether to draw the figures.
    progress : callable, optional
        Called with the name of what is being done.

    Raises
    ------
    ScenarioError
        If `out` is something else than a folder of ours, or cannot be written.
    """
    target, note = check_target(out), progress or (lambda what: None)
    with replacing(target) as folder:
        note("run folder")
        write_run(folder / "run", scenario, comparison.scene.schedule, overrides=overrides, figures=False)
        note("files")
        write_text(folder / "comparison.json", json_text(told(scenario, comparison)))
        np.savez_compressed(folder / "comparison.npz", **_arrays(comparison.shown))
        lines = [
            json.dumps(strict({"method": key, **decision}))
            for key, shown in comparison.shown.items()
            for decision in shown.decisions
        ]
        write_text(folder / "decisions.jsonl", "\n".join(lines) + "\n")
        if figures:
            from ..report.figures.comparison import draw_comparison

            note("figures")
            (folder / "figures").mkdir()
            draw_comparison(ComparisonFolder(folder, read_run(folder / "run")), folder / "figures")
    return ComparisonFolder(target, read_run(target / "run"))


def told(scenario: Scenario, comparison: Comparison) -> dict[str, Any]:
    """Contents of ``comparison.json``."""
    scene = comparison.scene
    methods = [
        {
            "key": key,
            "name": one.name,
            "guarantee": one.claim.kind,
            "reach": one.claim.reach,
            "note": "; ".join(f"{why}: {count}" for why, count in one.reasons.items() if count),
            "available": True,
            "settings": one.settings,
            "metrics": one.summary(),
        }
        for key, one in comparison.outcomes.items()
    ]
    methods += [
        {
            "key": key,
            "name": key,
            "guarantee": "none",
            "reach": why,
            "note": "",
            "available": False,
            "settings": {},
            "metrics": {},
        }
        for key, why in comparison.refused.items()
    ]
    return {
        "schema_version": 1,
        "scenario": scenario.name,
        "title": scenario.model.title,
        "protocol": {
            "runs": comparison.runs,
            "seed": comparison.seed,
            "decision_period_s": scene.period,
            "latency_s": scene.latency,
            "estimate_half_widths": scene.half_widths.tolist(),
            "statement": PROTOCOL,
        },
        "definitions": DEFINITIONS,
        "methods": sorted(methods, key=lambda one: list(METHODS).index(str(one["key"]))),
        "paired": comparison.paired(),
        "versions": versions(),
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
    }


PROTOCOL = (
    "Every method flies the same runs: the same initial states, disturbances, errors of the state estimate"
    " and true states of other satellites. Half of the runs are under worst-case disturbances, in equal"
    " shares against the flights of S alone, of U alone and of the schedule; the others under random ones."
    " Methods decide on the estimate; S and U themselves act on the true state. The experimental controller"
    " is the preferred one; the schedule and the online monitor may use the others too."
)


def _arrays(shown: Mapping[str, Shown]) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for key, one in shown.items():
        out |= {
            f"{key}_t_s": one.times,
            f"{key}_labels": np.array(one.labels, dtype=str),
            f"{key}_states": one.states,
            f"{key}_inputs": one.inputs,
            f"{key}_modes": one.modes,
            f"{key}_distance_m": one.nearest,
        }
    return out
