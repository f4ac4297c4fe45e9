"""Relations of two sets, decided by their classes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ...numerics.checks import as_count, checked, require_alike, require_same_dim, require_single
from ...numerics.errors import ReachError
from ...numerics.rounding import add_down, add_up
from ..ellipsoid import Ellipsoid
from ..intersection import Intersection
from ..interval import Interval
from ..lazy import AffineImage, MinkowskiSum
from ..polytope import HPolytope
from ..stacks import Generated
from ..zonotope import Zonotope
from . import containment as inside
from . import separation as apart
from .containment import MOST, Method
from .distance import Answer


@checked
def contains(outer: Any, inner: Any, method: Method = "auto", most: int = MOST) -> Answer:
    """Decide whether `inner` lies in `outer`.

    Parameters
    ----------
    outer : Interval, HPolytope, Zonotope, Ellipsoid, or AffineImage or Intersection of such
        A single set; an ellipsoid must not be flat, the map of an image must have an inverse.
    inner : set of this library
        A single set. An empty polytope lies in everything.
    method : {"auto", "exact", "sufficient"}
        For an outer zonotope: all its facets (polynomial in a fixed dimension; the question is
        co-NP-complete in general, Kulmburg and Althoff 2021), or one linear program that proves
        containment or nothing (Sadraddini and Tedrake 2019). For an inner zonotope and an outer
        ellipsoid: branch and bound over signs, or norm bounds. All other pairs have one method.
        "auto" is exact up to `most` and sufficient beyond (and asks the quick method first).
    most : int
        Most facets or branches looked at.

    Returns
    -------
    Answer
        Zonotopes and intervals in polytopes, intervals and (exactly) zonotopes are always decided:
        sets that touch are settled in integer arithmetic.

    Raises
    ------
    ReachError
        If the dimensions differ, a set is a stack, the outer set is of another kind, or
        ``method="exact"`` would take more than `most`.
    """
    require_same_dim(outer, inner)
    if not isinstance(method, str) or method not in ("auto", "exact", "sufficient"):
        raise ReachError(f"method must be 'auto', 'exact' or 'sufficient', got {method!r}")
    limit = as_count("most", most)
    for one in (outer, inner):
        require_single("a set asked about", one)
    if getattr(inner, "is_empty", False):
        return Answer(True, np.inf) if inner.proved_empty else Answer(None, 0.0, reason=inside.TOUCHING)
    if isinstance(outer, Generated) and not getattr(inner, "is_bounded", True):
        # What has no bounds leaves the hull too.
        verdict = inside.in_polytope(outer.interval_hull().to_polytope(), inner, method, limit)
        return verdict if verdict.holds is False else Answer(None, -np.inf, reason=inside.UNBOUNDED)
    for kind, answer in CONTAINS.items():
        if isinstance(outer, kind):
            return answer(outer, inner, method, limit)
    type_name = type(outer).__name__
    raise ReachError(f"containment in a {type_name} is not supported; enclose or convert it first")


@checked
def disjoint(X: Any, Y: Any) -> Answer:
    """Decide whether two sets have no point in common.

    Sets with flat faces go through one linear program, sets with an ellipsoid in them through
    Wolfe's nearest points (`reach.sets.relations.distance`). Either finds a direction; a "yes" is said only
    if the supports of both sets along it, rounding included, really leave a gap, a "no" only if the point
    found passes the inequalities of both sets when they are asked again.

    Parameters
    ----------
    X, Y : set of this library
        Single sets, at most one of them unbounded unless both are polytopes.

    Returns
    -------
    Answer
        ``margin`` is a proved lower bound on the Euclidean distance, ``direction`` separates (an
        unbounded polytope: its part within the interval hull of the other set), ``witness`` is a
        common point (to 1e-9 of the sets' sizes).

    Raises
    ------
    ReachError
        If the dimensions differ or a set is a stack.
    """
    require_same_dim(X, Y)
    for one in (X, Y):
        require_single("a set asked about", one)
        if getattr(one, "is_empty", False):
            return Answer(True, np.inf) if one.proved_empty else Answer(None, 0.0, reason=apart.CLOSER)
    return apart.separate(X, Y)


def intersect(X: Any, Y: Any) -> Any:
    """The points of both sets: of two boxes a box, of all inequalities a polytope, lazy with any others."""
    require_same_dim(X, Y)
    if isinstance(X, Interval) and isinstance(Y, Interval):
        lo, hi = np.maximum(X.lo, Y.lo), np.minimum(X.hi, Y.hi)
        if np.any(lo > hi):
            raise ReachError("the intersection of the intervals is empty")
        return Interval(lo, hi)
    parts = [part for one in (X, Y) for part in (one.parts if isinstance(one, Intersection) else (one,))]
    rows = [part.to_polytope() for part in parts if isinstance(part, Interval | HPolytope)]
    others = [part for part in parts if not isinstance(part, Interval | HPolytope)]
    if rows:
        others = [HPolytope(np.vstack([P.A for P in rows]), np.hstack([P.b for P in rows])), *others]
    return others[0] if len(others) == 1 else Intersection(tuple(others))


def minkowski_sum(X: Any, Y: Any) -> Any:
    """The sums of a point of each set: an interval or a zonotope where that is exact, else lazy and flat."""
    Z, box = (X, Y) if isinstance(X, Zonotope) else (Y, X)
    if isinstance(box, Interval) and isinstance(Z, Zonotope):
        return Z + box.to_zonotope()
    if isinstance(X, Interval) and isinstance(Y, Interval):
        require_same_dim(X, Y)
        require_alike(X.batch, Y.batch)
        return Interval(add_down(X.lo, Y.lo), add_up(X.hi, Y.hi))
    parts = [part for one in (X, Y) for part in (one.parts if isinstance(one, MinkowskiSum) else (one,))]
    return MinkowskiSum(tuple(parts))


CONTAINS: dict[type, Callable[..., Answer]] = {
    Interval: lambda outer, *others: inside.in_polytope(outer.to_polytope(), *others),
    HPolytope: inside.in_polytope,
    Zonotope: inside.in_zonotope,
    Ellipsoid: inside.in_ellipsoid,
    AffineImage: inside.in_image,
    Intersection: inside.in_intersection,
}
"""Of the outer set's class, whatever the inner one. No entry: not offered."""
