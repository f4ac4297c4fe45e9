"""Tubes of hybrid automata: every trajectory, at all times, whatever transitions it takes.

A worklist of start sets: all those of one mode are followed at once (see `flowpipes`), the parts that can
take a transition become the next entries. No trajectory is lost: steps are enclosed
continuously in time, guards and invariants cut by enclosures, and the absolute time at which a mode
was entered is kept as an interval.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..numerics.checks import as_count, as_numbers, checked, require_single
from ..numerics.errors import ReachError
from ..sets.clipping import clip, strips
from ..sets.convex import ConvexSet
from ..sets.zonotope import Zonotope
from .automaton import HybridAutomaton
from .segments import HybridTube, Segment, Starts
from .worklist import Worklist

JUMPS = 50
"""Most transitions of one trajectory, if nothing else is said."""


@checked
def hybrid_tube(
    automaton: HybridAutomaton,
    initial: ConvexSet,
    horizon: float,
    *,
    step: float | Mapping[str, float],
    tolerance: ArrayLike | Mapping[str, ArrayLike] | None = None,
    clusters: int | Mapping[str, int] | None = None,
    order: float = 10.0,
    reduction: str = "pca",
    jumps: int = JUMPS,
) -> HybridTube:
    """Enclose all trajectories of a hybrid automaton, continuously in time.

    Parameters
    ----------
    automaton : HybridAutomaton
    initial : ConvexSet
        A zonotope or a stack of them; of any other set the interval hull is taken.
    horizon : float
    step : float or mapping from mode names
        Longest time step.
    tolerance : array_like of shape (n,) or a number, or mapping from mode names, optional
        Steps are halved until the state leaves the set that joins two nodes by less than this.
    clusters : int or mapping from names of target modes, optional
        What crosses in one transition at one depth is merged into at most so many start sets, each
        one stretch of time. By default nothing is merged: every step that crosses a guard becomes a
        start set of its own, and all of them are followed together.
    order : float
        Start sets with more than ``order * n`` generators are reduced.
    reduction : str
        How; see `reach.sets.reduction`.
    jumps : int
        Most transitions of one trajectory. What would need more makes the tube incomplete.

    Returns
    -------
    HybridTube

    Raises
    ------
    ReachError
        If a number is not positive and finite, a mode has no step, or dimensions differ.
    """
    for name, value in (("step", step), ("tolerance", tolerance), ("clusters", clusters)):
        _positive(name, value, whole=name == "clusters")
    if jumps < 0:
        raise ReachError(f"jumps must be at least 0, got {jumps}")
    if not (np.isfinite(horizon) and horizon > 0):
        raise ReachError(f"the horizon must be a finite number > 0, got {horizon!r}")
    worklist = Worklist(automaton, float(horizon), step, tolerance, clusters, order, reduction)
    pending = _entries(automaton, initial)
    segments: list[Segment] = []
    for depth in range(jumps + 1):
        entered: list[Starts] = []
        for starts in pending:
            segment = worklist.follow(starts, depth)
            segments.append(segment)
            for transition in automaton.leaving(starts.mode.name):
                crossing = worklist.cross(segment, transition)
                entered += [crossing] if crossing is not None else []
        pending = worklist.gathered(entered)
        if not pending:
            return HybridTube(tuple(segments), float(horizon), True)
    return HybridTube(tuple(segments), float(horizon), False)


def _entries(automaton: HybridAutomaton, initial: ConvexSet) -> list[Starts]:
    """The part of the initial set that the invariant of the first mode leaves, if any."""
    assert automaton.start is not None
    mode = automaton[automaton.start]
    start = initial if isinstance(initial, Zonotope) else initial.interval_hull().to_zonotope()
    start = start if start.batch else Zonotope(start.c[None], start.G[None])
    require_single("the initial set", start[0], mode.system.dim)
    start, meets = clip(start, *strips([mode.invariant], mode.system.dim))
    return [Starts(mode, start[meets], np.zeros((int(meets.sum()), 2)))] if np.any(meets) else []


def _positive(name: str, given: Any, whole: bool) -> None:
    """Refuse what is not positive: a number (of a tolerance several), or a mapping from names to such."""
    for value in given.values() if isinstance(given, Mapping) else (given,):
        if value is None:
            continue
        if whole:
            good = as_count(name, value) >= 1
        else:
            numbers = as_numbers(name, value)
            good = bool(np.all((numbers > 0) & np.isfinite(numbers))) and numbers.ndim <= (
                name == "tolerance"
            )
        if not good or isinstance(value, bool):
            raise ReachError(f"the {name} must be finite and > 0, got {value!r}")
