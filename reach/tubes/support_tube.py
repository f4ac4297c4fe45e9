"""Support-function tubes: bounds along chosen directions over all of a time interval."""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..numerics.checks import Array, as_directions, as_numbers, checked
from ..numerics.errors import ReachError
from ..sets.convex import ConvexSet
from .stepping import Steps, row_bounds, warn_if_wide
from .systems import LinearSystem


@dataclass(frozen=True, eq=False)
class SupportTube:
    """Bounds on ``d x(t)`` for rows d, at nodes and over every interval between them.

    Attributes
    ----------
    times : ndarray, shape (K+1,)
        Nodes, from 0 to the horizon.
    directions : ndarray, shape (r, n)
    upper : ndarray, shape (K+1, r)
        ``d x(t_k) <= upper[k]`` for every initial state and every input.
    attained : ndarray, shape (K+1, r)
        Some initial state and input reach at least this, so the exact support lies between the two.
    interval : ndarray, shape (K, r)
        ``d x(t) <= interval[k]`` for every t in ``[times[k], times[k+1]]``.
    bow : ndarray, shape (K, r)
        Between two nodes the support exceeds the line that joins ``upper`` by no more than
        ``4 s (1 - s) bow``, s in [0, 1] running from one node to the next.
    """

    times: Array
    directions: Array
    upper: Array
    attained: Array
    interval: Array
    bow: Array

    def at(self, t: ArrayLike) -> Array:
        """Upper bounds at given times, shape (len(t), r).

        Raises
        ------
        ReachError
            If a time lies outside the tube's.
        """
        k, s = locate(self.times, t)
        s = s[:, None]
        line = (1 - s) * self.upper[k] + s * self.upper[k + 1]
        return np.asarray(line + 4 * s * (1 - s) * self.bow[k])

    @property
    def most(self) -> Array:
        """Upper bound over the whole horizon, shape (r,)."""
        return np.asarray(np.maximum(self.interval.max(axis=0), self.upper[-1]))

    @property
    def reached(self) -> Array:
        """What some trajectory reaches at a node, shape (r,): ``reached <= exact <= most``."""
        return np.asarray(self.attained.max(axis=0))


@checked
def support_tube(
    system: LinearSystem,
    initial: ConvexSet,
    horizon: float,
    directions: ArrayLike,
    *,
    step: float | None = None,
    tolerance: float | ArrayLike | None = None,
    limit: ArrayLike | None = None,
    max_seconds: float = np.inf,
) -> SupportTube:
    """Bound chosen directions over the reachable sets, continuously in time.

    Parameters
    ----------
    system : LinearSystem
        Dense or sparse; continuous or discrete.
    initial : ConvexSet
    horizon : float
        For a discrete system the number of steps.
    directions : array_like, shape (r, n)
    step : float, optional
        Length of every step (shortened so that it divides the horizon). Where much turns in one
        step, it is carried in up to 16 parts that are not shown.
    tolerance : float or array_like of shape (r,), optional
        Instead of a step: how far the bounds may lie above what is attained. Steps are then chosen
        by it, and differ. Default: a hundredth of the largest value met.
    limit : array_like, shape (r,), optional
        With a tolerance: a bound between nodes that stays below this is tight enough.
    max_seconds : float, optional
        Wall time after which to give up.

    Returns
    -------
    SupportTube

    Raises
    ------
    ReachError
        If a number is not finite or shapes do not fit.
    Unresolved
        If the tolerance cannot be met, in the time given, or a bound is beyond floating point.
    """
    deadline = perf_counter() + max_seconds
    D = as_directions(directions, system.dim)
    run = row_bounds(system, initial, D, horizon, Steps(step, tolerance, limit, deadline=deadline))
    above, below, between, coarse = run.above, run.below, run.between, run.coarse()
    if step is not None and not system.discrete:
        warn_if_wide(between.max(axis=0), below.max(axis=0), np.abs(above).max(axis=0))
    upper, attained = above[:: run.parts], below[:: run.parts]
    return SupportTube(coarse.times, D, upper, attained, between, coarse.bow + coarse.bend)


@checked
def locate(times: Array, t: ArrayLike) -> tuple[NDArray[np.intp], Array]:
    """Interval of every time and its place in it from 0 to 1.

    Raises
    ------
    ReachError
        If a time lies outside the nodes, or is not a number.
    """
    t = np.atleast_1d(as_numbers("t", t))
    if t.ndim != 1:
        raise ReachError(f"times must be a number or a vector of them, got shape {t.shape}")
    if not np.all((t >= times[0]) & (t <= times[-1])):
        raise ReachError(f"times must lie in [{times[0]:g}, {times[-1]:g}]")
    k = np.clip(np.searchsorted(times, t, side="right") - 1, 0, len(times) - 2)
    return k, (t - times[k]) / (times[k + 1] - times[k])
