"""Verification in one call: proven, violated with a trajectory that shows it, or unknown."""

from __future__ import annotations

from dataclasses import replace
from time import perf_counter
from typing import Any

import numpy as np

from ..numerics.checks import checked, require_single
from ..numerics.errors import ReachError
from ..sets.convex import ConvexSet
from ..sets.polytope import HPolytope
from ..tubes.systems import LinearSystem
from ..tubes.trajectory import worst_case
from .avoidance import verify_never
from .invariance import Motions, verify_always
from .specification import Always, Never, Verdict


@checked
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
        May be 0: then the initial set is asked.
    max_seconds : float
        Wall time after which the answer is "unknown".

    Raises
    ------
    ReachError
        If dimensions differ, or the times of the specification lie outside the horizon.
    """
    window = _window(system, spec, horizon)
    require_single("the initial set", initial)
    begun, region = perf_counter(), spec.region
    motions = Motions(system, initial, window, begun + max_seconds)
    if len(region.b) == 0:
        found = _without_limits(motions, spec)
    elif isinstance(spec, Always):
        found = verify_always(motions, region)
    elif len(region.b) == 1:  # out of one halfspace is inside the opposite one, its boundary excluded
        found = verify_always(motions, HPolytope(-region.A, np.nextafter(-region.b, -np.inf)))
    else:
        found = verify_never(motions, region)
    return replace(found, seconds=perf_counter() - begun)


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
    """Of a region that is everything there is nothing to compute."""
    none, system = np.zeros(0), motions.system
    if isinstance(spec, Always):
        return Verdict("proven", np.inf, none, none, None, 0, "the region has no limits")
    path = worst_case(system, motions.initial, motions.window[0], np.ones(system.dim))
    return Verdict("violated", -np.inf, none, none, path, 0, "the region to avoid has no limits")
