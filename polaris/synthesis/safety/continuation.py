"""Continuation of a flight by S: from which errors it keeps every limit to the end, and by which margin."""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from reach.sets.zonotope import Zonotope

from ...model.system import Array
from ...model.tolerances import ROUNDING
from ..tracker.intersample import at_nodes
from .carried_rows import CarriedRows
from .recoverable import Margin, RecoverableSet, left

COARSE = (0.5, 0.05, float(np.finfo(float).tiny))
"""Shares of the room, tried in this order: entries that a bound by the norm shows to need no more wait."""


@dataclass(frozen=True, eq=False)
class Continuation(RecoverableSet):
    """All facets and thrust limits, carried back exactly through the closed loop (the default).

    ``C^t = {e : row_j Phi(t_j - t) e + disturbance <= room_j for every later t_j}``: exact for the
    chosen facets up to what is booked between nodes. Limits further away than the memory of the
    loop are collected in one ball, which they can hardly touch (docs/theory.md, Proposition 6).
    """

    kind: ClassVar[str] = "polytope"

    @cached_property
    def table(self) -> CarriedRows:
        """Rows of the limits, carried back."""
        return CarriedRows(self.clearance.tracking, self.limits.rows)

    @cached_property
    def disturbance(self) -> Array:
        """Need besides the error, round-off of the reference included, by age, shape (memory + 3, r)."""
        tracking, table = self.clearance.tracking, self.table
        need = table.disturbance + self.clearance.round_off(table.plant)
        if tracking.profile is not None:  # a bound that falls is the first one, of which more is taken
            falls = tracking.profile[0] - np.vstack([tracking.profile, tracking.profile[-1:]])
            need[:, self.limits.booked :] += np.hstack([falls, falls])
        return need

    @cached_property
    def _per_size(self) -> Array:
        """Bound on the need per unit of ``norm(W e)``, by lag, shape (memory + 2, r)."""
        sizes = self.table.sizes * (1 + ROUNDING)
        return np.asarray(np.maximum(sizes, np.concatenate([sizes[:1], sizes[:-1]])) + self.table.bend)

    # -- limits beyond the memory of the loop -----------------------------------------------------------

    @cached_property
    def _beyond(self) -> NDArray[np.int_]:
        """Node from which on limits lie beyond the memory, seen from every node, shape (nodes + 1,)."""
        # After the tail the reference repeats it: whatever the node, the whole tail lies ahead again.
        tail = self.clearance.planned * self.clearance.q
        return np.minimum(np.arange(len(self.limits.ahead)) + self.clearance.tracking.memory, tail)

    @cached_property
    def far(self) -> Array:
        """Largest ``norm(W e)`` at every node that all limits beyond the memory allow, shape (nodes + 1,)."""
        spare = self.limits.ahead[self._beyond] - self.disturbance[-1]
        allowed = np.where(np.isposinf(spare), np.inf, spare / self.table.beyond).min(axis=1, initial=np.inf)
        return np.asarray(np.where(np.isnan(allowed), -np.inf, allowed))

    def _far_margin(self, node: int, radius: float) -> Margin:
        """Tightest limit beyond the memory for errors up to a norm at a node."""
        limits, start = self.limits, int(self._beyond[min(node, len(self._beyond) - 1)])
        room = limits.ahead[start] + limits.most_taken
        need = (self.disturbance[-1] + self.table.beyond * radius) * (1 + ROUNDING) + limits.most_taken
        share = self._counted(left(need, room), room, np.arange(len(room)))
        row = int(np.argmin(share))
        if not np.isfinite(room[row]):
            return NOTHING
        period = start + int(np.argmin(limits.periods[start:, row]))
        time = period // self.clearance.q * self.clearance.tracking.delta
        return Margin(float(share[row]), limits.name(period, row), time, float(need[row]), float(room[row]))

    def _counted(self, share: Array, room: Array, row: NDArray[np.int_]) -> Array:
        """Shares of room left, infinite where nothing is limited, and where errors are booked for enough."""
        share[np.isinf(room) | ((row >= self.limits.booked) & (share >= 0))] = np.inf
        return share

    # -- limits within the memory -----------------------------------------------------------------------

    def _shares(
        self, at: NDArray[np.int_], sets: Zonotope, bow: Array, radius: Array, spare: float
    ) -> tuple[Array, Array, Array, NDArray[np.int_], NDArray[np.int_]]:
        """Shares of the room left of all limits within the memory that may need more than a share of it.

        Parameters
        ----------
        at : ndarray of int, shape (sets,)
            Node of each set, the first one least.
        sets : Zonotope
            Stack of sets of errors.
        bow : ndarray, shape (sets, n)
        radius : ndarray, shape (sets,)
            Bound on ``norm(W e)``.
        spare : float
            Limits that surely need no more than this share of their room are left out.

        Returns
        -------
        share, need, room : ndarray, shape (2, sets, entries)
            At both ends of periods.
        period : ndarray of int, shape (2, sets, entries)
        row : ndarray of int, shape (entries,)
        """
        limits, table, last = self.limits, self.table, len(self.limits.ahead) - 1
        least = spare * limits.ahead[at[0]] - (1 - spare) * limits.most_taken
        lag, row = np.nonzero(self._per_size * radius.max(initial=0.0) + self.disturbance[:-1] > least)
        size, bend, pushed = (part[lag, row] for part in (self._per_size, table.bend, self.disturbance))
        exact = table.supports(lag, row, sets, bow) + np.multiply.outer(radius, bend)
        need = np.minimum(exact, np.multiply.outer(radius, size)) + pushed
        need = need * (1 + ROUNDING * np.sign(need))
        node, end = at[:, None] + lag, np.arange(2)[:, None, None]
        behind = (node > last) | ((end == 1) & (node == at[0]))
        where = end, np.minimum(node, last), row
        need, room = need + limits.taken[where], limits.room[where] + limits.taken[where]
        room[behind] = np.inf
        return self._counted(left(need, room), room, row), need, room, node - end, row

    def _near_margin(self, first: int, sets: Zonotope, bow: Array, radius: float, spare: float) -> Margin:
        """Tightest limit within the memory over a stack of nodes that starts at one of the grid."""
        at = first + np.arange(len(sets))
        share, need, room, period, row = self._shares(at, sets, bow, np.full(len(at), radius), spare)
        if not np.isfinite(share).any():
            return NOTHING
        tightest = end, _, entry = np.unravel_index(int(np.argmin(share)), share.shape)
        name, time = self.limits.name(int(period[tightest]), int(row[entry])), float(period[tightest] + end)
        found = (float(part[tightest]) for part in (share, need, room))
        return Margin(next(found), name, time * self.clearance.tracking.flow.h, *found)

    # -- recoverable sets -------------------------------------------------------------------------------

    def _radius(self, sets: Zonotope, bow: Array) -> float:
        """Bound on ``norm(W e)`` over a tube: states between two nodes are as large as the larger node's."""
        W = self.clearance.tracking.W
        return float(np.max(sets.norm_bound(W) + np.linalg.norm(bow @ np.abs(W).T, axis=-1)))

    def tightest(self, first: int, sets: Zonotope, bow: Array) -> Margin:
        """Margin of errors at nodes that follow one another from `first` on (`RecoverableSet.tightest`)."""
        radius = self._radius(sets, bow)
        far = self._far_margin(first, radius)
        for spare in COARSE:
            near = self._near_margin(first, sets, bow, radius, spare)
            found = min(near, far, key=lambda margin: margin.value)
            if found.value < 1 - spare:
                break  # nothing that was left out can be tighter
        return found

    def holds(self, k: int, nodes: Zonotope, bow: Array) -> bool:
        """Return True if a tube over cell k is inside: only what the norm cannot tell is worked out."""
        first, bow = k * self.clearance.q, at_nodes(bow)
        radius = self._radius(nodes, bow)
        inside = self._far_margin(first, radius).inside
        return inside and self._near_margin(first, nodes, bow, radius, 1.0).inside

    def contains(self, node: int, errors: Array) -> NDArray[np.bool_]:
        """Return True for each error (runs, n) at a node that is recoverable."""
        errors = np.atleast_2d(errors)
        radius = np.linalg.norm(errors @ self.clearance.tracking.W.T, axis=-1)
        found = np.asarray(radius <= self.far[min(node, len(self.far) - 1)])
        points = Zonotope(errors[found], np.zeros((int(found.sum()), errors.shape[1], 0)))
        at = np.full(len(points.c), node)
        if len(at):
            share = self._shares(at, points, 0 * points.c, radius[found], 1.0)[0]
            found[found] = np.all(share >= 0, axis=(0, 2))
        return found

    def radius(self, node: int) -> float:
        """Return the radius of the largest ball ``norm(W e) <= r`` inside the set at a node."""
        table = self.table
        window = self.limits.window(node, len(table.carried))
        spare = window - self.disturbance[: len(window)]
        near = np.min(spare / (table.sizes + table.bend)[: len(window)], initial=np.inf)
        return float(max(min(near, self.far[min(node, len(self.far) - 1)]), 0.0))


NOTHING = Margin(np.inf, "", np.inf, 0.0, np.inf)
"""Margin where there is no limit."""
