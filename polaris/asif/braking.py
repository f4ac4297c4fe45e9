"""Braking before a boundary: the speed from which a spacecraft can still stop (eqs. 27 to 30, 35, 36)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ..system import Array


@dataclass(frozen=True, eq=False)
class Braking:
    """Approach speed ``s(delta)`` that may be held at the distance delta from a boundary.

    The paper's ``sqrt(2 a delta)`` has no slope at the boundary and no value behind it (theory, item 14).
    Here ``s(delta) = k delta`` below the depth d of a layer and ``sqrt(2 a (delta - d / 2))`` above it,
    with ``k = sqrt(a / d)``: value and slope are continuous, ``s(0) = 0``, and s never exceeds the paper's,
    so whatever respects it respects eq. 27. Braking in the layer needs ``k^2 delta <= a`` only.

    Parameters
    ----------
    acceleration : array_like
        a [m/s^2], > 0; broadcasts against delta.
    depth : float
        d [m], > 0.
    """

    acceleration: Array | float
    depth: float

    @cached_property
    def _numbers(self) -> tuple[Array, Array]:
        """``2 a`` and k."""
        return np.asarray(2 * self.acceleration), np.sqrt(np.asarray(self.acceleration) / self.depth)

    def __call__(self, delta: ArrayLike) -> tuple[Array, Array]:
        """Speed [m/s] and its slope [1/s] at a signed distance [m]."""
        twice, k = self._numbers
        half = self.depth / 2
        delta = np.asarray(delta, dtype=float)
        root = np.sqrt(twice * np.maximum(delta - half, half))
        # The line is tangent to the root, and above it; inside the layer the root is held at k d.
        return np.minimum(root, k * delta), self.acceleration / root

    def bend(self, delta: ArrayLike) -> Array:
        """Bound on ``-s''`` [1/(m s)] at all distances of at least delta."""
        a, d = self.acceleration, self.depth
        root = np.sqrt(2 * a * np.maximum(np.asarray(delta) - d / 2, d / 2))
        return np.asarray(a**2 / root**3)
