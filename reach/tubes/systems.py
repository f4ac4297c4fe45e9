"""Linear systems with uncertain inputs: the subject of all tubes of this library."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from ..numerics.checks import Array, as_array, as_numbers, finite_fields, require_single
from ..numerics.errors import ReachError
from ..numerics.exponentials import bordered
from ..short_repr import short_repr

FILLED = 0.25  # share of entries from which a matrix in a sparse container is handled as a dense one
FILLED_MOST = 1000  # most states for which it is: beyond, exponentials cost more than they save


@short_repr
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

    @property
    def jumps(self) -> Array:
        """Times at which the value jumps, shape (j,)."""
        changed = np.any(np.diff(self.values, axis=0), axis=1)
        return np.asarray(self.times[1:][(np.diff(self.times) == 0) & changed])

    def slope(self, t: ArrayLike) -> Array:
        """Slopes at given times, those to the right at a knot, shape (len(t), m)."""
        length = np.diff(self.times)
        rise = np.diff(self.values, axis=0)
        inner = np.divide(rise, length[:, None], out=np.zeros_like(rise), where=length[:, None] > 0)
        slopes = np.vstack([np.zeros((1, self.dim)), inner, np.zeros((1, self.dim))])
        at = np.searchsorted(self.times, np.atleast_1d(as_numbers("t", t)), side="right")
        return np.asarray(slopes[at])


def _require_pairs(t: Array, values: Array) -> None:
    if t.ndim != 1 or len(t) == 0 or values.ndim != 2 or len(values) != len(t):
        raise ReachError(f"a signal needs times (k,) and values (k, m), got {t.shape} and {values.shape}")


@short_repr
@dataclass(frozen=True, eq=False)
class LinearSystem:
    """``x' = A x + B (u_0(t) + u) + c`` with an unknown input ``u(t)`` in U at every instant.

    With ``discrete=True`` the same letters mean ``x+ = A x + B (u_0 + u) + c``.

    Parameters
    ----------
    A : array_like or scipy sparse matrix, shape (n, n)
        A sparse matrix stays sparse, and above 300 states no exponential is formed of it; one of up to
        1,000 states with a quarter of all entries or more is made dense.
    B : array_like or scipy sparse matrix, shape (n, m), optional
        Input map; the identity if only U is given.
    U : ConvexSet of dimension m, or sequence of them, optional
        Set of the input, which may change arbitrarily (measurably) within it. A sequence gives one
        set per piece of time, see `breaks`.
    c : array_like, shape (n,), optional
        Constant drift.
    breaks : array_like, shape (p-1,), optional
        Times at which the set of the input changes from one piece to the next, for p sets.
    discrete : bool
    nominal : Signal, optional
        Known part ``u_0(t)`` of the input, of dimension m; nothing if not given.

    Raises
    ------
    ReachError
        If a shape does not fit, a number is not finite, or the pieces and breaks do not match.
    """

    A: Any
    B: Any = None
    U: Any = None
    c: Any = None
    breaks: Any = ()
    discrete: bool = False
    nominal: Signal | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.discrete, bool | np.bool_):
            raise ReachError(f"discrete must be true or false, got {self.discrete!r}")
        if self.nominal is not None and not isinstance(self.nominal, Signal):
            raise ReachError(f"nominal must be a Signal, got {type(self.nominal).__name__}")
        A = _matrix("A", self.A)
        n = A.shape[0]
        if A.shape != (n, n) or n == 0:
            raise ReachError(f"A must be square, got shape {A.shape}")
        if sparse.issparse(A) and n <= FILLED_MOST and A.nnz >= FILLED * n**2:
            A = A.toarray()
        pieces = () if self.U is None else tuple(self.U) if isinstance(self.U, list | tuple) else (self.U,)
        for U in pieces:
            require_single("U", U)
        B, driven = self.B, pieces or self.nominal is not None
        if B is None:
            B = np.eye(n) if driven and not sparse.issparse(A) else sparse.identity(n, format="csr")
            B = B if driven else np.zeros((n, 0))
        B = _matrix("B", B)
        if B.shape[0] != n:
            raise ReachError(f"B must have {n} rows as A has, got shape {B.shape}")
        if B.shape[1] and not driven:
            raise ReachError("B is given without U, the set of its input, or a nominal input")
        if self.nominal is not None and self.nominal.dim != B.shape[1]:
            expected = f"{B.shape[1]}, the columns of B"
            raise ReachError(f"nominal must have dimension {expected}, got {self.nominal.dim}")
        for U in pieces:
            require_single("U", U, B.shape[1])
        c = np.zeros(n) if self.c is None else as_array("c", self.c, n)
        breaks, count = as_numbers("breaks", self.breaks), max(len(pieces) - 1, 0)
        increasing = np.diff(breaks, prepend=0.0) > 0 if breaks.shape == (count,) else np.zeros(1)
        if not (np.all(increasing) and np.all(np.isfinite(breaks))):
            rule = f"{len(pieces)} input sets need {count} breaks, positive and increasing"
            raise ReachError(f"{rule}, got {self.breaks!r}")
        if self.discrete and np.any(breaks != np.round(breaks)):
            raise ReachError(f"the breaks of a discrete system must be whole numbers, got {self.breaks!r}")
        for name, value in (("A", A), ("B", B), ("U", pieces), ("c", c), ("breaks", breaks)):
            object.__setattr__(self, name, value)

    @property
    def dim(self) -> int:
        """Number n of states."""
        return int(self.A.shape[0])

    @property
    def inputs(self) -> int:
        """Number m of inputs."""
        return int(self.B.shape[1])

    @property
    def sparse(self) -> bool:
        """True if A is kept sparse."""
        return bool(sparse.issparse(self.A))

    def holding_inputs(self) -> LinearSystem:
        """The system whose state is ``(x, u)``, for an input that is unknown but constant.

        Its initial set is the product of the initial set of x and of U, ``X.product(U)``.
        """
        m = self.inputs
        if len(self.U) != 1 or m == 0:
            raise ReachError(f"an input can be constant only if it has one set, got {len(self.U)}")
        A = bordered(self.A, self.B, sparse.identity(m) if self.discrete else None)
        drift, B = np.r_[self.c, np.zeros(m)], None
        if self.nominal is not None:
            B = sparse.vstack([self.B, sparse.csr_matrix((m, m))], format="csr")
            B = B if self.sparse else B.toarray()
        return LinearSystem(A, B, c=drift, discrete=self.discrete, nominal=self.nominal)


def _matrix(name: str, value: ArrayLike) -> Any:
    """A dense float array or a CSR matrix, two-dimensional and finite."""
    if sparse.issparse(value):
        matrix: Any = sparse.csr_matrix(value, dtype=float)
        entries = matrix.data
    else:
        matrix = entries = as_numbers(name, value)
    if matrix.ndim != 2:
        raise ReachError(f"{name} must be a matrix, got shape {matrix.shape}")
    if not np.all(np.isfinite(entries)):
        raise ReachError(f"{name} has entries that are not finite numbers")
    return matrix
