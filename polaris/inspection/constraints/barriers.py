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

from ...model.system import Array
from ..braking import Braking

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
    # The first is quicker for a few vectors, the second for thousands.
    return np.asarray(np.vecdot(a, b) if a.size < 1000 else np.einsum("...i,...i->...", a, b))


def rounded_length(vectors: Array, least: float) -> tuple[Array, Array]:
    """Length and direction, both continuous: below `least` the length is a parabola (never too small)."""
    length = np.sqrt(dot(vectors, vectors))
    if not (length < least).any():
        return length, vectors / length[..., None]
    bounded = np.maximum(length, least)
    rounded = length + (bounded - length) ** 2 / (2 * least)
    return rounded, vectors / bounded[..., None]


def _sideways(vectors: Array, outward: Array, along: Array, distance: Array) -> Array:
    """Change of a direction for a motion along `vectors`: their part across it, over the distance.

    Closer than `CENTRE` a direction is the position over `CENTRE`, and all of the motion changes it.
    """
    if (distance <= CENTRE).any():
        along = np.where(distance > CENTRE, along, 0.0)
        distance = np.maximum(distance, CENTRE)
    return (vectors - along[..., None] * outward) / distance[..., None]


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
        gradient = np.empty(z.shape)
        gradient[..., :3] = slope[..., None] * toward + _sideways(v, toward, away, distance)
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
        delta, normal, _, _, radius = self._geometry(z[..., :3], sun)
        return delta, dot(normal, z[..., 3:] - (z @ self._turn)[..., :3]), radius

    @cached_property
    def _turn(self) -> Array:
        """``z @ turn = [w x p, w x v]`` with ``w = [0, 0, -n]``, shape (6, 6)."""
        n = self.mean_motion
        return np.asarray(np.kron(np.eye(2), [[0.0, -n, 0.0], [n, 0.0, 0.0], [0.0, 0.0, 0.0]]), dtype=float)

    @cached_property
    def _axes(self) -> tuple[Array, Array]:
        """What the cosine and the sine of the sun's angle multiply in the axis."""
        minus = -np.asarray(self.side, dtype=float)[..., None]
        return minus * np.eye(3)[0], minus * np.eye(3)[1]

    def _geometry(self, p: Array, sun: ArrayLike) -> tuple[Array, Array, Array, Array, Array]:
        """Signed distance and its gradient (the normal); the axis, the direction and the distance from it."""
        cosine, sine = np.cos(sun)[..., None], np.sin(sun)[..., None]
        axis = cosine * self._axes[0] + sine * self._axes[1]
        along = dot(p, axis)
        radius, outward = rounded_length(p - along[..., None] * axis, CENTRE)
        c, s = np.cos(self.half_angle), np.sin(self.half_angle)
        return c * radius - s * along, c * outward - s * axis, axis, outward, radius

    def __call__(self, z: Array, sun: ArrayLike) -> Evaluation:
        """Evaluate at states of shape (..., 6)."""
        delta, normal, axis, outward, radius = self._geometry(z[..., :3], sun)
        speed, slope = self.braking(delta)
        turned = z @ self._turn
        slip = z[..., 3:] - turned[..., :3]  # velocity relative to the turning cone
        forward = dot(slip, axis)
        across = slip - forward[..., None] * axis
        away = dot(outward, across)
        c, s = np.cos(self.half_angle), np.sin(self.half_angle)
        gradient = np.empty(z.shape)
        gradient[..., :3] = slope[..., None] * normal + normal @ self._turn[:3, :3]
        gradient[..., :3] += c * _sideways(across, outward, away, radius)
        gradient[..., 3:] = normal
        return Evaluation(speed + c * away - s * forward, gradient, -dot(gradient, turned))


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
