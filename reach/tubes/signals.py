"""Signals known in advance, piecewise affine in time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..numerics.checks import Array, as_numbers, finite_fields
from ..numerics.errors import ReachError


@dataclass(frozen=True, eq=False)
class Signal:
    """Values joined by straight lines, constant before the first and after the last.

    Parameters
    ----------
    times : array_like, shape (k,)
        Not decreasing. Two equal times are a jump, after which the second value holds.
    values : array_like, shape (k, m)

    Raises
    ------
    ReachError
        If a shape does not fit, a number is not finite, or the times decrease.
    """

    times: Array
    values: Array

    def __post_init__(self) -> None:
        t, values = finite_fields(self, "times", "values")
        _require_pairs(t, values)
        if np.any(np.diff(t) < 0):
            k = int(np.argmax(np.diff(t) < 0))
            raise ReachError(f"times of a signal must not decrease, got {t[k]:g} before {t[k + 1]:g}")

    @classmethod
    def constant_pieces(cls, times: ArrayLike, values: ArrayLike) -> Signal:
        """Each value holds from its time to the next."""
        t, v = as_numbers("times", times), as_numbers("values", values)
        _require_pairs(t, v)
        return cls(np.r_[t[:1], np.repeat(t[1:], 2)], np.repeat(v, 2, axis=0)[:-1])

    @property
    def dim(self) -> int:
        """Number m of values."""
        return int(self.values.shape[1])

    def __call__(self, t: ArrayLike) -> Array:
        """Values at given times, the later one at a jump, shape (len(t), m)."""
        t = np.atleast_1d(as_numbers("t", t))
        k = np.searchsorted(self.times, t, side="right") - 1
        since = np.where(k < 0, 0.0, t - self.times[np.maximum(k, 0)])
        return np.asarray(self.values[np.maximum(k, 0)] + since[:, None] * self.slope(t))

    def slope(self, t: ArrayLike) -> Array:
        """Slopes at given times, those to the right at a knot, shape (len(t), m)."""
        length = np.diff(self.times)
        rise = np.diff(self.values, axis=0)
        inner = np.divide(rise, length[:, None], out=np.zeros_like(rise), where=length[:, None] > 0)
        slopes = np.vstack([np.zeros((1, self.dim)), inner, np.zeros((1, self.dim))])
        return np.asarray(
            slopes[np.searchsorted(self.times, np.atleast_1d(as_numbers("t", t)), side="right")]
        )


def _require_pairs(t: Array, values: Array) -> None:
    if t.ndim != 1 or len(t) == 0 or values.ndim != 2 or len(values) != len(t):
        raise ReachError(f"a signal needs times (k,) and values (k, m), got {t.shape} and {values.shape}")
