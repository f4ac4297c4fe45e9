"""Worklist of a hybrid tube: all start sets of a mode followed at once, and what crosses from them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..numerics.checks import Array
from ..numerics.errors import ReachError
from ..sets.clipping import clip, hull_of, strips
from ..sets.zonotope import Zonotope
from ..tubes.flowpipes import Flowpipes, Propagator, flowpipes, input_response
from .automaton import HybridAutomaton, Mode, Transition
from .segments import Segment, Starts


@dataclass(frozen=True, eq=False)
class Worklist:
    """What `reach.hybrid_tube` was asked for, and the steps of its worklist."""

    automaton: HybridAutomaton
    horizon: float
    step: Any
    tolerance: Any
    clusters: Any
    order: float
    reduction: str
    propagators: dict[str, Propagator] = field(default_factory=dict)

    def _of(self, value: Any, mode: Mode) -> Any:
        return value.get(mode.name) if isinstance(value, Mapping) else value

    def _flowpipes(self, mode: Mode, sets: Zonotope, length: float, **more: Any) -> Flowpipes:
        step = self._of(self.step, mode)
        if step is None:
            raise ReachError(f"mode {mode.name!r} has no step")
        if mode.name not in self.propagators:
            self.propagators[mode.name] = Propagator(mode.system)
        propagator = self.propagators[mode.name]
        return flowpipes(
            propagator, sets, length, step=step, tolerance=self._of(self.tolerance, mode), **more
        )

    def _stay(self, starts: Starts | Segment) -> Array:
        """Longest time in the mode after each entry, shape (N,).

        A window that may have ended before the entry binds nobody.
        """
        a, b = starts.entered.T
        until = self.horizon - a
        for t in self.automaton.leaving(starts.mode.name):
            if t.urgent and t.window is not None:
                until = np.minimum(until, np.where(b <= t.window[1], t.window[1] - a, np.inf))
            if t.urgent and t.dwell is not None:
                until = np.minimum(until, t.dwell[1])
        return np.asarray(np.maximum(until, 0.0))

    def follow(self, starts: Starts, depth: int) -> Segment:
        """Follow a mode until nothing is left of it."""
        mode, until = starts.mode, self._stay(starts)
        H, low, high = strips([mode.invariant], mode.system.dim)
        alive: list[NDArray[np.bool_]] = [np.ones((1, len(until)), dtype=bool)]

        def going(block: Flowpipes) -> NDArray[np.bool_]:
            inside = meets(block, H, low, high) & (block.times[:-1, None] <= until)
            inside = np.logical_and.accumulate(np.vstack([alive[-1][-1:], inside]))[1:]
            alive.append(inside)
            return np.asarray(inside[-1])

        flow = self._flowpipes(mode, starts.sets, float(until.max()), going=going)
        return Segment(mode, flow, starts.entered, np.concatenate(alive[1:]), depth)

    def cross(self, segment: Segment, t: Transition) -> Starts | None:
        """Start sets behind a transition; None if it cannot be taken."""
        n, target = segment.mode.system.dim, self.automaton[t.target]
        here = strips([segment.mode.invariant, t.guard], n)
        timed = t.window is not None or t.dwell is not None
        found = self._timed(segment, t) if timed else self._guarded(segment, here)
        if found is None:
            return None
        sets, entered = found
        sets, hit = clip(sets, *here)
        sets, entered = sets[hit], entered[hit]
        sets = t.R @ sets + t.r
        if t.uncertain is not None:
            sets = sets + t.uncertain
        sets, hit = clip(sets, *strips([target.invariant], target.system.dim))
        return Starts(target, sets[hit], entered[hit]) if np.any(hit) else None

    def _guarded(self, segment: Segment, here: tuple[Array, Array, Array]) -> tuple[Zonotope, Array] | None:
        k, i = np.nonzero(segment.alive & meets(segment.flowpipes, *here))
        if len(k) == 0:
            return None
        entered = np.minimum(segment.span(k, i), self.horizon)
        return segment.flowpipes.sets(k, i), entered

    def _timed(self, segment: Segment, t: Transition) -> tuple[Zonotope, Array] | None:
        """Sets over the local times at which a window or dwell time allows the transition."""
        a, b = segment.entered.T
        window = t.window or (0.0, self.horizon)
        dwell = t.dwell or (0.0, np.inf)
        # A start is dead from the beginning of its first step that misses the invariant.
        lasting = segment.alive.sum(axis=0)
        death = segment.flowpipes.times[lasting]
        first = np.maximum(np.maximum(window[0] - b, dwell[0]), 0.0)
        last = np.minimum(np.minimum(window[1] - a, dwell[1]), np.minimum(self._stay(segment), death))
        open_ = np.nonzero((first <= last) & (lasting > 0))[0]
        if len(open_) == 0:
            return None
        first, last = first[open_], last[open_]
        plain = segment.flowpipes.start[open_].project(range(segment.mode.system.dim))
        flow = self._flowpipes(segment.mode, plain, float((last - first).max()), offset=first)
        k, j = np.nonzero(flow.times[:-1, None] <= last - first)
        sets = flow.sets(k, j)
        if segment.mode.system.U and np.any(first):
            sets = self._responding(
                sets, segment, first[j] + np.minimum(flow.times[k + 1], (last - first)[j])
            )
        low, high = a[open_][j] + first[j] + flow.times[k], b[open_][j] + first[j] + flow.times[k + 1]
        entered = np.stack([np.maximum(low, window[0]), np.minimum(high, window[1])], axis=-1)
        keep = entered[:, 0] <= np.minimum(entered[:, 1], self.horizon)
        if not np.any(keep):
            return None
        return sets[keep], np.minimum(entered[keep], self.horizon)

    def _responding(self, sets: Zonotope, segment: Segment, until: Array) -> Zonotope:
        """Add the response to the inputs; it grows with time, as the centred inputs hold zero."""
        if np.ptp(until) == 0:
            step = self._of(self.step, segment.mode)
            response = input_response(segment.mode.system, float(until[0]), step)
            return sets + Zonotope(
                np.broadcast_to(response.c, sets.c.shape),
                np.broadcast_to(response.G, (*sets.c.shape, response.order_count)),
            )
        k = np.searchsorted(segment.flowpipes.times, until * (1 - 1e-12)) - 1
        k = np.clip(k, 0, segment.flowpipes.shape[0] - 1)
        low, high = segment.flowpipes.low[k], segment.flowpipes.high[k]
        return (sets + (low + high) / 2).inflate((high - low) / 2)

    def gathered(self, entered: list[Starts]) -> list[Starts]:
        """Start sets to go on with, one entry per mode, merged and reduced."""
        pending = []
        for mode in self.automaton.modes:
            same = [s for s in entered if s.mode is mode]
            if not same:
                continue
            most = self._of(self.clusters, mode)
            same = [s if most is None or len(s.sets) <= most else _merged(s, int(most)) for s in same]
            width = max(s.sets.order_count for s in same)
            padded = [s.sets._pad(width) for s in same]
            sets = Zonotope(np.concatenate([p.c for p in padded]), np.concatenate([p.G for p in padded]))
            times = np.concatenate([s.entered for s in same])
            used = np.any(sets.G != 0, axis=(0, 1))
            sets = Zonotope(sets.c, sets.G[..., used])
            pending.append(Starts(mode, sets.reduce(self.order, self.reduction), times))
        return pending


def meets(flow: Flowpipes, H: Array, low: Array, high: Array) -> NDArray[np.bool_]:
    """Whether each step of each start may meet strips, shape (K, N)."""
    out = np.ones(flow.shape, dtype=bool)
    if len(H) == 0:
        return out
    bounds = flow.support(np.vstack([H, -H]))
    out &= np.all(bounds[..., : len(H)] >= low, axis=-1)
    return np.asarray(out & np.all(-bounds[..., len(H) :] <= high, axis=-1))


def _merged(starts: Starts, most: int) -> Starts:
    """At most so many sets, each around those that are entered in one stretch of time."""
    times = starts.entered
    rank = np.argsort(times.sum(axis=1), kind="stable")
    groups = np.array_split(rank, most)
    hulls = Zonotope.stack([hull_of(starts.sets[g]) for g in groups])
    spans = [[times[g, 0].min(), times[g, 1].max()] for g in groups]
    return Starts(starts.mode, hulls, np.array(spans))
