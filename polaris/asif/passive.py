"""Passively safe manoeuvres: h7 = phi7 (eq. 21) and h8 = phi8 (eq. 22)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..system import Array
from .barriers import Evaluation, rounded_length
from .closest import ClosestApproach


@dataclass(frozen=True, eq=False)
class Passive:
    """Clear of a sphere for T seconds without thrust: ``inf norm(p(t)) - radius`` over free flight.

    Parameters
    ----------
    name : str
    radius : array_like
        [m]
    approach : ClosestApproach
    beyond : float
        Values larger than this [m] need not be exact: they may come out smaller, but not below it.
    """

    name: str
    radius: Array | float
    approach: ClosestApproach
    beyond: float = np.inf

    def __call__(self, z: Array, sun: ArrayLike = 0.0) -> Evaluation:
        """Evaluate at states of shape (..., 6)."""
        found = self.approach(z, self.beyond + float(np.max(self.radius)))
        outward = rounded_length(found.place, 1e-9)[1]
        gradient = _carried_back(outward, self.approach.mean_motion, found.when)
        return Evaluation(found.distance - self.radius, gradient, 0.0)


def _carried_back(direction: Array, n: float, t: Array) -> Array:
    """``Phi_p(t)^T direction``: gradient of a position after free flight (eq. 20) by the state before."""
    s, c = np.sin(n * t), np.cos(n * t)
    turned = 2 / n * (1 - c)
    x, y, z = direction[..., 0], direction[..., 1], direction[..., 2]
    gradient = np.empty((*direction.shape[:-1], 6))
    gradient[..., 0] = (4 - 3 * c) * x + 6 * (s - n * t) * y
    gradient[..., 1] = y
    gradient[..., 2] = c * z
    gradient[..., 3] = s / n * x - turned * y
    gradient[..., 4] = turned * x + (4 / n * s - 3 * t) * y
    gradient[..., 5] = s / n * z
    return gradient
