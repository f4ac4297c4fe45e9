"""Passively safe manoeuvres: h7 = phi7 (eq. 21) and h8 = phi8 (eq. 22), and their form for sampled data."""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from ...model.system import Array
from ..closest import ClosestApproach, circle_map, map_norms
from ..vectors import dot, rounded_length
from .constraint import Evaluation, Printed
from .motion import MotionBound

BOW = 0.01  # least distance [m] by which a free flight is assumed to stray from its chords


@dataclass(frozen=True, eq=False)
class Passive(Printed):
    """Clear of a sphere for T seconds without thrust: ``inf norm(p(t)) - radius`` [m] over free flight.

    Values larger than `beyond` [m] need not be exact: they may come out smaller, but not below it, and then
    without a gradient.
    """

    COLUMNS: ClassVar[tuple[str, ...]] = ("radius",)
    radius: Array | float
    approach: ClosestApproach
    beyond: float = np.inf

    def value(self, z: Array, sun: ArrayLike = 0.0) -> Array:
        """Return phi7 or phi8 [m] (eqs. 21, 22)."""
        return np.asarray(self.approach(z, np.inf).distance - self.radius)

    def sampled(self) -> "PassiveSegments":
        """Return the form in conditions on chords."""
        return PassiveSegments(self.radius, self.approach, label=self.label)

    @cached_property
    def _largest(self) -> float:
        return float(np.max(self.radius))

    def __call__(self, z: Array, sun: ArrayLike = 0.0) -> Evaluation:
        """Evaluate at states of shape (..., 6)."""
        exact = self.beyond + self._largest
        nearest = self.approach(z, exact)
        near, gradient = nearest.distance <= exact, np.zeros(z.shape)
        if near.any():
            outward, time = rounded_length(nearest.place[near], 1e-9)[1], nearest.when[near][:, None]
            constant, drift, circle, across = (outward @ part for part in self.approach.parts)
            angle = self.approach.mean_motion * time
            gradient[near] = constant + drift * time + circle * np.cos(angle) + across * np.sin(angle)
        return Evaluation(nearest.distance - self.radius, gradient, 0.0)


@dataclass(frozen=True, eq=False)
class PassiveSegments(Passive):
    """Passively safe manoeuvres as conditions on chords: two per stretch of each free flight.

    Over a stretch of length L the flight leaves its chord by at most ``L^2 / 8`` times its acceleration,
    hence by less than ``bow = n^2 L^2 / 8 (amplitude^2 + margin^2)^(1/2)`` (see `circle_map`; the margin
    makes it smooth). A direction is chosen per stretch, towards the chord's point nearest to the origin; the
    flight stays clear there if both ends of the chord lie beyond ``radius + bow`` along that direction.
    Every instant of the flight is covered, not only the closest approach, whose place may jump within a
    period. The directions at the next sample are the best for the chords then, and the bow is a function of
    the state: h at the next sample is no less than what was left of it. Each flight has its radius [m].
    """

    @property
    def repeat(self) -> int:
        """Rows per flight."""
        return 2 * (len(self.approach.times) - 1)

    @cached_property
    def _reach(self) -> tuple[Array, Array, float, float, Array]:
        """Gains of acceleration and jerk for each row; bow per amplitude; margin [m]; map to the circle."""
        gain_a, gain_j = map_norms(self.approach.place_maps)
        n = self.approach.mean_motion
        per_amplitude = float(n * self.approach.times[1]) ** 2 / 8
        ends = np.repeat(np.arange(len(gain_a)), 2)[1:-1]
        return gain_a[ends], gain_j[ends], per_amplitude, BOW / per_amplitude, circle_map(n)

    @property
    def numbers(self) -> tuple[tuple[float, ...], Array]:
        """Numbers of compiled loops: bow, margin, turn of thrust; maps, their norms, maps to the circle."""
        _, _, intersample, margin, to_circle = self._reach
        maps = np.zeros((len(self.approach.times) + 2, 4, 6))
        maps[:-2, :3], maps[-2:, :3] = self.approach.place_maps, to_circle.reshape(2, 3, 6)
        maps[:-2, 3, :2] = np.transpose(map_norms(self.approach.place_maps))
        return (intersample, margin, float(np.linalg.norm(to_circle[:, 3:], 2))), maps

    def __call__(self, z: Array, sun: ArrayLike = 0.0) -> Evaluation:
        """Evaluate K flights, shape (..., K, 6); the rows of a flight follow each other, (..., K rows)."""
        ends = (z @ self.approach.positions).reshape(*z.shape[:-1], -1, 3)
        start, chord = ends[..., :-1, :], np.diff(ends, axis=-2)
        part = np.clip(-dot(start, chord) / np.maximum(dot(chord, chord), 1e-30), 0.0, 1.0)
        outward = rounded_length(start + part[..., None] * chord, 1e-9)[1]
        first = dot(outward, start)
        _, _, per_amplitude, _, to_circle = self._reach
        amplitude, circle = self._amplitude(z)
        h = np.stack([first, first + dot(outward, chord)], axis=-1)
        h = h - (np.asarray(self.radius) + per_amplitude * amplitude)[..., None, None]
        Phi = self.approach.place_maps
        both = [np.einsum("...si,sij->...sj", outward, maps) for maps in (Phi[:-1], Phi[1:])]
        gradient = np.stack(both, axis=-2)
        growth = (per_amplitude / amplitude)[..., None] * (circle @ to_circle)
        gradient -= growth[..., None, None, :]
        shape = (*z.shape[:-2], z.shape[-2] * self.repeat)
        return Evaluation(h.reshape(shape), gradient.reshape(*shape, 6), 0.0)

    def _amplitude(self, z: Array) -> tuple[Array, Array]:
        """Amplitude with its margin [m], and the vectors it is the length of."""
        circle = z @ self._reach[4].T
        return np.sqrt(dot(circle, circle) + self._reach[3] ** 2), circle

    def curvature(self, z: Array, sun: ArrayLike, motion: MotionBound) -> Array:
        """Bound M, for each row."""
        gain_a, gain_j, per_amplitude, margin, to_circle = self._reach
        M = motion.acceleration[..., None] * gain_a + motion.jerk[..., None] * gain_j
        # In free flight the amplitude does not change; thrust moves the turning vectors at this rate.
        rate = np.linalg.norm(to_circle[:, 3:], 2) * motion.thrust
        lower = np.maximum(self._amplitude(z)[0] - rate * motion.period, margin)
        M += (per_amplitude * (rate**2 / lower + self.approach.mean_motion * rate))[..., None]
        return M.reshape(*M.shape[:-2], -1)
