"""Enclosures of the convex hull of sets that have nothing to do with each other."""

from __future__ import annotations

import numpy as np

from ..numerics.arguments import checked
from .convex import require_alike, require_same_dim
from .zonotope import Zonotope


@checked
def enclosing_hull(first: Zonotope, second: Zonotope) -> Zonotope:
    """Zonotope around the convex hull of two zonotopes; stacks broadcast.

    `Zonotope.hull` holds both sets for any pairing of their generators; this takes the pairing (and
    the signs) with the least total distance, generators left over being paired with none.

    Raises
    ------
    ReachError
        If the dimensions differ.
    """
    from scipy.optimize import linear_sum_assignment

    require_same_dim(first, second)
    require_alike(first.batch, second.batch)
    shape = np.broadcast_shapes(first.batch, second.batch)
    width = first.order_count + second.order_count
    a, b = (Zonotope(z.c + np.zeros((*shape, 1)), z.G + np.zeros((*shape, 1, 1))) for z in (first, second))
    size = np.maximum(a.half_widths, b.half_widths)
    size = np.where(size > 0, size, 1.0)[..., None]
    missing = [np.zeros((*shape, first.dim, width - z.order_count)) for z in (a, b)]
    G, H = (np.concatenate([z.G, zero], axis=-1) for z, zero in zip((a, b), missing, strict=True))
    near, far = (
        np.linalg.norm((G / size)[..., :, None] - sign * (H / size)[..., None, :], axis=-3)
        for sign in (1, -1)
    )
    paired = np.empty_like(H)
    for at in np.ndindex(shape):
        order = linear_sum_assignment(np.minimum(near[at], far[at]))[1]
        pick = np.arange(width), order
        paired[at] = H[at][:, order] * np.where(near[at][pick] <= far[at][pick], 1.0, -1.0)
    used = np.any(G != 0, axis=-2) | np.any(paired != 0, axis=-2)
    kept = used.any(axis=tuple(range(len(shape))))
    return Zonotope(a.c, G[..., kept]).hull(Zonotope(b.c, paired[..., kept]))
