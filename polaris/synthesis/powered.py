"""Powered abort: from whatever instant of a step S flies to a named orbit, in time and within a budget.

Where the orbit is not the schedule's own goal, S flies on along the reference until a branch leaves it, which
was planned beforehand; one branch serves the steps before it for as long as all is proven of them.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from reach.sets.zonotope import Zonotope

from ..model.errors import NotCertified, OutOfTime, SynthesisInfeasible
from ..model.system import Array
from ..model.tolerances import ROUNDING
from ..planning.problem import PlanProblem
from ..planning.reference import Reference
from ..planning.solve import plan
from .arrival import distance, goal_rows, tolerated
from .attempts import perceive_unsafe, plan_problem
from .clearance import Clearance, error_tube
from .controllers import TubeSegment
from .demand import command_errors
from .end_condition import coast, judge_end, tail_length
from .get_safety import Safety, get_recover
from .problem import PoweredAbort
from .recoverable import Margin, RecoverableSet, directed
from .tracking import Tracking, at_nodes

LATEST = 0.25
"""Share of the time that an abort may take after which, at the latest, its branch leaves the reference."""
PROGRAMS = 300
"""Most linear programs that the plan of one branch takes."""
SPARE = 0.02
"""Share by which claims are loosened, and plans kept further away: a checker merges sets in its own way."""
TOLD = "leaves_s", "by_s", "delta_v_m_s", "safe_until_s"
"""What is told of an abort in a step, in the order of `PoweredSafety.told`."""


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
                found.append(cls(k, k * safety.clearance.q, tube.nodes, tube, until[k]))
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
    def size(self) -> Array:
        """Bound on all errors there, elementwise, shape (n,)."""
        return np.asarray(self.sets.extent.max(axis=0) * (1 + ROUNDING))

    def margin(self, q: int, sets: RecoverableSet) -> Margin | None:
        """How far they are outside the recoverable sets along some reference; None if they are inside."""
        if self.tube is not None:
            holds = sets.holds(self.k, self.tube.nodes, self.tube.bow)
            return None if holds else sets.margin(self.k, self.tube.nodes, self.tube.bow)
        margin = sets.margin_at(self.first // q, Zonotope(self.sets.c[0], self.sets.G[0]))
        return None if margin.inside else margin

    def over(self, tracking: Tracking, rows: Array, cells: int) -> tuple[Array, Array]:
        """What they need along rows within every cell, and at its start, for all instants of the abort.

        Each of shape (cells, r), zero in the cells before step k, where nothing is aborted.
        """
        box = Zonotope(np.zeros(len(self.size)), np.diag(self.size))
        need = error_tube(tracking, box, rows).need
        q, end = tracking.feedback.nodes_per_cell, len(need) - 1
        within, at = np.zeros((2, cells, len(rows)))
        for c in range(self.k, cells):
            low, node = max(c * q - self.last, 0), max(c * q - self.first, 0)
            at[c] = need[min(low, end) : min(node, end) + 1].max(axis=0)
            within[c] = need[min(low, end) : min(node + q, end) + 1].max(axis=0)
        return within, at


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
        return rows, sides, tolerated(self.safety, rows)

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
        if last < K or safety.guarantee != "proved":
            return None, np.inf
        states = reference.chi[K : last + 1]
        need = taken.over(tracking, rows, last + 1)[1][K:] + safety.clearance.tail_need(rows)[0]
        need = (need + np.abs(rows) @ tracking.system.displaced_at_nodes) * (1 + SPARE)
        size = ROUNDING * (np.abs(states) @ np.abs(rows).T + np.abs(sides))
        most = distance(safety.problem.goal.conditions, states @ rows.T - sides + need + size)
        there = np.flatnonzero(most <= tolerance)
        return (K + int(there[0]) if len(there) else None), float(most.min())

    def _spent(self, taken: Takeover, end: int) -> float:
        """Bound on S's velocity change from an abort in a step until the start of a cell [m/s]."""
        safety, tracking, system = self.safety, self.safety.tracking, self.safety.problem.system
        both = np.vstack([tracking.gain, -tracking.gain])
        need = taken.over(tracking, both, end)[0] + safety.clearance.round_off(both)
        need = need + safety.clearance.scheduled(both)[:end].max(axis=1)
        need[safety.problem.K :] += safety.clearance.jump_need(both)
        most = need.reshape(end, 2, -1).max(axis=1) + np.abs(safety.reference.nu[:end])
        most = np.minimum(most + command_errors(system, tracking.gain, end), system.u_max)
        spent = float(system.spent(most[taken.k :]).sum()) * safety.problem.delta
        wrong = (fault.wrong(system.thrusters).sum(axis=1) * fault.lasts for fault in system.transients)
        spent += float(np.max(np.concatenate([np.zeros(1), *wrong])))  # [N s], until a fault is isolated
        return (spent + system.thrusters.made(system.m * system.timing.carried)) / system.mass * (1 + SPARE)


@dataclass(frozen=True, eq=False)
class PoweredSafety:
    """From which steps S reaches the orbit, aborting at any instant of them, and how."""

    asked: PoweredAbort
    delta: float  # step of the schedule [s]
    branches: tuple[Branch, ...]
    ways: tuple[Way, ...]

    def require(self) -> None:
        """`SynthesisInfeasible`, or `NotCertified` where only the budget is exceeded, if it is required."""
        lost = [(k, way) for k, way in enumerate(self.ways) if way.branch is None]
        if not (self.asked.required and lost):
            return
        k, way = max(lost, key=lambda each: (not each[1].budget, each[1].short))
        told = f"powered abort is required, but in {len(lost)} of {len(self.ways)} steps it is not proven"
        told += f"; in step {k} (from {k * self.delta:g} s) {way.why}"
        if way.budget:
            raise NotCertified(f"{told}; raise {way.budget} by {way.short:.4g}")
        raise SynthesisInfeasible(f"{told}.", way.short, "raise abort.within_s, or widen the orbit.")

    def told(self) -> dict[str, Any]:
        """What a run claims of it."""
        steps, delta = list[dict[str, Any]](), self.delta
        for k, way in enumerate(self.ways):
            found: tuple[float | None, ...] = (None,) * len(TOLD)
            if way.branch is not None:
                branch = self.branches[way.branch]
                ends = until if np.isfinite(until := branch.safety.end.until) else None
                found = branch.step * delta, way.cell * delta, way.delta_v, ends
            steps.append({"step": k, **dict(zip(TOLD, found, strict=True)), "why": way.why or None})
        return {"within_s": self.asked.within, "delta_v_max_m_s": self.asked.budget, "steps": steps}


def powered(safety: Safety, flown: Sequence[tuple[int, TubeSegment]], spent: Array) -> PoweredSafety | None:
    """What is proven of aborts with thrust in every step of a schedule, if anything is asked of them.

    `flown` holds who flies each step (0 is S), and in which tube; `spent` the velocity change (K,) [m/s].
    """
    asked, delta = safety.problem.powered, safety.problem.delta
    if asked is None:
        return None
    taken = Takeover.each(safety, flown, spent)
    if asked.goal is None:
        own = Branch(safety.problem.K, safety)
        return PoweredSafety(asked, delta, (own,), tuple(own.serve(each, asked, 0) for each in taken))
    branches, ways = list[Branch](), list[Way]()
    while len(ways) < len(taken):
        served, lost = list[Way](), Way(None, why="there is no time for a branch")
        for branch in _branches(safety, asked, taken, len(ways)):
            if isinstance(branch, str):
                lost = Way(None, why=branch)
                continue
            for each in taken[len(ways) : branch.step]:
                way = branch.serve(each, asked, len(branches))
                if way.branch is None:
                    break
                served.append(way)
            if served:
                branches.append(branch)
                break
            lost = way
        ways += served or [lost]
    return PoweredSafety(asked, delta, tuple(branches), tuple(ways))


def _branches(
    safety: Safety, asked: PoweredAbort, taken: Sequence[Takeover], k: int
) -> Iterator[Branch | str]:
    """Branches for aborts from step k on, those first that leave late; or why there is none."""
    assert asked.within is not None
    time = int(asked.within / safety.problem.delta * (1 + ROUNDING))
    stride = max(1, round(LATEST * time))
    for ahead in dict.fromkeys((stride, max(1, stride // 2), 1)):
        b = min(k + ahead, len(taken))
        if b < k + time:
            yield _leave(safety, asked, taken[k:b], k + time - b)


def _leave(safety: Safety, asked: PoweredAbort, taken: Sequence[Takeover], n: int) -> Branch | str:
    """A branch of n steps towards the orbit, after the last of some steps; or why there is none."""
    b, goal, tracking = taken[-1].k + 1, asked.goal or safety.problem.goal, safety.tracking
    aborted = replace(safety.problem, K=b + n, abort=None, powered=None)
    problem = replace(aborted, goal=goal, goal_tolerance=asked.tolerance)
    tail = tail_length(tracking)
    unsafe = perceive_unsafe(problem, problem.K + tail)
    most = min(problem.planner.max_linear_programs, PROGRAMS)
    try:
        wanted = _wanted(plan_problem(problem, tracking, unsafe), safety, taken, tail)
        found = plan(wanted, replace(problem.planner, max_linear_programs=most, progress=None))
    except (SynthesisInfeasible, NotCertified, OutOfTime) as error:
        return f"no branch is found: {error}"
    nu = np.vstack([safety.reference.nu[:b], found.nu])
    path = Reference.propagate(problem.system, problem.delta, problem.initial_set.c, nu)
    reference, jump = coast(path, tail)
    facets = np.vstack([safety.clearance.facets[:b], found.facets.T, found.tail_facets.T])
    clearance = Clearance(tracking, reference, unsafe, facets, problem.K, jump)
    recoverable = get_recover(problem.recoverable, clearance, safety.bounds)
    end = judge_end(tracking, reference, problem.K, tail, unsafe, safety.start_margin)
    made = replace(safety, problem=problem, plan=replace(found, chi=path.chi, nu=nu), reference=reference)
    made = replace(made, clearance=clearance, recoverable=recoverable, end=end)
    return Branch(b, replace(made, start_margin=recoverable.margin_at(0, safety.start)))


def _wanted(asked: PlanProblem, safety: Safety, taken: Sequence[Takeover], tail: int) -> PlanProblem:
    """The planning problem of a branch: from the reference on, with what S needs where it may take over."""
    tracking, system, b = safety.tracking, asked.system, taken[-1].k + 1
    chi = Reference.propagate(system, asked.delta, asked.x0, safety.reference.nu[:b]).chi[-1]

    def needed(rows: Array) -> Array:
        parts = []
        for each in taken:
            bow = np.zeros((1, system.n)) if each.tube is None else at_nodes(each.tube.bow)
            for i in {0, len(each.sets) // 2, len(each.sets) - 1}:
                one = Zonotope(each.sets.c[i], each.sets.G[i]).inflate(bow[i])
                tube = error_tube(tracking, one, rows)
                q, last = tracking.feedback.nodes_per_cell, len(tube.need) - 1
                lags = np.arange(b * q, asked.K * q + 1) - each.first - i
                at = tube.need[np.minimum(lags, last)]
                parts.append(np.maximum(at[:-1].reshape(asked.K - b, q, -1).max(axis=1), at[q::q]))
        most: Array = np.max(parts, axis=0) * (1 + SPARE)
        return np.asarray(most + safety.clearance.scheduled(rows).max(axis=(0, 1)))

    margins = [
        np.maximum(known[b:], needed(-body.normals @ system.position))
        for body, known in zip(asked.unsafe, asked.margins, strict=True)
    ]
    thrust = needed(np.vstack([tracking.gain, -tracking.gain])).reshape(asked.K - b, 2, -1).max(axis=1)
    left = system.u_max * (1 - SPARE) - thrust - system.command_error(tracking.gain)
    unsafe = tuple(replace(body, offsets=body.offsets[b:]) for body in asked.unsafe)
    limit = np.maximum(np.minimum(asked.u_limit[b:], left), 0.0)
    asked = replace(asked, x0=chi, K=asked.K - b, unsafe=unsafe, margins=tuple(margins), u_limit=limit)
    return replace(asked, objective="fuel", extra_margin=0.0, tail_cells=tail)
