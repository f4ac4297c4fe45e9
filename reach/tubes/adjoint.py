"""Bounds on the effect of a linear system's inputs along rows carried backwards, step by step.

The support of the set reached at time t in a direction d needs one row only, ``r(t) = d e^{A t}``:

    rho(d, X_t) = rho(r(t), X_0) + int_0^t rho(r(s) B, U) ds

(Le Guernic and Girard 2010). Everything here follows from it and from two facts: a support function
is convex in its row, and a smooth row departs from its chord over a step h by no more than
``h^2/8`` times its second derivative. So the bounds are of second order in h, on the integral (its
trapezoid from above) and between the nodes alike.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import sparse

from ..numerics.checks import Array, require_single
from ..numerics.errors import ReachError, Unresolved
from ..numerics.exponentials import FLUSHED, bordered, scaled, times
from ..sets.convex import ConvexSet
from ..sets.interval import Interval
from ..sets.lazy import AffineImage
from ..sets.stacks import Generated
from .rows import ExponentialRows
from .systems import LinearSystem

SMALL = 2000  # entries that a product with a sparse input map must save to be worth it


class Overflow(Unresolved):
    """A bound is too large for floating point."""


@dataclass(frozen=True, eq=False)
class Block:
    """Bounds over m steps of one length, for r rows and p input sets; rounding is not included yet."""

    rows: Array  # d e^{A t} at the nodes in the balanced coordinates, (m+1, r, n)
    first: Array  # support of the initial set at the nodes, (m+1, r)
    attained: Array  # what one of its points attains there, (m+1, r)
    upper: Array  # what one step adds for each input set, never less than it can, (m, p, r)
    lower: Array  # never more than some input attains, (m, p, r)
    intersample: Array  # how far the bound exceeds the line between two nodes, without inputs, (m, r)
    bend: Array  # the same for each input set, (m, p, r)
    size: Array  # sizes of the terms of the support, and of the rate of its integral, (2, m+1, r)


class Adjoint:
    """Bounds along given rows for one system and one initial set; the sets must be bounded."""

    def __init__(self, system: LinearSystem, initial: ConvexSet) -> None:
        require_single("the initial set", initial, system.dim)
        self.system, self.rows = system, ExponentialRows(system)
        A, s = self.rows.A, self.rows.scale
        self.initial, self.inputs = initial, system.U
        self.input_pieces = max(len(system.U), int(np.any(system.c)))
        self._A2 = A @ A if isinstance(A, np.ndarray) else None
        B, c = scaled(system.B, 1 / s), system.c / s
        thin = not isinstance(B, np.ndarray) and B.nnz < min(np.prod(B.shape) / 4, np.prod(B.shape) - SMALL)
        B = B if thin or isinstance(B, np.ndarray) else B.toarray()
        sizes = [extent("the initial set", initial) / s]
        sizes += [abs(B) @ extent("an input set", U) + np.abs(c) for U in system.U]
        sizes += [np.abs(c)] if self.input_pieces > len(system.U) else []
        # [B c], A [B c], A^2 [B c] side by side: one product along many rows.
        force = [sparse.hstack([B, c[:, None]], format="csr") if thin else np.hstack([B, c[:, None]])]
        force += [A @ force[0], A @ (A @ force[0])]
        self._force = sparse.hstack(force, format="csr") if thin else np.hstack(force)
        self._sizes = np.stack(sizes, axis=1)
        self._grown: dict[float, Array] = {}
        self.watch([])

    def watch(self, lags: list[float], driven: Array | float = 0.0) -> None:
        """Weigh rounding by the sizes that states, `driven` by a nominal input, grow to after some lags."""
        states = self._sizes[:, 0] + driven / self.rows.scale
        sizes = np.stack([states, self._sizes[:, 1:].sum(axis=1)], axis=1)
        self.weights = self.rows.weights(lags, self.rows.weights(lags, sizes))

    def row_products(self, rows: Array) -> Array:
        """``rows A^k [B c]`` for k = 0, 1, 2, shape (3, ..., m+1); rows in balanced coordinates."""
        products = times(rows, self._force)
        return np.moveaxis(products.reshape(*rows.shape[:-1], 3, -1), -2, 0)

    def supports(self, piece: int, along: Array, attained: bool = False) -> Array:
        """``sup over u in U of b u + c`` for rows ``[b c]``, or the value of some u."""
        return driven_support(self.inputs[piece] if self.inputs else None, along, attained)

    def magnitudes(self, piece: int, along: Array) -> Array:
        """``sup over u in U of |b u + c|`` for rows ``[b c]``."""
        if not self.inputs:
            return np.asarray(np.abs(along[..., -1]))
        return np.asarray(_magnitude(self.inputs[piece], along[..., :-1], along[..., -1]))

    def values(self, rows: Array) -> tuple[Array, Array]:
        """Largest absolute values along rows (m, r, n): of the first part, and the rate of inputs, (m, r)."""
        rate, along = np.zeros(rows.shape[:2]), self.row_products(rows)[0]
        for i in range(self.input_pieces):
            rate += self.magnitudes(i, along)
        return _magnitude(self.initial, rows / self.rows.scale), rate

    def sizes(self, rows: Array, h: float) -> tuple[Array, Array]:
        """Largest absolute values over a block: of the first part, and about the inputs' addition, (r,)."""
        first, rate = self.values(rows)
        return first.max(axis=0), h * np.minimum(rate[1:], rate[:-1]).sum(axis=0)

    def block(self, start: Array, h: float, count: int) -> Block:
        """Carry rows (balanced, shape (r, n)) over `count` steps of length h; may be an `Overflow`."""
        with np.errstate(over="ignore", invalid="ignore"):
            return self._block(self.rows.carry(start, h, count), h, count)

    def _block(self, R: Array, h: float, count: int) -> Block:
        """Bounds along rows at nodes, shape (count+1, r, n); not finite where anything overflows."""
        unscaled = R / self.rows.scale
        _in_range(R, unscaled)
        first = supported(self.initial, unscaled)
        attained = attained_support(self.initial, unscaled, first)
        size = np.moveaxis(times(np.abs(R), self.weights + FLUSHED * self.weights.sum(axis=0)), -1, 0)
        shape = (count, self.input_pieces, R.shape[1])
        upper, lower, bend = np.empty(shape), np.empty(shape), np.zeros(shape)
        if self.system.discrete:
            along = self.row_products(R[:-1])[0]
            for i in range(self.input_pieces):
                upper[:, i] = self.supports(i, along)
                lower[:, i] = self.supports(i, along, attained=True)
            return Block(R, first, attained, upper, lower, np.zeros((count, R.shape[1])), bend, size)
        R2 = self._curved(R)
        if h not in self._grown:
            self._grown[h] = self.rows.closing(h, self._sizes)
        closing = times(np.abs(self._curved(R2)[:-1]), self._grown[h])
        closing = h**2 / 8 * np.where(np.isnan(closing), np.inf, closing)
        R2 = R2 / self.rows.scale
        along = self.row_products(R) if self.input_pieces else R
        _in_range(R2, along)
        p2 = _ends(_magnitude(self.initial, R2)) + closing[..., 0]
        for i in range(self.input_pieces):
            value = self.supports(i, along[0])
            q2 = _ends(self.magnitudes(i, along[2])) + closing[..., 1 + i]
            q1 = _ends(self.magnitudes(i, along[1])) + h / 2 * q2
            remainder = h**3 / 12 * q2
            upper[:, i] = h / 2 * (value[:-1] + value[1:]) + remainder
            lower[:, i] = h * self.supports(i, (along[0, :-1] + along[0, 1:]) / 2, attained=True) - remainder
            bend[:, i] = h**2 / 8 * q1
        return Block(R, first, attained, upper, lower, h**2 / 8 * p2, bend, size)

    def _curved(self, rows: Array) -> Array:
        """``rows A^2``, the second derivative."""
        if self._A2 is not None:
            return times(rows, self._A2)
        return times(times(rows, self.rows.A), self.rows.A)


def is_symmetric(body: ConvexSet) -> bool:
    """Return True if a set is known to be symmetric about its centre."""
    return isinstance(body, Interval | Generated)


def attained_support(body: Any, rows: Array, support: Array) -> Array:
    """Return the support proved to be attained: a lower bound where `support` is an upper one."""
    return support if is_symmetric(body) or not hasattr(body, "support_down") else body.support_down(rows)


def driven_support(U: Any, along: Array, attained: bool = False) -> Array:
    """``sup over u in U of b u + c`` for rows ``[b c]``, or the value of some u; c where there is no U."""
    value, rows = along[..., -1], along[..., :-1]
    if U is not None:
        support = supported(U, rows)
        value = value + (attained_support(U, rows, support) if attained else support)
    return np.asarray(value)


def supported(body: Any, rows: Array) -> Array:
    """Support along rows (..., n), all at once: products of one large matrix are much faster."""
    return np.asarray(body.support(rows.reshape(-1, rows.shape[-1])).reshape(rows.shape[:-1]))


def _magnitude(body: ConvexSet, rows: Array, shift: Array | float = 0.0) -> Array:
    """``sup |d x + shift|`` over a set."""
    if is_symmetric(body):
        middle = times(rows, body.center[:, None])[..., 0]
        return np.asarray(np.abs(middle + shift) + (supported(body, rows) - middle))
    return np.maximum(supported(body, rows) + shift, supported(body, -rows) - shift)


def extent(name: str, body: ConvexSet) -> Array:
    """Largest absolute value of every coordinate over a set, shape (n,)."""
    try:
        hull = body.interval_hull()
    except ReachError as exc:
        raise ReachError(f"{name} must be bounded and not empty: {exc}") from None
    return np.asarray(np.maximum(np.abs(hull.lo), np.abs(hull.hi)))


def _in_range(*numbers: Array) -> None:
    if not all(np.all(np.isfinite(values)) for values in numbers):
        raise Overflow("the response grows beyond floating point")


def _ends(values: Array) -> Array:
    return np.maximum(values[:-1], values[1:])


def augmented(system: LinearSystem, start: Any) -> tuple[LinearSystem, Any]:
    """The system with its drift and its input's centre as one more state, constantly 1, and the set likewise.

    Of an input that changes its set only the drift is moved; what is left of the input varies about 0.
    """
    require_single("the initial set", start, system.dim)
    inputs, drift = system.U, system.c
    if len(inputs) == 1:
        try:
            middle = inputs[0].center
        except ReachError as exc:
            raise ReachError(f"an input set must be bounded and not empty: {exc}") from None
        drift = drift + np.asarray(system.B @ middle).ravel()
        inputs = (inputs[0] + (-middle),) if np.any(middle) else inputs
    if not np.any(drift):
        return replace(system, U=inputs or None, c=None), start
    n, m = system.dim, system.inputs
    A = bordered(system.A, drift[:, None], [[1.0 if system.discrete else 0.0]])
    B: Any = sparse.vstack([sparse.csr_matrix(system.B), sparse.csr_matrix((1, m))])
    extended = replace(system, A=A, B=B if system.sparse else B.toarray(), U=inputs or None, c=None)
    if isinstance(start, Interval):
        return extended, Interval(np.r_[start.lo, 1.0], np.r_[start.hi, 1.0])
    if isinstance(start, Generated):
        c, G = start.arrays
        return extended, type(start)(np.r_[c, 1.0], np.vstack([G, np.zeros((1, G.shape[1]))]))
    return extended, AffineImage(np.eye(n + 1, n), start, np.eye(n + 1)[n])
