"""Staying in a polytope: one tube along its normals, sharper where it must be."""

from __future__ import annotations

from fractions import Fraction
from math import lcm
from time import perf_counter
from typing import Any

import numpy as np

from ..numerics.checks import Array
from ..numerics.errors import Unresolved
from ..sets.convex import ConvexSet
from ..sets.polytope import HPolytope
from ..tubes.support_tube import SupportTube, support_tube
from ..tubes.systems import LinearSystem
from ..tubes.trajectory import Trajectory, worst_case
from .specification import Verdict

REPLAY = 1e-9
"""A replayed trajectory must pass a limit by this share of its size before it counts as a violation."""

SHARPER = 8.0
"""Factor by which the tolerance shrinks while neither proof nor violation is found."""

FIRST, LAST = 0.05, 1e-7
"""First and last tolerance, as shares of the size of the quantity bounded."""

GRID = 10_000
"""Most steps that a first grid takes to have every change of the input set on a node."""


def visited(system: LinearSystem, initial: ConvexSet, horizon: float, deadline: float) -> Array:
    """Largest absolute values of the states over the horizon, never too small, shape (n,)."""
    axes = np.vstack([np.eye(system.dim), -np.eye(system.dim)])
    if horizon == 0:
        most = initial.support(axes)
    else:
        step = {"step": horizon / 64} if len(system.U) > 1 and not system.discrete else {}
        seconds = deadline - perf_counter()
        most = support_tube(system, initial, horizon, axes, max_seconds=seconds, **step).most
    return np.asarray(np.maximum(most[: system.dim], most[system.dim :]).clip(min=0))


def verify_always(
    system: LinearSystem,
    initial: ConvexSet,
    region: HPolytope,
    window: tuple[float, float],
    begun: float,
    deadline: float,
) -> Verdict:
    """`verify` for a region to stay in: one tube along its normals, sharper where it must be."""
    C, limits = region.A, region.b
    size = np.maximum(np.abs(limits), np.maximum(initial.support(C), initial.support(-C)))
    size = np.where(size > 0, size, 1.0)
    bounds, reached = np.full(len(C), np.inf), np.full(len(C), -np.inf)
    share, steps, path, reason = FIRST, 0, None, ""

    def verdict(status: str, margin: float) -> Verdict:
        return Verdict(status, margin, bounds, reached, path, steps, perf_counter() - begun, reason)

    while True:
        rows = np.nonzero(~(bounds <= limits))[0]
        if len(rows) == 0:
            margin = float(np.min((limits - bounds) / np.linalg.norm(C, axis=1)))
            reason = f"every bound keeps {margin:.6g} from its limit"
            return verdict("proven", margin)
        if share < LAST:
            gap = np.max((np.abs(bounds - reached) / size)[rows])
            reason = f"bounds and trajectories are within {gap:.1g} of each other and of the limit"
            return verdict("unknown", np.nan)
        # At a single instant, which is a node, nothing between nodes matters.
        between = limits[rows] if window[0] < window[1] else np.full(len(rows), np.inf)
        try:
            tube = sharp_tube(system, initial, window[1], C[rows], share * size[rows], between, deadline)
        except Unresolved as exc:
            reason = f"neither proven nor violated: {exc}"
            return verdict("unknown", np.nan)
        steps = len(tube.times) - 1
        bounds[rows], instants, reached[rows] = extremes(tube, window, system.discrete)
        broken = np.nonzero(reached > limits)[0]
        if len(broken):
            row = int(broken[np.argmax((reached - limits)[broken] / size[broken])])
            instant = float(instants[rows.tolist().index(row)])
            excess = float(reached[row] - limits[row])
            path = sharp_worst_case(system, initial, instant, C[row], excess / 2, window[1] / max(steps, 1))
            value = float(C[row] @ path.states[-1])
            if value > limits[row] + REPLAY * size[row]:
                reason = f"row {row} reaches {value:.6g} at t = {instant:.6g}, its limit is {limits[row]:.6g}"
                return verdict("violated", float((limits[row] - value) / np.linalg.norm(C[row])))
            path = None
        share /= SHARPER


def sharp_tube(
    system: LinearSystem,
    initial: ConvexSet,
    horizon: float,
    C: Array,
    tolerance: Array,
    limits: Array,
    deadline: float = np.inf,
) -> SupportTube:
    """A tube as sharp as a tolerance asks; with several input sets, equal steps short enough for it.

    Raises
    ------
    Unresolved
        If that takes too many steps, or longer than the deadline.
    """
    if horizon == 0:
        start, none = initial.support(C)[None], np.zeros((0, len(C)))
        return SupportTube(np.zeros(1), C, start, start, none, none)
    if len(system.U) < 2 or system.discrete:
        how: dict[str, Any] = {} if system.discrete else {"tolerance": tolerance, "limit": limits}
        return support_tube(system, initial, horizon, C, max_seconds=deadline - perf_counter(), **how)
    step = horizon / _grid(system.breaks[system.breaks < horizon] / horizon)
    while True:
        tube = support_tube(system, initial, horizon, C, step=step, max_seconds=deadline - perf_counter())
        loose = np.maximum((tube.upper - tube.attained).max(axis=0), tube.bow.max(axis=0))
        if np.all(loose <= tolerance):
            return tube
        step /= 2


def _grid(shares: Array) -> int:
    """Least number of equal parts of [0, 1] that has all shares at its nodes, if there is a small one."""
    near = [Fraction(share).limit_denominator(GRID) for share in shares]
    count = lcm(*(share.denominator for share in near))
    return count if count <= GRID else 64


def sharp_worst_case(
    system: LinearSystem, initial: ConvexSet, horizon: float, d: Array, tolerance: float, step: float
) -> Trajectory:
    """`worst_case` by a tolerance; with the step of the tube where that cannot be."""
    if system.discrete:
        return worst_case(system, initial, horizon, d)
    if len(system.U) < 2:
        try:
            return worst_case(system, initial, horizon, d, tolerance=tolerance)
        except Unresolved:
            pass
    return worst_case(system, initial, horizon, d, step=step)


def extremes(tube: SupportTube, window: tuple[float, float], discrete: bool) -> tuple[Array, Array, Array]:
    """Bounds over a window, where it is reached most, and what is attained there, each (r,)."""
    bounds = seen(tube, window, discrete)[1].max(axis=0)
    inside = np.nonzero((tube.times >= window[0]) & (tube.times <= window[1]))[0]
    if len(inside) == 0:
        nowhere = np.full(len(bounds), -np.inf)
        return bounds, nowhere, nowhere
    best = inside[np.argmax(tube.attained[inside], axis=0)]
    return bounds, tube.times[best], tube.attained[best, np.arange(len(bounds))]


def seen(tube: SupportTube, window: tuple[float, float], discrete: bool) -> tuple[Array, Array]:
    """Times, one each, and bounds (k, r) of what covers a window: intervals, or nodes where those are all."""
    before, after = tube.times[:-1], tube.times[1:]
    if discrete or len(before) == 0:
        inside = (tube.times >= window[0]) & (tube.times <= window[1])
        return tube.times[inside], tube.upper[inside]
    if window[0] == window[1]:
        return np.array([window[1]]), tube.at([window[1]])
    meets = (before < window[1]) & (after > window[0])
    return np.clip((before + after)[meets] / 2, *window), tube.interval[meets]
