"""Where the safe reference is, and how much room it has: what every recoverable set is made from."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from reach.brief import brief
from reach.sets.zonotope import Zonotope

from ...model.scene.timed_polytope import TimedPolytope
from ...model.system import Array
from ...model.tolerances import ROUNDING
from ...planning.reference import Reference
from ..tracker.intersample import at_nodes
from ..tracker.tracking import Tracking
from .demand import Scheduled, command_noise


@dataclass(frozen=True, eq=False)
class Tube:
    """What S's error from one set needs along fixed rows, period by period (theory item 3).

    Attributes
    ----------
    rows : ndarray, shape (r, n) or (r, N)
    need : ndarray, shape (memory + 3, r)
        Entry l belongs to node l after the start. Over the period between two nodes ``row e(t)`` is
        at most the chord of their entries; the last entry holds for every later time.
    """

    rows: Array
    need: Array

    def over_cells(self, cells: int, q: int) -> Array:
        """Largest need within every planning cell, shape (cells, r)."""
        last = len(self.need) - 1
        lags = np.minimum(np.arange(cells * q + 1), last)
        per_node = self.need[lags]
        inside = per_node[:-1].reshape(cells, q, -1).max(axis=1)
        return np.asarray(np.maximum(inside, per_node[q::q]))

    def left_over(self, tracking: Tracking, radius: float) -> Array:
        """What an error of a given norm still needs beyond the memory of the loop, shape (r,)."""
        plant = self.rows[:, : tracking.system.n]
        return np.asarray(tracking.forgotten(plant, radius) + tracking.disturbance(self.rows)[-1])


@dataclass(frozen=True, eq=False)
class TubeRows:
    """Fixed rows of S's error, for tubes from any set of errors.

    Parameters
    ----------
    tracking : Tracking
    whole : ndarray, shape (r, n) or (r, N)
        Rows of the error, or of the loop state (`Tracking.disturbance`).
    failing : bool
        Whether a fault that is isolated late may occur, where any is declared.
    """

    tracking: Tracking
    whole: Array
    failing: bool = True

    @cached_property
    def _disturbance(self) -> Array:
        return self.tracking.disturbance(self.whole, self.failing)

    @cached_property
    def _carried(self) -> Array:
        return np.asarray(self._rows @ self.tracking.transitions)

    @property
    def _rows(self) -> Array:
        return self.whole[:, : self.tracking.system.n]

    @cached_property
    def _curvature(self) -> Array:
        return self.tracking.curvature(self._rows)

    def at(self, start: Zonotope, lags: NDArray[np.int_] | slice) -> Array:
        """Return what rows need of errors at some nodes after the start, within the memory, (lags, r)."""
        tracking, carried = self.tracking, self._carried[lags]
        centre = carried @ start.c
        spread = np.abs(carried.reshape(-1, start.dim) @ start.G).sum(axis=-1).reshape(centre.shape)
        support = centre + spread + ROUNDING * (np.abs(centre) + spread)
        booked = self._curvature * tracking.decay_before[lags, None] * float(start.norm_bound(tracking.W))
        return np.asarray(support + booked + self._disturbance[: len(self._carried)][lags])

    def tube(self, start: Zonotope) -> Tube:
        """Return the tight bound on ``row e(t)`` under S from a set of errors ``x - xi`` at time 0."""
        radius = float(start.norm_bound(self.tracking.W))
        beyond = self.tracking.forgotten(self._rows, radius) + self._disturbance[-1]
        need = np.vstack([self.at(start, slice(None)), beyond])
        return Tube(self.whole, need + ROUNDING * np.abs(need))


def error_tube(tracking: Tracking, start: Zonotope, rows: Array, failing: bool = True) -> Tube:
    """Tight bound on ``row e(t)`` under S from a set of errors, for all time, between nodes too.

    See `TubeRows` for the rows, (r, n) or (r, N), and for `failing`.
    """
    return TubeRows(tracking, rows, failing).tube(start)


@brief
@dataclass(frozen=True, eq=False)
class Clearance:
    """Room around the reference: per cell one separating facet for every unsafe set, and thrust.

    Parameters
    ----------
    tracking : Tracking
        S, and what is known of its error.
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
        """Distinct rows ``-n C`` (a state error e is safe if ``row e <= room``), and their index.

        Returns
        -------
        rows : ndarray, shape (r, n)
        index : ndarray of int, shape (cells, o)
        """
        normals = [u.normals[self.facets[:, o]] for o, u in enumerate(self.unsafe)]
        d = self.tracking.system.d
        flat = np.concatenate(normals) if normals else np.zeros((0, d))
        distinct, index = np.unique(flat, axis=0, return_inverse=True)
        index = np.asarray(index).reshape(len(self.unsafe), self.cells).T
        return -distinct @ self.tracking.system.position, index

    @cached_property
    def room(self) -> Array:
        """Distance from the reference to its facet at every node [m], shape (cells, q+1, o).

        Reduced by the bow of the reference between the nodes, by the jump into the tail, and by
        rounding: a lower bound that holds over the whole of both adjacent parts of the cell.
        """
        if not self.unsafe:
            return np.zeros((self.cells, self.q + 1, 0))
        parts = [facet_room(self.tracking, self.reference, u, self.q, self.nodes) for u in self.unsafe]
        chosen = [
            np.take_along_axis(part, self.facets[:, None, o : o + 1], axis=2)[..., 0]
            for o, part in enumerate(parts)
        ]
        return np.asarray(np.stack(chosen, axis=-1) - self.jumps[0][:, None, :])

    @cached_property
    def _scheduled(self) -> Scheduled | None:
        if not self.tracking.varies:
            return None
        return Scheduled(self.tracking, self.reference, self.planned)

    def scheduled(self, rows: Array) -> Array:
        """Return what errors add along rows by the time of the flight, (cells, q + 1, r) (`Scheduled`)."""
        if self._scheduled is None:
            return np.zeros((self.cells, self.q + 1, len(rows)))
        return self._scheduled.along(rows)

    @cached_property
    def thrust(self) -> tuple[Array, Array]:
        """Input left above and below the reference input per cell [N], each of shape (cells, m)."""
        noise = command_noise(self.tracking, self.cells, self.planned)
        limit = self.tracking.system.u_max * (1 - ROUNDING) - noise
        cost = self.jumps[1]
        return limit - self.reference.nu - cost, limit + self.reference.nu - cost

    @cached_property
    def jumps(self) -> tuple[Array, Array]:
        """What the jump into the tail takes of `room` [m] and `thrust` [N], shapes (cells, o), (cells, m).

        A share of the room counts it as a need: of a smaller room, the same need would seem to leave more.
        """
        rows, index = self.obstacle_rows
        facets, inputs = np.zeros(index.shape), np.zeros((self.cells, self.tracking.system.m))
        facets[self.planned :] = self.jump_need(rows)[index[self.planned :]]
        inputs[self.planned :] = self.jump_need(self.tracking.gain)
        return facets, inputs

    def jump_need(self, rows: Array) -> Array:
        """What the jump into the tail needs along rows (r, n) at any time after it, shape (r,)."""
        return self._need_of(rows, self.jump)

    def round_off(self, rows: Array) -> Array:
        """What the round-off of the reference's states, new at every step, needs along rows, shape (r,)."""
        return self._need_of(rows, self.tracking.accumulated * self.reference.rounding.max(axis=0))

    def tail_need(self, rows: Array) -> Array:
        """What S needs along rows (r, n) from a node of the tail on, errors at T apart, shape (nodes, r)."""
        found = self.scheduled(rows)[min(self.planned, self.cells - 1) :]
        nodes = np.concatenate([found[:, :-1].reshape(len(found) * self.q, len(rows)), found[-1, -1:]])
        nodes[self.q :: self.q] = np.maximum(nodes[self.q :: self.q], found[:, -1])
        later = np.maximum.accumulate(nodes[::-1])[::-1]
        plant = rows[:, : self.tracking.system.n]
        return np.asarray(later + self.jump_need(plant) + self.round_off(plant))

    def _need_of(self, rows: Array, step: Array) -> Array:
        weight = np.linalg.norm(rows @ self.tracking.W_inverse, axis=-1) + self.tracking.curvature(rows)
        return np.asarray(weight * np.linalg.norm(np.abs(self.tracking.W) @ step))


def facet_room(
    tracking: Tracking, reference: Reference, unsafe: TimedPolytope, q: int, nodes: Array | None = None
) -> Array:
    """Distance from the reference to every facet of one set at every node, shape (cells, q+1, F).

    Already reduced by the bow of the reference between nodes and by rounding.
    """
    system, h = tracking.system, reference.delta / q
    nodes = reference.fine(q) if nodes is None else nodes
    cells = reference.cells
    across = np.abs(unsafe.normals @ system.position @ system.A)
    bow = at_nodes(h**2 / 8 * reference.rates(nodes) @ across.T)
    distance = (nodes @ system.position.T) @ unsafe.normals.T - unsafe.fine(q)[:cells]
    size = np.abs(nodes @ system.position.T).sum(axis=-1, keepdims=True) + np.abs(unsafe.fine(q)[:cells])
    return np.asarray(distance - bow - ROUNDING * size)


def best_facets(
    tracking: Tracking, reference: Reference, unsafe: tuple[TimedPolytope, ...], start: Zonotope
) -> NDArray[np.int_]:
    """For every cell and set the facet that leaves most room beyond S's tube, shape (cells, o)."""
    q = tracking.feedback.nodes_per_cell
    nodes = reference.fine(q)
    chosen = np.zeros((reference.cells, len(unsafe)), dtype=int)
    for o, polytope in enumerate(unsafe):
        tube = error_tube(tracking, start, -polytope.normals @ tracking.system.position)
        need = tube.over_cells(reference.cells, q)
        room = facet_room(tracking, reference, polytope, q, nodes).min(axis=1)
        chosen[:, o] = np.argmax(room - need, axis=1)
    return chosen
