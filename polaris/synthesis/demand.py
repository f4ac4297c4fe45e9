"""What S commands after a hand-over, and what errors of thrusters in proportion to it add.

Two parts are booked apart: the feedback, by a bound that falls with the time since the hand-over (the
*profile*), and the reference's input with what S corrects of its errors, step by step (the *scheduled* part).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.signal import oaconvolve

from ..model.system import Array
from ..model.tolerances import ROUNDING
from ..planning.reference import Reference

if TYPE_CHECKING:
    from .tracking import Tracking

ROUNDS = 60
"""Most rounds of a bound that grows with the errors which it allows."""
SETTLED, SPARE = 1e-4, 2e-3
"""Relative change at which it counts as settled, and what is added to it then."""
SLOWER = 1.5
"""By how much slower the demand of sets that an experimental controller leaves falls than that of a ball."""
FFT = 1e-13
"""Round-off of sums of products by fast transforms, relative to the largest of them."""


def summed(gains: Array, errors: Array) -> Array:
    """``sum_{i<L} gains[L-1-i] errors[i]`` for L = 0 ... len(errors), shape (len(errors) + 1, r).

    `gains` (a, r, m) belong to periods by their age, `errors` (L, m) to periods in their order.
    """
    sums = oaconvolve(gains, errors[:, None, :], axes=0)[: len(errors)].sum(axis=-1)
    sums = np.maximum(sums, 0.0) + FFT * np.max(sums, axis=0, initial=0.0)
    return np.vstack([np.zeros((1, gains.shape[1])), sums])


def profile(tracking: Tracking, level: float) -> Array:
    """Bound on what S's feedback commands so many periods after a hand-over, shape (memory + 2, m) [N].

    Any bound that does not grow would be sound, as long as the recoverable sets keep to it. This one falls as
    what errors demand that start with the share `level` of the limits, to what disturbances and
    the errors of the commands themselves demand for ever: each round allows for the errors of the one before.
    """
    gain, u_max = tracking.gain, tracking.system.u_max
    norms = np.linalg.norm(gain @ tracking.transitions @ tracking.W_inverse, axis=-1)
    ages, falls = np.arange(len(norms)), np.maximum.accumulate(norms[::-1])[::-1] / norms[0]
    shape = np.stack([np.interp(ages / SLOWER, ages, fall) for fall in falls.T], axis=1)
    shape = shape * level * u_max
    noise = tracking.system.command_error(gain)
    left = tracking.forgotten(gain, float(np.min(u_max / norms[0])))
    found = shape
    for _ in range(ROUNDS):
        pushed = tracking.pushed(gain, found)
        parts = np.maximum(shape + pushed[:-1], pushed[-1] + left) + noise
        before, found = found, np.maximum.accumulate(parts[::-1])[::-1]
        if np.all(found - before <= SETTLED * before) or np.any(found[-1] > u_max):
            break
    return np.asarray(found * (1 + SPARE))


class Scheduled:
    """What errors of the thrusters add because of the reference's own input, by the time of the flight.

    Parameters
    ----------
    tracking : Tracking
    reference : Reference
    planned : int
        Number of steps before the tail.
    """

    def __init__(self, tracking: Tracking, reference: Reference, planned: int) -> None:
        self.tracking, self.planned = tracking, planned
        self.nu = np.abs(reference.nu)
        self.commanded = self._commanded()

    def _commanded(self) -> Array:
        """Bound on the scheduled part of every command, constant over the tail, shape (cells, m) [N]."""
        found = self.nu
        for _ in range(ROUNDS):
            more = self._along(self.tracking.gain, found).max(axis=1)
            more[self.planned :] = more[self.planned :].max(axis=0, initial=0.0)
            before, found = found, self.nu + more * (1 + SPARE)
            if np.all(found - before <= SETTLED * more) or np.any(more > self.tracking.system.u_max):
                break
        return found

    def along(self, rows: Array) -> Array:
        """What they add along rows (r, n) in the periods next to a node, shape (cells, q + 1, r)."""
        return self._along(rows, self.commanded)

    def _along(self, rows: Array, commanded: Array) -> Array:
        tracking, cells = self.tracking, len(commanded)
        q, errors = tracking.feedback.nodes_per_cell, tracking.system.thrusters.part(commanded)
        gains = tracking.flow.input_gains(rows, tracking.system.B, tracking.memory + 2)
        sums, within = summed(gains, np.repeat(errors, q, axis=0)), errors @ gains[0].T
        now = sums[:-1].reshape(cells, q, -1) + within[:, None]
        between = np.maximum(now, sums[1:].reshape(cells, q, -1))
        if cells > self.planned:  # the tail is flown again and again: as if its commands had always been
            for_ever = gains.sum(axis=0) @ errors[-1] + within[-1]
            between[self.planned :] = np.maximum(between[self.planned :], for_ever)
        late, curved = tracking.late(rows, errors.max(axis=0))
        found = np.concatenate([between[:, :1], between], axis=1)
        found[:, 1:-1] = np.maximum(between[:, :-1], between[:, 1:])
        return np.asarray((found + late + curved) * (1 + ROUNDING))


def taken_over(tracking: Tracking, reference: Reference) -> Array:
    """Bound on the errors of what S applies along a reference, right after it takes over, shape (m,) [N]."""
    system, told = tracking.system, tracking.system.u_max
    if tracking.profile is not None:
        scheduled = Scheduled(tracking, reference, reference.cells).commanded.max(axis=0)
        told = np.minimum(told, scheduled + tracking.profile[0])
    return system.input_error(tracking.gain, told)
