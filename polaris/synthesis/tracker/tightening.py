"""Tightening of limits: effect of a loop's channels along rows, from rest and for ever.

For every row r and node i + L after a hand-over at node i (docs/theory.md, Theorem 3):

    r z_{i+L} <= max_Z r F^L z + sum_c sum_{j<L} s_c(r F^{L-1-j}) sigma_c(i+j).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from reach.numerics.linear import growth, powers, summed

from ...model.errors import ScenarioError
from ...model.tolerances import ROUNDING
from .channel import Channel
from .loop import Array, ClosedLoop

LEFT_OVER = 1e-5  # share of a loop state left after the settling horizon; smaller: more rows, smaller tails
LONGEST = 6000  # periods of a settling horizon, at most


@dataclass(frozen=True, eq=False)
class Tightening:
    """Bounds on rows of a closed loop under its channels.

    Parameters
    ----------
    closed : ClosedLoop
    u_max : ndarray, shape (m,)
        No command is larger.
    scale : ndarray, shape (N,)
        Typical sizes of the loop states, positive; units cancel in it. Any scale is sound.
    """

    closed: ClosedLoop
    u_max: Array
    scale: Array

    @cached_property
    def _settling(self) -> tuple[Array, Array, float]:
        """Powers of F up to one period beyond the settling horizon, the vector v, and the factor."""
        F, count = self.closed.F, 64
        if not np.max(np.abs(np.linalg.eigvals(F))) < 1:
            raise ScenarioError("feedback.period_s", self.closed.loop.h, "must give a stable loop")
        while True:
            stack = powers(F, count + 1)
            reached = np.abs(stack) @ self.scale
            v = reached.max(axis=0)
            remaining = (np.abs(stack) @ v / v).max(axis=1)
            below = np.flatnonzero(remaining[:-1] <= LEFT_OVER)
            if len(below):
                N = int(below[0])
                return stack[: N + 2], v, float(remaining[N]) * (1 + ROUNDING)
            if count > LONGEST:
                rule = f"must let errors decay within {LONGEST} periods"
                raise ScenarioError("feedback.period_s", self.closed.loop.h, rule)
            count *= 2

    @property
    def horizon(self) -> int:
        """Settling horizon N in periods: ``|F^N| v <= factor v``, factor at most `LEFT_OVER`."""
        return len(self.transitions) - 2

    @property
    def transitions(self) -> Array:
        """``F^l`` for l = 0 ... N + 1."""
        return self._settling[0]

    @property
    def v(self) -> Array:
        """Positive sizes of the loop states in which ``max |z_i| / v_i`` fades, shape (N,)."""
        return self._settling[1]

    @property
    def factor(self) -> float:
        """Share of that norm that is left after the settling horizon."""
        return self._settling[2]

    def carried(self, rows: Array) -> Array:
        """Return ``rows F^l`` for l = 0 ... N + 1, shape (N + 2, r, states)."""
        return np.asarray(rows @ self.transitions)

    def remainder(self, rows: Array) -> Array:
        """Return the tightening of rows at lags from N on, per unit of the norm at a hand-over, (r,)."""
        sizes = np.abs(self.carried(rows)) @ self.v
        least = np.minimum(self.factor * sizes.max(axis=0), self._growth * sizes[-2])
        return np.asarray(least * (1 + ROUNDING))

    @cached_property
    def _growth(self) -> float:
        """Largest growth of the norm within the settling horizon."""
        return float((np.abs(self.transitions) @ self.v / self.v).max() * (1 + ROUNDING))

    def sizes(self, channel: Channel, bound: Array | None) -> Array:
        """Return the sizes of a channel under bounds on commands (..., m), shape (..., k)."""
        if channel.share is None or bound is None:
            return channel.size
        return np.asarray(channel.size + channel.share(np.minimum(bound, self.u_max)))

    def remembered_bound(self, channel: Channel, bound: Array) -> Array:
        """Shift a bound on commands since a hand-over (L, m), which falls, by the lag of a channel.

        Before the hand-over commands are within `u_max` alone.
        """
        before = np.tile(self.u_max, (min(channel.lag, len(bound)), 1))
        return np.vstack([before, bound[: len(bound) - len(before)]])

    def from_rest(self, rows: Array, bound: Array | None = None) -> Array:
        """Return the tightening of rows by all channels at node L = 0 ... N + 1 and later, (N + 3, r).

        Parameters
        ----------
        rows : ndarray, shape (r, states)
        bound : ndarray, shape (m,) or (N + 2, m), optional
            Bound on the commands: of all periods, or period by period since the hand-over, not growing, the
            last for ever. Without it nothing that grows with commands counts.
        """
        return self._from_rest(self.carried(rows), bound)

    def largest(self, channel: Channel, bound: Array | None) -> Array:
        """Return the largest sizes of a channel under a bound on commands, shape (k,)."""
        if bound is None or np.ndim(bound) == 1:
            return self.sizes(channel, bound)
        return self.sizes(channel, self.u_max if channel.lag else bound[0])

    def _from_rest(self, carried: Array, bound: Array | None) -> Array:
        count = len(carried) - 1
        sums = np.zeros((count + 1, carried.shape[1]))
        for channel in self.closed.loop.channels:
            gains, constant = self.closed.gains(channel, carried[:-1]), channel.constant
            if constant is None:
                constant = np.zeros(1)
            else:  # the largest so far, so that tightenings do not fall
                response = np.abs(np.cumsum(carried[:-1] @ self.closed.held_map(channel), axis=0))
                sums[1:] += np.maximum.accumulate(response @ constant, axis=0)
            if channel.share is None or bound is None or np.ndim(bound) == 1:
                sums[1:] += np.cumsum(gains @ (self.largest(channel, bound) - constant), axis=0)
            else:
                sizes = self.sizes(channel, self.remembered_bound(channel, bound)[:count]) - constant
                sums += summed(gains, sizes)
        return np.vstack([sums, sums[-1] + np.abs(carried[-2]) @ self.reached(bound)]) * (1 + ROUNDING)

    def reached(self, bound: Array | None) -> Array:
        """Bound on every loop state for ever, from rest, under commands within a bound, shape (states,)."""
        each = zip(self.closed.loop.channels, self.reach, strict=True)
        parts = [gains @ self.largest(channel, bound) for channel, gains in each]
        return np.asarray(np.sum([np.zeros(self.closed.loop.N), *parts], axis=0))

    @cached_property
    def reach(self) -> tuple[Array, ...]:
        """Bounds on the loop states for ever, from rest, per unit of every channel's sizes, (states, k)."""
        return tuple(self._reach_of(channel) for channel in self.closed.loop.channels)

    def _reach_of(self, channel: Channel) -> Array:
        N = self.horizon
        rest = np.eye(self.closed.loop.N) - np.abs(self.transitions[N])
        each = self.closed.gains(channel, self.transitions[:N]).sum(axis=0)
        return np.asarray(np.linalg.solve(rest, each) * (1 + ROUNDING))

    def response(self, channel: Channel, rows: Array, plant: Array) -> "Response":
        """Return the response of rows (r, states) to a channel; `plant` (r, n) is their part in the plant."""
        carried, N, reach = self.carried(rows), self.horizon, self._reach_of(channel)
        older = np.abs(carried[N]) @ reach
        rates = self.carried(self.closed.rates)
        rate = self.closed.gains(channel, rates[:N]).sum(axis=0) + np.abs(rates[N]) @ reach
        push = self.closed.input_map(channel)
        if push is not None:
            rate = rate + np.abs(self.closed.loop.B) @ np.abs(push)
        between = self.curvature(plant) @ rate
        if channel.rate is not None:
            between = between + self.curvature(plant) @ np.abs(channel.rate)
        return Response(self.closed.gains(channel, carried[: N + 1]), older, between)

    def noise(self, bound: Array | None = None) -> Array:
        """Return the bound on the noise in a command of the same period, shape (m,)."""
        channels = self.closed.loop.channels
        parts = [self.closed.noise(channel) @ self.largest(channel, bound) for channel in channels]
        return np.asarray(np.sum([np.zeros(self.closed.loop.m), *parts], axis=0))

    def settled_bound(self, rounds: int = 500) -> Array:
        """Bound on the commands long after a hand-over, shape (m,): ``P >= tightening of K under P + noise``.

        Raises
        ------
        ScenarioError
            If errors that grow with commands feed on themselves.
        """
        K, P = self.carried(self.closed.K), np.zeros(self.closed.loop.m)
        for _ in range(rounds):
            needed = self._from_rest(K, P)[-1] + self.noise(P)
            if np.all(needed <= P):
                return P
            if np.any(needed > 1e6 * self.u_max):
                break
            P = needed * (1 + 1e-6)
        raise ScenarioError("thrusters", P.tolist(), "must be smaller: they amplify themselves")

    def between(self, rows: Array, bound: Array | None = None) -> tuple[Array, Array]:
        """Return intersample bounds of rows of the plant's error (docs/theory.md, Proposition 9 (d)).

        Over the period between two nodes a row is at most the chord of its bounds there, and besides this.

        Parameters
        ----------
        rows : ndarray, shape (r, n)
        bound : ndarray, shape (m,) or (N + 2, m), optional
            Bound on the commands (`from_rest`).

        Returns
        -------
        fixed : ndarray, shape (r,)
            For any errors at the hand-over.
        per_size : ndarray, shape (N + 2, r)
            Per unit of the norm at the hand-over, by lag.
        """
        loop, rates = self.closed.loop, self.closed.rates
        curvature = self.curvature(rows)
        carried, fixed = self.carried(rates), np.zeros(len(rows))
        rate = self._from_rest(carried, bound).max(axis=0)
        for channel in loop.channels:
            sizes, push = self.largest(channel, bound), self.closed.input_map(channel)
            if push is not None:
                size = np.linalg.norm(push, axis=1) * sizes[0] if channel.ball else np.abs(push) @ sizes
                rate = rate + np.abs(loop.B) @ size
            if channel.rate is not None:  # an addition within the period leaves its own chord
                gains = curvature @ np.abs(channel.rate)
                fixed = fixed + (np.linalg.norm(gains, axis=1) * sizes[0] if channel.ball else gains @ sizes)
        per_size = np.abs(carried) @ self.v @ curvature.T
        return (fixed + curvature @ rate) * (1 + ROUNDING), np.asarray(per_size * (1 + ROUNDING))

    def curvature(self, rows: Array) -> Array:
        """Return how far rows of the plant leave their chord per unit of a rate at a node, shape (r, n)."""
        loop = self.closed.loop
        return np.asarray(loop.h**2 / 8 * np.abs(rows @ loop.A) @ growth(loop.A, loop.h))


@dataclass(frozen=True, eq=False)
class Response:
    """Response of rows to one channel, a box, by age.

    Attributes
    ----------
    gains : ndarray, shape (N + 1, r, k)
        By the age of a period.
    older : ndarray, shape (r, k)
        Of all that is older than N periods.
    between : ndarray, shape (r, k)
        How far rows leave the chord between nodes, per unit of the largest size.
    """

    gains: Array
    older: Array
    between: Array

    def at_nodes(self, sizes: Array) -> Array:
        """Return the tightening at every node by sizes (count, k) per period from rest, (count + 1, r)."""
        added, N = summed(self.gains, sizes), len(self.gains) - 1
        added[N + 1 :] += self.older @ sizes.max(axis=0, initial=0.0)
        return np.asarray(added * (1 + ROUNDING))

    def ever(self, size: Array, until: int = 0, count: int = 1) -> Array:
        """Return the tightening from a node on by a size (k,) until `until` periods before it, (count, r)."""
        since = np.concatenate([np.cumsum(self.gains[-2::-1], axis=0)[::-1], 0 * self.gains[:1]])
        ages = np.minimum(until + np.arange(count), len(since) - 1)
        return np.asarray((since[ages] + self.older) @ size * (1 + ROUNDING))
