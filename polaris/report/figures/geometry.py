"""Plane and solid outlines of sets, ready to be drawn."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from reach.sets.zonotope import Zonotope

from ...model.shapes import Polytope
from ...model.system import Array
from ...runs.picture import directions


def ball(radius: float, d: int) -> Array:
    """Points all over a ball's surface about the origin, shape (V, d)."""
    if d == 1:
        return np.array([[-radius], [radius]])
    if d == 2:
        return radius * directions(64)
    angle = np.pi * np.arange(1, 12) / 12
    round_, up = directions(24), np.cos(angle)
    rings = np.concatenate(
        [np.c_[np.sin(a) * round_, np.full(24, z)] for a, z in zip(angle, up, strict=True)]
    )
    return np.asarray(radius * np.vstack([rings, [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]]))


def boxed(H: Array, b: Array, low: Array, high: Array) -> Polytope:
    """The polytope ``H p <= b`` cut to a box [m]."""
    eye = np.eye(len(low))
    return Polytope(np.vstack([H, eye, -eye]), np.concatenate([b, high, -low]))


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


def tube_polygons(centre: Array, generators: Array, bow: Array, parts: int, count: int = 32) -> Array:
    """Outlines of a tube in the plane, each over a part of a step, shape (K, parts, count, 2).

    Parameters
    ----------
    centre : ndarray, shape (K, q+1, 2)
        Centres at the nodes of every step [m].
    generators : ndarray, shape (K, q+1, 2, g)
    bow : ndarray, shape (K, q, 2)
        Bound on what lies outside the hull of consecutive nodes.
    parts : int
        Parts per step, at most q.
    """
    rays, q = directions(count), bow.shape[1]
    node = centre @ rays.T + np.abs(np.einsum("ri,kqig->kqrg", rays, generators)).sum(axis=-1)
    between = np.maximum(node[:, :-1], node[:, 1:]) + bow @ np.abs(rays).T
    edges = np.unique(np.linspace(0, q, parts + 1).astype(int))
    spans = [between[:, a:b].max(axis=1) for a, b in zip(edges[:-1], edges[1:], strict=True)]
    return polygon(np.stack(spans, axis=1), rays)


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


def zonotope_outline(zonotope: Zonotope, axes: list[int]) -> Array:
    """Outline of one set's projection on two coordinates, shape (count, 2)."""
    rays = directions(64)
    c, G = zonotope.c[axes], zonotope.G[axes]
    return polygon(rays @ c + np.abs(rays @ G).sum(axis=-1), rays)


def faces(vertices: Array) -> list[Array]:
    """Faces of the convex hull of points in space, corners in order, each of shape (V, 3)."""
    from scipy.spatial import ConvexHull, QhullError

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


def stretches(flags: ArrayLike) -> list[tuple[int, int]]:
    """First and one-past-last index of every stretch of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], np.asarray(flags, dtype=int), [0]])))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]
