"""Channels through which uncertainty enters a loop, and their effect along rows of its state."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from reach.numerics.linear import discretize, growth

Array = NDArray[np.float64]
Share = Callable[[Array], Array]
"""Half-widths of a box (..., k) under bounds on the size of commands (..., m)."""


@dataclass(frozen=True, eq=False)
class Channel:
    """Uncertain input of a loop, within a set V in every period.

    Attributes
    ----------
    name : str
        Source, as reports name it.
    size : ndarray, shape (k,), or (1,) for a ball
        Half-widths of the box V, or the radius of the ball V. Where `share` is given it is added to that.
    rate : ndarray, shape (n, k), optional
        Enters the rate of the plant's states, measurable within the period.
    sample : ndarray, shape (N, k), optional
        One value per period, added to the next loop state.
    noise : ndarray, shape (n, k), optional
        The same value, as it is added to the error that the law sees.
    push : ndarray, shape (m, k), optional
        The same value, as it is added to the input of the period. The flight computer does not know of it.
    ball : bool
        V is a ball in the 2-norm instead of a box.
    share : callable, optional
        Part of the half-widths that grows with the size of the commands.
    lag : int
        For how many periods a command counts in `share`: the largest of that many and of the period's own.
    constant : ndarray, shape (k,), optional
        Part of the half-widths `size` of a box that is one value for the whole flight.
    """

    name: str
    size: Array
    rate: Array | None = None
    sample: Array | None = None
    noise: Array | None = None
    push: Array | None = None
    ball: bool = False
    share: Share | None = None
    lag: int = 0
    constant: Array | None = None


def row_integral(rows: Array, A: Array, M: Array, h: float, part: tuple[float, float], ball: bool) -> Array:
    """Bound ``int norm(row e^{A (h - s)} M) ds`` over a part of a period: (..., k), or (..., 1) for a ball.

    Column by column, or of all columns together for a ball. The trapezoid rule, and ``d^3/12`` times a bound
    on the second derivative: the norm of a smooth function is at most that of its chord plus the remainder.
    """
    a, b = part
    last, length = discretize(A, M, h - b)[0], b - a
    first = discretize(A, M, length)[0] @ last  # from the start of the part to the end of the period
    curvature = np.abs(rows @ last @ A @ A) @ growth(A, length) @ np.abs(M)
    ends = norms(rows @ first @ M, ball) + norms(rows @ last @ M, ball)
    return np.asarray(length / 2 * ends + length**3 / 12 * norms(curvature, ball))


def norms(gains: Array, ball: bool) -> Array:
    """Return norms of gains (..., k): column by column, or for a ball of all columns, (..., 1)."""
    return np.linalg.norm(gains, axis=-1, keepdims=True) if ball else np.abs(gains)
