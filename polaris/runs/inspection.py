"""Run folders of one flight of the inspection problem.

================== ==================================================================================
scenario.toml      the scenario, with the overrides applied
summary.json       least value of every constraint, answers of the filter, guarantee, times
constraints.csv    the same least values as a table
flight.npz         states, thrust wanted and applied, status and barriers of every control period
figures/           PDF and PNG, drawn from the files above alone
================== ==================================================================================
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..inspection.flights.judge import JudgedRun, judge
from ..inspection.flights.simulation import Flights, InspectionRun, fly_one, whole_periods
from ..scenario.scenario import FlightScenario
from . import inspection_summary as told
from .arrays import read_finite
from .folder import SCENARIO, RunKind
from .stages import Stages
from .tables import write_csv

ARRAYS = {
    "t_s": "t",
    "states": "x",
    "sun_rad": "sun",
    "thrust_N": "u",
    "desired_N": "desired",
    "status": "status",
    "barriers": "h",
}
"""Attribute of a flight by the name of its array."""


def fly_flight(scenario: FlightScenario, stages: Stages | None = None) -> JudgedRun:
    """Fly one flight of the inspection problem and judge it, also between the samples."""
    stages, flight = stages or Stages(), scenario.model.flight
    with stages.stage("flight"):
        x, sun = scenario.initial()
        flights = Flights(
            scenario.inspection(),
            x[None],
            np.array([sun]),
            flight.duration_s,
            flight.period_s,
            scenario.primary(),
        )
        total = whole_periods(flight.duration_s, flight.period_s)
        counting = stages.counting("flight: {} of {} periods")
        filtering = scenario.filter(scenario.model.filter, flight.period_s)
        run = fly_one(flights, filtering, lambda step: counting(step.k + 1, total))
        return judge(run, scenario.families(), flight.between)


def _write(folder: Path, scenario: FlightScenario, found: JudgedRun) -> None:
    rows = told.constraint_rows(found.constraints) + told.barrier_rows(found.barriers)
    for row in rows:
        row["deputies"] = " ".join(map(str, row["deputies"]))
    write_csv(folder / "constraints.csv", told.COLUMNS, [[row[key] for key in told.COLUMNS] for row in rows])
    np.savez(folder / "flight.npz", **flight_arrays(found.run))


def flight_arrays(run: InspectionRun) -> dict[str, Any]:
    """Everything a flight consists of, by the names that files have for it."""
    return {name: getattr(run, held) for name, held in ARRAYS.items()}


def _read(folder: Path, scenario: FlightScenario) -> InspectionRun:
    """The flight, bit for bit."""
    arrays = read_finite(folder / "flight.npz", ("t_s", "states", "sun_rad", "thrust_N"))
    q, K = scenario.inspection(), len(arrays["t_s"]) - 1
    N = q.deputies
    shapes = [arrays[name].shape for name in ARRAYS]
    shapes[-1] = shapes[-1][:1]
    if shapes != [(K + 1,), (K + 1, N, 6), (K + 1,), (K, N, 3), (K, N, 3), (K, N), (K,)]:
        raise ValueError("flight.npz: arrays of the wrong shape")
    return InspectionRun(q, *(arrays[name] for name in ARRAYS))


FLIGHT = RunKind(
    "inspection", (SCENARIO, "constraints.csv", "flight.npz"), _write, told.tell, _read, fly_flight
)
"""What one flight leaves."""
