"""Outward rounding: what floating-point sums can be wrong by, booked on the safe side."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def gamma(terms: int) -> float:
    """Relative error of a sum of so many products, with room to spare (Higham 2002, section 3.1)."""
    return float((terms + 4) * np.finfo(float).eps)


def add_up(a: Array, b: Array) -> Array:
    """The sum, rounded up; unchanged where it is exact (two-sum, Knuth)."""
    total = np.asarray(a + b)
    part = total - a
    error = (a - (total - part)) + (b - part)
    return np.where(error > 0, np.nextafter(total, np.inf), total)


def add_down(a: Array, b: Array) -> Array:
    """The sum, rounded down; unchanged where it is exact."""
    return -add_up(-a, -b)
