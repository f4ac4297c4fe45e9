"""Closest approach to the origin in free flight, over continuous time (eqs. 20 to 22)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..hill import cw_matrix, free_flight
from ..system import Array
from .barriers import dot

SEGMENT = 20.0
"""Spacing [s] of the instants at which every free flight is looked at first."""

NEWTON = 30
"""Most steps per minimum: Newton's converge in three or four, bisection alone in thirty."""

BLOCK = 1024
"""Flights looked at together: what fits into fast memory."""


class Approach(NamedTuple):
    """Closest approaches.

    Attributes
    ----------
    distance : ndarray, shape (...)
        Least distance from the origin [m].
    when : ndarray, shape (...)
        Time of flight at which it is reached [s].
    place : ndarray, shape (..., 3)
        Position there [m].
    """

    distance: Array
    when: Array
    place: Array


class FreeFlight:
    """Free flights in closed form (eq. 20): ``p(t) = a + b t + c cos(n t) + d sin(n t)``."""

    def __init__(self, z: Array, n: float) -> None:
        x, y, zz, vx, vy, vz = z.T
        o = np.zeros_like(x)
        self.n = n
        self.a = np.stack([4 * x + 2 / n * vy, y - 2 / n * vx, o], axis=-1)
        self.b = np.stack([o, -6 * n * x - 3 * vy, o], axis=-1)
        self.c = np.stack([-3 * x - 2 / n * vy, 2 / n * vx, zz], axis=-1)
        self.d = np.stack([vx / n, 6 * x + 4 / n * vy, vz / n], axis=-1)

    def __call__(self, t: Array) -> tuple[Array, Array, Array]:
        """Position, velocity and acceleration at the time t of each flight."""
        s, c = np.sin(self.n * t)[:, None], np.cos(self.n * t)[:, None]
        circle = self.c * c + self.d * s
        across = self.d * c - self.c * s
        return self.a + self.b * t[:, None] + circle, self.b + self.n * across, -(self.n**2) * circle


class ClosestApproach:
    """Least distance from the origin during a free flight of length T.

    At instants `SEGMENT` apart the distance and its rate are known in closed form. Between two of them
    the distance can have a minimum only if the rate changes its sign there, or nearly does; those minima
    are found by Newton steps on the closed form, held in their bracket.

    Parameters
    ----------
    mean_motion : float
        n [rad/s].
    duration : float
        T [s], at most half an orbit.
    """

    def __init__(self, mean_motion: float, duration: float) -> None:
        self.mean_motion, self.duration = mean_motion, duration
        self.times = np.linspace(0.0, duration, max(2, int(np.ceil(duration / SEGMENT)) + 1))
        transitions = free_flight(mean_motion, self.times)
        self.positions = np.ascontiguousarray(transitions[:, :3].reshape(-1, 6).T)
        self.velocities = np.ascontiguousarray(transitions[:, 3:].reshape(-1, 6).T)
        # Speed of a flight <= gain_p norm(p) + gain_v norm(v), acceleration alike. The norms change by less than 4 n times
        # their unit per second, and no time is further than half a segment from one looked at.
        slack = 4 * mean_motion * SEGMENT
        g_p, g_v = _norms(transitions[:, 3:])
        self.speed_gain = (g_p + slack * mean_motion, g_v + slack)
        g_p, g_v = _norms(cw_matrix(mean_motion)[3:] @ transitions)
        self.acceleration_gain = (g_p + slack * mean_motion**2, g_v + slack * mean_motion)
        self.place_maps = transitions[:, :3]
        self.place_gain = _norms(self.place_maps)

    def __call__(self, z: Array, beyond: float = np.inf) -> Approach:
        """Find the closest approach of every flight.

        Parameters
        ----------
        z : ndarray, shape (..., 6)
            States at the start.
        beyond : float
            Distances larger than this need not be exact: they may come out smaller, but not below it.
        """
        flat = z.reshape(-1, 6)
        if len(flat) <= BLOCK:
            found = [self._block(flat, beyond)]
        else:
            found = [self._block(flat[k : k + BLOCK], beyond) for k in range(0, len(flat), BLOCK)]
        distance, when, place = (
            np.concatenate(part) if len(found) > 1 else part[0] for part in zip(*found, strict=True)
        )
        shape = z.shape[:-1]
        return Approach(distance.reshape(shape), when.reshape(shape), place.reshape(*shape, 3))

    def _block(self, z: Array, beyond: float) -> Approach:
        places = (z @ self.positions).reshape(len(z), -1, 3)
        squares = dot(places, places)
        nearest = squares.argmin(axis=1)
        every = np.arange(len(z))
        found = Approach(np.sqrt(squares[every, nearest]), self.times[nearest], places[every, nearest])
        if beyond == np.inf:
            self._refine(z, places, every, found)
            return found
        gain_p, gain_v = self.speed_gain
        squared = z * z
        speed = gain_p * np.sqrt(squared[:, :3].sum(axis=1)) + gain_v * np.sqrt(squared[:, 3:].sum(axis=1))
        bound = found.distance - speed * (self.times[1] / 2)
        near = np.flatnonzero(bound <= beyond)
        if len(near):
            self._refine(z, places, near, found)
        far = bound > beyond
        found.distance[far] = bound[far]
        return found

    def _refine(self, z: Array, places: Array, chosen: Array, found: Approach) -> None:
        """Lower the distances of the chosen flights to their true minima, in place."""
        speeds = (z[chosen] @ self.velocities).reshape(len(chosen), -1, 3)
        rates = dot(places[chosen], speeds)  # half the derivative of the squared distance
        row, segment = np.nonzero((rates[:, :-1] < 0) & (rates[:, 1:] > 0))
        if not len(row):
            return
        flight = FreeFlight(z[chosen[row]], self.mean_motion)
        low, high = self.times[segment], self.times[segment + 1]
        a, b = rates[row, segment], rates[row, segment + 1]
        at = low + (high - low) * a / (a - b)
        for _ in range(NEWTON):
            p, v, w = flight(at)
            rate, bend = dot(p, v), dot(v, v) + dot(p, w)
            low, high = np.where(rate < 0, at, low), np.where(rate < 0, high, at)
            step = at - rate / np.where(bend > 0, bend, 1.0)
            after = np.where((bend > 0) & (step > low) & (step < high), step, (low + high) / 2)
            moved = np.abs(after - at).max()
            at = after
            if moved < 1e-6:
                break
        place = flight(at)[0]
        distance = np.sqrt(dot(place, place))
        for k in np.argsort(-distance) if len(row) > 1 else (0,):  # the least of a flight is written last
            target = chosen[row[k]]
            if distance[k] < found.distance[target]:
                found.distance[target], found.when[target], found.place[target] = distance[k], at[k], place[k]


def _norms(maps: Array) -> tuple[float, float]:
    """Largest 2-norms of the halves of maps of shape (S, 3, 6): per metre, and per metre per second."""
    parts = (maps[..., :3], maps[..., 3:])
    position, velocity = (float(np.linalg.norm(part, 2, axis=(1, 2)).max()) for part in parts)
    return position, velocity
