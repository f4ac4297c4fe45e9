"""Powered abort: from any instant of a step S flies to a named orbit, in time and within a budget.

Where the orbit is not the schedule's own goal, S flies on along the reference until a branch leaves it, which
was planned beforehand; one branch serves the steps before it for as long as all is proven of them.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
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
from ..safety.carried_rows import CarriedRows, SetTightening
from ..safety.clearance import Clearance
from ..safety.corrections import Corrections
from ..safety.end_condition import coast, prove_end, tail_length
from ..safety.get_safety import Safety, get_recover
from ..safety.problem import PoweredAbort, Problem
from .abort_branch import AbortBranch, AbortStep, Takeover
from .arrival import SPARE

LATEST = 0.25
"""Share of the time that an abort may take after which, at the latest, its branch leaves the reference."""
ARRIVES = 1.0, 0.8
"""Shares of that time after which the plan of a branch ends: a shorter flight spends less on corrections, and
the errors of its last commands fade before the orbit is due."""
PROGRAMS = 300  # most linear programs that the plan of one branch takes
STEP_KEYS = (
    "leaves_s",
    "by_s",
    "delta_v_m_s",
    "safe_until_s",
)  # of an abort in a step, as in `PoweredSafety.to_dict`


@dataclass(frozen=True, eq=False)
class PoweredSafety:
    """Steps from which S reaches the orbit, aborting at any instant of them, and how it does."""

    abort: PoweredAbort
    delta: float  # step of the schedule [s]
    branches: tuple[AbortBranch, ...]
    ways: tuple[AbortStep, ...]

    def require(self) -> None:
        """Raise `SynthesisInfeasible`, or `NotCertified` for a budget, if a required abort is not proven."""
        unproven = [(k, way) for k, way in enumerate(self.ways) if way.branch is None]
        if not (self.abort.required and unproven):
            return
        k, way = max(unproven, key=lambda each: (not each[1].budget, each[1].short))
        message = f"the required powered abort is not proven in {len(unproven)} of {len(self.ways)} steps"
        message += f"; in step {k} (from {k * self.delta:g} s) {way.why}"
        if way.budget:
            raise NotCertified(f"{message}; raise {way.budget} by {way.short:.4g}")
        raise SynthesisInfeasible(f"{message}.", way.short, "raise abort.within_s, or widen the orbit.")

    def to_dict(self) -> dict[str, Any]:
        """Return the claims that a run makes of it, as JSON."""
        steps, delta = list[dict[str, Any]](), self.delta
        for k, way in enumerate(self.ways):
            values: tuple[float | None, ...] = (None,) * len(STEP_KEYS)
            if way.branch is not None:
                branch = self.branches[way.branch]
                ends = until if np.isfinite(until := branch.safety.end.until) else None
                values = branch.step * delta, way.cell * delta, way.delta_v, ends
            steps.append({"step": k, **dict(zip(STEP_KEYS, values, strict=True)), "why": way.why or None})
        return {"within_s": self.abort.within, "delta_v_max_m_s": self.abort.budget, "steps": steps}


@dataclass(frozen=True, eq=False)
class KnownBranches:
    """Branches that were planned before: where each leaves, its path, and which one serves each step."""

    steps: Sequence[int]
    inputs: Sequence[Array]  # until it coasts, (steps of the branch, m)
    facets: Sequence[NDArray[np.int_]]  # in every cell from the start of the flight on, (cells, n_o)
    serve: Sequence[int | None]  # each step, by their places; None of steps that none serves
    reasons: Sequence[str]  # for these steps, none serves them; "" for others


def powered(
    safety: Safety, tubes: Sequence[tuple[int, TubeSegment]], costs: Array, known: KnownBranches | None = None
) -> PoweredSafety | None:
    """Return the proven powered aborts from every step of a schedule, or None if none are required.

    `tubes` holds who flies each step (0 is S), and in which tube; `costs` the velocity change (K,) [m/s].
    Branches are planned unless they are `known`.
    """
    abort, delta = safety.problem.powered, safety.problem.delta
    if abort is None:
        return None
    takeovers = Takeover.for_steps(safety, tubes, costs)
    search = BranchSearch(safety, abort, takeovers)
    if abort.goal is None:
        trunk = AbortBranch(safety.problem.K, safety, search.corrections)
        return PoweredSafety(abort, delta, (trunk,), tuple(trunk.serve(each, abort, 0) for each in takeovers))
    if known is not None:
        parts = zip(known.steps, known.inputs, known.facets, strict=True)
        rebuilt = tuple(search.branch(*part) for part in parts)
        replayed = (
            AbortStep(None, why=reason) if place is None else rebuilt[place].serve(each, abort, place)
            for each, place, reason in zip(takeovers, known.serve, known.reasons, strict=True)
        )
        return PoweredSafety(abort, delta, rebuilt, tuple(replayed))
    branches, ways = list[AbortBranch](), list[AbortStep]()
    while len(ways) < len(takeovers):
        served, lost = list[AbortStep](), list[AbortStep]()
        for branch in search.branches(len(ways)):
            if isinstance(branch, str):
                lost.append(AbortStep(None, why=branch))
                continue
            for each in takeovers[len(ways) : branch.step]:
                way = branch.serve(each, abort, len(branches))
                if way.branch is None:
                    break
                served.append(way)
            if served:
                branches.append(branch)
                break
            lost.append(way)
        ways += served or [
            min(lost, key=lambda way: way.lacks, default=AbortStep(None, why="there is no time for a branch"))
        ]
    return PoweredSafety(abort, delta, tuple(branches), tuple(ways))


@dataclass(frozen=True, eq=False)
class BranchSearch:
    """Search for branches that serve steps from the sets which S may take over in them."""

    safety: Safety
    abort: PoweredAbort
    takeovers: Sequence[Takeover]
    _tubes: dict[tuple[bytes, int], list[tuple[int, SetTightening]]] = field(default_factory=dict, repr=False)

    @cached_property
    def corrections(self) -> Corrections:
        """Bounds on S's corrections, along any branch."""
        return Corrections(self.safety.tracking)

    def branches(self, k: int) -> Iterator[AbortBranch | str]:
        """Yield branches for aborts from step k on, late ones first; or why there is none."""
        assert self.abort.within is not None
        time, steps = int(self.abort.within / self.safety.problem.delta * (1 + ROUNDING)), len(self.takeovers)
        stride = max(1, round(LATEST * time))
        for b in dict.fromkeys(min(k + count, steps) for count in (stride, max(1, stride // 2), 1)):
            for arrives in dict.fromkeys(k + round(share * time) for share in ARRIVES):
                if b < arrives:
                    yield (branch := self._leave(k, b, arrives - b))
                    if isinstance(branch, str):
                        break  # less time will not do

    def _leave(self, k: int, b: int, n: int) -> AbortBranch | str:
        """Return a branch of n steps that leaves at the start of step b > k; or why there is none."""
        tracking = self.safety.tracking
        problem, tail = self._aborted(b + n), tail_length(tracking)
        unsafe = perceive_unsafe(problem, problem.K + tail)
        limit = min(problem.planner.max_linear_programs, PROGRAMS)
        try:
            task = self._task(plan_problem(problem, tracking, unsafe), self.takeovers[k:b], tail)
            planned = plan(task, replace(problem.planner, max_linear_programs=limit, progress=None))
        except (SynthesisInfeasible, NotCertified, OutOfTime) as error:
            return f"no branch is found: {error}"
        facets = np.vstack([self.safety.clearance.facets[:b], planned.facets.T, planned.tail_facets.T])
        return self.branch(b, planned.nu, facets)

    def _aborted(self, K: int) -> Problem:
        """Return the problem of a flight that is aborted and reaches the orbit after K steps."""
        problem, abort = self.safety.problem, self.abort
        near, slow, goal = abort.tolerance, abort.velocity_tolerance, abort.goal or problem.goal
        aborted = replace(problem, K=K, abort=None, powered=None)
        return replace(aborted, goal=goal, goal_tolerance=near, goal_velocity_tolerance=slow)

    def branch(self, b: int, inputs: Array, facets: NDArray[np.int_]) -> AbortBranch:
        """Return the branch that leaves the reference at the start of step b and flies these inputs."""
        safety, tracking = self.safety, self.safety.tracking
        problem, tail = self._aborted(b + len(inputs)), tail_length(tracking)
        unsafe = perceive_unsafe(problem, problem.K + tail)
        nu = np.vstack([safety.reference.nu[:b], inputs])
        path = Reference.propagate(problem.system, problem.delta, problem.initial_set.c, nu)
        reference, jump = coast(path, tail)
        clearance = Clearance(tracking, reference, unsafe, facets, problem.K, jump)
        recoverable = get_recover(problem.recoverable, clearance, safety.bounds)
        end = prove_end(tracking, reference, problem.K, tail, unsafe, safety.start_margin)
        start = recoverable.margin_at(0, safety.start)
        proven = replace(safety, clearance=clearance, recoverable=recoverable, start_margin=start, end=end)
        proven = replace(
            proven, problem=problem, plan=known_plan(path, problem.K, facets), reference=reference
        )
        return AbortBranch(b, proven, self.corrections)

    def _task(self, task: PlanProblem, takeovers: Sequence[Takeover], tail: int) -> PlanProblem:
        """Return the planning problem of a branch, with S's tightening wherever it may take over."""
        safety, tracking, system = self.safety, self.safety.tracking, task.system
        b, q = takeovers[-1].k + 1, tracking.feedback.nodes_per_cell
        chi = Reference.propagate(system, task.delta, task.x0, safety.reference.nu[:b]).chi[-1]

        def needed(rows: Array) -> Array:
            tubes = (each for one in takeovers for each in self._from(one, rows))
            parts = [tube.over_cells(task.K, q, node)[b:] for node, tube in tubes]
            largest: Array = np.max(parts, axis=0) * (1 + SPARE)
            return np.asarray(largest + safety.clearance.scheduled(rows).max(axis=(0, 1)))

        margins = [
            np.maximum(margin[b:], needed(-body.rows(system)))
            for body, margin in zip(task.unsafe, task.margins, strict=True)
        ]
        thrust = needed(tracking.commands).reshape(task.K - b, 2, -1).max(axis=1)
        slack = system.u_max * (1 - SPARE) - thrust - tracking.worst_noise
        unsafe = tuple(replace(body, offsets=body.offsets[b:]) for body in task.unsafe)
        limit = np.maximum(np.minimum(task.u_limit[b:], slack), 0.0)
        task = replace(task, x0=chi, K=task.K - b, unsafe=unsafe, margins=tuple(margins), u_limit=limit)
        return replace(task, objective="fuel", extra_margin=0.0, tail_cells=tail)

    def _from(self, takeover: Takeover, rows: Array) -> list[tuple[int, SetTightening]]:
        """Return first nodes and tightenings of rows for some of the sets that S may take over in a step."""
        key, n = (rows.tobytes(), takeover.k), self.safety.problem.system.n
        if key not in self._tubes:
            table = CarriedRows.from_tracking(self.safety.tracking, rows)
            self._tubes[key] = []
            for i in sorted({0, len(takeover.sets) // 2, len(takeover.sets) - 1}):
                one = Zonotope(takeover.sets.c[i], takeover.sets.G[i])
                one = one.inflate(np.pad(takeover.intersample[i], (0, one.dim - n)))
                self._tubes[key].append((takeover.first + i, table.tube(one)))
        return self._tubes[key]
