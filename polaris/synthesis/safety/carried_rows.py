"""Rows of S's error carried back through its loop, and their tightening by a set of errors at each age."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from reach.sets.zonotope import Zonotope

from ...model.system import Array
from ...model.tolerances import ROUNDING
from ..tracker.tracking import Tracking

BLOCK = 768  # rows that are multiplied at once; more: products leave the cache


@dataclass(frozen=True, eq=False)
class CarriedRows:
    """Table ``row F^l`` of every row and age, with its tightening (docs/theory.md, Theorem 3).

    Entry l of a table belongs to node l after a loop state was handed over to S. Over the period between two
    nodes a tightening is at most the chord of their entries. Sets are those of the loop state, or of the
    tracking error ``x - xi`` where the rest may be any state that a law leaves (`Tracking.loop_state`).

    Parameters
    ----------
    tracking : Tracking
        S's loop.
    rows : ndarray, shape (r, n) or (r, N)
        Directions of the error, or of the loop state (`Tracking.disturbance`).
    faults : bool
        True if a fault that is isolated late may occur, where any is declared.
    between : bool
        False if tightenings are those at nodes alone.
    """

    tracking: Tracking
    rows: Array
    faults: bool = True
    between: bool = True

    @classmethod
    def from_tracking(
        cls, tracking: Tracking, rows: Array, faults: bool = True, between: bool = True
    ) -> "CarriedRows":
        """Return the table of some rows, made once for every tracker."""
        key = rows.shape[1], rows.tobytes(), faults, between
        table: CarriedRows = tracking.tables.get(key) or cls(tracking, rows, faults, between)
        tracking.tables[key] = table
        return table

    @property
    def plant(self) -> Array:
        """Part of the rows along the tracking error, shape (r, n)."""
        return self.rows[:, : self.tracking.system.n]

    @cached_property
    def carried(self) -> Array:
        """``row F^l``, shape (settling + 2, r, N)."""
        return np.asarray(self.tracking.pad(self.rows) @ self.tracking.loop_transitions)

    @cached_property
    def per_state(self) -> Array:
        """Tightening, and its intersample part, per unit of loop states beside the error, by age.

        Shape (2, settling + 3, r, N - n).
        """
        between = self.tracking.between_per_state(self.plant) * self.between
        return np.stack([self.tracking.per_state(self.rows) + between, between])

    @cached_property
    def beside_errors(self) -> Array:
        """Tightening by the states handed over beside a true error, after any law, (settling + 3, r)."""
        tracking = self.tracking
        size = float(np.linalg.norm(np.abs(tracking.W) @ tracking.state_offset))
        bound = np.abs(self.carried[..., : tracking.system.n]) @ tracking.state_offset + self.curvature * size
        return np.asarray(np.vstack([bound, self.beyond * size]) + self.per_state[0] @ tracking.remembered)

    @cached_property
    def disturbance(self) -> Array:
        """Tightening by all but the handed state, by age and ever after, shape (settling + 3, r)."""
        tracking = self.tracking
        if self.between:
            return tracking.disturbance(self.rows, self.faults)
        tightening = tracking.responses(self.rows, tracking.feedback_bound)
        return tightening + self._transient[np.minimum(np.arange(len(tightening)) + 2, len(tightening) - 1)]

    @cached_property
    def _transient(self) -> Array:
        """Tightening by a transient fault up to l periods after it begins, shape (settling + 3, r)."""
        return self.tracking.transient_tightening(self.rows) * self.faults

    @cached_property
    def curvature(self) -> Array:
        """Intersample bound per unit of ``norm(W e)``, shape (settling + 2, r)."""
        curvature = self.tracking.curvature(self.plant) * self.tracking.decay_before[:, None]
        return np.asarray(curvature * self.between)

    @cached_property
    def sizes(self) -> Array:
        """``norm(row phi^l W^-1)``: tightening at nodes per unit of ``norm(W e)``, (settling + 2, r)."""
        error_rows = self.carried[..., : self.tracking.system.n]
        return np.asarray(np.linalg.norm(error_rows @ self.tracking.W_inverse, axis=-1))

    @cached_property
    def beyond(self) -> Array:
        """Tightening beyond the settling horizon per unit of ``norm(W e)``, shape (r,)."""
        size = self.tracking.per_size(self.plant) if self.between else self.sizes[0]
        return np.asarray(size * self.tracking.decay[-1])

    @cached_property
    def settled_tightening(self) -> Array:
        """Tightening at nodes for ever once S has settled, a fault included, shape (r,)."""
        return np.asarray(self.tracking.settled_tightening(self.rows) + self._transient[-1])

    def long_after(self, start: Zonotope) -> Array:
        """Bound rows at nodes more than `Tracking.long` periods after a hand-over of a set, shape (r,)."""
        decay = 1.0 if self.tracking.feedback_bound is None else self.tracking.decay[-1]
        return np.asarray(self.beyond * self.sizes_of(start)[0] * decay + self.settled_tightening)

    def from_set(self, start: Zonotope, ages: NDArray[np.int_] | slice) -> Array:
        """Return the tightenings from a set at ages within the settling horizon, shape (ages, r)."""
        start, (radius, others) = self.tracking.loop_state(start), self.sizes_of(start)
        carried, between = self.carried[ages], self.per_state[1, :-1][ages] @ others
        spread = _spread(carried.reshape(-1, start.dim), start.G).reshape(carried.shape[:-1])
        support = _rounded(carried @ start.c, spread)
        return np.asarray(support + self.curvature[ages] * radius + between + self.disturbance[:-1][ages])

    def sizes_of(self, sets: Zonotope) -> tuple[Array, Array]:
        """Return bounds over sets on ``norm(W e)``, shape (...), and on other loop states, (..., N - n)."""
        whole, n = self.tracking.loop_state(sets), self.tracking.system.n
        others = np.abs(whole.c[..., n:]) + np.abs(whole.G[..., n:, :]).sum(axis=-1)
        return self.tracking.error(whole).norm_bound(self.tracking.W), others

    def tube(self, start: Zonotope) -> "SetTightening":
        """Return the tightenings from a set, for all time."""
        radius, others = self.sizes_of(start)
        beyond = self.beyond * radius + self.per_state[0, -1] @ others + self.disturbance[-1]
        tightening = np.vstack([self.from_set(start, slice(None)), beyond])
        return SetTightening(self, tightening + ROUNDING * np.abs(tightening))

    def supports(
        self, lag: NDArray[np.int_], row: NDArray[np.int_], sets: Zonotope, intersample: Array
    ) -> Array:
        """Return the support of a stack of sets along some entries of the table, shape (sets, entries).

        Elementwise, (sets, n), the intersample bound bounds the states between each node and its neighbours.
        """
        rows, n = self.carried[lag, row], self.tracking.system.n
        centre = sets.c @ rows.T
        support = _rounded(centre, np.stack([_spread(rows, G) for G in sets.G]))
        if np.any(intersample > 0):
            # More than is needed: only U's own claim between two nodes is left, at lag 0 (Proposition 11).
            before = self.carried[np.maximum(lag - 1, 0), row]
            support += np.maximum(intersample @ np.abs(rows[:, :n]).T, intersample @ np.abs(before[:, :n]).T)
        return support


def _spread(rows: Array, G: Array) -> Array:
    """Return ``sum |rows G|``, shape (rows,), block by block: large arrays anew would cost more than sums."""
    sums, block = np.empty(len(rows)), np.empty((min(BLOCK, len(rows)), G.shape[1]))
    for first in range(0, len(rows), BLOCK):
        chunk = rows[first : first + BLOCK]
        products = np.matmul(chunk, G, out=block[: len(chunk)])
        np.abs(products, out=products).sum(axis=1, out=sums[first : first + BLOCK])
    return sums


def _rounded(centre: Array, spread: Array) -> Array:
    """Sum of both, rounded up by the size of its terms, which may cancel."""
    return np.asarray(centre + spread + ROUNDING * (np.abs(centre) + spread))


@dataclass(frozen=True, eq=False)
class SetTightening:
    """Tightening of the rows of a table by S's error from one set, for all time."""

    table: CarriedRows
    tightening: Array  # by age, (settling + 3, r); the last entry holds for every later time

    def at_ages(self, ages: NDArray[np.int_]) -> Array:
        """Return the tightening at ages [periods] of any shape, shape (..., r)."""
        return np.asarray(self.tightening[np.clip(ages, 0, len(self.tightening) - 1)])

    def over_cells(self, cells: int, q: int, node: int = 0) -> Array:
        """Return the largest tightening in each planning cell by a set handed over at a node, (cells, r)."""
        ages = np.arange(q + 1) - node
        return np.asarray(self.at_ages(np.arange(cells)[:, None] * q + ages).max(axis=1))

    def remainder(self, radius: float) -> Array:
        """Return the tightening by an error of a given norm beyond the settling horizon, shape (r,)."""
        table = self.table
        return np.asarray(table.beyond * radius + table.beside_errors[-1] + table.disturbance[-1])


def error_tube(tracking: Tracking, start: Zonotope, rows: Array, faults: bool = True) -> SetTightening:
    """Return a tight bound on ``row e(t)`` under S from a set at time 0 (see `CarriedRows`)."""
    return CarriedRows.from_tracking(tracking, rows, faults).tube(start)
