"""All control-invariant constraints of an inspection problem at once, as rows for the filters.

Row by row ``G (u_i - u_j) >= bound`` is the barrier condition BC >= 0 of eq. 7, with u_j absent where a row
concerns one deputy only.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ...model.checks import of_kind, one_of
from ...model.compiled import loops, plain
from ...model.errors import ScenarioError
from ...model.system import Array
from ..closest import ClosestApproach, map_norms
from ..inspection import Inspection
from ..vectors import CENTRE, STANDSTILL, dot
from .barriers import Radial, SunCone
from .constraint import Constraint
from .motion import MotionBound, SampledData
from .passive import Passive, PassiveSegments
from .speeds import Velocity
from .strengthening import FAMILIES, Strengthening, evaluate, preset
from .table import ConstraintGroup, ConstraintTable, Index


@dataclass(frozen=True, eq=False)
class BarrierRows:
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


class Families(ConstraintTable):
    """The constraints h1 to h11 of all deputies and pairs, and one's own, in one fixed order of rows.

    Parameters
    ----------
    inspection : Inspection
    strengthening : str or mapping from family to Strengthening
        A preset's name, or one function for each of `FAMILIES`; those of one's own constraints may be in it.
    without : collection of str
        Families left out.
    sampled : SampledData, optional
        Tighten the conditions so that they hold between samples.
    exact : bool
        h7 and h8 in full also where they allow every input; without it they may come out smaller there.

    Attributes
    ----------
    labels : tuple of str, length M
        Names of the rows: ``h1[2]``, ``h2[0,3]``; ``h5+`` and ``h5-`` are the two cones of a pair. For
        `family`, `first` and `second` see `ConstraintTable`.
    """

    def __init__(
        self,
        inspection: Inspection,
        strengthening: str | Mapping[str, Strengthening] = "polaris",
        without: Collection[str] = (),
        sampled: SampledData | None = None,
        exact: bool = False,
    ) -> None:
        of_kind("inspection", inspection, Inspection)
        if sampled is not None:
            sampled.growth(inspection.mean_motion)  # refuses periods that are too long
        self.sampled, self.alpha = sampled, _checked(strengthening, inspection.constraints, sampled)
        self.approach = approach = ClosestApproach(inspection.mean_motion, inspection.passive_time)
        beyond = np.inf if exact or sampled is not None else self._beyond(inspection, approach)
        super().__init__(inspection, without, approach, sampled is not None, beyond)
        members = zip(self.family, self.constraints, strict=True)
        numbers = [self.alpha.get(name, one.alpha).numbers for name, one in members]
        self._alpha = tuple(np.array(numbers).T)
        self._rank = np.array([one.rank for one in self.constraints], dtype=np.intp)
        self._largest = np.sqrt(3) * inspection.thrust_max / inspection.mass  # acceleration by thrust
        self.loops: Any = loops("polaris.inspection.loops")
        if self.loops:
            self._fixed, self._about = self._for_loops(), approach.loops
        custom: list[ConstraintGroup] = [group for group in self.groups if group.rows.start >= self.printed]
        self._by_formulas = custom if self.loops else self.groups
        for group in custom if sampled is not None else ():
            if type(group.barrier).curvature is Constraint.curvature:
                rule = "must have a curvature: conditions are to hold between samples"
                raise ScenarioError("constraints", group.barrier.label, rule)

    def _beyond(self, q: Inspection, approach: ClosestApproach) -> float:
        """Return the value above which a passive constraint allows every input, and need not be exact."""
        reach = float(map_norms(approach.place_maps)[1].max())
        thrust = 1.05 * reach * 2 * np.sqrt(3) * q.thrust_max / q.mass
        per_metre, per_speed = approach.speed_gain
        drift = 2 * q.distance_max * per_metre + 2 * np.sqrt(3) * q.speed_max * per_speed
        return max(self.alpha[name].reaches(thrust + 2 * drift) for name in ("passive", "deputy_passive"))

    def _by_loops(self, x: Array, sun: Array, u: Array | None) -> BarrierRows:
        lead = x.shape[:-2]
        if x.ndim != 3 or sun.shape != lead:
            x, sun = x.reshape(-1, *x.shape[-2:]), np.broadcast_to(sun, lead).reshape(-1)
        pairs, _, _, numbers, _ = self._fixed
        if self.sampled is None:
            about = self._about.approaches(x, pairs, numbers[10], self.approach.numbers)
        else:
            inputs = np.empty((1, 0, 3)) if u is None else plain(u).reshape(len(x), -1, 3)
            about = self._about.motions(x, pairs, inputs, numbers)
        h, G, bound = self.loops.rows(x, plain(sun), about, *self._fixed)
        if len(lead) == 1:
            return BarrierRows(h, G, bound)
        return BarrierRows(h.reshape(*lead, -1), G.reshape(*lead, -1, 3), bound.reshape(*lead, -1))

    def _for_loops(self) -> tuple[Array | Index, ...]:
        """The arguments of `polaris.inspection.loops.rows` that are always the same."""
        q, exact, maps = self.inspection, -np.inf, np.zeros((0, 4, 6))
        flights: tuple[float, ...] = (0.0, 0.0, 0.0)
        table, values = [], np.zeros((self.printed, 9))
        for group in (group for group in self.groups if group.rows.stop <= self.printed):
            barrier, size = group.barrier, group.rows.stop - group.rows.start
            table += [self.loops.FORMULAS[type(barrier).__name__]] * size
            radius = barrier.axis if isinstance(barrier, Velocity) else getattr(barrier, "radius", 0.0)
            values[group.rows, 0] = np.repeat(np.broadcast_to(radius, size // barrier.repeat), barrier.repeat)
            if isinstance(barrier, (Radial, SunCone)):
                values[group.rows, 1], values[group.rows, 2] = barrier.braking.acceleration, barrier.side
            if isinstance(barrier, PassiveSegments):
                flights, maps = barrier.numbers
            elif isinstance(barrier, Passive):
                exact = barrier.beyond + float(np.max(barrier.radius))
        values[:, 3:] = np.array(self._alpha).T[: self.printed]
        about_rows = (q.mean_motion, 1 / q.mass, q.smoothing, q.return_speed, q.field_of_view / 2)
        about_speeds = (CENTRE, STANDSTILL, q.docking_speed, q.nu_1, q.speed_max, exact)
        periods: tuple[float, ...] = (0.0, 0.0, 0.0)
        if self.sampled:
            periods = (self.sampled.period, self.sampled.share, self.sampled.growth(q.mean_motion))
        numbers = np.array([*about_rows, *about_speeds, *periods, self._largest, *flights])
        return q.pairs, np.stack([table, self.place[: self.printed]], axis=1), values, numbers, maps

    def rank(self, h: Array) -> Index:
        """Return ranks of rows, shape (..., M) as h: where not all can be met, higher ranks give way first.

        In the order of `Kind.rank`; within each, rows that keep what holds (``h >= 0``) before rows that
        ask for the way back.
        """
        return np.asarray(2 * self._rank + (h < 0))

    def missed(self, rows: BarrierRows, u: Array) -> Array:
        """Return how much inputs (..., N, 3) miss each row [N], 0 where they meet it; shape (..., M).

        Along the row, per newton of its deputies' thrust; inf where no input changes the row.
        """
        size = np.sqrt(dot(rows.G, rows.G) * np.where(self.second >= 0, 2.0, 1.0))
        gap = np.maximum(rows.bound - dot(rows.G, self.relative(u)), 0.0)
        return np.asarray(np.divide(gap, size, out=np.where(gap > 0, np.inf, 0.0), where=size > 0))

    def clip_inputs(self, desired: Array) -> Array:
        """Return inputs (..., N, 3) [N] clipped to the thrust limits: the nearest to them is looked for.

        The nearest to thrust far beyond the limits is at their corners, and at another corner each period.
        """
        limit = self.inspection.thrust_max
        return np.minimum(np.maximum(desired, -limit), limit)  # quicker than np.clip

    def __call__(self, x: Array, sun: ArrayLike, u: Array | None = None) -> BarrierRows:
        """Barrier conditions at states of shape (..., N, 6) and sun angles of shape (...) [rad].

        For sampled data they hold for every thrust, or, if it is given, for a thrust `u` (..., N, 3) [N].
        """
        q, sun = self.inspection, np.asarray(sun, dtype=float)
        if x.shape[-2:] != (q.deputies, 6):
            raise ScenarioError("x", x.shape, f"must have shape (..., {q.deputies}, 6), one row per deputy")
        parts = [self._by_loops(plain(x), sun, u)] if self.loops else []
        if self._by_formulas:
            parts.append(self._by_formula(x, sun, u))
        if len(parts) == 1:
            return parts[0]
        both = zip(*((rows.h, rows.G, rows.bound) for rows in parts), strict=True)
        return BarrierRows(*(np.concatenate(pair, axis=x.ndim - 2) for pair in both))

    def _by_formula(self, x: Array, sun: Array, u: Array | None) -> BarrierRows:
        """Rows of the groups that loops have not."""
        q, first = self.inspection, self._by_formulas[0].rows.start
        states = self.stack(x)
        drift = states @ q.system.A.T
        sun = sun[..., None]
        motion = self._motion(states, drift, u)
        shape = (*x.shape[:-2], len(self.family) - first)
        h, rate, M = np.empty(shape), np.empty(shape), np.zeros(shape)
        G = np.empty((*shape, 3))
        for group in self._by_formulas:
            barrier, columns = group.barrier, slice(group.rows.start - first, group.rows.stop - first)
            rows = (..., columns)
            z, z_dot = states[..., group.at, :], drift[..., group.at, :]
            h[rows], gradient, change = barrier(z, sun)
            G[..., columns, :] = gradient[..., 3:]
            z_dot = np.repeat(z_dot, barrier.repeat, axis=-2) if barrier.repeat > 1 else z_dot
            rate[rows] = dot(gradient, z_dot) + change
            if motion is not None:
                M[rows] = barrier.curvature(z, sun, motion[group.at])
        G *= 1 / q.mass
        alpha = evaluate(h, *(part[first:] for part in self._alpha))
        bound = -rate - alpha
        if self.sampled is not None:  # or -L_f h - share h / D if that is larger; and M D / 2 more
            D = self.sampled.period
            linear = np.maximum(h, 0.0) * (self.sampled.share / D)
            bound = bound + np.maximum(alpha - linear, 0.0) * (h > 0) + M * (D / 2)
        # What one's own constraint cannot say of a state no input satisfies; the other rows are kept.
        invalid = np.isnan(bound) | ~np.isfinite(h) | ~np.isfinite(G).all(axis=-1)
        invalid[..., : max(self.printed - first, 0)] = False
        G[invalid], bound[invalid] = 0.0, np.inf
        return BarrierRows(h, G, bound)

    def _motion(self, states: Array, drift: Array, u: Array | None) -> MotionBound | None:
        """Return the motion that is possible within a period; None if not sampled."""
        if self.sampled is None:
            return None
        q = self.inspection
        if u is not None:
            push = self.stack(u) / q.mass
            rates = drift + np.concatenate([np.zeros_like(push), push], axis=-1)
            return self.sampled.motion(states, rates, q.mean_motion, np.sqrt(dot(push, push)), known=True)
        thrust = np.full(states.shape[-2], self._largest)
        thrust[q.deputies :] *= 2
        return self.sampled.motion(states, drift, q.mean_motion, thrust)


def _checked(
    strengthening: str | Mapping[str, Strengthening], own: Collection[Constraint], sampled: SampledData | None
) -> dict[str, Strengthening]:
    if isinstance(strengthening, str):
        return preset(strengthening, sampled is not None)
    of_kind("strengthening", strengthening, str | Mapping)
    for name in FAMILIES:
        if name not in strengthening:
            raise ScenarioError(
                "strengthening", list(strengthening), f"must have every family: {name} is missing"
            )
    for name, alpha in strengthening.items():
        one_of("strengthening", name, (*FAMILIES, *(one.family or one.label for one in own)))
        of_kind(f"strengthening.{name}", alpha, Strengthening)
    return dict(strengthening)
