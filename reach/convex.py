"""What every convex set answers, and the operators that follow from it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import ReachError
from .rounding import gamma

if TYPE_CHECKING:
    from .interval import Interval

Array = NDArray[np.float64]


@runtime_checkable
class ConvexSet(Protocol):
    """A closed convex set that can be asked for its furthest point in a direction.

    Anything with these members can be checked against anything else (`reach.contains`,
    `reach.disjoint`); the sets of this library also have the operators of `SetOperators`.
    """

    @property
    def dim(self) -> int:
        """Dimension n of the space."""

    @property
    def center(self) -> Array:
        """A point of the set, the centre of symmetry where there is one, shape (n,)."""

    def support(self, directions: ArrayLike) -> Array:
        """Largest ``d . x`` over the set, shape (..., r) for rows (..., r, n), () for one (n,)."""

    def support_vector(self, directions: ArrayLike) -> Array:
        """Points of the set that attain the support, shape of `directions`."""

    def interval_hull(self) -> Interval:
        """Smallest axis-aligned box around the set, rounded outwards."""

    def contains(self, points: ArrayLike, slack: float = 1e-9) -> NDArray[np.bool_]:
        """Whether each point lies in the set, shape (...) for points (..., n)."""


class SetOperators(ABC):
    """Operators as on paper: ``M @ X``, ``X + Y``, ``X + v``, ``a * X``, ``-X``, ``x in X``, ``X <= Y``.

    All are exact; what a class cannot represent comes back as a lazily evaluated
    `reach.MinkowskiSum` or `reach.AffineImage`. Enclosures have names, never operators.
    """

    # Let ``M @ X`` and ``v + X`` reach this class instead of numpy's broadcasting.
    __array_ufunc__ = None

    @property
    @abstractmethod
    def dim(self) -> int:
        """Dimension n of the space."""

    @abstractmethod
    def __rmatmul__(self, M: ArrayLike) -> Any:
        """Linear image ``M @ X``."""

    @abstractmethod
    def __add__(self, other: Any) -> Any:
        """Minkowski sum with another set, or translation by a vector."""

    @abstractmethod
    def __mul__(self, factor: float) -> Any:
        """Scaled copy ``{a x}``."""

    @abstractmethod
    def contains(self, points: ArrayLike, slack: float = 1e-9) -> NDArray[np.bool_]:
        """Whether each point lies in the set."""

    @abstractmethod
    def support(self, directions: ArrayLike) -> Array:
        """Largest ``d . x`` over the set."""

    @property
    @abstractmethod
    def extent(self) -> Array:
        """Elementwise bound on the points, before rounding, shape (..., n)."""

    @property
    @abstractmethod
    def terms(self) -> int:
        """Number of products summed in one value of the support function."""

    def support_up(self, directions: ArrayLike) -> Array:
        """Support with its rounding booked: never below the true value, shape (..., r)."""
        D = as_vector(directions, self.dim)
        booked = gamma(self.terms) * (np.abs(D) @ self.extent[..., None])[..., 0]
        return np.asarray(self.support(D) + booked)

    def __radd__(self, other: Any) -> Any:
        return self + other

    def __rmul__(self, factor: float) -> Self:
        return self * factor  # type: ignore[no-any-return]

    def __neg__(self) -> Self:
        return self * -1.0  # type: ignore[no-any-return]

    def __sub__(self, vector: ArrayLike) -> Self:
        """Translation by the opposite vector."""
        if isinstance(vector, SetOperators):
            raise ReachError("a set is not subtracted from a set: write X + (-Y) for the Minkowski sum")
        return self + (-as_vector(vector, self.dim))  # type: ignore[no-any-return]

    def __contains__(self, point: ArrayLike) -> bool:
        return bool(self.contains(as_vector(point, self.dim)))

    def project(self, dims: Sequence[int]) -> Any:
        """Image on some of the coordinates, in the order given (exact)."""
        return selector(dims, self.dim) @ self


def magnitude(X: ConvexSet, directions: ArrayLike) -> Array:
    """Largest ``|d . x|`` over a set, shape (..., r) for rows (..., r, n)."""
    D = np.asarray(directions, dtype=float)
    return np.maximum(X.support(D), X.support(-D))


def as_vector(value: ArrayLike, n: int) -> Array:
    """A finite vector (or stack of them) of n entries, or one clear error."""
    vector = np.asarray(value, dtype=float)
    if vector.ndim == 0 or vector.shape[-1] != n:
        raise ReachError(f"expected vectors of {n} entries, got shape {vector.shape}")
    if not np.all(np.isfinite(vector)):
        raise ReachError("a vector must have finite entries, got nan or inf")
    return vector


def as_map(value: ArrayLike, n: int) -> Array:
    """A finite matrix (or stack of them) that acts on dimension n, or one clear error."""
    M = np.asarray(value, dtype=float)
    if M.ndim < 2 or M.shape[-1] != n:
        raise ReachError(f"cannot apply a map of shape {M.shape} to a set of dimension {n}")
    if not np.all(np.isfinite(M)):
        raise ReachError("a map must have finite entries, got nan or inf")
    return M


def as_factor(value: float) -> float:
    """A finite number, or one clear error."""
    if np.ndim(value) != 0 or not np.isfinite(value):
        raise ReachError(f"a set is scaled by one finite number, got {value!r}")
    return float(value)


def require_same_dim(a: ConvexSet | SetOperators, b: ConvexSet | SetOperators) -> None:
    """Refuse sets of different dimensions."""
    if a.dim != b.dim:
        raise ReachError(f"sets of dimensions {a.dim} and {b.dim} do not go together")


def selector(dims: Sequence[int], n: int) -> Array:
    """Rows of the identity that pick coordinates, shape (len(dims), n)."""
    picked = list(dims)
    if not picked or len(set(picked)) != len(picked) or not all(0 <= i < n for i in picked):
        raise ReachError(f"dims must be different numbers from 0 to {n - 1}, got {picked}")
    return np.asarray(np.eye(n)[picked])
