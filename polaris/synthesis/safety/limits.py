"""Limits that S must keep: rows of the loop state, and the room of each at every node of a flight."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...model.system import Array
from ...model.tolerances import ROUNDING
from .clearance import Clearance


@dataclass(frozen=True, eq=False)
class Limits:
    """Rows r of the loop state z with ``r z <= room``: facets, then commands of either sign.

    Commands are limited by the thrusters, and once more by what errors of thrusters are booked for, if that
    is less. Arrays of shape (2, nodes + 1, r) hold at both ends of every period: ``[0, i]`` where the period
    that begins at node i begins, ``[1, i]`` where the one that ends at node i ends.
    """

    clearance: Clearance

    @cached_property
    def rows(self) -> Array:
        """All rows, shape (r, N)."""
        tracking = self.clearance.tracking
        often = 1 if tracking.profile is None else 2
        return np.vstack([tracking.whole(self.clearance.obstacle_rows[0]), *[tracking.commands] * often])

    @property
    def facets(self) -> int:
        """Number of rows that are facets."""
        return len(self.clearance.obstacle_rows[0])

    @property
    def booked(self) -> int:
        """First of the rows that limit commands to what errors are booked for, which count if exceeded."""
        return self.facets + 2 * self.clearance.tracking.system.m

    @cached_property
    def room(self) -> Array:
        """Room of every row, infinite where it limits nothing, shape (2, nodes + 1, r).

        ``u = mu - Lambda e``: the row ``+Lambda_i`` is limited by the room below, ``-Lambda_i`` above.
        """
        clearance, tracking, o = self.clearance, self.clearance.tracking, self.facets
        cells, q, facets = clearance.cells, clearance.q, clearance.obstacle_rows[1]
        above, below = clearance.thrust
        thrust = [below, above]
        if tracking.profile is not None:
            level = tracking.profile[0] * (1 - ROUNDING) - tracking.noise
            thrust += [level - clearance.jumped(tracking.gain)] * 2
        room = np.full((2, cells * q + 1, len(self.rows)), np.inf)
        begins = np.arange(cells * q).reshape(cells, q, 1)
        for end in (0, 1):
            at = begins + end, facets[:, None, :]
            np.minimum.at(room[end], at, clearance.room[:, end : end + q])
            room[end, begins[..., 0].ravel() + end, o:] = np.repeat(np.hstack(thrust), q, axis=0)
        room[1, q::q, o:] = np.inf  # the input renewed at the end of a cell belongs to the next one
        return np.asarray(room - self._scheduled)

    @cached_property
    def _scheduled(self) -> Array:
        """Part of the room taken by errors that depend on the time of the flight, as `room`."""
        found = self._ends(self.clearance.scheduled(self.rows))
        found[..., self.booked :] = 0.0  # they are booked apart
        return found

    @cached_property
    def taken(self) -> Array:
        """Part of the room already taken by these errors and the jump into the tail, as `room`.

        A share of the room counts it as a need: of a smaller room, the same need would seem to leave more.
        """
        clearance = self.clearance
        jump = clearance.jumped(self.rows[:, : clearance.tracking.system.n])
        return self._scheduled + self._ends(np.repeat(jump[:, None], clearance.q + 1, axis=1))

    def _ends(self, places: Array) -> Array:
        """Lay out values at the nodes of every cell, shape (cells, q + 1, r), as `room`; 0 elsewhere."""
        cells, q = self.clearance.cells, self.clearance.q
        found = np.zeros((2, cells * q + 1, len(self.rows)))
        found[0, :-1] = places[:, :-1].reshape(cells * q, -1)
        found[1, 1:] = places[:, 1:].reshape(cells * q, -1)
        return found

    @cached_property
    def most_taken(self) -> Array:
        """Largest part of the room of each row that is `taken`, shape (r,)."""
        return np.asarray(self.taken.max(axis=(0, 1)))

    @cached_property
    def periods(self) -> Array:
        """Least room of every row in every period, shape (nodes, r)."""
        return np.minimum(self.room[0, :-1], self.room[1, 1:])

    @cached_property
    def ahead(self) -> Array:
        """Least room of every row from a node on, shape (nodes + 1, r)."""
        return later(self.room)

    def window(self, node: int, count: int) -> Array:
        """Return the least room at so many nodes from one on, or until the last, shape (count, r)."""
        begin, end = self.room[:, node : node + count].copy()
        end[:1] = np.inf  # the period that ends there lies behind
        return np.asarray(np.minimum(begin, end))

    def name(self, period: int, row: int) -> str:
        """Return the name of the unsafe set or of the input that a row limits in a period."""
        clearance = self.clearance
        if row >= self.facets:
            return clearance.tracking.system.input_names[(row - self.facets) % clearance.tracking.system.m]
        cell, place = divmod(period, clearance.q)
        mine = clearance.obstacle_rows[1][cell] == row
        room = np.where(mine, clearance.room[cell, place : place + 2].min(axis=0), np.inf)
        return clearance.unsafe[int(np.argmin(room))].name


def later(ends: Array, pick: np.ufunc = np.minimum) -> Array:
    """Return the least, or the largest, from a node on of what holds at both ends of every period.

    `ends`, shape (2, nodes + 1, ...), is laid out as `Limits.room`; its last entry of the first end, which
    belongs to no period, must not count.
    """
    both = pick(ends[0], np.concatenate([ends[1][1:], ends[0][-1:]]))
    return np.asarray(pick.accumulate(both[::-1])[::-1])
