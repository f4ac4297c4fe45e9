"""Exponentials of matrices and their action, accurate in every row relative to that row, however it decays.

Series of short pieces have no large terms that cancel; what is far below the rest of its row is cut off.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from .checks import Array
from .errors import Unresolved

FLUSH = 1e-36
"""Entries below this share of the largest of their row are set to zero: denormal numbers are slow."""
REACH = 3.0  # norm of ``A t`` up to which Taylor's series of the action is summed at once
CANCELLED = float(np.exp(2 * REACH) / (8 * REACH))
"""Factor, per norm of ``A t``, by which such a series rounds more than a product: its terms grow to
``exp(REACH)`` before they sum to what may be ``exp(-REACH)``."""
FLUSHED = 1e-15  # share of the sizes of all states that is added to each row for the terms cut off
FULL = 500  # entries a row up to which products with a sparse exponential are cheaper than its action
THIN = 1 / 4
"""Share of all entries up to which an exponential counts as sparse: of a fuller one products are slow."""
PROBES = 3  # rows from which it is seen how many entries such an exponential has
OVERHEAD = 20_000  # entries of a sparse matrix that are multiplied while one product is set up
MOST_PARTS = 50_000  # series in a row that one step may take


def exponential(A: Any, h: float) -> Any:
    """``e^{A h}`` of dense matrices (..., n, n), or of a sparse one, dense: a Taylor series, squared."""
    norm = float(np.max(np.asarray(abs(A).sum(axis=-1)), initial=0.0)) * h
    halvings = int(np.clip(np.ceil(np.log2(max(norm, 1e-300))) + 1, 0, 1000))
    part = A * (h / 2.0**halvings)
    out = _series(part) if isinstance(A, np.ndarray) else _series(sparse.csr_matrix(part)).toarray()
    for _ in range(halvings):
        out = flushed(out @ out)
    return out


def _series(X: Any) -> Any:
    """Terms up to the 15th; the norm of X, dense or sparse, is at most 1/2 and the rest below 1e-18."""
    n = X.shape[-1]
    term = total = np.eye(n) if isinstance(X, np.ndarray) else sparse.identity(n, format="csr")
    for k in range(1, 16):
        term = term @ X / k
        total = total + term
    return total


def thin_expm(A: Any, h: float, action: Action, half: Any = None) -> Any:
    """``e^{A h}`` of a sparse matrix, sparse (from the half of h if given); None where its action is cheaper.

    How far waves and diffusion reach in so short a time is seen from some rows moved by the action.
    """
    n, norm = A.shape[0], action.norm * h
    if norm > MOST_PARTS * REACH:
        return None
    probes = np.zeros((PROBES, n))
    probes[np.arange(PROBES), np.random.default_rng(0).integers(n, size=PROBES)] = 1.0
    fill = int(np.count_nonzero(action(probes, h, 1)[-1], axis=-1).max())
    work = _degree(min(norm, REACH)) * max(norm / REACH, 1.0) * (A.nnz + OVERHEAD)
    if fill > min(FULL, THIN * n) or n * fill > work:
        return None
    halvings = 1 if half is not None else max(int(np.ceil(np.log2(max(norm, 1e-300)))) + 2, 0)
    out = half if half is not None else _series(sparse.csr_matrix(A * (h / 2.0**halvings)))
    for _ in range(halvings):
        out = flushed(out @ out)
        out.eliminate_zeros()
    return out


class Action:
    """``e^{M t} v`` for a sparse M and rows v, by Taylor's series about the mean of the diagonal."""

    def __init__(self, M: Any) -> None:
        M = sparse.csr_matrix(M)
        self.shift = float(M.diagonal().mean())
        self.N = M - self.shift * sparse.identity(M.shape[0], format="csr")
        self.norm = float(abs(self.N).sum(axis=0).max())

    def __call__(self, rows: Array, h: float, count: int) -> Array:
        """``e^{M h l} v`` for l = 0..count and every row v of (r, n), shape (count+1, r, n)."""
        norm = h * self.norm
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
            x = out[k]
            for _ in range(parts - 1):
                x = self._series(x, h / parts, np.ones(1))[0]
            out[k + 1 : k + 1 + m] = self._series(x, h * m / parts, np.arange(1, m + 1) / m)
        return np.asarray(flushed(out))

    def _series(self, rows: Array, t: float, shares: Array) -> Array:
        """``e^{M t s} v`` for all shares s in [0, 1] of t and every row v."""
        degree = _degree(self.norm * t)
        terms = np.empty((degree + 1, self.N.shape[0], len(rows)))
        terms[0] = rows.T
        N = self.N * t
        for j in range(1, degree + 1):
            terms[j] = N @ terms[j - 1]
            terms[j] /= j
        weights = shares[:, None] ** np.arange(degree + 1) * np.exp(self.shift * t * shares)[:, None]
        sums: Array = (weights @ terms.reshape(degree + 1, -1)).reshape(len(shares), *terms.shape[1:])
        return np.asarray(np.moveaxis(sums, 2, 1))


def _degree(norm: float) -> int:
    """Terms after which the rest of the series of the exponential of a norm is below 1e-17."""
    term, j = 1.0, 0
    while True:
        j += 1
        term *= norm / j
        if term * norm / (j + 1) <= 5e-18 and norm < (j + 1) / 2:
            return j


def flushed(values: Any) -> Any:
    """The array, entries below `FLUSH` times the largest of their row (last axis) set to zero, in place."""
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


def dense(M: Any) -> Array:
    """The matrix as an array."""
    return M if isinstance(M, np.ndarray) else np.asarray(M.toarray())


def bordered(A: Any, B: Any, corner: Any = None) -> Any:
    """``[[A, B], [0, corner]]`` for a square A, dense or sparse as A is; a corner of zeros by default."""
    block = sparse.csr_matrix((B.shape[1], B.shape[1])) if corner is None else corner
    out: Any = sparse.bmat([[sparse.csr_matrix(A), sparse.csr_matrix(B)], [None, block]], format="csr")
    return out if sparse.issparse(A) else out.toarray()


def scaled(M: Any, s: Array) -> Any:
    """Rows of M, dense or sparse, times numbers s."""
    return M * s[:, None] if isinstance(M, np.ndarray) else sparse.csr_matrix(sparse.diags(s) @ M)
