"""Sets that the channels of a loop add in one period, as generators."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from reach.numerics.linear import discretize
from reach.sets.ellipsoid import ball_generators

from .channel import Channel
from .loop import Array, ClosedLoop, Loop

Sized = Sequence[tuple[Channel, Array]]
"""Channels, each with the half-widths of its box, or the radius of its ball, in the period."""


_ball = lru_cache(maxsize=64)(ball_generators)


def spread(channel: Channel, size: Array, columns: int) -> Array:
    """Return generators, shape (columns, g), of a set that holds the values of a channel."""
    return _ball(columns, float(size[0])) if channel.ball else np.diag(size)


def rates_added(loop: Loop, channels: Sized) -> Array:
    """Return generators of the effect of measurable values on the next loop state via rates, (N, g).

    The effect of a part of the period on the plant enters all loop states with the same generators: the
    mean of the values lies in their set, the rest is bounded (docs/theory.md, Proposition 9 (c)).
    """
    columns = [np.zeros((loop.N, 0))]
    for carried, mean, deviation in loop.part_maps:
        parts, rate = [], np.zeros(loop.n)
        for channel, size in channels:
            if channel.rate is not None and np.any(size):
                M = channel.rate
                parts.append(mean @ M @ spread(channel, size, M.shape[1]))
                rate = rate + (np.linalg.norm(M, axis=1) * size[0] if channel.ball else np.abs(M) @ size)
        if parts:
            columns.append(carried @ np.hstack([*parts, np.diag(deviation @ rate)]))
    return np.hstack(columns)


def sampled_added(closed: ClosedLoop, channels: Sized) -> Array:
    """Return generators of the effect of values that hold for a period on the next loop state, (N, g)."""
    columns = [np.zeros((closed.loop.N, 0))]
    for channel, size in channels:
        if np.any(size) and (effect := closed.sampled(channel)).any():
            columns.append(effect @ spread(channel, size, effect.shape[1]))
    return np.hstack(columns)


def within_period(loop: Loop, channels: Sized) -> Array:
    """Bound the effect of measurable values on the plant at any instant of the period, shape (n,)."""
    total, size_A = np.zeros(loop.n), np.abs(loop.A)
    for channel, size in channels:
        if channel.rate is not None:
            reached = discretize(size_A, np.abs(channel.rate), loop.h)[1]
            total = total + (reached.sum(axis=1) * size[0] if channel.ball else reached @ size)
    return total


def held_rates(closed: ClosedLoop, channels: Sized) -> Array:
    """Bound the rate of the plant's states due to values that hold for a period, shape (n,)."""
    B, total = np.abs(closed.loop.B), np.zeros(closed.loop.n)
    for channel, size in channels:
        if (push := closed.input_map(channel)) is not None:
            total = total + B @ np.abs(push @ spread(channel, size, push.shape[1])).sum(axis=1)
    return total
