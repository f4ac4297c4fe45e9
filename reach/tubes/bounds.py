"""Blocks of steps put together: sums, shifts of every input set, and the rounding that is booked."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from ..numerics.checks import Array
from .adjoint import Adjoint, Block, Overflow
from .known_input import known_response
from .rows import ROUNDING
from .systems import LinearSystem


@dataclass(frozen=True, eq=False)
class RowBounds:
    """Bounds along r rows over K steps.

    Attributes
    ----------
    times : ndarray, shape (K+1,)
    first, attained : ndarray, shape (K+1, r)
        Support of the initial set, moved on without unknown inputs, at the nodes; and what one of
        its points attains.
    driven : ndarray, shape (K+1, r)
        The part of it that a nominal input causes.
    kinks : ndarray, shape (K+1, r)
        By how much the slope of that part jumps at the nodes.
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
    attained: Array
    driven: Array
    kinks: Array
    upper: Array
    lower: Array
    bow: Array
    bend: Array
    rounding: Array
    rows: Array | None

    def every(self, s: int) -> RowBounds:
        """The same bounds with one node in s; steps must be alike within each group of s."""
        if s == 1:
            return self
        bow, bend = (s**2 * part.reshape(-1, s, part.shape[1]).max(axis=1) for part in (self.bow, self.bend))
        kinks = self.kinks[:-1].reshape(-1, s, self.kinks.shape[1])[:, 1:].sum(axis=1)
        bow = bow + np.diff(self.times[::s])[:, None] / 4 * kinks
        nodes = {name: getattr(self, name)[::s] for name in NODES if getattr(self, name) is not None}
        return replace(self, **nodes, bow=bow, bend=bend)


NODES = ("times", "first", "attained", "driven", "kinks", "upper", "lower", "rounding", "rows")
"""Fields of `RowBounds` that belong to nodes."""


def collect(
    adjoint: Adjoint,
    D: Array,
    horizon: float,
    blocks: Iterable[tuple[float, Block]],
    keep: bool,
    parts: int = 1,
) -> RowBounds:
    """Put blocks together: sums of the steps, shifted for every input set, and the rounding."""
    found: list[tuple[Array, ...]] = []
    begin: tuple[Array, ...] = ()
    for h, block in blocks:
        nodes = (block.first, block.attained, block.rows if keep else block.first, *block.size)
        begin = begin or tuple(node[:1] for node in nodes)
        between = (np.full(len(block.bow), h), block.upper, block.lower, block.bow, block.bend)
        found.append((*(node[1:] for node in nodes), *between))
    first, attained, rows, states, rates, steps, upper, lower, bow, bend = (
        np.concatenate(p) for p in zip(*found, strict=True)
    )
    nodes = (first, attained, rows, states, rates)
    first, attained, rows, states, rates = (np.concatenate([b, p]) for b, p in zip(begin, nodes, strict=True))
    # Where steps differ they are powers of two of the horizon, so that their sum is exact.
    times = np.r_[0.0, horizon * np.cumsum(steps / horizon)]
    if not np.ptp(steps):
        times = np.linspace(0, horizon, len(steps) + 1)
    starts, missed = piece_starts(adjoint.system, times, parts)
    rounding = booked(adjoint, D, times, steps, states, rates)
    # The rate of an integral between two nodes exceeds that at a node by its slope times half the step.
    slope = np.vstack([np.zeros((1, len(D))), 4 * bend.sum(axis=1) / steps[:, None]])
    rounding = rounding + missed * np.maximum.accumulate(rates + slope)
    if not (np.all(np.isfinite(rounding)) and np.all(np.isfinite(upper)) and np.all(np.isfinite(first))):
        raise Overflow("the bounds or their rounding are beyond floating point")
    motion, kinks = np.zeros((2, *first.shape))
    if adjoint.system.nominal is not None:
        by = known_response(adjoint.system, D, times, steps)
        motion, kinks, bow = by.values, by.kinks, bow + by.bow
    return RowBounds(
        times,
        first + motion,
        attained + motion,
        motion,
        kinks,
        totals(upper, starts),
        totals(lower, starts),
        bow,
        bends(bend, starts),
        rounding,
        rows / adjoint.rows.scale if keep else None,
    )


def booked(adjoint: Adjoint, D: Array, times: Array, steps: Array, states: Array, rates: Array) -> Array:
    """Bound on the rounding of the sum of both parts at the nodes, shape (K+1, r).

    What a step gets wrong, a share of the row it is applied to, is then carried on as the row is:
    it may grow although the row does not, where the row avoids a part of the system that grows.
    """
    lags = adjoint.rows.lags(float(steps.min()), times[-1])
    excess, rate = adjoint.rows.amplification(D * adjoint.rows.scale, lags, adjoint.weights, times[-1])
    grown = []
    for size, a, b in zip((states, rates), excess, rate, strict=True):
        with np.errstate(divide="ignore"):
            logs = np.maximum.accumulate(np.log(size) - b * times[:, None]) + b * times[:, None]
        grown.append(np.exp(np.minimum(logs + a, 700.0)))
    state, change = grown
    work = adjoint.system.dim + np.r_[0.0, np.cumsum(1 + steps * adjoint.rows.work)]
    total = np.vstack([np.zeros((1, len(D))), np.cumsum(steps[:, None] * change[1:], axis=0)])
    return np.asarray(ROUNDING * work[:, None] * (state + total))


def piece_starts(system: LinearSystem, times: Array, parts: int) -> tuple[list[int], float]:
    """Node at which every input set begins, and by how much all breaks lie off their nodes together.

    Between a break and the node it is moved to, the wrong set is taken: what that may add is booked.
    """
    starts, missed = [0], 0.0
    for b in system.breaks:
        if b >= times[-1]:
            starts.append(len(times))
            continue
        k = parts * int(np.argmin(np.abs(times[::parts] - b)))
        starts.append(k)
        missed += float(abs(times[k] - b))
    return starts, missed


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
