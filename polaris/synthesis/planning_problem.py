"""What the planner is asked by Algorithm 1: the unsafe sets as perceived, margins and thrust limits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..model.errors import NotCertified, SynthesisInfeasible
from ..model.obstacles import perceive
from ..model.timed_polytope import TimedPolytope
from ..model.tolerances import SOLVER_BOOK_INPUT, SOLVER_BOOK_M
from ..planning.problem import Plan, PlannerOptions, PlanProblem
from ..planning.solve import plan
from .clearance import error_tube
from .problem import Problem
from .tracking import Tracking


def perceive_unsafe(problem: Problem, cells: int) -> tuple[TimedPolytope, ...]:
    """The perception oracle of Definition 2 over a number of cells."""
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
    largest = float(np.min(tracking.u_max / np.linalg.norm(tracking.gain @ tracking.W_inverse, axis=1)))
    tube = error_tube(tracking, start, np.vstack([tracking.gain, -tracking.gain]))
    thrust = np.maximum(tube.over_cells(K, q), tube.left_over(tracking, largest))
    needed = np.maximum(thrust[:, : system.m], thrust[:, system.m :]) + system.command_error(tracking.gain)
    limit = tracking.u_max * (1 - SOLVER_BOOK_INPUT) - needed
    if np.any(limit < 0):
        k, axis = np.unravel_index(int(np.argmin(limit)), limit.shape)
        errors = errors_alone(tracking, int(axis))
        share = f", {errors:.4g} of it for errors of navigation and thrusters" if errors else ""
        raise SynthesisInfeasible(
            f"the tracker alone may demand {needed[k, axis]:.4g} of the {tracking.u_max[axis]:.4g} of "
            f"{system.input_names[axis]} at t = {k * problem.delta:g} s to correct the initial set and the "
            f"disturbance{share}.",
            float(-limit[k, axis]),
            "shrink the initial set, raise the thrust limit, or raise tracking.R for a softer tracker.",
        )
    limit = np.maximum(limit - problem.thrust_reserve * tracking.u_max, 0.0)
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


def errors_alone(tracking: Tracking, axis: int) -> float:
    """What S demands of an input, once settled, because of errors of estimates and thrusters."""
    system, row = tracking.system, tracking.gain[axis : axis + 1]
    exact = replace(tracking, system=system.as_ideal())
    beyond = tracking.disturbance(row)[-1] - exact.disturbance(row)[-1]
    return float(beyond[0] + system.command_error(tracking.gain)[axis])


def find_plan(asked: PlanProblem, options: PlannerOptions) -> Plan:
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
