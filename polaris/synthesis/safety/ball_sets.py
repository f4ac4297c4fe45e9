"""Recoverable balls, time-varying (section III-B, corrected)."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from reach.sets.zonotope import Zonotope

from ...model.system import Array
from ...model.tolerances import ROUNDING
from ..tracker.error_bounds import ErrorBounds
from ..tracker.intersample import at_nodes
from .clearance import Clearance
from .recoverable import Margin, left


@dataclass(frozen=True, eq=False)
class BallSets:
    """Balls ``norm(W e) <= r`` about the reference (eqs. 11 and 12 as docs/theory.md, Lemma 2, has them).

    The radius weighs the room at every later time by what is left of the error by then. The least radius is
    that of the constant ball, from the smallest room over all time.
    """

    clearance: Clearance
    bounds: ErrorBounds
    kind: str = "ball"

    @cached_property
    def _rooms(self) -> tuple[Array, Array, Array, list[str]]:
        """Room of every limit in every period, gamma (l,), disturbance, faults and round-off, and names.

        Room and disturbance have shape (cells * q, l).
        """
        c, b, w = self.clearance, self.bounds, self.clearance.tracking.system.w_max
        room = np.minimum(c.room[:, :-1], c.room[:, 1:]).reshape(c.cells * c.q, len(c.unsafe))
        gamma, gain = np.full(len(c.unsafe), b.gamma_position), np.full(len(c.unsafe), b.gain_position)
        names = [u.name for u in c.unsafe]
        rows, index = c.obstacle_rows
        round_off = (c.round_off(rows) + c.tracking.upset(rows)[-1])[index]
        room = np.hstack([room, np.repeat(np.minimum(*c.thrust), c.q, axis=0)])
        gamma, gain = np.append(gamma, b.gamma_input), np.append(gain, b.gain_input)
        names += c.tracking.system.input_names
        inputs = c.round_off(c.tracking.gain) + c.tracking.upset(c.tracking.gain)[-1]
        round_off = np.hstack([round_off, np.broadcast_to(inputs, (c.cells, len(inputs)))])
        return room, gamma, gain * w + np.repeat(round_off, c.q, axis=0), names

    @cached_property
    def limits(self) -> Array:
        """Norm allowed with no time to decay, per period and limit, shape (cells * q, l)."""
        room, gamma, disturbance, _ = self._rooms
        return (room - disturbance) / gamma * (1 - ROUNDING)

    def _decayed(self, count: int) -> Array:
        """Least factor by which an error shrinks from anywhere in one period to anywhere in a later one.

        In the first `count` of them: from period i to period j at least j - i - 1 periods pass.
        """
        gone = np.maximum(np.arange(count) - 1, 0) * self.clearance.tracking.flow.h
        return np.exp(np.minimum(self.bounds.beta * gone, np.log(1e12)))

    @cached_property
    def _radii(self) -> Array:
        """Radius for every period."""
        least = self.limits.min(axis=1)
        count = len(least)
        decayed = self._decayed(count)
        later = (least[i:] * np.where(least[i:] > 0, decayed[: count - i], 1.0) for i in range(count))
        return np.array([each.min() for each in later])

    def _margins(self, k: int, norms: Array) -> Margin:
        """Tightest limit for errors up to a norm at every node of a cell, or at its start alone."""
        first, last = k * self.clearance.q, len(self.limits) - 1
        # A node belongs to the period before it too, as far as that lies in the cell.
        own = np.minimum(np.maximum(first + np.arange(len(norms)) - (len(norms) > 1), first), last)
        found = [self._tightest(int(period), float(norm)) for period, norm in zip(own, norms, strict=True)]
        return min(found, key=lambda margin: margin.value)

    def _tightest(self, period: int, norm: float) -> Margin:
        """Tightest limit for errors up to a norm within a period."""
        room, gamma, disturbance, names = self._rooms
        jump = np.repeat(np.hstack(self.clearance.jumps), self.clearance.q, axis=0)[period:]
        room = room[period:] + jump
        size = norm / self._decayed(len(room))
        need = (gamma * size[:, None] + disturbance[period:]) * (1 + 2 * ROUNDING) + jump
        share = left(need, room)
        j, limit = np.unravel_index(int(np.argmin(share)), share.shape)
        time = float((period + j) * self.clearance.tracking.flow.h)
        return Margin(
            float(share[j, limit]), names[limit], time, float(need[j, limit]), float(room[j, limit])
        )

    def holds(self, k: int, nodes: Zonotope, bow: Array) -> bool:
        """Whether a tube over cell k is inside."""
        return self.margin(k, nodes, bow).inside

    def margin(self, k: int, nodes: Zonotope, bow: Array) -> Margin:
        """Margin of a tube over cell k."""
        extra = np.linalg.norm(at_nodes(bow) @ np.abs(self.bounds.W).T, axis=-1)
        return self._margins(k, (nodes.norm_bound(self.bounds.W) + extra) * (1 + ROUNDING))

    def margin_at(self, k: int, start: Zonotope) -> Margin:
        """Margin of one set at the start of cell k."""
        return self._margins(k, np.atleast_1d(start.norm_bound(self.bounds.W)) * (1 + ROUNDING))

    def contains(self, node: int, errors: Array) -> NDArray[np.bool_]:
        """Whether each error (runs, n) at a node is recoverable."""
        radius = self._radii[min(node, len(self._radii) - 1)]
        return np.asarray(np.linalg.norm(errors @ self.bounds.W.T, axis=-1) <= radius)

    def radius(self, node: int) -> float:
        """Radius of the ball at a node, in the norm of the tracker (for comparison between kinds)."""
        W = self.clearance.tracking.W
        stretch = float(np.linalg.norm(self.bounds.W @ np.linalg.inv(W), 2))
        return max(float(self._radii[min(node, len(self._radii) - 1)]), 0.0) / stretch
