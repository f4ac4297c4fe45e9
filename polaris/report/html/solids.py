"""Surfaces of sets in space, as triangles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...model.system import Array
from ..figures.geometry import boxed


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles in space.

    Attributes
    ----------
    points : ndarray, shape (V, 3)
        Corners [m].
    faces : ndarray of int, shape (F, 3)
        Corners of every triangle.
    """

    points: Array
    faces: NDArray[np.intp]


def hull(points: Array) -> Surface | None:
    """Surface of the convex hull of points (V, 3); None if it has no volume."""
    from scipy.spatial import ConvexHull, QhullError

    if len(points) < 4:
        return None
    size = max(float(np.ptp(points, axis=0).max()), 1e-300)
    try:
        found = ConvexHull((points - points.mean(axis=0)) / size)
    except QhullError:
        return None
    used = np.unique(found.simplices)
    place = np.zeros(len(points), dtype=np.intp)
    place[used] = np.arange(len(used))
    return Surface(points[used], place[found.simplices])


def polyhedron(normals: Array, support: Array, inside: Array) -> Surface | None:
    """Surface of ``{p : normals p <= support}``, bounded.

    Parameters
    ----------
    normals : ndarray, shape (F, 3)
    support : ndarray, shape (F,)
        [m]
    inside : ndarray, shape (3,)
        A point strictly inside [m].
    """
    from scipy.spatial import HalfspaceIntersection, QhullError

    room = support - normals @ inside
    size = float(np.max(np.abs(room)))
    if not np.all(room > 1e-12 * max(size, 1e-300)):
        return None
    try:
        found = HalfspaceIntersection(np.column_stack([normals, -room / size]), np.zeros(3))
    except QhullError:
        return None
    return hull(inside + size * _distinct(found.intersections))


def _distinct(points: Array) -> Array:
    """Points without those that round-off made of one."""
    kept = points[np.isfinite(points).all(axis=1)]
    return np.asarray(kept[np.unique(np.round(kept, 9), axis=0, return_index=True)[1]])


def ball(radius: float, splits: int = 2) -> Surface:
    """A ball about the origin: an icosahedron, its triangles split in four a few times."""
    golden = (1 + 5**0.5) / 2
    corners = np.array([[-1.0, golden, 0.0], [1.0, golden, 0.0], [-1.0, -golden, 0.0], [1.0, -golden, 0.0]])
    points = np.vstack([np.roll(corners, turn, axis=1) for turn in range(3)])
    for _ in range(splits):
        surface = hull(points / np.linalg.norm(points, axis=1, keepdims=True))
        assert surface is not None  # a ball's points have a volume
        edges = np.unique(np.sort(surface.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
        points = np.vstack([surface.points, surface.points[edges].mean(axis=1)])
    found = hull(radius * points / np.linalg.norm(points, axis=1, keepdims=True))
    assert found is not None
    return found


def cut_surface(H: Array, b: Array, low: Array, high: Array, closed: bool = True) -> Surface | None:
    """Surface of ``H p <= b`` within a box; None if nothing of it is there.

    Parameters
    ----------
    H, b : ndarray, shapes (F, 3) and (F,)
        Unit rows; b in m.
    low, high : ndarray, shape (3,)
        The box [m].
    closed : bool
        Whether the faces on the box are kept. Without them a cone stays open where it leaves the scene.
    """
    whole = boxed(H, b, low, high)
    if not whole.depth > 0:
        return None
    found = polyhedron(whole.H, whole.b, whole.middle)
    if found is None or closed:
        return found
    near = 1e-6 * float(np.max(high - low))
    on_low = np.abs(found.points - low) <= near
    on_high = np.abs(found.points - high) <= near
    capped = np.any(on_low[found.faces].all(axis=1) | on_high[found.faces].all(axis=1), axis=1)
    return Surface(found.points, found.faces[~capped]) if np.any(~capped) else None
