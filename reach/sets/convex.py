"""Interface of every convex set, and the operators that follow from it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol, Self, cast, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..numerics.checks import Array, as_factor, as_map, as_vector, checked, require_sets, selector
from ..numerics.errors import ReachError
from ..numerics.rounding import gamma

if TYPE_CHECKING:
    from .interval import Interval
    from .zonotope import Zonotope


@runtime_checkable
class ConvexSet(Protocol):
    """A closed convex set that can be asked for its furthest point in a direction.

    The sets of this library also include their rounding and have operators, see `SetOperators`.
    """

    @property
    @abstractmethod
    def dim(self) -> int:
        """Dimension n of the space."""

    @property
    @abstractmethod
    def center(self) -> Array:
        """A point of the set, the centre of symmetry where there is one, shape (n,)."""

    @abstractmethod
    def support(self, directions: ArrayLike) -> Array:
        """Largest ``d . x`` over the set, shape (..., r) for rows (..., r, n), () for one (n,)."""

    @abstractmethod
    def support_vector(self, directions: ArrayLike) -> Array:
        """Points of the set that attain the support, shape of `directions`."""

    @abstractmethod
    def interval_hull(self) -> Interval:
        """Smallest axis-aligned box around the set, rounded outwards."""

    @abstractmethod
    def contains(self, points: ArrayLike, slack: float = 1e-9) -> NDArray[np.bool_]:
        """Return True for each point that lies in the set, shape (...) for points (..., n)."""


class SetOperators(ConvexSet, ABC):
    """Operators as on paper: ``M @ X``, ``X + Y``, ``X + v``, ``a * X``, ``-X``, ``x in X``, ``X <= Y``.

    All are exact; what a class cannot represent comes back as a lazily evaluated
    `reach.MinkowskiSum` or `reach.AffineImage`. Enclosures have names, never operators. What depends on
    the classes of both sets is in `reach.sets.relations.pairs`.
    """

    # Let ``M @ X`` and ``v + X`` reach this class instead of numpy's broadcasting.
    __array_ufunc__ = None

    @property
    @abstractmethod
    def extent(self) -> Array:
        """Elementwise bound on the points, before rounding, shape (..., n)."""

    @property
    @abstractmethod
    def terms(self) -> int:
        """Number of products summed in one value of the support function."""

    def _translated(self, v: Array) -> Any:
        """The set moved by one vector."""
        from .lazy import AffineImage

        return AffineImage(np.eye(self.dim), self, v)

    def _scaled(self, a: float) -> Any:
        """The set times a number."""
        return a * np.eye(self.dim) @ self

    def __rmatmul__(self, M: ArrayLike) -> Any:
        """Linear image ``M @ X``."""
        from .lazy import AffineImage

        M = as_map(M, self.dim, single=True)
        return AffineImage(M, self, np.zeros(M.shape[0]))

    def __add__(self, other: Any) -> Any:
        """Minkowski sum with another set, or translation by a vector."""
        if isinstance(other, SetOperators):
            from .relations.pairs import minkowski_sum

            return minkowski_sum(self, other)
        return self._translated(as_vector(other, self.dim, single=True))

    def __mul__(self, factor: float) -> Any:
        """Scaled copy ``{a x}``."""
        return self._scaled(as_factor(factor))

    def support(self, directions: ArrayLike) -> Array:
        """Largest value of each direction over the set, shape (..., r) for rows (..., r, n)."""
        return np.asarray(self._support(self._rows(directions)))

    def support_vector(self, directions: ArrayLike) -> Array:
        """Points of the set that attain the support, shape of `directions` broadcast with the batch."""
        return np.asarray(self._furthest(self._rows(directions)))

    def _rows(self, directions: ArrayLike) -> Array:
        """Finite rows (..., r, n), or one vector (n,)."""
        return as_vector(directions, self.dim)

    @abstractmethod
    def _support(self, D: Array) -> Array: ...

    @abstractmethod
    def _furthest(self, D: Array) -> Array: ...

    def support_up(self, directions: ArrayLike) -> Array:
        """Support with its rounding included: never below the true value, shape (..., r)."""
        return self._rounded_support(as_vector(directions, self.dim), 1)

    def support_down(self, directions: ArrayLike) -> Array:
        """Support with its rounding included: never above the true value, shape (..., r)."""
        return self._rounded_support(as_vector(directions, self.dim), -1)

    def _rounded_support(self, D: Array, sign: int) -> Array:
        """Support with its rounding included upwards (1) or downwards (-1)."""
        return np.asarray(self.support(D) + sign * gamma(self.terms) * weighed(D, self.extent))

    def interval_hull(self) -> Interval:
        """Smallest box around the set, rounded outwards."""
        from .interval import Interval

        low, high = -self.support_up(-np.eye(self.dim)), self.support_up(np.eye(self.dim))
        return Interval(np.minimum(low, high), high)

    @checked
    def contains(self, points: ArrayLike, slack: float = 1e-9) -> NDArray[np.bool_]:
        """Return True for each point in the set, to `slack` times its size; shape (...) for points (..., n).

        Half-widths, coefficients and norms are taken ``1 + slack`` times, of a row the sizes of its terms. A
        (single) zonotope takes one linear program for each point.
        """
        return np.asarray(self._holds(as_vector(points, self.dim), slack))

    def _holds(self, x: Array, slack: float) -> NDArray[np.bool_]:
        from .relations.distance import contains_by_distance

        return contains_by_distance(self, x, slack)

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
        return bool(self.contains(as_vector(point, self.dim, single=True)))

    def __and__(self, other: Any) -> Any:
        """Intersection with another set: a box of two boxes, a polytope of inequalities, else lazy.

        See `reach.Intersection`; a lazy one is bounded from outside where it is evaluated.

        Raises
        ------
        ReachError
            If two boxes have no point in common.
        """
        from .relations.pairs import intersect

        return intersect(self, other)

    def __le__(self, other: Any) -> bool:
        """Return True if this set is proved to lie in the other one; see `reach.contains`."""
        from .relations.pairs import contains

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

        F = as_map(frame, self.dim, single=True)
        if F.shape != (self.dim, self.dim) or not np.linalg.cond(F) < 1e12:
            raise ReachError(f"frame must be an invertible {self.dim} x {self.dim} matrix")
        R = np.linalg.inv(F)
        # x = F y; the range of y - R x is added: |F^-1| |1 - F R| |x|, first order doubled.
        residual = np.abs(np.eye(self.dim) - F @ R) + gamma(self.dim) * (np.abs(F) @ np.abs(R))
        extent = self.interval_hull().extent
        allowance = 2 * np.abs(R) @ (residual @ extent) + gamma(self.dim) * np.abs(R) @ extent
        box = Interval(-self.support_up(-R) - allowance, self.support_up(R) + allowance)
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


def weighed(rows: Array, extent: Array) -> Array:
    """``|rows| . extent`` with ``0 * inf = 0``, shape (..., r) for rows (..., r, n)."""
    if np.all(np.isfinite(extent)):
        return np.asarray((np.abs(rows) @ extent[..., None])[..., 0])
    return np.asarray(np.where(rows != 0, np.abs(rows) * np.where(rows != 0, extent, 0.0), 0.0).sum(axis=-1))
