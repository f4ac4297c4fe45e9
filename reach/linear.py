"""Matrix exponentials of linear systems and bounds on what happens between samples."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

Array = NDArray[np.float64]


def discretize(A: Array, B: Array, h: float) -> tuple[Array, Array]:
    """Exact zero-order-hold pair ``(e^{A h}, int_0^h e^{A s} ds B)``.

    Parameters
    ----------
    A, B : ndarray, shapes (n, n), (n, m)
    h : float
        Step, >= 0.
    """
    n, m = B.shape
    block = np.zeros((n + m, n + m))
    block[:n, :n] = A
    block[:n, n:] = B
    E = expm(block * h)
    return E[:n, :n], E[:n, n:]


def growth(A: Array, h: float) -> Array:
    """Elementwise bound ``|e^{A s}| <= e^{|A| h}`` valid for every s in [0, h], shape (n, n)."""
    return np.asarray(expm(np.abs(A) * h))


def powers(M: Array, count: int) -> Array:
    """``M^0 ... M^count`` stacked, shape (count+1, n, n)."""
    out = np.empty((count + 1, *M.shape))
    out[0] = np.eye(len(M))
    for i in range(count):
        out[i + 1] = M @ out[i]
    return out
