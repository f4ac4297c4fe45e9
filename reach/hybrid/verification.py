"""Is a hybrid automaton safe? Proven by its tube, violated by a replayed trajectory, or unknown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from ..numerics.checks import Array, Index, as_count, checked, require_single
from ..numerics.errors import ReachError
from ..numerics.rounding import gamma
from ..sets.clipping import clip, strips
from ..sets.convex import ConvexSet
from ..sets.polytope import HPolytope
from ..short_repr import short_repr
from ..verification.specification import Always, Never
from .automaton import HybridAutomaton
from .segments import HybridTube, Segment
from .simulation import REPLAYED, HybridTrajectory, Policy, Visit, inside, simulate_hybrid
from .tube import HybridOptions, hybrid_tube

Specs = Mapping[str, Sequence[Always | Never]]

DEEP = 1e-6  # a violation must go beyond its limit by this share of the terms of the row, after the replay
CORNERS = 8  # directions in which corners of the initial set are tried
PART = 20_000  # sets that are cut at once


@short_repr
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
    options: HybridOptions,
    *,
    dt: float,
    runs: int = 100,
    seed: int = 0,
) -> HybridVerdict:
    """Decide whether every trajectory meets the requirement of each mode, in continuous time.

    First trajectories are tried that may break it: from corners of the initial set, with the
    earliest and the latest transitions. If none does, the tube is checked, and if that does not
    prove it, random trajectories are tried.

    Parameters
    ----------
    automaton : HybridAutomaton
    initial : ConvexSet
    specs : mapping from mode names to sequences of Always and Never
    horizon : float
    options : HybridOptions
    dt : float
        Sampling of the trajectories tried.
    runs : int
        Random trajectories tried.
    seed : int

    Raises
    ------
    ReachError
        If a mode is unknown or a region does not fit; also as `hybrid_tube`.
    """
    started = perf_counter()
    require_single("the initial set", initial)

    def verdict(status: str, reason: str) -> HybridVerdict:
        return HybridVerdict(status, run, tube, perf_counter() - started, reason)

    for name, mode_specs in specs.items():
        for spec in mode_specs:
            if spec.region.dim != automaton[name].system.dim:
                raise ReachError(f"a region for mode {name!r} has dimension {spec.region.dim}")
    rng, jumps = np.random.default_rng(as_count("seed", seed)), options.jumps
    tube: HybridTube | None = None
    run = falsify_hybrid(automaton, initial, specs, horizon, dt=dt, jumps=jumps)
    if run is None:
        tube = hybrid_tube(automaton, initial, horizon, options)
        pairs = ((name, spec) for name, mode_specs in specs.items() for spec in mode_specs)
        objection = next(filter(None, (unproven(tube, name, spec) for name, spec in pairs)), "")
        objection = objection if tube.complete else "the limit on jumps cut trajectories off"
        if not objection:
            return verdict("proven", "the tube meets all of it")
        run = falsify_hybrid(automaton, initial, specs, horizon, dt=dt, runs=runs, rng=rng, jumps=jumps)
        if run is None:
            return verdict("unknown", objection)
    last = run.visits[-1]
    return verdict("violated", f"broken in mode {last.mode!r} at t = {last.times[-1]:.6g}")


def unproven(tube: HybridTube, mode: str, spec: Always | Never) -> str:
    """Return a sentence on why a tube does not prove a specification in a mode; empty if it does."""
    for segment in tube.in_mode(mode):
        k, i = doubtful(segment, spec)
        if len(k):
            span = segment.span(k, i)
            kind = "leave the region to stay in" if isinstance(spec, Always) else "enter the region to avoid"
            return (
                f"in mode {mode!r} {len(k)} of {segment.alive.sum()} sets may {kind}, "
                f"between t = {span[:, 0].min():.6g} and {span[:, 1].max():.6g}"
            )
    return ""


def doubtful(segment: Segment, spec: Always | Never) -> Index:
    """Steps k and starts i, shape (2, M), for which a specification is not proved."""
    applies = segment.alive.copy()
    if spec.during is not None:
        k, i = segment.steps
        span = segment.span(k, i)
        applies[k, i] = (span[:, 1] >= spec.during[0]) & (span[:, 0] <= spec.during[1])
    invariant, terms = segment.mode.invariant, segment.flowpipes.start.terms + 8
    rows, limits, cuts = spec.region.A, spec.region.b, [invariant]
    if isinstance(spec, Always):
        open_ = ~_implied(invariant, rows, limits)
        rows, limits = rows[open_], limits[open_]
        if len(rows) == 0:
            return np.zeros((2, 0), dtype=np.intp)
        high = segment.flowpipes.support(rows)
        safe = np.all(high + gamma(terms) * np.abs(high) <= limits, axis=-1)
    else:
        cuts, low = [invariant, spec.region], -segment.flowpipes.support(-rows)
        safe = np.any(low - gamma(terms) * np.abs(low) > limits, axis=-1)
    k, i = np.nonzero(applies & ~safe)
    unproved = np.ones(len(k), dtype=bool)
    for j in range(0, len(k), PART):
        part = slice(j, j + PART)
        sets, meets = clip(segment.flowpipes.sets(k[part], i[part]), *strips(cuts, segment.mode.system.dim))
        if isinstance(spec, Always):
            meets = meets & np.any(sets.support_up(rows) > limits, axis=-1)
        unproved[part] = meets
    return np.stack([k[unproved], i[unproved]])


def _implied(invariant: HPolytope | None, rows: Array, limits: Array) -> NDArray[np.bool_]:
    """Return True for each row ``row . x <= limit`` that the invariant states itself, shape (r,)."""
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
    jumps: int = HybridOptions.jumps,
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
            violating = within if isinstance(spec, Never) else ~within
            if spec.during is not None:
                violating = violating & (visit.times >= spec.during[0]) & (visit.times <= spec.during[1])
            broken |= violating
        if np.any(broken):
            k = int(np.argmax(broken)) + 1
            end = Visit(visit.mode, visit.times[:k], visit.states[:k], visit.input)
            return HybridTrajectory((*path.visits[:j], end))
    return None


@checked
def replay_hybrid(automaton: HybridAutomaton, trajectory: HybridTrajectory, rtol: float = 1e-10) -> float:
    """Integrate a trajectory again, independently, and check that it is admissible.

    Every visit is integrated from the state in which the last one ended, with the same input and
    duration; inputs, guards, windows, dwell times, invariants and resets are checked on the way. That
    it begins in the initial set is not.

    Returns
    -------
    float
        Largest difference between the states, relative to the largest of each coordinate; inf if
        some step is not admissible.
    """
    from scipy.integrate import solve_ivp  # slow to import

    if not 0 < rtol < 1:
        raise ReachError(f"rtol must lie between 0 and 1, got {rtol!r}")
    rtol = max(rtol, 1e-13)
    worst, x = 0.0, trajectory.visits[0].states[0]
    if trajectory.visits[0].mode != automaton.start:
        return float("inf")
    for visit, after in zip(trajectory.visits, (*trajectory.visits[1:], None), strict=True):
        mode, start, length = automaton[visit.mode], visit.times[0], np.ptp(visit.times)
        force = np.asarray(mode.system.B @ visit.input).ravel() + mode.system.c
        size = np.abs(visit.states).max(axis=0)
        scale = np.where(size > 0, size, size.max() or 1.0)
        states = np.repeat(x[None], len(visit.times), axis=0)
        if length > 0:
            states = solve_ivp(
                lambda s, y, A=mode.system.A, f=force: A @ y + f,
                (0.0, length),
                x,
                method="LSODA" if np.abs(mode.system.A).max() * length > 100 else "DOP853",
                t_eval=np.clip(visit.times - start, 0, length),
                rtol=rtol,
                atol=rtol * float(scale.min()),
            ).y.T
        worst = max(worst, float(np.max(np.abs(states - visit.states) / scale)))
        slack, t, x = 1e-9 * (1 + abs(visit.times[-1])), visit.transition, states[-1]
        conditions = [
            *(U.contains(visit.input) for U in mode.system.U),
            np.all(inside(mode.invariant, states, size, REPLAYED)),
            length <= float(automaton.longest_stay(visit.mode, start, start)) + slack,
        ]
        if t is not None and after is not None:
            w = np.zeros(len(t.r)) if visit.uncertain is None else visit.uncertain
            conditions += [
                (t.source, t.target) == (visit.mode, after.mode),
                inside(t.guard, x[None], size, REPLAYED)[0],
                t.window is None or t.window[0] - slack <= visit.times[-1] <= t.window[1] + slack,
                t.dwell is None or t.dwell[0] - slack <= length <= t.dwell[1] + slack,
                not np.any(w) if t.uncertain is None else t.uncertain.contains(w),
            ]
            x = t.R @ x + t.r + w
        if not all(conditions):
            return float("inf")
    return worst
