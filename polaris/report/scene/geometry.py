"""Outlines and surfaces of sets, ready to be drawn."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...model.shapes import Polytope
from ...model.system import Array
from ...runs.picture import directions


@dataclass(frozen=True, eq=False)
class Shape:
    """A ``line`` (with gaps where it is nan), single ``points``, an ``area`` in an outline, or a ``mesh``.

    Attributes
    ----------
    kind : str
    points : ndarray, shape (N, dim)
        [m]
    faces : ndarray of int, shape (F, 3), optional
        Corners of the triangles of a mesh.
    """

    kind: str
    points: Array
    faces: NDArray[np.intp] | None = None

    def along(self, axes: list[int]) -> Shape:
        """The same, its coordinates in another order."""
        return Shape(self.kind, self.points[:, axes], self.faces)

    def moved(self, shift: Array) -> Shape:
        """The same elsewhere."""
        return Shape(self.kind, self.points + shift, self.faces)


# -- in the plane -----------------------------------------------------------------------------------


def polygon(support: ArrayLike, rays: Array) -> Array:
    """Corners of ``{p : rays p <= support}`` where every ray supports the set, shape (..., count, 2).

    Parameters
    ----------
    support : array_like, shape (..., count)
        Support of a convex set along each ray: the polygon is circumscribed about it.
    rays : ndarray, shape (count, 2)
        Unit vectors in the order of their angle (`directions`).
    """
    h = np.asarray(support, dtype=float)
    after, h_after = np.roll(rays, -1, axis=0), np.roll(h, -1, axis=-1)
    cross = rays[:, 0] * after[:, 1] - rays[:, 1] * after[:, 0]
    x = (h * after[:, 1] - h_after * rays[:, 1]) / cross
    y = (h_after * rays[:, 0] - h * after[:, 0]) / cross
    return np.stack([x, y], axis=-1)


def tube_support(centre: Array, generators: Array, bow: Array, parts: int, rays: Array) -> Array:
    """Support of a tube over parts of every step along rays (R, e), shape (K, parts, R).

    Parameters
    ----------
    centre : ndarray, shape (K, q+1, e)
        Centres at the nodes of every step [m].
    generators : ndarray, shape (K, q+1, e, g)
    bow : ndarray, shape (K, q, e)
        Bound on what lies outside the hull of consecutive nodes.
    parts : int
        Parts per step, at most q.
    rays : ndarray, shape (R, e)
    """
    node = centre @ rays.T + np.abs(np.einsum("ri,kqig->kqrg", rays, generators)).sum(axis=-1)
    between = np.maximum(node[:, :-1], node[:, 1:]) + bow @ np.abs(rays).T
    edges = part_edges(bow.shape[1], parts)
    return np.stack([between[:, a:b].max(axis=1) for a, b in zip(edges[:-1], edges[1:], strict=True)], axis=1)


def part_edges(q: int, parts: int) -> NDArray[np.int_]:
    """Nodes at which the parts of a step begin and end."""
    return np.unique(np.linspace(0, q, parts + 1).astype(int))


def flat_outline(vertices: Array) -> Array:
    """Convex hull of points in the plane, counter-clockwise, shape (V, 2)."""
    points = sorted({(float(x), float(y)) for x, y in vertices})
    if len(points) < 3:
        return np.array(points).reshape(-1, 2)

    def half(ordered: list[tuple[float, float]]) -> list[tuple[float, float]]:
        chain: list[tuple[float, float]] = []
        for p in ordered:
            while len(chain) >= 2:
                (ax, ay), (bx, by) = chain[-2], chain[-1]
                if (bx - ax) * (p[1] - ay) - (by - ay) * (p[0] - ax) > 0:
                    break
                chain.pop()
            chain.append(p)
        return chain[:-1]

    return np.array(half(points) + half(points[::-1]))


def closed(outline: Array) -> Array:
    """An outline whose last point is its first."""
    return np.vstack([outline, outline[:1]]) if len(outline) else outline


def gapped(lines: Iterable[Array], dim: int) -> Array:
    """Lines (N, dim) as one, with a gap after each."""
    gap = np.full((1, dim), np.nan)
    return np.vstack([gap[:0], *(part for line in lines for part in (line, gap))])


def stretches(flags: ArrayLike) -> list[tuple[int, int]]:
    """First and one-past-last index of every stretch of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], np.asarray(flags, dtype=int), [0]])))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


# -- in space ---------------------------------------------------------------------------------------


def hull(points: Array) -> Shape | None:
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
    return Shape("mesh", points[used], place[found.simplices])


def polyhedron(normals: Array, support: Array, inside: Array) -> Shape | None:
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
    points = found.intersections[np.isfinite(found.intersections).all(axis=1)]
    distinct = points[np.unique(np.round(points, 9), axis=0, return_index=True)[1]]  # but for round-off
    return hull(inside + size * distinct)


@cache
def _unit_ball(splits: int) -> Shape:
    golden = (1 + 5**0.5) / 2
    corners = np.array([[-1.0, golden, 0.0], [1.0, golden, 0.0], [-1.0, -golden, 0.0], [1.0, -golden, 0.0]])
    points = np.vstack([np.roll(corners, turn, axis=1) for turn in range(3)])
    for _ in range(splits):
        surface = hull(points / np.linalg.norm(points, axis=1, keepdims=True))
        assert surface is not None and surface.faces is not None  # a ball's points have a volume
        edges = np.sort(surface.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        points = np.vstack([surface.points, surface.points[np.unique(edges, axis=0)].mean(axis=1)])
    found = hull(points / np.linalg.norm(points, axis=1, keepdims=True))
    assert found is not None
    return found


def ball(radius: float, splits: int = 2) -> Shape:
    """A ball about the origin: an icosahedron, its triangles split in four a few times."""
    unit = _unit_ball(splits)
    return Shape("mesh", radius * unit.points, unit.faces)


def ball_points(radius: float, d: int) -> Array:
    """Points all over a ball's surface about the origin, shape (V, d)."""
    if d == 3:
        return ball(radius).points
    return radius * (directions(64) if d == 2 else np.array([[-1.0], [1.0]]))


def boxed(H: Array, b: Array, low: Array, high: Array) -> Polytope:
    """The polytope ``H p <= b`` cut to a box [m]."""
    eye = np.eye(len(low))
    return Polytope(np.vstack([H, eye, -eye]), np.concatenate([b, high, -low]))


def cut_surface(H: Array, b: Array, low: Array, high: Array) -> Shape | None:
    """Surface of ``H p <= b`` within a box, open where it leaves it; None if nothing of it is there.

    Parameters
    ----------
    H, b : ndarray, shapes (F, 3) and (F,)
        Unit rows; b in m.
    low, high : ndarray, shape (3,)
        The box [m].
    """
    whole = boxed(H, b, low, high)
    if not whole.depth > 0:
        return None
    found = polyhedron(whole.H, whole.b, whole.middle)
    if found is None or found.faces is None:
        return None
    near = 1e-6 * float(np.max(high - low))
    on_low = np.abs(found.points - low) <= near
    on_high = np.abs(found.points - high) <= near
    capped = np.any(on_low[found.faces].all(axis=1) | on_high[found.faces].all(axis=1), axis=1)
    return Shape("mesh", found.points, found.faces[~capped]) if np.any(~capped) else None


def faces(vertices: Array) -> list[Array]:
    """Faces of the convex hull of points in space, corners in order, each of shape (V, 3)."""
    from scipy.spatial import ConvexHull, QhullError

    if len(vertices) < 4:
        return []
    try:
        hull = ConvexHull(vertices)
    except QhullError:  # no volume
        return []
    found = []
    for plane in np.unique(np.round(hull.equations, 6), axis=0):
        normal = plane[:3]
        on = vertices[np.abs(vertices @ normal + plane[3]) <= 1e-4 * (1 + np.abs(plane[3]))]
        if len(on) < 3:
            continue
        first = np.linalg.svd(on - on.mean(axis=0))[2][:2]
        flat = (on - on.mean(axis=0)) @ first.T
        found.append(on[np.argsort(np.arctan2(flat[:, 1], flat[:, 0]))])
    return found
