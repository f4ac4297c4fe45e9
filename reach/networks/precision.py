"""Rounding of networks that are evaluated in floating point: standard a-priori bounds, layer by layer.

A sum of n products in any order, with or without fused multiply-add, is off by at most
``gamma_k (|W| |x| + |b|)`` with ``gamma_k = k u / (1 - k u)`` (Higham 2002, section 3.1), and by an absolute
error where results or operands below the normal numbers are flushed to zero.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..numerics.checks import Array
from ..numerics.errors import ReachError, Unresolved
from ..numerics.rounding import gamma
from .layers import Activation, Affine, Diagonal

FORMATS: dict[str, Any] = {"float32": np.float32, "float64": np.float64}

MORE = 8
"""Roundings of a term of a sum beside its additions: of the weight, of the product, and of factors that a
runtime folds into the weights."""
CURVED = 8.0  # error of tanh and sigmoid in unit roundoffs: 4 units in the last place of 1
READ = 3  # roundings of an input: of the number, of its scale, of the product
UP = 1 + gamma(8)  # what the bounds themselves are rounded by


@dataclass(frozen=True)
class Rounding:
    """Bounds on rounding to nearest in one format, with gradual underflow or without."""

    u: float  # unit roundoff
    tiny: float  # least normal number: absolute error of one operation near zero
    largest: float  # size up to which neither a number nor its inverse leaves the normal ones

    @classmethod
    def from_precision(cls, precision: str) -> Rounding | None:
        """Return the bounds of a precision; None for real arithmetic, `ReachError` for an unknown one."""
        if precision == "real":
            return None
        if precision not in FORMATS:
            raise ReachError(f"precision must be one of real, {', '.join(FORMATS)}, got {precision!r}")
        form = np.finfo(FORMATS[precision])
        return cls(float(form.eps) / 2, float(form.tiny), 1 / float(form.tiny))

    def relative(self, count: int) -> float:
        """Return ``gamma_count``, the relative error of so many roundings in a row."""
        return count * self.u / (1 - count * self.u) * UP

    def read(self, x: Array) -> Array:
        """Bound the rounding of inputs of sizes up to x, shape (n,)."""
        self._require_finite("an input of", x)
        return self.relative(READ) * x + 2 * self.tiny

    def summed(self, layer: Affine | Diagonal, x: Array) -> Array:
        """Bound the rounding of a layer of weights, shape (m,), for inputs of sizes up to x, (n,)."""
        size, relative = layer.sizes(x) + np.abs(layer.b), self.relative(layer.terms + MORE)
        weights = layer.sizes(np.ones(layer.shape[1]))
        self._require_finite("a sum of weights in", weights)
        self._require_finite("a sum in", size * (1 + relative) * UP)
        near_zero = 2 * layer.terms + 2 + weights + x.sum()
        return np.asarray((relative * size + 2 * self.tiny * near_zero) * (1 + gamma(layer.terms)) * UP)

    def bent(self, layer: Activation, values: Array) -> Array:
        """Bound the rounding of an activation, shape (m,), for values of sizes up to `values`."""
        self._require_finite("an activation in", values)
        curved = CURVED * self.u if layer.kind in ("tanh", "sigmoid") else 0.0
        near_zero = 2 * self.tiny * (1 + layer.steepest)
        return np.asarray((self.relative(2) * values + curved + near_zero) * UP)

    def _require_finite(self, place: str, x: Array) -> None:
        """Raise `Unresolved` where rounded numbers of sizes up to x may be infinite."""
        if not np.all(x * UP <= self.largest):
            raise Unresolved(f"{place} the network may reach {x.max():.3g}, beyond its floating-point format")
