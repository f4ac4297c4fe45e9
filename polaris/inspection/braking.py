"""Braking before a boundary: the speed from which a spacecraft can still stop (eqs. 27 to 30, 35, 36)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..model.system import Array


@dataclass(frozen=True, eq=False)
class Braking:
    """Approach speed ``s(delta)`` that may be held at the distance delta from a boundary.

    The paper's ``sqrt(2 a delta)`` has no slope at the boundary and no value behind it (theory, item 14).
    Here ``s(delta) = k delta`` in a layer of the depth d and ``sqrt(2 a (delta - d / 2))`` above it,
    with ``k = sqrt(a / d)``: value and slope are continuous, ``s(0) = 0``, and s never exceeds the paper's,
    so whatever respects it respects eq. 27. Braking in the layer needs ``k^2 delta <= a`` only.

    Outside (``delta < 0``) ``s = k delta / (1 + k |delta| / c)``, which has the same value and slope at 0
    and never asks for a way back faster than c, however far outside. The acceleration a [m/s^2] broadcasts
    against delta; the depth d is in m, the speed back c in m/s, and all are positive.
    """

    acceleration: Array | float
    depth: float
    back: float

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
        speed, slope = np.minimum(root, k * delta), self.acceleration / root
        if not (delta < 0).any():
            return speed, slope
        fade = 1 + k / self.back * np.maximum(-delta, 0.0)
        return speed / fade, slope / fade**2

    def steepest(self, nearest: ArrayLike, farthest: ArrayLike) -> Array:
        """Largest slope [1/s] between two distances: it rises up to 0 and falls beyond the layer."""
        return self(np.clip(0.0, nearest, farthest))[1]

    def bend(self, nearest: ArrayLike, farthest: ArrayLike) -> Array:
        """Bound on ``-s''`` [1/(m s)] between two distances; below the layer's depth s does not bend down."""
        a, d = self.acceleration, self.depth
        root = np.sqrt(2 * a * np.maximum(np.asarray(nearest) - d / 2, d / 2))
        return np.where(np.asarray(farthest) <= d, 0.0, a**2 / root**3)

    def curvature(
        self,
        delta: Array,
        rate: Array,
        low: Array,
        high: Array,
        third: Array,
        smooth: NDArray[np.bool_],
        D: float,
    ) -> Array:
        """Bound M on the second derivative of ``-(s(delta) + d(delta)/dt)`` over a period D [s].

        Given that delta's second derivative is within ``[-low, high]`` and its third at least ``-third``; inf
        where the direction may turn at once (not `smooth`), -inf where h cannot become negative meanwhile.
        """
        slowest, quickest = rate - low * D, rate + high * D
        closest = delta + np.minimum(slowest, 0.0) * D
        farthest = delta + np.maximum(quickest, 0.0) * D
        fastest = np.maximum(np.abs(slowest), np.abs(quickest))
        M = self.bend(closest, farthest) * fastest**2 + self.steepest(closest, farthest) * low + third
        M = np.where(smooth, M, np.inf)
        return np.where((self(closest)[0] + slowest >= 0) & (closest >= 0), -np.inf, M)
