"""Closest approach to the origin in free flight, over continuous time (eqs. 20 to 22)."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..model.compiled import loops, plain
from ..model.hill import free_flight
from ..model.system import Array
from .vectors import dot, length

SEGMENT = 20.0  # largest spacing [s] of the instants at which every free flight is looked at first
TOLERANCE = 1e-6  # a closest approach is never above the true infimum by more than this [m]
NEWTON = 40  # most steps per minimum: Newton's converge in three or four, bisection alone in thirty
HALVINGS = 40
"""Most halvings of a segment that may hide a minimum; each makes its doubt sixteen times smaller."""

BLOCK = 1024  # flights looked at together: what fits into fast memory
NO_PAIRS = np.zeros((0, 2), dtype=np.intp)


class ApproachResult(NamedTuple):
    """Closest approaches: distances from the origin [m], times of flight [s], positions (..., 3) [m]."""

    distance: Array
    when: Array
    place: Array


def flight_parts(z: Array, n: float) -> Array:
    """Vectors a to d of ``p(t) = a + b t + c cos(n t) + d sin(n t)`` (eq. 20), (4, F, 3)."""
    x, y, zz, vx, vy, vz = z.T
    o = np.zeros_like(x)
    parts = (
        (4 * x + 2 / n * vy, y - 2 / n * vx, o),
        (o, -6 * n * x - 3 * vy, o),
        (-3 * x - 2 / n * vy, 2 / n * vx, zz),
        (vx / n, 6 * x + 4 / n * vy, vz / n),
    )
    return np.stack([np.stack(part, axis=-1) for part in parts])


def free_motion(parts: Array, n: float, t: Array) -> tuple[Array, Array, Array]:
    """Position, velocity and acceleration, (F, 3) each, of free flights (4, F, 3) at times t (F,)."""
    a, b, c, d = parts
    t = t[:, None]
    sine, cosine = np.sin(n * t), np.cos(n * t)
    circle = c * cosine + d * sine
    return a + b * t + circle, b + n * (d * cosine - c * sine), -(n**2) * circle


def circle_map(n: float) -> Array:
    """The matrix from a state to the vectors c, d of `flight_parts`, shape (6, 6).

    Its norm at a state, the amplitude of the flight, is the same all along the flight. The acceleration is
    ``-n^2 (c cos + d sin)``, hence at most n^2 times the amplitude; each further derivative has one more n.
    """
    _, _, c, d = flight_parts(np.eye(6), n)
    return np.concatenate([c.T, d.T])


def map_norms(maps: Array) -> tuple[Array, Array]:
    """2-norms, shape (S,), of the halves of maps of shape (S, 3, 6): by a position, by a velocity."""
    position, velocity = (np.linalg.norm(part, 2, axis=(1, 2)) for part in (maps[..., :3], maps[..., 3:]))
    return np.asarray(position), np.asarray(velocity)


def _ends(p: Array, v: Array, w: Array) -> Array:
    """Half the squared distance, its rate and its bend, shape (3, F)."""
    return np.stack([dot(p, p) / 2, dot(p, v), dot(v, v) + dot(p, w)])


class ClosestApproach:
    """Least distance from the origin during a free flight of length T.

    Let ``q(t) = norm(p(t))^2 / 2``. At instants L <= `SEGMENT` apart q and its rate are known. As
    ``q'' >= -C`` with C the largest distance times the largest acceleration, q is known from below near each
    instant; only segments where it may fall below the least value so far are looked into. Where q is convex
    on a segment, its minimum is found by Newton steps, held in their bracket. Where it may not be, the
    segment is halved until it is, or until a cubic through the ends, off by at most
    ``L^4 / 384 max |q''''|``, shows that nothing is missed by more than `TOLERANCE`.

    The mean motion n is in rad/s, T (at most half an orbit) in s.

    Attributes
    ----------
    times : ndarray, shape (S+1,)
        The instants [s], evenly spaced.
    place_maps : ndarray, shape (S+1, 3, 6)
        Positions at the instants, as functions of the state at the start.
    parts : tuple of 4 ndarrays, shape (3, 6)
        The constant, linear, cosine and sine parts of eq. 20, as functions of the state at the start.
    speed_gain : tuple of 2 floats
        The speed of a flight never exceeds the first times norm(p) plus the second times norm(v), those
        at its start.
    """

    def __init__(self, mean_motion: float, duration: float) -> None:
        self.mean_motion, self.duration = mean_motion, duration
        self.times = np.linspace(0.0, duration, max(2, int(np.ceil(duration / SEGMENT)) + 1))
        transitions = free_flight(mean_motion, self.times)
        self.place_maps = transitions[:, :3]
        self.positions = np.ascontiguousarray(transitions[:, :3].reshape(-1, 6).T)
        self.velocities = np.ascontiguousarray(transitions[:, 3:].reshape(-1, 6).T)
        self._circle = np.ascontiguousarray(circle_map(mean_motion).T)
        self.parts = tuple(np.ascontiguousarray(part.T) for part in flight_parts(np.eye(6), mean_motion))
        # The maps change by at most 6 n^2 and 4 n per second, and every time is within half a segment of an
        # instant.
        per_metre, per_speed = map_norms(transitions[:, 3:])
        self.speed_gain = (
            float(per_metre.max()) + 3 * mean_motion**2 * self.times[1],
            float(per_speed.max()) + 2 * mean_motion * self.times[1],
        )
        self.loops = loops("polaris.inspection.closest_loops")
        angle = mean_motion * self.times
        instants = np.stack([self.times, 2 * np.sin(angle / 2) ** 2, np.sin(angle)], axis=1)
        self.numbers = np.vstack([[mean_motion, *self.speed_gain], instants])

    def __call__(self, z: Array, beyond: float = np.inf) -> ApproachResult:
        """Find the closest approach of every flight from states (..., 6).

        Distances larger than `beyond` [m] need not be exact: they may come out smaller, but not below it,
        and their places count for nothing.
        """
        flat, shape = z.reshape(-1, 6), z.shape[:-1]
        if self.loops:
            parts = self.loops.approaches(plain(flat)[:, None], NO_PAIRS, float(beyond), self.numbers)
            parts = parts.reshape(*shape, 5)
            return ApproachResult(parts[..., 0], parts[..., 1], parts[..., 2:])
        parts = [self._block(flat[k : k + BLOCK], beyond) for k in range(0, max(len(flat), 1), BLOCK)]
        distance, time, place = parts[0] if len(parts) == 1 else map(np.concatenate, zip(*parts, strict=True))
        return ApproachResult(distance.reshape(shape), time.reshape(shape), place.reshape(*shape, 3))

    def _block(self, z: Array, beyond: float) -> ApproachResult:
        places = (z @ self.positions).reshape(len(z), -1, 3)
        squares = dot(places, places)
        nearest = squares.argmin(axis=1)
        flights = np.arange(len(z))
        approach = ApproachResult(
            np.sqrt(squares[flights, nearest]), self.times[nearest], places[flights, nearest]
        )
        gain_p, gain_v = self.speed_gain
        speed = gain_p * length(z[:, :3]) + gain_v * length(z[:, 3:])
        bound = approach.distance - speed * (self.times[1] / 2)
        far = bound > beyond
        near = np.flatnonzero(~far)
        selected = near if far.any() else slice(None)  # a view is quicker than a copy
        if len(near):
            self._refine(z[selected], places[selected], squares[selected], approach, near)
        approach.distance[far] = bound[far]
        return approach

    def _refine(
        self, z: Array, places: Array, squares: Array, approach: ApproachResult, flights: NDArray[np.intp]
    ) -> None:
        """Lower the distances found for these flights, which are at these places, to their infima."""
        n, length = self.mean_motion, self.times[1]
        rates = dot(places, (z @ self.velocities).reshape(places.shape))
        circle = z @ self._circle
        pull = n**2 * np.sqrt(dot(circle, circle))  # largest acceleration
        intersample = pull * (length**2 / 8)
        drop = (np.sqrt(squares.max(axis=1)) + intersample) * intersample
        # Near an instant q >= q_k + rate (t - t_k) - C (t - t_k)^2 / 2: least half a segment away.
        excess = (squares - squares.min(axis=1, keepdims=True)) / 2 - drop[:, None]
        rates_half = rates * (length / 2)
        low = (excess[:, :-1] + rates_half[:, :-1] < 0) | (excess[:, 1:] - rates_half[:, 1:] < 0)
        row, segment = np.nonzero(low)
        if not len(row):
            return
        parts, start, end = flight_parts(z[row], n), self.times[segment], self.times[segment + 1]
        pull = pull[row]
        first, last = free_motion(parts, n, start), free_motion(parts, n, end)
        speed = np.sqrt(np.maximum(dot(first[1], first[1]), dot(last[1], last[1]))) + pull * (length / 2)
        reach = np.sqrt(squares.max(axis=1))[row] + intersample[row]
        quartic = pull * (3 * pull + n * (4 * speed + n * reach))  # bound on |q''''|
        _Search(approach, flights[row], parts, n, quartic).run(start, end, _ends(*first), _ends(*last))


@dataclass(frozen=True, eq=False)
class _Search:
    """Segments of flights on which the distance may fall below the least one found so far."""

    best: ApproachResult
    row: NDArray[np.intp]  # of each segment's flight, in `best`
    parts: Array
    n: float
    quartic: Array  # bounds on ``|q''''|``

    def run(self, start: Array, end: Array, first: Array, last: Array) -> None:
        """Search the segments, one for each row; all of the same length."""
        index = np.arange(len(self.row))
        for _ in range(HALVINGS):
            length = float(end[0] - start[0])
            (half_1, rate_1, bend_1), (half_2, rate_2, bend_2) = first, last
            deviation = self.quartic[index] * (length**2 / 8)  # of the bend, between the ends
            convex = np.minimum(bend_1, bend_2) > deviation
            dip = convex & (rate_1 < 0) & (rate_2 > 0)
            if dip.any():
                guess = start[dip] + length * rate_1[dip] / (rate_1[dip] - rate_2[dip])
                self._newton(index[dip], start[dip], end[dip], guess)
            # The cubic through values and rates at the ends is at least its least Bezier coefficient.
            third = length / 3
            corners = (half_1, half_2, half_1 + rate_1 * third, half_2 - rate_2 * third)
            lower = np.min(corners, axis=0) - self.quartic[index] * (length**4 / 384)
            goal = np.maximum(self.best.distance[self.row[index]] - TOLERANCE, 0.0)
            open_ = np.flatnonzero(~convex & (lower < goal**2 / 2))
            if not len(open_):
                return
            index, start, end = index[open_], start[open_], end[open_]
            middle = (start + end) / 2
            motion = free_motion(np.take(self.parts, index, axis=1), self.n, middle)
            self._keep(index, middle, motion[0])
            halves = _ends(*motion)
            first = np.concatenate([first[:, open_], halves], axis=1)
            last = np.concatenate([halves, last[:, open_]], axis=1)
            index = np.concatenate([index, index])
            start, end = np.concatenate([start, middle]), np.concatenate([middle, end])

    def _newton(self, index: NDArray[np.intp], low: Array, high: Array, time: Array) -> None:
        """Minimum of a convex q between two times, where its rate changes its sign."""
        parts = np.take(self.parts, index, axis=1)
        for _ in range(NEWTON):
            _, rate, bend = _ends(*free_motion(parts, self.n, time))
            low, high = np.where(rate < 0, time, low), np.where(rate < 0, high, time)
            step = time - rate / np.where(bend > 0, bend, 1.0)
            after = np.where((bend > 0) & (step >= low) & (step <= high), step, (low + high) / 2)
            change = np.abs(after - time).max()
            time = after
            if change < 1e-7:
                break
        self._keep(index, time, free_motion(parts, self.n, time)[0])

    def _keep(self, index: NDArray[np.intp], time: Array, place: Array) -> None:
        """Write down distances that are smaller than those known."""
        least, row = self.best, self.row[index]
        distance = np.sqrt(dot(place, place))
        improved = np.flatnonzero(distance < least.distance[row])
        for k in improved[np.argsort(-distance[improved])]:  # the least of a flight is written last
            least.distance[row[k]], least.when[row[k]], least.place[row[k]] = distance[k], time[k], place[k]
