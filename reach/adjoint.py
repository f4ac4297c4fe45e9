"""Bounds on what a linear system adds along rows carried backwards, step by step.

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

from .convex import ConvexSet
from .ellipsoid import Ellipsoid
from .errors import ReachError
from .interval import Interval
from .rows import Rows, times
from .systems import LinearSystem, single_set
from .zonotope import Zonotope

Array = NDArray[np.float64]


class Overflow(ReachError):
    """A bound is too large for floating point."""


@dataclass(frozen=True, eq=False)
class Block:
    """Bounds over consecutive steps of one length, for r rows.

    Attributes
    ----------
    rows : ndarray, shape (m+1, r, n)
        ``d e^{A t}`` at the nodes, in the balanced coordinates.
    first, attained : ndarray, shape (m+1, r)
        Support of the initial set at the nodes, and what one of its points attains.
    upper, lower : ndarray, shape (m, p, r)
        What one step adds, for each of p input sets: never less than it can, never more than some
        input attains.
    bow : ndarray, shape (m, r)
        How far the bound between two nodes may exceed the line that joins them, without inputs.
    bend : ndarray, shape (m, p, r)
        The same for each input set.
    size : ndarray, shape (2, m+1, r)
        Sizes of the terms of the support and of the rate of its integral, for booking rounding.
    """

    rows: Array
    first: Array
    attained: Array
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
        single_set("the initial set", initial)
        if initial.dim != system.dim:
            raise ReachError(
                f"the initial set has dimension {initial.dim}, the system has {system.dim} states"
            )
        self.system, self.rows = system, Rows(system)
        A, s = self.rows.A, self.rows.scale
        self.initial, self._shrink = _scaled(initial, s)
        self.inputs, self.pieces = system.U, max(len(system.U), int(np.any(system.c)))
        self._A2 = A @ A if isinstance(A, np.ndarray) else None
        B = sparse.csr_matrix(sparse.diags(1 / s) @ system.B)
        self._B, self._c = [B if B.nnz < B.shape[0] * B.shape[1] / 4 else B.toarray()], [system.c / s]
        for _ in range(2):
            self._B.append(A @ self._B[-1])
            self._c.append(A @ self._c[-1])
        sizes = [extent("the initial set", initial) / s]
        sizes += [abs(self._B[0]) @ extent("an input set", U) + np.abs(self._c[0]) for U in system.U]
        sizes += [np.abs(self._c[0])] if self.pieces > len(system.U) else []
        self._sizes = np.stack(sizes, axis=1)
        self.weights = self._weighed([], 0.0)

    def watch(self, lags: list[float], moved: Array | float = 0.0) -> None:
        """Weigh rounding by the sizes that states grow to after some lags (see `Rows.lags`).

        `moved` are the sizes that a nominal input brings them to.
        """
        self.weights = self._weighed(lags, moved)

    def _weighed(self, lags: list[float], moved: Array | float) -> Array:
        states = self._sizes[:, 0] + moved / self.rows.scale
        both = np.stack([states, self._sizes[:, 1:].sum(axis=1)], axis=1)
        return self.rows.weights(lags, self.rows.weights(lags, both))

    def supports(self, piece: int, rows: Array, attained: bool = False) -> Array:
        """``sup over u in U of rows (B u + c)``, or what some u attains; rows in balanced coordinates."""
        value = rows @ self._c[0]
        if self.inputs:
            along, U = times(rows, self._B[0]), self.inputs[piece]
            support = U.support(along)
            value = value + (attained_support(U, along, support) if attained else support)
        return np.asarray(value)

    def magnitudes(self, piece: int, rows: Array, order: int) -> Array:
        """``sup over u in U of |rows A^order (B u + c)|``, rows in balanced coordinates."""
        middle = rows @ self._c[order]
        if not self.inputs:
            return np.asarray(np.abs(middle))
        return np.asarray(_magnitude(self.inputs[piece], times(rows, self._B[order]), middle))

    def sizes(self, rows: Array, h: float) -> tuple[Array, Array]:
        """Largest absolute values over a block: of the first part, and about what the inputs add, (r,)."""
        rate = np.zeros(rows.shape[:2])
        for i in range(self.pieces):
            rate += self.magnitudes(i, rows, 0)
        gained = h * np.minimum(rate[1:], rate[:-1]).sum(axis=0)
        return _magnitude(self.initial, rows / self._shrink).max(axis=0), gained

    def block(self, start: Array, h: float, count: int) -> Block:
        """Carry rows (balanced, shape (r, n)) over `count` steps of length h.

        Raises
        ------
        Overflow
            If a row is too large for floating point.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            R = self.rows.carry(start, h, count)
        if not np.all(np.isfinite(R)):
            raise Overflow(f"the response grows beyond floating point within {count} steps of {h:g}")
        first = self.initial.support(R / self._shrink)
        attained = attained_support(self.initial, R / self._shrink, first)
        size = np.moveaxis(np.abs(R) @ self.weights, -1, 0)
        size = size + 1e-40 * np.abs(R).max(axis=-1) * self.weights.sum(axis=0)[:, None, None]
        shape = (count, self.pieces, R.shape[1])
        upper, lower, bend = np.empty(shape), np.empty(shape), np.zeros(shape)
        if self.system.discrete:
            for i in range(self.pieces):
                upper[:, i] = self.supports(i, R[:-1])
                lower[:, i] = self.supports(i, R[:-1], attained=True)
            return Block(R, first, attained, upper, lower, np.zeros((count, R.shape[1])), bend, size)
        R2 = self._curved(R)
        with np.errstate(over="ignore", invalid="ignore"):
            closing = np.abs(self._curved(R2)[:-1]) @ self.rows.closing(h, self._sizes)
            closing = h**2 / 8 * np.where(np.isnan(closing), np.inf, closing)
        p2 = _ends(_magnitude(self.initial, R2 / self._shrink)) + closing[..., 0]
        for i in range(self.pieces):
            value = self.supports(i, R)
            q2 = _ends(self.magnitudes(i, R, 2)) + closing[..., 1 + i]
            q1 = _ends(self.magnitudes(i, R, 1)) + h / 2 * q2
            rest = h**3 / 12 * q2
            upper[:, i] = h / 2 * (value[:-1] + value[1:]) + rest
            lower[:, i] = h * self.supports(i, (R[:-1] + R[1:]) / 2, attained=True) - rest
            bend[:, i] = h**2 / 8 * q1
        return Block(R, first, attained, upper, lower, h**2 / 8 * p2, bend, size)

    def _curved(self, rows: Array) -> Array:
        """``rows A^2``, the second derivative."""
        if self._A2 is not None:
            return times(rows, self._A2)
        return times(times(rows, self.rows.A), self.rows.A)


def _scaled(body: ConvexSet, s: Array) -> tuple[Any, Array | float]:
    """The set in coordinates divided by powers of two, or the set itself and what to divide rows by."""
    if isinstance(body, Interval):
        return Interval(body.lo / s, body.hi / s), 1.0
    if isinstance(body, Zonotope):
        return Zonotope(body.c / s, body.G / s[:, None]), 1.0
    if isinstance(body, Ellipsoid):
        return Ellipsoid(body.c / s, body.L / s[:, None]), 1.0
    return body, s


def is_symmetric(body: ConvexSet) -> bool:
    """Whether a set is known to be symmetric about its centre."""
    return isinstance(body, Interval | Zonotope | Ellipsoid)


def attained_support(body: Any, rows: Array, support: Array) -> Array:
    """What is proved to be attained, where the support is found by a program and is an upper bound."""
    return support if is_symmetric(body) or not hasattr(body, "support_down") else body.support_down(rows)


def _magnitude(body: ConvexSet, rows: Array, shift: Array | float = 0.0) -> Array:
    """``sup |d x + shift|`` over a set."""
    if is_symmetric(body):
        middle = rows @ body.center
        return np.asarray(np.abs(middle + shift) + (body.support(rows) - middle))
    return np.maximum(body.support(rows) + shift, body.support(-rows) - shift)


def extent(name: str, body: ConvexSet) -> Array:
    """Largest absolute value of every coordinate over a set, shape (n,)."""
    try:
        hull = body.interval_hull()
    except ReachError as exc:
        raise ReachError(f"{name} must be bounded and not empty: {exc}") from None
    return np.asarray(np.maximum(np.abs(hull.lo), np.abs(hull.hi)))


def _ends(values: Array) -> Array:
    return np.maximum(values[:-1], values[1:])
