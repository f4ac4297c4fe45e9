"""Is a hybrid automaton safe? Proven by its tube, violated by a replayed trajectory, or unknown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..numerics.checks import Array, Index, as_count, checked, require_single
from ..numerics.errors import ReachError
from ..numerics.rounding import gamma
from ..sets.clipping import clip, strips
from ..sets.convex import ConvexSet
from ..sets.polytope import HPolytope
from ..sets.zonotope import Zonotope
from ..verification.specification import Always, Never
from .automaton import HybridAutomaton
from .replay import replay_hybrid
from .segments import HybridTube, Segment
from .simulation import HybridTrajectory, Policy, Visit, inside, simulate_hybrid
from .tube import JUMPS, hybrid_tube

Specs = Mapping[str, Sequence[Always | Never]]

DEEP = 1e-6
"""A violation must go beyond its limit by this share of the terms of the row, after the replay."""
CORNERS = 8
"""Directions in which corners of the initial set are tried."""
PART = 20_000
"""Sets that are cut at once."""


@dataclass(frozen=True, eq=False)
class HybridVerdict:
    """Answer of `verify_hybrid`; true only if proven.

    Attributes
    ----------
    status : {"proven", "violated", "unknown"}
    trajectory : HybridTrajectory or None
        Of a violation: admissible and replayed; it ends at the violation.
    tube : HybridTube or None
        None if the violation was found first.
    seconds : float
        Wall time.
    reason : str
    """

    status: str
    trajectory: HybridTrajectory | None
    tube: HybridTube | None
    seconds: float
    reason: str

    def __bool__(self) -> bool:
        return self.status == "proven"


@checked
def verify_hybrid(
    automaton: HybridAutomaton,
    initial: ConvexSet,
    specs: Specs,
    horizon: float,
    *,
    dt: float,
    runs: int = 100,
    seed: int = 0,
    **options: Any,
) -> HybridVerdict:
    """Decide whether every trajectory meets what is asked in each mode, in continuous time.

    First trajectories are tried that may break it: from corners of the initial set, with the
    earliest and the latest transitions. If none does, the tube is checked, and if that does not
    prove it, random trajectories are tried.

    Parameters
    ----------
    automaton : HybridAutomaton
    initial : ConvexSet
    specs : mapping from mode names to sequences of Always and Never
    horizon : float
    dt : float
        Sampling of the trajectories tried.
    runs : int
        Random trajectories tried.
    seed : int
    **options
        Of `hybrid_tube`.

    Raises
    ------
    ReachError
        If a mode is unknown or a region does not fit; also as `hybrid_tube`.
    """
    begun = perf_counter()
    require_single("the initial set", initial)
    for name, asked in specs.items():
        for spec in asked:
            if spec.region.dim != automaton[name].system.dim:
                raise ReachError(f"a region for mode {name!r} has dimension {spec.region.dim}")
    limit = int(options.get("jumps", JUMPS))
    rng = np.random.default_rng(as_count("seed", seed))
    found = falsify_hybrid(automaton, initial, specs, horizon, dt=dt, jumps=limit)
    tube, reason = None, ""
    if found is None:
        tube = hybrid_tube(automaton, initial, horizon, **options)
        reason = "" if tube.complete else "the limit on jumps cut trajectories off"
        for name, asked in specs.items():
            for spec in asked:
                reason = reason or unproven(tube, name, spec)
        if not reason:
            return HybridVerdict("proven", None, tube, perf_counter() - begun, "the tube meets all of it")
        found = falsify_hybrid(automaton, initial, specs, horizon, dt=dt, runs=runs, rng=rng, jumps=limit)
    if found is not None:
        last = found.visits[-1]
        reason = f"broken in mode {last.mode!r} at t = {last.times[-1]:.6g}"
        return HybridVerdict("violated", found, tube, perf_counter() - begun, reason)
    return HybridVerdict("unknown", None, tube, perf_counter() - begun, reason)


def unproven(tube: HybridTube, mode: str, spec: Always | Never) -> str:
    """What keeps a tube from proving a specification in a mode, in a sentence; empty if proved."""
    for segment in tube.of(mode):
        k, i = doubtful(segment, spec)
        if len(k):
            span = segment.span(k, i)
            kind = "leave the region to stay in" if isinstance(spec, Always) else "enter the region to avoid"
            return (
                f"in mode {mode!r} {len(k)} of {segment.alive.sum()} sets may {kind}, "
                f"between t = {span[:, 0].min():.6g} and {span[:, 1].max():.6g}"
            )
    return ""


def doubtful(segment: Segment, spec: Always | Never) -> tuple[Index, Index]:
    """Steps k and starts i for which a specification is not proved."""
    asked = segment.alive.copy()
    if spec.during is not None:
        k, i = segment.steps
        span = segment.span(k, i)
        asked[k, i] = (span[:, 1] >= spec.during[0]) & (span[:, 0] <= spec.during[1])
    invariant = segment.mode.invariant
    rows, limits = spec.region.A, spec.region.b
    if isinstance(spec, Always):
        open_ = ~_implied(invariant, rows, limits)
        rows, limits = rows[open_], limits[open_]
        if len(rows) == 0:
            return np.zeros(0, dtype=np.intp), np.zeros(0, dtype=np.intp)
        high = segment.flowpipes.support(rows)
        safe = np.all(high + gamma(segment.flowpipes.start.terms + 8) * np.abs(high) <= limits, axis=-1)
    else:
        low = -segment.flowpipes.support(-rows)
        safe = np.any(low - gamma(segment.flowpipes.start.terms + 8) * np.abs(low) > limits, axis=-1)
    k, i = np.nonzero(asked & ~safe)
    left = np.ones(len(k), dtype=bool)
    here = strips(
        [invariant] if isinstance(spec, Always) else [invariant, spec.region], segment.mode.system.dim
    )
    for j in range(0, len(k), PART):
        part = slice(j, j + PART)
        sets, meets = clip(segment.flowpipes.sets(k[part], i[part]), *here)
        if isinstance(spec, Always):
            left[part] = meets & np.any(_outer(sets, rows) > limits, axis=-1)
        else:
            left[part] = meets
    return k[left], i[left]


def _outer(sets: Zonotope, rows: Array) -> Array:
    return np.asarray(
        sets.support(rows) + gamma(sets.terms) * (np.abs(rows) @ sets.extent[..., None])[..., 0]
    )


def _implied(invariant: HPolytope | None, rows: Array, limits: Array) -> NDArray[np.bool_]:
    """Which rows the invariant has itself."""
    if invariant is None:
        return np.zeros(len(rows), dtype=bool)
    same = np.all(rows[:, None] == invariant.A[None], axis=-1)
    return np.asarray(np.any(same & (invariant.b[None] <= limits[:, None]), axis=1))


@checked
def falsify_hybrid(
    automaton: HybridAutomaton,
    initial: ConvexSet,
    specs: Specs,
    horizon: float,
    *,
    dt: float,
    runs: int = 0,
    rng: np.random.Generator | None = None,
    jumps: int = JUMPS,
) -> HybridTrajectory | None:
    """Look for a trajectory that breaks a specification; None if none was found, which proves nothing.

    Parameters
    ----------
    automaton, initial, specs, horizon, dt : as in `verify_hybrid`
        As for `verify_hybrid`.
    runs : int
        Random trajectories to try; with 0, the earliest and the latest transitions from the centre
        and from corners of the initial set.
    rng : numpy.random.Generator, optional
    jumps : int
        Most transitions of one trajectory.
    """
    require_single("the initial set", initial)
    rng = np.random.default_rng(0) if rng is None else rng
    corners = initial.support_vector(rng.normal(size=(max(runs, CORNERS), initial.dim)))
    plans: list[tuple[Array, Policy]] = [(x, "random") for x in corners]
    if runs == 0:
        corners = np.unique(np.vstack([initial.center, corners]), axis=0)
        plans = [(x, policy) for x in corners for policy in ("last", "first")]
    for x, policy in plans:
        path = simulate_hybrid(automaton, x, horizon, dt=dt, policy=policy, rng=rng, jumps=jumps)
        broken = first_violation(path, specs)
        if broken is not None and replay_hybrid(automaton, broken) < DEEP:
            return broken
    return None


def first_violation(path: HybridTrajectory, specs: Specs) -> HybridTrajectory | None:
    """The trajectory up to its first clear violation; None if there is none."""
    for j, visit in enumerate(path.visits):
        broken, size = np.zeros(len(visit.times), dtype=bool), np.abs(visit.states).max(axis=0)
        for spec in specs.get(visit.mode, ()):
            slack = -DEEP if isinstance(spec, Never) else DEEP
            within = inside(spec.region, visit.states, size, slack)
            bad = within if isinstance(spec, Never) else ~within
            if spec.during is not None:
                bad = bad & (visit.times >= spec.during[0]) & (visit.times <= spec.during[1])
            broken |= bad
        if np.any(broken):
            k = int(np.argmax(broken)) + 1
            end = Visit(visit.mode, visit.times[:k], visit.states[:k], visit.input)
            return HybridTrajectory((*path.visits[:j], end))
    return None
