"""Is a point in the set? Linear programs for zonotopes, nearest points for the rest."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..numerics.rounding import gamma
from .convex import ConvexSet, as_vector
from .distance import nearest, unit_sizes

if TYPE_CHECKING:
    from .zonotope import Zonotope

Array = NDArray[np.float64]


def zonotope_level(zonotope: Zonotope, point: Array) -> float:
    """Least t with ``point = c + G b`` and ``|b_i| <= t``; inf if there is none.

    Along an axis on which the set is flat the rounding of the point is forgiven.
    """
    from scipy.optimize import linprog

    moved = np.any(zonotope.G != 0, axis=0)
    G, scale = zonotope.G[:, moved], zonotope.half_widths
    gap = point - zonotope.c
    if np.any(np.abs(gap[scale == 0]) > gamma(1) * np.abs(zonotope.c[scale == 0])):
        return np.inf
    G, gap = G[scale > 0] / scale[scale > 0, None], gap[scale > 0] / scale[scale > 0]
    least = float(np.abs(gap).max(initial=0.0))
    g = G.shape[1]
    if g == 0 or least > 2:  # far outside the interval hull: the bound is answer enough
        return least if g else 0.0
    bound = np.block([[np.eye(g), -np.ones((g, 1))], [-np.eye(g), -np.ones((g, 1))]])
    solved = linprog(
        np.r_[np.zeros(g), 1.0],
        bound,
        np.zeros(2 * g),
        np.c_[G, np.zeros(len(G))],
        gap,
        bounds=[(None, None)] * g + [(0, None)],
    )
    return float(solved.fun) if solved.status == 0 else np.inf


def contains_by_distance(X: ConvexSet, points: ArrayLike, slack: float) -> NDArray[np.bool_]:
    """Whether each point is within `slack` of the set, measured in sizes of its interval hull.

    A point is outside only if a direction shows it.
    """
    from .zonotope import Zonotope

    x, size = as_vector(points, X.dim), unit_sizes(X.interval_hull().half_widths)
    least = [nearest(Zonotope.point(p), X, size).least for p in x.reshape(-1, X.dim)]
    return np.array(least).reshape(x.shape[:-1]) <= slack
