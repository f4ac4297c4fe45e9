"""Bound on S's spending in a long flight, by a storage function (docs/theory.md, Proposition 14 (d))."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ...model.craft import Craft
from ...model.system import Array
from ..sources.thrusters import THRUSTERS
from .channel import Channel
from .loop import ClosedLoop, Loop

GRID = np.geomspace(3e-4, np.pi, 100)  # frequencies, per period, among which the worst of every input is
STEADY, FLOOR = 0.1, 1e-6
"""Least errors of thrusters and least weights, as shares of the largest, where weights are chosen."""
LOOSER, ATTEMPTS, PERIODS, SINES = 1.01, 120, 3000, 30
"""By how much weights rise until a storage lasts, how often at most, in how many periods it is there, and how
often the worst sine is looked for anew with the errors of thrusters that it leads to."""
LARGEST = 1e18  # beyond this a storage runs away
STRICT, SETTLED, LEAST = 1e-5, 1e-7, 1e-12  # of a storage: growth a period, change that ends, least entry
ORDER = "measurement", "disturbance", "bias", "impulse drift", "carried impulse", "pulses"
"""Channels in the order in which a certificate has the weights of their values; others come before them."""


@dataclass(frozen=True, eq=False)
class Storage:
    """Storage ``z' P z / 2 + p z`` of a loop state z, and a cost beside it [N]."""

    P: Array
    p: Array
    cost: float = 0.0

    @classmethod
    def from_matrix(cls, P: Array) -> "Storage":
        """Return a storage without a linear part."""
        return cls(P, np.zeros(len(P)))


@dataclass(frozen=True, eq=False)
class Inputs:
    """Values that enter a loop under one law in every period, and the spending of its commands.

    Attributes
    ----------
    F, K : ndarray, shapes (N, N), (m, N)
        Transition of the loop state, and the command ``-K z`` beside its middle.
    enter, feed : ndarray, shapes (N, k), (m, k)
        Maps from values to the next loop state and the command. Those of a `group` (k,) have a 2-norm up to
        one. The last ones are errors of thrusters [N], in the same order for each part of the period: first
        those that do not grow with the deviation of commands, then those that do.
    count : int
        Number of the values before errors of thrusters.
    craft : Craft
        Source of the errors of thrusters and of the weights of the spending.
    matrix : bool
        True if the loop state ends with a constant matrix of errors of thrusters. Commands are then twice as
        many: the thrust about the middle but for errors of the deviation, and the deviation. Errors
        that grow do so with the deviation alone.
    """

    F: Array
    K: Array
    enter: Array
    feed: Array
    group: NDArray[np.intp]
    count: int
    craft: Craft
    matrix: bool = False

    @classmethod
    def from_loop(
        cls,
        closed: ClosedLoop,
        craft: Craft,
        most: tuple[Array, Array],
        offset: Array,
        shift: Array,
        bands: Array | None = None,
    ) -> "Inputs":
        """Return those of a loop.

        Commands are up to the first of `most` (m,), and up to the second in the periods that errors remember.
        Estimates are off by some `offset` (n,) besides, and rounding moves the error by `shift` (n,) in every
        period. With `bands` (m,) commands are off by as much, input by input, instead of by estimate noise.
        """
        error, before = craft.thrusters.error(most[0]), np.minimum(most[1], craft.u_max)
        tops = np.minimum(most[0], craft.u_max)
        loop, enter, commands, group = closed.loop, list[Array](), list[Array](), list[int]()
        boxes = [shift + deviation @ np.abs(craft.B) @ error for _, _, deviation in loop.part_maps]

        def add(columns: Array, answers: Array | None, ball: bool = False) -> None:
            first, count = len(set(group)), columns.shape[1]
            group.extend([first] * count if ball else range(first, first + count))
            enter.append(columns)
            commands.append(np.zeros((loop.m, count)) if answers is None else answers)

        sources = *loop.channels, Channel("steps", offset, noise=np.eye(loop.n))
        channels = sorted((c for c in sources if c.name != THRUSTERS), key=_place)
        sizes = [c.size if c.share is None else c.size + c.share(before if c.lag else tops) for c in channels]
        if bands is not None:
            add(loop.held * bands, np.diag(bands))
            channels = [replace(c, noise=None) for c in channels]
        for c, size in zip(channels, sizes, strict=True):
            if c.noise is not None or c.sample is not None or c.push is not None:
                noise = None if c.noise is None else -closed.gain @ c.noise * size
                add(closed.sampled(c) * size, noise, c.ball)
        for (carried, mean, deviation), box in zip(loop.part_maps, boxes, strict=True):
            for c, size in zip(channels, sizes, strict=True):
                if c.rate is not None:
                    add(carried @ mean @ c.rate * size, None, c.ball)
                    along = np.linalg.norm(c.rate * size, axis=1) if c.ball else np.abs(c.rate) @ size
                    box = box + deviation @ along
            add(carried * box, None)
        start = len(group)
        for carried, mean, _ in (*loop.part_maps, *loop.part_maps):
            add(carried @ mean @ craft.B, None)
        return cls(closed.F, closed.K, np.hstack(enter), np.hstack(commands), np.array(group), start, craft)

    def about(self, loop: Loop, middle: Array) -> "Inputs":
        """Return the inputs of a loop that holds the matrix of its craft, commands having a middle (m,)."""
        (m, N), start, (rows, columns) = self.K.shape, self.count, np.nonzero(self.craft.matrix)
        product = np.eye(m)[:, rows] * middle[columns]  # the matrix times the middle
        applied = product * (rows == columns) if self.craft.timing.carried_impulse else product
        carried, number = carried_across(loop, self.craft), self.group[start - 1] + 1
        enter = np.insert(self.enter, [start], carried - self.F @ carried, axis=1)
        commands, added = np.insert(self.feed, [start], self.K @ carried, axis=1), np.arange(carried.shape[1])
        return Inputs(
            np.block([[self.F, loop.error_map @ product], [np.zeros((len(rows), N)), np.eye(len(rows))]]),
            np.block([[self.K, -applied], [self.K, 0 * product]]),
            np.vstack([enter, np.zeros((len(rows), enter.shape[1]))]),
            np.vstack([commands, commands]),
            np.concatenate([self.group[:start], number + added, self.group[start:] + len(added)]),
            start + len(added),
            self.craft,
            True,
        )

    @cached_property
    def spends(self) -> Array:
        """Return the spending per unit of each command, thruster errors included, shape (m,) or (2 m,)."""
        craft, errors, weights = self.craft, self.craft.on_time, self.craft.weights
        both = errors.summed(np.eye(craft.m)) @ weights
        if not self.matrix:
            return np.asarray(weights + both)
        across = both - errors.along
        if craft.timing.carried_impulse:  # thrust across is made in other periods than what it is a share of
            applied = weights + across / (1 - errors.along)
            return np.concatenate([applied, errors.along * applied])
        return np.concatenate([weights, both])

    @cached_property
    def squares(self) -> Array:
        """Return a bound on squares of errors of thrusters per squares of commands, (m, m) or (m, 2 m)."""
        thrusters, each = self.craft.thrusters, self.craft.thrusters.summed(np.eye(self.craft.m)).T
        total = each.sum(axis=1, keepdims=True) if thrusters.shares else thrusters.along + thrusters.across
        return np.hstack([*[0 * each] * self.matrix, total * each])

    @cached_property
    def bits(self) -> Array:
        """Return the errors of thrusters that do not grow with the deviation of commands, shape (m,)."""
        return np.full(self.craft.m, self.craft.thrusters.bit)

    def grouped(self, values: Array) -> Array:
        """Return root sums of squares of values (k, ...) by group."""
        total = np.zeros((self.group[-1] + 1, *values.shape[1:]))
        np.add.at(total, self.group, values**2)
        return np.sqrt(total)

    def errors(self, b: Array) -> Array:
        """Return weights of errors of thrusters: of those that are known, and of those that grow, (2, m)."""
        return np.asarray(b[self.count :].reshape(2, -1, self.craft.m).sum(axis=1))

    @cached_property
    def worst(self) -> tuple[Array, Array]:
        """Weights of commands (m,) and values (k,) of the worst sine, which need not be the worst flight."""
        m, z = len(self.K), np.exp(1j * GRID)[:, None, None]
        sine = np.linalg.solve(z * np.eye(len(self.F)) - self.F, self.enter + 0j * z)
        each = self.grouped(np.moveaxis(np.abs(-self.K @ sine + self.feed), 2, 0))  # (groups, frequencies, m)
        number = self.group[self.count - 1] + 1
        base, errors = each[:number].sum(axis=0), each[number:]
        size, r = np.array([self.bits, self.bits]), self.craft.u_max
        for _ in range(SINES):
            commanded = base + np.tensordot(np.repeat(size, len(errors) // 2 // m, axis=0).ravel(), errors, 1)
            r = np.maximum(commanded.max(axis=0), FLOOR * self.craft.u_max)
            size[1] = np.sqrt(self.squares @ r**2)
        b = np.einsum("ka,a->k", each[:, commanded.argmax(axis=0), np.arange(m)], self.spends)[self.group]
        b = np.maximum(b, FLOOR * b.max())
        typical = np.maximum(size, STEADY * size.max(axis=0)) + FLOOR * r
        b[self.count :] /= np.repeat(typical, len(errors) // 2 // m, axis=0).ravel()
        return r, b

    @cached_property
    def first(self) -> NDArray[np.intp]:
        """Return the first value of each group but those of errors of thrusters."""
        return np.asarray(np.unique(self.group[: self.count], return_index=True)[1])

    @cached_property
    def moves(self) -> tuple[Array, Array]:
        """Return maps of loop state and values into the next loop state and into commands."""
        return np.hstack([self.F, self.enter]), np.hstack([-self.K, self.feed])

    def before(self, after: "Storage", r: Array, b: Array, middle: Array | None = None) -> "Storage | None":
        """Return the storage at the start of a period.

        Parameters
        ----------
        after : Storage
            At its end.
        r, b : ndarray, shapes (m,) and (k,)
            Weights of commands and values.
        middle : ndarray, shape (m,), optional
            Command in the middle [N], zero without it.

        Returns
        -------
        Storage or None
            None if the weights of values are too small, or the storage is too large.
        """
        (steady, growing), N = self.errors(b), len(self.F)
        C = self.spends / r + growing @ self.squares
        X, Y = self.moves
        H = X.T @ after.P @ X + (Y.T * C) @ Y
        cost = self.spends @ r + b[self.first].sum() + steady @ self.bits**2
        h = X.T @ after.p
        if middle is not None:
            h, cost = h + Y.T @ (C * middle), cost + C @ middle**2
        try:
            factor = np.linalg.cholesky(np.diag(b) - H[N:, N:])
        except np.linalg.LinAlgError:
            return None
        half = np.linalg.solve(factor, np.column_stack([H[N:, :N], h[N:]]))
        both = half.T @ half
        P = H[:N, :N] + both[:N, :N]
        if not P.max(initial=0.0) < LARGEST:
            return None
        return Storage((P + P.T) / 2, h[:N] + both[:N, N], after.cost + float(cost + both[N, N]) / 2)

    def storage(self) -> tuple[Array, float] | None:
        """Return rows whose sum of squares is twice a storage that lasts, and the cost of a period [N]."""
        r, b = self.worst
        for attempt in range(ATTEMPTS):
            scale, P = np.where(np.arange(len(b)) < self.count, LOOSER**attempt, 1.0), np.zeros_like(self.F)
            for _ in range(PERIODS):
                earlier = self.before(Storage.from_matrix(P), r * LOOSER**attempt, b * scale)
                if earlier is None:
                    break
                enlarged = earlier.P + STRICT * np.diag(np.diagonal(earlier.P) + LEAST * earlier.P.max())
                size = np.sqrt(np.diagonal(enlarged))
                if np.all(np.abs(enlarged - P) <= SETTLED * np.outer(size, size)):
                    rows = np.linalg.cholesky(enlarged).T
                    return np.asarray(rows), earlier.cost * LOOSER  # a checker may need one more
                P = enlarged
        return None


def carried_across(loop: Loop, craft: Craft) -> Array:
    """Return the largest loop-state change by shares of carried impulses in other inputs, shape (N, k)."""
    moves = craft.timing.carried_impulse > 0 and np.any(craft.on_time.bit)
    return loop.error_map * craft.on_time.bit if moves else loop.error_map[:, :0]


def _place(channel: Channel) -> int:
    """Return the place of a channel among those of `ORDER`."""
    return ORDER.index(channel.name) + 1 if channel.name in ORDER else 0
