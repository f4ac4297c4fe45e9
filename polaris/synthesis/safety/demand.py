"""Errors that depend on the time of the flight: of scheduled commands in proportion, and of navigation."""

import numpy as np

from reach.numerics.linear import summed

from ...model.system import Array, LinearSystem
from ...model.tolerances import ROUNDING
from ...planning.reference import Reference
from ..tracker.profile import SETTLED, SPARE
from ..tracker.tracking import Tracking

ROUNDS = 300  # most rounds of a bound on commands: near errors that feed on themselves it grows for long
LONGER = 3
"""For how many memories bounds at the end of the tail are constant: a checker remembers longer."""


class Scheduled:
    """What errors add by the time of the flight: because of the reference's own input, and of its steps.

    The former are errors of thrusters; the latter are by how much estimates may be off more than in the best
    known step.

    Parameters
    ----------
    tracking : Tracking
    reference : Reference
    planned : int
        Number of steps before the tail.
    """

    def __init__(self, tracking: Tracking, reference: Reference, planned: int) -> None:
        self.tracking, self.planned = tracking, planned
        system, gain = tracking.system, tracking.gain
        known = command_errors(system, gain, reference.cells, planned)
        self.noise = known - system.calmest.command_error(gain)
        self.nu = np.abs(reference.nu) + self.noise
        self.commanded = self._commanded()

    def _commanded(self) -> Array:
        """Bound on the scheduled part of each command, shape (cells, m) [N]; beyond limits if none is found.

        It does not grow over the tail, and is constant over the end of it that later turns remember.
        """
        found, tracking, u_max = self.nu, self.tracking, self.tracking.system.u_max
        remembered = LONGER * (tracking.memory + 2)
        end = max(len(found) + -remembered // tracking.feedback.nodes_per_cell, self.planned)
        for _ in range(ROUNDS):
            more = self._along(self.tracking.gain, found).max(axis=1)
            more[end:] = more[end:].max(axis=0, initial=0.0)
            more[self.planned :] = np.maximum.accumulate(more[self.planned :][::-1])[::-1]
            before, found = found, self.nu + more * (1 + SPARE)
            if np.all(found - before <= SETTLED * more) or np.any(more > u_max):
                return np.asarray(found)
        return np.asarray(found + u_max / SPARE)

    def along(self, rows: Array) -> Array:
        """What they add along rows (r, n) in the periods next to a node, shape (cells, q + 1, r)."""
        return self._along(rows, self.commanded)

    def _along(self, rows: Array, commanded: Array) -> Array:
        tracking, cells = self.tracking, len(commanded)
        q, errors = tracking.feedback.nodes_per_cell, self.noise
        if tracking.profile is not None:
            errors = errors + tracking.system.thrusters.part(commanded) + self._unseen(commanded)
        gains = tracking.flow.input_gains(rows, tracking.system.B, tracking.memory + 2)
        sums, within = summed(gains, np.repeat(errors, q, axis=0)), errors @ gains[0].T
        now = sums[:-1].reshape(cells, q, -1) + within[:, None]
        between = np.maximum(now, sums[1:].reshape(cells, q, -1))
        if cells > self.planned:  # the tail is flown again and again: as if its last commands had always been
            for_ever = gains.sum(axis=0) @ errors[-1] + within[-1]
            between[self.planned :] = np.maximum(between[self.planned :], for_ever)
        late, curved = tracking.late(rows, errors.max(axis=0))
        found = np.concatenate([between[:, :1], between], axis=1)
        found[:, 1:-1] = np.maximum(between[:, :-1], between[:, 1:])
        return np.asarray((found + late + curved) * (1 + ROUNDING))

    def _unseen(self, commanded: Array) -> Array:
        """What errors of scheduled commands add to those after them until they are measured, (cells, m)."""
        system, gain = self.tracking.system, self.tracking.gain
        before = commanded.copy()
        for i in range(1, -(-system.timing.hidden // self.tracking.feedback.nodes_per_cell) + 1):
            before[i:] = np.maximum(before[i:], commanded[:-i])
        return system.command_error(gain, before) - system.command_error(gain, 0 * before)


def command_errors(system: LinearSystem, gain: Array, cells: int, planned: int) -> Array:
    """By how much commands may differ in each cell from those on the exact state, shape (cells, m).

    In the tail, after the `planned` cells, by as much as ever from then on: it is flown again and again.
    """
    rows = system.navigation[None] if system.error_by_step is None else system.error_by_step
    at, last = np.minimum(np.arange(cells), len(rows) - 1), len(rows) - 1
    if last:
        rows, at[planned:] = np.vstack([rows, rows[min(planned, last) :].max(axis=0)]), last + 1
    return (rows @ np.abs(gain).T)[at]


def taken_over(tracking: Tracking, reference: Reference) -> Array:
    """Bound on the errors of what S applies along a reference, right after it takes over, shape (m,) [N]."""
    system, told = tracking.system, tracking.system.u_max
    if tracking.profile is not None:
        scheduled = Scheduled(tracking, reference, reference.cells).commanded.max(axis=0)
        told = np.minimum(told, scheduled + tracking.profile[0])
    return system.input_error(tracking.gain, told)
