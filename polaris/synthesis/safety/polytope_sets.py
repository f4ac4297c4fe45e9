"""Polytopic recoverable sets: every limit carried back exactly through the closed loop."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from reach.sets.zonotope import Zonotope

from ...model.system import Array
from ...model.tolerances import ROUNDING
from ..tracker.intersample import at_nodes
from .clearance import Clearance
from .recoverable import Margin, left

COARSE = (0.5, 0.05)
"""Shares of the room up to which a bound by the norm stands for what a set needs, tried in this order."""


@dataclass(frozen=True, eq=False)
class PolytopeSets:
    """All facets and thrust limits, carried back exactly through the closed loop (the default).

    ``C^t = {e : row_j Phi(t_j - t) e + disturbance <= room_j for every later t_j}``: exact for the
    chosen facets up to what is booked between nodes. Limits further away than the memory of the
    loop are collected in one ball, which they can hardly touch (docs/theory.md, Proposition 11).
    """

    clearance: Clearance
    kind: str = "polytope"

    @cached_property
    def carried(self) -> tuple[Array, Array, Array, Array]:
        """Carried back ``row phi^l`` (L, r, n); disturbance and round-off (L + 1, r); curvature; rows."""
        tracking = self.clearance.tracking
        obstacle, _ = self.clearance.obstacle_rows
        thrust = tracking.commands
        whole = np.vstack([tracking.whole(obstacle), *[thrust] * self._times])
        rows = whole[:, : tracking.system.n]
        disturbance = tracking.disturbance(whole) + self.clearance.round_off(rows)
        if tracking.profile is not None:  # a bound that falls is the first one, of which more is taken
            falls = tracking.profile[0] - np.vstack([tracking.profile, tracking.profile[-1:]])
            disturbance[:, -len(thrust) :] += np.hstack([falls, falls])
        return rows @ tracking.transitions, disturbance, tracking.curvature(rows), whole

    @property
    def _times(self) -> int:
        """How often commands are limited: by the thrusters, and by what errors are booked for."""
        return 1 if self.clearance.tracking.profile is None else 2

    @cached_property
    def index(self) -> NDArray[np.int_]:
        """Row of every limit in every cell, shape (cells, limits): facets, then commands of either sign."""
        obstacle, index = self.clearance.obstacle_rows
        count = 2 * self.clearance.tracking.system.m * self._times
        thrust = np.broadcast_to(len(obstacle) + np.arange(count), (self.clearance.cells, count))
        return np.hstack([index, thrust])

    @cached_property
    def room(self) -> Array:
        """Room of every limit at every node of every cell, shape (cells, q+1, limits).

        ``u = mu - Lambda e``: the row ``+Lambda_i`` is limited by the room below, ``-Lambda_i`` above.
        """
        clearance, tracking = self.clearance, self.clearance.tracking
        above, below = clearance.thrust
        thrust = np.hstack([below, above])
        if tracking.profile is not None:
            level = tracking.profile[0] * (1 - ROUNDING) - tracking.noise
            thrust = np.hstack([thrust, *[level - clearance.jumps[1]] * 2])
        nodes = np.repeat(thrust[:, None, :], clearance.q + 1, axis=1)
        nodes[:, -1] = np.inf  # the input renewed at the end of a cell belongs to the next one
        return np.concatenate([clearance.room, nodes], axis=-1) - self._scheduled

    @cached_property
    def _scheduled(self) -> Array:
        """What errors by the time of the flight have taken of `room`, shape (cells, q+1, limits)."""
        return np.take_along_axis(self._caused, self.index[:, None, :], axis=2)

    @cached_property
    def _caused(self) -> Array:
        """The same along every distinct row, shape (cells, q+1, r)."""
        found = self.clearance.scheduled(self.carried[3])
        if self._times > 1:
            found[:, :, -2 * self.clearance.tracking.system.m :] = 0.0  # they are booked apart
        return found

    @cached_property
    def _taken(self) -> Array:
        """That, and what the jump into the tail has taken."""
        facets, inputs = self.clearance.jumps
        return np.hstack([facets, *[inputs] * (2 * self._times)])[:, None, :] + self._scheduled

    @cached_property
    def names(self) -> list[str]:
        """Names of the limits, in the order of `room`."""
        axes = self.clearance.tracking.system.input_names
        return [*(u.name for u in self.clearance.unsafe), *axes * (2 * self._times)]

    @cached_property
    def _reach(self) -> Array:
        """What each row needs of an error beyond the memory, per unit of ``norm(W e)`` now, shape (r,)."""
        tracking = self.clearance.tracking
        carried, _, curvature, _ = self.carried
        return np.asarray(
            (np.linalg.norm(carried[0] @ tracking.W_inverse, axis=-1) + curvature) * tracking.decay[-1]
        )

    @cached_property
    def _ahead(self) -> Array:
        """Least room of every distinct row from a node on, shape (nodes + 1, r)."""
        cells, q, r = self.clearance.cells, self.clearance.q, len(self.carried[3])
        least = np.full((cells, q, r), np.inf)
        both = np.minimum(self.room[:, :-1], self.room[:, 1:])
        at = np.arange(cells)[:, None], np.arange(q)[None, :]
        for limit in range(both.shape[-1]):
            np.minimum.at(least, (*at, self.index[:, limit, None]), both[:, :, limit])
        ahead = np.vstack([least.reshape(-1, r), np.full((1, r), np.inf)])
        return np.asarray(np.minimum.accumulate(ahead[::-1])[::-1])

    @cached_property
    def _beyond(self) -> NDArray[np.int_]:
        """Node from which on limits lie beyond the memory, seen from every node, shape (nodes + 1,)."""
        # After the tail the reference repeats it: whatever the node, the whole tail lies ahead again.
        tail = self.clearance.planned * self.clearance.q
        return np.minimum(np.arange(len(self._ahead)) + self.clearance.tracking.memory, tail)

    @cached_property
    def _far(self) -> Array:
        """Ball that covers all limits beyond the memory: allowed norm at every node, (nodes + 1,)."""
        spare = self._ahead[self._beyond] - self.carried[1][-1]
        allowed = np.where(np.isposinf(spare), np.inf, spare / self._reach).min(axis=1, initial=np.inf)
        return np.asarray(np.where(np.isnan(allowed), -np.inf, allowed))

    def _far_margin(self, node: int, radius: float) -> Margin:
        """Tightest limit beyond the memory for errors up to a norm at a node."""
        start = self._beyond[min(node, len(self._beyond) - 1)]
        jump = self.clearance.jump_need(self.carried[0][0]) + self._caused.max(axis=(0, 1))
        room = self._ahead[start] + jump
        need = (self.carried[1][-1] + self._reach * radius) * (1 + ROUNDING) + jump
        share = self._physical(left(need, room))
        row = int(np.argmin(share))
        # Where that row has its least room: which of the limits it is, and when.
        cells = np.arange(start // self.clearance.q, self.clearance.cells)
        found = np.where(self.index[cells] == row, self.room[cells].min(axis=1), np.inf)
        if not np.isfinite(room[row]):
            return Margin(np.inf, "", np.inf, 0.0, np.inf)
        at, limit = np.unravel_index(int(np.argmin(found)), found.shape)
        time = float(cells[at] * self.clearance.tracking.delta)
        return Margin(float(share[row]), self.names[limit], time, float(need[row]), float(room[row]))

    def _physical(self, share: Array) -> Array:
        """Shares of room left, where what errors are booked for counts only if it is exceeded."""
        if self._times > 1:
            booked = share[..., -2 * self.clearance.tracking.system.m :]
            booked[booked >= 0] = np.inf
        return share

    def _targets(self, node: int) -> tuple[NDArray[np.int_], NDArray[np.int_], NDArray[np.int_]]:
        """Lags, cells and places in the cell of the limits that a node must meet from there on."""
        q, cells = self.clearance.q, self.clearance.cells
        last = min(node + self.clearance.tracking.memory + 1, cells * q)
        later = np.arange(node, last + 1)
        right = later[later < cells * q]
        left = later[(later % q == 0) & (later > node)]
        lags = np.concatenate([right, left]) - node
        return (
            lags,
            np.concatenate([right // q, left // q - 1]),
            np.concatenate([right % q, np.full(len(left), q)]),
        )

    @cached_property
    def _floor(self) -> Array:
        """Least room of every distinct row from a cell on, shape (cells, r)."""
        floor = np.full((self.clearance.cells, len(self.carried[3])), np.inf)
        least = self.room.min(axis=1)
        for limit in range(least.shape[1]):
            np.minimum.at(floor, (np.arange(len(floor)), self.index[:, limit]), least[:, limit])
        return np.asarray(np.minimum.accumulate(floor[::-1], axis=0)[::-1])

    def _need(self, cell: int, nodes: Zonotope, bow: Array, radius: float, spare: float) -> Array:
        """What each node needs of every row at every lag, shape (count, memory + 2, r).

        Rows that a bound by the norm shows to need no more than a share `spare` of the room keep
        that bound; only the others are worked out exactly.
        """
        tracking = self.clearance.tracking
        carried, disturbance, curvature, _ = self.carried
        booked = curvature * tracking.decay_before[:, None] * radius + disturbance[: len(carried)]
        coarse = self._weights * radius + booked
        keep = coarse > spare * np.maximum(self._floor[cell], 0)
        exact = carried[keep]
        centre = exact @ nodes.c.T
        spread = np.stack([np.abs(exact @ G).sum(axis=-1) for G in nodes.G], axis=1)
        # Rounding is booked on the size of the terms, not on what is left of them after cancelling.
        support = centre + spread + ROUNDING * (np.abs(centre) + spread)
        if np.any(bow > 0):
            # More than is needed: only U's own claim between two nodes is left, at lag 0 (Proposition 11).
            before = np.concatenate([carried[:1], carried[:-1]])[keep]
            support += np.maximum(np.abs(exact) @ bow.T, np.abs(before) @ bow.T)
        need = np.repeat(coarse[None], len(nodes), axis=0)
        need[:, keep] = np.minimum(need[:, keep], support.T + booked[keep])
        return np.asarray(need * (1 + ROUNDING * np.sign(need)))

    @cached_property
    def _weights(self) -> Array:
        """``norm(row phi^l W^-1)``, and one period earlier if that is larger, shape (memory + 2, r)."""
        norms = np.linalg.norm(self.carried[0] @ self.clearance.tracking.W_inverse, axis=-1) * (1 + ROUNDING)
        return np.asarray(np.maximum(norms, np.concatenate([norms[:1], norms[:-1]])))

    def _margins(self, first: int, nodes: Zonotope, bow: Array, radius: float) -> Margin:
        """Tightest limit over a stack of nodes that starts at node `first` of the grid."""
        far = self._far_margin(first, radius)
        for spare in COARSE:
            near = self._near_margin(first, nodes, bow, radius, spare)
            if near.value < 1 - spare or far.value < near.value:
                break  # the tightest was worked out exactly: the bound by the norm would have done better
        return min(near, far, key=lambda found: found.value)

    def _near_margin(self, first: int, nodes: Zonotope, bow: Array, radius: float, spare: float) -> Margin:
        """The same within the memory; see `_need` for `spare`."""
        q, cells = self.clearance.q, self.clearance.cells
        count, lags = len(nodes), len(self.carried[0])
        need = self._need(min(first // q, cells - 1), nodes, bow, radius, spare)
        # Every target lies in the cell to its right; those at a cell's end also in the one to their left.
        target = first + np.arange(count)[:, None] + np.arange(lags)
        worst, where, found = np.inf, (0, 0, 0), (0.0, np.inf)
        for side in (0, 1):
            cell = target // q - side
            counts = cell < cells if side == 0 else (target % q == 0) & (target > first) & (cell < cells)
            i, lag = np.nonzero(counts)
            at = cell[i, lag]
            taken = self._taken[at, target[i, lag] - at * q]
            room = self.room[at, target[i, lag] - at * q] + taken
            needed = np.take_along_axis(need[i, lag], self.index[at], axis=1) + taken
            share = self._physical(left(needed, room))
            if share.size and share.min() < worst:
                j, limit = np.unravel_index(int(np.argmin(share)), share.shape)
                worst, where = float(share[j, limit]), (int(i[j]), int(lag[j]), int(limit))
                found = float(needed[j, limit]), float(room[j, limit])
        i0, lag0, limit0 = where
        time = (first + i0 + lag0) * self.clearance.tracking.flow.h
        return Margin(worst, self.names[limit0], time, *found)

    def holds(self, k: int, nodes: Zonotope, bow: Array) -> bool:
        """Whether a tube over cell k is inside: only what the norm cannot tell is worked out exactly."""
        first, grown, radius = self._grown(k, nodes, bow)
        inside = self._far_margin(first, radius).inside
        return inside and self._near_margin(first, nodes, grown, radius, 1.0).inside

    def margin(self, k: int, nodes: Zonotope, bow: Array) -> Margin:
        """Margin of a tube over cell k."""
        first, grown, radius = self._grown(k, nodes, bow)
        return self._margins(first, nodes, grown, radius)

    def _grown(self, k: int, nodes: Zonotope, bow: Array) -> tuple[int, Array, float]:
        """First node of a tube over cell k, its bow at every node, and a bound on ``norm(W e)`` over it."""
        grown, W = at_nodes(bow), self.clearance.tracking.W
        # States between two nodes are as large as the larger node's.
        radius = float(np.max(nodes.norm_bound(W) + np.linalg.norm(grown @ np.abs(W).T, axis=-1)))
        return k * self.clearance.q, grown, radius

    def margin_at(self, k: int, start: Zonotope) -> Margin:
        """Margin of one set at the start of cell k."""
        radius = float(start.norm_bound(self.clearance.tracking.W))
        one = Zonotope(start.c[None], start.G[None])
        return self._margins(k * self.clearance.q, one, np.zeros((1, start.dim)), radius)

    def contains(self, node: int, errors: Array) -> NDArray[np.bool_]:
        """Whether each error (runs, n) at a node is recoverable."""
        errors, tracking = np.atleast_2d(errors), self.clearance.tracking
        carried, disturbance, curvature, _ = self.carried
        lags, cell, place = self._targets(node)
        weight = curvature * tracking.decay_before[:, None]
        radius = np.linalg.norm(errors @ tracking.W.T, axis=-1)
        found = np.asarray(radius <= self._far[min(node, len(self._far) - 1)])
        errors, radius = errors[found], radius[found]
        # Only limits that the largest of the errors might touch are worked out.
        coarse = (self._weights + weight) * radius.max(initial=0.0) + disturbance[: len(carried)]
        where = coarse[lags[:, None], index := self.index[cell]] > (room := self.room[cell, place])
        lag, row, limit = np.broadcast_to(lags[:, None], index.shape)[where], index[where], room[where]
        need = errors @ carried[lag, row].T + radius[:, None] * weight[lag, row] + disturbance[lag, row]
        found[found] = np.all(need <= limit, axis=1)
        return found

    def radius(self, node: int) -> float:
        """Radius of the largest ball ``norm(W e) <= r`` inside the set at a node."""
        tracking = self.clearance.tracking
        carried, disturbance, curvature, _ = self.carried
        lags, cell, place = self._targets(node)
        per_unit = np.linalg.norm(carried @ tracking.W_inverse, axis=-1)
        per_unit, index = per_unit + curvature * tracking.decay_before[:, None], self.index[cell]
        spare = self.room[cell, place] - np.take_along_axis(disturbance[lags], index, axis=1)
        near = np.min(spare / np.take_along_axis(per_unit[lags], index, axis=1), initial=np.inf)
        return float(max(min(near, self._far[min(node, len(self._far) - 1)]), 0.0))
