"""Folders of comparisons of run-time methods.

================== ==================================================================================
run/               the run folder of the schedule (`polaris.runs.schedule`)
comparison.json    protocol, metrics of every method with intervals, claims, differences run by run
comparison.npz     some flights of every method, and the envelope of all of them
decisions.jsonl    decisions of every method in the run that came closest, one JSON object per line
figures/           PDF and PNG
================== ==================================================================================
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..rta.arena import Comparison
from ..rta.method_result import DEFINITIONS
from ..rta.methods import METHODS
from ..scenario.scenario import ScheduleScenario
from ..simulation.baselines import FlightEnvelope
from .files.arrays import flight_arrays, read_flights
from .files.atomic import check_target
from .files.folder import Draw, RunFolder, RunKind, read_json, write_folder
from .files.tables import strict, write_text
from .schedule import SCHEDULE, write_run
from .stages import Stages


@dataclass(frozen=True, eq=False)
class ComparisonData:
    """Plot data of a comparison."""

    table: dict[str, Any]  # contents of ``comparison.json``
    run: RunFolder  # of the schedule
    shown: dict[str, FlightEnvelope]  # the flights kept, by method


def write_comparison(
    out: str | Path,
    scenario: ScheduleScenario,
    comparison: Comparison,
    *,
    draw: Draw | None = None,
    stages: Stages | None = None,
) -> RunFolder:
    """Write a comparison folder, replacing an older one once everything is written.

    Parameters
    ----------
    out : path
    scenario : ScheduleScenario
        What was compared on.
    comparison : Comparison
        Result of `polaris.rta.arena.compare_methods`.
    draw, stages
        As for `polaris.run`.

    Raises
    ------
    ScenarioError
        If `out` is something else than a folder of ours, or cannot be written.
    """
    target = check_target(out, COMPARISON.names)
    return write_folder(target, COMPARISON, scenario, comparison, draw=draw, stages=stages)


def _summary(
    scenario: ScheduleScenario, comparison: Comparison, seconds: Mapping[str, float]
) -> dict[str, Any]:
    """Contents of ``comparison.json``."""
    scene, order = comparison.grid, {key: place for place, key in enumerate(METHODS)}
    methods: list[dict[str, Any]] = [
        {
            "key": key,
            "name": one.name,
            "guarantee": one.claim.kind,
            "reach": one.claim.reach,
            "note": "; ".join(f"{reason}: {count}" for reason, count in one.reasons.items() if count),
            "available": True,
            "settings": one.settings,
            "metrics": one.summary(),
        }
        for key, one in comparison.results.items()
    ]
    empty = {"note": "", "available": False, "settings": {}, "metrics": {}}
    methods += [
        {"key": key, "name": key, "guarantee": "none", "reach": reason, **empty}
        for key, reason in comparison.refused.items()
    ]
    return {
        "protocol": {
            "runs": comparison.runs,
            "seed": comparison.seed,
            "decision_period_s": scene.period,
            "latency_s": scene.latency,
            "estimate_half_widths": scene.half_widths.tolist(),
            "statement": PROTOCOL,
        },
        "definitions": DEFINITIONS,
        # Each U alone is beside the preferred one.
        "methods": sorted(methods, key=lambda one: order.get(one["key"], order["experimental"])),
        "paired": comparison.paired(),
    }


PROTOCOL = (
    "Every method flies the same runs: the same initial states, disturbances, errors of the state estimate"
    " and true states of other satellites. Half of the runs are under worst-case disturbances, in equal"
    " shares against the flights of S alone, of U alone and of the schedule; the others under random ones."
    " Methods decide on the estimate; S and U act on the true state, or on an estimate of their own that is"
    " as wrong as [navigation] allows, and thrusters err as [thrusters] does. The experimental controller"
    " is the preferred one; the schedule and the online monitor may use the others too."
)


def _write(folder: Path, scenario: ScheduleScenario, comparison: Comparison) -> None:
    write_run(folder / "run", scenario, comparison.grid.schedule)
    np.savez_compressed(folder / "comparison.npz", **flight_arrays(comparison.shown))
    lines = [
        json.dumps(strict({"method": key, **decision}))
        for key, decisions in comparison.decisions.items()
        for decision in decisions
    ]
    write_text(folder / "decisions.jsonl", "\n".join(lines) + "\n")


def _read(folder: Path, scenario: ScheduleScenario) -> ComparisonData:
    table = read_json(folder / "comparison.json")
    flights = read_flights(folder / "comparison.npz")
    return ComparisonData(table, RunFolder(folder / "run", scenario, SCHEDULE), flights)


COMPARISON = RunKind(  # run folder of a comparison
    "comparison", ("comparison.json", "comparison.npz"), _write, _summary, _read, summary="comparison.json"
)
