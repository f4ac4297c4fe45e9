"""Convex polytopes given by inequalities."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..numerics.checks import Array, as_factor, as_map, as_vector, checked, finite_fields
from ..numerics.errors import ReachError
from ..numerics.programs import maximise
from ..numerics.rounding import gamma, is_product
from ..short_repr import short_repr
from .bases import EXACT_MOST, Bases, mixed_level
from .convex import SetOperators, weighed
from .interval import Interval
from .relations.distance import unit_sizes

FLATNESS = 1e-9  # an inscribed radius above minus this, relative to the offsets, counts as 'not empty'


@short_repr
@dataclass(frozen=True, eq=False)
class HPolytope(SetOperators):
    """``{x : A x <= b}``; may be unbounded, flat or empty.

    Parameters
    ----------
    A : array_like, shape (m, n)
        Rows, none of them zero.
    b : array_like, shape (m,)

    Raises
    ------
    ReachError
        If the shapes do not fit, an entry is not finite, or a row is zero.
    """

    A: Array
    b: Array

    def __post_init__(self) -> None:
        A, b = finite_fields(self, "A", "b")
        if A.ndim != 2 or A.shape[1] == 0 or b.shape != A.shape[:1]:
            raise ReachError(f"A must have shape (m, n) and b shape (m,), got {A.shape} and {b.shape}")
        if np.any(~A.any(axis=1)):
            raise ReachError(f"row {int(np.argmin(A.any(axis=1)))} of A is zero")

    @property
    def dim(self) -> int:
        """Dimension n of the space."""
        return int(self.A.shape[1])

    @cached_property
    def _ball(self) -> tuple[Array, float, Array]:
        """Largest inscribed ball, axes scaled alike: centre, radius relative to b, multipliers."""
        scale = np.abs(self.A).max(axis=0, initial=0.0)
        rows = self.A / np.where(scale > 0, scale, 1.0)
        norms = np.linalg.norm(rows, axis=1)
        ball = maximise(np.r_[np.zeros(self.dim), 1.0], np.c_[rows, norms], self.b)
        level = float(np.max(np.abs(self.b) / norms, initial=0.0)) or 1.0
        return ball.point[:-1] / np.where(scale > 0, scale, 1.0), ball.value / level, ball.multipliers

    @property
    def is_empty(self) -> bool:
        """True if no point satisfies all rows (thinner than `FLATNESS` counts as flat, not empty)."""
        return self._ball[1] < -FLATNESS

    @checked
    def is_empty_within(self, sizes: Array) -> bool:
        """Return True if the set is proved to have no point with ``|x| <= sizes``, shape (n,) (Farkas)."""
        if not self.is_empty:
            return False
        level, residual = self.weak_duality(np.zeros((1, self.dim)), self._ball[2][None])
        return bool(level[0] + (1 + gamma(self.dim)) * float(residual[0] @ sizes) < 0)

    @cached_property
    def proved_empty(self) -> bool:
        """True if rows, mixed without rounding, leave ``0 <= negative`` (Farkas)."""
        if not self.is_empty or self.dim > EXACT_MOST:
            return False
        used = np.argsort(-self._ball[2] * np.linalg.norm(self.A, axis=1), kind="stable")[: self.dim + 1]
        used = used[self._ball[2][used] > 0]
        sizes = np.exp2(np.round(np.log2(np.linalg.norm(self.A[used], axis=1))))
        rows, levels = np.c_[self.A[used] / sizes[:, None], np.ones(len(used))], self.b[used] / sizes
        level = mixed_level(rows, levels, np.eye(self.dim + 1)[-1]) if np.all(np.isfinite(levels)) else None
        return level is not None and level < 0

    @cached_property
    def frame(self) -> tuple[Array, Array]:
        """A point and sizes to measure with, each (n,); those of the offsets if it has no bounds."""
        if self.is_bounded and not self.is_empty:
            hull = self.interval_hull()
            return hull.center, unit_sizes(hull.half_widths)
        columns = np.abs(self.A).max(axis=0, initial=0.0)
        columns = 1 / np.where(columns > 0, columns, 1.0)
        level = np.abs(self.b) / np.linalg.norm(self.A * columns, axis=1)
        return np.zeros(self.dim), columns * (float(level.max(initial=0.0)) or 1.0)

    @property
    def center(self) -> Array:
        """Centre of a largest inscribed ball, axes scaled alike, shape (n,).

        Raises
        ------
        ReachError
            If the set is empty or holds balls of every size.
        """
        self._refuse_empty()
        if not np.isfinite(self._ball[1]):
            raise ReachError("the polytope has no centre: it holds balls of every size")
        return self._ball[0]

    @property
    def is_bounded(self) -> bool:
        """Return True if a box around the set was proved."""
        return bool(np.all(np.isfinite(self.extent)))

    def _refuse_empty(self) -> None:
        if self.is_empty:
            raise ReachError("the polytope is empty")

    @cached_property
    def _axis_bounds(self) -> tuple[Array, Array]:
        """Weak duality along the positive, then the negative axes; levels (2 n,) are nan without a bound."""
        axes = np.vstack([np.eye(self.dim), -np.eye(self.dim)])
        self._refuse_empty()
        maxima = [self.bases.program(axis.tobytes()) for axis in axes]
        return self.weak_duality(axes, np.array([one.multipliers for one in maxima]))

    @property
    def terms(self) -> int:
        """Number of products summed in one value of the support function."""
        return len(self.b)

    @cached_property
    def extent(self) -> Array:
        """Proved elementwise bound on the points, shape (n,); inf in every entry if there is none.

        Weak duality along the axes leaves residuals, ``|x| <= u + P |x|``; a positive w >= u with
        ``P w <= t w``, t < 1, then proves ``|x| <= w / (1 - t)``.
        """
        n, unbounded = self.dim, np.full(self.dim, np.inf)
        levels, residuals = self._axis_bounds
        if not np.all(np.isfinite(levels)):
            return unbounded
        u, P = np.maximum(levels[:n], levels[n:]), np.maximum(residuals[:n], residuals[n:])
        w = np.maximum(u, max(1e-8 * u.max(), np.finfo(float).tiny))
        shrink = float(np.max(P @ w / w))
        return np.asarray(w / (1 - shrink) * (1 + gamma(n))) if shrink < 0.5 else unbounded

    def weak_duality(self, directions: Array, multipliers: Array) -> tuple[Array, Array]:
        """Proved bounds ``d . x <= level + residual . |x|`` for every x in the set.

        Parameters
        ----------
        directions : ndarray, shape (r, n)
        multipliers : ndarray, shape (r, m)
            Any numbers >= 0.

        Returns
        -------
        level : ndarray, shape (r,)
        residual : ndarray, shape (r, n)
            Both with rounding included.
        """
        m = len(self.b)
        level = multipliers @ self.b + gamma(m) * (multipliers @ np.abs(self.b))
        residual = np.abs(directions - multipliers @ self.A)
        return level, residual + gamma(m) * (multipliers @ np.abs(self.A) + np.abs(directions))

    def _support(self, D: Array) -> Array:
        """The bound of `support_up` where there is one, else the solver's value (1e-9 relative)."""
        values, _, multipliers = self._answers(D)
        proved = self._proved(D, values, multipliers)
        return np.where(np.isfinite(proved), proved, values)

    def _rounded_support(self, D: Array, sign: int) -> Array:
        """Up: proved by weak duality, inf without proof. Down: at the solver's point, less its tolerance."""
        values, points, multipliers = self._answers(D)
        if sign > 0:
            return self._proved(D, values, multipliers)
        finite = np.isfinite(values)
        terms = (np.abs(D) * np.abs(np.where(finite[..., None], points, 0.0))).sum(axis=-1)
        return np.asarray(values - FLATNESS * (terms + np.abs(np.where(finite, values, 0.0))))

    @cached_property
    def bases(self) -> Bases:
        """Vertices found so far, and proofs by the rows that meet in them."""
        return Bases(self.A, self.b)

    def _answers(self, D: Array) -> tuple[Array, Array, Array]:
        """Values, points and multipliers of the largest along directions (..., n)."""
        self._refuse_empty()
        return self.bases.answers(D)

    def _proved(self, D: Array, values: Array, multipliers: Array) -> Array:
        level, residual = self.weak_duality(D, np.where(np.isfinite(multipliers), multipliers, 0.0))
        return np.where(np.isfinite(values), level + weighed(residual, self.extent), np.inf)

    def _furthest(self, D: Array) -> Array:
        points = self._answers(D)[1]
        if np.any(np.isnan(points)):
            raise ReachError("the polytope is unbounded in a requested direction")
        return points

    def interval_hull(self) -> Interval:
        """Smallest box around the set, by 2 n linear programs, rounded outwards.

        Raises
        ------
        ReachError
            If the set is empty or unbounded.
        """
        if not self.is_bounded:
            raise ReachError("the polytope is unbounded: it has no interval hull")
        n, (level, residual) = self.dim, self._axis_bounds
        ends = level + residual @ self.extent
        return Interval(np.minimum(-ends[n:], ends[:n]), ends[:n])

    def _holds(self, x: Array, slack: float) -> NDArray[np.bool_]:
        allowance = slack * (np.abs(x) @ np.abs(self.A.T) + np.abs(self.b))
        return np.asarray(np.all(x @ self.A.T <= self.b + allowance, axis=-1))

    def __rmatmul__(self, M: ArrayLike) -> Any:
        """Linear image: a polytope where its inequalities are free of rounding, else a lazy `AffineImage`.

        `AffineImage.to_polytope` encloses that by inequalities, where the map has an inverse. Translations
        and scaled copies are polytopes under the same condition.
        """
        M = as_map(M, self.dim, single=True)
        if M.shape == (self.dim, self.dim) and np.linalg.cond(M) < 1 / np.finfo(float).eps:
            rows = np.asarray(np.linalg.solve(M.T, self.A.T).T, dtype=np.float64)
            if is_product(self.A, rows, M):
                return HPolytope(rows, self.b)
        return super().__rmatmul__(M)

    def _translated(self, v: Array) -> Any:
        b = self.b + self.A @ v
        if is_product(b, np.c_[self.b, self.A], np.r_[1.0, v]):
            return HPolytope(self.A, b)
        return super()._translated(v)

    def _scaled(self, a: float) -> Any:
        b = abs(a) * self.b
        if a == 0 or not is_product(b, self.b[:, None], np.array([abs(a)])):
            return super()._scaled(a)
        return HPolytope(np.sign(a) * self.A, b)

    def intersect_halfspace(self, normal: ArrayLike, offset: float) -> HPolytope:
        """Part of the set with ``normal . x <= offset`` (exact)."""
        row = as_vector(normal, self.dim, single=True)
        return HPolytope(np.vstack([self.A, row]), np.r_[self.b, as_factor(offset, "offset")])

    def to_polytope(self) -> HPolytope:
        """The set itself."""
        return self

    def vertices(self) -> Array:
        """Vertices to rounding, by Qhull, shape (k, n); an empty, unbounded or flat set is refused."""
        from scipy.spatial import HalfspaceIntersection

        hull = self.interval_hull()
        if self.dim == 1:
            return np.stack([hull.lo, hull.hi])
        if not self._ball[1] > FLATNESS:
            raise ReachError("the vertices of a flat polytope are not supported")
        scale = hull.half_widths
        rows, slack = self.A * scale, self.b - self.A @ self.center
        norms = np.linalg.norm(rows, axis=1)
        points = HalfspaceIntersection(np.c_[rows, -slack] / norms[:, None], np.zeros(self.dim)).intersections
        points = points[np.all(np.isfinite(points), axis=1)]
        near = np.unique(np.round(points, 9), axis=0, return_index=True)[1]
        return np.asarray(points[near] * scale + self.center)

    def volume(self) -> float:
        """Volume of the hull of the vertices; see `vertices` for refused cases."""
        from scipy.spatial import ConvexHull

        points = self.vertices()
        if self.dim == 1:
            return float(np.ptp(points))
        scale = self.interval_hull().half_widths
        return float(ConvexHull((points - self.center) / scale).volume * np.prod(scale))
