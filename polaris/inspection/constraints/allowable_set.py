"""The paper's eleven constraints: the families that keep them, and phi1 to phi6, phi9 to phi11 themselves.

Values (eqs. 12 to 19, 23, 24) are as the paper defines them, in its units: what flights are judged by,
independent of the filters' formulas. phi7 and phi8 (passively safe manoeuvres) are h7 and h8; see
`polaris.inspection.constraints.passive`.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ...model.system import Array
from ..inspection import Inspection
from ..vectors import length


class Kind(NamedTuple):
    """One family of constraints: what it keeps of phi1 to phi11 (eqs. 12 to 23), of one deputy or a pair.

    The rank is what gives way last where no input satisfies all conditions: not to collide (0), not to
    collide should the thrusters fail, speeds, the zone, the sun.
    """

    phi: tuple[str, ...]
    rank: int
    pair: bool = False


KINDS = {
    "chief_separation": Kind(("phi1",), 0),
    "deputy_separation": Kind(("phi2",), 0, True),
    "speed": Kind(("phi3",), 2),
    "sun": Kind(("phi4",), 4),
    "deputy_sun": Kind(("phi5",), 4, True),
    "keep_in": Kind(("phi6",), 3),
    "passive": Kind(("phi7",), 1),
    "deputy_passive": Kind(("phi8",), 1, True),
    "velocity": Kind(("phi9", "phi10", "phi11"), 2),
}
"""By family, in the order of h1 to h11."""

FAMILIES = tuple(KINDS)
CONSTRAINTS = tuple(name for kind in KINDS.values() for name in kind.phi)  # phi1 to phi11
PASSIVE = {"phi7": "passive", "phi8": "deputy_passive"}
"""The constraints on free flights: they are their own barriers, and no part of what a backup must keep."""


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
