"""Euclidean balls and the zonotopes that enclose them."""

from __future__ import annotations

from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from ..numerics.arguments import checked
from ..numerics.errors import ReachError

Array = NDArray[np.float64]


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
    columns = [v / np.linalg.norm(v) * weight[int(np.abs(v).sum())] for v in axes.values()]
    return np.array(columns).T
