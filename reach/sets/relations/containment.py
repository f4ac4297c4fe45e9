"""Is one set inside another? Exact where that is affordable, with a witness for every "no"."""

from collections.abc import Callable
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ...numerics.checks import Array
from ...numerics.errors import ReachError
from ...numerics.rounding import Whole, floats, gamma, integers
from ..convex import weighed
from ..ellipsoid import Ellipsoid
from ..intersection import Intersection
from ..interval import Interval
from ..lazy import AffineImage, MinkowskiSum, inverse
from ..norms import largest_norm
from ..polytope import HPolytope
from ..zonotope import FLAT, Zonotope, combination_count, facet_normals
from .distance import Answer

Method = Literal["auto", "exact", "sufficient"]
Settle = Callable[[NDArray[np.intp]], list[bool | None]]

MOST = 20_000  # facets of an outer zonotope, or branches over an inner one, looked at by default
TOUCHING = "the sets touch to within rounding"
UNBOUNDED = "a set without proved bounds, under a map or in a sum, is not decided"


def in_intersection(outer: Intersection, inner: Any, method: Method, most: int) -> Answer:
    """Inside every part."""
    from .pairs import contains

    answers = [contains(part, inner, method, most) for part in outer.parts]
    for verdict in (False, None):
        decisive = [answer for answer in answers if answer.holds is verdict]
        if decisive:
            return decisive[0]
    return min(answers, key=lambda answer: answer.margin)


def in_image(outer: AffineImage, inner: Any, method: Method, most: int) -> Answer:
    """The inner set drawn back through the map, with the map's error added on every axis.

    With W close to the inverse of M and ``F = 1 - W M``, the x with ``M x + v = y`` differs from
    ``W (y - v)`` by ``F x``, and ``|F| s <= t s`` with ``|W (y - v)| <= s`` shows ``|x| <= s / (1 - t)``.
    """
    from .pairs import contains

    M, v, n = outer.M, outer.v, outer.dim
    W = inverse(M)
    if outer.is_empty:
        if not outer.proved_empty:
            return Answer(None, -np.inf, reason=TOUCHING)
        return Answer(False, -np.inf, _beyond(inner, np.eye(n)[0], 0.0))
    if not np.all(np.isfinite(inner.extent)):
        return Answer(None, -np.inf, reason=UNBOUNDED)
    extent = inner.extent * (1 + gamma(n)) + np.abs(v)
    F = np.abs(np.eye(n) - W @ M) + gamma(n) * (np.abs(W) @ np.abs(M) + np.eye(n))
    size = np.abs(W) @ extent * (1 + gamma(n))
    size = np.maximum(size, 1e-9 * size.max(initial=0.0)) + np.finfo(float).tiny
    factor = float(np.max(F @ size / size))
    if not factor < 0.5:
        return Answer(None, -np.inf, reason="the map is too ill-conditioned to be drawn back through")
    allowance = (F @ size / (1 - factor) + gamma(2 * n) * np.abs(W) @ extent) * (1 + gamma(n))
    back = W @ (inner + (-v)) if isinstance(inner, Zonotope | Ellipsoid) else AffineImage(W, inner, -(W @ v))
    proved = contains(outer.base, back + Interval(-allowance, allowance), method, most)
    if proved:
        return proved
    answer = contains(outer.base, back, method, most)
    if answer.holds is False and answer.direction is not None:
        d, base = answer.direction, outer.base
        excess = float(back.support_down(d)) - float(base.support_up(d)) - float(weighed(d, allowance))
        if excess > 0:
            return Answer(False, answer.margin, inner.support_vector(d @ W), d @ W)
    return Answer(None, answer.margin if answer.holds is None else 0.0, reason=answer.reason or TOUCHING)


def in_polytope(outer: HPolytope, inner: Any, method: Method, most: int) -> Answer:
    """Every row against the support of the inner set."""

    def settle(indices: NDArray[np.intp]) -> list[bool | None]:
        if isinstance(inner, HPolytope):
            return [True if inner.bases.proves(outer.A[i], outer.b[i]) else None for i in indices]
        if not isinstance(inner, Zonotope | Interval):
            return [None]
        rows, offsets = integers(outer.A[indices], outer.b[indices])
        (c, G), unit = _doubled(inner)
        return list(rows @ c + np.abs(rows @ G).sum(axis=1) <= 2 * unit * offsets)

    return _by_rows(outer.A, outer.b, outer.b, np.linalg.norm(outer.A, axis=1), inner, settle)


def _in_facets(outer: Zonotope, inner: Any, normals: Whole) -> Answer:
    """The supports of both sets along every facet normal of the outer one."""
    whole = np.hstack([normals, -normals]).T
    rows = floats(whole.T).T
    # The rows are the exact normals to one rounding, included for both sets.
    allowance = gamma(1) * np.abs(rows) @ (outer.extent + inner.extent)

    def settle(indices: NDArray[np.intp]) -> list[bool | None]:
        if not isinstance(inner, Zonotope | Interval):
            return [None]
        sets = _doubled(inner, outer)[0], _doubled(outer, inner)[0]
        supports = [whole[indices] @ c + np.abs(whole[indices] @ G).sum(axis=1) for c, G in sets]
        return list(supports[0] <= supports[1])

    radius = np.maximum(np.abs(rows @ outer.G).sum(axis=1), FLAT * np.abs(rows) @ outer.extent)
    units = np.where(radius > 0, radius, 1.0)
    return _by_rows(rows, outer.support_down(rows) - allowance, outer.support_up(rows), units, inner, settle)


def _by_rows(rows: Array, least: Array, largest: Array, units: Array, inner: Any, settle: Settle) -> Answer:
    """Decide ``rows . x <= offsets``, in [least, largest], over the inner set; near ones by `settle`."""
    margins = (least - inner.support_up(rows)) / units
    margin = float(margins.min(initial=np.inf))
    if margin >= 0:
        return Answer(True, margin)
    undecided = np.flatnonzero(margins < 0)
    excess = (inner.support_down(rows[undecided]) - largest[undecided]) / units[undecided]
    if excess.max() > 0:
        worst = undecided[np.argmax(excess)]
        point = _beyond(inner, rows[worst], largest[worst])
        allowance = gamma(len(point)) * (np.abs(rows[worst]) @ np.abs(point) + abs(largest[worst]))
        if not rows[worst] @ point - largest[worst] > allowance:
            return Answer(None, margin, reason=TOUCHING)
        return Answer(False, margin, point, rows[worst])
    for i, inside in zip(undecided, settle(undecided), strict=False):
        if inside is None:
            return Answer(None, margin, reason=TOUCHING if np.isfinite(margin) else UNBOUNDED)
        if not inside:
            return Answer(False, margin, inner.support_vector(rows[i]), rows[i])
    return Answer(True, 0.0)


def _beyond(inner: Any, row: Array, offset: float) -> Array:
    """A point of the inner set with ``row . x > offset``; not infinitely far where the set is unbounded."""
    if getattr(inner, "is_bounded", True):
        return np.asarray(inner.support_vector(row))
    if isinstance(inner, AffineImage):
        preimage = _beyond(inner.base, np.asarray(row @ inner.M), offset - float(np.dot(row, inner.v)))
        return np.asarray(inner.M @ preimage + inner.v)
    if isinstance(inner, MinkowskiSum):
        subtotal = sum(-float(part.support(-row)) for part in inner.parts if np.isfinite(part.support(-row)))
        return np.asarray(sum(_beyond(part, row, offset - min(subtotal, 0.0)) for part in inner.parts))
    nearest = max(offset, -float(inner.support(-row)))
    inner = inner.intersect_halfspace(row, nearest + max(1.0, abs(nearest)))
    return np.asarray(inner.support_vector(row))


def _doubled(*sets: Zonotope | Interval) -> tuple[tuple[Whole, Whole], int]:
    """Twice the centre and generators of the first set in a common unit, and how many units are one."""
    arrays = [a for X in sets for a in ((X.c, X.G) if isinstance(X, Zonotope) else (X.lo, X.hi))]
    first, second, *rest = integers(*arrays, np.ones(1))
    if isinstance(sets[0], Zonotope):
        return (2 * first, 2 * second), rest[-1][0]
    return (first + second, np.diag(second - first)), rest[-1][0]


def in_ellipsoid(outer: Ellipsoid, inner: Any, method: Method, most: int) -> Answer:
    """The largest norm of the inner set, in coordinates in which the ellipsoid is the unit ball."""
    n = outer.dim
    if outer.L.shape[1] != n or not np.linalg.cond(outer.L) < 1e12:
        raise ReachError("containment in a flat ellipsoid is not decided: its matrix L must be invertible")
    W = np.linalg.inv(outer.L)
    # W (x - c) = u - F u for x = c + L u, so norm(u) <= norm(W (x - c)) / (1 - norm(F)).
    F = np.abs(np.eye(n) - W @ outer.L) + gamma(n) * np.abs(W) @ np.abs(outer.L)
    centred = inner + (-outer.c)
    image = W @ centred
    allowance = gamma(2 * n) * float(np.linalg.norm(np.abs(W) @ (inner.extent + np.abs(outer.c))))
    defect = float(np.linalg.norm(F))
    if method == "sufficient" and isinstance(image, Zonotope):
        upper = float(image.norm_bound(np.eye(n)))
        bracket = None
    else:
        bracket = largest_norm(image, most, 1.0)
        upper = bracket.upper
    upper = (upper + allowance) / (1 - defect)
    if upper <= 1:
        return Answer(True, 1 - upper)
    if bracket is None:
        return Answer(None, 1 - upper, reason="the norm bound of the inner set exceeds one")
    if (bracket.lower - allowance) / (1 + defect) > 1:
        direction = W.T @ bracket.point
        return Answer(False, 1 - bracket.lower, np.asarray(inner.support_vector(direction)), direction)
    if method == "exact" and bracket.upper - bracket.lower > 1e-6:
        raise ReachError(f"more than {most} branches are needed; allow more, or use method='sufficient'")
    return Answer(None, 1 - upper, reason=TOUCHING if upper < 1 + 1e-6 else "the norm is only bracketed")


def in_zonotope(outer: Zonotope, inner: Any, method: Method, most: int) -> Answer:
    """Decide by all facets, or by one linear program, as the method says."""
    if method == "exact":
        return _in_facets(outer, inner, facet_normals(outer.G, most))
    proved = _by_program(outer, inner)
    if proved.holds is not None or method == "sufficient" or combination_count(outer.G) > most:
        return proved
    return _in_facets(outer, inner, facet_normals(outer.G, most))


def _by_program(outer: Zonotope, inner: Any) -> Answer:
    """Prove containment by one linear program, or refute it along some directions."""
    image = inner if isinstance(inner, Zonotope) else inner.enclosing_zonotope()
    scale = scale_to_hold(outer, image)
    if scale <= 1:
        return Answer(True, 1 - scale)
    D = np.random.default_rng(0).normal(size=(64, outer.dim)) / np.where(outer.extent > 0, outer.extent, 1)
    D = np.vstack([D, np.eye(outer.dim), -np.eye(outer.dim)])
    excess = inner.support_down(D) - outer.support_up(D)
    if excess.max() > 0:
        worst = D[np.argmax(excess)]
        return Answer(False, 1 - scale, np.asarray(inner.support_vector(worst)), worst)
    return Answer(None, 1 - scale, reason="the linear program is only sufficient")


def scale_to_hold(outer: Zonotope, inner: Zonotope) -> float:
    """A factor t with ``inner`` inside ``{c + t G b}`` of the outer set, proved; inf if none was found.

    The least t for which ``[G_in, c_in - c] = G Gamma`` with row sums ``sum_j |Gamma_ij| <= t``
    (Sadraddini and Tedrake 2019, theorem 3). What rounding leaves of the equation is mapped back
    through a right inverse of G and added to the rows, so t needs no trust in the solver. For a flat
    outer set there is no right inverse, hence no proof.
    """
    from scipy import sparse
    from scipy.optimize import linprog

    size = outer.half_widths
    if np.any(size == 0):
        return np.inf
    G = outer.G[:, np.any(outer.G != 0, axis=0)] / size[:, None]
    target = np.c_[inner.G, inner.c - outer.c] / size[:, None]
    target = target[:, np.any(target != 0, axis=0)]
    (n, p), q = G.shape, target.shape[1]
    R = np.linalg.pinv(G)
    defect = np.abs(np.eye(n) - G @ R) + gamma(p) * (np.abs(G) @ np.abs(R))
    loss = float(defect.sum(axis=1).max())
    if not loss < 0.5:
        return np.inf
    if q == 0:
        return 0.0
    blocks = sparse.kron(sparse.eye(q), G)
    equalities = sparse.hstack([blocks, -blocks, np.zeros((n * q, 1))])
    sums = sparse.kron(np.ones((1, 2 * q)), sparse.eye(p))
    solved = linprog(
        np.r_[np.zeros(2 * p * q), 1.0],
        sparse.hstack([sums, -np.ones((p, 1))]).tocsr(),
        np.zeros(p),
        equalities.tocsr(),
        target.T.ravel(),
        bounds=(0, None),
    )
    if solved.status != 0:
        return np.inf
    Gamma = (solved.x[: p * q] - solved.x[p * q : -1]).reshape(q, p).T
    residual = np.abs(target - G @ Gamma) + gamma(p) * (np.abs(target) + np.abs(G) @ np.abs(Gamma))
    repair = np.abs(R).sum(axis=1) * residual.max(axis=0).sum() / (1 - loss)
    return float((np.abs(Gamma).sum(axis=1) + repair).max() * (1 + gamma(q)))
