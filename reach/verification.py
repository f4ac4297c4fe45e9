"""Verification in one call: proven, violated with a trajectory that shows it, or unknown."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from math import lcm
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from .convex import ConvexSet
from .errors import ReachError
from .polytope import HPolytope
from .systems import LinearSystem
from .trajectory import Trajectory, worst_case
from .tube_support import SupportTube, support_tube

Array = NDArray[np.float64]

REPLAY = 1e-9
"""A replayed trajectory must pass a limit by this share of its size before it counts as a violation."""
SHARPER = 8.0
"""Factor by which the tolerance shrinks while neither proof nor violation is found."""
FIRST, LAST = 0.05, 1e-7
"""First and last tolerance, as shares of the size of the quantity bounded."""


@dataclass(frozen=True, eq=False)
class Always:
    """The state stays in a polytope.

    Parameters
    ----------
    region : HPolytope
        May be unbounded.
    during : tuple of float, optional
        First and last time at which it must hold; the whole horizon if not given. The two may be
        the same.
    """

    region: HPolytope
    during: tuple[float, float] | None = None


@dataclass(frozen=True, eq=False)
class Never:
    """The state never enters a polytope (its boundary belongs to it).

    Parameters
    ----------
    region : HPolytope
        May be unbounded.
    during : tuple of float, optional
        As for `Always`.
    """

    region: HPolytope
    during: tuple[float, float] | None = None


@dataclass(frozen=True, eq=False)
class Verdict:
    """Answer of `verify`; true only if proven.

    Attributes
    ----------
    status : {"proven", "violated", "unknown"}
    margin : float
        Of a proof: distance kept to the limits, in the units of the normals of the region, over
        the lengths of these. Of a violation: how far the trajectory goes beyond them (negative).
        nan if unknown.
    bounds : ndarray, shape (r,)
        Upper bounds on the rows of the region to stay in (`Always`), or on the directions that were
        to separate (`Never`; its rows negated come first), from the last tube computed.
    reached : ndarray, shape (r,)
        What trajectories reach in these rows; nan where it was not asked.
    trajectory : Trajectory or None
        Of a violation: initial state and inputs that are admissible, replayed; it ends at the
        instant of the violation.
    steps : int
        Steps of the last tube.
    seconds : float
        Wall time.
    reason : str
        One sentence.
    """

    status: str
    margin: float
    bounds: Array
    reached: Array
    trajectory: Trajectory | None
    steps: int
    seconds: float
    reason: str

    def __bool__(self) -> bool:
        return self.status == "proven"


def verify(
    system: LinearSystem,
    initial: ConvexSet,
    spec: Always | Never,
    horizon: float,
    *,
    max_seconds: float = 60.0,
) -> Verdict:
    """Decide whether every trajectory meets a specification, in continuous time.

    Bounds are made sharper until they prove it, until a trajectory breaks it, or until time or
    precision runs out. For `Always` and for `Never` of one halfspace there is nothing between: the
    bound and the trajectory close in on each other.

    Parameters
    ----------
    system : LinearSystem
    initial : ConvexSet
    spec : Always or Never
    horizon : float
    max_seconds : float
        No further refinement is begun after this time.

    Raises
    ------
    ReachError
        If dimensions differ, or the times of the specification lie outside the horizon.
    """
    if spec.region.dim != system.dim:
        raise ReachError(f"the region has dimension {spec.region.dim}, the system {system.dim} states")
    window = (0.0, float(horizon)) if spec.during is None else spec.during
    if not 0 <= window[0] <= window[1] <= horizon:
        raise ReachError(f"`during` must lie within [0, {horizon:g}], got {spec.during}")
    if system.discrete:
        window = float(np.ceil(window[0])), float(np.floor(window[1]))
        if window[0] > window[1]:
            raise ReachError(f"`during` must hold a whole number of steps, got {spec.during}")
    begun = perf_counter()
    if isinstance(spec, Never) and len(spec.region.b) == 1:
        # Out of one halfspace is inside the opposite one, its boundary excluded.
        beyond = HPolytope(-spec.region.A, np.nextafter(-spec.region.b, -np.inf))
        return verify_always(system, initial, beyond, window, begun, max_seconds)
    if isinstance(spec, Never):
        from .avoidance import verify_never

        return verify_never(system, initial, spec.region, window, begun, max_seconds)
    return verify_always(system, initial, spec.region, window, begun, max_seconds)


def verify_always(
    system: LinearSystem,
    initial: ConvexSet,
    region: HPolytope,
    window: tuple[float, float],
    begun: float,
    max_seconds: float,
) -> Verdict:
    """`verify` for a region to stay in: one tube along its normals, sharper where it must be."""
    C, limits = region.A, region.b
    size = np.maximum(np.abs(limits), np.maximum(initial.support(C), initial.support(-C)))
    size = np.where(size > 0, size, 1.0)
    bounds, reached = np.full(len(C), np.inf), np.full(len(C), -np.inf)
    share, steps, stop = FIRST, 0, ""
    while not stop:
        open_rows = np.nonzero(~(bounds <= limits))[0]
        if len(open_rows) == 0:
            margin = float(np.min((limits - bounds) / np.linalg.norm(C, axis=1)))
            reason = f"every bound keeps {margin:.6g} from its limit"
            return Verdict("proven", margin, bounds, reached, None, steps, perf_counter() - begun, reason)
        # At a single instant, which is a node, nothing between nodes matters.
        between = limits[open_rows] if window[0] < window[1] else np.full(len(open_rows), np.inf)
        tube = sharp_tube(system, initial, window[1], C[open_rows], share * size[open_rows], between)
        steps = len(tube.times) - 1
        bounds[open_rows], instants, reached[open_rows] = extremes(tube, window, system.discrete)
        broken = np.nonzero(reached > limits)[0]
        if len(broken):
            row = int(broken[np.argmax((reached - limits)[broken] / size[broken])])
            instant = float(instants[open_rows.tolist().index(row)])
            excess = float(reached[row] - limits[row])
            found = sharp_worst_case(system, initial, instant, C[row], excess / 2, window[1] / max(steps, 1))
            value = float(C[row] @ found.states[-1])
            if value > limits[row] + REPLAY * size[row]:
                margin = float((limits[row] - value) / np.linalg.norm(C[row]))
                reason = (
                    f"row {row} reaches {value:.6g} at t = {instant:.6g}, above its limit {limits[row]:.6g}"
                )
                return Verdict(
                    "violated", margin, bounds, reached, found, steps, perf_counter() - begun, reason
                )
        share /= SHARPER
        if share < LAST:
            stop = "the limit is touched to working precision"
        elif perf_counter() - begun > max_seconds:
            stop = f"neither proven nor violated within {max_seconds:g} s"
    return Verdict("unknown", np.nan, bounds, reached, None, steps, perf_counter() - begun, stop)


def sharp_tube(
    system: LinearSystem, initial: ConvexSet, horizon: float, C: Array, tolerance: Array, limits: Array
) -> SupportTube:
    """A tube as sharp as a tolerance asks; with several input sets, equal steps short enough for it."""
    if horizon == 0:
        start, none = initial.support(C)[None], np.zeros((0, len(C)))
        return SupportTube(np.zeros(1), C, start, start, none, none)
    if len(system.U) < 2:
        return support_tube(system, initial, horizon, C, tolerance=tolerance, limit=limits)
    shares = [Fraction(time / horizon).limit_denominator(100_000) for time in system.breaks]
    step = horizon / lcm(*(share.denominator for share in shares))
    while True:
        tube = support_tube(system, initial, horizon, C, step=step)
        loose = np.maximum((tube.upper - tube.attained).max(axis=0), tube.bow.max(axis=0))
        if np.all(loose <= tolerance):
            return tube
        step /= 2


def sharp_worst_case(
    system: LinearSystem, initial: ConvexSet, horizon: float, d: Array, tolerance: float, step: float
) -> Trajectory:
    """`worst_case` by a tolerance; with the step of the tube where that cannot be."""
    if system.discrete or len(system.U) < 2:
        return worst_case(system, initial, horizon, d, tolerance=None if system.discrete else tolerance)
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
