"""The fuel limit, from a scenario to a run folder (figure 9)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..model.errors import ScenarioError
from .arrays import read_arrays
from ..model.version import versions
from ..inspection.enmt import (semi_axes, velocity_error)
from ..inspection.filters.fuel import FuelLimit
from ..inspection.flights.fuel_run import (FuelRun, Prediction, fly_fuel_limit)
from ..inspection.inspection import Inspection
from ..inspection.flights.primary import (LQR, Phases)
from .inspection import (InspectionFolder, write_folder)
from ..scenario.inspection import InspectionScenario
from ..scenario.inspection_tables import FuelLimitModel

if TYPE_CHECKING:
    from ..inspection.backup.parking import Law


def backup_law(scenario: InspectionScenario) -> Law:
    """The backup controller that a scenario names."""
    from ..inspection.backup.parking import Parking
    from ..inspection.enmt import Ellipses
    from ..inspection.backup.tracker import Tracker

    model = scenario.model
    assert isinstance(model, FuelLimitModel)
    given, q = model.fuel, scenario.inspection()
    usual = Ellipses.of(q)
    try:
        ellipses = Ellipses(
            q.mean_motion,
            usual.least if given.semi_minor_least_m is None else given.semi_minor_least_m,
            usual.largest if given.semi_minor_largest_m is None else given.semi_minor_largest_m,
            usual.cross_track if given.cross_track_m is None else given.cross_track_m,
        )
    except ScenarioError as error:
        names = {"least": "semi_minor_least_m", "largest": "semi_minor_largest_m"}
        field = f"fuel.{names.get(error.field, error.field)}"
        raise ScenarioError(field, error.given, error.rule) from error
    law = Parking if given.backup == "parking" else Tracker
    try:
        return law(q, ellipses, model.flight.period_s, given.response_s)
    except ScenarioError as error:
        field = "flight.period_s" if error.field == "period" else f"fuel.{error.field}_s"
        raise ScenarioError(field, error.given, error.rule) from error


def fly_fuel_scenario(scenario: InspectionScenario) -> FuelRun:
    """Fly a scenario of the kind ``fuel_limit``."""
    model = scenario.model
    assert isinstance(model, FuelLimitModel)
    q, flight = scenario.inspection(), model.flight
    shown = np.linspace(0, flight.duration_s, model.fuel.predictions + 1)[:-1]
    filtering = FuelLimit(q, backup_law(scenario), model.fuel.keep_clear, spent=model.fuel.spent_m_s)
    primary = there_and_back(q, model)
    return fly_fuel_limit(filtering, primary, model.initial_state, flight.duration_s, shown.tolist())


def there_and_back(q: Inspection, model: FuelLimitModel) -> Phases:
    """Regulators to the outer and to the inner target in turn."""
    given = model.primary
    weights = (given.position_weight_1_m2, given.velocity_weight_s2_m2, given.thrust_weight_1_N2)
    inner, outer = LQR(q, given.distance_m / 4, *weights), LQR(q, given.distance_m, *weights)
    starts = np.arange(0.0, model.flight.duration_s, given.swing_s)
    return Phases(starts.tolist(), [outer if k % 2 else inner for k in range(len(starts))])


# -- in numbers -------------------------------------------------------------------------------------


def summary(scenario: InspectionScenario, run: FuelRun, seconds: Mapping[str, float]) -> dict[str, Any]:
    """Contents of ``summary.json`` of a flight into the fuel limit."""
    model, q = scenario.model, run.inspection
    assert isinstance(model, FuelLimitModel)
    left = q.delta_v_max - run.delta_v
    distance = np.linalg.norm(run.x[:, :3], axis=1)
    quiet = np.flatnonzero(np.abs(run.u).sum(axis=1) > 1e-6 * q.thrust_max)
    a, c = semi_axes(run.x[-1], q.mean_motion)
    return {
        "schema_version": 1,
        "scenario": scenario.name,
        "kind": scenario.kind,
        "title": model.title,
        "duration_s": float(run.t[-1]),
        "period_s": model.flight.period_s,
        "backup": model.fuel.backup,
        "safe": bool(left.min() >= 0),
        "fuel_left_m_s": float(left[-1]),
        "phi12_least_m_s": float(left.min()),
        "delta_v_m_s": float(run.delta_v[-1]),
        "delta_v_max_m_s": q.delta_v_max,
        "latched_at_s": run.latched_at,
        "latch_reason": run.reason,
        "delta_v_at_latch_m_s": None
        if run.latched_at is None
        else float(run.delta_v[int(np.searchsorted(run.t, run.latched_at))]),
        "last_thrust_s": float(run.t[quiet[-1]]) if len(quiet) else None,
        "exhausted": run.exhausted,
        "distance_least_m": float(distance.min()),
        "distance_least_time_s": float(run.t[int(distance.argmin())]),
        "phi1_least_m": float(distance.min()) - q.separation,
        "parking_orbit": {
            "semi_minor_m": float(a),
            "cross_track_m": float(c),
            "velocity_error_m_s": float(np.linalg.norm(velocity_error(run.x[-1], q.mean_motion))),
        },
        "filter_seconds": {"median": run.median_decision, "largest": run.slowest_decision},
        "guarantee": guarantee(model, run),
        "definitions": {
            "phi12_least_m_s": "fuel limit less what was spent, least over the flight (eq. 24)",
            "last_thrust_s": "last period with a thrust above one millionth of its limit",
            "distance_least_m": "least distance from the chief at the starts of the periods",
            "parking_orbit": "of the last state; the velocity error vanishes on a closed ellipse",
            "filter_seconds": "wall time of one decision before the switch, prediction included",
        },
        "seconds": dict(seconds),
        "versions": versions(),
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def guarantee(model: FuelLimitModel, run: FuelRun) -> dict[str, Any]:
    """What is claimed of the fuel limit, and on what assumptions."""
    nothing = None
    if run.exhausted:
        nothing = "thrust was cut where the fuel ended: the limit held, the parking orbit may be missed"
    elif run.latched_at is not None and run.latched_at <= run.t[0]:
        nothing = f"the backup took over at once, and nothing was known of its flight before ({run.reason})"
    if nothing:
        return {"kind": "none", "reason": nothing, "assumptions": []}
    clear = ", and the deputy stays clear of the chief" if model.fuel.keep_clear else ""
    return {
        "kind": "by_prediction",
        "reason": f"the limit is never exceeded{clear}: each period begins with a backup flight that is "
        "predicted to its end and bounded beyond, and paid for. The other constraints are not looked at",
        "assumptions": [
            "the motion is that of the Clohessy-Wiltshire equations, without disturbance",
            "the state is known exactly and without delay, and the thrust is applied exactly",
            "the filter is asked once per period, and at the first one the backup flight can be paid for",
        ],
    }


# -- run folder -------------------------------------------------------------------------------------


def write_fuel_run(
    out: str | Path,
    scenario: InspectionScenario,
    run: FuelRun,
    *,
    overrides: Sequence[str] = (),
    seconds: Mapping[str, float] | None = None,
    figures: bool = True,
    progress: Callable[[str], None] = lambda what: None,
) -> InspectionFolder:
    """Write the run folder of a flight into the fuel limit; see `polaris.runs.inspection.write_run`."""

    def contents(folder: Path) -> dict[str, Any]:
        write_fuel(folder / "fuel.npz", run)
        return summary(scenario, run, seconds or {})

    return write_folder(out, scenario, contents, overrides, figures, progress)


def write_fuel(path: Path, run: FuelRun) -> None:
    """Write the flight and the predicted backup flights."""
    arrays: dict[str, Any] = {}
    for k, one in enumerate(run.predictions):
        arrays |= {
            f"prediction_{k}_t_s": one.t,
            f"prediction_{k}_states": one.x,
            f"prediction_{k}_delta_v_m_s": one.delta_v,
        }
    np.savez(
        path,
        t_s=run.t,
        states=run.x,
        thrust_N=run.u,
        desired_N=run.desired,
        delta_v_m_s=run.delta_v,
        latched_at_s=np.array(np.nan if run.latched_at is None else run.latched_at),
        predictions=np.array(len(run.predictions)),
        **arrays,
    )


def read_fuel(path: Path, scenario: InspectionScenario) -> FuelRun:
    """Read what `write_fuel` wrote; reasons and wall times are in the summary only."""
    arrays = read_arrays(path)
    t, x, u, desired, spent = (
        arrays[name] for name in ("t_s", "states", "thrust_N", "desired_N", "delta_v_m_s")
    )
    K = len(t) - 1
    if (x.shape, u.shape, desired.shape, spent.shape) != ((K + 1, 6), (K, 3), (K, 3), (K + 1,)):
        raise ValueError("fuel.npz: arrays of the wrong shape")
    if not all(np.isfinite(values).all() for values in (t, x, u, spent)):
        raise ValueError("fuel.npz: numbers that are not finite")
    latched = float(arrays["latched_at_s"])
    predictions = tuple(
        Prediction(*(arrays[f"prediction_{k}_{name}"] for name in ("t_s", "states", "delta_v_m_s")))
        for k in range(int(arrays["predictions"]))
    )
    return FuelRun(
        scenario.inspection(),
        t,
        x,
        u,
        desired,
        spent,
        None if np.isnan(latched) else latched,
        None,
        predictions,
        False,
        0.0,
        0.0,
    )
