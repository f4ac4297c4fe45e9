"""Zonotopes, one at a time or stacked along leading axes (usually time)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..numerics.arguments import checked
from ..numerics.checks import (
    Array,
    as_alike,
    as_count,
    as_map,
    as_numbers,
    as_rows,
    as_vector,
    require_alike,
    require_same_dim,
    require_single,
    require_stackable,
    selector,
)
from ..numerics.errors import ReachError
from ..numerics.rounding import gamma
from .convex import SetOperators
from .facets import facet_normals, least_level, unit_columns, volume
from .interval import Interval, SetStack
from .polytope import HPolytope


@dataclass(frozen=True, eq=False)
class Zonotope(SetStack):
    """``{c + G b : |b_i| <= 1}``, or a stack of such sets.

    Parameters
    ----------
    c : array_like, shape (..., n)
        Centres. Leading axes are a batch.
    G : array_like, shape (..., n, g)
        Generators as columns, with the same batch axes (g may be 0).

    Raises
    ------
    ReachError
        If the shapes do not fit or an entry is not finite.
    """

    c: Array
    G: Array

    names = ("c", "G")

    def __post_init__(self) -> None:
        c, G = as_numbers("c", self.c), as_numbers("G", self.G)
        if c.ndim == 0 or G.ndim != c.ndim + 1 or G.shape[:-1] != c.shape:
            raise ReachError(f"generators must have shape {c.shape} + (g,), got {G.shape}")
        if not (np.all(np.isfinite(c)) and np.all(np.isfinite(G))):
            raise ReachError("centre and generators must be finite numbers")
        object.__setattr__(self, "c", c)
        object.__setattr__(self, "G", G)

    @classmethod
    def box(cls, center: ArrayLike, half_widths: ArrayLike) -> Zonotope:
        """Axis-aligned box (exact). Batches allowed; a half-width below zero is refused."""
        center, half = as_alike("center", center, "half-widths", half_widths)
        if not np.all(half >= 0):
            raise ReachError(f"half-widths must be >= 0, got {half.min()}")
        if not np.all(np.isfinite(half)):
            raise ReachError("half-widths must be finite numbers")
        return cls(center.copy(), half[..., :, None] * np.eye(half.shape[-1]))

    @classmethod
    def point(cls, c: ArrayLike) -> Zonotope:
        """A single point (no generators)."""
        c = as_numbers("c", c)
        return cls(c, np.zeros((*c.shape, 0)))

    @classmethod
    def stack(cls, parts: Sequence[Zonotope]) -> Zonotope:
        """Stack sets along a new leading axis, padding with zero generators."""
        require_stackable(parts, cls)
        width = max(part.order_count for part in parts)
        padded = [part._pad(width) for part in parts]
        return cls(np.stack([part.c for part in padded]), np.stack([part.G for part in padded]))

    def _pad(self, count: int) -> Zonotope:
        missing = count - self.order_count
        if missing == 0:
            return self
        return Zonotope(self.c, np.concatenate([self.G, np.zeros((*self.c.shape, missing))], axis=-1))

    @property
    def order_count(self) -> int:
        """Number g of generators."""
        return int(self.G.shape[-1])

    @property
    def half_widths(self) -> Array:
        """Half-widths of the interval hull, shape (..., n)."""
        return np.asarray(np.abs(self.G).sum(axis=-1))

    @property
    def center(self) -> Array:
        """Centre of symmetry, shape (..., n)."""
        return self.c

    @property
    def extent(self) -> Array:
        """Elementwise bound on the points, before rounding, shape (..., n)."""
        return np.asarray(np.abs(self.c) + self.half_widths)

    @property
    def terms(self) -> int:
        """Number of products summed in one value of the support function."""
        return self.dim + self.order_count

    def interval_hull(self) -> Interval:
        """Smallest enclosing box, rounded outwards (exact where one generator moves each axis)."""
        moving = np.count_nonzero(self.G, axis=-1)
        slack = np.where(moving > 1, moving * np.finfo(float).eps, 0.0)
        return Interval.ball(self.c, self.half_widths * (1 + slack))

    def __rmatmul__(self, M: ArrayLike) -> Zonotope:
        """Linear image ``M @ Z``; M may carry batch axes that broadcast with the set's."""
        M = as_map(M, self.dim)
        require_alike(M.shape[:-2], self.batch)
        c = (M @ self.c[..., None])[..., 0]
        G = M @ self.G
        return Zonotope(c, np.broadcast_to(G, (*c.shape, self.order_count)))

    @overload
    def __add__(self, other: Zonotope | Interval | ArrayLike) -> Zonotope: ...

    @overload
    def __add__(self, other: SetOperators) -> Any: ...

    def __add__(self, other: Any) -> Any:
        """Minkowski sum with another set, or translation by vectors.

        Zonotopes and intervals give a zonotope, other sets a lazy `reach.MinkowskiSum`.
        """
        return super().__add__(other)

    def _translated(self, v: Array) -> Zonotope:
        c = self.c + v
        return Zonotope(c, np.broadcast_to(self.G, (*c.shape, self.order_count)))

    def _scaled(self, a: float) -> Zonotope:
        return Zonotope(a * self.c, a * self.G)

    def project(self, dims: Sequence[int]) -> Zonotope:
        """Coordinates in the order given."""
        selector(dims, self.dim)
        return Zonotope(self.c[..., list(dims)], self.G[..., list(dims), :])

    @checked
    def inflate(self, half_widths: ArrayLike) -> Zonotope:
        """Minkowski sum with a centred box."""
        half = np.asarray(half_widths, dtype=float)
        if half.shape[-1:] not in ((), (1,), (self.dim,)) or not np.all(np.isfinite(half)):
            raise ReachError(f"half-widths must be {self.dim} finite numbers, got shape {half.shape}")
        require_alike(half.shape[:-1], self.batch)
        half = np.broadcast_to(half, (*np.broadcast_shapes(half.shape[:-1], self.batch), self.dim))
        return self + Zonotope.box(np.zeros_like(half), half)

    def support(self, directions: ArrayLike) -> Array:
        """Largest value of each direction over the set.

        Parameters
        ----------
        directions : array_like, shape (..., r, n)
            Rows; batch axes broadcast with the set's.

        Returns
        -------
        ndarray, shape (..., r)
        """
        D = as_rows(directions, self.dim, self.batch)
        return np.asarray((D @ self.c[..., None])[..., 0] + np.abs(D @ self.G).sum(axis=-1))

    def support_vector(self, directions: ArrayLike) -> Array:
        """Corners that attain the support, shape of `directions` broadcast with the batch."""
        D = as_rows(directions, self.dim, self.batch)
        signs = np.where(D @ self.G < 0, -1.0, 1.0)
        if D.ndim == 1:
            return np.asarray(self.c + (self.G @ signs[..., None])[..., 0])
        return np.asarray(self.c[..., None, :] + signs @ np.swapaxes(self.G, -1, -2))

    def corners(self, most: int = 4096) -> Array:
        """All points ``c + G b``, b in {-1, 1}^g: at most `most`, vertices among them, shape (2^g, n)."""
        require_single(self, "corners")
        G = self.G[:, np.any(self.G != 0, axis=0)]
        if 2 ** G.shape[1] > as_count("most", most):
            raise ReachError(f"{G.shape[1]} generators have more than {most} corners")
        signs = np.array(list(product((-1.0, 1.0), repeat=G.shape[1]))).reshape(2 ** G.shape[1], G.shape[1])
        return np.asarray(self.c + signs @ G.T)

    @checked
    def sample(self, rng: np.random.Generator, count: int) -> Array:
        """Points of the (single) set, a third of them corners; not uniform. Shape (count, n)."""
        require_single(self, "sample")
        b = rng.uniform(-1, 1, (as_count("count", count), self.order_count))
        b[: count // 3] = np.sign(b[: count // 3])
        return np.asarray(self.c + b @ self.G.T)

    @checked
    def contains(self, points: ArrayLike, slack: float = 1e-9) -> NDArray[np.bool_]:
        """Whether each point lies in the (single) set, by one linear program each, shape (...).

        Parameters
        ----------
        points : array_like, shape (..., n)
        slack : float
            Points reached with ``|b_i| <= 1 + slack`` count as inside.
        """
        require_single(self, "contains")
        x = as_vector(points, self.dim)
        levels = [least_level(self.c, self.G, p) for p in x.reshape(-1, self.dim)]
        return np.array(levels).reshape(x.shape[:-1]) <= 1 + slack

    @checked
    def hull(self, other: Zonotope) -> Zonotope:
        """Enclosure of the convex hull of two sets whose generators correspond one to one.

        Encloses ``{(1-s) x + s y}`` for every x and y with the same coefficients and every s in
        [0, 1], which is what consecutive sets of a tube need; see `reach.enclosing_hull` for
        unrelated sets. The last n generators carry the rounding.
        """
        require_same_dim(self, other)
        require_alike(self.batch, other.batch)
        width = max(self.order_count, other.order_count)
        a, b = self._pad(width), other._pad(width)
        G = np.concatenate([(a.G + b.G) / 2, (a.G - b.G) / 2, ((a.c - b.c) / 2)[..., None]], axis=-1)
        return Zonotope((a.c + b.c) / 2, G).inflate(gamma(width) * (a.extent + b.extent))

    @checked
    def norm_bound(self, W: ArrayLike) -> Array:
        """Upper bound on ``max ||W x||_2`` over the set (fast, sufficient), shape (...).

        The least of two bounds: the norm of the interval hull of ``W Z`` and the sum of the norms
        of the generators of ``W Z``. Exact for a point and for one generator.
        """
        image = as_map(W, self.dim) @ self
        hull = np.linalg.norm(np.abs(image.c) + image.half_widths, axis=-1)
        total = np.linalg.norm(image.c, axis=-1) + np.linalg.norm(image.G, axis=-2).sum(axis=-1)
        return np.asarray(np.minimum(hull, total))

    @checked
    def reduce(self, order: float, method: str = "pca") -> Zonotope:
        """Enclosing zonotope with at most ``order * n`` generators; see `reach.sets.reduction`."""
        from .reduction import reduce

        return reduce(self, order, method)

    @checked
    def meet_halfspace(self, normal: ArrayLike, offset: ArrayLike) -> Zonotope:
        """Enclosure of the part with ``normal . x <= offset``; see `reach.sets.intersection`."""
        from .clipping import meet_halfspace

        return meet_halfspace(self, normal, offset)

    def to_zonotope(self) -> Zonotope:
        """The set itself."""
        return self

    def to_polytope(self, most: int = 20_000) -> HPolytope:
        """The same (single) set by inequalities, one pair for each pair of facets.

        Exact but for the offsets, which are rounded up; a flat set gets its equations as pairs.

        Raises
        ------
        ReachError
            If more than `most` groups of n - 1 generators would have to be looked at.
        """
        require_single(self, "to_polytope")
        rows = np.unique(unit_columns(facet_normals(self.G, as_count("most", most))).T, axis=0)
        rows = np.vstack([rows, -rows])
        return HPolytope(rows, self.support_up(rows))

    def volume(self, most: int = 1_000_000) -> Array:
        """Volume, by ``comb(g, n)`` determinants (at most `most` of them), shape (...)."""
        return volume(self.G, as_count("most", most))
