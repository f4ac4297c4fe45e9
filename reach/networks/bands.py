"""Activations of a network, each with the affine band that holds it over an interval.

``|f(y) - (slope y + offset)| <= radius`` for every y in [lo, hi]. A band may have any slope; that of the
secant is taken, and what is left, ``f(y) - slope y``, has its extremes at the ends of the interval, at kinks,
and where ``f' = slope``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..numerics.checks import Array, check_fields
from ..numerics.errors import ReachError

SLACK = 16 * float(np.finfo(float).eps)
"""Relative rounding booked on the values a band is made from."""


@dataclass(frozen=True)
class Activation:
    """A scalar function, applied to every component: never decreasing, of slope at most 1.

    Parameters
    ----------
    kind : {"relu", "tanh", "sigmoid", "clip"}
        ``relu`` lets a share `low` of what is negative through (0 for the plain one), ``clip`` limits to
        [low, high].
    low, high : float

    Raises
    ------
    ReachError
        If the kind is unknown, a number not finite, or the function would decrease.
    """

    kind: str
    low: float = 0.0
    high: float = 0.0

    def __post_init__(self) -> None:
        check_fields(self)
        if self.kind not in _FUNCTIONS:
            raise ReachError(f"an activation must be one of {', '.join(_FUNCTIONS)}, got {self.kind!r}")
        if not (np.isfinite(self.low) and np.isfinite(self.high)):
            raise ReachError(f"{self.kind} needs finite numbers, got {self.low!r} and {self.high!r}")
        if self.kind == "relu" and not 0 <= self.low <= 1:
            raise ReachError(f"the slope of a leaky relu must lie in [0, 1], got {self.low!r}")
        if self.kind == "clip" and not self.low <= self.high:
            raise ReachError(f"a clip needs low <= high, got {self.low!r} and {self.high!r}")

    def __call__(self, y: Array) -> Array:
        """Values, shape of y."""
        return _FUNCTIONS[self.kind](self, np.asarray(y))

    def slope(self, y: Array) -> Array:
        """Derivative at y; at a kink one of the two."""
        if self.kind == "relu":
            return np.where(y < 0, self.low, 1.0)
        if self.kind == "clip":
            return np.where((y < self.low) | (y > self.high), 0.0, 1.0)
        value = self(y)
        return np.asarray(1 - value**2 if self.kind == "tanh" else value * (1 - value))

    def band(self, lo: Array, hi: Array) -> tuple[Array, Array, Array]:
        """Slope, offset and radius of a band over [lo, hi], elementwise; exact where f is affine there.

        Parameters
        ----------
        lo, hi : ndarray
            Of one shape, ``lo <= hi``.
        """
        top, bottom, width = self(hi), self(lo), hi - lo
        slope = np.divide(top - bottom, width, out=np.zeros_like(width), where=width > 0)
        slope = np.clip(slope, 0.0, 1.0)
        places = np.stack([lo, hi, *(np.clip(y, lo, hi) for y in self._turns(slope))])
        rest = self(places) - slope * places
        most, least = rest.max(axis=0), rest.min(axis=0)
        scale = np.maximum(np.abs(top), np.abs(bottom)) + np.maximum(np.abs(lo), np.abs(hi))
        return slope, (most + least) / 2, (most - least) / 2 + SLACK * scale

    def _turns(self, slope: Array) -> list[Array | float]:
        """Where ``f(y) - slope y`` may turn: kinks, and where f has that slope."""
        if self.kind == "relu":
            return [0.0]
        if self.kind == "clip":
            return [self.low, self.high]
        # 1 / cosh(y)^2 = slope for tanh; the sigmoid is (1 + tanh(y / 2)) / 2, and its slope at most 1/4.
        stretch = 2.0 if self.kind == "sigmoid" else 1.0
        y = stretch * np.arccosh(1 / np.sqrt(np.clip(slope * stretch**2, 1e-300, 1.0)))
        return [y, -y]


def _sigmoid(_: Activation, y: Array) -> Array:
    return np.asarray(0.5 + 0.5 * np.tanh(0.5 * y))


_FUNCTIONS: dict[str, Callable[[Activation, Array], Array]] = {
    "relu": lambda f, y: np.where(y < 0, f.low * y, y),
    "tanh": lambda _, y: np.tanh(y),
    "sigmoid": _sigmoid,
    "clip": lambda f, y: np.clip(y, f.low, f.high),
}
