"""Exponentials of matrices and their action, accurate in every row relative to that row.

A row may decay by many orders of magnitude beside others that do not, and bounds along it are wanted
to its own precision. Series of short pieces have no large terms that cancel, which Pade's
approximants of long ones do; and what is far below the rest of its row is cut off, since denormal
numbers are slow.
"""

from __future__ import annotations

from math import factorial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from .errors import Unresolved

Array = NDArray[np.float64]

FLUSH = 1e-60
"""Entries below this share of the largest of their row are set to zero: denormal numbers are slow."""
REACH = 3.0
"""Norm of ``A t`` up to which Taylor's series of the action is summed at once."""
CANCELLED = float(np.exp(2 * REACH) / (8 * REACH))
"""How much more rounding, per norm of ``A t``, such a series has than a product: its terms grow to
``exp(REACH)`` before they sum to what may be ``exp(-REACH)``."""
MOST_TERMS = 100
"""Terms of that series, whose rest then is below 1e-100; more are asked for only where numbers overflow."""
MOST_PARTS = 50_000
"""Series in a row that one step may take."""


def exponential(A: Any, h: float) -> Any:
    """``e^{A h}`` of dense matrices, shape (..., n, n), or of a sparse one, dense.

    Taylor's series of a fraction of h, squared. Of a sparse matrix the terms stay sparse, which
    keeps the entries far from those of A at zero.
    """
    norm = float(np.max(np.asarray(abs(A).sum(axis=-1)), initial=0.0)) * h
    halvings = int(np.clip(np.ceil(np.log2(max(norm, 1e-300))) + 1, 0, 1000))
    part = A * (h / 2.0**halvings)
    out = _dense_series(part) if isinstance(A, np.ndarray) else _sparse_series(sparse.csr_matrix(part))
    for _ in range(halvings):
        out = flushed(out @ out)
    return out


def _dense_series(X: Array) -> Array:
    """Terms up to the 15th, in six products; the norm of X is at most 1/2 and the rest below 1e-18."""
    X2 = X @ X
    X3, X4 = X2 @ X, X2 @ X2
    c = [1 / factorial(k) for k in range(16)]
    out: Array = c[13] * X + c[14] * X2 + c[15] * X3
    diagonal = np.arange(X.shape[-1])
    for k in (12, 8, 4, 0):
        if k < 12:
            out = out @ X4 + c[k + 1] * X + c[k + 2] * X2 + c[k + 3] * X3
        out[..., diagonal, diagonal] += c[k]
    return out


def _sparse_series(X: Any) -> Array:
    term = total = sparse.identity(X.shape[0], format="csr")
    for k in range(1, 16):
        term = term @ X / k
        total = total + term
    return np.asarray(total.toarray())


def action(M: Any, rows: Array, h: float, count: int) -> Array:
    """``e^{M h l} v`` for l = 0..count and every row v, shape (count+1, r, n), by Taylor's series.

    Each series spans as many steps as `REACH` allows, or a part of one, and ends where the bound on
    its rest, a geometric series in the norm of the last term, is below the rounding of every row.
    The mean of the diagonal is split off: it takes nothing but a factor.
    """
    M = sparse.csr_matrix(M)
    shift = float(M.diagonal().mean())
    N = M - shift * sparse.identity(M.shape[0], format="csr")
    norm = h * float(abs(N).sum(axis=0).max())
    if not norm <= MOST_PARTS * REACH:
        raise Unresolved(
            f"a step of {h:g} is too long for a sparse system this stiff ({norm:.3g} times its norm): "
            f"take steps below {h * MOST_PARTS * REACH / norm:.3g}, or give A as a dense matrix"
        )
    parts = max(int(np.ceil(norm / REACH)), 1)
    span = int(np.clip(REACH / norm if norm > 0 else count, 1, count)) if parts == 1 else 1
    out = np.empty((count + 1, *rows.shape))
    out[0] = rows
    for k in range(0, count, span):
        m = min(span, count - k)
        shares = np.arange(1, m + 1) / m
        x: Any = out[k]
        for _ in range(parts - 1):
            x = _series(N, x, h / parts, norm / parts, np.ones(1))[0] * np.exp(shift * h / parts)
        length = h * m / parts
        out[k + 1 : k + 1 + m] = _series(N, x, length, norm * m / parts, shares)
        out[k + 1 : k + 1 + m] *= np.exp(shift * length * shares)[:, None, None]
    return out


def _series(N: Any, rows: Array, t: float, norm: float, shares: Array) -> Array:
    """``e^{N t s} v`` for all shares s in [0, 1] of t and every row v; norm bounds ``|N t|``."""
    term = np.ascontiguousarray(rows.T)
    terms, start, j = [rows.ravel()], np.abs(rows).sum(axis=1), 0
    while True:
        j += 1
        term = N @ term * (t / j)
        terms.append(term.T.ravel())
        ratio = norm / (j + 1)
        rest = np.abs(term).sum(axis=0) * ratio / (1 - ratio) if ratio < 0.5 else np.full(len(start), np.inf)
        if np.all(rest <= 1e-17 * start) or j > MOST_TERMS:
            break
    powers = shares[:, None] ** np.arange(j + 1)
    return np.asarray((powers @ np.array(terms)).reshape(len(shares), *rows.shape))


def flushed(values: Any) -> Any:
    """The array, with entries below `FLUSH` times the largest of their row set to zero, in place.

    Rows run along the last axis. Each is compared with itself only: another row may be larger by
    any factor and matter less.
    """
    if isinstance(values, np.ndarray):
        size = np.abs(values)
        values[size < FLUSH * size.max(axis=-1, keepdims=True, initial=0.0)] = 0.0
        return values
    size, counts = np.abs(values.data), np.diff(values.indptr)
    largest = np.zeros(len(counts))
    largest[counts > 0] = np.maximum.reduceat(size, values.indptr[:-1][counts > 0]) if len(size) else 0.0
    values.data[size < FLUSH * np.repeat(largest, counts)] = 0.0
    return values


def times(rows: Array, M: Any) -> Array:
    """``rows @ M`` for rows (..., n) and M dense or sparse."""
    flat = rows.reshape(int(np.prod(rows.shape[:-1])), rows.shape[-1])
    out = flat @ M if isinstance(M, np.ndarray) else np.asarray((M.T @ flat.T).T)
    return out.reshape(*rows.shape[:-1], M.shape[1])


def scaled(M: Any, s: Array) -> Any:
    """Rows of M, dense or sparse, times numbers s."""
    return M * s[:, None] if isinstance(M, np.ndarray) else sparse.csr_matrix(sparse.diags(s) @ M)
