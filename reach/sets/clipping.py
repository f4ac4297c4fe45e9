"""Enclosures of zonotopes cut by halfspaces, and of unions, on stacks: a guard cuts many small sets."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..numerics.checks import Array, as_numbers, as_vector, checked, require_alike, require_same_dim
from ..numerics.errors import ReachError
from ..numerics.rounding import gamma
from .polytope import HPolytope
from .zonotope import Zonotope

Flags = NDArray[np.bool_]
SWEEPS = 3  # passes over the rows while coefficients are narrowed
WORTH = 0.9  # a strip is intersected by one more generator if it is narrower than this share of the set


def strips(polytopes: Sequence[HPolytope | None], n: int) -> tuple[Array, Array, Array]:
    """Unit rows (q, n) and limits (q,) of ``low <= H x <= high``; parallel rows share a strip."""
    H, low, high = np.zeros((0, n)), np.zeros(0), np.zeros(0)
    for p in filter(None, polytopes):
        norms = np.linalg.norm(p.A, axis=1)
        for row, b in zip(p.A / norms[:, None], p.b / norms, strict=True):
            same, opposite = np.all(row == H, axis=1), np.all(row == -H, axis=1)
            if np.any(same):
                j = int(np.argmax(same))
                high[j] = min(high[j], b)
            elif np.any(opposite):
                j = int(np.argmax(opposite))
                low[j] = max(low[j], -b)
            else:
                H, low, high = np.vstack([H, row]), np.r_[low, -np.inf], np.r_[high, b]
    return H, low, high


def clip(Z: Zonotope, H: Array, low: Array, high: Array) -> tuple[Zonotope, Flags]:
    """Enclose the part of every zonotope of a stack (M,) that lies in the strips.

    Two steps, both sound. The coefficients are narrowed to those with which the limits can be met
    (the interval hull of each cut of the cube of coefficients, so the order does not grow). Where a
    strip still cuts, the zonotope ``c + l (d - h c), [(I - l h) G, l s]`` encloses the
    intersection with ``|h x - d| <= s`` for any l; the l of the least sum of squares is taken
    (Bravo et al. 2006). The strips are those of `strips`, or one of each per member, (M, q, n) and (M, q).
    Also said is which members meet the strips, (M,): the others are proved not to, and stay as they are.
    """
    meets = np.ones(len(Z), dtype=bool)
    q = H.shape[-2]
    if q == 0 or len(Z) == 0:
        return Z, meets
    slack = gamma(Z.terms + 2 * q) * (np.abs(H) @ Z.extent[..., None])[..., 0]
    slack = slack + gamma(4) * np.where(np.isfinite(high), np.abs(high), np.abs(low))
    lows, highs = low - slack, high + slack
    cut, meets = _narrow(Z, H, lows, highs, meets)
    grew = False
    for j in range(q):
        cut, changed = _strip(cut, H[..., j, :], lows[:, j], highs[:, j], slack[:, j], meets)
        grew = grew or changed
    if grew:
        cut, meets = _narrow(cut, H, lows, highs, meets)
    margin = gamma(8 * (Z.order_count + q)) * Z.extent
    return Zonotope(
        np.where(meets[:, None], cut.c, Z.c),
        np.where(meets[:, None, None], cut.inflate(margin).G, Z._pad(cut.order_count + Z.dim).G),
    ), meets


def _narrow(Z: Zonotope, H: Array, low: Array, high: Array, meets: Flags) -> tuple[Zonotope, Flags]:
    """Shrink the range of every coefficient to the values the strips allow."""
    a = H @ Z.G  # (M, q, g)
    d = (H @ Z.c[..., None])[..., 0]
    lo, hi = np.full((len(Z), Z.order_count), -1.0), np.full((len(Z), Z.order_count), 1.0)
    meets = meets.copy()
    with np.errstate(divide="ignore", invalid="ignore"):
        for _ in range(SWEEPS):
            for j in range(H.shape[-2]):
                w = a[:, j]
                least, largest = np.minimum(w * lo, w * hi), np.maximum(w * lo, w * hi)
                total_least, total_most = least.sum(1, keepdims=True), largest.sum(1, keepdims=True)
                room_high, room_low = high[:, j] - d[:, j], low[:, j] - d[:, j]
                meets &= (total_least[:, 0] <= room_high) & (total_most[:, 0] >= room_low)
                # w b_l <= room_high - what the others take at least, and the same from below
                above = room_high[:, None] - (total_least - least)
                below = room_low[:, None] - (total_most - largest)
                upper, lower = np.maximum(above / w, below / w), np.minimum(above / w, below / w)
                tiny = np.abs(w) < 1e-9 * np.abs(w).max(axis=1, keepdims=True, initial=0.0)
                widen = 1e-12
                hi = np.where(tiny | np.isnan(upper), hi, np.clip(upper + widen, lo, hi))
                lo = np.where(tiny | np.isnan(lower), lo, np.clip(lower - widen, lo, hi))
    middle, half = (lo + hi) / 2, (hi - lo) / 2 * (1 + 4 * np.finfo(float).eps)
    return Zonotope(Z.c + (Z.G @ middle[..., None])[..., 0], Z.G * half[:, None, :]), meets


def _strip(
    Z: Zonotope, h: Array, low: Array, high: Array, slack: Array, meets: Flags
) -> tuple[Zonotope, bool]:
    """Intersect with one strip by one more generator, where worth it; rounding widens the strip."""
    a = (h[..., None, :] @ Z.G)[:, 0]
    d, reach = (Z.c * h).sum(axis=-1), np.abs(a).sum(axis=1)
    low, high = np.maximum(low, d - reach), np.minimum(high, d + reach)
    s, middle = np.maximum((high - low) / 2, 0) + 2 * slack, (high + low) / 2
    worth = meets & (s < WORTH * reach)
    if not np.any(worth):
        return Z, False
    size = (a**2).sum(axis=1) + s**2
    gain = (Z.G @ a[..., None])[..., 0] / np.where(size > 0, size, 1.0)[:, None]
    gain[~worth] = 0.0
    G = Z.G - gain[..., None] * a[:, None, :]
    c = Z.c + gain * np.where(worth, middle - d, 0.0)[:, None]
    return Zonotope(c, np.concatenate([G, (gain * s[:, None])[..., None]], axis=-1)), True


def hull_of(Z: Zonotope) -> Zonotope:
    """One zonotope around all sets of a stack: a parallelotope along their principal axes."""
    if len(Z) == 1:
        return Z[0]
    hull = Z.interval_hull()
    lo, hi = hull.lo.min(axis=0), hull.hi.max(axis=0)
    scale = np.where(hi > lo, (hi - lo) / 2, 1.0)
    spread = np.concatenate([(Z.c - Z.c.mean(axis=0)).T, *(Z.G[i] for i in range(len(Z)))], axis=1)
    frame = np.linalg.svd(spread / scale[:, None], full_matrices=True)[0]
    rows = frame.T / scale
    upper, lower = Z.support_up(rows).max(axis=0), -Z.support_up(-rows).max(axis=0)
    middle, half = (upper + lower) / 2, (upper - lower) / 2
    size = np.max(np.abs(rows) @ np.maximum(np.abs(lo), np.abs(hi)))
    half = half + gamma(8 * Z.dim) * size  # the frame is orthogonal but for rounding
    columns = frame * scale[:, None]
    return Zonotope(columns @ middle, columns * half)


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


@checked
def meet_halfspace(zonotope: Zonotope, normal: ArrayLike, offset: ArrayLike) -> Zonotope:
    """Enclose the part of a zonotope with ``normal . x <= offset``.

    See `clip`: coefficients are narrowed, then the strip between the least value of ``normal . x`` and
    the offset is intersected where that is worth it.

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
    a, b = as_vector(normal, zonotope.dim), as_numbers("offset", offset)
    if not np.all(np.isfinite(b)):
        raise ReachError("offset must be finite")
    require_alike(a.shape[:-1], b.shape, zonotope.batch)
    shape = np.broadcast_shapes(a.shape[:-1], b.shape, zonotope.batch)
    n, g, M = zonotope.dim, zonotope.order_count, int(np.prod(shape))
    norms = np.linalg.norm(a, axis=-1)
    norms = np.where(norms > 0, norms, 1.0)
    H, high = a / norms[..., None], b / norms + gamma(n) * np.abs(b / norms)
    H, high = np.broadcast_to(H, (*shape, n)).reshape(M, 1, n), np.broadcast_to(high, shape).reshape(M, 1)
    c, G = np.broadcast_to(zonotope.c, (*shape, n)), np.broadcast_to(zonotope.G, (*shape, n, g))
    stack = Zonotope(c.reshape(M, n), G.reshape(M, n, g))
    cut, meets = clip(stack, H, np.full_like(high, -np.inf), high)
    if not np.all(meets):
        raise ReachError("no point of the set satisfies normal . x <= offset")
    return Zonotope(cut.c.reshape(*shape, n), cut.G.reshape(*shape, n, cut.order_count))
