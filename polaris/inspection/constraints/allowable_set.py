"""The allowable set: phi1 to phi6 and phi9 to phi11 (eqs. 12 to 19, 23, 24).

`allowable` has them as the paper defines them, in its units: what flights are judged by, independent of
the filters' formulas. `AllowableRows` has them as filters use them: with gradients, bounded between samples.
phi7 and phi8 (passively safe manoeuvres) are h7 and h8; see `polaris.inspection.constraints.passive`.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from numpy.typing import ArrayLike

from ...model.system import Array
from ..inspection import Inspection
from ..vectors import length
from .barriers import Evaluation
from .table import Table


def _sun_angle(vectors: Array, sun: Array) -> Array:
    """Angle [rad] between vectors and the direction of the sun; pi where a vector is zero."""
    x, y = np.cos(sun), np.sin(sun)
    along = vectors[..., 0] * x + vectors[..., 1] * y
    across = np.hypot(vectors[..., 1] * x - vectors[..., 0] * y, vectors[..., 2])
    angle = np.arctan2(across, along)  # as accurate near 0 as anywhere, unlike the arc cosine of eq. 16
    return np.where((along == 0) & (across == 0), np.pi, angle)


def allowable(inspection: Inspection, x: Array, sun: ArrayLike) -> dict[str, Array]:
    """Values of the constraints at states of shape (..., N, 6) and sun angles of shape (...) [rad].

    Returns
    -------
    dict of str to ndarray
        phi1 to phi6, phi9 to phi11, each of shape (..., N), or (..., P) for phi2 and phi5 of the P pairs.
        phi5 is the smaller of its values for (i, j) and (j, i).
    """
    q = inspection
    sun = np.asarray(sun, dtype=float)[..., None]
    p, v = x[..., :3], x[..., 3:]
    apart = p[..., q.pairs[:, 0], :] - p[..., q.pairs[:, 1], :]
    distance = length(p)
    between = _sun_angle(apart, sun)
    limit = q.speed_max**2
    return {
        "phi1": distance - q.separation,
        "phi2": length(apart) - q.deputy_separation,
        "phi3": q.docking_speed + q.nu_1 * distance - length(v),
        "phi4": _sun_angle(-p, sun) - q.field_of_view / 2,
        "phi5": np.minimum(between, np.pi - between) - q.field_of_view / 2,
        "phi6": q.distance_max - distance,
        "phi9": limit - v[..., 0] ** 2,
        "phi10": limit - v[..., 1] ** 2,
        "phi11": limit - v[..., 2] ** 2,
    }


class AllowableRows(Table):
    """phi1 to phi6 and phi9 to phi11 with gradients, as rows; phi4 and phi5 in metres, not as angles.

    Which rows are about velocities, `is_speed` (M,) says.
    """

    def __init__(self, inspection: Inspection, without: Collection[str] = ()) -> None:
        super().__init__(inspection, "phi", without)
        self.is_speed = self.among("speed", "velocity")

    def __call__(self, x: Array, sun: Array) -> Evaluation:
        """Values, gradients by the first deputy's state (the second's is the negative), changes with time.

        Shapes (S, M), (S, M, 6) and (S, M), at states (S, N, 6) and sun angles (S,) [rad].
        """
        every = self.stack(x)
        found = [group.barrier.phi(every[:, group.at], sun[:, None]) for group in self.groups]
        return Evaluation(
            np.concatenate([phi.h for phi in found], axis=1),
            np.concatenate([phi.gradient for phi in found], axis=1),
            np.concatenate([np.broadcast_to(phi.change, phi.h.shape) for phi in found], axis=1),
        )

    def between(self, value: Array, x: Array, period: float, push: float) -> Array:
        """Lower bounds (S-1, M) of values (S, M) between samples x (S, N, 6) that are `period` [s] apart.

        `push` is the largest acceleration by thrust of one deputy [m/s^2], constant between samples.
        Distances change no faster than the position moves (seen from the turning cone, for phi4 and phi5):
        between two samples they are at least the mean of both less half the path. Speeds lie on a chord but
        for the jerk; the largest is at an end.
        """
        n, D = self.inspection.mean_motion, period
        z = self.relative(x)
        r, v = length(z[..., :3]), length(z[..., 3:])
        r, v = np.maximum(r[1:], r[:-1]), np.maximum(v[1:], v[:-1])
        acceleration = np.where(self.second >= 0, 2.0, 1.0) * push + 3 * n**2 * r + 2 * n * v
        slip = v + np.where(self.among("sun", "deputy_sun"), n * r, 0.0)
        path = D * (slip + 1.2 * acceleration * D / 2)
        middle = (value[1:] + value[:-1] - path) / 2
        jerk = 1.2 * (3 * n**2 * v + 2 * n * acceleration) * D**2 / 8
        lost = np.where(self.among("speed"), jerk + self.inspection.nu_1 * path / 2, 2 * v * jerk)
        return np.where(self.is_speed, np.minimum(value[1:], value[:-1]) - lost, middle)
