"""Boxes of what faults add to the states until they are isolated (docs/theory.md, Proposition 8 (a))."""

from collections.abc import Callable
from dataclasses import replace
from math import ceil

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.linalg import expm

from reach.numerics.linear import powers
from reach.tubes.flow import LinearFlow

from ...model.craft import Array, Craft
from ...model.prediction import IN_PERIOD, forgetting, prediction_error, unseen_by
from ...model.timing import WHOLE, Transient
from ...model.tolerances import ROUNDING


def moved(system: Craft, fault: Transient, gain: Array, h: float, off: Array) -> Array:
    """How far wrong thrust moves the states at most, whoever flies meanwhile, shape (J, n).

    Every law answers with no more than its gain times the deviation, whatever clips it (Gronwall's
    inequality); a network also with no more than twice the limits from the first node after the fault on, a
    black box with that alone. What a delay hides counts as if it lasted longer. Periods are of h [s]; an
    observer is misled by `off` (J, n) at most.
    """
    most, given = np.maximum(fault.gains, np.abs(gain)), (fault.pushes, off)
    found, later = _spread(system, fault.lasts, h, most, given), h * (ceil(fault.lasts / h * (1 - WHOLE)) - 1)
    if later > 0 and (fault.asked or fault.networks is not None):
        found = found + _spread(system, later, h, most, (2 * system.u_max[None], 0 * off[:1]))
    if fault.networks is not None and not fault.asked:
        steep = np.maximum(most, fault.networks)
        found = np.minimum(found, _spread(system, fault.lasts, h, steep, given))
    if fault.after > 0:  # meanwhile nobody's answer counts
        found = np.maximum(found, _spread(system, fault.lasts + fault.after, h, 0 * most, given))
    return np.asarray(found)


def hidden(system: Craft, gain: Array, h: float) -> Array:
    """What wrong thrust may add to states by the time that predictions know of it, shape (n,)."""
    ended = (replace(fault, lasts=0.0) for fault in system.transients if len(fault.thrust))
    found = (moved(system, fault, gain, h, np.zeros((1, system.n))).max(axis=0) for fault in ended)
    return np.asarray(np.max([np.zeros(system.n), *found], axis=0))


def _spread(system: Craft, lasts: float, h: float, gains: Array, given: tuple[Array, Array]) -> Array:
    """The same under laws with gains up to these; `given` is how far inputs (J, m) and estimates are off."""
    (wrong, off), timing, thrusters, n = given, system.timing, system.thrusters, system.n
    late = h * (ceil(timing.delay / h * (1 - WHOLE)) + timing.missed)
    answer = np.eye(system.m) * (1 + thrusters.along) + thrusters.across
    block = np.zeros((2 * n, 2 * n))
    block[:n, :n] = np.abs(system.A) + np.abs(system.B) @ answer @ gains
    block[:n, n:] = np.eye(n)
    spread = expm(block * (lasts + late))[:n, n:] @ np.abs(system.B)
    return np.asarray((wrong + thrusters.part(wrong) + off @ gains.T @ answer.T) @ spread.T * (1 + ROUNDING))


def misled(system: Craft, fault: Transient, h: float, count: int) -> Array:
    """How far estimates are off because an observer does not know of a fault, shape (J, count, n).

    From the node on at which S flies because of it and no command is older, period by period, or ever after;
    the first row holds before, too (docs/theory.md, Proposition 8 (c)).
    """
    observer, timing, n, first = system.observer, system.timing, system.n, np.zeros(system.n)
    if observer is None:
        return np.zeros((max(len(fault.pushes), 1), count, n))
    loop, last, more = forgetting(system, observer, h)
    off = abs(timing.delay - h * round(timing.delay / h)) > WHOLE * h  # measurements are not those of nodes
    lasting = ceil(fault.lasts / h * (1 - WHOLE)) + off if len(fault.thrust) else 1
    left = powers(loop, count + more + lasting - 1) @ observer.rest
    if len(fault.thrust):
        flow = LinearFlow.continuous(system.A, system.D, system.w_max, h / IN_PERIOD)
        gains = flow.input_gains(left.reshape(-1, n), system.B, IN_PERIOD).sum(axis=0)
        wrong = fault.pushes + system.thrusters.part(fault.pushes)
        each = np.einsum("lnm,jm->jln", gains.reshape(-1, n, system.m), wrong)
        first = wrong @ unseen_by(system, timing.delay).T
    else:
        known = system.measured + system.displaced
        worst = system.thrusters.error(system.u_max)
        each = (np.abs(left) @ prediction_error(system, known, worst, fault.lasts + h))[None]
    found = sliding_window_view(each, lasting, axis=1).sum(axis=-1)
    ever = np.linalg.solve(np.eye(n) - last, found[:, count:].max(axis=1).T).T
    over = np.abs(expm(system.A * timing.delay)).T
    found = np.concatenate([found[:, :count], ever[:, None]], axis=1) @ over
    found = np.maximum.accumulate(found[:, ::-1], axis=1)[:, :0:-1]
    found[:, 0] += first
    return np.asarray(found * (1 + 10 * ROUNDING))


def lost(system: Craft, fault: Transient, h: float, left: Callable[[Array, Array], Array]) -> Array:
    """Error of predictions over a whole outage, and what is left of that of the first estimate, (1, n).

    S steers what is predicted, exactly as a loop without disturbance, in which `left` of some rows and boxes
    (J, n) remains. Periods may be missed before and after.
    """
    timing, every = system.timing, np.eye(system.n)
    measured = system.measured + system.displaced
    age = fault.lasts + timing.delay + h * (2 * timing.missed + 1)
    found = prediction_error(system, measured, system.thrusters.error(system.u_max), age)
    carried = [np.abs(expm(system.A * h * i)) @ system.navigation for i in range(fault.unseen + 1)]
    first = np.max(carried, axis=0)
    return np.asarray((found + left(every, first[None])[-1].T) * (1 + ROUNDING))
