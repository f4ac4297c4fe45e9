"""Continuation: from these error sets, a law along a path keeps every limit until the horizon.

Recoverable sets, the goal, drifts and aborts are continuations; they differ in law, path, limits and horizon.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from reach.sets.zonotope import Zonotope

from ...model.tolerances import ROUNDING
from ..tracker.intersample import at_nodes
from ..tracker.loop import Array
from .recoverable import Margin, left
from .row_table import RowTable

COARSE = (0.5, 0.05)
"""Shares of a slack up to which a bound by the norm stands for what a set needs, tried in this order."""


@dataclass(frozen=True, eq=False)
class Limits:
    """Limits along a path: one row and one slack per limit at every node of every cell.

    Attributes
    ----------
    index : ndarray of int, shape (cells, L)
        Row of the table that each limit bounds in each cell.
    slack : ndarray, shape (cells, q + 1, L)
        What a row may reach; infinite where a limit is not imposed.
    taken : ndarray, shape (cells, q + 1, L)
        Part of the clearance that is not left to errors after a hand-over: margins count it as a need.
    names : tuple of str
    assumed : ndarray of bool, shape (L,)
        Limits that bound what errors are tightened for: kept or not, never the tightest.
    """

    index: NDArray[np.int_]
    slack: Array
    taken: Array
    names: tuple[str, ...]
    assumed: NDArray[np.bool_]

    @property
    def cells(self) -> int:
        """Number of cells."""
        return len(self.slack)

    @property
    def q(self) -> int:
        """Nodes per cell."""
        return int(self.slack.shape[1]) - 1


@dataclass(frozen=True, eq=False)
class Continuation:
    """A law along a path, and the limits that it must keep.

    Parameters
    ----------
    table : RowTable
    limits : Limits
    h : float
        Period [s].
    repeats : int
        Cell from which on the path repeats for ever: limits beyond the settling horizon are those of all
        cells from there on. `limits.cells` if it ends.
    falls : ndarray, shape (N + 3, R), optional
        By how much slacks are less at later lags than at the hand-over.
    """

    table: RowTable
    limits: Limits
    h: float
    repeats: int
    falls: Array | None = None

    @cached_property
    def _fixed(self) -> Array:
        return self.table.fixed if self.falls is None else self.table.fixed + self.falls

    @cached_property
    def _least(self) -> Array:
        """Least slack of every row at every node, of the cells on both sides, shape (nodes + 1, R)."""
        cells, q, rows = self.limits.cells, self.limits.q, len(self.table.rows)
        least = np.full((cells * q + 1, rows), np.inf)
        for at in range(q + 1):
            node = np.arange(cells) * q + at
            for limit in range(self.limits.slack.shape[2]):
                np.minimum.at(least, (node, self.limits.index[:, limit]), self.limits.slack[:, at, limit])
        return least

    @cached_property
    def _ahead(self) -> Array:
        """Least slack of every row from a node on, shape (nodes + 1, R)."""
        return np.asarray(np.minimum.accumulate(self._least[::-1])[::-1])

    def _beyond(self, node: int) -> int:
        """Return the first node whose limits lie beyond the settling horizon, seen from a node."""
        last = self.limits.cells * self.limits.q
        return int(min(node + self.table.tightening.horizon, self.repeats * self.limits.q, last))

    def allowed(self, node: int) -> float:
        """Return the largest norm at a node that keeps the limits beyond the settling horizon."""
        slack = self._ahead[self._beyond(node)] - self._fixed[-1]
        with np.errstate(divide="ignore", invalid="ignore"):
            sizes = np.where(np.isposinf(slack), np.inf, slack / self.table.beyond)
        return float(np.where(np.isnan(sizes), -np.inf, sizes).min(initial=np.inf))

    def margin(self, first: int, errors: Zonotope, between: Array | None = None) -> Margin:
        """Return the margin of sets of loop states at consecutive nodes, each of which may be handed over.

        Parameters
        ----------
        first : int
            Node of the first set.
        errors : Zonotope
            Stack of sets, shape (count, N).
        between : ndarray, shape (count - 1, n), optional
            Intersample bound of the flight that reaches them: it adds to the limits at its own nodes.
        """
        bow = np.zeros((len(errors), self.table.plant.shape[1])) if between is None else at_nodes(between)
        size = float(np.max(self.table.size(errors)))
        far = self._far_margin(first, size)
        near = far
        for share in COARSE:
            near = self._near_margin(first, errors, bow, size, share)
            if near.value < 1 - share or far.value < near.value:
                break
        return min(near, far, key=lambda margin: margin.value)

    def holds(self, first: int, errors: Zonotope, between: Array | None = None) -> bool:
        """Return True if the margin is not negative; cheaper than `margin`."""
        bow = np.zeros((len(errors), self.table.plant.shape[1])) if between is None else at_nodes(between)
        size = float(np.max(self.table.size(errors)))
        inside = size <= self.allowed(first)
        return inside and self._near_margin(first, errors, bow, size, 1.0).inside

    def _far_margin(self, node: int, size: float) -> Margin:
        """Return the margin of the limits beyond the settling horizon for loop states up to a norm."""
        start, limits = self._beyond(node), self.limits
        most = np.zeros(len(self.table.rows))
        np.maximum.at(most, limits.index.ravel(), limits.taken.max(axis=1).ravel())
        slack = self._ahead[start] + most
        need = (self._fixed[-1] + self.table.beyond * size) * (1 + ROUNDING) + most
        share = left(need, slack)
        assumed = np.zeros(len(share), dtype=bool)
        assumed[limits.index[0, limits.assumed]] = True
        share = np.where(assumed & (share >= 0), np.inf, share)
        row = int(np.argmin(share))
        if not np.isfinite(slack[row]):
            return Margin(np.inf, "", np.inf, 0.0, np.inf)
        cells = np.arange(min(start // limits.q, limits.cells - 1), limits.cells)
        at = np.where(limits.index[cells] == row, limits.slack[cells].min(axis=1), np.inf)
        cell, limit = np.unravel_index(int(np.argmin(at)), at.shape)
        time = float(cells[cell] * limits.q * self.h)
        return Margin(float(share[row]), limits.names[limit], time, float(need[row]), float(slack[row]))

    def _near_margin(self, first: int, errors: Zonotope, bow: Array, size: float, share: float) -> Margin:
        """Return the margin of the limits within the settling horizon.

        Rows that the norm shows to need no more than a `share` of the least slack ahead keep that bound.
        """
        limits, lags = self.limits, len(self.table.carried)
        need = self._need(first, errors, bow, size, share)
        target = first + np.arange(len(errors))[:, None] + np.arange(lags)
        worst = Margin(np.inf, "", np.inf, 0.0, np.inf)
        for side in (0, 1):  # a node at the end of a cell is also one of the cell to its left
            cell = target // limits.q - side
            counts = (cell < limits.cells) & (
                (side == 0) | ((target % limits.q == 0) & (target > first) & (cell >= 0))
            )
            i, lag = np.nonzero(counts)
            at = cell[i, lag]
            place = target[i, lag] - at * limits.q
            taken = limits.taken[at, place]
            slack = limits.slack[at, place] + taken
            needed = np.take_along_axis(need[i, lag], limits.index[at], axis=1) + taken
            shares = left(needed, slack)
            shares[:, limits.assumed] = np.where(
                shares[:, limits.assumed] >= 0, np.inf, shares[:, limits.assumed]
            )
            if shares.size and shares.min() < worst.value:
                j, limit = np.unravel_index(int(np.argmin(shares)), shares.shape)
                time = float(target[i[j], lag[j]] * self.h)
                found = float(needed[j, limit]), float(slack[j, limit])
                worst = Margin(float(shares[j, limit]), limits.names[limit], time, *found)
        return worst

    def _need(self, first: int, errors: Zonotope, bow: Array, size: float, share: float) -> Array:
        """Return what each set needs of every row at every lag, shape (count, N + 2, R)."""
        table = self.table
        rest = self._fixed[: len(table.carried)] + table.per_size * size
        coarse = np.abs(table.carried) @ table.tightening.v * (size * (1 + ROUNDING)) + rest
        floor = self._ahead[min(first, len(self._ahead) - 1)]
        keep = coarse > share * np.maximum(floor, 0)
        need = np.repeat(coarse[None], len(errors), axis=0)
        exact = table.carried[keep]
        centre = exact @ errors.c.T
        spread = np.stack([np.abs(exact @ G).sum(axis=-1) for G in errors.G], axis=1)
        support = centre + spread + ROUNDING * (np.abs(centre) + spread)
        need[:, keep] = np.minimum(need[:, keep], support.T + rest[keep])
        count = len(table.plant)
        need[:, 0, :count] += bow @ np.abs(table.plant).T
        return np.asarray(need * (1 + ROUNDING * np.sign(need)))

    def contains(self, node: int, errors: Array) -> NDArray[np.bool_]:
        """Return True for each loop state (runs, N) at a node from which every limit is kept."""
        errors = np.atleast_2d(errors)
        points = Zonotope(errors, np.zeros((*errors.shape, 0)))
        return np.array(
            [self.holds(node, Zonotope(c[None], G[None])) for c, G in zip(points.c, points.G, strict=True)]
        )
