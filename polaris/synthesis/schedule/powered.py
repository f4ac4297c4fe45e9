"""Powered abort: from whatever instant of a step S flies to a named orbit, in time and within a budget.

Where the orbit is not the schedule's own goal, S flies on along the reference until a branch leaves it, which
was planned beforehand; one branch serves the steps before it for as long as all is proven of them.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reach.sets.zonotope import Zonotope

from ...model.errors import NotCertified, OutOfTime, SynthesisInfeasible
from ...model.system import Array
from ...model.tolerances import ROUNDING
from ...planning.problem import PlanProblem
from ...planning.recheck import known_plan
from ...planning.reference import Reference
from ...planning.solve import plan
from ..controllers.controllers import TubeSegment
from ..safety.attempts import perceive_unsafe, plan_problem
from ..safety.carried_rows import CarriedRows
from ..safety.clearance import Clearance
from ..safety.end_condition import coast, judge_end, tail_length
from ..safety.get_safety import Safety, get_recover
from ..safety.problem import PoweredAbort, Problem
from .arrival import SPARE
from .takeover import Branch, Takeover, Way

LATEST = 0.25
"""Share of the time that an abort may take after which, at the latest, its branch leaves the reference."""
PROGRAMS = 300  # most linear programs that the plan of one branch takes
TOLD = "leaves_s", "by_s", "delta_v_m_s", "safe_until_s"  # of an abort in a step, as in `PoweredSafety.told`


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


@dataclass(frozen=True, eq=False)
class KnownBranches:
    """Branches that were planned before: where each leaves, its path, and which one serves each step."""

    steps: Sequence[int]
    inputs: Sequence[Array]  # until it coasts, (steps of the branch, m)
    facets: Sequence[NDArray[np.int_]]  # in every cell from the start of the flight on, (cells, n_o)
    serve: Sequence[int | None]  # each step, by their places; None of steps that none serves
    why: Sequence[str]  # for these steps, none serves them; "" for others


def powered(
    safety: Safety, flown: Sequence[tuple[int, TubeSegment]], spent: Array, known: KnownBranches | None = None
) -> PoweredSafety | None:
    """Return what is proven of aborts with thrust in every step of a schedule, if anything is asked of them.

    `flown` holds who flies each step (0 is S), and in which tube; `spent` the velocity change (K,) [m/s].
    Branches are planned unless they are `known`.
    """
    asked, delta = safety.problem.powered, safety.problem.delta
    if asked is None:
        return None
    taken = Takeover.each(safety, flown, spent)
    if asked.goal is None:
        own = Branch(safety.problem.K, safety)
        return PoweredSafety(asked, delta, (own,), tuple(own.serve(each, asked, 0) for each in taken))
    if known is not None:
        parts = zip(known.steps, known.inputs, known.facets, strict=True)
        made = tuple(_branch(safety, asked, *part) for part in parts)
        found = (
            Way(None, why=why) if place is None else made[place].serve(each, asked, place)
            for each, place, why in zip(taken, known.serve, known.why, strict=True)
        )
        return PoweredSafety(asked, delta, made, tuple(found))
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
    b, tracking = taken[-1].k + 1, safety.tracking
    problem, tail = _aborted(safety, asked, b + n), tail_length(tracking)
    unsafe = perceive_unsafe(problem, problem.K + tail)
    most = min(problem.planner.max_linear_programs, PROGRAMS)
    try:
        wanted = _wanted(plan_problem(problem, tracking, unsafe), safety, taken, tail)
        found = plan(wanted, replace(problem.planner, max_linear_programs=most, progress=None))
    except (SynthesisInfeasible, NotCertified, OutOfTime) as error:
        return f"no branch is found: {error}"
    facets = np.vstack([safety.clearance.facets[:b], found.facets.T, found.tail_facets.T])
    return _branch(safety, asked, b, found.nu, facets)


def _aborted(safety: Safety, asked: PoweredAbort, K: int) -> Problem:
    """Return the problem of a flight that is aborted and reaches the orbit after K steps."""
    near, slow, goal = asked.tolerance, asked.velocity_tolerance, asked.goal or safety.problem.goal
    aborted = replace(safety.problem, K=K, abort=None, powered=None)
    return replace(aborted, goal=goal, goal_tolerance=near, goal_velocity_tolerance=slow)


def _branch(safety: Safety, asked: PoweredAbort, b: int, inputs: Array, facets: NDArray[np.int_]) -> Branch:
    """Return the branch that leaves the reference at the start of step b and flies these inputs."""
    problem, tracking = _aborted(safety, asked, b + len(inputs)), safety.tracking
    tail = tail_length(tracking)
    unsafe = perceive_unsafe(problem, problem.K + tail)
    nu = np.vstack([safety.reference.nu[:b], inputs])
    path = Reference.propagate(problem.system, problem.delta, problem.initial_set.c, nu)
    reference, jump = coast(path, tail)
    clearance = Clearance(tracking, reference, unsafe, facets, problem.K, jump)
    recoverable = get_recover(problem.recoverable, clearance, safety.bounds)
    end = judge_end(tracking, reference, problem.K, tail, unsafe, safety.start_margin)
    start = recoverable.margin_at(0, safety.start)
    proven = replace(safety, clearance=clearance, recoverable=recoverable, start_margin=start, end=end)
    found = known_plan(path, problem.K, facets)
    return Branch(b, replace(proven, problem=problem, plan=found, reference=reference))


def _wanted(asked: PlanProblem, safety: Safety, taken: Sequence[Takeover], tail: int) -> PlanProblem:
    """The planning problem of a branch: from the reference on, with what S needs where it may take over."""
    tracking, system, b = safety.tracking, asked.system, taken[-1].k + 1
    chi = Reference.propagate(system, asked.delta, asked.x0, safety.reference.nu[:b]).chi[-1]

    def needed(rows: Array) -> Array:
        table, parts = CarriedRows.of(tracking, rows), []
        for each in taken:
            for i in {0, len(each.sets) // 2, len(each.sets) - 1}:
                one = Zonotope(each.sets.c[i], each.sets.G[i])
                one = one.inflate(np.pad(each.bow[i], (0, one.dim - system.n)))
                q, node = tracking.feedback.nodes_per_cell, each.first + i
                parts.append(table.tube(one).over_cells(asked.K, q, node)[b:])
        most: Array = np.max(parts, axis=0) * (1 + SPARE)
        return np.asarray(most + safety.clearance.scheduled(rows).max(axis=(0, 1)))

    margins = [
        np.maximum(known[b:], needed(-body.normals @ system.position))
        for body, known in zip(asked.unsafe, asked.margins, strict=True)
    ]
    thrust = needed(tracking.commands).reshape(asked.K - b, 2, -1).max(axis=1)
    left = system.u_max * (1 - SPARE) - thrust - tracking.worst_noise
    unsafe = tuple(replace(body, offsets=body.offsets[b:]) for body in asked.unsafe)
    limit = np.maximum(np.minimum(asked.u_limit[b:], left), 0.0)
    asked = replace(asked, x0=chi, K=asked.K - b, unsafe=unsafe, margins=tuple(margins), u_limit=limit)
    return replace(asked, objective="fuel", extra_margin=0.0, tail_cells=tail)
