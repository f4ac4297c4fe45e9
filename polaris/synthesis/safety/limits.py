"""Limits that S must keep: rows of the loop state, and the room of each in every period of a flight."""

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
    is less. Arrays of shape (2, periods, r) hold where every period begins, and where it ends.
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
        """Room of every row, infinite where it limits nothing, shape (2, periods, r).

        ``u = mu - Lambda e``: the row ``+Lambda_i`` is limited by the room below, ``-Lambda_i`` above.
        """
        clearance, tracking, q = self.clearance, self.clearance.tracking, self.clearance.q
        above, below = clearance.thrust
        thrust = [below, above]
        if tracking.profile is not None:
            level = tracking.profile[0] * (1 - ROUNDING) - tracking.noise
            thrust += [level - clearance.jumped(tracking.gain)] * 2
        facets, index = _ends(clearance.room), np.repeat(clearance.obstacle_rows[1], q, axis=0)
        room = np.full((2, len(index), len(self.rows)), np.inf)
        np.minimum.at(room, (np.arange(2)[:, None, None], np.arange(len(index))[:, None], index), facets)
        room[..., self.facets :] = np.repeat(np.hstack(thrust), q, axis=0)
        room[1, q - 1 :: q, self.facets :] = np.inf  # the input renewed there belongs to the next cell
        return np.asarray(room - self._scheduled)

    @cached_property
    def _scheduled(self) -> Array:
        """Part of the room taken by errors that depend on the time of the flight."""
        found = _ends(self.clearance.scheduled(self.rows))
        found[..., self.booked :] = 0.0  # they are booked apart
        return found

    @cached_property
    def taken(self) -> Array:
        """Part of the room already taken by these errors and the jump into the tail, shape (2, periods, r).

        A share of the room counts it as a need: of a smaller room, the same need would seem to leave more.
        """
        jump = self.clearance.jumped(self.rows[:, : self.clearance.tracking.system.n])
        return np.asarray(self._scheduled + np.repeat(jump, self.clearance.q, axis=0))

    @cached_property
    def most_taken(self) -> Array:
        """Largest part of the room of each row that is `taken`, shape (r,)."""
        return np.asarray(self.taken.max(axis=(0, 1)))

    @cached_property
    def ahead(self) -> Array:
        """Least room of every row from a node on, shape (periods + 1, r)."""
        least = np.vstack([self.room.min(axis=0), np.full(len(self.rows), np.inf)])
        return np.asarray(np.minimum.accumulate(least[::-1])[::-1])

    def name(self, cell: int, row: int) -> str:
        """Return the name of the unsafe set or of the input that a row limits in a cell."""
        clearance, system = self.clearance, self.clearance.tracking.system
        if row >= self.facets:
            return system.input_names[(row - self.facets) % system.m]
        mine = clearance.obstacle_rows[1][cell] == row
        return clearance.unsafe[int(np.where(mine, clearance.room[cell].min(axis=0), np.inf).argmin())].name


def _ends(places: Array) -> Array:
    """Values at both ends of every period, (2, periods, r), from those at nodes of cells, (cells, q+1, r)."""
    cells, nodes, r = places.shape
    return np.stack([part.reshape(cells * (nodes - 1), r) for part in (places[:, :-1], places[:, 1:])])
