"""Is a plan that brakes and holds safe for all time? Bounds of phi1 to phi11, between samples and for ever.

The lemmas are those of ``docs/inspection-theory.md``, section 6.
"""

from collections.abc import Collection

import numpy as np

from ...model.checks import number, of_kind
from ...model.errors import ScenarioError
from ...model.system import Array
from ..closest import ClosestApproach, circle_map, map_norms
from ..constraints.constraint import KINDS
from ..vectors import dot, length
from .brake import Brake, rotate
from .tube import TOLERANCE, VARIATION

SUPPORTS = 16  # most steps towards the nearest point of a patch of free flights; each gives a valid bound
NEAR = 5.0  # bounds of free flights [m] up to which they are looked at closely


class AllTime:
    """Bounds every constraint from below, for all time, along plans and within the tube about them.

    Attributes
    ----------
    labels : tuple of str, length M
        ``phi1[0]``, ``phi2[0,3]`` and so on; ``thrust[i]`` is what a plan leaves of the thrust limit [N].
        Distances, phi4 and phi5 among them, in m; speeds in m/s.
    first, second : ndarray of int, shape (M,)
        The deputies of each; the second is -1 where there is one only.
    about_speed, about_thrust : ndarray of bool, shape (M,)
        True for rows about speed, and about thrust: neither are distances.
    """

    def __init__(self, brake: Brake, sun_start: float = 0.0, without: Collection[str] = ()) -> None:
        of_kind("brake", brake, Brake)
        self.brake, self.inspection = brake, brake.inspection
        self.sun_start = number("sun_start", sun_start)
        self.without = tuple(without)
        q = self.inspection
        if q.constraints:
            rule = "must be empty: custom constraints need a barrier filter (centralized or decentralized)"
            raise ScenarioError("constraints", [one.label for one in q.constraints], rule)
        self.approach = ClosestApproach(q.mean_motion, q.passive_time)
        self._circle = circle_map(q.mean_motion)
        deputies = np.arange(q.deputies)
        alone = np.stack([deputies, np.full_like(deputies, -1)], axis=1)
        both = ["phi1", "phi7", "phi4"], ["phi2", "phi8", "phi5+", "phi5-"]
        single = [*both[0], "phi6", "phi3", "phi9", "phi10", "phi11", "thrust"]
        rows = [(name, *place) for name in single for place in alone]
        rows += [(name, *pair) for name in both[1] for pair in q.pairs]
        left_out = {name for name, kind in KINDS.items() if kind.family in without}
        self._counted = np.array([row[0].rstrip("+-") not in left_out for row in rows])
        rows = [row for row, counted in zip(rows, self._counted, strict=True) if counted]
        self.first, self.second = (np.array([row[k] for row in rows], dtype=np.intp) for k in (1, 2))
        self.labels = tuple(f"{name}[{i}]" if j < 0 else f"{name}[{i},{j}]" for name, i, j in rows)
        self.about_speed = np.array([row[0] in ("phi3", "phi9", "phi10", "phi11") for row in rows])
        self.about_thrust = np.array([row[0] == "thrust" for row in rows])
        self._gains = _gains(self.approach)
        self._places = [self.approach.positions[:, axis::3].copy() for axis in range(3)]

    def __call__(self, t: float, x: Array, around: Array, old: tuple[Array, Array] | None = None) -> Array:
        """Lower bounds (M,) over all time from t [s] on, of plans x (L+1, N, 6) that end at rest.

        The tube `around` (L+1, N, 2) them is as `Tube.around` has it. Any deputies may fly their `old` plans
        instead, which are known to be safe together: pairs are bounded for all that may come of it.
        """
        q, brake, N = self.inspection, self.brake, self.inspection.deputies
        D, n, (i, j), plans = brake.period, q.mean_motion, q.pairs.T, (x, around)
        if old is not None:
            i, j = np.concatenate([i, i, i + N]), np.concatenate([j, j + N, j])
            plans = np.concatenate([x, old[0]], axis=1), np.concatenate([around, old[1]], axis=1)
        z = np.concatenate([x, plans[0][:, i] - plans[0][:, j]], axis=1)
        # Axes that keep their direction in space: those of Hill's frame at the time t.
        p = z[..., :3] @ rotate(-n * D * np.arange(len(x)))
        intersample, bow_hill, jolt = self._intersamples(z)
        wide = np.concatenate([around, plans[1][:, i] + plans[1][:, j]], axis=1)
        radius = np.repeat([q.separation, q.deputy_separation], [N, len(i)])
        offset, slip = around[..., 0], around[..., 1]
        r, closest = _convex(p, length(p), _units(p), intersample)
        clearance = (closest - wide[..., 0]).min(axis=0) - radius
        sun = q.sun_angle(t, self.sun_start)
        # Signed distances from both cones about the sun's line, over every period, (L+1, N + P) [m].
        distances = (_convex(p, *self._normal(p, float(sun), side), intersample)[1] for side in (1.0, -1.0))
        cones = [(part - wide[..., 0]).min(axis=0) for part in distances]
        inside = q.distance_max - (_over_periods(r[:, :N]) + offset).max(axis=0) - intersample[:N]
        fastest = _over_periods(length(x[..., 3:])) + jolt[:N] + slip
        allowed = q.docking_speed + q.nu_1 * (closest[:, :N] - offset)
        speed = (allowed - fastest).min(axis=0)
        along = _over_periods(np.abs(x[..., 3:]))
        # Held, a deputy turns about z: each axis of the plane comes to have its whole speed.
        along[-1, :, :2] = n * length(x[-1, :, :2])[:, None]
        axes = q.speed_max**2 - ((along + slip[..., None]).max(axis=0) + jolt[:N, None]) ** 2
        u = brake.thrusts(x)
        varied = length(np.diff(u, axis=0)).sum(axis=0) + 4 * np.sqrt(3) * q.thrust_max  # at its ends, too
        u = np.abs(u).max(axis=2)
        thrust = np.minimum(q.thrust_max - u[0], brake.available - u[1:].max(axis=0, initial=0.0))
        hold_thrust = brake.holding * length(x[-1, :, :3])
        thrust = np.minimum(thrust, brake.available - hold_thrust) + TOLERANCE
        # The tube counts what holding misses up to r_max; farther out, where phi6 is left out, it is none.
        thrust[(length(x[-1, :, :3]) > q.distance_max) | (varied > VARIATION * q.thrust_max)] = -np.inf
        passive = self._passive(z, wide, bow_hill, jolt, radius)
        alone = [clearance[:N], passive[:N], cones[0][:N], inside, speed, *axes.T, thrust]
        cases = 1 if old is None else 3
        of_pairs = [v[N:].reshape(cases, -1).min(axis=0) for v in (clearance, passive, *cones)]
        return np.asarray(np.concatenate([*alone, *of_pairs])[self._counted])

    def _intersamples(self, z: Array) -> tuple[Array, Array, Array]:
        """Lemma D: how far flights leave chords, (N + P,): in fixed axes, in Hill's [m], speeds [m/s]."""
        q, D, n = self.inspection, self.brake.period, self.inspection.mean_motion
        several = np.repeat([1.0, 2.0], [q.deputies, z.shape[1] - q.deputies])
        push = several * np.sqrt(3) * q.thrust_max / q.mass
        speed, distance = length(z[..., 3:]).max(axis=0), length(z[..., :3]).max(axis=0)
        growth = np.exp((2 + np.sqrt(3)) * n * D)
        speed = (speed + np.sqrt(3) * n * distance + push * D) * growth  # also between the samples
        distance = distance + D * speed
        hill = 3 * n**2 * distance + 2 * n * speed + push
        jerk = 3 * n**2 * speed + 2 * n * hill
        part = D**2 / 8
        return part * (2 * n**2 * distance + push), part * hill, part * jerk

    def direction(self, name: str, z: Array, t: float) -> Array:
        """Unit vector (3,) along which a distance of a place z (3,) at t [s] grows fastest, by its name."""
        outward = _units(z)
        if name in ("phi1", "phi2"):
            return outward
        if name == "phi6":
            return -outward
        sun = float(self.inspection.sun_angle(t, self.sun_start))
        return self._normal(z, sun, -1.0 if name == "phi5-" else 1.0)[1]

    def _normal(self, places: Array, sun: float, side: float) -> tuple[Array, Array]:
        """Signed distances (...) from a cone about the sun's line, and their slopes, at places (..., 3)."""
        half = self.inspection.field_of_view / 2
        axis = -side * np.array([np.cos(sun), np.sin(sun), 0.0])
        along = places @ axis
        across = places - along[..., None] * axis
        value = np.cos(half) * length(across) - np.sin(half) * along
        return value, np.cos(half) * _units(across) - np.sin(half) * axis

    def _passive(self, z: Array, wide: Array, intersample: Array, jolt: Array, radius: Array) -> Array:
        """Lower bounds of phi7 and phi8, (N + P,), at every instant of the plans and ever after."""
        gain_p, gain_v = self._gains
        spread = (wide @ self._gains).max(axis=0)
        tightening = spread + gain_p * intersample + gain_v * jolt + radius
        plane, across = self.brake.drifting
        hold_bound = np.hypot(plane * length(z[-1, :, :2]), across * np.abs(z[-1, :, 2])) - spread - radius
        n, step = self.inspection.mean_motion, self.approach.times[1]
        amplitude = length(z @ self._circle.T).max(axis=0)
        tightening = tightening + (n * step) ** 2 / 8 * amplitude
        # No point of a patch is farther from its nearest corner than half of two of its sides.
        change = np.abs(z[1:] - z[:-1]).max(axis=0, initial=0.0)
        sides = gain_p * length(change[:, :3]) + gain_v * length(change[:, 3:])
        distance, fast = (length(part).max(axis=0) for part in (z[..., :3], z[..., 3:]))
        sides = sides + step * (np.array([distance, fast]).T @ self.approach.speed_gain)
        X, Y, Z = (z @ part for part in self._places)
        lower = np.sqrt((X * X + Y * Y + Z * Z).min(axis=(0, 2))) - sides / 2
        near = np.flatnonzero(lower < tightening + NEAR)
        if len(near):
            places = np.stack([X[:, near], Y[:, near], Z[:, near]], axis=-1)
            lower[near] = np.maximum(lower[near], _patches(places))
        return np.asarray(np.minimum(lower - tightening, hold_bound))


def _patches(places: Array) -> Array:
    """Lower bounds (K,) of distances over the patches between the places (S, K, T, 3) of free flights."""
    if len(places) == 1:
        places = np.concatenate([places, places])
    ends = places[:, :, :-1], places[:, :, 1:]
    corners = np.stack([ends[0][:-1], ends[1][:-1], ends[0][1:], ends[1][1:]], axis=-2)
    middle = corners.mean(axis=-2)
    lower = length(middle) - length(corners - middle[..., None, :]).max(axis=-1)
    close = np.nonzero(lower < length(places).min(axis=(0, 2))[None, :, None])  # of others a corner is nearer
    lower[close] = np.maximum(lower[close], _nearest(corners[close], middle[close]))
    return np.asarray(lower.min(axis=(0, 2)))


def _gains(approach: ClosestApproach) -> tuple[float, float]:
    """Most metres of a free flight's place per metre and per m/s of its start, at any time up to T."""
    by_place, by_speed = map_norms(approach.place_maps)
    half = approach.times[1] / 2
    per_metre, per_speed = approach.speed_gain
    return float(by_place.max()) + per_metre * half, float(by_speed.max()) + per_speed * half


def _units(vectors: Array) -> Array:
    """Directions; zero, a subgradient of the length, where there is none."""
    size = length(vectors)
    return np.asarray(vectors / np.where(size > 0, size, 1.0)[..., None])


def _over_periods(values: Array) -> Array:
    """The larger of the values at the ends of each period, and the last for ever; shape (L+1, ...)."""
    return np.concatenate([np.maximum(values[1:], values[:-1]), values[-1:]])


def _convex(places: Array, value: Array, slope: Array, intersample: Array) -> tuple[Array, Array]:
    """Values (L+1, K) of a convex function, and bounds over each period: tangents on chords, less bows."""
    chord = places[1:] - places[:-1]
    falls, rises = dot(slope[:-1], chord), dot(slope[1:], chord)
    first, last = value[:-1], value[1:]
    bends = np.maximum(rises - falls, 1e-300)
    meet = first + falls * np.clip((first - last + rises) / bends, 0.0, 1.0)
    lower = np.where(falls >= 0, first, np.where(rises <= 0, last, np.minimum(meet, np.minimum(first, last))))
    return value, np.concatenate([lower - intersample, value[-1:]])


def _nearest(corners: Array, start: Array) -> Array:
    """Lower bounds (K,) of distances from the origin to hulls of corners (K, 4, 3), by Gilbert's steps."""
    point, bound = start, np.full(len(start), -np.inf)
    rows = np.arange(len(start))
    for _ in range(SUPPORTS):
        along = np.einsum("kci,ki->kc", corners, _units(point))
        lowest = along.argmin(axis=1)
        bound = np.maximum(bound, along[rows, lowest])
        edge = corners[rows, lowest] - point
        share = np.clip(-dot(point, edge) / np.maximum(dot(edge, edge), 1e-300), 0.0, 1.0)
        point = point + share[:, None] * edge
    return bound
