"""Ellipsoids, flat ones included."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import gamma as gamma_function

from ..numerics.checks import Array, as_factor, as_numbers, checked, finite_fields
from ..numerics.errors import ReachError
from ..numerics.rounding import gamma
from .interval import Interval
from .stacks import Generated
from .zonotope import Zonotope


@dataclass(frozen=True, eq=False)
class Ellipsoid(Generated):
    """``{c + L u : norm(u, 2) <= 1}``, the image of the unit ball.

    Parameters
    ----------
    c : array_like, shape (n,)
        Centre.
    L : array_like, shape (n, k)
        Any matrix; the shape matrix is ``L L^T``. Flat where its rank is below n.

    Raises
    ------
    ReachError
        If the shapes do not fit or an entry is not finite.
    """

    c: Array
    L: Array

    names = ("c", "L")

    def __post_init__(self) -> None:
        c, L = finite_fields(self, *self.names)
        if c.ndim != 1 or L.ndim != 2 or len(L) != len(c):
            raise ReachError(f"c must have shape (n,) and L shape (n, k), got {c.shape} and {L.shape}")

    @classmethod
    def ball(cls, center: ArrayLike, radius: float) -> Ellipsoid:
        """Euclidean ball; a radius below zero is refused."""
        center, radius = as_numbers("center", center), as_factor(radius, "radius", 0.0)
        return cls(center, radius * np.eye(len(np.atleast_1d(center))))

    @classmethod
    def from_shape(cls, center: ArrayLike, Q: ArrayLike) -> Ellipsoid:
        """``{x : d . (x - c) <= sqrt(d . Q d) for all d}`` from a positive semidefinite shape matrix.

        Raises
        ------
        ReachError
            If Q is not square, not symmetric or has an eigenvalue below zero (to rounding).
        """
        values, vectors = _spectrum("Q", Q)
        return cls(as_numbers("center", center), vectors * np.sqrt(np.maximum(values, 0)))

    @classmethod
    def sublevel(cls, center: ArrayLike, P: ArrayLike, level: float = 1.0) -> Ellipsoid:
        """``{x : (x - c) . P (x - c) <= level}`` for a positive definite P.

        Raises
        ------
        ReachError
            If P is not square, not symmetric or not positive definite, or the level is negative.
        """
        level = as_factor(level, "level", 0.0)
        values, vectors = _spectrum("P", P)
        if not values.min() > 0:
            raise ReachError(f"P must be positive definite, got an eigenvalue {values.min():.3g}")
        return cls(as_numbers("center", center), vectors * np.sqrt(level / values))

    @property
    def shape(self) -> Array:
        """Shape matrix ``L L^T``, shape (n, n)."""
        return np.asarray(self.L @ self.L.T)

    @property
    def half_widths(self) -> Array:
        """Half-widths of the interval hull, shape (n,)."""
        return np.asarray(np.linalg.norm(self.L, axis=1))

    def _support(self, D: Array) -> Array:
        return np.asarray(D @ self.c + _lengths(D @ self.L)[..., 0])

    def _furthest(self, D: Array) -> Array:
        inner = D @ self.L
        norms = _lengths(inner)
        return np.asarray(self.c + (inner / np.where(norms > 0, norms, 1.0)) @ self.L.T)

    def interval_hull(self) -> Interval:
        """Smallest box around the set, rounded outwards."""
        return Interval.ball(self.c, self.half_widths * (1 + gamma(self.L.shape[1])))

    def _holds(self, x: Array, slack: float) -> NDArray[np.bool_]:
        gap = x - self.c
        size = self.half_widths
        size = np.where(size > 0, size, 1.0)
        scaled = self.L / size[:, None]
        u = (gap / size) @ np.linalg.pinv(scaled).T
        residual = np.abs(u @ scaled.T - gap / size).max(axis=-1, initial=0.0)
        return np.asarray((np.linalg.norm(u, axis=-1) <= 1 + slack) & (residual <= slack))

    def enclosing_zonotope(self, frame: ArrayLike | None = None) -> Zonotope:
        """Zonotope around the set: the image of `reach.ball_generators`, or a parallelotope in a frame.

        Without a frame the excess is that of the unit ball of the rank of L: none in one dimension,
        2 % in two, 10 % in three; above, a box along the principal axes (axes scaled alike).
        """
        if frame is not None:
            return super().enclosing_zonotope(frame)
        size = self.half_widths
        U, s, _ = np.linalg.svd(self.L / np.where(size > 0, size, 1.0)[:, None], full_matrices=False)
        live = s > 0
        if not live.any():
            return Zonotope.point(self.c)
        ball = ball_generators(int(live.sum()), 1.0)
        # U S V^T is the scaled L to rounding only; what it misses lies in a box.
        defect = gamma(self.terms) * float(s.max()) * self.dim
        return Zonotope(self.c, size[:, None] * ((U[:, live] * s[live]) @ ball)).inflate(defect * size)

    def volume(self) -> float:
        """Volume ``pi^(n/2) / Gamma(n/2 + 1) sqrt(det(L L^T))``; zero if flat."""
        if self.L.shape[1] < self.dim:
            return 0.0
        sizes = np.linalg.svd(self.L, compute_uv=False)
        return float(np.prod(sizes) * np.pi ** (self.dim / 2) / gamma_function(self.dim / 2 + 1))


def _lengths(rows: Array) -> Array:
    """Euclidean norms, shape (..., 1), of rows whose squares may be beyond floating point."""
    size = np.abs(rows).max(axis=-1, keepdims=True, initial=0.0)
    size = np.where(size > 0, size, 1.0)
    return np.asarray(size * np.linalg.norm(rows / size, axis=-1, keepdims=True))


def _spectrum(name: str, matrix: ArrayLike) -> tuple[Array, Array]:
    """Eigenvalues and vectors of a symmetric matrix with no eigenvalue below zero."""
    Q = as_numbers(name, matrix)
    if Q.ndim != 2 or Q.shape[0] != Q.shape[1]:
        raise ReachError(f"{name} must be square, got shape {Q.shape}")
    if not np.all(np.isfinite(Q)):
        raise ReachError(f"{name} must have finite entries")
    size = np.abs(Q).max(initial=0.0)
    if np.abs(Q - Q.T).max(initial=0.0) > 1e-9 * size:
        raise ReachError(f"{name} must be symmetric, its halves differ by {np.abs(Q - Q.T).max():.3g}")
    values, vectors = np.linalg.eigh((Q + Q.T) / 2)
    if values.min(initial=0.0) < -1e-9 * size:
        raise ReachError(f"{name} must be positive semidefinite, got an eigenvalue {values.min():.3g}")
    return np.asarray(values), np.asarray(vectors)


@checked
def ball_generators(p: int, radius: float) -> Array:
    """Generators of a centred zonotope that encloses the ball of a radius, shape (p, g).

    Exact for p = 1; within 2 % in the plane (8 generators), within 10 % in space (13 generators,
    the axes of the cube); a box above.

    Raises
    ------
    ReachError
        If the dimension is below 1 or the radius is negative or not finite.
    """
    if p < 1:
        raise ReachError(f"a ball needs a dimension of at least 1, got {p}")
    if not (np.isfinite(radius) and radius >= 0):
        raise ReachError(f"a radius must be a finite number >= 0, got {radius}")
    if p == 1 or p > 3:
        return np.eye(p) * radius
    if p == 2:
        angles = np.pi * np.arange(8) / 8
        rays = np.vstack([np.cos(angles), np.sin(angles)])
        normals = np.vstack([-rays[1], rays[0]])
    else:
        rays = _cube_axes()
        pairs = [np.cross(rays[:, i], rays[:, j]) for i, j in combinations(range(rays.shape[1]), 2)]
        normals = np.array([v / np.linalg.norm(v) for v in pairs if np.linalg.norm(v) > 1e-9]).T
    # The inner radius is the least support over the facet normals.
    inner = np.abs(normals.T @ rays).sum(axis=1).min()
    return np.asarray(rays * (radius / inner * (1 + 1e-12)))


def _cube_axes() -> Array:
    """Face, edge and vertex axes of the cube, weighted for roundness, shape (3, 13)."""
    axes: dict[tuple[int, ...], Array] = {}
    for signs in product((-1, 0, 1), repeat=3):
        first = next((s for s in signs if s), 0)
        if first > 0:
            axes[signs] = np.array(signs, dtype=float)
    weight = {1: 1.0, 2: 1.15, 3: 0.9}  # roundest by search
    return np.array([v / np.linalg.norm(v) * weight[int(np.abs(v).sum())] for v in axes.values()]).T
