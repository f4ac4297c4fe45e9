"""Sampled-data safety: barrier conditions that hold between samples, not only at them.

The filter holds its input for a period D. If ``d^2 h / dt^2 >= -M`` over the period whatever the admissible
input, then ``h(t) >= h + t dh/dt - M t^2 / 2``. So

    dh/dt >= -share h / D + M D / 2,    0 < share <= 1,

at the sample gives ``h(t) >= (1 - share t / D) h + M t (D - t) / 2 >= (1 - share) h`` over the whole period.
This module bounds M for each barrier from the state at the sample. A row that no admissible input can make
negative within the period gets ``-inf``: it may be dropped. One for which there is no bound gets ``inf``: no
input satisfies it. The proofs are in ``docs/inspection-theory.md``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...model.checks import number, positive
from ...model.errors import ScenarioError
from ...model.system import Array
from ..braking import Braking
from .barriers import CENTRE, STANDSTILL, Evaluation, Radial, SunCone, Velocity, dot, rounded_length
from .segments import PassiveSegments


@dataclass(frozen=True)
class SampledData:
    """How the barrier conditions are tightened.

    Parameters
    ----------
    period : float
        Control period D [s].
    share : float
        Part of h that may be lost in one period, in (0, 1]. Less is calmer.

    Raises
    ------
    ScenarioError
        If a number is out of range.
    """

    period: float
    share: float = 0.5

    def __post_init__(self) -> None:
        positive("period", self.period, "s")
        if not 0 < number("share", self.share) <= 1:
            raise ScenarioError("share", self.share, "must be in (0, 1]")

    def growth(self, n: float) -> float:
        """How much larger than at its start the acceleration may be within a period.

        Raises
        ------
        ScenarioError
            If the period is so long that there is no bound: ``2 n D + 3 (n D)^2 >= 1``, D above 1 / (3 n).
        """
        D = self.period
        rest = 1 - 2 * n * D - 3 * n**2 * D**2
        if rest <= 0:
            raise ScenarioError(
                "period", D, f"must be below {1 / (3 * n):.6g} s, a third over the mean motion"
            )
        return 1 / rest

    def motion(self, z: Array, drift: Array, n: float, thrust: Array) -> Motion:
        """Bounds over the period.

        Parameters
        ----------
        z : ndarray, shape (..., 6)
            States of deputies, or of deputies relative to each other, at the sample.
        drift : ndarray, shape (..., 6)
            Their natural rates.
        n : float
            Mean motion [rad/s].
        thrust : ndarray, shape (...)
            Largest acceleration by thrust [m/s^2].
        """
        D = self.period
        speed = np.sqrt(dot(z[..., 3:], z[..., 3:]))
        natural = np.sqrt(dot(drift[..., 3:], drift[..., 3:]))
        # a <= natural + thrust + 3 n^2 (speed + a D) D + 2 n a D, solved for a.
        a = (natural + thrust + 3 * n**2 * speed * D) * self.growth(n)
        fastest = speed + a * D
        return Motion(D, fastest, a, 3 * n**2 * fastest + 2 * n * a, np.asarray(thrust, dtype=float))


@dataclass(frozen=True, eq=False)
class Motion:
    """Bounds on the motion over one period, each of shape (...).

    Attributes
    ----------
    period : float
        [s]
    speed, acceleration, jerk, thrust : ndarray
        [m/s], [m/s^2], [m/s^3]; thrust is the part of the acceleration that is held [m/s^2].
    """

    period: float
    speed: Array
    acceleration: Array
    jerk: Array
    thrust: Array

    def __getitem__(self, place: NDArray[np.intp] | slice) -> Motion:
        """The bounds of some states."""
        parts = (self.speed, self.acceleration, self.jerk, self.thrust)
        return Motion(self.period, *(part[..., place] for part in parts))


def curvature(barrier: object, z: Array, sun: ArrayLike, motion: Motion) -> Array:
    """Bound M on ``-d^2 h / dt^2``; ``-inf`` where h cannot become negative within the period."""
    if isinstance(barrier, Radial):
        return _radial(barrier, z, motion)
    if isinstance(barrier, SunCone):
        return _cone(barrier, z, sun, motion)
    if isinstance(barrier, (SpeedInSquares, VelocitySide, PassiveSegments)):
        return barrier.curvature(z, motion)
    raise TypeError(f"no bound for {type(barrier).__name__}")


def _radial(barrier: Radial, z: Array, motion: Motion) -> Array:
    side = np.asarray(barrier.side)
    distance, outward = rounded_length(z[..., :3], CENTRE)
    nearest = distance - motion.speed * motion.period
    near = np.maximum(nearest, CENTRE)
    around = motion.speed**2 / near  # centripetal, pushes outwards
    low = motion.acceleration + np.where(side > 0, 0.0, around)
    high = motion.acceleration + np.where(side > 0, around, 0.0)
    # third derivative: 3 v_t a_t / r - 3 r' v_t^2 / r^2 + jerk, and r' v_t^2 <= 2 / sqrt(27) speed^3
    third = 3 * motion.speed * motion.acceleration / near + 1.155 * motion.speed**3 / near**2 + motion.jerk
    delta = np.asarray(side * (distance - np.asarray(barrier.radius)))
    rate = np.asarray(side * dot(outward, z[..., 3:]))
    return _braked(barrier.braking, delta, rate, low, high, third, nearest > CENTRE, motion.period)


def _cone(barrier: SunCone, z: Array, sun: ArrayLike, motion: Motion) -> Array:
    n, D = barrier.mean_motion, motion.period
    delta, rate, radius = barrier.approach(z, sun)
    far = np.sqrt(dot(z[..., :3], z[..., :3])) + motion.speed * D
    # Everything as seen from the turning cone.
    slip = motion.speed + n * far
    push = motion.acceleration + 2 * n * slip + n**2 * far
    jerk = motion.jerk + n * motion.acceleration + 2 * n * push + n**2 * slip
    nearest = radius - slip * D
    near = np.maximum(nearest, CENTRE)
    c = np.cos(barrier.half_angle)
    third = c * (3 * slip * push / near + 1.155 * slip**3 / near**2) + jerk
    return _braked(barrier.braking, delta, rate, push, push + c * slip**2 / near, third, nearest > CENTRE, D)


def _braked(
    braking: Braking,
    delta: Array,
    rate: Array,
    low: Array,
    high: Array,
    third: Array,
    smooth: NDArray[np.bool_],
    D: float,
) -> Array:
    """M of ``s(delta) + delta'`` where ``-low <= delta'' <= high`` and ``delta''' >= -third``."""
    slowest = rate - low * D
    quickest = rate + high * D
    closest = delta + np.minimum(slowest, 0.0) * D
    farthest = delta + np.maximum(quickest, 0.0) * D
    fastest = np.maximum(np.abs(slowest), np.abs(quickest))
    M = braking.bend(closest, farthest) * fastest**2 + braking.steepest(closest, farthest) * low + third
    speed = braking(closest)[0]
    M = np.where(smooth, M, np.inf)  # the direction may turn at once: no bound
    return np.where((speed + slowest >= 0) & (closest >= 0), -np.inf, M)


@dataclass(frozen=True, eq=False)
class SpeedInSquares:
    """phi3 through squares, which stay smooth where the speed is zero.

    ``g = (nu_0 + nu_1 r)^2 - norm(v)^2`` has the sign of phi3. What is returned is ``g / w`` with
    ``w = nu_0 + nu_1 r + norm(v)`` held fixed: its value is that of phi3.

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
        limit, speed, outward = self._parts(z)
        gradient = np.empty(z.shape)
        gradient[..., :3] = (2 * limit * self.slope)[..., None] * outward
        gradient[..., 3:] = -2 * z[..., 3:]
        return Evaluation(limit - speed, gradient / (limit + speed)[..., None], 0.0)

    def _parts(self, z: Array) -> tuple[Array, Array, Array]:
        distance, outward = rounded_length(z[..., :3], CENTRE)
        speed = rounded_length(z[..., 3:], STANDSTILL)[0]
        return self.docking_speed + self.slope * distance, speed, outward

    def curvature(self, z: Array, motion: Motion) -> Array:
        """Bound M; ``-inf`` where the limit cannot be reached within the period."""
        limit, speed, _ = self._parts(z)
        D, a = motion.period, motion.acceleration
        change = self.slope * motion.speed * D
        M = 2 * (limit + change) * self.slope * a + 2 * a**2 + 2 * motion.speed * motion.jerk
        return np.where(motion.speed <= limit - change, -np.inf, M / (limit + speed))


class VelocitySide(Velocity):
    """phi9 to phi11 on the nearer side: ``(v_max - |v_axis|) w``, with ``w = v_max + |v_axis|`` held fixed.

    Linear in the velocity, so that its curvature is the jerk's, and its gradient never vanishes.
    """

    def __call__(self, z: Array, sun: ArrayLike = 0.0) -> Evaluation:
        """Evaluate at states of shape (..., 6)."""
        along = dot(z[..., 3:], self.direction)
        gradient = np.zeros(z.shape)
        gradient[..., 3:] = -np.copysign(self.limit + np.abs(along), along)[..., None] * self.direction
        return Evaluation(self.limit**2 - along**2, gradient, 0.0)

    def curvature(self, z: Array, motion: Motion) -> Array:
        """Bound M; ``-inf`` where the limit cannot be reached within the period, ``inf`` where both can."""
        speed = np.abs(dot(z[..., 3:], self.direction))
        # Thrust is within a box whose half-diagonal is motion.thrust; the rest is natural motion.
        change = (motion.acceleration - (1 - 1 / np.sqrt(3)) * motion.thrust) * motion.period
        M = np.where(change < self.limit + speed, (self.limit + speed) * motion.jerk, np.inf)
        return np.where(speed + change <= self.limit, -np.inf, M)
