"""Barriers about the velocities: h3 (eq. 14) and h9 to h11 (eq. 23), and their forms for sampled data."""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...model.system import Array
from ..vectors import CENTRE, STANDSTILL, dot, length, rounded_length
from .constraint import Evaluation, Printed, join
from .motion import MotionBound


@dataclass(frozen=True, eq=False)
class Speed(Printed):
    """Slower when nearer: h3 = phi3 (eq. 14), ``nu_0 + nu_1 norm(p) - norm(v)``; nu_0 [m/s], nu_1 [1/s]."""

    docking_speed: float
    slope: float

    def value(self, z: Array, sun: ArrayLike = 0.0) -> Array:
        """Return phi3 [m/s] (eq. 14)."""
        return np.asarray(self.docking_speed + self.slope * length(z[..., :3]) - length(z[..., 3:]))

    def sampled(self) -> "SpeedInSquares":
        """Return the form in squares."""
        return SpeedInSquares(self.docking_speed, self.slope, label=self.label)

    def _parts(self, z: Array) -> tuple[Array, Array, Array, Array]:
        """Allowed speed and the direction outwards; the speed and its direction."""
        # The rounded distance exceeds the distance: at the centre the limit is nu_1 CENTRE / 2 too high,
        # 1e-4 m/s, and only there, ten metres inside the chief.
        distance, outward = rounded_length(z[..., :3], CENTRE)
        return self.docking_speed + self.slope * distance, outward, *rounded_length(z[..., 3:], STANDSTILL)

    def __call__(self, z: Array, sun: ArrayLike = 0.0) -> Evaluation:
        """Evaluate at states of shape (..., 6)."""
        limit, outward, speed, direction = self._parts(z)
        return Evaluation(limit - speed, join(self.slope * outward, -direction), 0.0)


class SpeedInSquares(Speed):
    """phi3 through squares, which stay smooth where the speed is zero.

    ``g = (nu_0 + nu_1 r)^2 - norm(v)^2`` has the sign of phi3. What is returned is ``g / w`` with
    ``w = nu_0 + nu_1 r + norm(v)`` held fixed: its value is that of phi3.
    """

    def __call__(self, z: Array, sun: ArrayLike = 0.0) -> Evaluation:
        """Evaluate at states of shape (..., 6)."""
        limit, outward, speed, _ = self._parts(z)
        gradient = join((2 * limit * self.slope)[..., None] * outward, -2 * z[..., 3:])
        return Evaluation(limit - speed, gradient / (limit + speed)[..., None], 0.0)

    def curvature(self, z: Array, sun: ArrayLike, motion: MotionBound) -> Array:
        """Bound M; less, by and by, where the limit cannot be reached within the period.

        A row that is dropped at once lets a deputy speed up for a period and makes it brake in the next.
        """
        limit, _, speed, _ = self._parts(z)
        D, a = motion.period, motion.acceleration
        change = self.slope * motion.speed * D
        M = 2 * (limit + change) * self.slope * a + 2 * a**2 + 2 * motion.speed * motion.jerk
        slack = np.maximum(limit - change - motion.speed, 0.0)
        return np.asarray(M / (limit + speed) - 2 * slack / D**2)


@dataclass(frozen=True, eq=False)
class Velocity(Printed):
    """Structural limit [m/s] along an axis: h9 to h11 = phi9 to phi11 (eq. 23), ``v_max^2 - v_axis^2``."""

    COLUMNS: ClassVar[tuple[str, ...]] = ("axis",)
    axis: int | NDArray[np.intp]
    limit: float

    def value(self, z: Array, sun: ArrayLike = 0.0) -> Array:
        """Return phi9, phi10 or phi11 [m^2/s^2] (eq. 23)."""
        return np.asarray(self.limit**2 - dot(z[..., 3:], self.direction) ** 2)

    def sampled(self) -> "VelocitySide":
        """Return the form on the nearer side."""
        return VelocitySide(self.axis, self.limit, label=self.label)

    @cached_property
    def direction(self) -> Array:
        """Unit vector along the axis, shape (..., 3)."""
        return np.asarray(np.eye(3)[self.axis])

    def __call__(self, z: Array, sun: ArrayLike = 0.0) -> Evaluation:
        """Evaluate at states of shape (..., 6)."""
        along = dot(z[..., 3:], self.direction)
        by_velocity = -self._slope(along)[..., None] * self.direction
        return Evaluation(self.limit**2 - along**2, join(np.zeros_like(by_velocity), by_velocity), 0.0)

    def _slope(self, along: Array) -> Array:
        return 2 * along


class VelocitySide(Velocity):
    """phi9 to phi11 on the nearer side: ``(v_max - |v_axis|) w``, with ``w = v_max + |v_axis|`` held fixed.

    Linear in the velocity, so that its curvature is the jerk's, and its gradient never vanishes.
    """

    def _slope(self, along: Array) -> Array:
        return np.copysign(self.limit + np.abs(along), along)

    def curvature(self, z: Array, sun: ArrayLike, motion: MotionBound) -> Array:
        """Bound M; ``-inf`` where the limit cannot be reached within the period, ``inf`` where both can."""
        speed = np.abs(dot(z[..., 3:], self.direction))
        change = motion.along * motion.period
        M = np.where(change < self.limit + speed, (self.limit + speed) * motion.jerk, np.inf)
        return np.where(speed + change <= self.limit, -np.inf, M)
