"""Control-invariant constraints h1 to h6 and h9 to h11: value, gradient, explicit change with time.

All act on states ``z = [p, v]`` in Hill's frame: of one deputy, or of one relative to another (the motion
is linear, so both obey the same equations). They broadcast over leading axes, and their parameters over
rows, so that one object evaluates a whole family at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..system import Array
from .braking import Braking

CENTRE = 0.1
"""Below this distance [m] from a centre or an axis, directions fade to zero instead of jumping.

Both lie inside what must be avoided, or are far from any boundary: nothing admissible is changed.
"""

STANDSTILL = 1e-6
"""Below this speed [m/s] the length of the velocity is rounded off, upwards by at most half of it."""


class Evaluation(NamedTuple):
    """A barrier at some states.

    Attributes
    ----------
    h : ndarray, shape (...)
        Value, >= 0 inside.
    gradient : ndarray, shape (..., 6)
        With respect to the state.
    change : ndarray, shape (...) or float
        Partial derivative with respect to time [1/s].
    """

    h: Array
    gradient: Array
    change: Array | float


class Barrier(Protocol):
    """A control-invariant constraint ``h(t, z) >= 0``."""

    @property
    def name(self) -> str:
        """What it is called."""
        ...

    def __call__(self, z: Array, sun: ArrayLike) -> Evaluation:
        """Evaluate at states of shape (..., 6) and sun angles [rad] that broadcast against (...)."""
        ...


def dot(a: Array, b: Array) -> Array:
    """Inner products along the last axis."""
    return np.asarray(np.einsum("...i,...i->...", a, b))


def rounded_length(vectors: Array, least: float) -> tuple[Array, Array]:
    """Length and direction, both continuous: below `least` the length is a parabola (never too small)."""
    length = np.sqrt(dot(vectors, vectors))
    bounded = np.maximum(length, least)
    rounded = length + (bounded - length) ** 2 / (2 * least)
    return rounded, vectors / bounded[..., None]


@dataclass(frozen=True, eq=False)
class Radial:
    """Stop before a sphere: h1 (eq. 29), h2 (eq. 30) from outside, h6 (eq. 36) from inside.

    ``h = s(delta) + d(delta)/dt`` with ``delta = side (norm(p) - radius)``.

    Parameters
    ----------
    name : str
    radius : array_like
        [m]
    braking : Braking
        With a_max for one deputy, 2 a_max for two that both brake.
    side : array_like
        +1 to stay outside, -1 to stay inside.
    """

    name: str
    radius: Array | float
    braking: Braking
    side: Array | float = 1.0

    def __call__(self, z: Array, sun: ArrayLike = 0.0) -> Evaluation:
        """Evaluate at states of shape (..., 6)."""
        p, v = z[..., :3], z[..., 3:]
        distance, toward = rounded_length(p, CENTRE)
        speed, slope = self.braking(self.side * (distance - self.radius))
        away = dot(toward, v)
        across = v - np.where(distance > CENTRE, away, 0.0)[..., None] * toward
        gradient = np.empty(z.shape)
        gradient[..., :3] = slope[..., None] * toward + across / np.maximum(distance, CENTRE)[..., None]
        gradient[..., 3:] = toward
        gradient *= np.asarray(self.side)[..., None]
        return Evaluation(speed + self.side * away, gradient, 0.0)


@dataclass(frozen=True, eq=False)
class Speed:
    """Slower when nearer: h3 = phi3 (eq. 14), ``nu_0 + nu_1 norm(p) - norm(v)``.

    Parameters
    ----------
    name : str
    docking_speed : float
        nu_0 [m/s].
    slope : float
        nu_1 [1/s].
    """

    name: str
    docking_speed: float
    slope: float

    def __call__(self, z: Array, sun: ArrayLike = 0.0) -> Evaluation:
        """Evaluate at states of shape (..., 6)."""
        # The rounded distance exceeds the distance: at the centre the limit is nu_1 CENTRE / 2 too high,
        # 1e-4 m/s, and only there, ten metres inside the chief.
        distance, outward = rounded_length(z[..., :3], CENTRE)
        speed, ahead = rounded_length(z[..., 3:], STANDSTILL)
        gradient = np.empty(z.shape)
        gradient[..., :3] = self.slope * outward
        gradient[..., 3:] = -ahead
        return Evaluation(self.docking_speed + self.slope * distance - speed, gradient, 0.0)


@dataclass(frozen=True, eq=False)
class SunCone:
    """Stop before the cone of positions from which the sensor would see the sun: h4, h5 (eqs. 33 to 35).

    The cone has its apex at the origin, its axis along ``-r_s`` (`side` +1) and half the field of view
    as its angle. Let ``delta = cos(theta) norm(p_perp) - sin(theta) <p, axis>``, the signed distance from
    the line through the apex that eq. 34 projects onto. The cone turns with the sun, at -n (theory, item
    16), so that ``d(delta)/dt = <normal, v - w x p>`` with ``w = [0, 0, -n]``, and
    ``h = s(delta) + d(delta)/dt``.

    For a pair of deputies both cones count, the one about ``-r_s`` and the one about ``r_s``: eq. 35's
    choice of the nearer jumps where they are equally near.

    Parameters
    ----------
    name : str
    half_angle : float
        theta [rad].
    mean_motion : float
        n [rad/s].
    braking : Braking
    side : array_like
        +1 for the cone about ``-r_s``, -1 for the one about ``r_s``.
    """

    name: str
    half_angle: float
    mean_motion: float
    braking: Braking
    side: Array | float = 1.0

    def approach(self, z: Array, sun: ArrayLike) -> tuple[Array, Array, Array]:
        """Signed distance [m], its rate [m/s] and the distance from the axis [m], each of shape (...)."""
        delta, normal, _, radius = self._geometry(z[..., :3], sun)
        return delta, dot(normal, z[..., 3:] - _turn(z[..., :3], self.mean_motion)), radius

    def _geometry(self, p: Array, sun: ArrayLike) -> tuple[Array, Array, Array, Array]:
        """Signed distance, its gradient (the normal), the axis and the distance from it."""
        axis = np.empty(np.broadcast_shapes(p.shape, (*np.shape(sun), 3)))
        axis[..., 0] = -self.side * np.cos(sun)
        axis[..., 1] = -self.side * np.sin(sun)
        axis[..., 2] = 0.0
        along = dot(p, axis)
        radius, outward = rounded_length(p - along[..., None] * axis, CENTRE)
        c, s = np.cos(self.half_angle), np.sin(self.half_angle)
        return c * radius - s * along, c * outward - s * axis, axis, radius

    def __call__(self, z: Array, sun: ArrayLike) -> Evaluation:
        """Evaluate at states of shape (..., 6)."""
        p, v = z[..., :3], z[..., 3:]
        delta, normal, axis, radius = self._geometry(p, sun)
        speed, slope = self.braking(delta)
        n = self.mean_motion
        slip = v - _turn(p, n)  # velocity relative to the turning cone
        rate = dot(normal, slip)
        # Change of the normal with the position, along the slip.
        across = slip - dot(slip, axis)[..., None] * axis
        outward = (normal + np.sin(self.half_angle) * axis) / np.cos(self.half_angle)
        far = radius > CENTRE
        straight = np.where(far, dot(outward, across), 0.0)[..., None] * outward
        bend = np.cos(self.half_angle) / np.maximum(radius, CENTRE)
        gradient = np.empty(p.shape[:-1] + (6,))
        gradient[..., :3] = (
            slope[..., None] * normal + bend[..., None] * (across - straight) + _turn(normal, n)
        )
        gradient[..., 3:] = normal
        change = -dot(gradient[..., :3], _turn(p, n)) - dot(normal, _turn(v, n))
        return Evaluation(speed + rate, gradient, change)


def _turn(vectors: Array, n: float) -> Array:
    """``[0, 0, -n] x vectors``."""
    turned = np.zeros(vectors.shape)
    turned[..., 0] = n * vectors[..., 1]
    turned[..., 1] = -n * vectors[..., 0]
    return turned


@dataclass(frozen=True, eq=False)
class Velocity:
    """Structural limit along one axis: h9, h10, h11 = phi9, phi10, phi11 (eq. 23), ``v_max^2 - v_axis^2``.

    Parameters
    ----------
    name : str
    axis : int or array of int
        0, 1 or 2.
    limit : float
        v_max [m/s].
    """

    name: str
    axis: int | NDArray[np.intp]
    limit: float

    @cached_property
    def direction(self) -> Array:
        """Unit vector along the axis, shape (..., 3)."""
        return np.asarray(np.eye(3)[self.axis])

    def __call__(self, z: Array, sun: ArrayLike = 0.0) -> Evaluation:
        """Evaluate at states of shape (..., 6)."""
        along = dot(z[..., 3:], self.direction)
        gradient = np.zeros(z.shape)
        gradient[..., 3:] = (-2 * along)[..., None] * self.direction
        return Evaluation(self.limit**2 - along**2, gradient, 0.0)
