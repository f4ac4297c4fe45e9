"""Tubes of hybrid automata: every trajectory, at all times, with any transitions.

A worklist of start sets: those of a mode are followed at once, and what can take a transition is next.
Steps are enclosed continuously in time, guards and invariants cut, entry times kept as intervals.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..numerics.checks import (
    Array,
    as_count,
    as_numbers,
    check_fields,
    checked,
    require_positive,
    require_single,
)
from ..numerics.errors import ReachError
from ..sets.clipping import clip, hull_of, strips
from ..sets.convex import ConvexSet
from ..sets.zonotope import Zonotope
from ..tubes.flowpipes import Flowpipes, Propagator, flowpipes, input_response
from .automaton import HybridAutomaton, Mode, Transition
from .segments import HybridTube, Segment


@dataclass(frozen=True, eq=False)
class HybridOptions:
    """Settings of `reach.hybrid_tube`: steps, merging and reduction of start sets, limits.

    Parameters
    ----------
    step : float or mapping from mode names
        Longest time step.
    tolerance : array_like of shape (n,) or a number, or mapping from mode names, optional
        Steps are halved until the state leaves the set that joins two nodes by less than this.
    clusters : int or mapping from names of target modes, optional
        Start sets, each one stretch of time, into which all sets are merged that cross in one transition
        at one depth. By default nothing is merged: every step that crosses a guard becomes a
        start set of its own, and all of them are followed together.
    order : float
        Start sets with more than ``order * n`` generators are reduced.
    reduction : str
        Method of reduction; see `reach.sets.reduction`.
    jumps : int
        Most transitions of one trajectory. What would need more makes the tube incomplete.

    Raises
    ------
    ReachError
        If a number is not positive and finite, or the method of reduction is unknown.
    """

    step: float | Mapping[str, float]
    tolerance: ArrayLike | Mapping[str, ArrayLike] | None = None
    clusters: int | Mapping[str, int] | None = None
    order: float = 10.0
    reduction: str = "pca"
    jumps: int = 50

    def __post_init__(self) -> None:
        check_fields(self)
        for name in ("step", "tolerance", "clusters"):
            _require_positive(name, getattr(self, name))
        as_count("jumps", self.jumps)
        Zonotope.point([0.0]).reduce(self.order, self.reduction)  # refuses what it does not know

    def value(self, name: str, mode: Mode) -> Any:
        """An option for a mode; None if it has none."""
        value = getattr(self, name)
        return value.get(mode.name) if isinstance(value, Mapping) else value


@checked
def hybrid_tube(
    automaton: HybridAutomaton, initial: ConvexSet, horizon: float, options: HybridOptions
) -> HybridTube:
    """Enclose all trajectories of a hybrid automaton, continuously in time.

    Parameters
    ----------
    automaton : HybridAutomaton
    initial : ConvexSet
        A zonotope or a stack of them; of any other set the interval hull is taken.
    horizon : float
    options : HybridOptions

    Raises
    ------
    ReachError
        If the horizon is not positive and finite, a mode has no step, or dimensions differ.
    """
    require_positive("horizon", horizon)
    worklist = Worklist(automaton, float(horizon), options)
    pending = worklist.entries(initial)
    segments: list[Segment] = []
    for depth in range(options.jumps + 1):
        entered: list[Starts] = []
        for starts in pending:
            segment = worklist.follow(starts, depth)
            segments.append(segment)
            for transition in automaton.leaving(starts.mode.name):
                crossing = worklist.cross(segment, transition)
                entered += [crossing] if crossing is not None else []
        pending = worklist.gathered(entered)
        if not pending:
            break
    return HybridTube(tuple(segments), float(horizon), complete=not pending)


def _require_positive(name: str, setting: Any) -> None:
    """Refuse all that is not positive: a number (of a tolerance several), or a mapping from names to such."""
    for value in setting.values() if isinstance(setting, Mapping) else (setting,):
        if value is None:
            continue
        numbers = as_numbers(name, as_count(name, value) if name == "clusters" else value)
        several = numbers.ndim > (name == "tolerance") or isinstance(value, bool)
        if several or not np.all((numbers > 0) & np.isfinite(numbers)):
            raise ReachError(f"the {name} must be finite and > 0, got {value!r}")


@dataclass(frozen=True, eq=False)
class Starts:
    """Start sets of one mode: a stack, and the absolute times (N, 2) between which each may be entered."""

    mode: Mode
    sets: Zonotope
    entered: Array


@dataclass(frozen=True, eq=False)
class Worklist:
    """Arguments of `reach.hybrid_tube`, and the steps of its worklist."""

    automaton: HybridAutomaton
    horizon: float
    options: HybridOptions
    propagators: dict[str, Propagator] = field(default_factory=dict)

    def entries(self, initial: ConvexSet) -> list[Starts]:
        """The part of the initial set that the invariant of the first mode leaves, if any."""
        mode = self.automaton[str(self.automaton.start)]
        start = initial if isinstance(initial, Zonotope) else initial.interval_hull().to_zonotope()
        start = start if start.batch else Zonotope(start.c[None], start.G[None])
        require_single("the initial set", start[0], mode.system.dim)
        start, meets = clip(start, *strips([mode.invariant], mode.system.dim))
        return [Starts(mode, start[meets], np.zeros((int(meets.sum()), 2)))] if np.any(meets) else []

    def _flowpipes(self, mode: Mode, sets: Zonotope, length: float, **more: Any) -> Flowpipes:
        step = self.options.value("step", mode)
        if step is None:
            raise ReachError(f"mode {mode.name!r} has no step")
        if mode.name not in self.propagators:
            self.propagators[mode.name] = Propagator(mode.system)
        more |= {"step": step, "tolerance": self.options.value("tolerance", mode)}
        return flowpipes(self.propagators[mode.name], sets, length, **more)

    def _stay(self, starts: Starts | Segment) -> Array:
        """Longest time in the mode after each entry, shape (N,)."""
        a, b = starts.entered.T
        stay = self.automaton.longest_stay(starts.mode.name, a, b)
        return np.asarray(np.maximum(np.minimum(self.horizon - a, stay), 0.0))

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
        region = strips([segment.mode.invariant, t.guard], n)
        if t.window is not None or t.dwell is not None:
            sets, entered = self._timed(segment, t)
        else:
            k, i = np.nonzero(segment.alive & meets(segment.flowpipes, *region))
            sets, entered = segment.flowpipes.sets(k, i), np.minimum(segment.span(k, i), self.horizon)
        if len(sets) == 0:
            return None
        sets, nonempty = clip(sets, *region)
        sets, entered = sets[nonempty], entered[nonempty]
        sets = t.R @ sets + t.r
        if t.uncertain is not None:
            sets = sets + t.uncertain
        sets, nonempty = clip(sets, *strips([target.invariant], target.system.dim))
        return Starts(target, sets[nonempty], entered[nonempty]) if np.any(nonempty) else None

    def _timed(self, segment: Segment, t: Transition) -> tuple[Zonotope, Array]:
        """Sets over the local times at which a window or dwell time allows the transition."""
        a, b = segment.entered.T
        window = t.window or (0.0, self.horizon)
        dwell = t.dwell or (0.0, np.inf)
        # A start is dead from the beginning of its first step that misses the invariant.
        live_steps = segment.alive.sum(axis=0)
        death = segment.flowpipes.times[live_steps]
        first = np.maximum(np.maximum(window[0] - b, dwell[0]), 0.0)
        last = np.minimum(np.minimum(window[1] - a, dwell[1]), np.minimum(self._stay(segment), death))
        open_ = np.nonzero((first <= last) & (live_steps > 0))[0]
        first, last = first[open_], last[open_]
        plain = segment.flowpipes.start[open_].project(range(segment.mode.system.dim))
        if len(open_) == 0:
            return plain, np.zeros((0, 2))
        flow = self._flowpipes(segment.mode, plain, float((last - first).max()), offset=first)
        k, j = np.nonzero(flow.times[:-1, None] <= last - first)
        sets = flow.sets(k, j)
        if segment.mode.system.U and np.any(first):
            until = first[j] + np.minimum(flow.times[k + 1], (last - first)[j])
            sets = self._responding(sets, segment, until)
        low, high = a[open_][j] + first[j] + flow.times[k], b[open_][j] + first[j] + flow.times[k + 1]
        entered = np.stack([np.maximum(low, window[0]), np.minimum(high, window[1])], axis=-1)
        in_time = entered[:, 0] <= np.minimum(entered[:, 1], self.horizon)
        return sets[in_time], np.minimum(entered[in_time], self.horizon)

    def _responding(self, sets: Zonotope, segment: Segment, until: Array) -> Zonotope:
        """Add the response to the inputs; it grows with time, as the centred inputs hold zero."""
        if np.ptp(until) == 0:
            step = self.options.value("step", segment.mode)
            return sets + input_response(segment.mode.system, float(until[0]), step)
        k = np.searchsorted(segment.flowpipes.times, until * (1 - 1e-12)) - 1
        k = np.clip(k, 0, segment.flowpipes.shape[0] - 1)
        low, high = segment.flowpipes.low[k], segment.flowpipes.high[k]
        return (sets + (low + high) / 2).inflate((high - low) / 2)

    def gathered(self, entered: list[Starts]) -> list[Starts]:
        """Start sets to go on with, one entry per mode, merged and reduced."""
        pending = []
        for mode in self.automaton.modes:
            starts = [s for s in entered if s.mode is mode]
            if not starts:
                continue
            limit = self.options.value("clusters", mode)
            starts = [s if limit is None or len(s.sets) <= limit else _merged(s, int(limit)) for s in starts]
            width = max(s.sets.order_count for s in starts)
            padded = [s.sets._pad(width) for s in starts]
            sets = Zonotope(np.concatenate([p.c for p in padded]), np.concatenate([p.G for p in padded]))
            times = np.concatenate([s.entered for s in starts])
            used = np.any(sets.G != 0, axis=(0, 1))
            sets = Zonotope(sets.c, sets.G[..., used])
            pending.append(Starts(mode, sets.reduce(self.options.order, self.options.reduction), times))
        return pending


def meets(flow: Flowpipes, H: Array, low: Array, high: Array) -> NDArray[np.bool_]:
    """Return True for each step of each start that may meet ``low <= H x <= high``, shape (K, N)."""
    out = np.ones(flow.shape, dtype=bool)
    if len(H) == 0:
        return out
    bounds = flow.support(np.vstack([H, -H]))
    out &= np.all(bounds[..., : len(H)] >= low, axis=-1)
    return np.asarray(out & np.all(-bounds[..., len(H) :] <= high, axis=-1))


def _merged(starts: Starts, count: int) -> Starts:
    """Merge start sets into `count` hulls, each around those that are entered in one stretch of time."""
    times = starts.entered
    rank = np.argsort(times.sum(axis=1), kind="stable")
    groups = np.array_split(rank, count)
    hulls = Zonotope.stack([hull_of(starts.sets[g]) for g in groups])
    return Starts(starts.mode, hulls, np.array([[times[g, 0].min(), times[g, 1].max()] for g in groups]))
