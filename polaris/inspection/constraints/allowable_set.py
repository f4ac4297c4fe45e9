"""The allowable set: phi1 to phi6 and phi9 to phi11 (eqs. 12 to 19, 23, 24), as the paper defines them.

phi7 and phi8 (passively safe manoeuvres) are h7 and h8; see `polaris.inspection.constraints.passive`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ...model.system import Array
from ..inspection import Inspection
from .barriers import dot

NAMES = ("phi1", "phi2", "phi3", "phi4", "phi5", "phi6", "phi9", "phi10", "phi11")
"""In the order of the columns of `allowable`; phi5 counts both orders of a pair."""


def _length(vectors: Array) -> Array:
    return np.asarray(np.sqrt(dot(vectors, vectors)))


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
        By `NAMES`, each of shape (..., N), or (..., P) for phi2 and phi5 of the P pairs. phi5 is the
        smaller of its values for (i, j) and (j, i).
    """
    q = inspection
    sun = np.asarray(sun, dtype=float)[..., None]
    p, v = x[..., :3], x[..., 3:]
    apart = p[..., q.pairs[:, 0], :] - p[..., q.pairs[:, 1], :]
    distance = _length(p)
    between = _sun_angle(apart, sun)
    limit = q.speed_max**2
    return {
        "phi1": distance - q.separation,
        "phi2": _length(apart) - 2 * q.deputy_radius,
        "phi3": q.docking_speed + q.nu_1 * distance - _length(v),
        "phi4": _sun_angle(-p, sun) - q.field_of_view / 2,
        "phi5": np.minimum(between, np.pi - between) - q.field_of_view / 2,
        "phi6": q.distance_max - distance,
        "phi9": limit - v[..., 0] ** 2,
        "phi10": limit - v[..., 1] ** 2,
        "phi11": limit - v[..., 2] ** 2,
    }
