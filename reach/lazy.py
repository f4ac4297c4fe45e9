"""Exact results that no class represents, evaluated through their support functions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .convex import SetOperators, as_factor, as_map, as_vector, require_same_dim, require_single, weighed
from .errors import ReachError
from .interval import Interval
from .membership import contains_by_distance
from .rounding import gamma

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class AffineImage(SetOperators):
    """``{M x + v : x in base}``, kept unevaluated.

    Parameters
    ----------
    M : array_like, shape (m, n)
    base : ConvexSet
        A single set of dimension n.
    v : array_like, shape (m,)
    """

    M: Array
    base: Any
    v: Array

    def __post_init__(self) -> None:
        M = as_map(self.M, self.base.dim)
        if M.ndim != 2:
            raise ReachError(f"M must be one matrix, got shape {M.shape}")
        object.__setattr__(self, "M", M)
        object.__setattr__(self, "v", as_vector(self.v, len(M)))

    @property
    def dim(self) -> int:
        """Dimension m of the space."""
        return len(self.M)

    @property
    def center(self) -> Array:
        """Image of the base set's centre, shape (m,)."""
        return np.asarray(self.M @ self.base.center + self.v)

    def support(self, directions: ArrayLike) -> Array:
        """Largest value of each direction over the set, shape (..., r) for rows (..., r, m)."""
        D = as_vector(directions, self.dim)
        return np.asarray(self.base.support(D @ self.M) + D @ self.v)

    def support_up(self, directions: ArrayLike) -> Array:
        """Support with its rounding booked: never below the true value, shape (..., r)."""
        D = as_vector(directions, self.dim)
        return np.asarray(self.base.support_up(D @ self.M) + D @ self.v + self._booked(D))

    def support_down(self, directions: ArrayLike) -> Array:
        """Support with its rounding booked: never above the true value, shape (..., r)."""
        D = as_vector(directions, self.dim)
        return np.asarray(self.base.support_down(D @ self.M) + D @ self.v - self._booked(D))

    def _booked(self, D: Array) -> Array:
        return gamma(2 * self.dim) * weighed(D, self.extent)

    def support_vector(self, directions: ArrayLike) -> Array:
        """Points of the set that attain the support, shape of `directions`."""
        D = as_vector(directions, self.dim)
        return np.asarray(self.base.support_vector(D @ self.M) @ self.M.T + self.v)

    @property
    def extent(self) -> Array:
        """Elementwise bound on the points, before rounding, shape (m,)."""
        return weighed(self.M, self.base.extent) + np.abs(self.v)

    @property
    def terms(self) -> int:
        """Number of products summed in one value of the support function."""
        return self.dim + int(self.base.terms)

    def interval_hull(self) -> Interval:
        """Smallest box around the set, rounded outwards."""
        eye = np.eye(self.dim)
        return Interval(-self.support_up(-eye), self.support_up(eye))

    def contains(self, points: ArrayLike, slack: float = 1e-9) -> NDArray[np.bool_]:
        """Whether each point lies in the set, to `slack` times its size; shape (...) for (..., m)."""
        return contains_by_distance(self, points, slack)

    def __rmatmul__(self, M: ArrayLike) -> AffineImage:
        """Linear image."""
        M = as_map(M, self.dim)
        return AffineImage(M @ self.M, self.base, M @ self.v)

    def __add__(self, other: Any) -> Any:
        """Minkowski sum with another set, or translation by a vector."""
        if isinstance(other, SetOperators):
            return minkowski_sum(self, other)
        return AffineImage(self.M, self.base, self.v + as_vector(other, self.dim))

    def __mul__(self, factor: float) -> AffineImage:
        """Scaled copy ``{a x}``."""
        a = as_factor(factor)
        return AffineImage(a * self.M, self.base, a * self.v)


@dataclass(frozen=True, eq=False)
class MinkowskiSum(SetOperators):
    """``{x_1 + ... + x_k : x_i in X_i}``, kept unevaluated.

    Parameters
    ----------
    parts : tuple of ConvexSet
        Single sets of one dimension.
    """

    parts: tuple[Any, ...]

    def __post_init__(self) -> None:
        if not self.parts:
            raise ReachError("a Minkowski sum needs at least one set")
        for part in self.parts[1:]:
            require_same_dim(self.parts[0], part)

    @property
    def dim(self) -> int:
        """Dimension n of the space."""
        return int(self.parts[0].dim)

    @property
    def center(self) -> Array:
        """Sum of the centres, shape (n,)."""
        return np.asarray(sum(part.center for part in self.parts))

    def support(self, directions: ArrayLike) -> Array:
        """Largest value of each direction over the set, shape (..., r) for rows (..., r, n)."""
        return np.asarray(sum(part.support(directions) for part in self.parts))

    def support_up(self, directions: ArrayLike) -> Array:
        """Support with its rounding booked: never below the true value, shape (..., r)."""
        D = as_vector(directions, self.dim)
        booked = gamma(len(self.parts)) * weighed(D, self.extent)
        return np.asarray(sum(part.support_up(D) for part in self.parts) + booked)

    def support_down(self, directions: ArrayLike) -> Array:
        """Support with its rounding booked: never above the true value, shape (..., r)."""
        D = as_vector(directions, self.dim)
        booked = gamma(len(self.parts)) * weighed(D, self.extent)
        return np.asarray(sum(part.support_down(D) for part in self.parts) - booked)

    def support_vector(self, directions: ArrayLike) -> Array:
        """Points of the set that attain the support, shape of `directions`."""
        return np.asarray(sum(part.support_vector(directions) for part in self.parts))

    @property
    def extent(self) -> Array:
        """Elementwise bound on the points, before rounding, shape (n,)."""
        return np.asarray(sum(part.extent for part in self.parts))

    @property
    def terms(self) -> int:
        """Number of products summed in one value of the support function."""
        return sum(int(part.terms) for part in self.parts)

    def interval_hull(self) -> Interval:
        """Smallest box around the set, rounded outwards."""
        total = self.parts[0].interval_hull()
        for part in self.parts[1:]:
            total = total + part.interval_hull()
        return total  # type: ignore[no-any-return]

    def contains(self, points: ArrayLike, slack: float = 1e-9) -> NDArray[np.bool_]:
        """Whether each point lies in the set, to `slack` times its size; shape (...) for (..., n)."""
        return contains_by_distance(self, points, slack)

    def __rmatmul__(self, M: ArrayLike) -> MinkowskiSum:
        """Linear image: the sum of the images."""
        return MinkowskiSum(tuple(as_map(M, self.dim) @ part for part in self.parts))

    def __add__(self, other: Any) -> MinkowskiSum:
        """Minkowski sum with another set, or translation by a vector."""
        if isinstance(other, SetOperators):
            return minkowski_sum(self, other)
        return MinkowskiSum((self.parts[0] + as_vector(other, self.dim), *self.parts[1:]))

    def __mul__(self, factor: float) -> MinkowskiSum:
        """Scaled copy ``{a x}``."""
        return MinkowskiSum(tuple(part * as_factor(factor) for part in self.parts))


def minkowski_sum(*sets: Any) -> MinkowskiSum:
    """Lazy Minkowski sum; nested sums are flattened."""
    for part in sets:
        require_single(part, "a lazy Minkowski sum")
    flat = [part for s in sets for part in (s.parts if isinstance(s, MinkowskiSum) else (s,))]
    return MinkowskiSum(tuple(flat))
