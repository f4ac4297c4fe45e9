"""Sound affine relaxations of static nonlinearities over an interval."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .checks import Array, checked, require_alike
from .errors import ReachError


@checked
def clip_relaxation(
    lo: ArrayLike, hi: ArrayLike, limit: ArrayLike, slopes: int | None = None
) -> tuple[Array, Array, Array]:
    """Affine band that holds ``clip(y, -limit, limit)`` for every y in [lo, hi], elementwise.

    Parameters
    ----------
    lo, hi : array_like
        Range of the argument.
    limit : array_like
        Limits at which it is clipped, >= 0.
    slopes : int, optional
        Round the slope to this many equal parts of 1, so that few different ones occur (a band of
        any slope is sound; the radius pays for it).

    Returns
    -------
    slope, offset, radius : ndarray
        ``|clip(y) - (slope * y + offset)| <= radius``. Exact (radius 0) where the interval does
        not straddle a limit.

    Raises
    ------
    ReachError
        If an interval is empty, a limit negative, or a number not finite.
    """
    arrays = [np.asarray(v, dtype=float) for v in (lo, hi, limit)]
    require_alike(*(v.shape for v in arrays))
    lo, hi, limit = np.broadcast_arrays(*arrays)
    if slopes is not None and slopes < 1:
        raise ReachError(f"slopes must be at least 1, got {slopes}")
    if not np.all(np.isfinite(lo) & np.isfinite(hi) & np.isfinite(limit)):
        raise ReachError("interval and limit must be finite")
    if np.any(lo > hi) or np.any(limit < 0):
        raise ReachError("need lo <= hi and limit >= 0")
    width = hi - lo
    top, bottom = np.clip(hi, -limit, limit), np.clip(lo, -limit, limit)
    slope = np.divide(top - bottom, width, out=np.zeros_like(width), where=width > 0)
    if slopes is not None:
        slope = np.round(slope * slopes) / slopes
    # clip(y) - slope * y is piecewise affine: its extremes are at the ends and at the limits.
    corners = np.stack([lo, hi, np.clip(-limit, lo, hi), np.clip(limit, lo, hi)])
    values = np.clip(corners, -limit, limit) - slope * corners
    upper, lower = values.max(axis=0), values.min(axis=0)
    radius = (upper - lower) / 2
    exact = np.where((lo >= -limit) & (hi <= limit), True, (lo >= limit) | (hi <= -limit))
    inside = (lo >= -limit) & (hi <= limit)
    offset = np.where(inside, 0.0, np.where(exact, top, (upper + lower) / 2))
    slope = np.where(inside, 1.0, np.where(exact, 0.0, slope))
    # The rounding of the differences above, covered.
    slack = 8 * np.finfo(float).eps * (np.abs(lo) + np.abs(hi) + limit)
    return slope, offset, np.where(exact, 0.0, radius + slack)
