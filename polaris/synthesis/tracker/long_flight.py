"""Bound on what S spends in a long flight, by root mean squares (docs/theory.md, Proposition 14 (d))."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from ...model.system import Array
from ...model.tolerances import ROUNDING
from ..sources.thrusters import THRUSTERS
from .loop import Channel
from .tracking import Tracking

SQUARED = 4  # how often the power of a response is squared whose coefficients bound its peak
ROUNDS, RISES = 500, 1e-9
"""Most rounds until a bound holds that feeds on itself, and by what share each round raises it."""


@dataclass(frozen=True, eq=False)
class LongFlight:
    """Flight under S of any number of periods, whose commands nothing clips.

    Parameters
    ----------
    tracking : Tracking
        S's loop.
    start : ndarray, shape (N,)
        Bounds on the loop state at every node.
    most, more : ndarray, shape (m,)
        Bounds on all commands, and on what adds to each of them besides the loop.
    before : ndarray, shape (m,)
        Bound on the same commands and on those before that some channel remembers.
    """

    tracking: Tracking
    start: Array
    most: Array
    more: Array
    before: Array

    @cached_property
    def rows(self) -> Array:
        """Commands carried back, ``K F^l`` for l = 0 ... N - 1, shape (N, m, states)."""
        limits = self.tracking.tightening
        return limits.carried(limits.closed.K)[: limits.horizon]

    def mean(self) -> Array | None:
        """Bound the root mean square of commands, but for what the first state adds, shape (m,).

        The sum of the sizes of a command over any number of periods is at most that number times it. None if
        errors of thrusters feed on themselves.
        """
        limits, system = self.tracking.tightening, self.tracking.system
        given = self.more + np.abs(limits.carried(limits.closed.K)[limits.horizon]) @ self.start
        answer, steps = np.zeros((system.m, system.m)), self.tracking.step_errors[-1]
        for channel in (*limits.closed.loop.channels, Channel("steps", steps, noise=np.eye(system.n))):
            gains = self._amplified(channel)
            size = limits.sizes(channel, self.before if channel.lag else self.most)
            if channel.name == THRUSTERS:
                answer, size = gains, channel.size
            given = given + gains @ size
        return _fed(given, lambda U: answer @ system.thrusters.part(U))

    def once(self) -> Array | None:
        """Bound the sum over all periods of what the first state adds to each command, (m,), as `mean`."""
        closed, thrusters = self.tracking.tightening.closed, self.tracking.system.thrusters
        answer = np.zeros((closed.loop.m, closed.loop.m))
        for channel in closed.loop.channels:
            if channel.name == THRUSTERS:
                answer = self._summed(closed.gains(channel, np.eye(closed.loop.N)))
        return _fed(self._summed(self.start), lambda U: answer @ thrusters.summed(U))

    def _summed(self, states: Array) -> Array:
        """Bound the sum over all periods of commands from boxes of states (N, ...), shape (m, ...)."""
        limits, each = self.tracking.tightening, np.abs(self.rows).sum(axis=0)
        size = (states.T / limits.v).max(axis=-1)
        later = np.multiply.outer(each @ limits.v, size) * limits.factor / (1 - limits.factor)
        return np.asarray(each @ states + later)

    def _amplified(self, channel: Channel) -> Array:
        """Bound the root mean square of commands per unit of the values of a channel, (m, k) or (m, 1)."""
        closed, gains = self.tracking.tightening.closed, np.zeros((self.rows.shape[1], 1))
        if channel.rate is not None:
            rest, size = np.abs(self.rows).sum(axis=0), np.abs(channel.rate)
            size = np.linalg.norm(size, axis=1, keepdims=True) if channel.ball else size
            for carried, mean, apart in closed.loop.part_maps:
                gains = gains + _gains(-self.rows @ carried @ mean @ channel.rate, channel.ball)
                gains = gains + rest @ np.abs(carried) @ apart @ size
        if channel.noise is not None or channel.sample is not None or channel.push is not None:
            own = np.zeros((len(gains), len(channel.size)))
            if channel.noise is not None:
                own = -closed.gain @ channel.noise
            gains = gains + _gains(
                np.concatenate([own[None], -self.rows @ closed.sampled(channel)]), channel.ball
            )
        return gains


def _gains(response: Array, ball: bool) -> Array:
    """Bound the peak of the spectra of responses (periods, m, k): by column, or jointly, (m, 1)."""
    each = response.transpose(1, 2, 0)
    return np.array([[peak(row)] if ball else [peak(column[None]) for column in row] for row in each])


def _fed(given: Array, answer: Callable[[Array], Array]) -> Array | None:
    """Return U with ``U >= given + answer(U)``, shape (m,), or None."""
    U = given
    for _ in range(ROUNDS):
        more = given + answer(U)
        if np.all(more <= U):
            return np.asarray(U * (1 + ROUNDING))
        U = more * (1 + RISES)
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
