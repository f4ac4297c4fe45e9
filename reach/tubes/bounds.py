"""Blocks of steps put together: sums, shifts of every input set, and the rounding allowance."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..numerics.checks import Array
from ..numerics.errors import Unresolved
from .adjoint import Adjoint, Block, Overflow
from .known_input import KnownResponse
from .rows import ROUNDING
from .systems import LinearSystem


@dataclass(frozen=True, eq=False)
class RowBounds:
    """Bounds along r rows over K steps, some of which may be parts of one step that was asked for."""

    times: Array  # nodes, (K+1,)
    first: Array  # support of the initial set, moved on without unknown inputs, at the nodes, (K+1, r)
    attained: Array  # what one of its points attains there, (K+1, r)
    upper: Array  # support of the response to the inputs alone: bound, (K+1, r)
    lower: Array  # and attained value, (K+1, r)
    intersample: Array  # how far the first part exceeds the lines that join the nodes, (K, r)
    bend: Array  # and how far the response to the inputs does, (K, r)
    rounding: Array  # rounding allowance of the sum of the two parts, (K+1, r)
    driven: Array  # the part of `first` that a nominal input causes, (K+1, r)
    kinks: Array  # by how much the slope of that part jumps at the nodes, (K+1, r)
    rows: Array | None = None  # d e^{A t} at the nodes, if they were to be kept, (K+1, r, n)
    parts: int = 1

    @property
    def above(self) -> Array:
        """Bounds at the nodes, rounding included, shape (K+1, r)."""
        return self.first + self.upper + self.rounding

    @property
    def below(self) -> Array:
        """Values attained at the nodes, less the rounding, shape (K+1, r)."""
        return self.attained + self.lower - self.rounding

    @property
    def between(self) -> Array:
        """Bounds over the steps that were asked for, shape (K / parts, r)."""
        above = self.above
        over = np.maximum(above[1:], above[:-1]) + self.intersample + self.bend
        return np.asarray(over.reshape(-1, self.parts, over.shape[1]).max(axis=1))

    def coarse(self) -> RowBounds:
        """Return the bounds over the steps that were asked for."""
        s = self.parts
        if s == 1:
            return self
        intersample, bend = (
            s**2 * part.reshape(-1, s, part.shape[1]).max(axis=1) for part in (self.intersample, self.bend)
        )
        kinks = self.kinks[:-1].reshape(-1, s, self.kinks.shape[1])[:, 1:].sum(axis=1)
        intersample = intersample + np.diff(self.times[::s])[:, None] / 4 * kinks
        nodes: dict[str, Any] = {
            name: part[::s] for name, part in vars(self).items() if isinstance(part, np.ndarray)
        }
        return replace(self, **nodes | {"intersample": intersample, "bend": bend, "parts": 1})


@dataclass
class EffortBudget:
    """Count of computed numbers, the same on every machine, and its limit."""

    rest: float = np.inf

    def spend(self, numbers: float) -> None:
        """Take numbers from the rest of the count; `Unresolved` once there is none."""
        self.rest -= numbers
        if self.rest < 0:
            raise Unresolved("max_effort is exhausted; raise it, or the tolerance")


def collect(
    adjoint: Adjoint,
    D: Array,
    horizon: float,
    blocks: Iterable[tuple[float, Block]],
    keep: bool,
    parts: int = 1,
    response: KnownResponse | None = None,
) -> RowBounds:
    """Put blocks together: sums of the steps, shifted for every input set, the known motion, the rounding."""
    pairs = [(h, block if keep else replace(block, rows=block.first)) for h, block in blocks]

    def at_nodes(values: list[Array]) -> Array:
        return np.concatenate([values[0], *(part[1:] for part in values[1:])])

    first, attained, rows = (
        at_nodes([getattr(block, name) for _, block in pairs]) for name in ("first", "attained", "rows")
    )
    states, rates = (at_nodes([block.size[i] for _, block in pairs]) for i in (0, 1))
    steps = np.repeat([h for h, _ in pairs], [len(block.intersample) for _, block in pairs])
    upper, lower, intersample, bend = (
        np.concatenate([getattr(block, name) for _, block in pairs])
        for name in ("upper", "lower", "intersample", "bend")
    )
    # Where steps differ they are powers of two of the horizon, so that their sum is exact.
    times = np.r_[0.0, horizon * np.cumsum(steps / horizon)]
    if not np.ptp(steps):
        times = np.linspace(0, horizon, len(steps) + 1)
    starts, misfit = _piece_starts(adjoint.system, times, parts)
    rounding = _rounding(adjoint, D, times, steps, states, rates)
    # The rate of an integral between two nodes exceeds that at a node by its slope times half the step.
    slope = np.vstack([np.zeros((1, len(D))), 4 * bend.sum(axis=1) / steps[:, None]])
    rounding = rounding + misfit * np.maximum.accumulate(rates + slope)
    if not (np.all(np.isfinite(rounding)) and np.all(np.isfinite(upper)) and np.all(np.isfinite(first))):
        raise Overflow("the bounds or their rounding are beyond floating point")
    motion, kinks = np.zeros((2, *first.shape))
    if response is not None:
        motion, kinks, intersample = response.values, response.kinks, intersample + response.intersample
    node_rows = rows / adjoint.rows.scale if keep else None
    upper, lower, bend = _totals(upper, starts), _totals(lower, starts), _bends(bend, starts)
    first, attained = first + motion, attained + motion
    return RowBounds(
        times, first, attained, upper, lower, intersample, bend, rounding, motion, kinks, node_rows, parts
    )


def _rounding(adjoint: Adjoint, D: Array, times: Array, steps: Array, states: Array, rates: Array) -> Array:
    """Bound on both parts' rounding at nodes, (K+1, r); a step's error is carried on, and grows."""
    lags = adjoint.rows.lags(float(steps.min()), times[-1])
    excess, rate = adjoint.rows.amplification(D * adjoint.rows.scale, lags, adjoint.weights, times[-1])
    sizes = []
    for size, a, b in zip((states, rates), excess, rate, strict=True):
        with np.errstate(divide="ignore"):
            logs = np.maximum.accumulate(np.log(size) - b * times[:, None]) + b * times[:, None]
        sizes.append(np.exp(np.minimum(logs + a, 700.0)))
    state, change = sizes
    work = adjoint.system.dim + np.r_[0.0, np.cumsum(1 + steps * adjoint.rows.work)]
    total = np.vstack([np.zeros((1, len(D))), np.cumsum(steps[:, None] * change[1:], axis=0)])
    return np.asarray(ROUNDING * work[:, None] * (state + total))


def _piece_starts(system: LinearSystem, times: Array, parts: int) -> tuple[list[int], float]:
    """Node at which every input set begins, and by how much all breaks lie off their nodes together."""
    starts, misfit = [0], 0.0
    for b in system.breaks:
        if b >= times[-1]:
            starts.append(len(times))
            continue
        k = parts * int(np.argmin(np.abs(times[::parts] - b)))
        starts.append(k)
        misfit += float(abs(times[k] - b))
    return starts, misfit


def _totals(steps: Array, starts: list[int]) -> Array:
    """Integral of the inputs at every node, (K+1, r): each set acted over the lags ``t - e`` to ``t - b``."""
    K, pieces, r = steps.shape
    sums = np.concatenate([np.zeros((1, pieces, r)), np.cumsum(steps, axis=0)])
    totals, k = np.zeros((K + 1, r)), np.arange(K + 1)
    for i in range(pieces):
        totals += sums[np.maximum(k - starts[i], 0), i]
        if i + 1 < pieces:
            totals -= sums[np.maximum(k - starts[i + 1], 0), i]
    return totals


def _bends(bend: Array, starts: list[int]) -> Array:
    """Intersample bound of the integral, shape (K, r): the rates at both ends of every set's lags."""
    K, pieces, r = bend.shape
    bounds = np.zeros((K, r))
    for i in range(pieces):
        for start in starts[i : i + 2]:
            bounds[start:] += bend[: max(K - start, 0), i]
    return bounds
