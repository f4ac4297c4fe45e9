"""Outlines and surfaces of sets, ready to be drawn."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError

from ...model.scene.shapes import PolytopeShape
from ...model.system import Array
from ...runs.plot_data import directions


@dataclass(frozen=True, eq=False)
class DrawnShape:
    """A ``line`` (nan: gap), ``points``, ``area`` or ``mesh`` of triangles (F, 3); points (N, dim) [m]."""

    kind: str
    points: Array
    faces: NDArray[np.intp] | None = None

    def with_axes(self, axes: list[int]) -> "DrawnShape":
        """Return the shape with its coordinates in another order."""
        return DrawnShape(self.kind, self.points[:, axes], self.faces)

    def translated(self, shift: Array) -> "DrawnShape":
        """Return the shape moved by a vector."""
        return DrawnShape(self.kind, self.points + shift, self.faces)


def tube_support(centre: Array, generators: Array, intersample: Array, parts: int, rays: Array) -> Array:
    """Support (K, parts, R) [m] of a tube over parts of every step along rays (R, e).

    From centres (K, q+1, e) and generators (K, q+1, e, g) at nodes, and the intersample bound (K, q, e)
    between them.
    """
    node = centre @ rays.T + np.abs(np.einsum("ri,kqig->kqrg", rays, generators)).sum(axis=-1)
    between = np.maximum(node[:, :-1], node[:, 1:]) + intersample @ np.abs(rays).T
    return np.asarray(np.maximum.reduceat(between, part_edges(intersample.shape[1], parts)[:-1], axis=1))


def part_edges(q: int, parts: int) -> NDArray[np.int_]:
    """Nodes at which the parts of a step begin and end."""
    return np.unique(np.linspace(0, q, parts + 1).astype(int))


def flat_outline(vertices: Array) -> Array:
    """Convex hull (V, 2) of points in the plane, counter-clockwise; the ends of a set without area."""
    points = np.unique(vertices, axis=0)
    try:
        corners = ConvexHull(points).vertices
    except (QhullError, ValueError):  # too few, or all on a line
        return np.asarray(points[:: max(len(points) - 1, 1)])
    return np.asarray(points[np.roll(corners, -int(np.argmin(corners)))])


def closed(outline: Array) -> Array:
    """An outline whose last point is its first."""
    return np.vstack([outline, outline[:1]]) if len(outline) else outline


def gapped(lines: Iterable[Array], dim: int) -> Array:
    """Lines (N, dim) as one, with a gap after each."""
    gap = np.full((1, dim), np.nan)
    return np.vstack([gap[:0], *(part for line in lines for part in (line, gap))])


def hull(points: Array) -> DrawnShape | None:
    """Surface of the convex hull of points (V, 3); None if it has no volume."""
    if len(points) < 4:
        return None
    size = max(float(np.ptp(points, axis=0).max()), 1e-300)
    try:
        body = ConvexHull((points - points.mean(axis=0)) / size)
    except QhullError:
        return None
    used = np.unique(body.simplices)
    place = np.zeros(len(points), dtype=np.intp)
    place[used] = np.arange(len(used))
    return DrawnShape("mesh", points[used], place[body.simplices])


def polyhedron(normals: Array, support: Array, inside: Array) -> DrawnShape | None:
    """Surface of the bounded set ``normals p <= support``, from a point strictly inside [m]."""
    slack = support - normals @ inside
    size = float(np.max(np.abs(slack)))
    if not np.all(slack > 1e-12 * max(size, 1e-300)):
        return None
    try:
        body = HalfspaceIntersection(np.column_stack([normals, -slack / size]), np.zeros(3))
    except QhullError:
        return None
    points = body.intersections[np.isfinite(body.intersections).all(axis=1)]
    distinct = points[np.unique(np.round(points, 9), axis=0, return_index=True)[1]]  # but for round-off
    return hull(inside + size * distinct)


@cache
def _unit_ball() -> DrawnShape:
    """Return a sphere through points on a spiral that winds evenly about it, and those opposite."""
    height, turn = np.linspace(-1, 1, 100), np.pi * (3 - 5**0.5) * np.arange(100)
    wide = np.sqrt(1 - height**2)
    points = np.stack([wide * np.cos(turn), wide * np.sin(turn), height], axis=1)
    surface = hull(np.unique(np.vstack([points, -points]), axis=0))
    assert surface is not None
    return surface


def ball(radius: float) -> DrawnShape:
    """A ball [m] about the origin."""
    return DrawnShape("mesh", radius * _unit_ball().points, _unit_ball().faces)


def ball_points(radius: float, d: int) -> Array:
    """Points all over a ball's surface about the origin, shape (V, d)."""
    if d == 3:
        return ball(radius).points
    return radius * (directions(64) if d == 2 else np.array([[-1.0], [1.0]]))


def boxed(H: Array, b: Array, low: Array, high: Array) -> PolytopeShape:
    """The polytope ``H p <= b`` cut to a box [m]."""
    eye = np.eye(len(low))
    return PolytopeShape(np.vstack([H, eye, -eye]), np.concatenate([b, high, -low]))


def cut_surface(H: Array, b: Array, low: Array, high: Array) -> DrawnShape | None:
    """Surface of ``H p <= b`` within a box [m], open where it leaves it; None if nothing of it is there."""
    whole = boxed(H, b, low, high)
    if not whole.depth > 0:
        return None
    body = polyhedron(whole.H, whole.b, whole.middle)
    if body is None or body.faces is None:
        return None
    inner = ~on_box(body.points[body.faces], low, high)
    return DrawnShape("mesh", body.points, body.faces[inner]) if np.any(inner) else None


def on_box(parts: Array, low: Array, high: Array) -> NDArray[np.bool_]:
    """Return True for each line or triangle (N, corners, 3) that lies in a side of a box [m]."""
    gaps = np.abs(np.stack([parts - low, parts - high]))
    return np.asarray(np.any(np.all(gaps <= 1e-6 * np.max(high - low), axis=2), axis=(0, 2)))


def edges(points: Array) -> Array:
    """Return the edges of the convex hull of points in space, shape (L, 2, 3); none if it has no volume."""
    surface = hull(points)
    if surface is None or surface.faces is None:
        return np.zeros((0, 2, 3))
    corners = surface.points[surface.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    sides = np.sort(surface.faces[:, [[0, 1], [1, 2], [2, 0]]], axis=2).reshape(-1, 2)
    kinds, place = np.unique(sides, axis=0, return_inverse=True)
    first, second = np.argsort(place, kind="stable").reshape(-1, 2).T // 3  # the two triangles beside each
    sharp = np.abs(np.sum(normal[first] * normal[second], axis=1)) < 1 - 1e-9
    return np.asarray(surface.points[kinds[sharp]])
