"""Zonotopes that enclose what a halfspace leaves of a zonotope."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..numerics.arguments import checked
from ..numerics.errors import ReachError
from ..numerics.rounding import gamma
from .convex import as_vector, require_alike, weighed
from .zonotope import Zonotope

Array = NDArray[np.float64]


@checked
def meet_halfspace(zonotope: Zonotope, normal: ArrayLike, offset: ArrayLike) -> Zonotope:
    """Enclose the part of a zonotope with ``normal . x <= offset``.

    Each coefficient is first confined to the range that the inequality leaves it; then the strip
    between the least value of ``normal . x`` and the offset is applied as an observer would
    (Bravo, Alamo and Camacho 2006), if that makes the interval hull smaller.

    Parameters
    ----------
    zonotope : Zonotope
        One set or a stack.
    normal : array_like, shape (..., n)
    offset : array_like, shape (...)
        Both broadcast with the stack.

    Returns
    -------
    Zonotope
        With up to n + 1 generators more: one for the strip, n for the rounding.

    Raises
    ------
    ReachError
        If no point of (one of) the set(s) is left.
    """
    a, b = as_vector(normal, zonotope.dim), np.asarray(offset, dtype=float)
    if not np.all(np.isfinite(b)):
        raise ReachError("offset must be finite")
    require_alike(a.shape[:-1], b.shape, zonotope.batch)
    shape = np.broadcast_shapes(a.shape[:-1], b.shape, zonotope.batch)
    n, g = zonotope.dim, zonotope.order_count
    c, G = np.broadcast_to(zonotope.c, (*shape, n)), np.broadcast_to(zonotope.G, (*shape, n, g))
    a, b = np.broadcast_to(a, (*shape, n)), np.broadcast_to(b, shape)
    booked = gamma(n + g) * (weighed(a[..., None, :], np.abs(c) + np.abs(G).sum(axis=-1))[..., 0] + np.abs(b))
    room = b - (a * c).sum(axis=-1) + booked  # a G beta <= room
    pull = (a[..., None, :] @ G)[..., 0, :]
    total = np.abs(pull).sum(axis=-1)
    if np.any(room + total < 0):
        raise ReachError("no point of the zonotope satisfies normal . x <= offset")
    # Each coefficient, the others at their least: sign(pull) beta <= most.
    share = room[..., None] + (total[..., None] - np.abs(pull))
    most = np.divide(share, np.abs(pull), out=np.ones_like(share), where=np.abs(pull) > np.abs(share))
    most = np.clip(most + gamma(g), -1, 1)
    middle = np.where(most < 1, np.sign(pull) * (most - 1) / 2, 0.0)
    half = np.where(most < 1, (1 + most) / 2 + gamma(1), 1.0)
    confined = Zonotope(c + (G @ middle[..., None])[..., 0], G * half[..., None, :])
    strip = _strip(confined, a, b)
    size = np.where(zonotope.half_widths > 0, zonotope.half_widths, 1.0)
    better = (strip.half_widths / size).sum(axis=-1) < (confined.half_widths / size).sum(axis=-1)
    padded = np.concatenate([confined.G, np.zeros((*shape, n, 1))], axis=-1)
    out = Zonotope(
        np.where(better[..., None], strip.c, confined.c), np.where(better[..., None, None], strip.G, padded)
    )
    changed = better | np.any(most < 1, axis=-1)
    extent = np.abs(c) + np.abs(G).sum(axis=-1)
    turned = np.abs(out.c - c) + np.abs(out.G).sum(axis=-1)
    return out.inflate(np.where(changed[..., None], 4 * gamma(n + g) * (extent + turned), 0.0))


def _strip(zonotope: Zonotope, a: Array, b: Array) -> Zonotope:
    """Observer correction by the strip ``-support(-a) <= a . x <= b``; sound for any gain."""
    c, G = zonotope.c, zonotope.G
    pull = (a[..., None, :] @ G)[..., 0, :]
    value = (a * c).sum(axis=-1)
    least = value - np.abs(pull).sum(axis=-1)
    top = np.minimum(b, value + np.abs(pull).sum(axis=-1))
    middle, width = (top + least) / 2, np.abs(top - least) / 2
    spread = (G @ pull[..., None])[..., 0]
    weight = (pull**2).sum(axis=-1) + width**2
    gain = spread / np.where(weight > 0, weight, 1.0)[..., None]
    turned = G - gain[..., :, None] * pull[..., None, :]
    return Zonotope(
        c + gain * (middle - value)[..., None],
        np.concatenate([turned, (gain * width[..., None])[..., None]], axis=-1),
    )
