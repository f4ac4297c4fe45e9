"""Nearest points of two convex sets, from their support vectors alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .convex import ConvexSet, require_same_dim

Array = NDArray[np.float64]

STEPS = 500
"""Most support vectors asked of each set; polytopes need far fewer, ellipsoids stop at `CLOSE`."""

CLOSE = 1e-12
"""Relative improvement of the squared distance that is no longer worth a step."""


@dataclass(frozen=True)
class Nearest:
    """Nearest points found, in coordinates scaled so that the sets have about unit size.

    Attributes
    ----------
    x, y : ndarray, shape (n,)
        Points of the first and the second set.
    gap : float
        Scaled distance of the two points.
    least : float
        The sets are at least this far apart (scaled, before rounding); not above `gap`.
    direction : ndarray, shape (n,)
        In true coordinates: ``direction . (y - x)`` is positive for disjoint sets.
    scale : ndarray, shape (n,)
        Size of one unit along each axis.
    """

    x: Array
    y: Array
    gap: float
    least: float
    direction: Array
    scale: Array


def nearest(X: ConvexSet, Y: ConvexSet, scale: Array | None = None, enough: float = 0.0) -> Nearest:
    """Nearest points of two sets (Wolfe 1976, the point of least norm of ``X - Y``).

    Parameters
    ----------
    X, Y : ConvexSet
        Single bounded sets.
    scale : ndarray, shape (n,), optional
        Size of one unit along each axis; by default the larger of the two interval hulls.
    enough : float
        Scaled distance at or below which the points need not come closer.
    """
    require_same_dim(X, Y)
    if scale is None:
        scale = unit_sizes(np.maximum(X.interval_hull().half_widths, Y.interval_hull().half_widths))
    pairs = [np.stack([X.center, Y.center])]
    corral, weights, least = ((X.center - Y.center) / scale)[None], np.ones(1), 0.0
    for _ in range(STEPS):
        z = weights @ corral
        if z @ z <= enough**2:
            break
        pair = np.stack([X.support_vector(-z / scale), Y.support_vector(z / scale)])
        furthest = (pair[0] - pair[1]) / scale
        least = max(least, float(z @ furthest) / max(float(np.linalg.norm(z)), np.finfo(float).tiny))
        if z @ (z - furthest) <= CLOSE * max(float(z @ z), CLOSE * float(np.max(corral**2))):
            break
        corral, weights, pairs = _settle(np.vstack([corral, furthest]), np.r_[weights, 0.0], [*pairs, pair])
    x, y = np.tensordot(weights, np.array(pairs), axes=1)
    z = weights @ corral
    return Nearest(x, y, float(np.linalg.norm(z)), least, -z / scale, scale)


def unit_sizes(half_widths: Array) -> Array:
    """Positive sizes to measure with: the half-widths, flat axes taking the largest of the others."""
    largest = float(half_widths.max(initial=0.0)) or 1.0
    return np.where(half_widths > 0, half_widths, largest)


def _settle(corral: Array, weights: Array, pairs: list[Array]) -> tuple[Array, Array, list[Array]]:
    """Minor cycle: move to the point of least norm of a face of the corral, dropping what it does not use."""
    while True:
        k = len(corral)
        system = np.block([[np.zeros((1, 1)), np.ones((1, k))], [np.ones((k, 1)), corral @ corral.T]])
        best = np.linalg.lstsq(system, np.r_[1.0, np.zeros(k)], rcond=None)[0][1:]
        if np.all(best > 1e-14):
            return corral, best / best.sum(), pairs
        falling = best <= 1e-14
        shares = weights[falling] / np.maximum(weights[falling] - best[falling], 1e-300)
        weights = weights + min(1.0, float(shares.min())) * (best - weights)
        keep = weights > 1e-14
        if keep.all():
            keep[np.argmin(weights)] = False
        corral, weights = corral[keep], weights[keep] / weights[keep].sum()
        pairs = [pair for pair, kept in zip(pairs, keep, strict=True) if kept]
