"""Planar outlines of convex sets, from their support vectors."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..numerics.checks import Array, require_sets
from ..numerics.errors import ReachError
from .ellipsoid import Ellipsoid
from .interval import Interval
from .lazy import DerivedSet
from .zonotope import Zonotope

OUTLINE = 128  # supporting lines that a round set is drawn with; it is overestimated by 0.03 %
SAME = 1e-9  # points this close, in sizes of the set, are one vertex


def is_round(X: Any) -> bool:
    """Return True if the set is an ellipsoid or made of one."""
    return isinstance(X, Ellipsoid) or (isinstance(X, DerivedSet) and any(map(is_round, X.operands)))


def outline(X: Any) -> Array:
    """Polygon around a planar set, counter-clockwise, shape (k, 2): exact unless the set is round."""
    require_sets(X)
    _require_planar(X)
    return _round_outline(X) if is_round(X) else np.asarray(X.vertices_2d())


def _require_planar(X: Any) -> None:
    if X.dim != 2:
        raise ReachError(f"an outline needs a planar set, got dimension {X.dim}")


def vertices_2d(X: Any) -> Array:
    """Vertices of a planar set with flat faces, counter-clockwise, shape (k, 2)."""
    _require_planar(X)
    if is_round(X):
        raise ReachError("a set with an ellipsoid in it has no vertices; reach.outline draws around it")
    flat = X.to_zonotope() if isinstance(X, Interval) else X
    return _of_zonotope(flat) if isinstance(flat, Zonotope) else _by_chords(X)


def _of_zonotope(Z: Zonotope) -> Array:
    """Generators in the order of their angles, walked around, (..., 2 g, 2); points may repeat."""
    if Z.order_count == 0:
        return Z.c[..., None, :]
    x, y = Z.G[..., 0, :], Z.G[..., 1, :]
    upward = np.where((y > 0) | ((y == 0) & (x > 0)), 1.0, -1.0)[..., None, :] * Z.G
    order = np.argsort(np.arctan2(upward[..., 1, :], upward[..., 0, :]), axis=-1)
    edges = 2 * np.swapaxes(np.take_along_axis(upward, order[..., None, :], axis=-1), -1, -2)
    half = np.cumsum(edges, axis=-2) - edges.sum(axis=-2, keepdims=True) / 2
    return np.asarray(Z.c[..., None, :] + np.concatenate([half, -half], axis=-2))


def _by_chords(X: Any) -> Array:
    """Between two vertices the support vector across their chord is a new one or shows an edge."""
    hull = X.interval_hull()
    size = np.maximum(hull.half_widths, SAME * max(float(hull.half_widths.max()), np.finfo(float).tiny))
    start = X.support_vector(np.array([[0.0, -1.0], [1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]]) / size)
    corners = [(p - hull.center) / size for p in start]
    out: list[Array] = []
    pending = list(zip(corners, [*corners[1:], corners[0]], strict=True))[::-1]
    while pending:
        p, q = pending.pop()
        chord = q - p
        length = float(np.linalg.norm(chord))
        if length <= SAME:
            continue
        normal = np.array([chord[1], -chord[0]]) / length
        between = (X.support_vector(normal / size) - hull.center) / size
        near = min(float(np.linalg.norm(between - p)), float(np.linalg.norm(between - q)))
        if normal @ (between - p) > SAME and near > SAME:
            pending += [(between, q), (p, between)]
        else:
            out.append(q)
    return np.asarray(np.array(out or corners[:1]) * size + hull.center)


def _round_outline(X: Any) -> Array:
    """Polygon of supporting lines around a planar set, counter-clockwise, shape (OUTLINE, 2)."""
    hull = X.interval_hull()
    size = np.where(hull.half_widths > 0, hull.half_widths, 1.0)
    angles = 2 * np.pi * np.arange(OUTLINE) / OUTLINE
    normals = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    offsets = X.support(normals / size) - (normals / size) @ hull.center
    return np.asarray(polygon(offsets, normals) * size + hull.center)


def polygon(support: ArrayLike, rays: Array) -> Array:
    """Corners (..., R, 2) of a polygon about a set, by its support (..., R) along rays in order of angle."""
    h = np.asarray(support, dtype=float)
    next_rays, next_h = np.roll(rays, -1, axis=0), np.roll(h, -1, axis=-1)
    cross = rays[:, 0] * next_rays[:, 1] - rays[:, 1] * next_rays[:, 0]
    x = (h * next_rays[:, 1] - next_h * rays[:, 1]) / cross
    return np.stack([x, (next_h * rays[:, 0] - h * next_rays[:, 0]) / cross], axis=-1)
