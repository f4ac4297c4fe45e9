"""Constraints on positions: spheres (phi1, phi2, phi6) and sun cones (phi4, phi5).

They brake before a boundary: `Braking` is the speed from which a spacecraft can still stop.

All act on states ``z = [p, v]`` in Hill's frame: of one deputy, or of one relative to another (the motion
is linear, so both obey the same equations). They broadcast over leading axes, and their parameters over
rows, so that one object evaluates a whole family at once. Each is the one account of its constraint: of
phi, of the control-invariant h, of their gradients and explicit changes with time, and of the bound on the
curvature of h between samples.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...model.system import Array
from ..vectors import CENTRE, dot, length, rounded_length, turning
from .constraint import Evaluation, Printed, join
from .motion import MotionBound


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
        distance: Array,
        motion: MotionBound,
        share: float = 1.0,
        outside: NDArray[np.bool_] | bool = True,
    ) -> Array:
        """Bound M on the second derivative of ``-(s(delta) + d(delta)/dt)`` over a period.

        Of delta, the `share` that is a distance [m] from a centre or an axis (or its negative, not `outside`)
        is about a direction that turns. M is inf where that may turn at once, -inf where h cannot become
        negative meanwhile.
        """
        v, push, D = motion.speed, motion.acceleration, motion.period
        nearest = distance - v * D
        near = np.maximum(nearest, CENTRE)
        centripetal = share * v**2 / near  # centripetal, pushes outwards
        low, high = push + np.where(outside, 0.0, centripetal), push + np.where(outside, centripetal, 0.0)
        # third derivative: 3 v_t a_t / r - 3 r' v_t^2 / r^2 + jerk, and r' v_t^2 <= 2 / sqrt(27) v^3
        third = share * (3 * v * push / near + 1.155 * v**3 / near**2) + motion.jerk
        slowest, quickest = rate - low * D, rate + high * D
        closest = delta + np.minimum(slowest, 0.0) * D
        farthest = delta + np.maximum(quickest, 0.0) * D
        fastest = np.maximum(np.abs(slowest), np.abs(quickest))
        M = self.bend(closest, farthest) * fastest**2 + self.steepest(closest, farthest) * low + third
        M = np.where(nearest > CENTRE, M, np.inf)
        return np.where((self(closest)[0] + slowest >= 0) & (closest >= 0), -np.inf, M)


def sun_angle(vectors: Array, sun: Array) -> Array:
    """Angle [rad] between vectors and the direction of the sun; pi where a vector is zero."""
    x, y = np.cos(sun), np.sin(sun)
    along = vectors[..., 0] * x + vectors[..., 1] * y
    across = np.hypot(vectors[..., 1] * x - vectors[..., 0] * y, vectors[..., 2])
    angle = np.arctan2(across, along)  # as accurate near 0 as anywhere, unlike the arc cosine of eq. 16
    return np.where((along == 0) & (across == 0), np.pi, angle)


@dataclass(frozen=True, eq=False)
class Radial(Printed):
    """Stop before a sphere: h1 (eq. 29), h2 (eq. 30) from outside (`side` +1), h6 (eq. 36) from inside (-1).

    ``h = s(delta) + d(delta)/dt`` with ``delta = side (norm(p) - radius)`` [m]; the braking has a_max for one
    deputy, 2 a_max for two that both brake.
    """

    COLUMNS: ClassVar[tuple[str, ...]] = ("radius", "braking", "side")
    radius: Array | float
    braking: Braking
    side: Array | float = 1.0

    def value(self, z: Array, sun: ArrayLike = 0.0) -> Array:
        """Return phi1, phi2 or phi6 [m] (eqs. 12, 13, 19)."""
        return np.asarray(self.side * (length(z[..., :3]) - self.radius))

    def __call__(self, z: Array, sun: ArrayLike = 0.0) -> Evaluation:
        """Evaluate at states of shape (..., 6)."""
        p, v = z[..., :3], z[..., 3:]
        distance, toward = rounded_length(p, CENTRE)
        speed, slope = self.braking(self.side * (distance - self.radius))
        rate = dot(toward, v)
        gradient = join(slope[..., None] * toward + turning(v, toward, rate, distance), toward)
        gradient *= np.asarray(self.side)[..., None]
        return Evaluation(speed + self.side * rate, gradient, 0.0)

    def curvature(self, z: Array, sun: ArrayLike, motion: MotionBound) -> Array:
        """Bound M; see `Constraint.curvature`."""
        distance, outward = rounded_length(z[..., :3], CENTRE)
        delta = np.asarray(self.side * (distance - self.radius))
        rate = np.asarray(self.side * dot(outward, z[..., 3:]))
        return self.braking.curvature(delta, rate, distance, motion, outside=np.asarray(self.side) > 0)


@dataclass(frozen=True, eq=False)
class SunCone(Printed):
    """Stop before the cone of positions from which the sensor would see the sun: h4, h5 (eqs. 33 to 35).

    The cone has its apex at the origin, its axis along ``-r_s`` (`side` +1) or ``r_s`` (-1) and half the
    field of view as its angle theta [rad]. Let ``delta = cos(theta) norm(p_perp) - sin(theta) <p, axis>``,
    the signed distance from the line through the apex that eq. 34 projects onto. The cone turns with the
    sun, at -n (theory, item 16), so that ``d(delta)/dt = <normal, v - w x p>`` with ``w = [0, 0, -n]``, and
    ``h = s(delta) + d(delta)/dt``.

    For a pair of deputies both cones count, the one about ``-r_s`` and the one about ``r_s``: eq. 35's
    choice of the nearer jumps where they are equally near.
    """

    COLUMNS: ClassVar[tuple[str, ...]] = ("braking", "side")
    half_angle: float
    mean_motion: float
    braking: Braking
    side: Array | float = 1.0

    @property
    def row(self) -> str:
        """Name of its rows; for pairs with the side."""
        return super().row + (("+" if self.side == 1 else "-") if self.pair else "")

    def value(self, z: Array, sun: ArrayLike = 0.0) -> Array:
        """Return phi4, or the part of phi5 of its side [rad] (eqs. 15 to 18)."""
        angle = sun_angle(-z[..., :3], np.asarray(sun, dtype=float))
        return np.asarray(np.where(np.asarray(self.side) > 0, angle, np.pi - angle) - self.half_angle)

    @cached_property
    def _turn(self) -> Array:
        """``z @ turn = [w x p, w x v]`` with ``w = [0, 0, -n]``, shape (6, 6)."""
        n = self.mean_motion
        return np.asarray(np.kron(np.eye(2), [[0.0, -n, 0.0], [n, 0.0, 0.0], [0.0, 0.0, 0.0]]), dtype=float)

    @cached_property
    def _opening(self) -> tuple[float, float]:
        """Cosine and sine of the half-angle."""
        return float(np.cos(self.half_angle)), float(np.sin(self.half_angle))

    @cached_property
    def _axes(self) -> tuple[Array, Array]:
        """Vectors that the cosine and the sine of the sun's angle multiply in the axis."""
        minus = -np.asarray(self.side, dtype=float)[..., None]
        return minus * np.eye(3)[0], minus * np.eye(3)[1]

    def _geometry(self, p: Array, sun: ArrayLike) -> tuple[Array, Array, Array, Array, Array]:
        """Signed distance and its gradient (the normal); the axis, the direction and the distance from it."""
        cosine, sine = np.cos(sun)[..., None], np.sin(sun)[..., None]
        axis = cosine * self._axes[0] + sine * self._axes[1]
        along = dot(p, axis)
        radius, outward = rounded_length(p - along[..., None] * axis, CENTRE)
        c, s = self._opening
        return c * radius - s * along, c * outward - s * axis, axis, outward, radius

    def __call__(self, z: Array, sun: ArrayLike = 0.0) -> Evaluation:
        """Evaluate at states of shape (..., 6)."""
        delta, normal, axis, outward, radius = self._geometry(z[..., :3], sun)
        speed, slope = self.braking(delta)
        rotation = z @ self._turn
        slip = z[..., 3:] - rotation[..., :3]  # velocity relative to the turning cone
        forward = dot(slip, axis)
        across = slip - forward[..., None] * axis
        rate = dot(outward, across)
        c, s = self._opening
        by_position = slope[..., None] * normal + normal @ self._turn[:3, :3]
        gradient = join(by_position + c * turning(across, outward, rate, radius), normal)
        return Evaluation(speed + c * rate - s * forward, gradient, -dot(gradient, rotation))

    def curvature(self, z: Array, sun: ArrayLike, motion: MotionBound) -> Array:
        """Bound M; see `Constraint.curvature`."""
        n = self.mean_motion
        delta, normal, _, _, radius = self._geometry(z[..., :3], sun)
        rate = dot(normal, z[..., 3:] - (z @ self._turn)[..., :3])
        distance = length(z[..., :3]) + motion.speed * motion.period
        # Everything as seen from the turning cone.
        slip = motion.speed + n * distance
        push = motion.acceleration + 2 * n * slip + n**2 * distance
        jerk = motion.jerk + n * motion.acceleration + 2 * n * push + n**2 * slip
        relative = MotionBound(motion.period, slip, push, jerk, motion.thrust, motion.along)
        return self.braking.curvature(delta, rate, radius, relative, np.cos(self.half_angle))
