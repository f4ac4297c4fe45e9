"""Exact results that no class represents, evaluated through their support functions."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ..numerics.checks import Array, as_map, as_vector, require_same_dim, require_single
from ..numerics.errors import ReachError
from ..numerics.rounding import gamma
from .convex import SetOperators, weighed
from .interval import Interval

if TYPE_CHECKING:
    from .polytope import HPolytope


class DerivedSet(SetOperators):
    """Set made of other sets: empty as soon as one of them is, unbounded if one may be."""

    @property
    @abstractmethod
    def operands(self) -> tuple[Any, ...]:
        """The other sets."""

    @property
    def is_empty(self) -> bool:
        """Return True if one of the sets is empty."""
        return any(getattr(part, "is_empty", False) for part in self.operands)

    @property
    def proved_empty(self) -> bool:
        """Return True if one of the sets is proved to be empty."""
        return any(getattr(part, "is_empty", False) and part.proved_empty for part in self.operands)

    @property
    def is_bounded(self) -> bool:
        """Return True if a box around the set was proved."""
        return bool(np.all(np.isfinite(self.extent)))

    def _with_rounding(self, values: Array, D: Array, sign: int, terms: int) -> Array:
        """Values with their rounding added; infinite ones stay, and those of unbounded sets are unproved."""
        with np.errstate(invalid="ignore"):
            bounds = values + sign * gamma(terms) * weighed(D, self.extent)
        return np.asarray(np.where(np.isposinf(values), np.inf, bounds))


@dataclass(frozen=True, eq=False)
class AffineImage(DerivedSet):
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
        require_single("the base of an affine image", self.base)
        M = as_map(self.M, self.base.dim, single=True)
        object.__setattr__(self, "M", M)
        object.__setattr__(self, "v", as_vector(self.v, len(M), single=True))

    @property
    def dim(self) -> int:
        """Dimension m of the space."""
        return len(self.M)

    @property
    def operands(self) -> tuple[Any, ...]:
        """The base."""
        return (self.base,)

    @property
    def center(self) -> Array:
        """Image of the base set's centre, shape (m,)."""
        return np.asarray(self.M @ self.base.center + self.v)

    def _support(self, D: Array) -> Array:
        return np.asarray(self.base.support(D @ self.M) + D @ self.v)

    def _rounded_support(self, D: Array, sign: int) -> Array:
        inner = self.base.support_up(D @ self.M) if sign > 0 else self.base.support_down(D @ self.M)
        return self._with_rounding(inner + D @ self.v, D, sign, 2 * self.dim)

    def _furthest(self, D: Array) -> Array:
        return np.asarray(self.base.support_vector(D @ self.M) @ self.M.T + self.v)

    @property
    def extent(self) -> Array:
        """Elementwise bound on the points, before rounding, shape (m,)."""
        return weighed(self.M, self.base.extent) + np.abs(self.v)

    @property
    def terms(self) -> int:
        """Number of products summed in one value of the support function."""
        return self.dim + int(self.base.terms)

    def __rmatmul__(self, M: ArrayLike) -> AffineImage:
        """Linear image."""
        M = as_map(M, self.dim, single=True)
        return AffineImage(M @ self.M, self.base, M @ self.v)

    def _translated(self, v: Array) -> AffineImage:
        return AffineImage(self.M, self.base, self.v + v)

    def to_polytope(self) -> HPolytope:
        """Inequalities around the image of a bounded polytope, its offsets rounded up.

        With ``R M`` close to A, ``R (y - v) <= b + |R M - A| |x|`` for the images y of all x with
        ``A x <= b``.

        Raises
        ------
        ReachError
            If the map has no inverse to working precision, or the base set is no polytope or unbounded.
        """
        from .polytope import HPolytope

        base = self.base.to_polytope() if isinstance(self.base, Interval) else self.base
        if not isinstance(base, HPolytope) or not base.is_bounded:
            raise ReachError("only the image of a bounded polytope or box is written by inequalities")
        W = inverse(self.M)
        R, n = base.A @ W, self.dim
        residual = np.abs(R @ self.M - base.A) + gamma(n) * (np.abs(R) @ np.abs(self.M) + np.abs(base.A))
        allowance = residual @ base.extent + gamma(n) * (np.abs(R) @ np.abs(self.v) + np.abs(base.b))
        return HPolytope(R, base.b + R @ self.v + allowance * (1 + gamma(n)))


def inverse(M: Array) -> Array:
    """Approximate inverse of a square matrix, which must have one to working precision."""
    if M.shape[0] != M.shape[1] or not np.linalg.cond(M) < 1e15:
        raise ReachError(f"the map must have an inverse to working precision, its shape is {M.shape}")
    return np.asarray(np.linalg.inv(M))


@dataclass(frozen=True, eq=False)
class CompositeSet(DerivedSet):
    """Base of sets that are made of single sets of one dimension, kept unevaluated."""

    parts: tuple[Any, ...]

    def __post_init__(self) -> None:
        if not isinstance(self.parts, tuple | list) or not self.parts:
            raise ReachError(f"{type(self).__name__} needs a tuple of at least one set")
        object.__setattr__(self, "parts", tuple(self.parts))
        for part in self.parts:
            require_same_dim(self.parts[0], part)
            require_single(f"a part of a lazy {type(self).__name__}", part)

    @property
    def operands(self) -> tuple[Any, ...]:
        """The parts."""
        return self.parts

    @property
    def dim(self) -> int:
        """Dimension n of the space."""
        return int(self.parts[0].dim)

    @property
    def terms(self) -> int:
        """Number of products summed in one value of the support function."""
        return sum(int(part.terms) for part in self.parts)


class MinkowskiSum(CompositeSet):
    """``{x_1 + ... + x_k : x_i in X_i}``, kept unevaluated.

    Parameters
    ----------
    parts : tuple of ConvexSet
        Single sets of one dimension.
    """

    @property
    def center(self) -> Array:
        """Sum of the centres, shape (n,)."""
        return np.asarray(sum(part.center for part in self.parts))

    def _support(self, D: Array) -> Array:
        return np.asarray(sum(part.support(D) for part in self.parts))

    def _rounded_support(self, D: Array, sign: int) -> Array:
        values = (part.support_up(D) if sign > 0 else part.support_down(D) for part in self.parts)
        return self._with_rounding(np.asarray(sum(values)), D, sign, len(self.parts))

    def _furthest(self, D: Array) -> Array:
        return np.asarray(sum(part.support_vector(D) for part in self.parts))

    @property
    def extent(self) -> Array:
        """Elementwise bound on the points, before rounding, shape (n,)."""
        return np.asarray(sum(part.extent for part in self.parts))

    def __rmatmul__(self, M: ArrayLike) -> MinkowskiSum:
        """Linear image: the sum of the images."""
        return MinkowskiSum(tuple(as_map(M, self.dim, single=True) @ part for part in self.parts))

    def _translated(self, v: Array) -> MinkowskiSum:
        return MinkowskiSum((self.parts[0] + v, *self.parts[1:]))

    def _scaled(self, a: float) -> MinkowskiSum:
        return MinkowskiSum(tuple(part * a for part in self.parts))
