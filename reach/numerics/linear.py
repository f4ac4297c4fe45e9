"""Matrix exponentials of linear systems and bounds on motion between samples."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.linalg import expm

from .checks import Array, checked
from .errors import ReachError

FFT = 1e-13  # round-off of sums of products by fast transforms, relative to the largest of them


def require_square(name: str, M: Array) -> None:
    """Refuse all but one square matrix."""
    if M.ndim != 2 or M.shape[0] != M.shape[1] or len(M) == 0:
        raise ReachError(f"{name} must be a square matrix, got shape {M.shape}")


LARGE = 1024.0  # entries of ``B h`` from which its unit is changed


@checked
def discretize(A: Array, B: Array, h: float) -> tuple[Array, Array]:
    """Exact zero-order-hold pair ``(e^{A h}, int_0^h e^{A s} ds B)``.

    Parameters
    ----------
    A, B : ndarray, shapes (n, n), (n, m)
    h : float
        Step, >= 0.
    """
    require_square("A", A)
    if B.ndim != 2 or len(B) != len(A):
        raise ReachError(f"B must have {len(A)} rows as A has, got shape {B.shape}")
    n, m = B.shape
    # Inputs in small units would cost e^{A h} digits: B is divided by a power of two, exactly.
    size = float(np.abs(B).max(initial=0.0)) * h
    unit = 2.0 ** np.ceil(np.log2(size)) if LARGE < size < np.inf else 1.0
    block = np.zeros((n + m, n + m))
    block[:n, :n], block[:n, n:] = A, B / unit
    E = _exponential((block * h).tobytes(), n + m).copy()
    return E[:n, :n], E[:n, n:] * unit


@lru_cache(maxsize=1024)
def _exponential(entries: bytes, n: int) -> Array:
    """Return the exponential of a matrix given by its entries, cached: references of one system share it."""
    return np.asarray(expm(np.frombuffer(entries).reshape(n, n)))


@checked
def growth(A: Array, h: float) -> Array:
    """Elementwise bound ``|e^{A s}| <= e^{|A| h}`` valid for every s in [0, h], shape (n, n)."""
    require_square("A", A)
    return _exponential((np.abs(A) * h).tobytes(), len(A)).copy()


@checked
def powers(M: Array, count: int) -> Array:
    """``M^0 ... M^count`` stacked, shape (count+1, n, n)."""
    require_square("M", M)
    if count < 0:
        raise ReachError(f"count must be at least 0, got {count}")
    out = np.empty((count + 1, *M.shape))
    out[0] = np.eye(len(M))
    for i in range(count):
        out[i + 1] = M @ out[i]
    return out


def summed(gains: Array, sizes: Array) -> Array:
    """Return ``sum_{i<L} gains[L-1-i] sizes[i]`` for L = 0 ... count, rounded upwards, shape (count + 1, r).

    Parameters
    ----------
    gains : ndarray, shape (ages, r, k)
        Not negative, by the age of a period.
    sizes : ndarray, shape (count, k)
        Not negative, period by period.
    """
    from scipy.signal import oaconvolve  # takes longer to load than all else that a synthesis needs

    sums = oaconvolve(gains, sizes[:, None, :], axes=0)[: len(sizes)].sum(axis=-1)
    sums = np.maximum(sums, 0.0) + FFT * np.max(sums, axis=0, initial=0.0)
    return np.vstack([np.zeros((1, gains.shape[1])), sums])
