"""Errors by the time of the flight, of commands and navigation (docs/theory.md, Proposition 4)."""

from functools import cached_property

import numpy as np

from ...model.craft import Array, Craft
from ...model.tolerances import ROUNDING
from ...planning.reference import Reference
from ..tracker.channel import Channel
from ..tracker.feedback_bound import SETTLED, SPARE
from ..tracker.tightening import Response
from ..tracker.tracking import Tracking

ROUNDS = 300  # most rounds of a bound on commands: near errors that feed on themselves it grows for long

Effects = list[tuple[Channel, Response]]
"""Channels, and the response of some rows to each."""


class Feedforward:
    """Tightening by flight time: errors of the reference's commands, and of estimates in some steps.

    The former cause errors of thrusters. The latter are by how much estimates may be off more than in the
    best known step.

    Parameters
    ----------
    tracking : Tracking
    reference : Reference
    planned : int
        Number of steps before the tail.
    """

    def __init__(self, tracking: Tracking, reference: Reference, planned: int) -> None:
        self.tracking, self.planned = tracking, planned
        self.constant = planned + (reference.cells - planned) // 2  # cell from which bounds do not change
        self.excess = errors_by_cell(tracking.step_errors, reference.cells, planned)
        self.nu = np.abs(reference.nu) + self.excess @ np.abs(tracking.gain).T

    @cached_property
    def commanded(self) -> Array:
        """Bound on the scheduled part of each command, shape (cells, m) [N]; beyond limits if none is found.

        It does not grow over the tail, and is constant over the second half of it.
        """
        bound, u_max = self.nu, self.tracking.system.u_max
        effects = self._effects(self.tracking.commands[: len(u_max)])
        for _ in range(ROUNDS):
            response = self._along(effects, bound, len(u_max)).max(axis=1)
            response[self.constant :] = response[self.constant :].max(axis=0, initial=0.0)
            response[self.planned :] = np.maximum.accumulate(response[self.planned :][::-1])[::-1]
            before, bound = bound, self.nu + response * (1 + SPARE)
            if np.all(bound - before <= SETTLED * response) or np.any(response > u_max):
                return np.asarray(bound)
        return np.asarray(bound + u_max / SPARE)

    def response(self, rows: Array, between: bool = True) -> Array:
        """Return the feedforward tightening of rows at every node of every cell, shape (cells, q + 1, r).

        Rows are those of the error, (r, n), or of the loop state, (r, N). If `between`, a row is at most the
        chord of its entries between two nodes.
        """
        return self._along(self._effects(rows), self.commanded, len(rows), between)

    def _effects(self, rows: Array) -> Effects:
        tracking, n = self.tracking, self.tracking.system.n
        channels = [Channel("steps", np.zeros(n), noise=np.eye(n))] * bool(np.any(self.excess))
        if tracking.feedback_bound is not None:
            channels += [channel for channel in tracking.tightening.closed.loop.channels if channel.share]
        return [(channel, tracking.response(channel, rows)) for channel in channels]

    def _along(self, effects: Effects, commanded: Array, count: int, between: bool = True) -> Array:
        cells, q = len(commanded), self.tracking.feedback.nodes_per_cell
        T, constant = self.planned * q, (cells - self.constant) * q
        at, later, intersample = (np.zeros((nodes, count)) for nodes in (cells * q + 1, cells * q - T + 1, 1))
        for channel, effect in effects:
            sizes = np.repeat(self._sizes(channel, commanded), q, axis=0)
            at += effect.at_nodes(sizes)
            intersample += effect.between @ sizes.max(axis=0) * between
            if constant:  # before a later turn of the tail are its own last sizes, and larger ones before
                last, largest = sizes[-constant:].max(axis=0), sizes[T:].max(axis=0)
                later += effect.at_nodes(np.maximum(sizes[T:] - last, 0.0)) + effect.ever(last)
                later += effect.ever(largest - last, constant, len(later))
        parts = at[: T + 1], np.maximum(at[T:], later)
        ends = [part[i : i + q + 1] for part in parts for i in range(0, len(part) - 1, q)]
        return np.asarray((np.array(ends) + intersample) * (1 + ROUNDING))

    def _sizes(self, channel: Channel, commanded: Array) -> Array:
        """Sizes of a channel in every cell, under commands of as many periods as it remembers."""
        if channel.share is None:
            return self.excess
        before = commanded.copy()
        for i in range(1, -(-channel.lag // self.tracking.feedback.nodes_per_cell) + 1):
            before[i:] = np.maximum(before[i:], commanded[:-i])
        return channel.share(np.minimum(before, self.tracking.system.u_max))


def errors_by_cell(by_step: Array, cells: int, planned: int) -> Array:
    """Bounds (K + 1, n) in each step and ever after, as bounds in each cell, shape (cells, n).

    In the tail, after the `planned` cells, as much as ever from then on: it is flown again and again.
    """
    at, last = np.minimum(np.arange(cells), len(by_step) - 1), len(by_step) - 1
    if last:
        at[planned:] = last + 1
        by_step = np.vstack([by_step, by_step[min(planned, last) :].max(axis=0)])
    return np.asarray(by_step[at])


def command_errors(system: Craft, gain: Array, cells: int, planned: int) -> Array:
    """Bound how far commands in each cell may be from those on the exact state, shape (cells, m)."""
    rows = system.navigation[None] if system.error_by_step is None else system.error_by_step
    return errors_by_cell(rows, cells, planned) @ np.abs(gain).T


def command_noise(tracking: Tracking, cells: int, planned: int) -> Array:
    """Bound on the part of a command that `Tracking.commands` omits, in each cell, shape (cells, m)."""
    errors = errors_by_cell(tracking.step_errors, cells, planned)
    return np.asarray(tracking.noise + errors @ np.abs(tracking.gain).T)


def hand_over_error(tracking: Tracking, reference: Reference) -> Array:
    """Bound on the errors of S's thrust along a reference, right after it takes over, shape (m,) [N]."""
    system, commanded = tracking.system, tracking.system.u_max
    if tracking.feedback_bound is not None:
        scheduled = Feedforward(tracking, reference, reference.cells).commanded.max(axis=0)
        commanded = np.minimum(commanded, scheduled + tracking.feedback_bound[0])
    return system.input_error(tracking.gain, commanded)
