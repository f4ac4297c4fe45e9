"""All control-invariant constraints of an inspection problem at once, as rows for the filters.

Row by row ``G (u_i - u_j) >= bound`` is the barrier condition BC >= 0 of eq. 7, with u_j absent where a row
concerns one deputy only.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...model.errors import ScenarioError
from ...model.hill import free_flight
from ...model.system import Array
from ..braking import Braking
from ..closest import ClosestApproach
from ..inspection import Inspection
from .barriers import Barrier, Radial, Speed, SunCone, Velocity, dot
from .passive import Passive
from .sampled import Motion, SampledData, SpeedInSquares, VelocitySide, curvature
from .segments import PassiveSegments
from .strengthening import FAMILIES, PRESETS, Strengthening, evaluate

Index = NDArray[np.intp]


RANKS = {
    "chief_separation": 0,
    "deputy_separation": 0,
    "passive": 1,
    "deputy_passive": 1,
    "speed": 2,
    "velocity": 2,
    "keep_in": 3,
    "sun": 4,
    "deputy_sun": 4,
}
"""What gives way last where no input satisfies all conditions: not to collide, not to collide should the
thrusters fail, speeds, the zone, the sun."""


@dataclass(frozen=True, eq=False)
class Rows:
    """Barrier conditions at some states; the leading axes are runs.

    Attributes
    ----------
    h : ndarray, shape (..., M)
        Values of the constraints.
    G : ndarray, shape (..., M, 3)
        Change of h per newton of thrust.
    bound : ndarray, shape (..., M)
        ``-L_f h - alpha(h)``, least value of ``G (u_i - u_j)``.
    """

    h: Array
    G: Array
    bound: Array


_Member = tuple[str, Index, float, float, float]
"""Family, places, radius [m], acceleration [m/s^2], side."""


@dataclass(frozen=True, eq=False)
class _Group:
    """Constraints of one formula: a barrier with a parameter per row, and whom each row concerns."""

    barrier: Barrier
    family: list[str]
    place: Index  # into the stack of deputies and pairs
    repeat: int = 1  # rows per place

    @cached_property
    def at(self) -> Index | slice:
        """The places as a slice if they follow each other: a view is quicker than a copy."""
        first, last = int(self.place[0]), int(self.place[-1])
        straight = np.array_equal(self.place, np.arange(first, last + 1))
        return slice(first, last + 1) if straight else self.place


class Families:
    """The constraints h1 to h11 of all deputies and pairs, in one fixed order of rows.

    Parameters
    ----------
    inspection : Inspection
    strengthening : str or mapping from family to Strengthening
        A preset's name, or one function for each of `FAMILIES`.
    without : collection of str
        Families left out.
    sampled : SampledData, optional
        Tighten the conditions so that they hold between samples.
    exact : bool
        h7 and h8 in full also where they allow every input; without it they may come out smaller there.

    Attributes
    ----------
    family : tuple of str, length M
        Family of each row.
    first, second : ndarray of int, shape (M,)
        The deputies a row concerns; second is -1 where there is one only.
    labels : tuple of str, length M
        Names of the rows: ``h1[2]``, ``h2[0,3]``; ``h5+`` and ``h5-`` are the two cones of a pair.
    """

    def __init__(
        self,
        inspection: Inspection,
        strengthening: str | Mapping[str, Strengthening] = "polaris",
        without: Collection[str] = (),
        sampled: SampledData | None = None,
        exact: bool = False,
    ) -> None:
        self.sampled, self.exact = sampled, exact
        if sampled is not None:
            sampled.growth(inspection.mean_motion)  # refuses periods that are too long
        self.inspection = inspection
        self.alpha = _checked(strengthening)
        for name in without:
            if name not in FAMILIES:
                raise ScenarioError("without", name, f"must be one of {', '.join(FAMILIES)}")
        self._groups = [group for group in self._all_groups(frozenset(without)) if len(group.place)]
        if not self._groups:
            raise ScenarioError("without", sorted(without), "must leave a constraint")
        place = np.concatenate([np.repeat(group.place, group.repeat) for group in self._groups])
        self.family = tuple(name for g in self._groups for name in g.family for _ in range(g.repeat))
        N, pairs = inspection.deputies, inspection.pairs
        who = np.concatenate([np.stack([np.arange(N), np.full(N, -1)], axis=1), pairs])[place]
        self.first, self.second = who[:, 0], who[:, 1]
        self._pairs = np.flatnonzero(self.second >= 0)
        self.labels = tuple(map(_label, self.family, self.first, self.second, self._variants()))
        self._alpha = tuple(np.array([self.alpha[name].numbers for name in self.family]).T)
        self._rank = np.array([RANKS[name] for name in self.family], dtype=np.intp)

    def _all_groups(self, without: frozenset[str]) -> list[_Group]:
        """Stack what shares a formula."""
        q = self.inspection
        alone = np.arange(q.deputies)
        pairs = q.deputies + np.arange(len(q.pairs))

        def stack(*members: _Member) -> tuple[list[str], Index, Array, Array, Array]:
            kept = [member for member in members if member[0] not in without]
            names = [member[0] for member in kept for _ in member[1]]
            place = np.concatenate([alone[:0], *(member[1] for member in kept)])
            values = np.array([member[2:] for member in kept for _ in member[1]]).reshape(-1, 3)
            return names, place, values[:, 0], values[:, 1], values[:, 2]

        apart = 2 * q.deputy_radius
        names, place, radius, a, side = stack(
            ("chief_separation", alone, q.separation, q.a_max, 1.0),
            ("deputy_separation", pairs, apart, 2 * q.a_max, 1.0),
            ("keep_in", alone, q.distance_max, q.a_inside, -1.0),
        )
        groups = [
            _Group(Radial("radial", radius, Braking(a, q.smoothing, q.return_speed), side), names, place)
        ]
        names, place, _, a, side = stack(
            ("sun", alone, 0.0, q.a_max, 1.0),
            ("deputy_sun", pairs, 0.0, q.a_max, 1.0),
            ("deputy_sun", pairs, 0.0, q.a_max, -1.0),
        )
        cone = SunCone(
            "cone", q.field_of_view / 2, q.mean_motion, Braking(a, q.smoothing, q.return_speed), side
        )
        groups.append(_Group(cone, names, place))
        names, place, radius, _, _ = stack(
            ("passive", alone, q.separation, 0.0, 0.0), ("deputy_passive", pairs, apart, 0.0, 0.0)
        )
        approach = ClosestApproach(q.mean_motion, q.passive_time)
        speed: Barrier = Speed("speed", q.docking_speed, q.nu_1)
        if self.sampled is None:
            beyond = np.inf if self.exact else self._beyond(approach)
            groups.append(_Group(Passive("passive", radius, approach, beyond), names, place))
        else:
            segments = PassiveSegments("passive", radius, approach)
            groups.append(_Group(segments, names, place, segments.rows))
            speed = SpeedInSquares("speed", q.docking_speed, q.nu_1)
        axes = np.repeat(np.arange(3), q.deputies)
        limit: Barrier = Velocity("velocity", axes, q.speed_max)
        if self.sampled is not None:
            limit = VelocitySide("velocity", axes, q.speed_max)
        for name, barrier, times in (("speed", speed, 1), ("velocity", limit, 3)):
            if name not in without:
                groups.append(_Group(barrier, [name] * q.deputies * times, np.tile(alone, times)))
        return groups

    def _beyond(self, approach: ClosestApproach) -> float:
        """From which value on a passive constraint allows every input: it then need not be exact."""
        q = self.inspection
        reach = np.linalg.norm(free_flight(q.mean_motion, approach.times)[:, :3, 3:], 2, axis=(1, 2)).max()
        thrust = 1.05 * float(reach) * 2 * np.sqrt(3) * q.thrust_max / q.mass
        drift = (
            2 * q.distance_max * approach.speed_gain[0]
            + 2 * np.sqrt(3) * q.speed_max * approach.speed_gain[1]
        )
        return max(self.alpha[name].reaches(thrust + 2 * drift) for name in ("passive", "deputy_passive"))

    def _variants(self) -> list[str]:
        """What tells apart the rows of one family that concern the same deputies."""
        seen: dict[tuple[str, int, int], int] = {}
        out = []
        for key in zip(self.family, self.first, self.second, strict=True):
            number = seen[key] = seen.get(key, -1) + 1
            out.append({"deputy_sun": "+-", "velocity": "012"}.get(key[0], " ")[number : number + 1])
        return out

    def relative(self, u: Array) -> Array:
        """``u_first - u_second`` for each row, shape (..., M, 3), of inputs of shape (..., N, 3)."""
        relative = u[..., self.first, :]
        relative[..., self._pairs, :] -= u[..., self.second[self._pairs], :]
        return np.asarray(relative)

    def rank(self, h: Array) -> Index:
        """Which row gives way to which, least last; shape (..., M) as h.

        In the order of `RANKS`; within each, rows that keep what holds (``h >= 0``) before rows that ask for
        the way back.
        """
        return np.asarray(2 * self._rank + (h < 0))

    def missed(self, rows: Rows, u: Array) -> Array:
        """By how much inputs of shape (..., N, 3) miss each row [N], 0 where they meet it; shape (..., M).

        Along the row, per newton of its deputies' thrust; inf where no input changes the row.
        """
        length = np.sqrt(dot(rows.G, rows.G) * np.where(self.second >= 0, 2.0, 1.0))
        gap = np.maximum(rows.bound - dot(rows.G, self.relative(u)), 0.0)
        out = np.divide(gap, length, out=np.where(gap > 0, np.inf, 0.0), where=length > 0)
        return np.asarray(out)

    def stack(self, x: Array) -> Array:
        """States of the deputies, then of each pair relative to each other, shape (..., N + P, 6)."""
        pairs = self.inspection.pairs
        return np.concatenate([x, x[..., pairs[:, 0], :] - x[..., pairs[:, 1], :]], axis=-2)

    def __call__(self, x: Array, sun: ArrayLike) -> Rows:
        """Barrier conditions at states of shape (..., N, 6) and sun angles of shape (...) [rad]."""
        q = self.inspection
        every = self.stack(x)
        drift = every @ q.A.T
        sun = np.asarray(sun)[..., None]
        motion = self._motion(every, drift)
        shape = (*x.shape[:-2], len(self.family))
        h, rate, M = np.empty(shape), np.empty(shape), np.zeros(shape)
        G = np.empty((*shape, 3))
        start = 0
        for group in self._groups:
            z, moved = every[..., group.at, :], drift[..., group.at, :]
            value, gradient, change = group.barrier(z, sun)
            rows = (..., slice(start, start := start + len(group.family) * group.repeat))
            h[rows] = value
            G[(*rows, slice(None))] = gradient[..., 3:]
            if group.repeat > 1:
                moved = np.repeat(moved, group.repeat, axis=-2)
            rate[rows] = dot(gradient, moved) + change
            if motion is not None:
                M[rows] = curvature(group.barrier, z, sun, motion[group.at])
        G *= 1 / q.mass
        bound = -rate - evaluate(h, *self._alpha)
        if self.sampled is not None:
            bound = self._tightened(h, bound, M)
        return Rows(h, G, bound)

    def _motion(self, every: Array, drift: Array) -> Motion | None:
        if self.sampled is None:
            return None
        q = self.inspection
        thrust = np.full(every.shape[-2], np.sqrt(3) * q.thrust_max / q.mass)
        thrust[q.deputies :] *= 2
        return self.sampled.motion(every, drift, q.mean_motion, thrust)

    def _tightened(self, h: Array, bound: Array, M: Array) -> Array:
        """The larger of ``-L_f h - alpha(h)`` and ``-L_f h - share h / D``, plus ``M D / 2``."""
        assert self.sampled is not None
        alpha = evaluate(h, *self._alpha)
        linear = np.maximum(h, 0.0) * (self.sampled.share / self.sampled.period)
        return np.asarray(bound + np.maximum(alpha - linear, 0.0) * (h > 0) + M * (self.sampled.period / 2))


def _checked(strengthening: str | Mapping[str, Strengthening]) -> dict[str, Strengthening]:
    if isinstance(strengthening, str):
        if strengthening not in PRESETS:
            raise ScenarioError("strengthening", strengthening, f"must be one of {', '.join(PRESETS)}")
        return dict(PRESETS[strengthening])
    missing = [name for name in FAMILIES if name not in strengthening]
    if missing:
        raise ScenarioError("strengthening", sorted(strengthening), f"{missing[0]} is missing")
    return {name: strengthening[name] for name in FAMILIES}


_NUMBERS = dict(zip(FAMILIES, ("h1", "h2", "h3", "h4", "h5", "h6", "h7", "h8", "h9"), strict=True))


def _label(family: str, first: int, second: int, variant: str) -> str:
    number = f"h{9 + int(variant)}" if family == "velocity" else _NUMBERS[family] + variant.strip()
    return f"{number}[{first},{second}]" if second >= 0 else f"{number}[{first}]"
