"""Convex polytopes given by inequalities."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .convex import SetOperators, as_factor, as_map, as_vector, require_same_dim, weighed
from .errors import ReachError
from .interval import Interval
from .programs import Maximum, maximise
from .rounding import gamma

Array = NDArray[np.float64]

CONDITION_LIMIT = 1e8
"""A map worse conditioned than this is not inverted; its image stays lazily evaluated."""

FLATNESS = 1e-9
"""An inscribed radius above minus this, relative to the offsets, counts as 'not empty'."""


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
        A, b = np.asarray(self.A, dtype=float), np.asarray(self.b, dtype=float)
        if A.ndim != 2 or A.shape[1] == 0 or b.shape != A.shape[:1]:
            raise ReachError(f"A must have shape (m, n) and b shape (m,), got {A.shape} and {b.shape}")
        if not (np.all(np.isfinite(A)) and np.all(np.isfinite(b))):
            raise ReachError("A and b must be finite numbers")
        if np.any(~A.any(axis=1)):
            raise ReachError(f"row {int(np.argmin(A.any(axis=1)))} of A is zero")
        object.__setattr__(self, "A", A)
        object.__setattr__(self, "b", b)

    # -- facts ----------------------------------------------------------------------------------

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
        found = maximise(np.r_[np.zeros(self.dim), 1.0], np.c_[rows, norms], self.b)
        level = float(np.max(np.abs(self.b) / norms, initial=0.0)) or 1.0
        return found.point[:-1] / np.where(scale > 0, scale, 1.0), found.value / level, found.multipliers

    @property
    def is_empty(self) -> bool:
        """Whether no point satisfies all rows (thinner than `FLATNESS` counts as flat, not empty)."""
        return self._ball[1] < -FLATNESS

    def is_empty_within(self, sizes: Array) -> bool:
        """Whether it is proved that no point with ``|x| <= sizes``, shape (n,), is in the set (Farkas)."""
        if not self.is_empty:
            return False
        level, residual = self.weak_duality(np.zeros((1, self.dim)), self._ball[2][None])
        return bool(level[0] + (1 + gamma(self.dim)) * float(residual[0] @ sizes) < 0)

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
        """Whether a box around the set was proved."""
        return bool(np.all(np.isfinite(self.extent)))

    def _refuse_empty(self) -> None:
        if self.is_empty:
            raise ReachError("the polytope is empty")

    # -- questions ------------------------------------------------------------------------------

    @cached_property
    def _axes(self) -> list[Maximum]:
        """The linear programs along the positive, then the negative axes."""
        return self._programs(np.vstack([np.eye(self.dim), -np.eye(self.dim)]))

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
        if not all(np.isfinite(found.value) for found in self._axes):
            return unbounded
        levels, residuals = self.weak_duality(
            np.vstack([np.eye(n), -np.eye(n)]), np.array([found.multipliers for found in self._axes])
        )
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
            Both with rounding booked.
        """
        m = len(self.b)
        level = multipliers @ self.b + gamma(m) * (multipliers @ np.abs(self.b))
        left = np.abs(directions - multipliers @ self.A)
        return level, left + gamma(m) * (multipliers @ np.abs(self.A) + np.abs(directions))

    def support(self, directions: ArrayLike) -> Array:
        """Largest value of each direction, one linear program each, shape (..., r); inf if unbounded.

        The bound of `support_up` where there is one, else what the solver says (1e-9 relative). An
        empty set is refused.
        """
        D = as_vector(directions, self.dim)
        found = self._programs(D)
        proved = self._proved(D, found)
        values = np.array([one.value for one in found]).reshape(D.shape[:-1])
        return np.where(np.isfinite(proved), proved, values)

    def support_up(self, directions: ArrayLike) -> Array:
        """Support proved by weak duality, residuals booked, shape (..., r); inf where there is no proof.

        Of a bounded set there always is one.
        """
        D = as_vector(directions, self.dim)
        return self._proved(D, self._programs(D))

    def support_down(self, directions: ArrayLike) -> Array:
        """Value at the solver's point less its tolerance, shape (..., r); inf if unbounded."""
        D = as_vector(directions, self.dim)
        found = self._programs(D)
        values = np.array([one.value for one in found]).reshape(D.shape[:-1])
        points = np.array([one.point for one in found]).reshape(D.shape)
        room = np.nan_to_num(np.abs(D) * np.abs(points)).sum(axis=-1) + np.abs(
            np.nan_to_num(values, posinf=0)
        )
        return np.asarray(values - FLATNESS * room)

    @cached_property
    def _program(self) -> Callable[[bytes], Maximum]:
        return lru_cache(1024)(lambda direction: maximise(np.frombuffer(direction), self.A, self.b))

    def _programs(self, D: Array) -> list[Maximum]:
        self._refuse_empty()
        return [self._program(d.tobytes()) for d in D.reshape(-1, self.dim)]

    def _proved(self, D: Array, found: list[Maximum]) -> Array:
        values = np.full(len(found), np.inf)
        for i, one in enumerate(found):
            if np.isfinite(one.value):
                level, residual = self.weak_duality(D.reshape(-1, self.dim)[i : i + 1], one.multipliers[None])
                values[i] = level[0] + weighed(residual, self.extent)[0]
        return values.reshape(D.shape[:-1])

    def support_vector(self, directions: ArrayLike) -> Array:
        """Points of the set that attain the support, shape of `directions`; refused where unbounded."""
        D = as_vector(directions, self.dim)
        points = np.array([found.point for found in self._programs(D)])
        if np.any(np.isnan(points)):
            raise ReachError("the polytope is unbounded in a direction asked for")
        return points.reshape(D.shape)

    def interval_hull(self) -> Interval:
        """Smallest box around the set, by 2 n linear programs, rounded outwards.

        Raises
        ------
        ReachError
            If the set is empty or unbounded.
        """
        if not self.is_bounded:
            raise ReachError("the polytope is unbounded: it has no interval hull")
        n = self.dim
        level, residual = self.weak_duality(
            np.vstack([np.eye(n), -np.eye(n)]), np.array([found.multipliers for found in self._axes])
        )
        ends = level + residual @ self.extent
        return Interval(np.minimum(-ends[n:], ends[:n]), ends[:n])

    def contains(self, points: ArrayLike, slack: float = 1e-9) -> NDArray[np.bool_]:
        """Whether each point satisfies all rows to `slack` times the sizes of their terms, shape (...)."""
        x = as_vector(points, self.dim)
        room = slack * (np.abs(x) @ np.abs(self.A.T) + np.abs(self.b))
        return np.asarray(np.all(x @ self.A.T <= self.b + room, axis=-1))

    # -- operations, all exact ------------------------------------------------------------------

    def __rmatmul__(self, M: ArrayLike) -> Any:
        """Linear image: a polytope for a well-conditioned square map, else a lazy `AffineImage`."""
        from .lazy import AffineImage

        M = as_map(M, self.dim)
        if M.shape != (self.dim, self.dim) or not np.linalg.cond(M) < CONDITION_LIMIT:
            return AffineImage(M, self, np.zeros(M.shape[0]))
        return HPolytope(np.asarray(np.linalg.solve(M.T, self.A.T).T, dtype=float), self.b)

    def __add__(self, other: Any) -> Any:
        """Translation by a vector, or the (lazy) Minkowski sum with a set."""
        from .lazy import minkowski_sum

        if isinstance(other, SetOperators):
            return minkowski_sum(self, other)
        return HPolytope(self.A, self.b + self.A @ as_vector(other, self.dim))

    def __mul__(self, factor: float) -> Any:
        """Scaled copy ``{a x}``."""
        a = as_factor(factor)
        if a == 0:
            return np.zeros((self.dim, self.dim)) @ self
        return HPolytope(np.sign(a) * self.A, abs(a) * self.b)

    def __and__(self, other: HPolytope) -> HPolytope:
        """Intersection; rows are kept, redundant ones too. May be empty, see `is_empty`."""
        require_same_dim(self, other)
        return HPolytope(np.vstack([self.A, other.A]), np.r_[self.b, other.b])

    def intersect_halfspace(self, normal: ArrayLike, offset: float) -> HPolytope:
        """Part of the set with ``normal . x <= offset`` (exact)."""
        return self & HPolytope(as_vector(normal, self.dim)[None], np.asarray([float(offset)]))

    # -- other descriptions -----------------------------------------------------------------------

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
            raise ReachError("the polytope is flat: its vertices are not offered")
        scale = hull.half_widths
        rows, room = self.A * scale, self.b - self.A @ self.center
        norms = np.linalg.norm(rows, axis=1)
        points = HalfspaceIntersection(np.c_[rows, -room] / norms[:, None], np.zeros(self.dim)).intersections
        points = points[np.all(np.isfinite(points), axis=1)]
        near = np.unique(np.round(points, 9), axis=0, return_index=True)[1]
        return np.asarray(points[near] * scale + self.center)

    def volume(self) -> float:
        """Volume of the hull of the vertices; see `vertices` for what is refused."""
        from scipy.spatial import ConvexHull

        points = self.vertices()
        if self.dim == 1:
            return float(np.ptp(points))
        scale = self.interval_hull().half_widths
        return float(ConvexHull((points - self.center) / scale).volume * np.prod(scale))
