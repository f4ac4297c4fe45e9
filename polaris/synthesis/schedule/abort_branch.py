"""S where a flight is aborted: from which sets, along which branch (docs/theory.md, Proposition 15 (c))."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from reach.sets.zonotope import Zonotope

from ...model.system import Array
from ...model.tolerances import ROUNDING
from ..controllers.controllers import TubeSegment
from ..safety.continuation import HandOver
from ..safety.corrections import Corrections
from ..safety.get_safety import Safety
from ..safety.problem import PoweredAbort
from ..safety.recoverable import directed
from ..tracker.intersample import at_nodes
from .arrival import SPARE, Nearness
from .spending import tracked


@dataclass(frozen=True, eq=False)
class Takeover:
    """Sets and nodes from which S may have taken over if the flight is aborted in step k."""

    k: int
    first: int  # node of the grid; the sets follow one another
    sets: Zonotope
    intersample: Array  # elementwise between each and its neighbours, (sets, n)
    cost: float  # velocity change until then at most, that of S in this step apart [m/s]

    @classmethod
    def for_steps(
        cls, safety: Safety, tubes: Sequence[tuple[int, TubeSegment]], delta_v: Array
    ) -> tuple["Takeover", ...]:
        """Return all steps' takeovers, by who flies each, in which tube, for which delta-v (K,) [m/s]."""
        takeovers, since, until = [], 0, np.cumsum(delta_v) * (1 + SPARE)
        n, start = safety.tracking.system.n, safety.start
        for k, (mode, tube) in enumerate(tubes):
            if mode:
                takeovers.append(
                    cls(k, k * safety.clearance.q, tube.states, at_nodes(tube.intersample), until[k])
                )
                since, start = (k + 1) * safety.clearance.q, tube.end
            else:
                one = Zonotope(start.c[None], start.G[None])
                takeovers.append(cls(k, since, one, np.zeros((1, n)), until[k - 1] if k else 0.0))
        return tuple(takeovers)

    @property
    def start(self) -> HandOver:
        """All loop states there, in one box."""
        size = self.sets.extent.max(axis=0) * (1 + ROUNDING)
        box = Zonotope(np.zeros(len(size)), np.diag(size))
        return HandOver(box, self.first, self.first + len(self.sets) - 1)


@dataclass(frozen=True, eq=False)
class AbortStep:
    """Result of the proof of an abort in one step."""

    branch: int | None  # along which branch; None if nothing is proven
    cell: int = 0  # at whose start the orbit is reached
    delta_v: float = 0.0  # velocity change of S from the abort until then, at most [m/s]
    why: str = ""  # it is not proven
    short: float = 0.0  # by how much, in the unit of the shortfall; 0 if no branch is found
    budget: str = ""  # what to raise, if only a budget is in the way

    @property
    def lacks(self) -> tuple[bool, bool, float]:
        """Order of reasons, the least first: a budget, anything else that is short, no branch at all."""
        return not self.budget, not self.short, self.short


@dataclass(frozen=True, eq=False)
class AbortBranch:
    """S along a reference that leaves the schedule's at the start of a step, towards the orbit."""

    step: int
    safety: Safety
    corrections: Corrections

    @cached_property
    def goal(self) -> Nearness:
        """Distance from the orbit, and S's commands, a fault included."""
        return Nearness(self.safety, faults=True)

    def serve(self, takeover: Takeover, abort: PoweredAbort, place: int) -> AbortStep:
        """Return the abort of a step along this branch, at a place in the list, or why it is not proven."""
        margin = self.safety.recoverable.tightest(takeover.first, takeover.sets, takeover.intersample)
        if not margin.inside:
            return AbortStep(
                None, why=f"S is not proven to recover: {margin}", short=margin.tightening - margin.clearance
            )
        cell, miss = self._reached(takeover, abort.within)
        if cell is None:
            text = f"it ends within {miss:.4g} m of the orbit, the tolerance is {self.goal.tolerance:.4g} m"
            return AbortStep(
                None, why=f"the orbit is not reached in time: {text}", short=miss - self.goal.tolerance
            )
        delta_v = self._spending(takeover, cell)
        if abort.budget is not None and delta_v > abort.budget:
            text = f"S may need {directed(delta_v, '.4g', up=True)} m/s, the budget is {abort.budget:g} m/s"
            return AbortStep(None, why=text, short=delta_v - abort.budget, budget="abort.delta_v_max_m_s")
        tank = self.safety.problem.tank
        if tank is not None and takeover.cost + delta_v > tank:
            parts = (directed(x, ".4g", up=True) for x in (takeover.cost, delta_v))
            text = "up to {} m/s are used and S may need {} m/s, the tank holds {:g} m/s".format(*parts, tank)
            return AbortStep(None, why=text, short=takeover.cost + delta_v - tank, budget="tank.delta_v_m_s")
        return AbortStep(place, cell, delta_v)

    def _reached(self, takeover: Takeover, within: float | None) -> tuple[int | None, float]:
        """Return the first cell of the tail at whose start the orbit is reached in time; least distance."""
        K, q, last = self.safety.problem.K, self.safety.clearance.q, self.safety.reference.cells
        if within is not None:
            last = min(last, takeover.k + int(within / self.safety.problem.delta * (1 + ROUNDING)))
        if last < K:
            return None, np.inf
        bounds = self.goal.goal_rows.tightenings(takeover.start, K * q, last * q + 1)[0, ::q] * (1 + SPARE)
        misses = self.goal.distance(self.safety.reference.chi[K : last + 1], bounds)
        indices = np.flatnonzero(misses <= self.goal.tolerance)
        return (K + int(indices[0]) if len(indices) else None), float(misses.min())

    def _spending(self, takeover: Takeover, end: int) -> float:
        """Bound on S's velocity change from an abort in a step until the start of a cell [m/s].

        The lesser of the sum of its periods' bounds and of that of all periods at once.
        """
        system, q = self.safety.problem.system, self.safety.clearance.q
        delta_v = tracked(self.goal.commands, [takeover.start], takeover.k * q, end * q)
        wrong = (fault.wrong(system.thrusters).sum(axis=1) * fault.lasts for fault in system.transients)
        impulse = float(np.max(np.concatenate([np.zeros(1), *wrong])))  # [N s], until a fault is isolated
        delta_v = min(delta_v + impulse / system.mass, self._together(takeover, end))
        return (delta_v + system.carried_impulse / system.mass) * (1 + SPARE)

    def _together(self, takeover: Takeover, end: int) -> float:
        """Bound the same by all periods at once since S may have taken over, carried impulse apart [m/s]."""
        mean, system = self.corrections.mean, self.safety.problem.system
        if mean is None:
            return np.inf
        reference, clearance = self.safety.reference, self.safety.clearance
        first, last = min(takeover.first, takeover.k * clearance.q), end * clearance.q
        inputs, count = np.repeat(reference.nu, clearance.q, axis=0)[first:last], last - first
        jump = clearance.jump + count * reference.rounding.max(axis=0)
        parts = (
            count * mean,
            self.corrections.once(takeover.sets, count),
            self.corrections.planned(inputs),
            self.corrections.answer_bound(jump, count),
            self.corrections.late_fault_thrust(count),
        )
        return system.longest * sum(parts) * self.safety.tracking.flow.h / system.mass
