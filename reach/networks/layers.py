"""Layers of feed-forward networks: affine maps, elementwise ones, activations and their affine bands.

An activation is held by an affine band, ``|f(y) - (slope y + offset)| <= radius`` for every y in [lo, hi]. It
may have any slope; that of the secant is taken, and what is left, ``f(y) - slope y``, has its extremes at the
ends of the interval, at kinks, and where ``f' = slope``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..numerics.checks import Array, check_fields, finite_fields
from ..numerics.errors import ReachError
from ..short_repr import short_repr

SLACK = 16 * float(np.finfo(float).eps)  # relative rounding allowance on the values a band is made from


@dataclass(frozen=True)
class Activation:
    """A scalar function, applied to every component: never decreasing.

    Parameters
    ----------
    kind : {"relu", "tanh", "sigmoid", "clip"}
        ``relu`` multiplies negative values by `low` (0 for the plain one), ``clip`` limits to [low, high].
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
        if self.kind == "relu" and self.low < 0:
            raise ReachError(f"the slope of a leaky relu must be >= 0, got {self.low!r}")
        if self.kind == "clip" and not self.low <= self.high:
            raise ReachError(f"a clip needs low <= high, got {self.low!r} and {self.high!r}")

    def __call__(self, y: Array) -> Array:
        """Values, shape of y."""
        return _FUNCTIONS[self.kind](self, np.asarray(y))

    @property
    def steepest(self) -> float:
        """Largest slope."""
        return max(self.low, 1.0) if self.kind == "relu" else 1.0

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
        slope = np.clip(slope, 0.0, self.steepest)
        places = np.stack([lo, hi, *(np.clip(y, lo, hi) for y in self._turns(slope))])
        deviation = self(places) - slope * places
        upper, lower = deviation.max(axis=0), deviation.min(axis=0)
        scale = np.maximum(np.abs(top), np.abs(bottom)) + np.maximum(np.abs(lo), np.abs(hi))
        return slope, (upper + lower) / 2, (upper - lower) / 2 + SLACK * scale

    def _turns(self, slope: Array) -> list[Array | float]:
        """Return points at which ``f(y) - slope y`` may turn: kinks, and those with that slope of f."""
        if self.kind == "relu":
            return [0.0]
        if self.kind == "clip":
            return [self.low, self.high]
        # 1 / cosh(y)^2 = slope for tanh; the sigmoid is (1 + tanh(y / 2)) / 2, and its slope at most 1/4.
        stretch = 2.0 if self.kind == "sigmoid" else 1.0
        y = stretch * np.arccosh(1 / np.sqrt(np.clip(slope * stretch**2, 1e-300, 1.0)))
        return [y, -y]


_FUNCTIONS: dict[str, Callable[[Activation, Array], Array]] = {
    "relu": lambda f, y: np.where(y < 0, f.low * y, y),
    "tanh": lambda _, y: np.tanh(y),
    "sigmoid": lambda _, y: np.asarray(0.5 + 0.5 * np.tanh(0.5 * y)),
    "clip": lambda f, y: np.clip(y, f.low, f.high),
}


@short_repr
@dataclass(frozen=True, eq=False)
class Affine:
    """A layer ``W x + b``.

    Parameters
    ----------
    W : array_like, shape (m, n)
    b : array_like, shape (m,)

    Raises
    ------
    ReachError
        If the shapes do not fit or a weight is not finite.
    """

    W: Array
    b: Array

    def __post_init__(self) -> None:
        W, b = finite_fields(self, "W", "b")
        if W.ndim != 2 or 0 in W.shape or b.shape != W.shape[:1]:
            raise ReachError(f"a layer needs weights (m, n) and biases (m,), got {W.shape} and {b.shape}")

    @property
    def shape(self) -> tuple[int, int]:
        """Number of outputs and of inputs."""
        return self.W.shape[0], self.W.shape[1]

    @property
    def terms(self) -> int:
        """Number of products summed in one output."""
        return self.shape[1]

    def sizes(self, x: Array) -> Array:
        """Product of the absolute weights and a matrix or vector."""
        return np.asarray(np.abs(self.W) @ x)

    def __call__(self, x: Array) -> Array:
        """Values for inputs of shape (..., n), in the format of the inputs."""
        return np.asarray(x @ self.W.T.astype(x.dtype, copy=False) + self.b.astype(x.dtype, copy=False))

    def times(self, G: Array) -> Array:
        """Product of the weights and a matrix or vector."""
        return np.asarray(self.W @ G)

    def back(self, weights: Array) -> Array:
        """Product of rows of output weights (..., m) and the weights, shape (..., n)."""
        return np.asarray(weights @ self.W)


@short_repr
@dataclass(frozen=True, eq=False)
class Diagonal:
    """A layer ``scale * x + b`` that takes every component for itself.

    Parameters
    ----------
    scale, b : array_like, shape (m,)

    Raises
    ------
    ReachError
        If the shapes do not fit or a number is not finite.
    """

    terms: ClassVar[int] = 1  # products summed in one output
    scale: Array
    b: Array

    def __post_init__(self) -> None:
        scale, b = finite_fields(self, "scale", "b")
        if scale.ndim != 1 or not scale.size or b.shape != scale.shape:
            raise ReachError(f"an elementwise layer needs two vectors, got {scale.shape} and {b.shape}")

    @property
    def shape(self) -> tuple[int, int]:
        """Number of outputs and of inputs."""
        return len(self.b), len(self.b)

    def sizes(self, x: Array) -> Array:
        """Product of the absolute weights and a matrix or vector."""
        return np.asarray((x.T * np.abs(self.scale)).T)

    def __call__(self, x: Array) -> Array:
        """Values for inputs of shape (..., m), in the format of the inputs."""
        scale, b = (part.astype(x.dtype, copy=False) for part in (self.scale, self.b))
        return np.asarray(x * scale + b)

    def times(self, G: Array) -> Array:
        """Product of the weights and a matrix or vector."""
        return np.asarray((G.T * self.scale).T)

    def back(self, weights: Array) -> Array:
        """Product of rows of output weights (..., m) and the weights, shape (..., m)."""
        return np.asarray(weights * self.scale)
