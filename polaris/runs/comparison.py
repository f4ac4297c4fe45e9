"""Folders of comparisons of run-time methods, and of trade-offs: one schedule per price of velocity change.

================== ==================================================================================
run/               the run folder of the schedule (`polaris.runs.schedule`)
comparison.json    protocol, metrics of every method with intervals, claims, differences run by run
comparison.npz     some flights of every method, and the envelope of all of them
decisions.jsonl    decisions of every method in the run that came closest, one JSON object per line
figures/           PDF and PNG
------------------ ----------------------------------------------------------------------------------
price-0.06/ ...    the run folder of each price of velocity change (`polaris.runs.schedule`)
printed/           that of the printed algorithms, without recourse
scenario.toml      the scenario that they share
tradeoff.json/csv  what each of them reaches, costs and proves, and which none of the others outdoes
================== ==================================================================================
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..rta.arena import Comparison, Shown
from ..rta.method_result import DEFINITIONS
from ..rta.methods import METHODS
from ..scenario.scenario import ScheduleScenario
from .arrays import held_by, read_arrays, read_flights, read_held
from .folder import SCENARIO, Draw, RunFolder, RunKind, read_json, readable, write_folder
from .schedule import SCHEDULE, write_run
from .stages import Stages
from .tables import strict, write_csv, write_text

ARRAYS = {
    "t_s": "times",
    "states": "states",
    "inputs": "inputs",
    "modes": "modes",
    "distance_m": "nearest",
}
"""Attribute of the flights of a method by the name of its array."""


@dataclass(frozen=True, eq=False)
class ComparisonPicture:
    """What figures show of a comparison."""

    table: dict[str, Any]  # contents of ``comparison.json``
    run: RunFolder  # of the schedule
    shown: dict[str, Shown]  # the flights kept, by method, without their decisions


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
    draw : callable, optional
        Puts the figures into the folder before it takes its place; `polaris.draw_run` can do so later.
    stages : Stages, optional
        Told what is being done.

    Raises
    ------
    ScenarioError
        If `out` is something else than a folder of ours, or cannot be written.
    """
    return write_folder(out, COMPARISON, scenario, comparison, draw=draw, stages=stages)


def _tell(scenario: ScheduleScenario, comparison: Comparison, seconds: Mapping[str, float]) -> dict[str, Any]:
    """Contents of ``comparison.json``."""
    scene = comparison.grid
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
        for key, one in comparison.results.items()
    ]
    rest = {"note": "", "available": False, "settings": {}, "metrics": {}}
    methods += [
        {"key": key, "name": key, "guarantee": "none", "reach": why, **rest}
        for key, why in comparison.refused.items()
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
        "methods": sorted(methods, key=lambda one: list(METHODS).index(str(one["key"]))),
        "paired": comparison.paired(),
    }


PROTOCOL = (
    "Every method flies the same runs: the same initial states, disturbances, errors of the state estimate"
    " and true states of other satellites. Half of the runs are under worst-case disturbances, in equal"
    " shares against the flights of S alone, of U alone and of the schedule; the others under random ones."
    " Methods decide on the estimate; S and U themselves act on the true state. The experimental controller"
    " is the preferred one; the schedule and the online monitor may use the others too."
)


def _write(folder: Path, scenario: ScheduleScenario, comparison: Comparison) -> None:
    write_run(folder / "run", scenario, comparison.grid.schedule)
    arrays: dict[str, Any] = {}
    for key, one in comparison.shown.items():
        arrays[f"{key}_labels"] = np.array(one.labels, dtype=str)
        arrays |= held_by(one, ARRAYS, f"{key}_")
    np.savez_compressed(folder / "comparison.npz", **arrays)
    lines = [
        json.dumps(strict({"method": key, **decision}))
        for key, shown in comparison.shown.items()
        for decision in shown.decisions
    ]
    write_text(folder / "decisions.jsonl", "\n".join(lines) + "\n")


def _read(folder: Path, scenario: ScheduleScenario) -> ComparisonPicture:
    table, arrays = read_json(folder / "comparison.json"), read_arrays(folder / "comparison.npz")
    shown = {}
    for method in table["methods"]:
        key = method["key"]
        if f"{key}_t_s" in arrays:
            labels = tuple(map(str, arrays[f"{key}_labels"]))
            shown[key] = Shown(labels, **read_held(arrays, ARRAYS, f"{key}_"), decisions=[])
    return ComparisonPicture(table, RunFolder(folder / "run", scenario, SCHEDULE), shown)


COMPARISON = RunKind(
    "comparison",
    ("comparison.json", "comparison.npz"),
    _write,
    _tell,
    _read,
    summary="comparison.json",
)
"""What a comparison leaves."""


Row = dict[str, Any]  # what one point says, by column


COLUMNS = {
    "folder": "run folder of the point; printed: recoverable.recourse = none, where no price is paid",
    "price": "schedule.delta_v_price",
    "share": "share of the time under experimental controllers",
    "weighted_share": "the same, each controller's time times its weight",
    "delta_v_undisturbed_m_s": "velocity change of the undisturbed flight from the middle of the initial set",
    "delta_v_most_m_s": "velocity change proven never to be exceeded until the goal is reached, or nearest",
    "delta_v_m_s": "velocity change, mean over simulated runs",
    "delta_v_max_m_s": "velocity change, largest over simulated runs",
    "non_dominated": "no other point is as good in weighted_share, delta_v_m_s, switches, the goal, the"
    " guarantee and until when it holds, and better in one of them",
}


def row_of(folder: RunFolder, name: str, price: float | None) -> Row:
    """What the run folder of a point says; `ScenarioError` if a file is missing or damaged."""
    summary, scenario = folder.summary, folder.scenario
    with readable(folder.path):
        found, claim, flown = summary["synthesis"], summary["guarantee"], summary["polaris"]
        goal, modes = claim["goal"], np.array(folder.json("schedule.json")["modes"], dtype=int)
        flights = read_flights(folder.path / "trajectories.npz")["polaris"]
        thrust = np.abs(flights.inputs[flights.labels.index("nominal")]).sum(axis=1)
        weights = np.array([0.0, *scenario.switching_rules().weights])
        return {
            "folder": name,
            "price": price,
            "share": found["experimental_share"],
            "weighted_share": float(weights[modes].mean()),
            "switches": found["switches"],
            "delta_v_undisturbed_m_s": float(thrust @ np.diff(flights.times)) / scenario.system().mass,
            "delta_v_most_m_s": goal["delta_v_max_m_s"],
            "delta_v_m_s": flown["delta_v_m_s"],
            "delta_v_max_m_s": flown["delta_v_max_m_s"],
            "goal_reached": goal["reached"],
            "goal_by_s": goal["by_s"],
            "goal_distance_m": goal["distance_m"],
            "guarantee": claim["kind"],
            "horizon": claim["horizon"],
            "until_s": claim["until_s"],
            "cut_by_clock": bool(found["planner"]["cut_by_clock"]),
        }


def non_dominated(rows: Sequence[Mapping[str, Any]]) -> list[bool]:
    """Which points no other one outdoes: is as good in every respect and better in one; see `COLUMNS`."""
    merits = np.array([_merits(row) for row in rows], dtype=float)
    as_good = np.all(merits[:, None] >= merits, axis=2)
    return [bool(alone) for alone in ~np.any(as_good & ~as_good.T, axis=0)]


def _merits(row: Mapping[str, Any]) -> tuple[float, ...]:
    until = np.inf if row["until_s"] is None else row["until_s"]
    proved, reached = row["guarantee"] == "proved", row["goal_reached"] is True
    return row["weighted_share"], -row["delta_v_m_s"], -row["switches"], reached, proved, until


TRADEOFF = RunKind(
    "tradeoff",
    (SCENARIO, "tradeoff.csv"),
    lambda folder, scenario, rows: write_csv(folder / "tradeoff.csv", rows),
    lambda scenario, rows, seconds: {"points": list(rows), "definitions": COLUMNS},
    lambda folder, scenario: list(read_json(folder / "tradeoff.json")["points"]),
    summary="tradeoff.json",
)
"""What a trade-off leaves."""
