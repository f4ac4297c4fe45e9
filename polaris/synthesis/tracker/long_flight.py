"""Bound on what S spends in a long flight, by a storage function (docs/theory.md, Proposition 14 (d))."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft

from ...model.craft import Craft
from ...model.system import Array
from ..sources.thrusters import THRUSTERS
from .channel import Channel
from .loop import ClosedLoop

GRID = np.geomspace(3e-4, np.pi, 100)  # frequencies, per period, among which the worst of every input is
STEADY, FLOOR = 0.1, 1e-6
"""Least errors of thrusters and least weights, as shares of the largest, where weights are chosen."""
LOOSER, ATTEMPTS, PERIODS, SINES = 1.01, 120, 3000, 30
"""By how much weights rise until a storage lasts, how often at most, in how many periods it is there, and how
often the worst sine is looked for anew with the errors of thrusters that it leads to."""
LARGEST = 1e18  # beyond this a storage runs away
STRICT, SETTLED = 1e-5, 1e-7  # shares of a storage by which it grows every period, and has settled
SQUARED = 4  # how often the power of a response is squared whose coefficients bound its peak


@dataclass(frozen=True, eq=False)
class Inputs:
    """Values that enter a loop under one law in every period, and what its commands spend.

    Attributes
    ----------
    F, K : ndarray, shapes (N, N), (m, N)
        Transition of the loop state, and the command ``-K z`` beside its middle.
    enter, own : ndarray, shapes (N, k), (m, k)
        What values add to the next loop state and to the command. Those of a `group` (k,) have a 2-norm up to
        one. The last ones are errors of thrusters [N], in the same order for each part of the period: first
        those that do not grow with the deviation of commands, then those that do.
    held : int
        Number of the values before those.
    craft : Craft
        Source of the errors of thrusters and of the weights of what is spent.
    """

    F: Array
    K: Array
    enter: Array
    own: Array
    group: NDArray[np.intp]
    held: int
    craft: Craft

    @classmethod
    def of(
        cls, closed: ClosedLoop, craft: Craft, most: tuple[Array, Array], off: Array, moved: Array
    ) -> "Inputs":
        """Return those of a loop.

        Commands are up to the first of `most` (m,), and up to the second in the periods that errors remember.
        Estimates are off by some `off` (n,) besides, and rounding moves the error by `moved` (n,) in every
        period.
        """
        error, before = craft.thrusters.error(most[0]), np.minimum(most[1], craft.u_max)
        loop, enter, own, group = closed.loop, list[Array](), list[Array](), list[int]()
        rest = [moved + apart @ np.abs(craft.B) @ error for _, _, apart in loop.part_maps]

        def add(columns: Array, answers: Array | None, ball: bool = False) -> None:
            first, count = len(set(group)), columns.shape[1]
            group.extend([first] * count if ball else range(first, first + count))
            enter.append(columns)
            own.append(np.zeros((loop.m, count)) if answers is None else answers)

        for c in (*loop.channels, Channel("steps", off, noise=np.eye(loop.n))):
            if c.name == THRUSTERS:
                continue
            size = c.size if c.share is None else c.size + c.share(before)
            if c.rate is not None:
                along = np.linalg.norm(c.rate * size, axis=1) if c.ball else np.abs(c.rate) @ size
                for place, (carried, mean, apart) in enumerate(loop.part_maps):
                    add(carried @ mean @ c.rate * size, None, c.ball)
                    rest[place] = rest[place] + apart @ along
            if c.noise is not None or c.sample is not None or c.push is not None:
                seen = None if c.noise is None else -closed.gain @ c.noise * size
                add(closed.sampled(c) * size, seen, c.ball)
        for (carried, _, _), box in zip(loop.part_maps, rest, strict=True):
            add(carried * box, None)
        held = len(group)
        for carried, mean, _ in (*loop.part_maps, *loop.part_maps):
            add(carried @ mean @ craft.B, None)
        return cls(closed.F, closed.K, np.hstack(enter), np.hstack(own), np.array(group), held, craft)

    @cached_property
    def spends(self) -> Array:
        """Return what a unit of each command spends, errors of thrusters included, shape (m,)."""
        one, weights = np.eye(self.craft.m), self.craft.weights
        return np.asarray(weights + self.craft.on_time.summed(one) @ weights)

    @cached_property
    def squares(self) -> Array:
        """Return a bound on squares of errors of thrusters per squares of commands, shape (m, m)."""
        thrusters, each = self.craft.thrusters, self.craft.thrusters.summed(np.eye(self.craft.m)).T
        total = each.sum(axis=1, keepdims=True) if thrusters.shares else thrusters.along + thrusters.across
        return np.asarray(total * each)

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
        return np.asarray(b[self.held :].reshape(2, -1, len(self.K)).sum(axis=1))

    @cached_property
    def worst(self) -> tuple[Array, Array]:
        """Weights of commands (m,) and values (k,) of the worst sine, which need not be the worst flight."""
        m, z = len(self.K), np.exp(1j * GRID)[:, None, None]
        sine = np.linalg.solve(z * np.eye(len(self.F)) - self.F, self.enter + 0j * z)
        each = self.grouped(np.moveaxis(np.abs(-self.K @ sine + self.own), 2, 0))  # (groups, frequencies, m)
        number = self.group[self.held - 1] + 1
        known, made = each[:number].sum(axis=0), each[number:]
        size, r = np.array([self.bits, self.bits]), self.craft.u_max
        for _ in range(SINES):
            most = known + np.tensordot(np.repeat(size, len(made) // 2 // m, axis=0).ravel(), made, 1)
            r = np.maximum(most.max(axis=0), FLOOR * self.craft.u_max)
            size[1] = np.sqrt(self.squares @ r**2)
        b = np.einsum("ka,a->k", each[:, most.argmax(axis=0), np.arange(m)], self.spends)[self.group]
        b = np.maximum(b, FLOOR * b.max())
        usual = np.maximum(size, STEADY * size.max(axis=0)) + FLOOR * r
        b[self.held :] /= np.repeat(usual, len(made) // 2 // m, axis=0).ravel()
        return r, b

    def before(self, P: Array, r: Array, b: Array) -> tuple[Array, float] | None:
        """Return the storage at the start of a period, and what the period costs.

        Parameters
        ----------
        P : ndarray, shape (N, N)
            Storage at its end.
        r, b : ndarray, shapes (m,) and (k,)
            Weights of commands and values.

        Returns
        -------
        tuple or None
            None if the weights of values are too small, or the storage is too large.
        """
        (steady, made), N = self.errors(b), len(P)
        C = self.spends / r + made @ self.squares
        X, Y = np.hstack([self.F, self.enter]), np.hstack([-self.K, self.own])
        H = X.T @ P @ X + (Y.T * C) @ Y
        try:
            half = np.linalg.solve(np.linalg.cholesky(np.diag(b) - H[N:, N:]), H[N:, :N])
        except np.linalg.LinAlgError:
            return None
        first = np.unique(self.group[: self.held], return_index=True)[1]  # one weight for each group
        cost = self.spends @ r + b[first].sum() + steady @ self.bits**2
        P = H[:N, :N] + half.T @ half
        return ((P + P.T) / 2, float(cost) / 2) if P.max(initial=0.0) < LARGEST else None

    def lasting(self) -> tuple[Array, float] | None:
        """Return rows whose sum of squares is twice a storage that lasts, and what a period costs [N]."""
        r, b = self.worst
        for attempt in range(ATTEMPTS):
            scale, P = np.where(np.arange(len(b)) < self.held, LOOSER**attempt, 1.0), np.zeros_like(self.F)
            for _ in range(PERIODS):
                found = self.before(P, r * LOOSER**attempt, b * scale)
                if found is None:
                    break
                earlier, cost = found
                grown = earlier + STRICT * np.diag(np.diagonal(earlier) + FLOOR * earlier.max())
                size = np.sqrt(np.diagonal(grown))
                if np.all(np.abs(grown - P) <= SETTLED * np.outer(size, size)):
                    rows = np.linalg.cholesky(grown).T
                    return np.asarray(rows), cost * LOOSER  # a checker may need one more
                P = grown
        return None


def peak(responses: Array) -> float:
    """Bound the largest amplification of any frequency by responses together, (j, k): by a power of them."""
    power, root = np.sum([np.convolve(each, each[::-1]) for each in responses], axis=0), 2.0
    for _ in range(SQUARED):
        count = 2 * len(power) - 1
        size = next_fast_len(count, real=True)
        spectrum = rfft(power, size)
        with np.errstate(over="ignore", invalid="ignore"):  # of a law that runs away: no bound
            power, root = irfft(spectrum * spectrum, size)[:count], 2 * root
    return float(np.abs(power).sum() ** (1 / root))
