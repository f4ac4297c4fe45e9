"""What faults add to the states until they are isolated (docs/theory.md, Lemma 41)."""

from collections.abc import Callable
from dataclasses import replace
from math import ceil

import numpy as np
from scipy.linalg import expm

from ..model.prediction import prediction_error
from ..model.system import Array, LinearSystem
from ..model.timing import WHOLE
from ..model.tolerances import ROUNDING
from ..model.transient import Transient


def moved(system: LinearSystem, fault: Transient, gain: Array, h: float) -> Array:
    """How far wrong thrust moves the states at most, whoever flies meanwhile, shape (J, n).

    Every law answers with no more than its gain times the deviation, whatever clips it (Gronwall's
    inequality); a network also with no more than twice the limits from the first node after the fault on, a
    black box with that alone. What a delay hides counts as if it lasted longer. Periods are of h [s].
    """
    most, pushes = np.maximum(fault.gains, np.abs(gain)), fault.pushes
    found = _spread(system, fault.lasts, h, most, pushes)
    answered = h * (ceil(fault.lasts / h * (1 - WHOLE)) - 1)
    if answered > 0 and (fault.asked or fault.networks is not None):
        found = found + _spread(system, answered, h, most, 2 * system.u_max[None])
    if fault.networks is None or fault.asked:
        return found
    steep = np.maximum(most, fault.networks)
    return np.asarray(np.minimum(found, _spread(system, fault.lasts, h, steep, pushes)))


def hidden(system: LinearSystem, gain: Array, h: float) -> Array:
    """What wrong thrust may add to states by the time that predictions know of it, shape (n,)."""
    ended = (replace(fault, lasts=0.0) for fault in system.transients if len(fault.thrust))
    found = (moved(system, fault, gain, h).max(axis=0) for fault in ended)
    return np.asarray(np.max([np.zeros(system.n), *found], axis=0))


def _spread(system: LinearSystem, lasts: float, h: float, gains: Array, wrong: Array) -> Array:
    """The same under laws with gains up to these, inputs being off by a row of `wrong` (J, m) besides."""
    timing, thrusters, n = system.timing, system.thrusters, system.n
    late = h * (ceil(timing.delay / h * (1 - WHOLE)) + timing.missed)
    answer = np.eye(system.m) * (1 + thrusters.along) + thrusters.across
    block = np.zeros((2 * n, 2 * n))
    block[:n, :n] = np.abs(system.A) + np.abs(system.B) @ answer @ gains
    block[:n, n:] = np.eye(n)
    spread = expm(block * (lasts + late))[:n, n:] @ np.abs(system.B)
    return np.asarray((wrong + thrusters.part(wrong)) @ spread.T * (1 + ROUNDING))


def lost(system: LinearSystem, fault: Transient, h: float, left: Callable[[Array, Array], Array]) -> Array:
    """Error of predictions over a whole outage, and what is left of that of the first estimate, (1, n).

    S steers what is predicted, exactly as a loop without disturbance, in which `left` of some rows and boxes
    (J, n) remains. Periods may be missed before and after.
    """
    timing, every = system.timing, np.eye(system.n)
    measured = np.array(timing.measured or system.navigation) + system.displaced
    age = fault.lasts + timing.delay + h * (2 * timing.missed + 1)
    found = prediction_error(system, measured, system.thrusters.error(system.u_max), age)
    carried = [np.abs(expm(system.A * h * i)) @ system.navigation for i in range(fault.unseen + 1)]
    first = np.max(carried, axis=0)
    return np.asarray((found + left(every, first[None])[-1].T) * (1 + ROUNDING))
