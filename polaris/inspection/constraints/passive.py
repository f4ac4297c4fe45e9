"""Passively safe manoeuvres: h7 = phi7 (eq. 21) and h8 = phi8 (eq. 22)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from ...model.system import Array
from ..closest import ClosestApproach
from .barriers import Evaluation, rounded_length


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
    still, drift, circle, across = (direction @ part for part in _parts(n))
    angle = (n * t)[..., None]
    return np.asarray(still + drift * t[..., None] + circle * np.cos(angle) + across * np.sin(angle))


@cache
def _parts(n: float) -> tuple[Array, ...]:
    """The constant, linear, cosine and sine parts of eq. 20, each of shape (3, 6)."""
    still, drift, circle, across = np.zeros((4, 3, 6))
    still[0, [0, 4]], still[1, [1, 3]] = (4, 2 / n), (1, -2 / n)
    drift[1, [0, 4]] = -6 * n, -3
    circle[0, [0, 4]], circle[1, 3], circle[2, 2] = (-3, -2 / n), 2 / n, 1
    across[0, 3], across[1, [0, 4]], across[2, 5] = 1 / n, (6, 4 / n), 1 / n
    return still, drift, circle, across
