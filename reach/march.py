"""Marching over time: blocks of steps, of one length or as long as a tolerance allows, put together."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .adjoint import ROUNDING, Adjoint, Block
from .errors import ReachError
from .systems import LinearSystem

Array = NDArray[np.float64]

MAX_STEPS = 10_000_000
BLOCK = 64
"""Steps that are carried together when their length may change."""
ENTRIES = 100_000
"""Entries of all rows that are carried together when it does not."""
SHARE = 0.01
"""Tolerance if none is given, as a share of the largest support."""
FINEST = 2.0**-40
"""Shortest step of the automatic choice, as a share of the horizon."""


@dataclass(frozen=True, eq=False)
class March:
    """Bounds along r rows over K steps.

    Attributes
    ----------
    times : ndarray, shape (K+1,)
    first : ndarray, shape (K+1, r)
        Support of the initial set alone, at the nodes.
    upper, lower : ndarray, shape (K+1, r)
        Support of the response to the inputs alone: bound and attained value.
    bow, bend : ndarray, shape (K, r)
        How far the two parts may exceed the lines that join the nodes.
    rounding : ndarray, shape (K+1, r)
        Booked rounding of the sum of the two parts.
    rows : ndarray, shape (K+1, r, n), or None
        ``d e^{A t}`` at the nodes, if they were to be kept.
    """

    times: Array
    first: Array
    upper: Array
    lower: Array
    bow: Array
    bend: Array
    rounding: Array
    rows: Array | None

    def every(self, s: int) -> March:
        """The same bounds with one node in s; steps must be alike within each group of s."""
        if s == 1:
            return self
        coarse = [s**2 * part.reshape(-1, s, part.shape[1]).max(axis=1) for part in (self.bow, self.bend)]
        return March(
            self.times[::s],
            self.first[::s],
            self.upper[::s],
            self.lower[::s],
            coarse[0],
            coarse[1],
            self.rounding[::s],
            None if self.rows is None else self.rows[::s],
        )


def march(
    adjoint: Adjoint,
    D: Array,
    horizon: float,
    step: float | None,
    tolerance: ArrayLike | None,
    limit: ArrayLike | None = None,
    keep: bool = False,
    substeps: int = 1,
) -> March:
    """Carry rows D over the horizon, with a step (in substeps) or by a tolerance (see `support_tube`)."""
    if not (np.isfinite(horizon) and horizon > 0):
        raise ReachError(f"the horizon must be a finite number > 0, got {horizon!r}")
    if step is not None and tolerance is not None:
        raise ReachError("give a step or a tolerance, not both")
    if adjoint.system.discrete:
        if horizon != round(horizon):
            raise ReachError(f"a discrete system needs a whole number of steps, got {horizon!r}")
        step = 1.0
    if step is None and adjoint.pieces > 1:
        raise ReachError("an input that changes its set needs a step, one that divides its breaks")
    if step is not None:
        return collect(adjoint, D, horizon, regular(adjoint, D, horizon, step, substeps), keep)
    if tolerance is None:
        first = collect(
            adjoint, D, horizon, regular(adjoint, D, horizon, first_step(adjoint, horizon), 1), keep
        )
        size = np.maximum(np.abs(first.first) + np.abs(first.lower), np.finfo(float).tiny).max(axis=0)
        tolerance = SHARE * size
        error = (first.upper - first.lower).max(axis=0) + (first.bow + first.bend).max(axis=0)
        if np.all(error <= tolerance):
            return first
    return collect(adjoint, D, horizon, adaptive(adjoint, D, horizon, tolerance, limit), keep)


def first_step(adjoint: Adjoint, horizon: float) -> float:
    """A step in which the fastest row turns by about a radian, at least 64 and at most 4096 of them."""
    return horizon / float(np.clip(horizon * _norm(adjoint), 64, 4096))


def substeps(adjoint: Adjoint, step: float | None) -> int:
    """Parts, a power of two up to 16, that a given step is carried in so that little turns in one."""
    if step is None or adjoint.system.discrete:
        return 1
    return int(2 ** np.clip(np.ceil(np.log2(max(2 * step * _norm(adjoint), 1.0))), 0, 4))


def _norm(adjoint: Adjoint) -> float:
    return float(np.max(np.asarray(abs(adjoint.rows.A).sum(axis=1))))


def regular(
    adjoint: Adjoint, D: Array, horizon: float, step: float, parts: int
) -> Iterator[tuple[float, Block]]:
    """Blocks with one step length, each with that length; every step asked for in some parts."""
    if not (np.isfinite(step) and step > 0):
        raise ReachError(f"the step must be a finite number > 0, got {step!r}")
    if horizon / step > MAX_STEPS:
        raise ReachError(f"more than {MAX_STEPS:,} steps: horizon {horizon:g}, step {step:g}")
    count = max(int(np.ceil(horizon / step * (1 - 1e-12))), 1) * parts
    h, rows = horizon / count, D * adjoint.rows.scale
    size = int(np.clip(ENTRIES // D.size, BLOCK, count))
    for k in range(0, count, size):
        block = adjoint.block(rows, h, min(size, count - k))
        yield h, block
        rows = block.rows[-1]


def adaptive(
    adjoint: Adjoint, D: Array, horizon: float, tolerance: float | ArrayLike, limit: ArrayLike | None
) -> Iterator[tuple[float, Block]]:
    """Blocks whose steps are a half, a quarter, ... of the horizon, as short as the tolerance asks.

    Half of the tolerance is for the integral of the inputs, spent in proportion to time but never
    less than a twentieth of what is left on one block; half for the bow between nodes.
    """
    rows = D * adjoint.rows.scale
    tol = np.broadcast_to(np.asarray(tolerance, dtype=float), (len(D),))
    if not np.all(tol > 0):
        raise ReachError(f"the tolerance must be > 0, got {tolerance!r}")
    ceiling = np.full(len(D), -np.inf) if limit is None else np.asarray(limit, dtype=float)
    level = int(np.clip(np.ceil(np.log2(max(horizon * _norm(adjoint), 1.0))), 0, 40))
    done, reached, left, patience = 0.0, np.zeros(len(D)), tol / 2, 0
    while done < 1:
        h = 2.0**-level
        count = int(min(BLOCK, round((1 - done) / h)))
        block = adjoint.block(rows, h * horizon, count)
        gain, loss = block.upper.sum(axis=1), (block.upper - block.lower).sum(axis=(0, 1))
        node = block.first + reached + np.vstack([np.zeros(len(D)), np.cumsum(gain, axis=0)])
        room = np.maximum(tol / 2, ceiling - np.maximum(node[1:], node[:-1]))
        bow = np.max((block.bow + block.bend.sum(axis=1)) / room)
        share = left * np.maximum(count * h / (1 - done), 0.05)
        error = float(max(bow, np.max(loss / share)))
        if error > 1 and h > FINEST:
            level += 1 + (error > 16) + (error > 256)
            patience = 4  # blocks before a longer step is tried again
            continue
        if error > 1 or not np.isfinite(error):
            raise ReachError(f"no step is short enough for the tolerance {tolerance!r}")
        yield h * horizon, block
        done, reached, left = done + count * h, reached + gain.sum(axis=0), left - loss
        rows, patience = block.rows[-1], patience - 1
        easy = error < 0.01 or (error < 0.1 and patience <= 0)
        if easy and level > 0 and (done * 2.0 ** (level - 1)).is_integer():
            level -= 1


def collect(
    adjoint: Adjoint, D: Array, horizon: float, blocks: Iterable[tuple[float, Block]], keep: bool
) -> March:
    """Put blocks together: sums of the steps, shifted for every input set, and the rounding."""
    parts: list[tuple[Array, ...]] = []
    begin: tuple[Array, ...] = ()
    for h, block in blocks:
        nodes = (block.first, block.size[0], block.rows if keep else block.first)
        begin = begin or tuple(node[:1] for node in nodes)
        between = (np.full(len(block.bow), h), block.upper, block.lower, block.bow, block.bend)
        parts.append((*(node[1:] for node in nodes), *between, block.size[1, :-1]))
    first, size, rows, steps, upper, lower, bow, bend, added = (
        np.concatenate(p) for p in zip(*parts, strict=True)
    )
    first, size, rows = (np.concatenate([b, p]) for b, p in zip(begin, (first, size, rows), strict=True))
    times = np.r_[0.0, np.cumsum(steps)] if np.ptp(steps) else np.linspace(0, horizon, len(steps) + 1)
    times[-1] = horizon
    starts = piece_starts(adjoint.system, times)
    k = np.arange(len(times))[:, None]
    sums = np.vstack([np.zeros((1, len(D))), np.cumsum(added, axis=0)])
    rounding = ROUNDING * (adjoint.system.dim + k) * (np.maximum.accumulate(size) + sums)
    return March(
        times,
        first,
        totals(upper, starts),
        totals(lower, starts),
        bow,
        bends(bend, starts),
        rounding,
        rows / adjoint.rows.scale if keep else None,
    )


def piece_starts(system: LinearSystem, times: Array) -> list[int]:
    """Node at which every input set begins."""
    starts = [int(np.argmin(np.abs(times - b))) for b in (0.0, *system.breaks)]
    for b, k in zip(system.breaks, starts[1:], strict=True):
        if b < times[-1] and abs(times[k] - b) > 1e-9 * times[-1]:
            raise ReachError(f"the break at {b:g} is not a node: the step must divide it")
    return [k if b < times[-1] else len(times) for k, b in zip(starts, (0.0, *system.breaks), strict=True)]


def totals(steps: Array, starts: list[int]) -> Array:
    """Integral of the inputs at every node from what the steps add per input set, shape (K+1, r).

    At time t the set that begins at b and ends at e has acted over the lags ``t - e`` to ``t - b``.
    """
    K, pieces, r = steps.shape
    sums = np.concatenate([np.zeros((1, pieces, r)), np.cumsum(steps, axis=0)])
    out, k = np.zeros((K + 1, r)), np.arange(K + 1)
    for i in range(pieces):
        out += sums[np.maximum(k - starts[i], 0), i]
        if i + 1 < pieces:
            out -= sums[np.maximum(k - starts[i + 1], 0), i]
    return out


def bends(bend: Array, starts: list[int]) -> Array:
    """Bow of the integral between nodes, shape (K, r): the rates at both ends of every set's lags."""
    K, pieces, r = bend.shape
    out = np.zeros((K, r))
    for i in range(pieces):
        for start in starts[i : i + 2]:
            out[start:] += bend[: max(K - start, 0), i]
    return out
