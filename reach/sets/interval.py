"""Axis-aligned boxes, one at a time or stacked along leading axes (usually time)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..numerics import checks
from ..numerics.checks import Array, checked
from ..numerics.errors import ReachError
from ..numerics.rounding import add_down, add_up, gamma
from .stacks import SetStack, as_center_and_sizes

if TYPE_CHECKING:
    from .polytope import HPolytope
    from .zonotope import Zonotope


@dataclass(frozen=True, eq=False)
class Interval(SetStack):
    """``{x : lo <= x <= hi}``, or a stack of such boxes.

    Parameters
    ----------
    lo, hi : array_like, shape (..., n)
        Lower and upper corners. Leading axes are a batch.

    Raises
    ------
    ReachError
        If the shapes differ, an entry is not finite, or some ``lo > hi`` (the empty set).
    """

    lo: Array
    hi: Array

    names = ("lo", "hi")

    def __post_init__(self) -> None:
        lo, hi = checks.finite_fields(self, *self.names)
        if lo.ndim == 0 or lo.shape != hi.shape:
            raise ReachError(f"lo and hi must be vectors of the same shape, got {lo.shape} and {hi.shape}")
        if np.any(lo > hi):
            at = tuple(int(i) for i in np.argwhere(lo > hi)[0])
            raise ReachError(f"lo must not exceed hi, got lo{list(at)} = {lo[at]:g} > {hi[at]:g}")

    @classmethod
    def ball(cls, center: ArrayLike, radius: ArrayLike) -> Interval:
        """Box around a centre with half-widths `radius` (a number or one per axis), rounded outwards."""
        c, r = as_center_and_sizes(center, "radius", radius)
        return cls(add_down(c, -r), add_up(c, r))

    @classmethod
    def around(cls, points: ArrayLike) -> Interval:
        """Smallest box that holds points, shape (..., k, n)."""
        points = checks.as_numbers("points", points)
        if points.ndim < 2 or points.shape[-2] == 0:
            raise ReachError(f"points must have shape (..., k, n) with k >= 1, got {points.shape}")
        return cls(points.min(axis=-2), points.max(axis=-2))

    @property
    def center(self) -> Array:
        """Midpoint, shape (..., n)."""
        return np.asarray(self.lo / 2 + self.hi / 2)

    @property
    def half_widths(self) -> Array:
        """Largest distance of a corner from `center`, rounded up, shape (..., n)."""
        middle = self.center
        return np.maximum(add_up(self.hi, -middle), add_up(middle, -self.lo))

    def volume(self) -> Array:
        """Product of the widths, shape (...)."""
        return np.asarray(np.prod(self.hi - self.lo, axis=-1))

    @property
    def extent(self) -> Array:
        """Elementwise bound on the points, before rounding, shape (..., n)."""
        return np.maximum(np.abs(self.lo), np.abs(self.hi))

    @property
    def terms(self) -> int:
        """Number of products summed in one value of the support function."""
        return self.dim

    def _support(self, D: Array) -> Array:
        positive, negative = np.maximum(D, 0), np.minimum(D, 0)
        return np.asarray((positive @ self.hi[..., None] + negative @ self.lo[..., None])[..., 0])

    def _furthest(self, D: Array) -> Array:
        lo, hi = (self.lo, self.hi) if D.ndim == 1 else (self.lo[..., None, :], self.hi[..., None, :])
        return np.where(D >= 0, hi, lo)

    def interval_hull(self) -> Interval:
        """The box itself."""
        return self

    def _holds(self, x: Array, slack: float) -> NDArray[np.bool_]:
        checks.require_alike(x.shape[:-1], self.batch)
        extra = slack * (self.hi - self.lo) / 2 + gamma(1) * self.extent
        return np.asarray(np.all((self.lo - extra <= x) & (x <= self.hi + extra), axis=-1))

    def __rmatmul__(self, M: ArrayLike) -> Zonotope:
        """Linear image ``M @ X``, a zonotope."""
        return checks.as_map(M, self.dim) @ self.to_zonotope()

    def _translated(self, v: Array) -> Interval:
        return Interval(add_down(self.lo, v), add_up(self.hi, v))

    def _scaled(self, a: float) -> Interval:
        ends = (a * self.lo, a * self.hi)
        return Interval(*(ends if a >= 0 else ends[::-1]))

    def project(self, dims: Sequence[int]) -> Interval:
        """Coordinates in the order given (exact)."""
        checks.selector(dims, self.dim)
        return Interval(self.lo[..., list(dims)], self.hi[..., list(dims)])

    @checked
    def hull(self, other: Interval) -> Interval:
        """Smallest box that holds both."""
        checks.require_same_dim(self, other)
        return Interval(np.minimum(self.lo, other.lo), np.maximum(self.hi, other.hi))

    def to_zonotope(self) -> Zonotope:
        """Return the box as a zonotope (exact; half-widths rounded up)."""
        from .zonotope import Zonotope

        return Zonotope.box(self.center, self.half_widths)

    def to_polytope(self) -> HPolytope:
        """Return the box as inequalities (exact)."""
        from .polytope import HPolytope

        checks.require_single("a set to convert", self)
        eye = np.eye(self.dim)
        return HPolytope(np.vstack([eye, -eye]), np.r_[self.hi, -self.lo])

    @checked
    def meet_halfspace(self, normal: ArrayLike, offset: ArrayLike) -> Interval:
        """Smallest box around the part with ``normal . x <= offset``, rounded outwards.

        Arguments and errors are those of `reach.meet_halfspace`.
        """
        a, b = checks.as_vector(normal, self.dim), checks.as_numbers("offset", offset)[..., None]
        checks.require_alike(a.shape[:-1], b.shape[:-1], self.batch)
        if not np.all(np.isfinite(b)):
            raise ReachError("offset must be finite")
        # The least the other coordinates can contribute leaves this much for each one.
        minima = np.minimum(a * self.lo, a * self.hi)
        allowance = gamma(2 * self.dim) * (np.abs(a) * self.extent).sum(axis=-1, keepdims=True)
        total = minima.sum(axis=-1, keepdims=True)
        if np.any(total - allowance > b):
            raise ReachError("no point of the set satisfies normal . x <= offset")
        slack = b - (total - minima) + allowance + gamma(1) * np.abs(b)
        with np.errstate(over="ignore"):  # of a row that hardly depends on a coordinate: no limit
            ratio = np.divide(slack, a, out=np.zeros(np.broadcast_shapes(slack.shape, a.shape)), where=a != 0)
            ratio = ratio + gamma(1) * np.sign(a) * np.abs(ratio)
        lo, hi = np.broadcast_arrays(self.lo, ratio)[0], np.broadcast_arrays(self.hi, ratio)[0]
        cut = np.where(a > 0, np.clip(ratio, lo, hi), hi)
        return Interval(np.where(a < 0, np.clip(ratio, lo, hi), lo), cut)
