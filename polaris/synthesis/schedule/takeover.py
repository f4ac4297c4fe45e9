"""S where a flight is aborted: from which sets, along which branch (docs/theory.md, Proposition 15 (c))."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from reach.sets.zonotope import Zonotope

from ...model.system import Array
from ...model.tolerances import ROUNDING
from ..controllers.controllers import TubeSegment
from ..safety.carried_rows import error_tube
from ..safety.demand import command_noise
from ..safety.get_safety import Safety
from ..safety.goal_rows import distance, goal_rows
from ..safety.problem import PoweredAbort
from ..safety.recoverable import Margin, RecoverableSet, directed
from ..tracker.tracking import Tracking
from .arrival import long_after, spare, tolerated

SPARE = 0.02
"""Share by which claims are loosened, and plans kept further away: a checker merges sets in its own way."""


@dataclass(frozen=True, eq=False)
class Takeover:
    """Where S may have taken over if the flight is aborted in step k: from which sets, at which nodes."""

    k: int
    first: int  # node of the grid; the sets follow one another
    sets: Zonotope
    tube: TubeSegment | None  # of the step, if U flies it
    spent: float  # velocity change until then at most, that of S in this step apart [m/s]

    @classmethod
    def each(
        cls, safety: Safety, flown: Sequence[tuple[int, TubeSegment]], spent: Array
    ) -> tuple["Takeover", ...]:
        """Of every step, from who flies it, in which tube, and for which velocity change (K,) [m/s]."""
        found, since, start, until = [], 0, safety.start, np.cumsum(spent) * (1 + SPARE)
        for k, (mode, tube) in enumerate(flown):
            if mode:
                found.append(cls(k, k * safety.clearance.q, tube.states, tube, until[k]))
                since, start = (k + 1) * safety.clearance.q, tube.end
            else:
                one = Zonotope(start.c[None], start.G[None])
                found.append(cls(k, since, one, None, until[k - 1] if k else 0.0))
        return tuple(found)

    @property
    def last(self) -> int:
        """The last node."""
        return self.first + len(self.sets) - 1

    @property
    def box(self) -> Zonotope:
        """All loop states there."""
        size = self.sets.extent.max(axis=0) * (1 + ROUNDING)
        return Zonotope(np.zeros(len(size)), np.diag(size))

    def margin(self, q: int, sets: RecoverableSet) -> Margin | None:
        """How far they are outside the recoverable sets along some reference; None if they are inside."""
        if self.tube is None:
            margin = sets.margin_at(self.first // q, Zonotope(self.sets.c[0], self.sets.G[0]))
        else:
            margin = sets.margin(self.k, self.sets, self.tube.bow)
        return None if margin.inside else margin

    def over_cells(self, tracking: Tracking, rows: Array, cells: int, periods: int | None = None) -> Array:
        """Return their needs along rows within every cell, or its first periods, shape (cells, r)."""
        tube, q = error_tube(tracking, self.box, rows), tracking.feedback.nodes_per_cell
        return tube.over_cells(cells, q, self.first, self.last, periods)


@dataclass(frozen=True, eq=False)
class Way:
    """What is proven of an abort in one step."""

    branch: int | None  # along which branch; None if nothing is proven
    cell: int = 0  # at whose start the orbit is reached
    delta_v: float = 0.0  # velocity change of S from the abort until then, at most [m/s]
    why: str = ""  # it is not proven
    short: float = 0.0  # by how much, in the unit of what lacks; 0 if no branch is found
    budget: str = ""  # what to raise, if only a budget is in the way


@dataclass(frozen=True, eq=False)
class Branch:
    """S along a reference that leaves the schedule's at the start of a step, towards the orbit."""

    step: int
    safety: Safety

    @cached_property
    def goal(self) -> tuple[Array, Array, float]:
        """Rows of the orbit, their sides, and what counts as reached [m]."""
        rows, sides = goal_rows(self.safety.problem)
        return rows, sides, tolerated(self.safety, rows, True)

    def serve(self, taken: Takeover, asked: PoweredAbort, place: int) -> Way:
        """What is proven of aborts in a step along this branch, the one at a place in their list."""
        margin = taken.margin(self.safety.clearance.q, self.safety.recoverable)
        if margin is not None:
            return Way(None, why=f"S is not proven to recover: {margin}", short=margin.need - margin.room)
        found, off = self._reached(taken, asked.within)
        if found is None:
            told = f"{off:.4g} m off at best, {self.goal[2]:.4g} m allowed"
            return Way(None, why=f"the orbit is not reached in time: {told}", short=off - self.goal[2])
        spent = self._spent(taken, found)
        if asked.budget is not None and spent > asked.budget:
            told = f"S may need {directed(spent, '.4g', up=True)} m/s, {asked.budget:g} m/s are allowed"
            return Way(None, why=told, short=spent - asked.budget, budget="abort.delta_v_max_m_s")
        tank = self.safety.problem.tank
        if tank is not None and taken.spent + spent > tank:
            parts = (directed(x, ".4g", up=True) for x in (taken.spent, spent))
            told = "up to {} m/s are spent and S may need {} m/s, the tank holds {:g} m/s".format(
                *parts, tank
            )
            return Way(None, why=told, short=taken.spent + spent - tank, budget="tank.delta_v_m_s")
        return Way(place, found, spent)

    def _reached(self, taken: Takeover, within: float | None) -> tuple[int | None, float]:
        """The first cell of the tail, in time, at whose start the orbit is reached; how far off at best."""
        safety, (rows, sides, tolerance) = self.safety, self.goal
        K, tracking, reference = safety.problem.K, safety.tracking, safety.reference
        last = reference.cells
        if within is not None:
            last = min(last, taken.k + int(within / safety.problem.delta * (1 + ROUNDING)))
        if last < K:
            return None, np.inf
        states = reference.chi[K : last + 1]
        need, q = taken.over_cells(tracking, rows, last + 1, 0)[K:], safety.clearance.q
        far = np.arange(K, last + 1) * q - taken.last > tracking.long
        settled = long_after(tracking, rows, taken.box) * (1 + spare(tracking)) + tracking.upset(rows)[-1]
        need = np.where(far[:, None], np.minimum(need, settled), need)
        need = need + safety.clearance.tail_need(rows, (last - K) * q + 1)[::q]
        need = (need + np.abs(rows) @ tracking.system.displaced_at_nodes) * (1 + SPARE)
        size = ROUNDING * (np.abs(states) @ np.abs(rows).T + np.abs(sides))
        most = distance(safety.problem.goal.conditions, states @ rows.T - sides + need + size)
        there = np.flatnonzero(most <= tolerance)
        return (K + int(there[0]) if len(there) else None), float(most.min())

    def _spent(self, taken: Takeover, end: int) -> float:
        """Bound on S's velocity change from an abort in a step until the start of a cell [m/s]."""
        safety, tracking, system = self.safety, self.safety.tracking, self.safety.problem.system
        both = tracking.commands
        need = taken.over_cells(tracking, both, end) + safety.clearance.round_off(both[:, : system.n])
        need = need + safety.clearance.scheduled(both)[:end].max(axis=1)
        need[(K := safety.problem.K) :] += safety.clearance.jump_need(both[:, : system.n])
        most = need.reshape(end, 2, -1).max(axis=1) + np.abs(safety.reference.nu[:end])
        most = np.minimum(most + command_noise(tracking, end, K), system.u_max)
        spent = float(system.spent(most[taken.k :]).sum()) * safety.problem.delta
        wrong = (fault.wrong(system.thrusters).sum(axis=1) * fault.lasts for fault in system.transients)
        spent += float(np.max(np.concatenate([np.zeros(1), *wrong])))  # [N s], until a fault is isolated
        return (spent + system.thrusters.made(system.m * system.timing.carried)) / system.mass * (1 + SPARE)
