"""The planner's problem, the references that Algorithm 1 tries, and the proof about each after T."""

import time
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from reach.sets.zonotope import Zonotope

from ...model.craft import Array, Craft
from ...model.errors import ClockWarning, NotCertified, OutOfTime, SynthesisInfeasible
from ...model.scene.obstacles import perceive
from ...model.scene.timed_polytope import TimedPolytope
from ...model.tolerances import SOLVER_BOOK_INPUT, SOLVER_BOOK_M
from ...planning.problem import Plan, PlannerOptions, PlanProblem
from ...planning.recheck import path_bounds
from ...planning.reference import Reference
from ...planning.solve import plan
from ..tracker.tracking import Tracking
from .carried_rows import error_tube
from .clearance import facet_clearance
from .end_condition import EndCondition, coast, prove_end, tail_length
from .feedforward import Feedforward
from .goal_rows import inset
from .problem import Problem
from .recoverable import Margin, RecoverableSet

AFRESH = 2  # how often it is planned again where intersample bounds or errors by time leave no clearance
AGAIN = 1000, 2  # linear programs of a plan with coasting: so many, or so many times those without it


class StageClock:
    """Wall time by stage [s]; a stage named twice adds up."""

    def __init__(self) -> None:
        self.laps: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, stage: str) -> None:
        """End a stage, which began where the last one ended."""
        now = time.perf_counter()
        self.laps[stage] = self.laps.get(stage, 0.0) + now - self._last
        self._last = now

    def with_earlier(self, before: Mapping[str, float]) -> dict[str, float]:
        """Return the stages of earlier work and those timed here; ``other`` is the time since the last."""
        self.lap("other")
        return {name: before.get(name, 0.0) + self.laps.get(name, 0.0) for name in [*before, *self.laps]}


class Attempts:
    """References to try in turn: with the coasting tail, without it, and planned again for safe coasting.

    The last only where nothing but the time after T stands in the way, and no plan is given. `plan`, `margin`
    (of `start`, Theta about the reference, in the first recoverable set) and `cut_by_clock` are those of the
    last attempt, `end` that of the last one with a tail; `unsafe` the perceived sets until the tail's end,
    and as far as drifts are followed.
    """

    plan: Plan
    margin: Margin
    end: EndCondition

    def __init__(
        self, problem: Problem, tracking: Tracking, clock: StageClock, known_plan: Plan | None = None
    ) -> None:
        self.problem, self.tracking, self.clock, self.plan_before = problem, tracking, clock, known_plan
        self.tail = tail_length(tracking)
        drift_cells = 0 if problem.abort is None else problem.abort.cells(problem.delta)
        self.unsafe = perceive_unsafe(problem, problem.K + max(self.tail, drift_cells))
        self.start = start_about(problem, tracking)
        self.cut_by_clock: tuple[str, ...] = ()

    def __iter__(self) -> Iterator[tuple[Reference, Array]]:
        """References, and the jump into the tail of each (see `coast`)."""
        if self.plan_before is not None:
            yield from self._references(self.plan_before)
            return
        task = plan_problem(self.problem, self.tracking, self.unsafe)
        self.clock.lap("bounds")
        plan = find_plan(task, self.problem.planner)
        self.cut_by_clock = plan.cut_by_clock
        self.clock.lap("plan")
        yield from self._references(plan)
        for _ in range(AFRESH):
            if (widened := self._allowing(task)) is None:
                break
            task, plan = widened, find_plan(widened, self.problem.planner)
            self.clock.lap("plan")
            yield from self._references(plan)
        if not self.margin.inside:
            return
        self.clock.lap("recoverable")
        coasting = self._with_coasting(task)
        self.clock.lap("plan")
        if coasting is not None:
            yield next(self._references(coasting))
            names, short = (
                [body.name for body in task.unsafe],
                self.margin.tightening - self.margin.clearance,
            )
            if (
                short > 0 and self.margin.limit in names
            ):  # as after T, where the plan leaves less than it needs
                pairs = zip(names, task.margins, strict=True)
                margins = (margin + 1.1 * short * (name == self.margin.limit) for name, margin in pairs)
                coasting = self._with_coasting(replace(task, margins=tuple(margins))) or coasting
                self.clock.lap("plan")
            yield from self._references(coasting)

    def _allowing(self, task: PlanProblem) -> PlanProblem | None:
        """Return the problem with margins that the last plan lacked; None if it fails for other reasons.

        They hold errors by the time of the flight, as large as along that plan, and how much the bounds here
        on the reference's intersample bound, which a checker shares, exceed those of the planner.
        """
        if self.margin.inside:
            return None
        system, K = self.problem.system, self.problem.K
        path = Reference.propagate(system, self.problem.delta, self.problem.initial_set.c, self.plan.nu)
        clearances = (facet_clearance(self.tracking, path, unsafe).min(axis=1) for unsafe in task.unsafe)
        intersamples = [
            bound - clearance for bound, clearance in zip(path_bounds(task, path), clearances, strict=True)
        ]
        short = self.margin.tightening - self.margin.clearance
        if not self.tracking.varies and all(np.all(intersample < short) for intersample in intersamples):
            return None
        errors, rows = Feedforward(self.tracking, path, K), self.tracking.commands
        margins = tuple(
            margin + np.clip(intersample, 0, 1.1 * short) + errors.response(-each.rows(system)).max(axis=1)
            for each, margin, intersample in zip(task.unsafe, task.margins, intersamples, strict=True)
        )
        limit = np.maximum(task.u_limit - errors.response(rows[: len(task.system.u_max)]).max(axis=1), 0.0)
        return replace(task, margins=margins, u_limit=limit)

    def _with_coasting(self, task: PlanProblem) -> Plan | None:
        """Plan again, so that coasting after the end is safe; return None if there is no such plan."""
        options = self.problem.planner
        limit = min(options.max_linear_programs, max(AGAIN[0], AGAIN[1] * int(self.plan.stats["lps"])))
        try:
            coasting = plan(replace(task, tail_cells=self.tail), replace(options, max_linear_programs=limit))
        except OutOfTime as error:
            self.cut_by_clock += ("plan with coasting",)
            warnings.warn(f"safe coasting after the end: {error}", ClockWarning, stacklevel=4)
            return None
        except (SynthesisInfeasible, NotCertified):
            return None
        self.cut_by_clock += tuple(f"{stage} with coasting" for stage in coasting.cut_by_clock)
        return coasting

    def _references(self, plan: Plan) -> Iterator[tuple[Reference, Array]]:
        self.plan, problem = plan, self.problem
        planned = Reference.propagate(problem.system, problem.delta, problem.initial_set.c, plan.nu)
        yield coast(planned, self.tail)
        yield planned, np.zeros(problem.system.n)

    def record(self, reference: Reference, recoverable: RecoverableSet) -> bool:
        """Record the proof of an attempt; return True if it is more than the next one could give."""
        self.margin = recoverable.margin_at(0, self.start)
        if reference.cells > self.problem.K:
            self.end = prove_end(
                self.tracking, reference, self.problem.K, self.tail, self.unsafe, self.margin
            )
        return self.end.proven

    def require_start(self, recoverable: RecoverableSet) -> None:
        """Refuse an initial set that is not inside the first recoverable set."""
        if not self.margin.inside:
            raise SynthesisInfeasible(
                f"the initial set is not inside the first recoverable set ({recoverable.kind}): "
                f"{self.margin}.",
                self.margin.tightening - self.margin.clearance,
                "shrink the initial set, raise the thrust limits or take smaller steps"
                + ("." if recoverable.kind == "polytope" else ", or use recoverable kind 'polytope'."),
            )


def perceive_unsafe(problem: Problem, cells: int) -> tuple[TimedPolytope, ...]:
    """Return the perception oracle of Definition 2 over a number of cells."""
    return tuple(perceive(problem.unsafe, problem.system, problem.delta, cells))


def start_about(problem: Problem, tracking: Tracking) -> Zonotope:
    """Return the loop states at the start: Theta less its middle, and all that may be known of the rest."""
    return tracking.loop_state(problem.initial_set - problem.initial_set.c, tracking.at_start)


def plan_problem(problem: Problem, tracking: Tracking, sets: tuple[TimedPolytope, ...]) -> PlanProblem:
    """Return the MIP of eqs. 14 to 19, with margins from S's tube and thrust limits tightened by it.

    Raises `SynthesisInfeasible` if correcting the initial error alone may demand more than the thrusters
    have.
    """
    system, q, K = problem.system, tracking.feedback.nodes_per_cell, problem.K
    start = start_about(problem, tracking)
    # Errors as large as the thrusters can correct at all must be forgotten by the time they have left
    # the settling horizon, or a tight place late in the flight would bind early recoverable sets.
    largest = float(
        np.min(tracking.max_feedback / np.linalg.norm(tracking.gain @ tracking.W_inverse, axis=1))
    )
    rows = tracking.commands, *(-unsafe.rows(system) for unsafe in sets)
    tubes = (error_tube(tracking, start, each) for each in rows)
    thrust, *margins = (np.maximum(tube.over_cells(K, q), tube.remainder(largest)) for tube in tubes)
    needed = np.maximum(thrust[:, : system.m], thrust[:, system.m :]) + tracking.worst_noise
    limit = system.u_max * (1 - SOLVER_BOOK_INPUT) - needed
    if np.any(limit < 0):
        k, axis = np.unravel_index(int(np.argmin(limit)), limit.shape)
        errors = errors_alone(tracking, int(axis), system.as_ideal())
        share = f", {errors:.4g} of it for errors of navigation and thrusters" if errors else ""
        portion = 0.0 if system.timing.instant else errors_alone(tracking, int(axis), system.without_delay)
        if portion > 0:
            share += f" ({portion:.4g} of that for delay, missed periods and jitter)"
        if system.transients:
            portion = errors_alone(tracking, int(axis), replace(system, transients=()))
            share += f" ({portion:.4g} of that for a fault until it is isolated)"
        raise SynthesisInfeasible(
            f"the tracking feedback may demand {needed[k, axis]:.4g} of the {system.u_max[axis]:.4g} of "
            f"{system.input_names[axis]} at t = {k * problem.delta:g} s to correct the initial set and the "
            f"disturbance{share}.",
            float(-limit[k, axis]),
            "shrink the initial set, raise the thrust limit, or raise tracking.R for a softer tracker.",
        )
    limit = np.maximum(limit - problem.thrust_reserve * system.u_max, 0.0)
    return PlanProblem(
        system,
        problem.initial_set.c,
        K,
        problem.delta,
        sets,
        tuple(margins),
        limit,
        inset(problem, problem.goal, problem.goal_inset) if problem.goal_inset else problem.goal,
        problem.objective,
        problem.extra_margin,
    )


def errors_alone(tracking: Tracking, axis: int, other: Craft) -> float:
    """Return the command of S on an axis, once settled, beyond that in a system with fewer errors."""
    fewer = replace(tracking, system=other)
    sums = (each.disturbance(each.commands)[-1][axis] + each.worst_noise[axis] for each in (tracking, fewer))
    return float(next(sums) - next(sums))


def find_plan(task: PlanProblem, options: PlannerOptions) -> Plan:
    """Plan; if that fails in a scene about as small as the clearance added for the solver, say so."""
    try:
        return plan(task, options)
    except (SynthesisInfeasible, NotCertified) as error:
        lengths = [np.abs(unsafe.offsets).max() for unsafe in task.unsafe]
        size = max(float(np.abs(task.system.position @ task.x0).max()), *lengths, 0.0)
        if not task.unsafe or size > 100 * SOLVER_BOOK_M:
            raise
        hint = (
            f"another unit of length: this scene is {size:.2g} m wide, and the planner adds "
            f"{SOLVER_BOOK_M:g} m to every clearance, whatever the size of the scene."
        )
        if isinstance(error, SynthesisInfeasible):
            relax = f"{error.relax.rstrip('.')}, or {hint}" if error.relax else hint
            raise SynthesisInfeasible(error.condition, error.shortfall, relax) from error
        raise type(error)(f"{str(error).rstrip('.')}. It may take {hint}") from error
