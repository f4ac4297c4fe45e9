"""Matrices that vary in time, with bounds on how fast."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..numerics.checks import Array, as_array, as_numbers, check_fields
from ..numerics.errors import ReachError

Bound = ArrayLike | Callable[[float, float], ArrayLike] | None

CONSISTENT = 1e-6
"""Share by which values may break a bound on their derivatives before this is said (rounding)."""


@dataclass(frozen=True, eq=False)
class Varying:
    """A matrix or vector as a function of time, with elementwise bounds on its derivatives.

    Parameters
    ----------
    value : callable
        ``value(t)`` is the matrix at time t.
    slope : array_like or callable, optional
        Bound on the absolute value of the first derivative: for all times, or ``slope(a, b)`` over
        the interval from a to b.
    bend : array_like or callable, optional
        The same for the second derivative. With it tubes are of second order in the step, with
        the first alone of first order.

    Raises
    ------
    ReachError
        If neither bound is given.
    """

    value: Callable[[float], ArrayLike]
    slope: Bound = None
    bend: Bound = None

    def __post_init__(self) -> None:
        check_fields(self)
        if self.slope is None and self.bend is None:
            raise ReachError("a matrix that varies needs a bound on its first or second derivative")


@dataclass(frozen=True, eq=False)
class Sampled:
    """A varying matrix over K steps of length h, compared with the chord between two nodes."""

    nodes: Array  # values, (K+1, p, q)
    chord: Array  # slope of the chord, (K, p, q)
    off: Array  # largest distance from the chord, (K, p, q)
    area: Array  # integral of that distance over the step, (K, p, q)
    rate: Array  # largest absolute value of the derivative, (K, p, q)
    swing: Array  # largest distance of the derivative from the slope of the chord, (K, p, q)

    @property
    def middle(self) -> Array:
        """Mean of the values at both ends of every step, shape (K, p, q)."""
        return np.asarray((self.nodes[1:] + self.nodes[:-1]) / 2)

    @property
    def most(self) -> Array:
        """Largest absolute value in every step, shape (K, p, q)."""
        return np.maximum(np.abs(self.nodes[1:]), np.abs(self.nodes[:-1])) + self.off


def sample(name: str, M: Any, shape: tuple[int, ...], times: Array) -> Sampled:
    """Evaluate a constant or varying matrix, vectors as one column; its bounds must hold at the nodes."""
    column = (*shape, 1)[:2]
    h, count = np.diff(times), len(times)
    if not isinstance(M, Varying):
        value = as_array(name, M, *shape).reshape(column)
        zero = np.zeros((count - 1, *column))
        return Sampled(np.tile(value, (count, 1, 1)), zero, zero, zero, zero, zero)
    with np.errstate(all="ignore"):  # what is not finite is refused with its name and time
        values = [M.value(float(t)) for t in times]
    named = zip(values, times, strict=True)
    nodes = np.stack([as_array(f"{name}({t:g})", value, *shape).reshape(column) for value, t in named])
    step = h[:, None, None]
    chord = np.diff(nodes, axis=0) / step
    slope = _bound(f"slope of {name}", M.slope, shape, times).reshape(count - 1, *column)
    bend = _bound(f"bend of {name}", M.bend, shape, times).reshape(count - 1, *column)
    noise = 16 * np.finfo(float).eps * np.abs(nodes).max(axis=0)
    _consistent(f"slope of {name}", np.abs(chord) - noise / step, slope)
    if count > 2:
        # The second difference is a mean of the second derivative over two steps.
        second = np.abs(np.diff(chord, axis=0)) - 4 * noise / step[:-1]
        _consistent(f"bend of {name}", second / step[:-1], np.maximum(bend[1:], bend[:-1]))
    return Sampled(
        nodes,
        chord,
        np.minimum(step / 2 * slope, step**2 / 8 * bend),
        np.minimum(step**2 / 3 * slope, step**3 / 12 * bend),
        np.minimum(slope, np.abs(chord) + step / 2 * bend),
        np.minimum(slope + np.abs(chord), step / 2 * bend),
    )


def _bound(name: str, bound: Bound, shape: tuple[int, ...], times: Array) -> Array:
    if bound is None:
        return np.full((len(times) - 1, *shape), np.inf)
    over = bound if callable(bound) else lambda a, b: bound
    found = [as_numbers(name, over(float(a), float(b))) for a, b in zip(times[:-1], times[1:], strict=True)]
    for values in found:
        if values.shape != shape or not np.all(values >= 0):
            raise ReachError(f"the {name} must be >= 0 and of shape {shape}, got {values!r}")
    return np.stack(found)


def _consistent(name: str, seen: Array, bound: Array) -> None:
    if np.any(seen > bound * (1 + CONSISTENT)):
        k, i, j = np.unravel_index(np.argmax(seen - bound * (1 + CONSISTENT)), seen.shape)
        given = f"values change by {seen[k, i, j]:g} in entry ({i}, {j}) of step {k}"
        raise ReachError(f"the bound on the {name} is too small: {given}, the bound is {bound[k, i, j]:g}")
