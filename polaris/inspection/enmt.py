"""Closed elliptical natural motion trajectories about the chief (eq. 38), and the one nearest to a state.

On such a trajectory ``v_x = n y / 2`` and ``v_y = -2 n x``; cross-track the free motion is an oscillation
whatever the state, so that z and v_z are free. Write ``q = (x, y / 2)``: along the trajectory q turns at the
rate n and keeps its length a, the semi-minor axis. Hence ``norm(p) >= a`` for ever, whatever z does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..model.checks import positive
from ..model.errors import ScenarioError
from ..model.system import Array
from .inspection import Inspection

DEEPER = 0.1
"""How far inside the limits, as a share of them, a state outside is sent by `Ellipses.inside`."""


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


@dataclass(frozen=True)
class Ellipses:
    """The closed eNMTs among which one is chosen.

    Parameters
    ----------
    mean_motion : float
        n [rad/s].
    least : float
        Least semi-minor axis [m], > 0: no point of the trajectory is nearer to the chief.
    largest : float
        Largest semi-minor axis [m]; half the largest distance in the plane.
    cross_track : float
        Largest amplitude cross-track [m].

    Raises
    ------
    ScenarioError
        If they leave no room of at least three times `DEEPER` between `least` and `largest`.
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
            rule = f"must be at least {(1 + 3 * DEEPER) * self.least:g} m, the least semi-minor axis and room"
            raise ScenarioError("largest", self.largest, rule)

    @classmethod
    def of(cls, inspection: Inspection, keep_in: bool = True) -> Ellipses:
        """Those that keep clear of the chief by half the separation again.

        Parameters
        ----------
        inspection : Inspection
        keep_in : bool
            Also within r_max (``4 a^2 + c^2 <= r_max^2``) and the velocity limits (``2 n a``, ``n c``).
        """
        q = inspection
        least = 1.5 * q.separation
        if not keep_in:
            return cls(q.mean_motion, least)
        span = min(q.distance_max / np.sqrt(2), q.speed_max / q.mean_motion)
        return cls(q.mean_motion, least, span / 2, span)

    @classmethod
    def fitting(cls, inspection: Inspection, given: Ellipses | None) -> Ellipses:
        """Those given, or the usual ones; refused if they are of another orbit than the problem.

        Raises
        ------
        ScenarioError
            If the mean motions differ: about another orbit they are no free flights.
        """
        if given is None:
            return cls.of(inspection)
        if given.mean_motion != inspection.mean_motion:
            rule = f"must be for {inspection.mean_motion:g} rad/s"
            raise ScenarioError("ellipses", given.mean_motion, rule)
        return given

    def nearest(self, x: Array) -> Array:
        """State on an eNMT within the limits that is nearest to a state.

        Nearest in the norm whose square is ``dx^2 + (dy/2)^2 + dz^2 + (dv_z/n)^2``: the velocity in the
        plane does not weigh, because it is what a short manoeuvre changes at once. In these coordinates
        the limits are rings about the origin, and the nearest point is found in closed form: the same
        direction, the length brought into its limits. At the very centre every direction is as near: ahead
        of the chief (+y) is taken there. Without limits this is eq. 41.

        Parameters
        ----------
        x : ndarray, shape (..., 6)
            States in Hill's frame [m, m/s].

        Returns
        -------
        ndarray, shape (..., 6)
        """
        a, c = semi_axes(x, self.mean_motion)
        return self._scaled(x, a, np.clip(a, self.least, self.largest), c, np.minimum(c, self.cross_track))

    def inside(self, x: Array) -> Array:
        """As `nearest`, but states outside a limit are sent a share `DEEPER` further in.

        For a controller that follows the answer step by step: it arrives inside the limits instead of
        approaching them for ever.
        """
        a, c = semi_axes(x, self.mean_motion)
        aim, across = self._aims(a, c)
        return self._scaled(x, a, aim, c, across)

    def _aims(self, a: Array, c: Array) -> tuple[Array, Array]:
        aim = np.where(a < self.least, self.least * (1 + DEEPER), a)
        aim = np.where(a > self.largest, self.largest * (1 - DEEPER), aim)
        return aim, np.where(c > self.cross_track, self.cross_track * (1 - DEEPER), c)

    def _scaled(self, x: Array, a: Array, a_aim: Array, c: Array, c_aim: Array) -> Array:
        n = self.mean_motion
        out = np.empty(x.shape)
        scale = a_aim / np.where(a > 0, a, 1.0)
        out[..., 0] = scale * x[..., 0]
        out[..., 1] = np.where(a > 0, scale * x[..., 1], 2 * a_aim)
        out[..., 3] = n / 2 * out[..., 1]
        out[..., 4] = -2 * n * out[..., 0]
        out[..., 2::3] = (c_aim / np.where(c > 0, c, 1.0))[..., None] * x[..., 2::3]
        return out

    def inside_slope(self, x: Array) -> Array:
        """Derivative of `inside`, shape (..., 6, 6), where it has one (not on the limits themselves)."""
        a, c = semi_axes(x, self.mean_motion)
        n = self.mean_motion
        aim, across = self._aims(a, c)
        safe = np.where(a > 0, a, 1.0)
        ring = _radial_slope(
            np.stack([x[..., 0], x[..., 1] / 2], axis=-1) / safe[..., None], aim, safe, aim != a
        )
        safe = np.where(c > 0, c, 1.0)
        unit = np.stack([x[..., 2], x[..., 5] / n], axis=-1) / safe[..., None]
        wave = _radial_slope(unit, across, safe, across != c)
        out = np.zeros((*x.shape, 6))
        out[..., 0, 0], out[..., 0, 1] = ring[..., 0, 0], ring[..., 0, 1] / 2
        out[..., 1, 0], out[..., 1, 1] = 2 * ring[..., 1, 0], ring[..., 1, 1]
        out[..., 3, :], out[..., 4, :] = n / 2 * out[..., 1, :], -2 * n * out[..., 0, :]
        out[..., 2, 2], out[..., 2, 5] = wave[..., 0, 0], wave[..., 0, 1] / n
        out[..., 5, 2], out[..., 5, 5] = n * wave[..., 1, 0], wave[..., 1, 1]
        return out


def _radial_slope(unit: Array, aim: Array, length: Array, fixed: Array) -> Array:
    """Derivative of ``aim unit`` (fixed) or of the identity, shape (..., 2, 2)."""
    eye = np.eye(2)
    across = eye - unit[..., :, None] * unit[..., None, :]
    return np.asarray(np.where(fixed[..., None, None], (aim / length)[..., None, None] * across, eye))


def stopping_point(x: Array, n: float, acceleration: float) -> Array:
    """States moved to where braking with `acceleration` [m/s^2] per axis brings the velocity error to zero.

    The position moves by ``e |e| / (2 acceleration)`` per axis of the plane, the velocity error of the
    result is zero, and the cross-track motion stays as it is. An estimate (exact without gravity): for
    choosing a reference that needs no return.

    Parameters
    ----------
    x : ndarray, shape (..., 6)

    Returns
    -------
    ndarray, shape (..., 6)
    """
    e = velocity_error(x, n)
    out = np.array(x)
    out[..., :2] += e * np.abs(e) / (2 * acceleration)
    out[..., 3] = n / 2 * out[..., 1]
    out[..., 4] = -2 * n * out[..., 0]
    return out
