"""Run folders of a flight into the fuel limit (figure 9): scenario, summary, ``fuel.npz``, figures."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ...inspection.enmt import semi_axes, velocity_error
from ...inspection.filters.fuel import FuelLimit
from ...inspection.flights.fuel_run import FuelRun, Prediction, fly_fuel_limit
from ...scenario.scenario import FuelLimitScenario
from ...scenario.tables.inspection import FuelLimitModel
from ..files.arrays import array_fields, read_fields, read_finite
from ..files.folder import SCENARIO, RunKind
from ..stages import Stages

ARRAYS = {"t_s": "t", "states": "x", "thrust_N": "u", "desired_N": "desired", "delta_v_m_s": "delta_v"}
"""Attribute of a flight by the name of its array."""

PREDICTED = {"t_s": "t", "states": "x", "delta_v_m_s": "delta_v"}  # the same for a predicted flight


def fly_fuel(scenario: FuelLimitScenario, stages: Stages | None = None) -> FuelRun:
    """Fly one deputy into its fuel limit."""
    model, flight = scenario.model, scenario.model.flight
    instants = np.linspace(0, flight.duration_s, model.fuel.predictions + 1)[:-1].tolist()
    with (stages or Stages()).stage("flight"):
        filtering = FuelLimit(scenario.backup(), model.fuel.keep_clear, spent=model.fuel.spent_m_s)
        return fly_fuel_limit(filtering, scenario.primary(), model.initial_state, flight.duration_s, instants)


def _summary(scenario: FuelLimitScenario, run: FuelRun, seconds: Mapping[str, float]) -> dict[str, Any]:
    """Contents of ``summary.json``."""
    model, q = scenario.model, run.inspection
    fuel_left = q.delta_v_max - run.delta_v
    distance = np.linalg.norm(run.x[:, :3], axis=1)
    thrusting = np.flatnonzero(np.abs(run.u).sum(axis=1) > 1e-6 * q.thrust_max)
    a, c = semi_axes(run.x[-1], q.mean_motion)
    latched = run.latched_at
    delta_v = None if latched is None else float(run.delta_v[int(np.searchsorted(run.t, latched))])
    return {
        "duration_s": float(run.t[-1]),
        "period_s": model.flight.period_s,
        "safe": bool(fuel_left.min() >= 0),
        "fuel_left_m_s": float(fuel_left[-1]),
        "phi12_least_m_s": float(fuel_left.min()),
        "delta_v_m_s": float(run.delta_v[-1]),
        "delta_v_max_m_s": q.delta_v_max,
        "latched_at_s": run.latched_at,
        "latch_reason": run.reason,
        "delta_v_at_latch_m_s": delta_v,
        "last_thrust_s": float(run.t[thrusting[-1]]) if len(thrusting) else None,
        "exhausted": run.exhausted,
        "distance_least_m": float(distance.min()),
        "distance_least_time_s": float(run.t[int(distance.argmin())]),
        "phi1_least_m": float(distance.min()) - q.separation,
        "parking_orbit": {
            "semi_minor_m": float(a),
            "cross_track_m": float(c),
            "velocity_error_m_s": float(np.linalg.norm(velocity_error(run.x[-1], q.mean_motion))),
        },
        "filter_seconds": {"median": float(np.median(run.seconds)), "largest": float(run.seconds.max())},
        "guarantee": guarantee(model, run),
        "definitions": {
            "phi12_least_m_s": "fuel limit minus delta-v, minimum over the flight (eq. 24)",
            "last_thrust_s": "last period with a thrust above one millionth of its limit",
            "distance_least_m": "minimum distance from the chief at the starts of the periods",
            "parking_orbit": "of the last state; the velocity error vanishes on a closed ellipse",
            "filter_seconds": "wall time of one decision before the switch, prediction included",
        },
        "seconds": dict(seconds),
    }


def guarantee(model: FuelLimitModel, run: FuelRun) -> dict[str, Any]:
    """Return the claim about the fuel limit, and its assumptions."""
    failure = None
    if run.exhausted:
        failure = "thrust was cut off at the fuel limit, so that the parking orbit may be missed"
    elif run.latched_at is not None and run.latched_at <= run.t[0]:
        failure = f"the backup took over at the start, and its flight was not predicted before ({run.reason})"
    if failure:
        return {"kind": "none", "reason": failure, "assumptions": []}
    clear = ", and the deputy stays clear of the chief" if model.fuel.keep_clear else ""
    return {
        "kind": "by_prediction",
        "reason": f"the fuel limit is never exceeded{clear}: each period begins with a predicted backup "
        "flight, bounded for all time, for which the fuel is left. Other constraints are not checked",
        "assumptions": [
            "the motion obeys the Clohessy-Wiltshire equations, without disturbance",
            "the state is known exactly and without delay, and the thrust is applied exactly",
            "the filter decides once per period, and at the first the fuel suffices for the backup flight",
        ],
    }


def _write(folder: Path, scenario: FuelLimitScenario, run: FuelRun) -> None:
    """Write the flight and the predicted backup flights."""
    arrays = array_fields(run, ARRAYS)
    arrays["latched_at_s"] = np.array(np.nan if run.latched_at is None else run.latched_at)
    arrays["predictions"] = np.array(len(run.predictions))
    for k, one in enumerate(run.predictions):
        arrays |= array_fields(one, PREDICTED, f"prediction_{k}_")
    np.savez(folder / "fuel.npz", **arrays)


def _read(folder: Path, scenario: FuelLimitScenario) -> FuelRun:
    """Return the flight, bit for bit; reasons and wall times are in the summary only."""
    arrays = read_finite(folder / "fuel.npz", ("t_s", "states", "thrust_N", "delta_v_m_s"))
    K = len(arrays["t_s"]) - 1
    if [arrays[name].shape for name in ARRAYS] != [(K + 1,), (K + 1, 6), (K, 3), (K, 3), (K + 1,)]:
        raise ValueError("fuel.npz: arrays of the wrong shape")
    latched = float(arrays["latched_at_s"])
    predictions = tuple(
        Prediction(**read_fields(arrays, PREDICTED, f"prediction_{k}_"))
        for k in range(int(arrays["predictions"]))
    )
    return FuelRun(
        scenario.inspection(),
        **read_fields(arrays, ARRAYS),
        latched_at=None if np.isnan(latched) else latched,
        predictions=predictions,
    )


FUEL_LIMIT = RunKind("fuel_limit", (SCENARIO, "fuel.npz"), _write, _summary, _read, fly_fuel)
