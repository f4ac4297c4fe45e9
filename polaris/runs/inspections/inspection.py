"""Run folders of one flight of the inspection problem.

================== ==================================================================================
scenario.toml      the scenario, with the overrides applied
summary.json       least value of every constraint, answers of the filter, guarantee, times
constraints.csv    the same least values as a table
flight.npz         states, thrust wanted and applied, status and barriers of every control period
figures/           PDF and PNG, drawn from the files above alone
================== ==================================================================================
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...inspection.constraints.allowable_set import allowable
from ...inspection.constraints.constraint import KINDS
from ...inspection.flights.evaluation import EvaluatedRun, Least, least_values
from ...inspection.flights.simulation import BACKUP, UNPROVEN, FlightBatch, InspectionRun, fly_one, smoothness
from ...rta.projection import DESIRED, FAILED, FILTERED, SHORT
from ...scenario.scenario import FlightScenario
from ...scenario.tables.filters import AssuredFilter, BarrierFilter
from ..files.arrays import array_fields, read_fields, read_finite
from ..files.folder import SCENARIO, RunKind
from ..files.tables import write_csv
from ..stages import Stages

ARRAYS = {  # attribute of a flight by the name of its array
    "t_s": "t",
    "states": "x",
    "sun_rad": "sun",
    "thrust_N": "u",
    "desired_N": "desired",
    "status": "status",
    "barriers": "h",
}


def fly_flight(scenario: FlightScenario, stages: Stages | None = None) -> EvaluatedRun:
    """Fly one flight of the inspection problem and judge it, also between the samples."""
    stages, flight = stages or Stages(), scenario.model.flight
    with stages.stage("flight"):
        x, sun = scenario.initial()
        start, times = (x[None], np.array([sun])), (flight.duration_s, flight.period_s)
        flights = FlightBatch(scenario.inspection(), *start, *times, scenario.primary(), scenario.errors())
        total = round(flight.duration_s / flight.period_s)
        counting = stages.counting("flight: {} of {} periods")
        filtering = scenario.filter(scenario.model.filter, flight.period_s)
        run = fly_one(flights, filtering, lambda step: counting(step.k + 1, total))
        return least_values(run, scenario.families(), flight.between)


def _write(folder: Path, scenario: FlightScenario, judged: EvaluatedRun) -> None:
    rows = least_rows(judged.constraints | judged.barriers)
    for row in rows:
        row["deputies"] = " ".join(map(str, row["deputies"]))
    write_csv(folder / "constraints.csv", rows)
    np.savez(folder / "flight.npz", **array_fields(judged.run, ARRAYS))


def _read(folder: Path, scenario: FlightScenario) -> InspectionRun:
    """Return the flight, bit for bit."""
    arrays = read_finite(folder / "flight.npz", ("t_s", "states", "sun_rad", "thrust_N"))
    q, K = scenario.inspection(), len(arrays["t_s"]) - 1
    N = q.deputies
    shapes = [arrays[name].shape for name in ARRAYS]
    shapes[-1] = shapes[-1][:1]
    if shapes != [(K + 1,), (K + 1, N, 6), (K + 1,), (K, N, 3), (K, N, 3), (K, N), (K,)]:
        raise ValueError("flight.npz: arrays of the wrong shape")
    return InspectionRun(q, **read_fields(arrays, ARRAYS))


MEANING = {name: (kind.meaning, kind.unit) for name, kind in KINDS.items()}
"""Meaning of each constraint, and its unit."""

BARRIER_UNIT = {"passive": "m", "deputy_passive": "m", "velocity": "m^2/s^2"}
"""Units of the barriers that are not in m/s."""

SWITCHED = {"backup": BACKUP, "unproven": UNPROVEN}  # answers that only filters with a backup controller give

DEFINITIONS = {
    "constraints": "least value over the flight, at the start of every control period and at the instants "
    "between; negative is a violation",
    "violated_share": "share of those instants at which anyone violates it",
    "steps": "decisions of the filter, one per deputy and period: desired, the desired input; filtered, the "
    "nearest input that satisfies all conditions; short, no input does, the least violation is applied; "
    "failed, no solution, no thrust; backup, the backup controller's; unproven, not known to be safe",
    "filter_seconds": "wall time of one decision for all deputies",
    "smoothness": "sign changes between consecutive periods, and the total variation of thrust [N], per axis "
    "and minute: of the applied thrust, and of the desired one within the thrust limits",
    "delta_v_m_s": "integral of the absolute thrusts over mass (eq. 25), per deputy; delta_v_max_m_s is the "
    "limit of the tank, which no barrier keeps",
}


def assumptions(scenario: FlightScenario) -> list[str]:
    """Return the assumptions of a claim about a flight."""
    bounds, flight = scenario.uncertainty(), scenario.model.flight
    delay = scenario.model.timing.delay_s
    jitter = f", at most {bounds.jitter:g} s early or late" if bounds.jitter else ""
    timing = f"by a prediction over {delay:g} s" if delay else "without delay"
    state, push, thrust = f"exactly and {timing}", "without disturbance", "exactly"
    if bounds.estimate.any():
        largest = bounds.estimate.reshape(2, 3).max(axis=1)
        state = f"{timing}, within {largest[0]:g} m and {largest[1]:g} m/s per axis"
    if bounds.disturbance:
        push = f"with a disturbance of at most {bounds.disturbance:g} m/s^2"
    if not (errors := bounds.thrusters).exact:
        parts = f"{100 * errors.along:.3g} % of each thrust, {100 * errors.across:.3g} % of their 2-norm"
        thrust = f"within {parts} and {errors.bit:.3g} N"
    return [
        f"the motion obeys the Clohessy-Wiltshire equations, {push}",
        f"the state of every deputy is known {state}",
        f"the thrust is applied {thrust}, and held for the control period",
        f"the filter decides every {flight.period_s:g} s{jitter}",
    ]


def _summary(scenario: FlightScenario, judged: EvaluatedRun, seconds: Mapping[str, float]) -> dict[str, Any]:
    """Contents of ``summary.json`` for one flight."""
    model, run = scenario.model, judged.run
    delta_v = run.delta_v[-1]
    return {
        "deputies": run.inspection.deputies,
        "duration_s": float(run.t[-1]),
        "period_s": model.flight.period_s,
        "filter": {
            "kind": model.filter.kind,
            "sharing": getattr(model.filter, "sharing", None),
            "without": list(model.filter.without),
            "sampled_data": getattr(model.filter, "sampled_data", False),
        },
        "safe": bool(all(least.value >= 0 for least in judged.constraints.values())),
        "constraints": least_rows(judged.constraints),
        "barriers": least_rows(judged.barriers),
        "steps": steps(run.status),
        "delta_v_m_s": delta_v,
        "delta_v_max_m_s": run.inspection.delta_v_max,
        "smoothness": {
            name: smoothness(u, run.t, run.inspection.thrust_max)
            for name, u in (("applied", run.u), ("wanted", run.desired))
        },
        "filter_seconds": {
            "median": float(np.median(run.seconds)),
            "p99": float(np.quantile(run.seconds, 0.99)),
            "largest": float(run.seconds.max()),
        },
        "guarantee": guarantee(scenario, judged),
        "definitions": DEFINITIONS,
        "seconds": dict(seconds),
    }


def least_rows(minima: Mapping[str, Least]) -> list[dict[str, Any]]:
    """One row per constraint, phi1 to phi11, or per family of barriers."""
    rows = []
    for name, least in minima.items():
        meaning, unit = MEANING.get(name) or (name.replace("_", " "), BARRIER_UNIT.get(name, "m/s"))
        rows.append(
            {
                "constraint": name,
                "meaning": meaning,
                "unit": unit,
                "least": least.value,
                "time_s": least.time,
                "deputies": list(least.deputies),
                "least_at_samples": least.at_samples,
                "violated_share": least.violated_share,
            }
        )
    return rows


def steps(status: Any) -> dict[str, int]:
    """Return the number of answers of each kind."""
    names = {"desired": DESIRED, "filtered": FILTERED, "short": SHORT, "failed": FAILED}
    names |= {name: code for name, code in SWITCHED.items() if (status == code).any()}
    return {name: int((status == code).sum()) for name, code in names.items()}


def covered_periods(run: InspectionRun) -> NDArray[np.bool_]:
    """Periods that began with no constraint violated and for which every program had a solution."""
    phi = allowable(run.inspection, run.x[:-1], run.sun[:-1])
    safe = np.all([(values >= 0).all(axis=1) for values in phi.values()], axis=0)
    return np.asarray(safe & (run.h >= 0).all(axis=1) & (run.status < SHORT).all(axis=1))


def guarantee(scenario: FlightScenario, judged: EvaluatedRun) -> dict[str, Any]:
    """Return the claim about one flight, and its assumptions."""
    run, spec = judged.run, scenario.model.filter
    barriers = isinstance(spec, BarrierFilter)
    covered = covered_periods(run) if barriers else ~(run.status == UNPROVEN).any(axis=1)
    missed = np.flatnonzero(~covered)
    kind, reason = _argument(spec, len(missed), scenario.uncertainty().exact)
    return {
        "kind": kind,
        "periods": len(covered),
        "periods_covered": int(covered.sum()),
        "first_missed_s": float(run.t[missed[0]]) if len(missed) else None,
        "assumptions": [] if kind == "none" else assumptions(scenario),
        "reason": reason,
    }


def _argument(spec: BarrierFilter | AssuredFilter, missed: int, exact: bool) -> tuple[str, str]:
    """Return a filter's guarantee with so many periods not covered, and its reason."""
    left_out = f"constraints left out: {', '.join(spec.without)}"
    if isinstance(spec, BarrierFilter):
        if not spec.sampled_data:
            return "none", "the conditions hold at the start of each period only"
        if not exact:
            return "none", "the conditions assume exact states, thrust and model"
        if getattr(spec, "sharing", None) == "coasting":
            return "none", "each deputy meets the conditions on a pair as if the other did not thrust"
        if spec.without:
            return "none", left_out
        return "per_period", (
            "no barrier becomes negative within a period that began safe and whose program had a solution. "
            "A solution of the next program is not claimed"
        )
    if missed:
        return "none", "at some states no plan is known that keeps the constraints"
    if spec.without:
        return "none", left_out
    return "all_time", (
        "phi1 to phi11 hold at every instant, and for ever if the primary controller stops: no thrust is "
        "applied before a plan from its end is proven safe for all time"
    )


FLIGHT = RunKind(
    "inspection", (SCENARIO, "constraints.csv", "flight.npz"), _write, _summary, _read, fly_flight
)
