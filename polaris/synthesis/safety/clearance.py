"""Clearance of the safe reference, and the limits that S must keep along it."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from reach.sets.zonotope import Zonotope
from reach.short_repr import short_repr

from ...model.scene.timed_polytope import TimedPolytope
from ...model.system import Array
from ...model.tolerances import ROUNDING
from ...planning.reference import Reference
from ..tracker.intersample import at_nodes
from ..tracker.tracking import Tracking
from .carried_rows import error_tube
from .feedforward import Feedforward, command_noise


@short_repr
@dataclass(frozen=True, eq=False)
class Clearance:
    """Clearance of the reference: per cell one separating facet for every unsafe set, and thrust.

    Parameters
    ----------
    tracking : Tracking
        S, and the bounds on its error.
    reference : Reference
        The safe reference, coasting tail included.
    unsafe : tuple of TimedPolytope
        One per unsafe set (one per facet of a keep-in set).
    facets : ndarray of int, shape (cells, o)
        The facet that separates in each cell.
    planned : int
        Number K of cells before the tail.
    jump : ndarray, shape (n,)
        Elementwise bound on the step of the reference at the start of the tail (solver residual).
    """

    tracking: Tracking
    reference: Reference
    unsafe: tuple[TimedPolytope, ...]
    facets: NDArray[np.int_]
    planned: int
    jump: Array

    @property
    def q(self) -> int:
        """Nodes per cell."""
        return self.tracking.feedback.nodes_per_cell

    @property
    def cells(self) -> int:
        """All cells, tail included."""
        return self.reference.cells

    @cached_property
    def nodes(self) -> Array:
        """Reference states at the nodes of every cell, shape (cells, q+1, n)."""
        return self.reference.fine(self.q)

    @cached_property
    def obstacle_rows(self) -> tuple[Array, NDArray[np.int_]]:
        """Distinct rows ``-n C`` (a state error e is safe if ``row e <= distance``), and their index.

        Returns
        -------
        rows : ndarray, shape (r, n)
        index : ndarray of int, shape (cells, o)
        """
        system = self.tracking.system
        normals = [u.rows(system)[self.facets[:, o]] for o, u in enumerate(self.unsafe)]
        flat = np.concatenate(normals) if normals else np.zeros((0, system.n))
        distinct, index = np.unique(flat, axis=0, return_inverse=True)
        index = np.asarray(index).reshape(len(self.unsafe), self.cells).T
        return -distinct, index

    @cached_property
    def distances(self) -> Array:
        """Distance from the reference to its facet at every node [m], shape (cells, q+1, o).

        Reduced by the intersample bound of the reference between the nodes, by the jump into the tail, and by
        rounding: a lower bound that holds over the whole of both adjacent parts of the cell.
        """
        distances, (rows, index) = [np.zeros((self.cells, self.q + 1, 0))], self.obstacle_rows
        for o, unsafe in enumerate(self.unsafe):
            to_facets = facet_clearance(self.tracking, self.reference, unsafe)
            distances.append(np.take_along_axis(to_facets, self.facets[:, None, o : o + 1], axis=2))
        jump = np.take_along_axis(self.jumped(rows), index, axis=1)
        return np.asarray(np.concatenate(distances, axis=2) - jump[:, None, :])

    @cached_property
    def _scheduled(self) -> Feedforward:
        return Feedforward(self.tracking, self.reference, self.planned)

    def scheduled(self, rows: Array, between: bool = True) -> Array:
        """Return the feedforward tightening of rows, shape (cells, q + 1, r) (`Feedforward`)."""
        return self._scheduled.response(rows, between)

    @cached_property
    def limits(self) -> "Limits":
        """Facets and thrust, period by period."""
        return Limits(self)

    @cached_property
    def thrust(self) -> tuple[Array, Array]:
        """Input left above and below the reference input per cell [N], each of shape (cells, m)."""
        noise = command_noise(self.tracking, self.cells, self.planned)
        limit = self.tracking.system.u_max * (1 - ROUNDING) - noise
        cost = self.jumped(self.tracking.gain)
        return limit - self.reference.nu - cost, limit + self.reference.nu - cost

    def jumped(self, rows: Array) -> Array:
        """Return the tightening of rows (r, n) for the jump into the tail in every cell, shape (cells, r)."""
        return np.where(np.arange(self.cells)[:, None] >= self.planned, self.jump_tightening(rows), 0.0)

    def after_jump(self, sets: Zonotope) -> Zonotope:
        """Return sets of errors or loop states with the jump into the tail."""
        return sets.inflate(np.pad(self.jump, (0, sets.dim - len(self.jump))))

    def jump_tightening(self, rows: Array) -> Array:
        """Return the tightening of rows (r, n) for the jump into the tail, at any later time, shape (r,)."""
        tracking = self.tracking
        return np.asarray(tracking.per_size(rows) * np.linalg.norm(np.abs(tracking.W) @ self.jump))

    def round_off(self, rows: Array) -> Array:
        """Return the tightening of rows for the round-off of the reference, new at every step, shape (r,)."""
        tracking, step = self.tracking, self.reference.rounding.max(axis=0)
        size = np.linalg.norm(np.abs(tracking.W) @ (tracking.accumulated * step))
        return np.asarray(tracking.per_size(rows) * size)


@dataclass(frozen=True, eq=False)
class Limits:
    """Rows r of the loop state z with ``r z <= available``: facets, then commands of either sign.

    Commands are limited by the thrusters, and once more by the level that thruster errors assume, if that
    is less. Arrays of shape (2, periods, r) hold where every period begins, and where it ends.
    """

    clearance: Clearance

    @cached_property
    def rows(self) -> Array:
        """All rows, shape (r, N)."""
        tracking = self.clearance.tracking
        copies = 1 if tracking.feedback_bound is None else 2
        return np.vstack([tracking.pad(self.clearance.obstacle_rows[0]), *[tracking.commands] * copies])

    @property
    def facets(self) -> int:
        """Number of rows that are facets."""
        return len(self.clearance.obstacle_rows[0])

    @property
    def levels(self) -> int:
        """First of the rows that limit commands to the level of bounded errors; they count if exceeded."""
        return self.facets + 2 * self.clearance.tracking.system.m

    @cached_property
    def available(self) -> Array:
        """Clearance of every row, infinite where it limits nothing, shape (2, periods, r).

        ``u = mu - Lambda e``: the row ``+Lambda_i`` is limited by the thrust below, ``-Lambda_i`` above.
        """
        clearance, tracking, q = self.clearance, self.clearance.tracking, self.clearance.q
        above, below = clearance.thrust
        thrust = [below, above]
        if tracking.feedback_bound is not None:
            level = tracking.feedback_bound[0] * (1 - ROUNDING) - tracking.noise
            thrust += [level - clearance.jumped(tracking.gain)] * 2
        facets, index = by_ends(clearance.distances), np.repeat(clearance.obstacle_rows[1], q, axis=0)
        available = np.full((2, len(index), len(self.rows)), np.inf)
        np.minimum.at(available, (np.arange(2)[:, None, None], np.arange(len(index))[:, None], index), facets)
        available[..., self.facets :] = np.repeat(np.hstack(thrust), q, axis=0)
        available[1, q - 1 :: q, self.facets :] = np.inf  # the input renewed there belongs to the next cell
        return np.asarray(available - self._scheduled)

    @cached_property
    def _scheduled(self) -> Array:
        """Part of the clearance taken by errors that depend on the time of the flight."""
        tightening = by_ends(self.clearance.scheduled(self.rows))
        tightening[..., self.levels :] = 0.0  # their tightening is separate
        return tightening

    @cached_property
    def tightening(self) -> Array:
        """Part of the clearance taken by these errors and the jump into the tail, shape (2, periods, r).

        A share of the clearance counts it as tightening: of a smaller clearance, the same tightening would
        seem to leave more.
        """
        jump = self.clearance.jumped(self.rows[:, : self.clearance.tracking.system.n])
        return np.asarray(self._scheduled + np.repeat(jump, self.clearance.q, axis=0))

    @cached_property
    def max_tightening(self) -> Array:
        """Largest part of the clearance of each row that is `tightening`, shape (r,)."""
        return np.asarray(self.tightening.max(axis=(0, 1)))

    @cached_property
    def least_later(self) -> Array:
        """Least clearance of every row from a node on, shape (periods + 1, r)."""
        least = np.vstack([self.available.min(axis=0), np.full(len(self.rows), np.inf)])
        return np.asarray(np.minimum.accumulate(least[::-1])[::-1])

    def name(self, cell: int, row: int) -> str:
        """Return the name of the unsafe set or of the input that a row limits in a cell."""
        clearance, system = self.clearance, self.clearance.tracking.system
        if row >= self.facets:
            return system.input_names[(row - self.facets) % system.m]
        matches = clearance.obstacle_rows[1][cell] == row
        return clearance.unsafe[
            int(np.where(matches, clearance.distances[cell].min(axis=0), np.inf).argmin())
        ].name


def by_ends(values: Array) -> Array:
    """Values at both ends of every period, (2, periods, r), from those at nodes of cells, (cells, q+1, r)."""
    cells, nodes, r = values.shape
    return np.stack([part.reshape(cells * (nodes - 1), r) for part in (values[:, :-1], values[:, 1:])])


def facet_clearance(tracking: Tracking, reference: Reference, unsafe: TimedPolytope) -> Array:
    """Distance from the reference to every facet of one set at every node, shape (cells, q+1, F).

    Already reduced by the reference's intersample bound (docs/theory.md, Lemma 3) and by rounding.
    """
    system, q = tracking.system, tracking.feedback.nodes_per_cell
    nodes, offsets = reference.fine(q), unsafe.fine(q)[: reference.cells]
    rows = unsafe.rows(system)
    intersample = at_nodes(
        (reference.delta / q) ** 2 / 8 * reference.rates(nodes) @ np.abs(rows @ system.A).T
    )
    size = np.abs(nodes) @ np.abs(rows).T + np.abs(offsets)
    distance = nodes @ rows.T - offsets
    return np.asarray(distance - intersample - ROUNDING * size)


def best_facets(
    tracking: Tracking, reference: Reference, unsafe: tuple[TimedPolytope, ...], start: Zonotope
) -> NDArray[np.int_]:
    """Return for every cell and set the facet of most clearance beyond S's tube, shape (cells, o)."""
    chosen, q = np.zeros((reference.cells, len(unsafe)), dtype=int), tracking.feedback.nodes_per_cell
    for o, polytope in enumerate(unsafe):
        tube = error_tube(tracking, start, -polytope.rows(tracking.system))
        clearance = facet_clearance(tracking, reference, polytope).min(axis=1)
        chosen[:, o] = np.argmax(clearance - tube.over_cells(reference.cells, q), axis=1)
    return chosen
