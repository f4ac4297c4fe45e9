"""Recoverable sets (Definition 1): from which errors the safety controller stays safe to the end.

Three kinds behind one interface, from the paper's to the least conservative. All include "S does
not saturate from here to the end" (theory item 7), and all hold for the whole of every period.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from reach.zonotope import Zonotope

from .clearance import Clearance
from .controllers import Flight
from .error_bounds import ErrorBounds
from .errors import ScenarioError
from .system import Array
from .tolerances import ROUNDING


@dataclass(frozen=True)
class Margin:
    """How far a set of errors is inside a recoverable set, and what limits it.

    Attributes
    ----------
    value : float
        Share of the available room left over at the tightest place: 1 for the reference itself
        undisturbed, 0 on the boundary, negative outside.
    limit : str
        Name of the unsafe set or of the thrust axis that limits it.
    time : float
        Time [s] at which the limit bites, under S.
    need, room : float
        What the set needs there and what there is, in m or N (norm units for a ball).
    """

    value: float
    limit: str
    time: float
    need: float
    room: float

    @property
    def inside(self) -> bool:
        """Whether the whole set is recoverable."""
        return self.value >= 0

    def __str__(self) -> str:
        return f"{self.limit} at t = {self.time:.6g} s: needs {self.need:.4g} of {self.room:.4g}"


class RecoverableSet(Protocol):
    """One recoverable set per node, in error coordinates ``e = x - xi(t)``."""

    kind: str
    guarantee: str

    def margin(self, k: int, nodes: Zonotope, bow: Array) -> Margin:
        """Margin of a flight over cell k: sets at its q+1 nodes, bow over the q parts (see Flight)."""
        ...

    def margin_at(self, k: int, start: Zonotope) -> Margin:
        """Margin of one set at the start of cell k."""
        ...

    def contains(self, node: int, errors: Array) -> NDArray[np.bool_]:
        """Whether each error (runs, n) at a node is recoverable."""
        ...

    def radius(self, node: int) -> float:
        """Radius of the largest ball ``norm(W e) <= r`` inside the set at a node."""
        ...


def contains_flight(recoverable: RecoverableSet, k: int, flight: Flight) -> Margin:
    """Line 13 of Algorithm 2: is the reach set over ``[t1, t2]`` inside, pointwise in time?"""
    return recoverable.margin(k, flight.nodes, flight.bow)


def get_recover(kind: str, clearance: Clearance, bounds: ErrorBounds) -> RecoverableSet:
    """Build the recoverable sets of one kind (the paper's GetRecover)."""
    if not clearance.unsafe and kind == "paper_ball":
        raise ScenarioError("recoverable.kind", kind, "has nothing to keep clear of: there are no unsafe sets")
    if kind == "polytope":
        return PolytopeSets(clearance)
    if kind in ("ball", "time_varying_ball", "paper_ball"):
        return BallSets(clearance, bounds, kind)
    raise ValueError(f"unknown kind of recoverable set: {kind}")


def _grow(nodes: Zonotope, bow: Array) -> Array:
    """Bow at every node: the larger of the two parts that meet there, shape (q+1, n)."""
    return np.asarray(np.maximum(np.pad(bow, ((0, 1), (0, 0))), np.pad(bow, ((1, 0), (0, 0)))))


@dataclass(frozen=True, eq=False)
class BallSets:
    """Balls ``norm(W e) <= r`` about the reference (eqs. 11 and 12; theory items 2, 5, 6, 7).

    `ball` has one radius, from the smallest room over all time; `time_varying_ball` weighs the
    room at every later time by what is left of the error by then; `paper_ball` is eq. 12 as
    printed, without the thrust limits: it is not sound and carries no guarantee.
    """

    clearance: Clearance
    bounds: ErrorBounds
    kind: str

    @property
    def guarantee(self) -> str:
        """``proved`` for the two sound kinds."""
        return "none" if self.kind == "paper_ball" else "proved"

    @cached_property
    def limits(self) -> tuple[Array, list[str]]:
        """Norm allowed with no time to decay, per period and limit, shape (cells * q, l); names."""
        c, b, w = self.clearance, self.bounds, self.clearance.tracking.system.w_max
        room = np.minimum(c.room[:, :-1], c.room[:, 1:]).reshape(-1, len(c.unsafe))
        allowed = [(room - b.gain_position * w) / b.gamma_position]
        names = [u.name for u in c.unsafe]
        if self.kind != "paper_ball":
            thrust = np.repeat(np.minimum(*c.thrust), c.q, axis=0)
            allowed.append((thrust - b.gain_input * w) / b.gamma_input)
            names += [f"thrust axis {i}" for i in range(thrust.shape[1])]
        return np.hstack(allowed) * (1 - ROUNDING), names

    @cached_property
    def _radii(self) -> tuple[Array, NDArray[np.int_], NDArray[np.int_]]:
        """Radius for every period, and which period and limit set it."""
        allowed, _ = self.limits
        count = len(allowed)
        radii, when, which = np.empty(count), np.empty(count, int), np.empty(count, int)
        flat = allowed.min(axis=1), allowed.argmin(axis=1)
        step = np.exp(self.bounds.beta * self.clearance.tracking.flow.h)
        for i in range(count):
            later = flat[0][i:]
            if self.kind == "time_varying_ball":
                # From anywhere in period i to anywhere in period j at least j - i - 1 periods pass.
                gone = np.maximum(np.arange(len(later)) - 1, 0)
                later = np.where(later > 0, later * np.minimum(step**gone, 1e12), later)
            else:
                later = flat[0]
            j = int(np.argmin(later))
            radii[i] = later[j]
            when[i] = i + j if self.kind == "time_varying_ball" else j
            which[i] = flat[1][when[i]]
        return radii, when, which

    def _margins(self, k: int, norms: Array) -> Margin:
        radii, when, which = self._radii
        first = k * self.clearance.q
        own = radii[np.minimum(first + np.arange(len(norms)), len(radii) - 1)]
        before = radii[np.maximum(first + np.arange(len(norms)) - 1, first)]
        room = np.minimum(own, before) if len(norms) > 1 else own
        value = np.where(room > 0, 1 - norms / np.where(room > 0, room, 1), -np.inf)
        i = int(np.argmin(value))
        at = min(first + i, len(radii) - 1)
        time = float(when[at] * self.clearance.tracking.flow.h)
        return Margin(float(value[i]), self.limits[1][which[at]], time, float(norms[i]), float(room[i]))

    def margin(self, k: int, nodes: Zonotope, bow: Array) -> Margin:
        """Margin of a flight over cell k."""
        extra = np.linalg.norm(_grow(nodes, bow) @ np.abs(self.bounds.W).T, axis=-1)
        return self._margins(k, (nodes.norm_bound(self.bounds.W) + extra) * (1 + ROUNDING))

    def margin_at(self, k: int, start: Zonotope) -> Margin:
        """Margin of one set at the start of cell k."""
        return self._margins(k, np.atleast_1d(start.norm_bound(self.bounds.W)) * (1 + ROUNDING))

    def contains(self, node: int, errors: Array) -> NDArray[np.bool_]:
        """Whether each error (runs, n) at a node is recoverable."""
        radius = self._radii[0][min(node, len(self._radii[0]) - 1)]
        return np.asarray(np.linalg.norm(errors @ self.bounds.W.T, axis=-1) <= radius)

    def radius(self, node: int) -> float:
        """Radius of the ball at a node, in the norm of the tracker (for comparison between kinds)."""
        W = self.clearance.tracking.W
        stretch = float(np.linalg.norm(self.bounds.W @ np.linalg.inv(W), 2))
        return max(float(self._radii[0][min(node, len(self._radii[0]) - 1)]), 0.0) / stretch


@dataclass(frozen=True, eq=False)
class PolytopeSets:
    """All facets and thrust limits, carried back exactly through the closed loop (the default).

    ``C^t = {e : row_j Phi(t_j - t) e + disturbance <= room_j for every later t_j}``: exact for the
    chosen facets up to what is booked between nodes. Limits further away than the memory of the
    loop are collected in one ball, which they can hardly touch (docs/theory.md, Proposition 6).
    """

    clearance: Clearance
    kind: str = "polytope"
    guarantee: str = "proved"

    @cached_property
    def _rows(self) -> tuple[Array, Array, Array, Array]:
        """Rows carried back, ``row phi^l`` (L, r, n); disturbance (L + 1, r); curvature (r,); index."""
        tracking = self.clearance.tracking
        obstacle, _ = self.clearance.obstacle_rows
        rows = np.vstack([obstacle, tracking.gain, -tracking.gain])
        return rows @ tracking.transitions, tracking.disturbance(rows), tracking.curvature(rows), rows

    @cached_property
    def _index(self) -> NDArray[np.int_]:
        """Row of every limit in every cell, shape (cells, o + 2 m)."""
        obstacle, index = self.clearance.obstacle_rows
        m = self.clearance.tracking.system.m
        thrust = np.broadcast_to(len(obstacle) + np.arange(2 * m), (self.clearance.cells, 2 * m))
        return np.hstack([index, thrust])

    @cached_property
    def room(self) -> Array:
        """Room of every limit at every node of every cell, shape (cells, q+1, o + 2 m).

        ``u = mu - Lambda e``: the row ``+Lambda_i`` is limited by the room below, ``-Lambda_i`` above.
        """
        above, below = self.clearance.thrust
        thrust = np.broadcast_to(
            np.hstack([below, above])[:, None, :], (self.clearance.cells, self.clearance.q + 1, 2 * below.shape[1])
        ).copy()
        if self.clearance.tracking.feedback.sampled:
            thrust[:, -1] = np.inf  # the input renewed at the end of a cell belongs to the next one
        return np.concatenate([self.clearance.room, thrust], axis=-1)

    @cached_property
    def names(self) -> list[str]:
        """Names of the limits, in the order of `room`."""
        m = self.clearance.tracking.system.m
        axes = [f"thrust axis {i}" for i in range(m)]
        return [u.name for u in self.clearance.unsafe] + axes + axes

    @cached_property
    def _far(self) -> Array:
        """Ball that covers all limits beyond the memory: allowed norm at every node, (nodes + 1,)."""
        tracking = self.clearance.tracking
        _, disturbance, curvature, rows = self._rows
        reach = (np.linalg.norm(rows @ tracking.W_inverse, axis=-1) + curvature) * tracking.decay[-1]
        spare = self.room - disturbance[-1][self._index][:, None, :]
        allowed = np.min(np.where(np.isposinf(spare), np.inf, spare / reach[self._index][:, None, :]), axis=-1)
        allowed = np.where(np.isnan(allowed), -np.inf, allowed)
        per_node = allowed[:, :-1].reshape(-1)
        per_node = np.append(np.minimum(per_node, allowed[:, 1:].reshape(-1)), np.inf)
        suffix = np.minimum.accumulate(per_node[::-1])[::-1]
        # After the tail the reference repeats it: whatever the node, the whole tail lies ahead again.
        tail = self.clearance.planned * self.clearance.q
        first = np.minimum(np.arange(len(per_node)) + tracking.memory, tail)
        return np.asarray(suffix[first])

    def _targets(self, node: int) -> tuple[NDArray[np.int_], NDArray[np.int_], NDArray[np.int_]]:
        """Lags, cells and places in the cell of the limits that a node must meet from there on."""
        q, cells = self.clearance.q, self.clearance.cells
        last = min(node + self.clearance.tracking.memory + 1, cells * q)
        later = np.arange(node, last + 1)
        right = later[later < cells * q]
        left = later[(later % q == 0) & (later > node)]
        lags = np.concatenate([right, left]) - node
        return lags, np.concatenate([right // q, left // q - 1]), np.concatenate([right % q, np.full(len(left), q)])

    @cached_property
    def _floor(self) -> Array:
        """Least room of every distinct row from a cell on, shape (cells, r)."""
        floor = np.full((self.clearance.cells, len(self._rows[3])), np.inf)
        least = self.room.min(axis=1)
        for limit in range(least.shape[1]):
            np.minimum.at(floor, (np.arange(len(floor)), self._index[:, limit]), least[:, limit])
        return np.asarray(np.minimum.accumulate(floor[::-1], axis=0)[::-1])

    def _need(self, cell: int, nodes: Zonotope, bow: Array, radius: float) -> Array:
        """What each node needs of every row at every lag, shape (count, memory + 2, r).

        Rows that a bound by the norm shows to be met with half of the room to spare keep that
        bound; only the others are worked out exactly.
        """
        tracking = self.clearance.tracking
        carried, disturbance, curvature, _ = self._rows
        booked = curvature * tracking.decay_before[:, None] * radius + disturbance[: len(carried)]
        coarse = self._weights * radius + booked
        keep = coarse > 0.5 * np.maximum(self._floor[cell], 0)
        exact = carried[keep]
        centre = exact @ nodes.c.T
        spread = np.stack([np.abs(exact @ G).sum(axis=-1) for G in nodes.G], axis=1)
        # Rounding is booked on the size of the terms, not on what is left of them after cancelling.
        support = centre + spread + ROUNDING * (np.abs(centre) + spread)
        if np.any(bow > 0):
            # A switch between two nodes is seen from the later one: one period less to decay.
            before = np.concatenate([carried[:1], carried[:-1]])[keep]
            support += np.maximum(np.abs(exact) @ bow.T, np.abs(before) @ bow.T)
        need = np.repeat(coarse[None], len(nodes), axis=0)
        need[:, keep] = np.minimum(need[:, keep], support.T + booked[keep])
        return np.asarray(need * (1 + ROUNDING * np.sign(need)))

    @cached_property
    def _weights(self) -> Array:
        """``norm(row phi^l W^-1)``, and one period earlier if that is larger, shape (memory + 2, r)."""
        norms = np.linalg.norm(self._rows[0] @ self.clearance.tracking.W_inverse, axis=-1) * (1 + ROUNDING)
        return np.asarray(np.maximum(norms, np.concatenate([norms[:1], norms[:-1]])))

    def _margins(self, first: int, nodes: Zonotope, bow: Array, radius: float) -> Margin:
        """Tightest limit over a stack of nodes that starts at node `first` of the grid."""
        tracking, q, cells = self.clearance.tracking, self.clearance.q, self.clearance.cells
        count, lags = len(nodes), len(self._rows[0])
        need = self._need(min(first // q, cells - 1), nodes, bow, radius)
        # Every target lies in the cell to its right; those at a cell's end also in the one to their left.
        target = first + np.arange(count)[:, None] + np.arange(lags)
        worst, where, found = np.inf, (0, 0, 0), (0.0, np.inf)
        for side in (0, 1):
            cell = target // q - side
            counts = cell < cells if side == 0 else (target % q == 0) & (target > first) & (cell < cells)
            i, lag = np.nonzero(counts)
            at = cell[i, lag]
            room = self.room[at, target[i, lag] - at * q]
            needed = np.take_along_axis(need[i, lag], self._index[at], axis=1)
            share = np.where(room > 0, 1 - needed / np.where(room > 0, room, 1), -np.inf)
            share = np.where(np.isnan(share), -np.inf, share)  # what cannot be worked out is not met
            if share.size and share.min() < worst:
                j, limit = np.unravel_index(int(np.argmin(share)), share.shape)
                worst, where = float(share[j, limit]), (int(i[j]), int(lag[j]), int(limit))
                found = float(needed[j, limit]), float(room[j, limit])
        h = tracking.flow.h
        far = float(self._far[min(first, len(self._far) - 1)])
        if np.isfinite(far) and (1 - radius / far if far > 0 else -np.inf) < worst:
            value = 1 - radius / far if far > 0 else -np.inf
            return Margin(value, "limits beyond the loop's memory", first * h, radius, far)
        i0, lag0, limit0 = where
        return Margin(worst, self.names[limit0], (first + i0 + lag0) * h, *found)

    def margin(self, k: int, nodes: Zonotope, bow: Array) -> Margin:
        """Margin of a flight over cell k."""
        grown, W = _grow(nodes, bow), self.clearance.tracking.W
        # States between two nodes, and those of a switch there, are as large as the larger node's.
        radius = float(np.max(nodes.norm_bound(W) + np.linalg.norm(grown @ np.abs(W).T, axis=-1)))
        return self._margins(k * self.clearance.q, nodes, grown, radius)

    def margin_at(self, k: int, start: Zonotope) -> Margin:
        """Margin of one set at the start of cell k."""
        radius = float(start.norm_bound(self.clearance.tracking.W))
        one = Zonotope(start.c[None], start.G[None])
        return self._margins(k * self.clearance.q, one, np.zeros((1, start.dim)), radius)

    def contains(self, node: int, errors: Array) -> NDArray[np.bool_]:
        """Whether each error (runs, n) at a node is recoverable."""
        errors = np.atleast_2d(errors)
        tracking = self.clearance.tracking
        carried, disturbance, curvature, _ = self._rows
        lags, cell, place = self._targets(node)
        radius = np.linalg.norm(errors @ tracking.W.T, axis=-1)
        weight = curvature * tracking.decay_before[:, None]
        # Only limits that the largest of the errors might touch are worked out.
        coarse = (self._weights + weight) * radius.max() + disturbance[: len(carried)]
        index, room = self._index[cell], self.room[cell, place]
        where = coarse[lags[:, None], index] > room
        lag, row, limit = np.broadcast_to(lags[:, None], index.shape)[where], index[where], room[where]
        need = errors @ carried[lag, row].T + radius[:, None] * weight[lag, row] + disturbance[lag, row]
        return np.asarray(np.all(need <= limit, axis=1) & (radius <= self._far[min(node, len(self._far) - 1)]))

    def radius(self, node: int) -> float:
        """Radius of the largest ball ``norm(W e) <= r`` inside the set at a node."""
        ...


def contains_flight(recoverable: RecoverableSet, k: int, flight: Flight) -> Margin:
    """Line 13 of Algorithm 2: is the reach set over ``[t1, t2]`` inside, pointwise in time?"""
    return recoverable.margin(k, flight.nodes, flight.bow)


def get_recover(kind: str, clearance: Clearance, bounds: ErrorBounds) -> RecoverableSet:
    """Build the recoverable sets of one kind (the paper's GetRecover)."""
    if not clearance.unsafe and kind == "paper_ball":
        raise ScenarioError("recoverable.kind", kind, "has nothing to keep clear of: there are no unsafe sets")
    if kind == "polytope":
        return PolytopeSets(clearance)
    if kind in ("ball", "time_varying_ball", "paper_ball"):
        return BallSets(clearance, bounds, kind)
    raise ValueError(f"unknown kind of recoverable set: {kind}")


def _grow(nodes: Zonotope, bow: Array) -> Array:
    """Bow at every node: the larger of the two parts that meet there, shape (q+1, n)."""
    return np.asarray(np.maximum(np.pad(bow, ((0, 1), (0, 0))), np.pad(bow, ((1, 0), (0, 0)))))


@dataclass(frozen=True, eq=False)
class BallSets:
    """Balls ``norm(W e) <= r`` about the reference (eqs. 11 and 12; theory items 2, 5, 6, 7).

    `ball` has one radius, from the smallest room over all time; `time_varying_ball` weighs the
    room at every later time by what is left of the error by then; `paper_ball` is eq. 12 as
    printed, without the thrust limits: it is not sound and carries no guarantee.
    """

    clearance: Clearance
    bounds: ErrorBounds
    kind: str

    @property
    def guarantee(self) -> str:
        """``proved`` for the two sound kinds."""
        return "none" if self.kind == "paper_ball" else "proved"

    @cached_property
    def limits(self) -> tuple[Array, list[str]]:
        """Norm allowed with no time to decay, per period and limit, shape (cells * q, l); names."""
        c, b, w = self.clearance, self.bounds, self.clearance.tracking.system.w_max
        room = np.minimum(c.room[:, :-1], c.room[:, 1:]).reshape(-1, len(c.unsafe))
        allowed = [(room - b.gain_position * w) / b.gamma_position]
        names = [u.name for u in c.unsafe]
        if self.kind != "paper_ball":
            thrust = np.repeat(np.minimum(*c.thrust), c.q, axis=0)
            allowed.append((thrust - b.gain_input * w) / b.gamma_input)
            names += [f"thrust axis {i}" for i in range(thrust.shape[1])]
        return np.hstack(allowed) * (1 - ROUNDING), names

    @cached_property
    def _radii(self) -> tuple[Array, NDArray[np.int_], NDArray[np.int_]]:
        """Radius for every period, and which period and limit set it."""
        allowed, _ = self.limits
        count = len(allowed)
        radii, when, which = np.empty(count), np.empty(count, int), np.empty(count, int)
        flat = allowed.min(axis=1), allowed.argmin(axis=1)
        step = np.exp(self.bounds.beta * self.clearance.tracking.flow.h)
        for i in range(count):
            later = flat[0][i:]
            if self.kind == "time_varying_ball":
                # From anywhere in period i to anywhere in period j at least j - i - 1 periods pass.
                gone = np.maximum(np.arange(len(later)) - 1, 0)
                later = np.where(later > 0, later * np.minimum(step**gone, 1e12), later)
            else:
                later = flat[0]
            j = int(np.argmin(later))
            radii[i] = later[j]
            when[i] = i + j if self.kind == "time_varying_ball" else j
            which[i] = flat[1][when[i]]
        return radii, when, which

    def _margins(self, k: int, norms: Array) -> Margin:
        radii, when, which = self._radii
        first = k * self.clearance.q
        own = radii[np.minimum(first + np.arange(len(norms)), len(radii) - 1)]
        before = radii[np.maximum(first + np.arange(len(norms)) - 1, first)]
        room = np.minimum(own, before) if len(norms) > 1 else own
        value = np.where(room > 0, 1 - norms / np.where(room > 0, room, 1), -np.inf)
        i = int(np.argmin(value))
        at = min(first + i, len(radii) - 1)
        time = float(when[at] * self.clearance.tracking.flow.h)
        return Margin(float(value[i]), self.limits[1][which[at]], time, float(norms[i]), float(room[i]))

    def margin(self, k: int, nodes: Zonotope, bow: Array) -> Margin:
        """Margin of a flight over cell k."""
        extra = np.linalg.norm(_grow(nodes, bow) @ np.abs(self.bounds.W).T, axis=-1)
        return self._margins(k, (nodes.norm_bound(self.bounds.W) + extra) * (1 + ROUNDING))

    def margin_at(self, k: int, start: Zonotope) -> Margin:
        """Margin of one set at the start of cell k."""
        return self._margins(k, np.atleast_1d(start.norm_bound(self.bounds.W)) * (1 + ROUNDING))

    def contains(self, node: int, errors: Array) -> NDArray[np.bool_]:
        """Whether each error (runs, n) at a node is recoverable."""
        radius = self._radii[0][min(node, len(self._radii[0]) - 1)]
        return np.asarray(np.linalg.norm(errors @ self.bounds.W.T, axis=-1) <= radius)

    def radius(self, node: int) -> float:
        """Radius of the ball at a node, in the norm of the tracker (for comparison between kinds)."""
        W = self.clearance.tracking.W
        stretch = float(np.linalg.norm(self.bounds.W @ np.linalg.inv(W), 2))
        return max(float(self._radii[0][min(node, len(self._radii[0]) - 1)]), 0.0) / stretch


@dataclass(frozen=True, eq=False)
class PolytopeSets:
    """All facets and thrust limits, carried back exactly through the closed loop (the default).

    ``C^t = {e : row_j Phi(t_j - t) e + disturbance <= room_j for every later t_j}``: exact for the
    chosen facets up to what is booked between nodes. Limits further away than the memory of the
    loop are collected in one ball, which they can hardly touch (docs/theory.md, Proposition 6).
    """

    clearance: Clearance
    kind: str = "polytope"
    guarantee: str = "proved"

    @cached_property
    def _rows(self) -> tuple[Array, Array, Array, Array]:
        """Rows carried back, ``row phi^l`` (L, r, n); disturbance (L + 1, r); curvature (r,); index."""
        tracking = self.clearance.tracking
        obstacle, _ = self.clearance.obstacle_rows
        rows = np.vstack([obstacle, tracking.gain, -tracking.gain])
        return rows @ tracking.transitions, tracking.disturbance(rows), tracking.curvature(rows), rows

    @cached_property
    def _index(self) -> NDArray[np.int_]:
        """Row of every limit in every cell, shape (cells, o + 2 m)."""
        obstacle, index = self.clearance.obstacle_rows
        m = self.clearance.tracking.system.m
        thrust = np.broadcast_to(len(obstacle) + np.arange(2 * m), (self.clearance.cells, 2 * m))
        return np.hstack([index, thrust])

    @cached_property
    def room(self) -> Array:
        """Room of every limit at every node of every cell, shape (cells, q+1, o + 2 m).

        ``u = mu - Lambda e``: the row ``+Lambda_i`` is limited by the room below, ``-Lambda_i`` above.
        """
        above, below = self.clearance.thrust
        thrust = np.broadcast_to(
            np.hstack([below, above])[:, None, :], (self.clearance.cells, self.clearance.q + 1, 2 * below.shape[1])
        ).copy()
        if self.clearance.tracking.feedback.sampled:
            thrust[:, -1] = np.inf  # the input renewed at the end of a cell belongs to the next one
        return np.concatenate([self.clearance.room, thrust], axis=-1)

    @cached_property
    def names(self) -> list[str]:
        """Names of the limits, in the order of `room`."""
        m = self.clearance.tracking.system.m
        axes = [f"thrust axis {i}" for i in range(m)]
        return [u.name for u in self.clearance.unsafe] + axes + axes

    @cached_property
    def _far(self) -> Array:
        """Ball that covers all limits beyond the memory: allowed norm at every node, (nodes + 1,)."""
        tracking = self.clearance.tracking
        _, disturbance, curvature, rows = self._rows
        reach = (np.linalg.norm(rows @ tracking.W_inverse, axis=-1) + curvature) * tracking.decay[-1]
        spare = self.room - disturbance[-1][self._index][:, None, :]
        allowed = np.min(np.where(np.isposinf(spare), np.inf, spare / reach[self._index][:, None, :]), axis=-1)
        allowed = np.where(np.isnan(allowed), -np.inf, allowed)
        per_node = allowed[:, :-1].reshape(-1)
        per_node = np.append(np.minimum(per_node, allowed[:, 1:].reshape(-1)), np.inf)
        suffix = np.minimum.accumulate(per_node[::-1])[::-1]
        # After the tail the reference repeats it: whatever the node, the whole tail lies ahead again.
        tail = self.clearance.planned * self.clearance.q
        first = np.minimum(np.arange(len(per_node)) + tracking.memory, tail)
        return np.asarray(suffix[first])

    def _targets(self, node: int) -> tuple[NDArray[np.int_], NDArray[np.int_], NDArray[np.int_]]:
        """Lags, cells and places in the cell of the limits that a node must meet from there on."""
        q, cells = self.clearance.q, self.clearance.cells
        last = min(node + self.clearance.tracking.memory + 1, cells * q)
        later = np.arange(node, last + 1)
        right = later[later < cells * q]
        left = later[(later % q == 0) & (later > node)]
        lags = np.concatenate([right, left]) - node
        return lags, np.concatenate([right // q, left // q - 1]), np.concatenate([right % q, np.full(len(left), q)])

    @cached_property
    def _floor(self) -> Array:
        """Least room of every distinct row from a cell on, shape (cells, r)."""
        floor = np.full((self.clearance.cells, len(self._rows[3])), np.inf)
        least = self.room.min(axis=1)
        for limit in range(least.shape[1]):
            np.minimum.at(floor, (np.arange(len(floor)), self._index[:, limit]), least[:, limit])
        return np.asarray(np.minimum.accumulate(floor[::-1], axis=0)[::-1])

    def _need(self, cell: int, nodes: Zonotope, bow: Array, radius: float) -> Array:
        """What each node needs of every row at every lag, shape (count, memory + 2, r).

        Rows that a bound by the norm shows to be met with half of the room to spare keep that
        bound; only the others are worked out exactly.
        """
        tracking = self.clearance.tracking
        carried, disturbance, curvature, _ = self._rows
        booked = curvature * tracking.decay_before[:, None] * radius + disturbance[: len(carried)]
        coarse = self._weights * radius + booked
        keep = coarse > 0.5 * np.maximum(self._floor[cell], 0)
        exact = carried[keep]
        centre = exact @ nodes.c.T
        spread = np.stack([np.abs(exact @ G).sum(axis=-1) for G in nodes.G], axis=1)
        # Rounding is booked on the size of the terms, not on what is left of them after cancelling.
        support = centre + spread + ROUNDING * (np.abs(centre) + spread)
        if np.any(bow > 0):
            # A switch between two nodes is seen from the later one: one period less to decay.
            before = np.concatenate([carried[:1], carried[:-1]])[keep]
            support += np.maximum(np.abs(exact) @ bow.T, np.abs(before) @ bow.T)
        need = np.repeat(coarse[None], len(nodes), axis=0)
        need[:, keep] = np.minimum(need[:, keep], support.T + booked[keep])
        return np.asarray(need * (1 + ROUNDING * np.sign(need)))

    @cached_property
    def _weights(self) -> Array:
        """``norm(row phi^l W^-1)``, and one period earlier if that is larger, shape (memory + 2, r)."""
        norms = np.linalg.norm(self._rows[0] @ self.clearance.tracking.W_inverse, axis=-1) * (1 + ROUNDING)
        return np.asarray(np.maximum(norms, np.concatenate([norms[:1], norms[:-1]])))

    def _margins(self, first: int, nodes: Zonotope, bow: Array, radius: float) -> Margin:
        """Tightest limit over a stack of nodes that starts at node `first` of the grid."""
        tracking, q, cells = self.clearance.tracking, self.clearance.q, self.clearance.cells
        count, lags = len(nodes), len(self._rows[0])
        need = self._need(min(first // q, cells - 1), nodes, bow, radius)
        # Every target lies in the cell to its right; those at a cell's end also in the one to their left.
        target = first + np.arange(count)[:, None] + np.arange(lags)
        worst, where, found = np.inf, (0, 0, 0), (0.0, np.inf)
        for side in (0, 1):
            cell = target // q - side
            counts = cell < cells if side == 0 else (target % q == 0) & (target > first) & (cell < cells)
            i, lag = np.nonzero(counts)
            at = cell[i, lag]
            room = self.room[at, target[i, lag] - at * q]
            needed = np.take_along_axis(need[i, lag], self._index[at], axis=1)
            share = np.where(room > 0, 1 - needed / np.where(room > 0, room, 1), -np.inf)
            share = np.where(np.isnan(share), -np.inf, share)  # what cannot be worked out is not met
            if share.size and share.min() < worst:
                j, limit = np.unravel_index(int(np.argmin(share)), share.shape)
                worst, where = float(share[j, limit]), (int(i[j]), int(lag[j]), int(limit))
                found = float(needed[j, limit]), float(room[j, limit])
        h = tracking.flow.h
        far = float(self._far[min(first, len(self._far) - 1)])
        if np.isfinite(far) and (1 - radius / far if far > 0 else -np.inf) < worst:
            value = 1 - radius / far if far > 0 else -np.inf
            return Margin(value, "limits beyond the loop's memory", first * h, radius, far)
        i0, lag0, limit0 = where
        return Margin(worst, self.names[limit0], (first + i0 + lag0) * h, *found)

    def margin(self, k: int, nodes: Zonotope, bow: Array) -> Margin:
        """Margin of a flight over cell k."""
        grown, W = _grow(nodes, bow), self.clearance.tracking.W
        # States between two nodes, and those of a switch there, are as large as the larger node's.
        radius = float(np.max(nodes.norm_bound(W) + np.linalg.norm(grown @ np.abs(W).T, axis=-1)))
        return self._margins(k * self.clearance.q, nodes, grown, radius)

    def margin_at(self, k: int, start: Zonotope) -> Margin:
        """Margin of one set at the start of cell k."""
        radius = float(start.norm_bound(self.clearance.tracking.W))
        one = Zonotope(start.c[None], start.G[None])
        return self._margins(k * self.clearance.q, one, np.zeros((1, start.dim)), radius)

    def contains(self, node: int, errors: Array) -> NDArray[np.bool_]:
        """Whether each error (runs, n) at a node is recoverable."""
        errors = np.atleast_2d(errors)
        tracking = self.clearance.tracking
        carried, disturbance, curvature, _ = self._rows
        lags, cell, place = self._targets(node)
        radius = np.linalg.norm(errors @ tracking.W.T, axis=-1)
        need = np.einsum("lrn,en->elr", carried, errors) + disturbance[: len(carried)]
        need += curvature * tracking.decay_before[:, None] * radius[:, None, None]
        needed = np.take_along_axis(need[:, lags], self._index[cell][None], axis=2)
        near = np.all(needed <= self.room[cell, place], axis=(1, 2))
        return np.asarray(near & (radius <= self._far[min(node, len(self._far) - 1)]))

    def radius(self, node: int) -> float:
        """Radius of the largest ball ``norm(W e) <= r`` inside the set at a node."""
        tracking = self.clearance.tracking
        carried, disturbance, curvature, _ = self._rows
        lags, cell, place = self._targets(node)
        per_unit = np.linalg.norm(carried @ tracking.W_inverse, axis=-1) + curvature * tracking.decay_before[:, None]
        index = self._index[cell]
        spare = self.room[cell, place] - np.take_along_axis(disturbance[lags], index, axis=1)
        near = np.min(spare / np.take_along_axis(per_unit[lags], index, axis=1), initial=np.inf)
        return float(max(min(near, self._far[min(node, len(self._far) - 1)]), 0.0))
