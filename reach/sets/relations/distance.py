"""Nearest points of two convex sets, from their support vectors alone; answers about two sets."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...numerics.checks import Array
from ...short_repr import short_repr
from ..convex import ConvexSet

STEPS = 300
"""Most support vectors asked of each set: polytopes need far fewer, round sets that touch use them up."""

CLOSE = 1e-9
"""Distance, in sizes of the sets, that is as good as none, and relative gap at which the search ends."""


@short_repr
@dataclass(frozen=True, eq=False)
class Answer:
    """Answer to a question about two sets; true in an ``if`` only when proved.

    Attributes
    ----------
    holds : bool or None
        True: proved, rounding included. False: `witness` shows why not. None: not decided, either
        because the method is only sufficient or because the sets touch to within rounding.
    margin : float
        Margin by which it holds, never too large; negative where it does not. For containment in a
        polytope or an interval: the distance to the nearest facet. In a zonotope or an ellipsoid:
        one minus the factor by which it must be scaled about its centre to hold the inner set. For
        disjointness: the distance of the sets, 0 where they meet.
    witness : ndarray, shape (n,), or None
        With a "no": a point of the inner set outside the outer one; a point in both sets.
    direction : ndarray, shape (n,), or None
        Separating direction: the facet that the witness is beyond; for disjoint sets a d with
        ``d . x < d . y`` for all their points.
    reason : str
        Reason why it was not decided.
    """

    holds: bool | None
    margin: float
    witness: Array | None = None
    direction: Array | None = None
    reason: str = ""

    def __bool__(self) -> bool:
        return self.holds is True


@dataclass(frozen=True)
class Nearest:
    """Nearest points found, in coordinates scaled so that the sets have about unit size."""

    x: Array  # of the first set, (n,)
    y: Array  # of the second set, (n,)
    gap: float  # scaled distance of the two points
    least: float  # the sets are at least this far apart (scaled, before rounding); not above `gap`
    direction: Array  # in true coordinates: direction . (y - x) is positive for disjoint sets, (n,)


def nearest(X: Any, Y: Any, scale: Array) -> Nearest:
    """Nearest points of two bounded convex sets (Wolfe 1976), distances measured in one unit for each axis.

    Asked of the sets are `center` and `support_vector`, nothing else.
    """
    pairs = [np.stack([X.center, Y.center])]
    corral, weights, least = ((X.center - Y.center) / scale)[None], np.ones(1), 0.0
    for _ in range(STEPS):
        z = weights @ corral
        length = float(np.linalg.norm(z))
        pair = np.stack([X.support_vector(-z / scale), Y.support_vector(z / scale)])
        furthest = (pair[0] - pair[1]) / scale
        least = max(least, float(z @ furthest) / max(length, np.finfo(float).tiny))
        if length <= CLOSE / 10 or least >= (1 - CLOSE) * length:
            break
        combination = _least_norm(np.vstack([corral, furthest]))
        if combination is None:
            break  # what is known so far stays true
        corral, pairs, weights = np.vstack([corral, furthest]), [*pairs, pair], combination
        positive = weights > 0
        corral, weights = corral[positive], weights[positive]
        pairs = [pair for pair, use in zip(pairs, positive, strict=True) if use]
    x, y = np.tensordot(weights, np.array(pairs), axes=1)
    z = weights @ corral
    return Nearest(x, y, float(np.linalg.norm(z)), least, -z / scale)


def unit_sizes(half_widths: Array) -> Array:
    """Positive sizes to measure with: the half-widths, flat axes taking the largest of the others."""
    largest = float(half_widths.max(initial=0.0)) or 1.0
    return np.where(half_widths > 0, half_widths, largest)


def _least_norm(points: Array) -> Array | None:
    """Weights (k,) of the convex combination of least norm, at most n + 1 not zero; None if none is found."""
    from scipy.optimize import nnls

    k, n = points.shape
    rows, aim = np.vstack([points.T, np.ones((1, k))]), np.r_[np.zeros(n), 1.0]
    try:
        solution = nnls(rows, aim, maxiter=100 * (k + 1))[0]
    except RuntimeError:
        return None
    total = float(solution.sum())
    return np.asarray(solution / total) if total > 0 else np.full(k, 1 / k)


def contains_by_distance(X: ConvexSet, x: Array, slack: float) -> NDArray[np.bool_]:
    """Return True for each point within `slack` of the set, measured in sizes of its interval hull.

    A point is outside only if a direction shows it.
    """
    from ..zonotope import Zonotope

    size = unit_sizes(X.interval_hull().half_widths)
    least = [nearest(Zonotope.point(p), X, size).least for p in x.reshape(-1, X.dim)]
    return np.array(least).reshape(x.shape[:-1]) <= slack
