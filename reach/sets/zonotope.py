"""Zonotopes, one at a time or stacked along leading axes (usually time)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, product
from math import comb
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..numerics import checks
from ..numerics.checks import Array, checked
from ..numerics.errors import ReachError
from ..numerics.rounding import Whole, cross, floats, gamma, integers
from ..short_repr import short_repr
from .convex import SetOperators
from .interval import Interval
from .polytope import HPolytope
from .stacks import Generated, as_center_and_sizes

FLAT = 1e-9  # ratio of singular values (axes scaled to unit size) below which a zonotope is treated as flat


@short_repr
@dataclass(frozen=True, eq=False)
class Zonotope(Generated):
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
        c, G = checks.finite_fields(self, *self.names)
        if c.ndim == 0 or G.ndim != c.ndim + 1 or G.shape[:-1] != c.shape:
            raise ReachError(f"generators must have shape {c.shape} + (g,), got {G.shape}")

    @classmethod
    def box(cls, center: ArrayLike, half_widths: ArrayLike) -> Zonotope:
        """Axis-aligned box (exact). Batches allowed; a half-width below zero is refused."""
        center, half = as_center_and_sizes(center, "half-widths", half_widths)
        return cls(center.copy(), half[..., :, None] * np.eye(half.shape[-1]))

    @classmethod
    def point(cls, c: ArrayLike) -> Zonotope:
        """A single point (no generators)."""
        c = checks.as_numbers("c", c)
        return cls(c, np.zeros((*c.shape, 0)))

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

    def interval_hull(self) -> Interval:
        """Smallest enclosing box, rounded outwards (exact where one generator moves each axis)."""
        moving = np.count_nonzero(self.G, axis=-1)
        slack = np.where(moving > 1, moving * np.finfo(float).eps, 0.0)
        return Interval.ball(self.c, self.half_widths * (1 + slack))

    @overload
    def __add__(self, other: Zonotope | Interval | ArrayLike) -> Zonotope: ...

    @overload
    def __add__(self, other: SetOperators) -> Any: ...

    def __add__(self, other: Any) -> Any:
        """Minkowski sum with another set, or translation by vectors.

        Zonotopes and intervals give a zonotope, other sets a lazy `reach.MinkowskiSum`.
        """
        return self._joined(other) if type(other) is Zonotope else super().__add__(other)

    def _joined(self, other: Zonotope) -> Zonotope:
        """Minkowski sum of two zonotopes: the generators of both."""
        G, H = self.G, other.G
        if G.shape[:-1] != H.shape[:-1]:
            checks.require_same_dim(self, other)
            checks.require_alike(self.batch, other.batch)
            shape = np.broadcast_shapes(self.c.shape, other.c.shape)
            G, H = (np.broadcast_to(M, (*shape, M.shape[-1])) for M in (G, H))
        return Zonotope(self.c + other.c, np.concatenate([G, H], axis=-1))

    @checked
    def inflate(self, half_widths: ArrayLike) -> Zonotope:
        """Minkowski sum with a centred box."""
        half = np.asarray(half_widths, dtype=float)
        if half.shape[-1:] not in ((), (1,), (self.dim,)) or not np.all(np.isfinite(half)):
            raise ReachError(f"half-widths must be {self.dim} finite numbers, got shape {half.shape}")
        checks.require_alike(half.shape[:-1], self.batch)
        half = np.broadcast_to(half, (*np.broadcast_shapes(half.shape[:-1], self.batch), self.dim))
        return self + Zonotope.box(np.zeros_like(half), half)

    def _support(self, D: Array) -> Array:
        return np.asarray((D @ self.c[..., None])[..., 0] + np.abs(D @ self.G).sum(axis=-1))

    def _furthest(self, D: Array) -> Array:
        signs = np.where(D @ self.G < 0, -1.0, 1.0)
        if D.ndim == 1:
            return np.asarray(self.c + (self.G @ signs[..., None])[..., 0])
        return np.asarray(self.c[..., None, :] + signs @ np.swapaxes(self.G, -1, -2))

    def corners(self, most: int = 4096) -> Array:
        """All points ``c + G b``, b in {-1, 1}^g: at most `most`, vertices among them, shape (2^g, n)."""
        checks.require_single("a set asked for its corners", self)
        G = self.G[:, np.any(self.G != 0, axis=0)]
        if 2 ** G.shape[1] > checks.as_count("most", most):
            raise ReachError(f"{G.shape[1]} generators have more than {most} corners")
        signs = np.array(list(product((-1.0, 1.0), repeat=G.shape[1]))).reshape(2 ** G.shape[1], G.shape[1])
        return np.asarray(self.c + signs @ G.T)

    @checked
    def sample(self, rng: np.random.Generator, count: int) -> Array:
        """Points of the (single) set, a third of them corners; not uniform. Shape (count, n)."""
        checks.require_single("a set to sample", self)
        b = rng.uniform(-1, 1, (checks.as_count("count", count), self.order_count))
        b[: count // 3] = np.sign(b[: count // 3])
        return np.asarray(self.c + b @ self.G.T)

    def _holds(self, x: Array, slack: float) -> NDArray[np.bool_]:
        checks.require_single("a set asked about points", self)
        levels = [least_level(self.c, self.G, p) for p in x.reshape(-1, self.dim)]
        return np.array(levels).reshape(x.shape[:-1]) <= 1 + slack

    @checked
    def hull(self, other: Zonotope) -> Zonotope:
        """Enclosure of the convex hull of two sets whose generators correspond one to one.

        Encloses ``{(1-s) x + s y}`` for every x and y with the same coefficients and every s in
        [0, 1], which is what consecutive sets of a tube need; see `reach.enclosing_hull` for
        unrelated sets. The last n generators carry the rounding.
        """
        checks.require_same_dim(self, other)
        checks.require_alike(self.batch, other.batch)
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
        image = checks.as_map(W, self.dim) @ self
        hull = np.linalg.norm(image.extent, axis=-1)
        total = np.linalg.norm(image.c, axis=-1) + np.linalg.norm(image.G, axis=-2).sum(axis=-1)
        return np.asarray(np.minimum(hull, total))

    @checked
    def reduce(self, order: float, method: str = "pca") -> Zonotope:
        """Enclosing zonotope with at most ``order * n`` generators; see `reach.sets.reduction`."""
        from .reduction import reduce

        return reduce(self, order, method)

    @checked
    def meet_halfspace(self, normal: ArrayLike, offset: ArrayLike) -> Zonotope:
        """Enclosure of the part with ``normal . x <= offset``; see `reach.meet_halfspace`."""
        from .clipping import meet_halfspace

        return meet_halfspace(self, normal, offset)

    def to_zonotope(self) -> Zonotope:
        """The set itself."""
        return self

    def to_polytope(self, most: int = 20_000) -> HPolytope:
        """Return the (single) set as inequalities, one pair for each pair of facets.

        Exact but for the offsets, which are rounded up; a flat set gets its equations as pairs.

        Raises
        ------
        ReachError
            If more than `most` groups of n - 1 generators would have to be looked at.
        """
        checks.require_single("a set to convert", self)
        rows = np.unique(unit_columns(facet_normals(self.G, checks.as_count("most", most))).T, axis=0)
        rows = np.vstack([rows, -rows])
        return HPolytope(rows, self.support_up(rows))

    def volume(self, most: int = 1_000_000) -> Array:
        """Volume, by ``comb(g, n)`` determinants (at most `most` of them), shape (...)."""
        n, g = self.G.shape[-2:]
        if comb(g, n) > checks.as_count("most", most):
            detail = f"{g} generators in dimension {n} have {comb(g, n)} determinants"
            raise ReachError(f"{detail}, more than {most}")
        groups = np.array(list(combinations(range(g), n)), dtype=int).reshape(-1, n)
        minors = np.moveaxis(self.G[..., groups], -3, -2)
        return np.asarray(2.0**n * np.abs(np.linalg.det(minors)).sum(axis=-1))


def combination_count(G: Array) -> int:
    """Return the number of groups of n - 1 vectors that `facet_normals` looks at."""
    return comb(_spanning(G).shape[1], len(G) - 1)


def facet_normals(G: Array, most: int) -> Whole:
    """Normals of all facets of ``{G b : |b_i| <= 1}``, one of each opposite pair, exact: integers (n, k).

    They are scaled by some power of two. A flat zonotope is the limit of its sum with a vanishing box, so
    the axes join its generators; the normals then include those of the flat. A facet is spanned by n - 1
    generators (Althoff, Stursberg and Buss 2010, theorem 7): ``comb(g, n - 1)`` are looked at, `most` at
    the most.
    """
    n, candidates = len(G), _spanning(G)
    count = comb(candidates.shape[1], n - 1)
    if count > most:
        detail = f"{candidates.shape[1]} generators in dimension {n} span up to {count} facets"
        raise ReachError(f"{detail}, more than {most}")
    (whole,) = integers(candidates)
    groups = np.array(list(combinations(range(candidates.shape[1]), n - 1)), dtype=int).reshape(count, n - 1)
    normals = cross(np.transpose(whole[:, groups], (2, 0, 1)))
    return np.asarray(normals[:, np.any(normals != 0, axis=0)])


def unit_columns(normals: Whole) -> Array:
    """Exact columns to floats of unit length, the first entry that is not zero positive."""
    columns = floats(normals)
    first = np.take_along_axis(columns, (columns != 0).argmax(axis=0)[None], axis=0)
    return np.asarray(columns * np.sign(first) / np.linalg.norm(columns, axis=0) + 0.0)


def _spanning(G: Array) -> Array:
    """The generators that matter, with the axes if they do not span the space."""
    G = G[:, np.any(G != 0, axis=0)]
    size = np.abs(G).sum(axis=1)
    if G.shape[1] < len(G) or np.any(size == 0):
        return np.hstack([G, np.eye(len(G)) * np.where(size > 0, size, 1.0)])
    values = np.linalg.svd(G / size[:, None], compute_uv=False)
    return np.hstack([G, np.diag(size)]) if values[-1] < FLAT * values[0] else G


def least_level(c: Array, G: Array, point: Array) -> float:
    """Least t with ``point = c + G b``, ``|b_i| <= t``; inf if none. On a flat axis rounding is forgiven."""
    from scipy.optimize import linprog

    G, scale, gap = G[:, np.any(G != 0, axis=0)], np.abs(G).sum(axis=1), point - c
    if np.any(np.abs(gap[scale == 0]) > gamma(1) * np.abs(c[scale == 0])):
        return np.inf
    G, gap = G[scale > 0] / scale[scale > 0, None], gap[scale > 0] / scale[scale > 0]
    lower = float(np.abs(gap).max(initial=0.0))
    g = G.shape[1]
    if g == 0 or lower > 2:  # far outside the interval hull: the bound is answer enough
        return lower if g else 0.0
    bound = np.block([[np.eye(g), -np.ones((g, 1))], [-np.eye(g), -np.ones((g, 1))]])
    solved = linprog(
        np.r_[np.zeros(g), 1.0],
        bound,
        np.zeros(2 * g),
        np.c_[G, np.zeros(len(G))],
        gap,
        bounds=[(None, None)] * g + [(0, None)],
    )
    return float(solved.fun) if solved.status == 0 else np.inf
