"""What every convex set answers, and the operators that follow from it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol, Self, cast, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..numerics.errors import ReachError
from ..numerics.rounding import gamma

if TYPE_CHECKING:
    from .interval import Interval
    from .zonotope import Zonotope

Array = NDArray[np.float64]


@runtime_checkable
class ConvexSet(Protocol):
    """A closed convex set that can be asked for its furthest point in a direction.

    The sets of this library also book their rounding and have operators, see `SetOperators`.
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

    @property
    @abstractmethod
    def center(self) -> Array:
        """A point of the set."""

    @abstractmethod
    def support(self, directions: ArrayLike) -> Array:
        """Largest ``d . x`` over the set."""

    @abstractmethod
    def support_vector(self, directions: ArrayLike) -> Array:
        """Points of the set that attain the support."""

    @abstractmethod
    def interval_hull(self) -> Interval:
        """Smallest axis-aligned box around the set, rounded outwards."""

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
        return np.asarray(self.support(D) + gamma(self.terms) * weighed(D, self.extent))

    def support_down(self, directions: ArrayLike) -> Array:
        """Support with its rounding booked: never above the true value, shape (..., r)."""
        D = as_vector(directions, self.dim)
        return np.asarray(self.support(D) - gamma(self.terms) * weighed(D, self.extent))

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
        return bool(self.contains(as_one_vector(point, self.dim)))

    def __and__(self, other: Any) -> Any:
        """Intersection with another set: a polytope where both are given by inequalities, else lazy.

        See `reach.Intersection`; a lazy one is bounded from outside where it is evaluated.
        """
        from .meet import intersect

        return intersect(self, other)

    def __le__(self, other: Any) -> bool:
        """Whether this set is proved to lie in the other one; see `reach.contains`."""
        from .containment import contains

        return bool(contains(other, self))

    def product(self, other: Any) -> Any:
        """Cartesian product: this set's coordinates, then the other's (exact)."""
        require_sets(other)
        n, m = self.dim, other.dim
        return np.eye(n + m)[:, :n] @ self + np.eye(n + m)[:, n:] @ other

    def project(self, dims: Sequence[int]) -> Any:
        """Image on some of the coordinates, in the order given (exact)."""
        return selector(dims, self.dim) @ self

    def enclosing_zonotope(self, frame: ArrayLike | None = None) -> Zonotope:
        """A zonotope around the set: the smallest parallelotope with the columns of a frame as edges.

        Parameters
        ----------
        frame : array_like, shape (n, n), optional
            Invertible. By default the set itself where it is a zonotope, else its interval hull.

        Raises
        ------
        ReachError
            If the frame has no inverse to working precision, or the set is unbounded or empty.
        """
        if frame is None:
            same = getattr(self, "to_zonotope", None) or self.interval_hull().to_zonotope
            return cast("Zonotope", same())
        from .interval import Interval

        F = as_matrix(frame, self.dim)
        if F.shape != (self.dim, self.dim) or not np.linalg.cond(F) < 1e12:
            raise ReachError(f"frame must be an invertible {self.dim} x {self.dim} matrix")
        R = np.linalg.inv(F)
        # x = F y; what y - R x can be is booked: |F^-1| |1 - F R| |x|, first order doubled.
        left = np.abs(np.eye(self.dim) - F @ R) + gamma(self.dim) * (np.abs(F) @ np.abs(R))
        extent = self.interval_hull().extent
        booked = 2 * np.abs(R) @ (left @ extent) + gamma(self.dim) * np.abs(R) @ extent
        box = Interval(-self.support_up(-R) - booked, self.support_up(R) + booked)
        return box.to_zonotope().__rmatmul__(F)

    def vertices_2d(self) -> Array:
        """Vertices of a planar set, counter-clockwise, shape (k, 2).

        Of intervals and zonotopes, stacks too, shape (..., 2 g, 2): of a zonotope points repeat or
        lie on an edge where generators vanish or are parallel.

        Raises
        ------
        ReachError
            If the set is not planar, unbounded, or round.
        """
        from .outlines import vertices_2d

        return vertices_2d(self)

    def plot(self, ax: Any = None, dims: Sequence[int] = (0, 1), **style: Any) -> Any:
        """Draw the projection on two coordinates, and return the axes.

        Exact for sets with flat faces; round ones are drawn as the polygon of `OUTLINE` supporting
        lines, which contains them. Needs matplotlib.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            The current axes by default.
        dims : sequence of two int
        **style
            Passed on to ``ax.fill``.
        """
        from .outlines import outline

        if ax is None:
            from matplotlib import pyplot

            ax = pyplot.gca()
        polygon = outline(self.project(dims))
        ax.fill(polygon[:, 0], polygon[:, 1], **({"alpha": 0.5} | style))
        return ax


def magnitude(X: ConvexSet, directions: ArrayLike) -> Array:
    """Largest ``|d . x|`` over a set, shape (..., r) for rows (..., r, n)."""
    D = np.asarray(directions, dtype=float)
    return np.maximum(X.support(D), X.support(-D))


def weighed(rows: Array, extent: Array) -> Array:
    """``|rows| . extent`` with ``0 * inf = 0``, shape (..., r) for rows (..., r, n)."""
    if np.all(np.isfinite(extent)):
        return np.asarray((np.abs(rows) @ extent[..., None])[..., 0])
    return np.asarray(np.where(rows != 0, np.abs(rows) * np.where(rows != 0, extent, 0.0), 0.0).sum(axis=-1))


def as_numbers(name: str, value: Any) -> Array:
    """An array of floats, or one clear error."""
    if isinstance(value, np.ndarray) and value.dtype == float:
        return value
    try:
        found = np.asarray(value)
        if found.dtype.kind not in "biufO":
            raise TypeError("they are not real numbers")
        return np.asarray(found, dtype=float)
    except (TypeError, ValueError, OverflowError) as exc:
        raise ReachError(f"{name} must be numbers, got {type(value).__name__}: {exc}") from None


def as_vector(value: ArrayLike, n: int) -> Array:
    """A finite vector (or stack of them) of n entries, or one clear error."""
    vector = as_numbers("a vector", value)
    if vector.ndim == 0 or vector.shape[-1] != n:
        raise ReachError(f"expected vectors of {n} entries, got shape {vector.shape}")
    if not np.all(np.isfinite(vector)):
        raise ReachError("a vector must have finite entries, got nan or inf")
    return vector


def as_rows(value: ArrayLike, n: int, batch: tuple[int, ...]) -> Array:
    """Finite rows (..., r, n), or one vector (n,), that go together with a stack of sets."""
    D = as_vector(value, n)
    if batch and D.ndim > 2:
        require_alike(D.shape[:-2], batch)
    return D


def as_one_vector(value: ArrayLike, n: int) -> Array:
    """A finite vector of n entries, or one clear error."""
    vector = as_vector(value, n)
    if vector.ndim != 1:
        raise ReachError(f"expected one vector of {n} entries, got shape {vector.shape}")
    return vector


def as_map(value: ArrayLike, n: int) -> Array:
    """A finite matrix (or stack of them) that acts on dimension n, or one clear error."""
    M = as_numbers("a map", value)
    if M.ndim < 2 or M.shape[-1] != n:
        raise ReachError(f"cannot apply a map of shape {M.shape} to a set of dimension {n}")
    if not np.all(np.isfinite(M)):
        raise ReachError("a map must have finite entries, got nan or inf")
    return M


def as_matrix(value: ArrayLike, n: int) -> Array:
    """A finite matrix with n columns, or one clear error."""
    M = as_map(value, n)
    if M.ndim != 2:
        raise ReachError(f"a map of a single set must be one matrix, got shape {M.shape}")
    return M


def as_factor(value: float, name: str = "a factor") -> float:
    """A finite number, or one clear error."""
    number = as_numbers(name, value)
    if number.ndim != 0 or not np.isfinite(number):
        raise ReachError(f"{name} must be one finite number, got {value!r}")
    return float(number)


def as_count(name: str, value: Any) -> int:
    """A whole number >= 0, or one clear error."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 0:
        raise ReachError(f"{name} must be a whole number >= 0, got {value!r}")
    return int(value)


def require_same_dim(a: ConvexSet | SetOperators, b: ConvexSet | SetOperators) -> None:
    """Refuse what is no set, and sets of different dimensions."""
    require_sets(a, b)
    if a.dim != b.dim:
        raise ReachError(f"sets of dimensions {a.dim} and {b.dim} do not go together")


def require_sets(*values: Any) -> None:
    """Refuse what is not a convex set."""
    for value in values:
        if not (hasattr(type(value), "support") and hasattr(type(value), "interval_hull")):
            raise ReachError(f"a convex set is needed, got {type(value).__name__}")


def as_alike(first: str, a: ArrayLike, second: str, b: ArrayLike) -> tuple[Array, Array]:
    """Two arrays of numbers broadcast with each other, at least vectors."""
    one, other = as_numbers(first, a), as_numbers(second, b)
    try:
        one, other = np.broadcast_arrays(one, other)
    except ValueError:
        raise ReachError(
            f"{first} and {second} do not go together: shapes {one.shape}, {other.shape}"
        ) from None
    return one, other


def require_alike(*shapes: tuple[int, ...]) -> None:
    """Refuse stacks that do not broadcast with each other."""
    try:
        np.broadcast_shapes(*shapes)
    except ValueError:
        raise ReachError(f"stacks of shapes {', '.join(map(str, shapes))} do not go together") from None


def require_stackable(parts: Any, kind: type) -> None:
    """Refuse what is not a sequence of sets of one kind and shape."""
    good = isinstance(parts, list | tuple) and parts and all(isinstance(part, kind) for part in parts)
    if not good or len({(part.dim, part.batch) for part in parts}) > 1:
        raise ReachError(f"a stack needs a sequence of {kind.__name__} of one dimension and shape")


def stacked(values: Array, index: Any) -> Array:
    """What an index selects from a stack, or one clear error."""
    try:
        return np.asarray(values[index])
    except (IndexError, TypeError, ValueError) as exc:
        raise ReachError(f"an index selects from the batch axes: {exc}") from None


def require_single(X: Any, what: str) -> None:
    """Refuse a stack of sets."""
    if getattr(X, "batch", ()):
        raise ReachError(f"{what} asks a single set, got a stack of shape {X.batch}")


def selector(dims: Sequence[int], n: int) -> Array:
    """Rows of the identity that pick coordinates, shape (len(dims), n)."""
    try:
        picked = [as_count("an entry of dims", i) for i in dims]
    except TypeError:
        raise ReachError(f"dims must be a sequence of numbers, got {dims!r}") from None
    if not picked or len(set(picked)) != len(picked) or not all(0 <= i < n for i in picked):
        raise ReachError(f"dims must be different numbers from 0 to {n - 1}, got {picked}")
    return np.asarray(np.eye(n)[picked])
