"""Sampled-data safety: barrier conditions that hold between samples, not only at them.

The filter holds its input for a period D. If ``d^2 h / dt^2 >= -M`` over the period whatever the admissible
input, then ``h(t) >= h + t dh/dt - M t^2 / 2``, which is concave in t; so

    dh/dt >= -share h / D + M D / 2,    0 < share <= 1,

at the sample keeps ``h >= (1 - share) h >= 0`` over the whole period. This module bounds M for each barrier
from the state at the sample. A row that no admissible input can break within the period gets ``-inf``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..checks import positive
from ..errors import ScenarioError
from ..system import Array
from .barriers import CENTRE, STANDSTILL, Evaluation, Radial, SunCone, Velocity, dot, rounded_length
from .braking import Braking
from .closest import ClosestApproach


@dataclass(frozen=True)
class SampledData:
    """How the barrier conditions are tightened.

    Parameters
    ----------
    period : float
        Control period D [s].
    share : float
        Part of h that may be lost in one period, in (0, 1]. Less is calmer.
    """

    period: float
    share: float = 0.5

    def __post_init__(self) -> None:
        positive("period", self.period, "s")
        if not 0 < self.share <= 1:
            raise ScenarioError("share", self.share, "must be in (0, 1]")

    def motion(self, z: Array, drift: Array, n: float, thrust: Array) -> Motion:
        """Bounds over the period for states with the natural rates `drift` and thrust below a bound [m/s^2]."""
        D = self.period
        speed = np.sqrt(dot(z[..., 3:], z[..., 3:]))
        natural = np.sqrt(dot(drift[..., 3:], drift[..., 3:]))
        # a <= natural + thrust + 3 n^2 (speed + a D) D + 2 n a D, solved for a.
        a = (natural + thrust + 3 * n**2 * speed * D) / (1 - 2 * n * D - 3 * n**2 * D**2)
        fastest = speed + a * D
        return Motion(D, fastest, a, 3 * n**2 * fastest + 2 * n * a)


@dataclass(frozen=True, eq=False)
class Motion:
    """Bounds on the motion over one period, each of shape (...).

    Attributes
    ----------
    period : float
        [s]
    speed, acceleration, jerk : ndarray
        [m/s], [m/s^2], [m/s^3]
    """

    period: float
    speed: Array
    acceleration: Array
    jerk: Array

    def __getitem__(self, place: object) -> Motion:
        """The bounds of some states."""
        at = (..., place)
        return Motion(self.period, self.speed[at], self.acceleration[at], self.jerk[at])  # type: ignore[index]


def curvature(barrier: object, z: Array, sun: ArrayLike, motion: Motion) -> Array:
    """Bound M on ``-d^2 h / dt^2``; ``-inf`` where h cannot become negative within the period."""
    if isinstance(barrier, Radial):
        return _radial(barrier, z, motion)
    if isinstance(barrier, SunCone):
        return _cone(barrier, z, sun, motion)
    if isinstance(barrier, Velocity):
        return 2 * motion.acceleration**2 + 2 * motion.speed * motion.jerk
    if isinstance(barrier, (SpeedInSquares, PassiveSegments)):
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
    delta, rate = side * (distance - barrier.radius), side * dot(outward, z[..., 3:])
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
    smooth: Array,
    D: float,
) -> Array:
    """M of ``s(delta) + delta'`` where ``-low <= delta'' <= high`` and ``delta''' >= -third``."""
    slowest = rate - low * D
    closest = delta + np.minimum(slowest, 0.0) * D
    speed, slope = braking(closest)
    bend = braking.bend(closest)
    fastest = np.maximum(np.abs(slowest), np.abs(rate + high * D))
    M = bend * fastest**2 + slope * low + third
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


@dataclass(frozen=True, eq=False)
class PassiveSegments:
    """Passively safe manoeuvres as linear conditions: two per stretch of each free flight.

    Over a stretch of the flight the position stays within a bound ``bow`` of the chord. A direction is
    chosen per stretch (towards the chord's point nearest to the origin); the flight stays clear there if
    both ends of the chord lie beyond ``radius + bow`` along that direction. Every instant of the flight is
    covered, not only the closest approach, whose place may jump within a period.

    Parameters
    ----------
    name : str
    radius : array_like, shape (K,)
        One for each flight [m].
    approach : ClosestApproach
    """

    name: str
    radius: ArrayLike
    approach: ClosestApproach

    @property
    def rows(self) -> int:
        """Rows per flight."""
        return 2 * (len(self.approach.times) - 1)

    def __call__(self, z: Array, sun: ArrayLike = 0.0) -> Evaluation:
        """Evaluate K flights, shape (..., K, 6); the rows of a flight follow each other, (..., K rows)."""
        ends = (z @ self.approach.positions).reshape(*z.shape[:-1], -1, 3)
        start, chord = ends[..., :-1, :], np.diff(ends, axis=-2)
        part = np.clip(-dot(start, chord) / np.maximum(dot(chord, chord), 1e-30), 0.0, 1.0)
        outward = rounded_length(start + part[..., None] * chord, 1e-9)[1]
        first = dot(outward, start)
        h = np.stack([first, first + dot(outward, chord)], axis=-1)
        h = h - (np.asarray(self.radius) + self._bow(z))[..., None, None]
        Phi = self.approach.place_maps
        gradient = np.stack(
            [
                np.einsum("...si,sij->...sj", outward, Phi[:-1]),
                np.einsum("...si,sij->...sj", outward, Phi[1:]),
            ],
            axis=-2,
        )
        shape = (*z.shape[:-2], z.shape[-2] * self.rows)
        return Evaluation(h.reshape(shape), gradient.reshape(*shape, 6), 0.0)

    def _bow(self, z: Array) -> Array:
        """How far a flight strays from its chords [m], also after a period's change of the state."""
        gain_p, gain_v = self.approach.acceleration_gain
        p, v = (np.sqrt(dot(z[..., part], z[..., part])) for part in (np.s_[:3], np.s_[3:]))
        return 1.05 * (gain_p * (p + 20.0) + gain_v * (v + 1.0)) * self.approach.times[1] ** 2 / 8

    def curvature(self, z: Array, motion: Motion) -> Array:
        """Bound M, for each row."""
        gain_a, gain_j = self.approach.place_gain
        M = gain_a * motion.acceleration + gain_j * motion.jerk
        return np.repeat(M, self.rows, axis=-1)
