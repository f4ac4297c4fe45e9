"""A filtered flight in numbers: the contents of ``summary.json`` and ``constraints.csv``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..inspection.constraints.allowable_set import allowable
from ..inspection.flights.judge import JudgedRun, Least
from ..inspection.flights.simulation import BACKUP, UNPROVEN, InspectionRun
from ..rta.projection import DESIRED, FAILED, FILTERED, SHORT
from ..scenario.filter_tables import (
    BackupFilter,
    BarrierFilter,
    DecentralizedFilter,
    ExplicitSimplexFilter,
)
from ..scenario.inspection_tables import InspectionModel
from ..scenario.scenario import FlightScenario

MEANING = {
    "phi1": ("separation from the chief", "m"),
    "phi2": ("separation of deputies", "m"),
    "phi3": ("dynamic speed limit", "m/s"),
    "phi4": ("sun keep-out, towards the chief", "rad"),
    "phi5": ("sun keep-out, towards a deputy", "rad"),
    "phi6": ("keep-in zone", "m"),
    "phi7": ("free flight past the chief", "m"),
    "phi8": ("free flight of deputies", "m"),
    "phi9": ("velocity limit, radial", "m^2/s^2"),
    "phi10": ("velocity limit, along-track", "m^2/s^2"),
    "phi11": ("velocity limit, cross-track", "m^2/s^2"),
}
"""What each constraint is, and its unit."""

BARRIER_UNIT = {"passive": "m", "deputy_passive": "m", "velocity": "m^2/s^2"}
"""Units of the barriers that are not in m/s."""

COLUMNS = (
    "constraint",
    "meaning",
    "unit",
    "least",
    "time_s",
    "deputies",
    "least_at_samples",
    "violated_share",
)

SWITCHED = {"backup": BACKUP, "unproven": UNPROVEN}
"""Answers that only filters with a backup controller give."""

DEFINITIONS = {
    "constraints": "least value over the flight, at the start of every control period and at the instants "
    "between; negative is a violation",
    "violated_share": "share of those instants at which anyone violates it",
    "steps": "answers of the filter, one per deputy and period: desired, the input wanted; filtered, the "
    "nearest that satisfies all conditions; short, none does, and this violates them least; failed, no "
    "answer, no thrust; backup, the backup controller's; unproven, not even this is known to be safe",
    "filter_seconds": "wall time of one answer for all deputies",
    "delta_v_m_s": "sum of the absolute thrusts over mass and time (eq. 25), per deputy",
}

ASSUMPTIONS = (
    "the motion is that of the Clohessy-Wiltshire equations, without disturbance",
    "every deputy's state is known exactly and without delay",
    "the thrust is applied exactly, and held for the control period",
)


def tell(scenario: FlightScenario, flown: JudgedRun, seconds: Mapping[str, float]) -> dict[str, Any]:
    """Contents of ``summary.json`` for one flight."""
    model, run = scenario.model, flown.run
    spent = run.delta_v[-1]
    return {
        "deputies": run.inspection.deputies,
        "duration_s": float(run.t[-1]),
        "period_s": model.flight.period_s,
        "filter": {
            "kind": model.filter.kind,
            "sharing": model.filter.sharing if isinstance(model.filter, DecentralizedFilter) else None,
            "without": list(model.filter.without),
            "sampled_data": isinstance(model.filter, BarrierFilter) and model.filter.sampled_data,
        },
        "safe": bool(all(least.value >= 0 for least in flown.constraints.values())),
        "constraints": constraint_rows(flown.constraints),
        "barriers": barrier_rows(flown.barriers),
        "steps": steps(run.status),
        "delta_v_m_s": spent,
        "filter_seconds": {
            "median": float(np.median(run.seconds)),
            "p99": float(np.quantile(run.seconds, 0.99)),
            "largest": float(run.seconds.max()),
        },
        "guarantee": guarantee(model, flown),
        "definitions": DEFINITIONS,
        "seconds": dict(seconds),
    }


def constraint_rows(found: Mapping[str, Least]) -> list[dict[str, Any]]:
    """One row per constraint, phi1 to phi11."""
    return [_row(name, *MEANING[name], least) for name, least in found.items()]


def barrier_rows(found: Mapping[str, Least]) -> list[dict[str, Any]]:
    """One row per family of barriers."""
    return [
        _row(name, name.replace("_", " "), BARRIER_UNIT.get(name, "m/s"), least)
        for name, least in found.items()
    ]


def _row(name: str, meaning: str, unit: str, least: Least) -> dict[str, Any]:
    return {
        "constraint": name,
        "meaning": meaning,
        "unit": unit,
        "least": least.value,
        "time_s": least.time,
        "deputies": list(least.deputies),
        "least_at_samples": least.at_samples,
        "violated_share": least.violated_share,
    }


def steps(status: Any) -> dict[str, int]:
    """How many answers of each kind."""
    names = {"desired": DESIRED, "filtered": FILTERED, "short": SHORT, "failed": FAILED}
    names |= {name: code for name, code in SWITCHED.items() if (status == code).any()}
    return {name: int((status == code).sum()) for name, code in names.items()}


def covered_periods(run: InspectionRun) -> NDArray[np.bool_]:
    """Periods that began with no constraint violated and for which every program had a solution."""
    phi = allowable(run.inspection, run.x[:-1], run.sun[:-1])
    safe = np.all([(values >= 0).all(axis=1) for values in phi.values()], axis=0)
    return np.asarray(safe & (run.h >= 0).all(axis=1) & (run.status < SHORT).all(axis=1))


def guarantee(model: InspectionModel, flown: JudgedRun) -> dict[str, Any]:
    """What is claimed of one flight, and on what assumptions."""
    covered = covered_periods(flown.run)
    missed = np.flatnonzero(~covered)
    shares = isinstance(model.filter, DecentralizedFilter) and model.filter.sharing == "coasting"
    told: dict[str, Any] = {
        "kind": "none",
        "periods": len(covered),
        "periods_covered": int(covered.sum()),
        "first_missed_s": float(flown.run.t[missed[0]]) if len(missed) else None,
        "assumptions": [],
    }
    spec = model.filter
    if not isinstance(spec, BarrierFilter):
        told |= _by_prediction(spec, flown.run)
    elif not spec.sampled_data:
        told["reason"] = "the conditions are met at the start of each period only"
    elif shares:
        told["reason"] = "each deputy answers for a pair as if the other did not thrust"
    elif model.filter.without:
        told["reason"] = f"constraints left out: {', '.join(model.filter.without)}"
    else:
        told["kind"] = "per_period"
        told["reason"] = (
            "each period that began safe and for which the program had a solution: no barrier becomes "
            "negative within it. That the next program has one is not claimed"
        )
        told["assumptions"] = list(ASSUMPTIONS)
    return told


def _by_prediction(spec: BackupFilter, run: InspectionRun) -> dict[str, Any]:
    """What is claimed under a filter that falls back to a backup controller."""
    if isinstance(spec, ExplicitSimplexFilter):
        reason = "the barriers are looked at at instants, and what the backup controller does is not proven"
        return {"reason": reason}
    missed = np.flatnonzero((run.status == UNPROVEN).any(axis=1))
    told: dict[str, Any] = {
        "periods_covered": len(run.status) - len(missed),
        "first_missed_s": float(run.t[missed[0]]) if len(missed) else None,
    }
    if len(missed):
        return told | {"reason": "not even the backup's flight is proven to keep the constraints everywhere"}
    if spec.without:
        return told | {"reason": f"constraints left out: {', '.join(spec.without)}"}
    reason = (
        "phi1 to phi6 and phi9 to phi11 hold for all time: every period ends where the backup's flight is "
        "predicted to its end and proven to keep them. Free flights (phi7, phi8) are not looked at"
    )
    return told | {"kind": "by_prediction", "reason": reason, "assumptions": list(ASSUMPTIONS)}
