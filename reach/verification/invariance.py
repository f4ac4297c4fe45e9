"""Staying in a polytope: one tube along its normals, sharper where it must be."""

from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ..numerics.checks import Array
from ..numerics.errors import Unresolved
from ..sets.convex import ConvexSet
from ..sets.polytope import HPolytope
from ..tubes.bounds import EffortBudget
from ..tubes.stepping import Steps
from ..tubes.systems import LinearSystem
from ..tubes.trajectory import Trajectory, worst_case
from ..tubes.tubes import SupportTube, tube_of
from .specification import Verdict

REPLAY = 1e-9
"""A replayed trajectory must pass a limit by this share of its size before it counts as a violation."""

SHARPER = 8.0  # factor by which the tolerance shrinks while neither proof nor violation is found
FIRST, LAST = 0.05, 1e-7  # first and last tolerance, as shares of the size of the quantity bounded


@dataclass(frozen=True, eq=False)
class Motions:
    """All trajectories of a system from an initial set, asked about within a window of time."""

    system: LinearSystem
    initial: ConvexSet
    window: tuple[float, float]
    effort: EffortBudget  # of all tubes and trajectories together

    def sizes(self, rows: Array, limits: Array) -> Array:
        """Sizes in which rows (r, n) are measured, shape (r,): of their limits and over the initial set."""
        extent = np.maximum(self.initial.support(rows), self.initial.support(-rows))
        size = np.maximum(np.abs(limits), extent)
        return np.where(size > 0, size, 1.0)

    @cached_property
    def visited(self) -> Array:
        """Largest absolute values of the states up to the end of the window, never too small, shape (n,)."""
        n, end = self.system.dim, self.window[1]
        axes = np.vstack([np.eye(n), -np.eye(n)])
        bounds = self.initial.support(axes)
        if end > 0:
            bounds = self._support_tube(axes).most
        return np.asarray(np.maximum(bounds[:n], bounds[n:]).clip(min=0))

    def _support_tube(self, C: Array, **options: Any) -> SupportTube:
        return tube_of(self.system, self.initial, self.window[1], C, Steps(effort=self.effort, **options))

    def tube(self, C: Array, tolerance: Array, limits: Array) -> SupportTube:
        """A tube as sharp as a tolerance asks; between nodes a bound below its limit is sharp enough."""
        end = self.window[1]
        if end == 0:
            start, empty = self.initial.support(C)[None], np.zeros((0, len(C)))
            return SupportTube(np.zeros(1), C, start, start, empty, empty)
        limits = limits if self.window[0] < end else np.full(len(C), np.inf)
        return self._support_tube(C, tolerance=tolerance, limit=limits)

    def worst_case(self, instant: float, d: Array, tolerance: float, step: float) -> Trajectory:
        """`reach.worst_case` by a tolerance; with the step of the tube where that cannot be."""
        with suppress(Unresolved):
            return worst_case(self.system, self.initial, instant, d, tolerance=tolerance)
        return worst_case(self.system, self.initial, instant, d, step=step)

    def window_bounds(self, tube: SupportTube) -> tuple[Array, Array]:
        """Times, one each, and bounds (k, r) over a cover of the window: intervals, or nodes if discrete."""
        (begin, end), before, after = self.window, tube.times[:-1], tube.times[1:]
        if self.system.discrete or len(before) == 0:
            inside = (tube.times >= begin) & (tube.times <= end)
            return tube.times[inside], tube.upper[inside]
        if begin == end:
            return np.array([end]), tube.at([end])
        meets = (before < end) & (after > begin)
        return np.clip((before + after)[meets] / 2, begin, end), tube.interval[meets]

    def extremes(self, tube: SupportTube) -> tuple[Array, Array, Array]:
        """Bounds over the window, where it is reached most, and the attained values there, each (r,)."""
        bounds = self.window_bounds(tube)[1].max(axis=0)
        inside = np.nonzero((tube.times >= self.window[0]) & (tube.times <= self.window[1]))[0]
        if len(inside) == 0:
            nowhere = np.full(len(bounds), -np.inf)
            return bounds, nowhere, nowhere
        peak = inside[np.argmax(tube.attained[inside], axis=0)]
        return bounds, tube.times[peak], tube.attained[peak, np.arange(len(bounds))]


def verify_always(motions: Motions, region: HPolytope) -> Verdict:
    """`verify` for a region to stay in: one tube along its normals, sharper where it must be."""
    C, limits = region.A, region.b
    lengths, size = np.linalg.norm(C, axis=1), motions.sizes(C, limits)
    bounds, reached = np.full(len(C), np.inf), np.full(len(C), -np.inf)
    share, steps, rows = FIRST, 0, np.arange(len(C))

    def verdict(status: str, margin: float, reason: str, path: Trajectory | None = None) -> Verdict:
        return Verdict(status, margin, bounds, reached, path, steps, reason)

    while len(rows):
        if share < LAST:
            gap = np.max((np.abs(bounds - reached) / size)[rows])
            reason = f"bounds and trajectories are within {gap:.1g} of each other and of the limit"
            return verdict("unknown", np.nan, reason)
        try:
            tube = motions.tube(C[rows], share * size[rows], limits[rows])
        except Unresolved as exc:
            return verdict("unknown", np.nan, f"neither proven nor violated: {exc}")
        steps = len(tube.times) - 1
        bounds[rows], instants, reached[rows] = motions.extremes(tube)
        broken = np.nonzero(reached > limits)[0]
        if len(broken):
            row = int(broken[np.argmax((reached - limits)[broken] / size[broken])])
            instant, excess = float(instants[rows.tolist().index(row)]), float(reached[row] - limits[row])
            path = motions.worst_case(instant, C[row], excess / 2, motions.window[1] / max(steps, 1))
            value = float(C[row] @ path.states[-1])
            if value > limits[row] + REPLAY * size[row]:
                reason = f"row {row} reaches {value:.6g} at t = {instant:.6g}, its limit is {limits[row]:.6g}"
                return verdict("violated", float((limits[row] - value) / lengths[row]), reason, path)
        rows, share = np.nonzero(~(bounds <= limits))[0], share / SHARPER
    margin = float(np.min((limits - bounds) / lengths))
    return verdict("proven", margin, f"every bound keeps {margin:.6g} from its limit")
