"""Closed elliptical natural motion trajectories about the chief (eq. 38), and the one nearest to a state.

On such a trajectory ``v_x = n y / 2`` and ``v_y = -2 n x``; cross-track the free motion is an oscillation
whatever the state, so that z and v_z are free. Write ``q = (x, y / 2)``: along the trajectory q turns at the
rate n and keeps its length a, the semi-minor axis. Hence ``norm(p) >= a`` for ever, whatever z does.
"""

from dataclasses import dataclass

import numpy as np

from ..model.checks import positive
from ..model.errors import ScenarioError
from ..model.system import Array
from .inspection import Inspection

DEEPER = 0.1  # a third of the room that there must be between the limits, as a share of them


def velocity_error(x: Array, n: float) -> Array:
    """In-plane velocity relative to the eNMT through the same position, eq. 41 [m/s], shape (..., 2).

    It vanishes on closed eNMTs and nowhere else. In free flight ``e_y`` is constant and
    ``d(e_x)/dt = 1.5 n e_y``: zero stays zero.
    """
    return np.stack([x[..., 3] - n / 2 * x[..., 1], x[..., 4] + 2 * n * x[..., 0]], axis=-1)


def semi_axes(x: Array, n: float) -> tuple[Array, Array]:
    """Semi-minor axis a in the plane and amplitude c cross-track [m], each of shape (...).

    Of the eNMT through the position of a state of shape (..., 6), and of its cross-track motion.
    """
    return np.hypot(x[..., 0], x[..., 1] / 2), np.hypot(x[..., 2], x[..., 5] / n)


TINY = 1e-150  # [m] axes that are shorter count as none: shares of them would overflow


@dataclass(frozen=True)
class Ellipses:
    """The closed eNMTs among which one is chosen, at a mean motion [rad/s].

    Their semi-minor axes are between `least` [m], > 0 (no point of the trajectory is nearer to the chief),
    and `largest` [m], half the largest distance in the plane; their amplitude `cross_track` [m] is bounded.
    There must be room of at least three times `DEEPER` between `least` and `largest`.
    """

    mean_motion: float
    least: float
    largest: float = np.inf
    cross_track: float = np.inf

    def __post_init__(self) -> None:
        positive("mean_motion", self.mean_motion, "rad/s")
        positive("least", self.least, "m")
        for name in ("largest", "cross_track"):
            if not getattr(self, name) > 0:
                raise ScenarioError(name, getattr(self, name), "must be > 0 [m]")
        if self.largest < (1 + 3 * DEEPER) * self.least:
            rule = f"must be at least {(1 + 3 * DEEPER) * self.least:g} m, above the least semi-minor axis"
            raise ScenarioError("largest", self.largest, rule)

    @classmethod
    def for_inspection(cls, inspection: Inspection) -> "Ellipses":
        """Return eNMTs that keep 1.5 times the separation from the chief, within r_max and the speed limits.

        That is ``4 a^2 + c^2 <= r_max^2``, and ``2 n a`` and ``n c`` are at most v_max.
        """
        q = inspection
        span = min(q.distance_max / np.sqrt(2), q.speed_max / q.mean_motion)
        return cls(q.mean_motion, 1.5 * q.separation, span / 2, span)

    def nearest(self, x: Array) -> Array:
        """State on an eNMT within the limits that is nearest to a state, shapes (..., 6) [m, m/s].

        Nearest in the norm whose square is ``dx^2 + (dy/2)^2 + dz^2 + (dv_z/n)^2``: the velocity in the
        plane does not weigh, because it is what a short manoeuvre changes at once. In these coordinates
        the limits are rings about the origin, and the nearest point is found in closed form: the same
        direction, the length brought into its limits. At the very centre every direction is as near: ahead
        of the chief (+y) is taken there. Without limits this is eq. 41.
        """
        a, c = semi_axes(x, self.mean_motion)
        a_aim, c_aim = np.clip(a, self.least, self.largest), np.minimum(c, self.cross_track)
        n = self.mean_motion
        out = np.empty(x.shape)
        in_plane, across = a > TINY, c > TINY
        scale = a_aim / np.where(in_plane, a, 1.0)
        out[..., 0] = scale * x[..., 0]
        out[..., 1] = np.where(in_plane, scale * x[..., 1], 2 * a_aim)
        out[..., 3] = n / 2 * out[..., 1]
        out[..., 4] = -2 * n * out[..., 0]
        out[..., 2::3] = (c_aim / np.where(across, c, 1.0))[..., None] * x[..., 2::3]
        return out


def stopping_point(x: Array, n: float, acceleration: float) -> Array:
    """States (..., 6) moved to where braking with `acceleration` [m/s^2] per axis ends the velocity error.

    The position moves by ``e |e| / (2 acceleration)`` per axis of the plane, the velocity error of the
    result is zero, and the cross-track motion stays as it is. An estimate (exact without gravity): for
    choosing a reference that needs no return.
    """
    e = velocity_error(x, n)
    out = np.array(x)
    out[..., :2] += e * np.abs(e) / (2 * acceleration)
    out[..., 3] = n / 2 * out[..., 1]
    out[..., 4] = -2 * n * out[..., 0]
    return out
