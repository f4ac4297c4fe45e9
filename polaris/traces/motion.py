"""Stamped values in between: linear interpolation, rates, weights."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..model.system import Array


def between(stamps: Array, t: Array) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Rows on either side of every time and how far it is from one to the other.

    Times before the first stamp belong to the first row, those after the last to the last. Of rows with
    the same stamp the last counts, unless both have the same stamps throughout: then rows are paired.

    Returns
    -------
    tuple
        Two arrays of int and one of shares in [0, 1), each (N,).
    """
    if np.array_equal(stamps, t):
        same = np.arange(len(t))
        return same, same, np.zeros(len(t))
    left = np.clip(np.searchsorted(stamps, t, side="right") - 1, 0, len(stamps) - 1)
    right = np.minimum(left + 1, len(stamps) - 1)
    gap = stamps[right] - stamps[left]
    share = np.divide(t - stamps[left], gap, out=np.zeros(len(t)), where=gap > 0)
    share = np.clip(share, 0.0, 1.0)
    return left, np.where(share > 0, right, left), share


def interpolate(values: Array, rows: tuple[NDArray[np.int64], NDArray[np.int64], Array]) -> Array:
    """Linear between stamps; values (M, ...), `rows` from `between`, result (N, ...)."""
    left, right, share = rows
    share = share.reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray(values[left] * (1 - share) + values[right] * share)


def rates(stamps: Array, values: Array) -> Array | None:
    """Rates of values (M, k) at their stamps: second-order differences, one-sided at the ends.

    Of rows with the same stamp the last is used, and all of them get its rate.

    Returns
    -------
    ndarray or None
        Shape (M, k); None if there is only one instant.
    """
    last = np.r_[np.diff(stamps) > 0, True]
    if last.sum() < 2:
        return None
    found = np.gradient(values[last], stamps[last], axis=0)
    return np.asarray(found[np.cumsum(np.r_[False, last[:-1]])])


def weights(t: Array) -> Array:
    """Weight of every sample in a mean over time (trapezoidal), shape (N,); they add up to 1.

    Samples of a trace that takes no time weigh the same.
    """
    gaps = np.diff(t)
    total = np.r_[gaps, 0.0] + np.r_[0.0, gaps]
    return np.asarray(total / total.sum() if total.sum() > 0 else np.full(len(t), 1 / len(t)))
