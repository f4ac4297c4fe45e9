"""Verification in one call: proven, violated with a trajectory that shows it, or unknown.

Of a region to avoid, directions that separate are sought: its normals, then those between nearest points of
the region and of the exact reachable set, which else give a trajectory into it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import nnls

from ..numerics.checks import Array, checked, require_single
from ..numerics.errors import ReachError, Unresolved
from ..numerics.rounding import gamma
from ..sets.convex import ConvexSet
from ..sets.interval import Interval
from ..sets.polytope import HPolytope
from ..sets.relations.distance import nearest, unit_sizes
from ..tubes.bounds import EffortBudget
from ..tubes.systems import LinearSystem
from ..tubes.trajectory import STEPS, Trajectory, simulate, worst_case
from .invariance import FIRST, LAST, REPLAY, SHARPER, Motions, verify_always
from .specification import Always, Never, Verdict

EFFORT = 1e9  # numbers computed by default, minutes of one core: systems of 6 states rarely need a thousandth
MOST_DIRECTIONS = 64
MOST_STEPS = 20_000  # steps of a trajectory into the region
TOUCHING = 1e-8  # distance, in sizes of the sets, at which two points count as one
SHRINK = (0.25, 0.01, 0.0)
"""Shares of the inscribed radius by which the region is pulled in while a trajectory into it is sought,
so that rounding cannot put its end outside."""


@checked
def verify(
    system: LinearSystem,
    initial: ConvexSet,
    spec: Always | Never,
    horizon: float,
    *,
    max_effort: float = EFFORT,
) -> Verdict:
    """Decide whether every trajectory meets a specification, in continuous time.

    Bounds are made sharper until they prove it, until a trajectory breaks it, or until effort or
    precision runs out. For `Always` and for `Never` of one halfspace there is nothing between: the
    bound and the trajectory close in on each other.

    Parameters
    ----------
    system : LinearSystem
    initial : ConvexSet
    spec : Always or Never
    horizon : float
        May be 0: then the initial set is asked.
    max_effort : float
        Most numbers computed, steps times directions times states, after which the answer is "unknown". It is
        counted, so the answer is the same on every machine.

    Raises
    ------
    ReachError
        If dimensions differ, or the times of the specification lie outside the horizon.
    """
    window = _window(system, spec, horizon)
    require_single("the initial set", initial)
    started, region = perf_counter(), spec.region
    motions = Motions(system, initial, window, EffortBudget(max_effort))
    if len(region.b) == 0:
        verdict = _without_limits(motions, spec)
    elif isinstance(spec, Always):
        verdict = verify_always(motions, region)
    elif len(region.b) == 1:  # out of one halfspace is inside the opposite one, its boundary excluded
        verdict = verify_always(motions, HPolytope(-region.A, np.nextafter(-region.b, -np.inf)))
    else:
        verdict = verify_never(motions, region)
    return replace(verdict, seconds=perf_counter() - started)


def _window(system: LinearSystem, spec: Any, horizon: float) -> tuple[float, float]:
    """First and last time that a specification speaks of."""
    if not isinstance(spec, Always | Never):
        raise ReachError(f"the specification must be Always or Never, got {type(spec).__name__}")
    if spec.region.dim != system.dim:
        raise ReachError(f"the region has dimension {spec.region.dim}, the system {system.dim} states")
    if not 0 <= horizon < np.inf:
        raise ReachError(f"the horizon must be a finite number >= 0, got {horizon!r}")
    during = (0.0, horizon) if spec.during is None else spec.during
    if not 0 <= during[0] <= during[1] <= horizon:
        raise ReachError(f"`during` must be two times within [0, {horizon:g}], got {spec.during!r}")
    first, last = float(during[0]), float(during[1])
    if system.discrete:
        first, last = float(np.ceil(first)), float(np.floor(last))
        if first > last:
            raise ReachError(f"`during` must hold a whole number of steps, got {spec.during!r}")
    return first, last


def _without_limits(motions: Motions, spec: Always | Never) -> Verdict:
    """Decide a specification whose region is the whole space, without any bounds."""
    empty, system = np.zeros(0), motions.system
    if isinstance(spec, Always):
        return Verdict("proven", np.inf, empty, empty, None, 0, "the region has no limits")
    path = worst_case(system, motions.initial, motions.window[0], np.ones(system.dim))
    return Verdict("violated", -np.inf, empty, empty, path, 0, "the region to avoid has no limits")


@dataclass
class Reached:
    """Values of rows at one time, a set given by trajectories, whose mixtures are trajectories again."""

    motions: Motions
    rows: Array
    time: float
    step: float | None
    paths: list[Trajectory] = field(default_factory=list)

    @property
    def center(self) -> Array:
        """Some point of the set, shape (r,)."""
        return self.support_vector(np.ones(len(self.rows)))

    def support_vector(self, directions: ArrayLike) -> Array:
        """The values of the rows that go furthest in one direction, shape (r,)."""
        d = np.asarray(directions, dtype=float) @ self.rows
        motions = self.motions
        self.paths.append(worst_case(motions.system, motions.initial, self.time, d, step=self.step))
        motions.effort.spend(self.paths[-1].states.size)
        return np.asarray(self.rows @ self.paths[-1].states[-1])

    @property
    def answers(self) -> Array:
        """Every point found so far, shape (k, r)."""
        return np.array([self.rows @ path.states[-1] for path in self.paths])

    def leading_to(self, point: Array) -> Trajectory:
        """The trajectory that mixes the answers so as to end closest to a point."""
        answers = self.answers
        size = np.maximum(np.abs(answers).max(axis=0), np.finfo(float).tiny)
        M, aim = np.vstack([(answers / size).T, np.full(len(answers), 1e3)]), np.r_[point / size, 1e3]
        try:
            weights = nnls(M, aim, maxiter=100 * (len(answers) + 1))[0]
        except RuntimeError as exc:
            raise Unresolved(f"no mixture of trajectories was found: {exc}") from None
        weights = weights / weights.sum()
        x0 = np.tensordot(weights, np.array([path.states[0] for path in self.paths]), axes=1)
        inputs = np.tensordot(weights, np.array([path.inputs for path in self.paths]), axes=1)
        if self.time == 0:
            return replace(self.paths[0], states=x0[None])
        return simulate(self.motions.system, x0, self.paths[0].times, inputs)


def verify_never(motions: Motions, region: HPolytope) -> Verdict:
    """`verify` for a region to stay out of."""
    D, levels = -region.A, -region.b
    bounds, steps, share = np.full((1, len(D)), np.nan), 0, FIRST

    def verdict(status: str, margin: float, reason: str, path: Trajectory | None = None) -> Verdict:
        return Verdict(status, margin, bounds.max(axis=0), np.full(len(D), np.nan), path, steps, reason)

    try:
        if region.is_empty and region.is_empty_within(motions.visited):
            return verdict("proven", np.inf, "the region is empty")
        while share >= LAST:
            tube = motions.tube(D, share * motions.sizes(D, levels), levels)
            t, bounds = motions.window_bounds(tube)
            steps, step = len(tube.times) - 1, float(np.min(np.diff(tube.times), initial=np.inf))
            separation = ((levels - bounds) / np.linalg.norm(D, axis=1)).max(axis=1)
            worst = int(np.argmin(separation))
            if separation[worst] > 0:
                reason = f"some direction keeps {separation[worst]:.6g} from the region at every time"
                return verdict("proven", float(separation[worst]), reason)
            path, mix = _try(motions, region, float(t[worst]), step)
            if path is not None:
                slack = region.b - region.A @ path.states[-1]
                depth = float(np.min(slack / np.linalg.norm(region.A, axis=1)))
                reason = f"a trajectory is in the region at t = {path.times[-1]:.6g}, {depth:.6g} deep"
                return verdict("violated", -depth, reason, path)
            if mix is not None and len(D) < MOST_DIRECTIONS and _is_new(-mix @ region.A, D):
                # In the region -mix A x >= -mix b, but for the rounding of the products.
                level, residual = region.weak_duality((mix @ region.A)[None], mix[None])
                bound = level + (1 + gamma(motions.system.dim)) * residual @ motions.visited
                D, levels = np.vstack([D, -mix @ region.A]), np.r_[levels, -bound]
            else:
                share /= SHARPER
    except Unresolved as exc:
        return verdict("unknown", np.nan, f"neither proven nor violated: {exc}")
    reason = "no separating directions, and no trajectory that enters beyond rounding, were found"
    return verdict("unknown", np.nan, reason)


def _is_new(d: Array, D: Array) -> bool:
    """Return True if a direction differs from all those in use."""
    cosines = D @ d / np.linalg.norm(D, axis=1) / np.linalg.norm(d)
    return bool(np.max(cosines) < 1 - 1e-9)


def _try(
    motions: Motions, region: HPolytope, time: float, step: float
) -> tuple[Trajectory | None, Array | None]:
    """A trajectory into the region at about a time, or else the mixture of rows of A that separates there."""
    hold_time = None if time == 0 else max(min(time / STEPS, step), time / MOST_STEPS)
    if motions.system.discrete:
        time, hold_time = float(np.clip(round(time), *motions.window)), None
    body = Reached(motions, region.A, time, hold_time)
    for d in np.vstack([np.eye(len(region.b)), -np.eye(len(region.b))]):
        body.support_vector(d)
    lo = body.answers.min(axis=0)
    size = unit_sizes(np.ptp(body.answers, axis=0) / 2)
    if np.any(lo > region.b):
        return None, None  # a row separates: only the bounds were not sharp enough
    floor = np.minimum(lo, region.b) - size
    for share in SHRINK:
        target = Interval(floor, np.maximum(region.b - share * np.minimum(size, region.b - lo), floor))
        answer = nearest(body, target, size)
        if answer.gap <= TOUCHING:
            path = body.leading_to(answer.x)
            depth = REPLAY * (np.abs(region.A) @ np.abs(path.states[-1]) + np.abs(region.b))
            if np.all(region.A @ path.states[-1] <= region.b - depth):
                return path, None
    mix = np.maximum(-answer.direction, 0.0)
    d, terms = -mix @ region.A, mix @ np.abs(region.A)
    return None, mix if answer.least > 0 and np.any(np.abs(d) > 1e-9 * terms) else None
