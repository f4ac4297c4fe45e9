"""Rows carried backwards through a linear system: support functions of its reachable sets.

The support of the set reached at time t in a direction d needs one row only, ``r(t) = d e^{A t}``:

    rho(d, X_t) = rho(r(t), X_0) + int_0^t rho(r(s) B, U) ds

(Le Guernic and Girard 2010). Everything here follows from it and from two facts: a support function
is convex in its row, and a smooth row bends away from its chord over a step h by no more than
``h^2/8`` times its second derivative. So the bounds are of second order in h, on the integral (its
trapezoid from above) and between the nodes alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import expm
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import expm_multiply

from .convex import ConvexSet
from .errors import ReachError
from .systems import LinearSystem

Array = NDArray[np.float64]

SPARSE = 0.1
"""Share of entries below which products with A use its sparse form."""
SMALL_PART = 32
"""Largest independent part whose exponentials are formed on their own."""
ROUNDING = 16 * np.finfo(float).eps
"""Booked relative rounding per step and state, see `docs`; never the error of a method."""


def balance(A: Array) -> Array:
    """Powers of two s that make the rows and columns of ``A[i, j] s[j] / s[i]`` alike, shape (n,)."""
    size = abs(A)
    logs = np.zeros(size.shape[0])
    for _ in range(30):
        s = np.exp2(logs)
        row = np.asarray(size @ s).ravel() / s
        column = np.asarray(size.T @ (1 / s)).ravel() * s
        both = (row > 0) & (column > 0)
        change = np.zeros_like(logs)
        change[both] = np.log2(row[both] / column[both]) / 4
        logs = np.clip(logs + change, -60, 60)
        if np.max(np.abs(change), initial=0.0) < 0.25:
            break
    return np.asarray(np.exp2(np.round(logs)))


class Rows:
    """Rows ``d e^{A t}`` on regular grids, in coordinates in which A is balanced.

    Three ways to carry them, chosen by the structure of A: through the exponentials of its
    independent parts where it falls apart into small ones, through the action of the exponential
    where A is sparse, through the dense exponential otherwise.
    """

    def __init__(self, system: LinearSystem) -> None:
        self.discrete = system.discrete
        self.scale = s = np.ones(system.dim) if system.discrete else balance(system.A)
        A = sparse.csr_matrix(system.A)
        A = sparse.csr_matrix(sparse.diags(1 / s) @ A @ sparse.diags(s))
        self.parts = _parts(A)
        thin = system.sparse or A.nnz < SPARSE * A.shape[0] ** 2
        self.A = A if thin else A.toarray()
        self.AT = sparse.csr_matrix(A.T)
        self.action = system.sparse and self.parts is None
        self._maps: dict[float, Any] = {}
        self._closings: dict[float, Any] = {}

    def map(self, h: float) -> Any:
        """``e^{A h}``; squared from the half of h where that is known."""
        found = self._maps.get(h)
        if found is None:
            half = self._maps.get(h / 2)
            found = self._exponential(self.A, h) if half is None else flushed(half @ half)
            self._maps[h] = found
        return found

    def _exponential(self, A: Any, h: float) -> Any:
        dense = A if isinstance(A, np.ndarray) else A.toarray()
        if self.parts is None:
            return flushed(expm(dense * h) if A is dense else taylor(A, h))
        blocks = expm(dense[self.parts[:, :, None], self.parts[:, None, :]] * h)
        rows, columns = np.broadcast_arrays(self.parts[:, :, None], self.parts[:, None, :])
        return sparse.csr_matrix((blocks.ravel(), (rows.ravel(), columns.ravel())), shape=dense.shape)

    def carry(self, rows: Array, h: float, count: int) -> Array:
        """``rows e^{A h l}`` for l = 0..count, shape (count+1, r, n); rows of shape (r, n)."""
        r, n = rows.shape
        if self.action and not self.discrete:
            trace = float(self.AT.diagonal().sum())
            out = expm_multiply(self.AT, rows.T, 0.0, h * count, count + 1, traceA=trace)
            return np.asarray(flushed(np.ascontiguousarray(np.moveaxis(out, 1, 2))))
        out = np.empty((count + 1, r, n))
        out[0] = rows
        if self.discrete:
            for i in range(count):
                out[i + 1] = times(out[i], self.A)
            return out
        have = 1
        while have <= count:
            more = min(have, count + 1 - have)
            out[have : have + more] = times(out[:more], self.map(h * have))
            have *= 2
        return out

    def closing(self, h: float, vector: Array) -> Array:
        """Bound on ``sup_s |e^{A s}| v`` over [0, h], elementwise, for v >= 0.

        ``|e^{A s}| <= e^{M s}`` with M the absolute values of A off its diagonal and the positive
        part of its diagonal, so that the bound grows with s.
        """
        if h not in self._closings:
            diagonal = self.A.diagonal()
            M = abs(self.A) + sparse.diags(np.maximum(diagonal, 0) - np.abs(diagonal))
            if self.action:
                M, trace = sparse.csr_matrix(M) * h, float(np.maximum(diagonal, 0).sum()) * h
                self._closings[h] = lambda v: expm_multiply(M, v, traceA=trace)
            else:
                growth = self._exponential(np.asarray(M) if isinstance(self.A, np.ndarray) else M, h)
                self._closings[h] = lambda v: growth @ v
        return np.asarray(self._closings[h](vector))


def taylor(A: Any, h: float) -> Array:
    """``e^{A h}`` of a sparse matrix, dense: Taylor's series of a fraction of h, squared.

    The series keeps the entries far from those of A at zero, where Pade's form fills them with
    denormal numbers, which are slow.
    """
    halvings = max(int(np.ceil(np.log2(max(float(abs(A).sum(axis=1).max()) * h, 1e-300)))) + 2, 0)
    part = sparse.csr_matrix(A) * (h / 2.0**halvings)
    term = total = sparse.identity(A.shape[0], format="csr")
    for k in range(1, 15):  # the norm of `part` is at most 1/4: 0.25^15 / 15! < 1e-21
        term = term @ part / k
        total = total + term
    out = total.toarray()
    for _ in range(halvings):
        out = flushed(out @ out)
    return np.asarray(out)


def flushed(values: Any) -> Any:
    """The array with entries below 1e-60 of its largest set to zero, in place (see `ROUNDING`)."""
    data = values if isinstance(values, np.ndarray) else values.data
    size = np.abs(data)
    data[size < 1e-60 * size.max(initial=0.0)] = 0.0
    return values


def _parts(A: Any) -> NDArray[np.intp] | None:
    """Indices of the independent parts of A, shape (p, size), if all have one small size."""
    count, label = connected_components(A, directed=False)
    sizes = np.bincount(label)
    if count == 1 or np.ptp(sizes) or sizes[0] > SMALL_PART:
        return None
    return np.argsort(label, kind="stable").reshape(count, sizes[0])


@dataclass(frozen=True, eq=False)
class Block:
    """Bounds over consecutive steps of one length, for r rows.

    Attributes
    ----------
    rows : ndarray, shape (m+1, r, n)
        ``d e^{A t}`` at the nodes, in the balanced coordinates.
    first : ndarray, shape (m+1, r)
        Support of the initial set at the nodes.
    upper, lower : ndarray, shape (m, p, r)
        What one step adds, for each of p input sets: never less than it can, never more than some
        input attains.
    bow : ndarray, shape (m, r)
        How far the bound between two nodes may exceed the line that joins them, without inputs.
    bend : ndarray, shape (m, p, r)
        The same for each input set.
    size : ndarray, shape (2, m+1, r)
        Sizes of the terms of the support and of one step of the integral, for booking rounding.
    """

    rows: Array
    first: Array
    upper: Array
    lower: Array
    bow: Array
    bend: Array
    size: Array


class Adjoint:
    """Bounds along given rows for one system and one initial set.

    Parameters
    ----------
    system : LinearSystem
    initial : ConvexSet
        Of the dimension of the state, bounded.

    Raises
    ------
    ReachError
        If the dimensions differ or the initial set or an input set is unbounded.
    """

    def __init__(self, system: LinearSystem, initial: ConvexSet) -> None:
        if initial.dim != system.dim:
            raise ReachError(
                f"the initial set has dimension {initial.dim}, the system has {system.dim} states"
            )
        self.system, self.rows = system, Rows(system)
        s = self.rows.scale
        self.initial, self.inputs = initial, system.U
        self.B = system.B / s[:, None] if not hasattr(system.B, "multiply") else _rows_over(system.B, s)
        self.c = system.c / s
        self._x = extent(initial) / s
        self._u = [np.asarray(abs(self.B) @ extent(U)).ravel() + np.abs(self.c) for U in system.U]
        if not self._u and np.any(self.c):
            self._u = [np.abs(self.c)]
        self.pieces = len(self._u)

    def input_support(self, piece: int, rows: Array) -> Array:
        """``sup over u in U of rows (B u + c)``, rows in balanced coordinates."""
        value = rows @ self.c
        if self.inputs:
            value = value + self.inputs[piece].support(times(rows, self.B))
        return np.asarray(value)

    def input_magnitude(self, piece: int, rows: Array) -> Array:
        """``sup over u in U of |rows (B u + c)|``, rows in balanced coordinates."""
        value = np.abs(rows @ self.c)
        if self.inputs:
            value = value + _magnitude(self.inputs[piece], times(rows, self.B))
        return np.asarray(value)

    def block(self, start: Array, h: float, count: int) -> Block:
        """Carry rows (balanced, shape (r, n)) over `count` steps of length h."""
        if self.system.discrete:
            return self._discrete(start, count)
        A, s = self.rows.A, self.rows.scale
        R = self.rows.carry(start, h, count)
        first = self.initial.support(R / s)
        R1 = times(R, A)
        R2 = times(R1, A)
        R4 = np.abs(times(times(R2, A), A)[:-1])
        p2 = _ends(_magnitude(self.initial, R2 / s)) + h**2 / 8 * (R4 @ self.rows.closing(h, self._x))
        shape = (count, self.pieces, R.shape[1])
        upper, lower, bend = np.empty(shape), np.empty(shape), np.empty(shape)
        for i, reach in enumerate(self._u):
            value = self.input_support(i, R)
            q2 = _ends(self.input_magnitude(i, R2)) + h**2 / 8 * (R4 @ self.rows.closing(h, reach))
            q1 = _ends(self.input_magnitude(i, R1)) + h / 2 * q2
            rest = h**3 / 12 * q2
            upper[:, i] = h / 2 * (value[:-1] + value[1:]) + rest
            lower[:, i] = h * self.input_support(i, (R[:-1] + R[1:]) / 2) - rest
            bend[:, i] = h**2 / 8 * q1
        return Block(R, first, upper, lower, h**2 / 8 * p2, bend, self._size(R, h))

    def _discrete(self, start: Array, count: int) -> Block:
        R = self.rows.carry(start, 1.0, count)
        shape = (count, self.pieces, R.shape[1])
        upper = np.empty(shape)
        for i in range(self.pieces):
            upper[:, i] = self.input_support(i, R[:-1])
        none = np.zeros((count, R.shape[1]))
        return Block(R, self.initial.support(R), upper, upper, none, np.zeros(shape), self._size(R, 1.0))

    def _size(self, R: Array, h: float) -> Array:
        absolute, most = np.abs(R), sum(self._u, np.zeros_like(self._x))
        return np.stack([absolute @ self._x, h * (absolute @ most)])


def _magnitude(body: ConvexSet, rows: Array) -> Array:
    """``sup |d x|`` over a set."""
    return np.maximum(body.support(rows), body.support(-rows))


def extent(body: ConvexSet) -> Array:
    """Largest absolute value of every coordinate over a set, shape (n,)."""
    hull = body.interval_hull()
    out = np.maximum(np.abs(hull.lo), np.abs(hull.hi))
    if not np.all(np.isfinite(out)):
        raise ReachError("a set is not bounded")
    return np.asarray(out)


def _ends(values: Array) -> Array:
    return np.maximum(values[:-1], values[1:])


def times(rows: Array, M: Any) -> Array:
    """``rows @ M`` for rows (..., n) and M dense or sparse."""
    flat = rows.reshape(-1, rows.shape[-1])
    out = flat @ M if isinstance(M, np.ndarray) else np.asarray((M.T @ flat.T).T)
    return out.reshape(*rows.shape[:-1], M.shape[1])


def _rows_over(M: Any, s: Array) -> Any:
    return sparse.csr_matrix(sparse.diags(1 / s) @ M)
