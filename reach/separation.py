"""Do two sets meet? A common point, or a direction that is re-checked to separate them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from .answer import Answer
from .convex import require_same_dim, require_single, weighed
from .distance import nearest, unit_sizes
from .exact import integers
from .interval import Interval
from .lazy import AffineImage, MinkowskiSum
from .polytope import HPolytope
from .programs import maximise
from .zonotope import Zonotope

Array = NDArray[np.float64]

COMMON = 1e-9
"""Points of the two sets this close, in sizes of the sets, count as a common point."""


def disjoint(X: Any, Y: Any) -> Answer:
    """Whether two sets have no point in common.

    Sets with flat faces go through one linear program, sets with an ellipsoid in them through
    Wolfe's nearest points (`reach.distance`). Either finds a direction; a "yes" is said only if the
    supports of both sets along it, rounding booked, really leave a gap.

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
        require_single(one, "disjoint")
        if isinstance(one, HPolytope) and one.is_empty:
            return Answer(True, np.inf)
    first, second = _lifted(X), _lifted(Y)
    if first is not None and second is not None:
        return _by_program(X, Y, first, second)
    for one, other in ((X, Y), (Y, X)):
        if isinstance(one, HPolytope) and not one.is_bounded:
            box = other.interval_hull()
            apart = disjoint(X, box) if one is X else disjoint(box, Y)
            within = one & box.to_polytope()
            return (
                apart if apart or within.is_empty else disjoint(*((within, Y) if one is X else (X, within)))
            )
    found = nearest(X, Y)
    room = -float(X.support_up(found.direction) + Y.support_up(-found.direction))
    return _answer(found.direction, room, found.x, found.gap)


def _answer(direction: Array, room: float, point: Array, gap: float) -> Answer:
    length = float(np.linalg.norm(direction))
    if length > 0 and room > 0:
        return Answer(True, room / length, direction=direction)
    if gap <= COMMON:
        return Answer(False, 0.0, point)
    return Answer(None, 0.0, reason="the sets are closer than rounding can tell")


@dataclass(frozen=True)
class _Lifted:
    """``{c + G z : A z <= b}``."""

    c: Array
    G: Array
    A: Array
    b: Array


def _lifted(X: Any) -> _Lifted | None:
    """A set with flat faces as the image of a polytope; None for any other set."""
    if isinstance(X, Interval):
        X = X.to_zonotope()
    if isinstance(X, Zonotope):
        eye = np.eye(X.order_count)
        return _Lifted(X.c, X.G, np.vstack([eye, -eye]), np.ones(2 * len(eye)))
    if isinstance(X, HPolytope):
        return _Lifted(np.zeros(X.dim), np.eye(X.dim), X.A, X.b)
    if isinstance(X, AffineImage):
        base = _lifted(X.base)
        return base and _Lifted(X.M @ base.c + X.v, X.M @ base.G, base.A, base.b)
    if isinstance(X, MinkowskiSum):
        parts = [_lifted(part) for part in X.parts]
        known = [part for part in parts if part is not None]
        if len(known) == len(parts):
            A = block_diag(*(part.A for part in known))
            c = np.sum([part.c for part in known], axis=0)
            return _Lifted(c, np.hstack([part.G for part in known]), A, np.hstack([part.b for part in known]))
    return None


def _by_program(X: Any, Y: Any, first: _Lifted, second: _Lifted) -> Answer:
    """``min sum |x - y|_i / size_i``; the multipliers are the direction (Farkas)."""
    n, sizes = X.dim, [np.where(np.isfinite(one.extent), one.extent, 0.0) for one in (X, Y)]
    size = unit_sizes(np.maximum(*sizes))
    gaps = np.hstack([first.G, -second.G]) / size[:, None]
    offset = (first.c - second.c) / size
    rows = block_diag(first.A, second.A)
    A = np.block([[gaps, -np.eye(n)], [-gaps, -np.eye(n)], [rows, np.zeros((len(rows), n))]])
    b = np.r_[-offset, offset, first.b, second.b]
    found = maximise(np.r_[np.zeros(gaps.shape[1]), -np.ones(n)], A, b)
    if not np.isfinite(found.value):
        return Answer(None, 0.0, reason="the linear program has no finite answer")
    over, under, mine, theirs = np.split(found.multipliers, np.cumsum([n, n, len(first.A)]))
    direction = (under - over) / size
    if isinstance(X, HPolytope):
        direction = mine @ X.A
    elif isinstance(Y, HPolytope):
        direction = -theirs @ Y.A
    if isinstance(X, HPolytope) and isinstance(Y, HPolytope) and _cancel(X & Y, np.r_[mine, theirs]):
        gap, length = -(mine @ X.b + theirs @ Y.b), np.linalg.norm(direction)
        margin = max(float(gap) * (1 - 1e-9) / float(length), 0.0) if length > 0 else 0.0
        return Answer(True, margin, direction=direction)
    # Only points of both sets need be refuted, so a polytope may borrow the other set's bounds.
    common = np.minimum(X.extent, Y.extent)
    top = _top(X, direction, mine, common) + _top(Y, -direction, theirs, common)
    x = first.c + first.G @ found.point[: first.G.shape[1]]
    return _answer(direction, -top, x, -found.value)


def _top(X: Any, direction: Array, multipliers: Array, common: Array) -> float:
    """Proved upper bound of ``direction . x`` over the points of X within ``|x| <= common``."""
    if not isinstance(X, HPolytope):
        return float(X.support_up(direction))
    level, residual = X.weak_duality(direction[None], multipliers[None])
    return float(level[0] + weighed(residual, common)[0])


def _cancel(P: HPolytope, multipliers: Array) -> bool:
    """Whether the rows, so weighed, cancel without rounding and leave ``0 <= negative``."""
    A, b = integers(P.A, P.b)
    (weights,) = integers(multipliers)
    return not np.any(weights @ A) and bool(weights @ b < 0)
