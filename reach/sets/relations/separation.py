"""Do two sets meet? A common point, or a direction that is re-checked to separate them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from ...numerics.checks import Array
from ...numerics.programs import maximise
from ...numerics.rounding import gamma, integers
from ..convex import weighed
from ..intersection import Intersection
from ..interval import Interval
from ..lazy import AffineImage, MinkowskiSum
from ..polytope import HPolytope
from ..zonotope import Zonotope
from .containment import UNBOUNDED
from .distance import Answer, nearest, unit_sizes

COMMON = 1e-9  # points of the two sets this close, in sizes of the sets, count as a common point
CLOSER = "the sets are closer than rounding can tell"


def separate(X: Any, Y: Any) -> Answer:
    """Separate two sets by a linear program if both have flat faces, else by nearest points."""
    middle, size, units = _frame(X, Y)
    first, second = lifted(X, middle, size), lifted(Y, middle, size)
    if first is not None and second is not None:
        return _by_program(X, Y, first, second, units)
    for P, other, sign in ((X, Y, 1.0), (Y, X, -1.0)):
        if isinstance(P, HPolytope) and not P.is_bounded and getattr(other, "is_bounded", True):
            box = other.interval_hull()
            answer, within = separate(P, box), P & box
            answer = answer if answer or within.is_empty else separate(within, other)
            return answer if answer.direction is None else replace(answer, direction=sign * answer.direction)
    if not all(getattr(one, "is_bounded", True) for one in (X, Y)):
        return Answer(None, 0.0, reason=UNBOUNDED)
    near = nearest(X, Y, units)
    gap = -float(X.support_up(near.direction) + Y.support_up(-near.direction))
    return _answer(X, Y, near.direction, gap, near.x, near.y, units)


def _frame(X: Any, Y: Any) -> tuple[Array, Array, Array]:
    """Return centre and sizes of the frame for polytopes, and the units of a distance of the two sets."""
    hulls = [one.interval_hull() for one in (X, Y) if getattr(one, "is_bounded", True)]
    if not hulls:
        sizes = np.maximum(_own_frame(X)[1], _own_frame(Y)[1])
        return np.zeros(X.dim), sizes, sizes
    half = unit_sizes(np.max([hull.half_widths for hull in hulls], axis=0))
    lo, hi = np.min([hull.lo for hull in hulls], axis=0), np.max([hull.hi for hull in hulls], axis=0)
    return (lo + hi) / 2, unit_sizes((hi - lo) / 2), half


def _answer(X: Any, Y: Any, direction: Array, gap: float, x: Array, y: Array, units: Array) -> Answer:
    """Return "disjoint" if the direction proves it, a common point if x and y are close and stand."""
    length = float(np.linalg.norm(direction))
    if length > 0 and gap > 0:
        return Answer(True, gap / length, direction=direction)
    # Points far from the origin are known to the rounding of their coordinates only.
    grain = units + gamma(X.dim) / COMMON * (np.abs(x) + np.abs(y))
    if np.all(np.isfinite(x) & np.isfinite(y)) and np.all(np.abs(x - y) <= 4 * COMMON * grain):
        for point in (x / 2 + y / 2, x, y):
            if all(_stands(one, point, 8 * COMMON * grain) for one in (X, Y)):
                return Answer(False, 0.0, point)
    return Answer(None, 0.0, reason=CLOSER)


def _stands(X: Any, point: Array, grain: Array) -> bool:
    """Return True if a point meets the set's own description, to `grain` along every axis."""
    if isinstance(X, HPolytope):
        return bool(np.all(X.A @ point - X.b <= np.abs(X.A) @ grain))
    if isinstance(X, Intersection):
        return all(_stands(part, point, grain) for part in X.parts)
    if not getattr(X, "is_bounded", True):
        return False  # nothing that is asked again shows it
    hull = X.interval_hull()
    return not (np.any(point < hull.lo - grain) or np.any(point > hull.hi + grain))


def _by_program(X: Any, Y: Any, first: Lifted, second: Lifted, units: Array) -> Answer:
    """``min sum |x - y|_i / unit_i``; the multipliers are the direction (Farkas)."""
    n = X.dim
    gaps = np.hstack([first.G, -second.G]) / units[:, None]
    offset = (first.c - second.c) / units
    rows = block_diag(first.A, second.A)
    A = np.block([[gaps, -np.eye(n)], [-gaps, -np.eye(n)], [rows, np.zeros((len(rows), n))]])
    b = np.r_[-offset, offset, first.b, second.b]
    optimum = maximise(np.r_[np.zeros(gaps.shape[1]), -np.ones(n)], A, b)
    if not np.isfinite(optimum.value):
        return Answer(None, 0.0, reason="the linear program has no finite answer")
    over, under, duals_x, duals_y = np.split(optimum.multipliers, np.cumsum([n, n, len(first.A)]))
    direction = (under - over) / units
    if isinstance(X, HPolytope):
        direction = duals_x @ X.A
    elif isinstance(Y, HPolytope):
        direction = -duals_y @ Y.A
    if isinstance(X, HPolytope) and isinstance(Y, HPolytope) and _cancel(X & Y, np.r_[duals_x, duals_y]):
        gap, length = -(duals_x @ X.b + duals_y @ Y.b), np.linalg.norm(direction)
        margin = max(float(gap) * (1 - 1e-9) / float(length), 0.0) if length > 0 else 0.0
        return Answer(True, margin, direction=direction)
    # Only points of both sets need be refuted, so a polytope may borrow the other set's bounds.
    common = np.minimum(X.extent, Y.extent)
    top = _top(X, direction, duals_x, common) + _top(Y, -direction, duals_y, common)
    z, w = np.split(optimum.point[: gaps.shape[1]], [first.G.shape[1]])
    stands = all(
        np.all(one.A @ at - one.b <= 8 * COMMON * np.abs(one.A).sum(axis=1))
        for one, at in ((first, z), (second, w))
    )
    x, y = first.c + first.G @ z, second.c + second.G @ w
    return _answer(X, Y, direction, -top, x if stands else np.full(n, np.nan), y, units)


def _top(X: Any, direction: Array, multipliers: Array, common: Array) -> float:
    """Proved upper bound of ``direction . x`` over the points of X within ``|x| <= common``."""
    if not isinstance(X, HPolytope):
        return float(X.support_up(direction))
    level, residual = X.weak_duality(direction[None], multipliers[None])
    return float(level[0] + weighed(residual, common)[0])


def _cancel(P: HPolytope, multipliers: Array) -> bool:
    """Return True if the weighted rows cancel without rounding and leave ``0 <= negative``."""
    A, b = integers(P.A, P.b)
    (weights,) = integers(multipliers)
    return not np.any(weights @ A) and bool(weights @ b < 0)


@dataclass(frozen=True)
class Lifted:
    """``{c + G z : A z <= b}``, the z of about unit size where the set's own size is known."""

    c: Array
    G: Array
    A: Array
    b: Array


def lifted(X: Any, middle: Array, size: Array) -> Lifted | None:
    """A set with flat faces as the image of a polytope (about a middle, in sizes); None for any other set."""
    if isinstance(X, Interval):
        return Lifted(X.center, np.diag(X.half_widths), *_cube(X.dim))
    if isinstance(X, Zonotope):
        return Lifted(X.c, X.G, *_cube(X.order_count))
    if isinstance(X, HPolytope):
        return Lifted(middle, np.diag(size), X.A * size, X.b - X.A @ middle)
    if isinstance(X, AffineImage):
        base = lifted(X.base, *_own_frame(X.base))
        return base and Lifted(X.M @ base.c + X.v, X.M @ base.G, base.A, base.b)
    if isinstance(X, MinkowskiSum | Intersection):
        parts = [lifted(part, *_own_frame(part)) for part in X.parts]
        lifts = [part for part in parts if part is not None]
        if len(lifts) == len(parts):
            return _summed(lifts) if isinstance(X, MinkowskiSum) else _shared(lifts)
    return None


def _cube(g: int) -> tuple[Array, Array]:
    return np.vstack([np.eye(g), -np.eye(g)]), np.ones(2 * g)


def _own_frame(X: Any) -> tuple[Array, Array]:
    """A point and sizes to measure a set with; those of its offsets where it is unbounded."""
    if isinstance(X, HPolytope):
        return X.frame
    return np.zeros(X.dim), np.ones(X.dim)


def _summed(parts: list[Lifted]) -> Lifted:
    A = block_diag(*(part.A for part in parts))
    c = np.sum([part.c for part in parts], axis=0)
    return Lifted(c, np.hstack([part.G for part in parts]), A, np.hstack([part.b for part in parts]))


def _shared(parts: list[Lifted]) -> Lifted:
    """Points of the first set that are points of all others, each equation as two rows."""
    first, A = parts[0], block_diag(*(part.A for part in parts))
    rows, offsets, column = [A], [part.b for part in parts], first.G.shape[1]
    for part in parts[1:]:
        equations = np.zeros((len(first.c), A.shape[1]))
        equations[:, : first.G.shape[1]] = first.G
        equations[:, column : column + part.G.shape[1]] = -part.G
        column += part.G.shape[1]
        live = equations.any(axis=1)
        rows += [equations[live], -equations[live]]
        offsets += [(part.c - first.c)[live], (first.c - part.c)[live]]
    G = np.zeros((len(first.c), A.shape[1]))
    G[:, : first.G.shape[1]] = first.G
    return Lifted(first.c, G, np.vstack(rows), np.hstack(offsets))
