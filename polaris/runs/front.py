"""Folders of trade-offs: what schedules reach and cost at several prices of velocity change.

================ ====================================================================================
price-0.06/ ...  the run folder of each price of velocity change (`polaris.runs.schedule`)
printed/         that of the printed algorithms, without recourse
scenario.toml    the scenario that they share
tradeoff.json    what each of them reaches, costs and proves, and which none of the others outdoes
tradeoff.csv     the same as a table
figures/         PDF and PNG
================ ====================================================================================
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..scenario.scenario import ScheduleScenario
from .arrays import read_flights
from .folder import SCENARIO, RunFolder, RunKind, read_json, readable
from .tables import write_csv

Row = dict[str, Any]
"""What one point says, by column."""

DEFINITIONS = {
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
    """Which points no other one outdoes: is as good in every respect and better in one; see `DEFINITIONS`."""
    merits = np.array([_merits(row) for row in rows], dtype=float)
    as_good = np.all(merits[:, None] >= merits, axis=2)
    return [bool(alone) for alone in ~np.any(as_good & ~as_good.T, axis=0)]


def _merits(row: Mapping[str, Any]) -> tuple[float, ...]:
    until = np.inf if row["until_s"] is None else row["until_s"]
    proved, reached = row["guarantee"] == "proved", row["goal_reached"] is True
    return row["weighted_share"], -row["delta_v_m_s"], -row["switches"], reached, proved, until


def _write(folder: Path, scenario: ScheduleScenario, rows: Sequence[Row]) -> None:
    write_csv(folder / "tradeoff.csv", rows)


def _tell(scenario: ScheduleScenario, rows: Sequence[Row], seconds: Mapping[str, float]) -> dict[str, Any]:
    """Contents of ``tradeoff.json``."""
    return {"points": list(rows), "definitions": DEFINITIONS}


def _read(folder: Path, scenario: ScheduleScenario) -> list[Row]:
    return list(read_json(folder / "tradeoff.json")["points"])


TRADEOFF = RunKind("tradeoff", (SCENARIO, "tradeoff.csv"), _write, _tell, _read, summary="tradeoff.json")
"""What a trade-off leaves."""
