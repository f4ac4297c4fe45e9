"""What faults that are isolated late add to all that S must have room for."""

from __future__ import annotations

from dataclasses import replace
from math import ceil
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.linalg import expm

from ..model.errors import SynthesisInfeasible
from ..model.prediction import prediction_error
from ..model.system import Array
from ..model.tolerances import ROUNDING
from ..model.transient import Transient

if TYPE_CHECKING:
    from .tracking import Tracking

WHOLE = 1e-9
"""Share by which a delay may exceed a whole number of periods and count as one."""


def upset_boxes(tracking: Tracking) -> Array:
    """Boxes about zero: one of them holds what a fault has added to the states until S flies on, (J, n)."""
    system = tracking.system
    found = [(_moved if len(fault.thrust) else _lost)(tracking, fault) for fault in system.transients]
    return np.vstack([np.zeros((0, system.n)), *found])


def _moved(tracking: Tracking, fault: Transient) -> Array:
    """How far wrong thrust moves the states at most, whoever flies meanwhile, shape (J, n).

    Every law answers with no more than its gain times the deviation, whatever clips it
    (Gronwall's inequality). What a delay hides from it counts as if the fault lasted longer.
    """
    system, timing, h = tracking.system, tracking.system.timing, tracking.flow.h
    late, n = h * (ceil(timing.delay / h * (1 - WHOLE)) + timing.missed), system.n
    answer = np.eye(system.m) * (1 + system.thrusters.along) + system.thrusters.across
    answer = answer @ np.maximum(fault.gains, np.abs(tracking.gain))
    block = np.zeros((2 * n, 2 * n))
    block[:n, :n], block[:n, n:] = np.abs(system.A) + np.abs(system.B) @ answer, np.eye(n)
    spread = expm(block * (fault.lasts + late))[:n, n:] @ np.abs(system.B)
    return np.asarray((fault.pushes + system.thrusters.part(fault.pushes)) @ spread.T * (1 + ROUNDING))


def _lost(tracking: Tracking, fault: Transient) -> Array:
    """Error of predictions over the whole outage, and what is left of that of its first estimate, (1, n).

    S steers what is predicted, exactly as a loop without disturbance. Periods may be missed before and after.
    """
    system, h, timing = tracking.system, tracking.flow.h, tracking.system.timing
    measured = np.array(timing.measured or system.navigation) + system.displaced
    age = fault.lasts + timing.delay + h * (2 * timing.missed + 1)
    found = prediction_error(system, measured, system.thrusters.error(system.u_max), age)
    before = np.maximum(system.navigation, np.abs(expm(system.A * h)) @ system.navigation)
    first = _carried(tracking, np.eye(system.n), before[None])[-1].T
    return np.asarray((found + first) * (1 + ROUNDING))


def _carried(tracking: Tracking, rows: Array, boxes: Array) -> Array:
    """What errors in boxes (J, n) need along each row up to l periods later, shape (memory + 2, r, J)."""
    size = np.linalg.norm(boxes @ np.abs(tracking.W).T, axis=1)
    reach = np.abs(rows @ tracking.transitions) @ boxes.T
    beyond = np.linalg.norm(rows @ tracking.W_inverse, axis=-1)[:, None] * tracking.decay[-1] * size
    later = np.maximum(np.maximum.accumulate(reach), beyond)
    return np.asarray(later + tracking.curvature(rows)[:, None] * size)


def upset(tracking: Tracking, rows: Array) -> Array:
    """What the worst fault needs along each row by the end of period L + 1, shape (memory + 3, r).

    It happens once: the largest over all instants since then, not their sum (docs/theory.md, Proposition 42).
    """
    found = _carried(tracking, rows, tracking.upsets).max(axis=-1) * (1 + ROUNDING)
    last = len(found) - 1
    return np.asarray(found[np.minimum(np.arange(last + 2) + 2, last)])


def taken(tracking: Tracking) -> list[dict[str, Any]]:
    """What each fault takes until it is isolated: of every clearance [m], and of the thrust that S has."""
    system, found = tracking.system, []
    rows, m = np.vstack([system.position, tracking.gain]), system.m
    for fault in system.transients:
        most = upset(replace(tracking, system=replace(system, transients=(fault,))), rows)[-1]
        clearance, thrust = float(most[:-m].max()), float((most[-m:] / system.u_max).max())
        found.append(
            {"fault": fault.name, "until_s": fault.lasts, "clearance_m": clearance, "thrust_share": thrust}
        )
    return found


def naming_faults(error: SynthesisInfeasible, tracking: Tracking) -> SynthesisInfeasible:
    """An error that says, where faults are isolated late, which of them takes most, and how much."""
    if not tracking.system.transients:
        return error
    worst = max(taken(tracking), key=lambda each: each["thrust_share"])
    told = (
        f" While {worst['fault']} lasts, {worst['until_s']:g} s, it may take {worst['clearance_m']:.4g} m of"
        f" every clearance and {worst['thrust_share']:.4g} of the thrust."
    )
    relax = f"{error.relax} Or isolate it sooner."
    return SynthesisInfeasible(error.condition + told, error.shortfall, relax)
