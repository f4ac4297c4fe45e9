"""Algorithm 1, GetSafety: the safety controller and its recoverable sets."""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from reach.sets.zonotope import Zonotope

from ..model.errors import ClockWarning, NotCertified, OutOfTime, ScenarioError, SynthesisInfeasible
from ..model.system import Array, LinearSystem
from ..model.timed_polytope import TimedPolytope
from ..model.tolerances import SOLVER_BOOK_INPUT, SOLVER_BOOK_M
from ..planning import Plan, PlannerOptions, PlanProblem, plan
from ..planning.goals import Goal
from ..planning.reference import Reference
from .clearance import Clearance, best_facets, error_tube
from .controllers import AffineController, construct_s
from .end_condition import EndCondition, coast, judge_end, tail_length
from .error_bounds import ErrorBounds, get_err_bounds
from .problem import Problem
from .recoverable import Margin, RecoverableSet, get_recover
from .tracking import Tracking, choose_feedback, lqr_gain


@dataclass(frozen=True, eq=False)
class Safety:
    """Output of Algorithm 1.

    Attributes
    ----------
    problem : Problem
        What was asked.
    tracking : Tracking
        Gain Lambda, error dynamics, contraction norm.
    bounds : ErrorBounds
        Constants of Lemma 1.
    plan : Plan
        Waypoints chi, inputs nu, and how they were found.
    reference : Reference
        xi and mu, followed by the coasting tail.
    controller : AffineController
        S.
    recoverable : RecoverableSet
        In error coordinates, at every node of the grid.
    start : Zonotope
        Theta minus the reference's first state.
    start_margin : Margin
        How far Theta is inside the first recoverable set.
    end : EndCondition
        What is proven after T.
    seconds : mapping
        Wall time by stage.
    cut_by_clock : tuple of str
        Stages of the planning that the wall clock ended early (`Plan.cut_by_clock`); on another machine,
        or again, the result may be another.
    """

    problem: Problem
    tracking: Tracking
    bounds: ErrorBounds
    plan: Plan
    reference: Reference
    clearance: Clearance
    controller: AffineController
    recoverable: RecoverableSet
    start: Zonotope
    start_margin: Margin
    end: EndCondition
    seconds: Mapping[str, float] = field(default_factory=dict)
    cut_by_clock: tuple[str, ...] = ()

    @property
    def guarantee(self) -> str:
        """``proved``, or ``none`` for an option labelled unsound."""
        return self.recoverable.guarantee


def get_safety(
    problem: Any,
    initial_set: Zonotope | None = None,
    unsafe: tuple[Any, ...] = (),
    K: int | None = None,
    delta: float | None = None,
    Q: ArrayLike | None = None,
    R: ArrayLike | None = None,
    *,
    goal: Goal | None = None,
    **options: Any,
) -> Safety:
    """Algorithm 1: ARE, error bounds, safe reference, S, recoverable sets.

    Parameters
    ----------
    problem : Scenario, Problem, LinearSystem or control.StateSpace
        A scenario or problem says everything; a system needs the arguments below.
    initial_set, unsafe, K, delta, Q, R, goal
        See `Problem`. A ``control.StateSpace`` also needs ``u_max`` (and takes ``w_max`` and ``D``)
        among the options.
    **options
        Further fields of `Problem`.

    Returns
    -------
    Safety

    Raises
    ------
    ScenarioError
        If an argument is malformed.
    SynthesisInfeasible
        If no safe reference exists, or Theta is not inside the first recoverable set.
    NotCertified
        If none was found in the time given, or what was found failed its re-check.
    """
    problem = _as_problem(problem, initial_set, unsafe, K, delta, Q, R, goal, options)
    clock = _Clock()
    gain = lqr_gain(problem.system, problem.Q, problem.R)  # lines 1 and 2
    feedback = choose_feedback(problem.system, [gain, *problem.gains], problem.delta, problem.period)
    tracking = Tracking(problem.system, gain, feedback, problem.delta)
    bounds = get_err_bounds(tracking, problem.bound, problem.weight)  # line 3
    tail = tail_length(tracking)
    sets = perceive_unsafe(problem, problem.K + tail)
    asked = plan_problem(problem, tracking, sets)
    clock.lap("bounds")
    found = _find_plan(asked, problem.planner)  # line 4
    clock.lap("plan")
    safety = _complete(problem, tracking, bounds, sets, found, tail)  # lines 5 to 10
    cut = found.cut_by_clock
    if safety.end.retry:
        clock.lap("recoverable")
        try:
            found = plan(replace(asked, tail_cells=tail), problem.planner)
            cut += tuple(f"{stage} with coasting" for stage in found.cut_by_clock)
            clock.lap("plan")
            safety = _complete(problem, tracking, bounds, sets, found, tail)
        except OutOfTime as error:
            cut += ("plan with coasting",)
            warnings.warn(f"safe coasting after the end: {error}", ClockWarning, stacklevel=2)
            clock.lap("plan")
        except (SynthesisInfeasible, NotCertified):
            clock.lap("plan")
    if not safety.start_margin.inside and safety.guarantee == "proved":
        witness = safety.start_margin
        raise SynthesisInfeasible(
            f"the initial set is not inside the first recoverable set ({problem.recoverable}): {witness}.",
            witness.need - witness.room,
            "shrink the initial set, raise the thrust limits or take smaller steps"
            + ("." if problem.recoverable == "polytope" else ", or use recoverable kind 'polytope'."),
        )
    clock.lap("recoverable")
    return replace(safety, seconds=clock.laps, cut_by_clock=cut)


def _as_problem(
    system: Any,
    initial_set: Any,
    unsafe: Any,
    K: Any,
    delta: Any,
    Q: Any,
    R: Any,
    goal: Any,
    options: dict[str, Any],
) -> Problem:
    if isinstance(system, Problem):
        return replace(system, **options) if options else system
    if callable(getattr(system, "problem", None)):
        return _as_problem(system.problem(), None, (), None, None, None, None, None, options)
    if not isinstance(system, LinearSystem) and not all(hasattr(system, name) for name in "ABC"):
        rule = "must be a Scenario (polaris.load_scenario reads a file), a Problem, a LinearSystem or a"
        given = system if isinstance(system, str) else type(system).__name__
        raise ScenarioError("problem", given, f"{rule} control.StateSpace")
    missing = [
        name
        for name, value in (
            ("initial_set", initial_set),
            ("K", K),
            ("delta", delta),
            ("Q", Q),
            ("R", R),
            ("goal", goal),
        )
        if value is None
    ]
    if missing:
        raise TypeError(f"get_safety(system, ...) also needs {', '.join(missing)}")
    if not isinstance(system, LinearSystem):
        if "u_max" not in options:
            raise TypeError("get_safety(control.StateSpace, ...) also needs u_max")
        extra = {name: options.pop(name) for name in ("u_max", "w_max", "D", "C", "mass") if name in options}
        system = LinearSystem.from_statespace(system, **extra)
    wrong = sorted(set(options) - {field.name for field in fields(Problem)})
    if wrong:
        raise TypeError(f"get_safety(LinearSystem, ...) does not take {', '.join(wrong)}")
    if not isinstance(unsafe, Iterable):
        raise ScenarioError("unsafe", type(unsafe).__name__, "must be a tuple of obstacles, even of one")
    return Problem(system, initial_set, tuple(unsafe), K, delta, Q, R, goal, **options)


def perceive_unsafe(problem: Problem, cells: int) -> tuple[TimedPolytope, ...]:
    """The perception oracle of Definition 2 over a number of cells."""
    from ..model.obstacles import perceive

    return tuple(perceive(problem.unsafe, problem.system, problem.delta, cells))


def plan_problem(problem: Problem, tracking: Tracking, sets: tuple[TimedPolytope, ...]) -> PlanProblem:
    """The MIP of eqs. 14 to 19, with margins from S's tube and thrust limits tightened by it.

    Raises
    ------
    SynthesisInfeasible
        If correcting the initial error alone may demand more than the thrusters have.
    """
    system, q, K = problem.system, tracking.feedback.nodes_per_cell, problem.K
    start = problem.initial_set - problem.initial_set.c
    # Errors as large as the thrusters can correct at all must be forgotten by the time they have left
    # the loop's memory, or a tight place late in the flight would bind early recoverable sets.
    largest = float(np.min(system.u_max / np.linalg.norm(tracking.gain @ tracking.W_inverse, axis=1)))
    tube = error_tube(tracking, start, np.vstack([tracking.gain, -tracking.gain]))
    thrust = np.maximum(tube.over_cells(K, q), tube.left_over(tracking, largest))
    needed = np.maximum(thrust[:, : system.m], thrust[:, system.m :])
    limit = system.u_max * (1 - SOLVER_BOOK_INPUT) - needed
    if np.any(limit < 0):
        k, axis = np.unravel_index(int(np.argmin(limit)), limit.shape)
        raise SynthesisInfeasible(
            f"the tracker alone may demand {needed[k, axis]:.4g} of the {system.u_max[axis]:.4g} of "
            f"{system.input_names[axis]} at t = {k * problem.delta:g} s to correct the initial set and the "
            "disturbance.",
            float(-limit[k, axis]),
            "shrink the initial set, raise the thrust limit, or raise tracking.R for a softer tracker.",
        )
    limit = np.maximum(limit - problem.thrust_reserve * system.u_max, 0.0)
    margins = []
    for unsafe in sets:
        tube = error_tube(tracking, start, -unsafe.normals @ system.position)
        margins.append(np.maximum(tube.over_cells(K, q), tube.left_over(tracking, largest)))
    return PlanProblem(
        system,
        problem.initial_set.c,
        K,
        problem.delta,
        sets,
        tuple(margins),
        limit,
        problem.goal,
        problem.objective,
        problem.extra_margin,
    )


def _find_plan(asked: PlanProblem, options: PlannerOptions) -> Plan:
    """Plan; if that fails in a scene about as small as what the planner books for its solver, say so."""
    try:
        return plan(asked, options)
    except (SynthesisInfeasible, NotCertified) as error:
        lengths = [np.abs(unsafe.offsets).max() for unsafe in asked.unsafe]
        size = max(float(np.abs(asked.system.position @ asked.x0).max()), *lengths, 0.0)
        if not asked.unsafe or size > 100 * SOLVER_BOOK_M:
            raise
        hint = (
            f"another unit of length: this scene is {size:.2g} m wide, and the planner keeps "
            f"{SOLVER_BOOK_M:g} m more clearance than needed, whatever the size of the scene."
        )
        if isinstance(error, SynthesisInfeasible):
            relax = f"{error.relax.rstrip('.')}, or {hint}" if error.relax else hint
            raise SynthesisInfeasible(error.condition, error.shortfall, relax) from error
        raise type(error)(f"{str(error).rstrip('.')}. It may take {hint}") from error


def _complete(
    problem: Problem,
    tracking: Tracking,
    bounds: ErrorBounds,
    sets: tuple[TimedPolytope, ...],
    found: Plan,
    tail: int,
) -> Safety:
    """Lines 5 to 10: reference, S, recoverable sets; with the coasting tail as far as it is safe."""
    planned = Reference.propagate(problem.system, problem.delta, problem.initial_set.c, found.nu)
    start = problem.initial_set - problem.initial_set.c
    reference, jump = coast(planned, tail)

    def build(path: Reference, step: Array) -> tuple[Clearance, RecoverableSet]:
        facets = best_facets(tracking, path, sets, start)
        clearance = Clearance(tracking, path, sets, facets, problem.K, step)
        return clearance, get_recover(problem.recoverable, clearance, bounds)

    clearance, recoverable = build(reference, jump)
    margin = recoverable.margin_at(0, start)
    end = judge_end(tracking, reference, problem.K, tail, sets, margin, jump)
    if not end.proven:
        reference = planned
        clearance, recoverable = build(planned, np.zeros(problem.system.n))
        margin = recoverable.margin_at(0, start)
        end = replace(end, retry=margin.inside)  # only the time after T stands in the way
    s = construct_s(tracking, reference)
    return Safety(problem, tracking, bounds, found, reference, clearance, s, recoverable, start, margin, end)


class _Clock:
    """Wall time by stage; a stage named twice adds up."""

    def __init__(self) -> None:
        self.laps: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, stage: str) -> None:
        now = time.perf_counter()
        self.laps[stage] = self.laps.get(stage, 0.0) + now - self._last
        self._last = now
