"""Largest Euclidean norm over a set: bracketed from both sides."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..numerics.checks import Array, checked, require_single
from ..numerics.rounding import gamma
from ..short_repr import short_repr
from .convex import SetOperators
from .ellipsoid import Ellipsoid
from .interval import Interval
from .lazy import AffineImage, MinkowskiSum
from .zonotope import Zonotope


@short_repr
@dataclass(frozen=True)
class NormBracket:
    """``lower <= max norm(x, 2) <= upper``.

    Attributes
    ----------
    lower, upper : float
        Rounding included. Equal to rounding unless the search was cut short or is only sufficient.
    point : ndarray, shape (n,)
        Point of the set whose norm is `lower`.
    """

    lower: float
    upper: float
    point: Array


@checked
def largest_norm(X: SetOperators, most: int = 20_000, level: float | None = None) -> NormBracket:
    """Bracket of the largest Euclidean norm over a single set.

    Exact (to 1e-9 relative) for zonotopes and intervals by branch and bound over the signs of the
    generators, and for ellipsoids through the S-lemma; for other sets, whose maximum is NP-hard too,
    the interval hull above and a local search below.

    Parameters
    ----------
    X : set of this library
        A single bounded set.
    most : int
        Largest number of branches kept at a time; beyond it the bracket stays wide.
    level : float, optional
        Stop as soon as the maximum is known to lie on one side of this number.
    """
    require_single("a set whose norm is asked", X)
    if isinstance(X, Interval):
        corner = np.where(np.abs(X.lo) > np.abs(X.hi), X.lo, X.hi)
        return _bracket(X, corner, float(np.linalg.norm(corner)))
    if isinstance(X, Zonotope):
        return _over_signs(X, most, level)
    if isinstance(X, Ellipsoid):
        return _s_lemma(X)
    if isinstance(X, AffineImage) and isinstance(X.base, Ellipsoid | Zonotope):
        bracket = largest_norm(X.M @ X.base + X.v, most, level)  # but for the rounding of the image
        allowance = gamma(2 * X.terms) * float(np.linalg.norm(X.extent))
        return NormBracket(bracket.lower - allowance, bracket.upper + allowance, bracket.point)
    bracket = _bracket(X, _climb(X, X.center), float(np.linalg.norm(X.interval_hull().extent)))
    if isinstance(X, MinkowskiSum):
        total = sum(largest_norm(part, most).upper for part in X.parts) * (1 + gamma(len(X.parts)))
        return replace(bracket, upper=min(bracket.upper, total))
    return bracket


def _bracket(X: SetOperators, point: Array, upper: float) -> NormBracket:
    allowance = gamma(X.terms) * float(np.linalg.norm(X.extent))
    return NormBracket(float(np.linalg.norm(point)) - allowance, upper + allowance, point)


def _climb(X: SetOperators, start: Array) -> Array:
    """Local search: the furthest point in the direction of the last one, until it gets no further."""
    point = start
    for _ in range(50):
        further = X.support_vector(point if point.any() else np.ones(X.dim))
        if np.linalg.norm(further) <= np.linalg.norm(point) * (1 + 1e-12):
            break
        point = further
    return point


def _over_signs(Z: Zonotope, branches: int, level: float | None) -> NormBracket:
    """Branch and bound: signs are fixed from the longest generator to the shortest, level by level."""
    G = Z.G[:, np.argsort(-np.linalg.norm(Z.G, axis=0), kind="stable")]
    G = G[:, np.any(G != 0, axis=0)]
    furthest = max((_climb(Z, s) for s in (Z.c, *(Z.c + G.T))), key=np.linalg.norm)
    lower = float(np.linalg.norm(furthest))
    frame = np.linalg.svd(G, full_matrices=True)[0]  # in which the hull bound is tightest
    c, R = frame.T @ Z.c, frame.T @ G
    fixed = c[None] if c.any() or not R.shape[1] else c[None] + R[:, 0]
    upper = 0.0
    for j in range(0 if c.any() or not R.shape[1] else 1, R.shape[1] + 1):
        free = R[:, j:]
        bounds = _bounds(fixed, free)
        greedy = fixed + np.where(fixed @ free < 0, -1.0, 1.0) @ free.T
        norms = np.linalg.norm(greedy, axis=1)
        if norms.max() > lower:
            furthest = frame @ greedy[np.argmax(norms)]
            lower = float(norms.max())
        floor = lower * (1 + 1e-9)
        if level is not None and lower > level:
            return _bracket(Z, furthest, max(float(bounds.max()), upper))
        undecided = bounds > (floor if level is None else max(floor, level))
        upper = max(upper, float(bounds[~undecided].max(initial=floor)))
        fixed, bounds = fixed[undecided], bounds[undecided]
        if len(fixed) == 0:
            return _bracket(Z, furthest, upper)
        if len(fixed) > branches or j == R.shape[1]:
            return _bracket(Z, furthest, max(upper, float(bounds.max())))
        fixed = np.vstack([fixed + R[:, j], fixed - R[:, j]])
    raise AssertionError("the last level always returns")


def _bounds(fixed: Array, free: Array) -> Array:
    """Upper bounds on the norm over ``fixed + rest b``, the least of three, shape (k,)."""
    hull = np.linalg.norm(np.abs(fixed) + np.abs(free).sum(axis=1), axis=1)
    lengths = np.linalg.norm(fixed, axis=1)
    total = lengths + np.linalg.norm(free, axis=0).sum()
    gram = np.sqrt(lengths**2 + 2 * np.abs(fixed @ free).sum(axis=1) + np.abs(free.T @ free).sum())
    return np.asarray(np.minimum(np.minimum(hull, total), gram))


def _s_lemma(E: Ellipsoid) -> NormBracket:
    """``max |c + L u|^2 = min over m >= |L|^2 of m + |c|^2 + c.L (m - L^T L)^-1 L^T.c`` (S-lemma)."""
    U, s, Vt = np.linalg.svd(E.L, full_matrices=False)
    pull = s * (U.T @ E.c)
    top = float(s.max(initial=0.0)) ** 2
    low, high = top, top + float(np.linalg.norm(pull))
    for _ in range(200):  # where the derivative changes sign
        middle = (low + high) / 2
        gap = middle - s**2
        slope = 1 - np.sum(np.divide(pull, gap, out=np.zeros_like(pull), where=gap > 0) ** 2)
        low, high = (middle, high) if slope < 0 else (low, middle)
    gap = high - s**2
    live = (gap > 0) & (pull != 0)
    v = np.divide(pull, gap, out=np.zeros_like(pull), where=live)
    value = high + E.c @ E.c + float(np.sum(v * pull))
    if len(v):
        v[np.argmax(s)] += np.copysign(np.sqrt(max(0.0, 1 - float(v @ v))), v[np.argmax(s)])
        v /= max(1.0, float(np.linalg.norm(v)))
    # Directions that do not pull but are not cleared by the gap either contribute nothing: pull = 0.
    stuck = bool(np.any((gap <= 0) & (pull != 0)))
    upper = np.inf if stuck else float(np.sqrt(value))
    triangle = float(np.linalg.norm(E.c)) + float(s.max(initial=0.0))
    return _bracket(E, E.c + E.L @ (Vt.T @ v), min(upper * (1 + 1e-12), triangle))
