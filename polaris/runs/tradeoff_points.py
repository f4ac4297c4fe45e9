"""Folders of trade-offs: one schedule per price of velocity change, or per value of a field.

================== ==================================================================================
price-0.06/ ...    the run folder of each price of velocity change (`polaris.runs.schedule`)
printed/           that of the printed algorithms, without recourse
system.mass_kg-5/  the run folder of each value of a field; infeasible.json where there is no schedule
scenario.toml      the scenario that they share
tradeoff.json/csv  what each of them reaches, costs and proves, and which none of the others outdoes
================== ==================================================================================
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..scenario.scenario import ScheduleScenario
from .files.arrays import read_flights
from .files.folder import SCENARIO, RunFolder, RunKind, read_json, readable
from .files.tables import write_csv

Row = dict[str, Any]  # what one point says, by column

COLUMNS = {
    "folder": "run folder of the point; `printed` has recoverable.recourse = none and no prices",
    "field": "key of the scenario that varies from point to point",
    "value": "value of that field",
    "share": "share of the time under experimental controllers",
    "weighted_share": "share of time under experimental controllers, times their weights",
    "delta_v_undisturbed_m_s": "delta-v of the undisturbed flight from the middle of the initial set",
    "delta_v_most_m_s": "proven bound on the delta-v until the goal is reached, or nearest",
    "delta_v_m_s": "delta-v, mean over simulated runs",
    "delta_v_max_m_s": "delta-v, maximum over simulated runs",
    "guarantee": "proved, or statistical (black boxes); infeasible: there is no schedule, see reason",
    "non_dominated": "no other point is as good in weighted_share, delta_v_m_s, switches, goal, guarantee"
    " and its duration, and better in one of them; given for prices only",
    "needed": "for every field: the last value, from the better end on, with which the required share is"
    " proven; and the interpolated value between it and the next one, if that is proven too",
}


def row_of(folder: RunFolder, name: str, field: str, value: float | None) -> Row:
    """Return the row of a point from its run folder; `ScenarioError` if a file is missing or damaged."""
    summary, scenario = folder.summary, folder.scenario
    with readable(folder.path):
        synthesis, claim, metrics = summary["synthesis"], summary["guarantee"], summary["polaris"]
        goal, modes = claim["goal"], np.array(folder.json("schedule.json")["modes"], dtype=int)
        flights = read_flights(folder.path / "trajectories.npz")["polaris"]
        thrust = np.abs(flights.inputs[flights.labels.index("nominal")]).sum(axis=1)
        weights = np.array([0.0, *scenario.switching_rules().weights])
        return {
            "folder": name,
            "field": field,
            "value": value,
            "share": synthesis["experimental_share"],
            "weighted_share": float(weights[modes].mean()),
            "switches": synthesis["switches"],
            "delta_v_undisturbed_m_s": float(thrust @ np.diff(flights.times)) / scenario.system().mass,
            "delta_v_most_m_s": goal["delta_v_max_m_s"],
            "delta_v_m_s": metrics["delta_v_m_s"],
            "delta_v_max_m_s": metrics["delta_v_max_m_s"],
            "goal_reached": goal["reached"],
            "goal_by_s": goal["by_s"],
            "goal_distance_m": goal["distance_m"],
            "guarantee": claim["kind"],
            "horizon": claim["horizon"],
            "until_s": claim["until_s"],
            "cut_by_clock": bool(synthesis["planner"]["cut_by_clock"]),
            "reason": None,
        }


EMPTY = (  # columns that a point without a schedule leaves empty
    *("share", "weighted_share", "switches", "delta_v_undisturbed_m_s", "delta_v_most_m_s", "delta_v_m_s"),
    *("delta_v_max_m_s", "goal_reached", "goal_by_s", "goal_distance_m"),
)


def infeasible_row(folder: Path, field: str, value: float | None) -> Row:
    """Return the row of a point that has no schedule."""
    row = {"folder": folder.name, "field": field, "value": value, **dict.fromkeys(EMPTY)}
    row |= {"guarantee": "infeasible", "horizon": None, "until_s": None, "cut_by_clock": False}
    return row | {"reason": read_json(folder / INFEASIBLE.summary)["reason"]}


def needed(rows: Sequence[Mapping[str, Any]], field: str, share: float) -> Row:
    """Return the last value of a field that has a share of the time under U; see `COLUMNS`."""
    points = sorted((row for row in rows if row["field"] == field), key=lambda row: float(row["value"]))
    shares = [row["share"] if row["guarantee"] == "proved" else -1.0 for row in points]
    falls = shares[0] >= shares[-1]
    values = [row["value"] for row in points][:: 1 if falls else -1]
    shares = shares[:: 1 if falls else -1]
    answer = {"field": field, "share": share, "bound": "at most" if falls else "at least"}
    answer |= dict.fromkeys(("last_proven", "share_there", "next", "share_next", "interpolated"))
    indices = [i for i, one in enumerate(shares) if one >= share]
    if not indices:
        return answer
    last, after = indices[-1], indices[-1] + 1
    answer |= {"last_proven": values[last], "share_there": shares[last]}
    if after < len(values):
        answer["next"] = values[after]
        if shares[after] >= 0:
            part = (shares[last] - share) / (shares[last] - shares[after])
            answer["share_next"] = shares[after]
            answer["interpolated"] = values[last] + part * (values[after] - values[last])
    return answer


def non_dominated(rows: Sequence[Mapping[str, Any]]) -> list[bool]:
    """Return True for each point that none dominates (as good in all, better in one); see `COLUMNS`."""
    merits = np.array([_merits(row) for row in rows], dtype=float)
    as_good = np.all(merits[:, None] >= merits, axis=2)
    return [bool(flag) for flag in ~np.any(as_good & ~as_good.T, axis=0)]


def _merits(row: Mapping[str, Any]) -> tuple[float, ...]:
    until = np.inf if row["until_s"] is None else row["until_s"]
    proved, reached = row["guarantee"] == "proved", row["goal_reached"] is True
    return row["weighted_share"], -row["delta_v_m_s"], -row["switches"], reached, proved, until


Points = tuple[Sequence[Row], float]  # rows of all points, and the share asked


def _summary(scenario: ScheduleScenario, points: Points, seconds: Mapping[str, float]) -> dict[str, Any]:
    """Contents of ``tradeoff.json``."""
    rows, share = points
    fields = dict.fromkeys(row["field"] for row in rows if row["non_dominated"] is None)
    answers = [needed(rows, field, share) for field in fields]
    return {"points": list(rows), "needed": answers, "definitions": COLUMNS}


TRADEOFF = RunKind(  # run folder of a trade-off
    "tradeoff",
    (SCENARIO, "tradeoff.csv"),
    lambda folder, scenario, points: write_csv(folder / "tradeoff.csv", points[0]),
    _summary,
    lambda folder, scenario: list(read_json(folder / "tradeoff.json")["points"]),
    summary="tradeoff.json",
)

INFEASIBLE = RunKind(  # run folder of a point of a trade-off that has no schedule
    "infeasible",
    (SCENARIO,),
    lambda folder, scenario, reason: None,
    lambda scenario, reason, seconds: {"reason": reason},
    lambda folder, scenario: read_json(folder / "infeasible.json"),
    summary="infeasible.json",
)
