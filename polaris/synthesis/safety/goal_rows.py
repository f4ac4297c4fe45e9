"""The goal as rows of lengths: the length that a velocity counts for, and distances of states from it."""

import numpy as np

from ...model.system import Array, speeds
from ...planning.goals import Goal, GoalConditions, Inset
from .problem import Problem

SOON = 0.25  # share of the horizon in which a velocity has become the length that it counts as, at most


def goal_rows(problem: Problem) -> tuple[Array, Array]:
    """Rows of the goal and their sides, those of velocities weighed as the lengths they count for."""
    goal = problem.goal.conditions
    rows = _unweighted(goal)
    sides = np.concatenate([goal.e, -goal.e, goal.g, *(-c for _, c in goal.one_of)])
    weight = _weights(problem, rows)
    return rows * weight[:, None], sides * weight


def inset(problem: Problem, goal: Goal, length: float) -> Goal:
    """Return a goal, rows as the problem's, whose inequalities are met by a length as `goal_rows` has it."""
    conditions = goal.conditions
    clearance = length / _weights(problem, _unweighted(conditions))[2 * len(conditions.E) :]
    ends = np.cumsum([len(conditions.G), *(len(N) for N, _ in conditions.one_of)])
    return Inset(goal, tuple(np.split(clearance, ends[:-1])))


def _unweighted(goal: GoalConditions) -> Array:
    return np.vstack([goal.E, -goal.E, goal.G, *(-N for N, _ in goal.one_of)])


def velocity_times(problem: Problem, rows: Array) -> Array:
    """Time [s] in which the velocities of each row make the length that it measures, 0 for other rows, (r,).

    Rows of velocities alone; if velocities have a tolerance of their own, the equalities that they are in.
    """
    speed = speeds(problem.system.A, problem.system.position)
    moving = speed > 0
    times = np.linalg.norm(rows[:, moving] / speed[moving], axis=1)
    counts = np.all(rows[:, ~moving] == 0, axis=1)
    if problem.goal_velocity_tolerance is not None:
        counts[: 2 * len(problem.goal.conditions.E)] = True
    return np.where(counts, times, 0.0)


def _weights(problem: Problem, rows: Array) -> Array:
    """Weights of the goal's rows: the lengths that velocities count for, see `Arrival.velocity_time`."""
    seconds = velocity_times(problem, rows)
    if problem.goal_velocity_tolerance is not None:
        assert problem.goal_tolerance is not None  # checked on construction
        target: Array | float = problem.goal_tolerance / problem.goal_velocity_tolerance
    else:
        target = np.minimum(seconds, SOON * problem.K * problem.delta)
    return np.divide(target, seconds, out=np.ones(len(rows)), where=seconds > 0)


def distance(goal: GoalConditions, excess: Array) -> Array:
    """Largest excess over the goal's conditions [m], given that of every row, shape (nodes,)."""
    fixed = 2 * len(goal.E) + len(goal.G)
    worst = np.max(excess[:, :fixed], axis=1, initial=0.0)
    first = fixed
    for N, _ in goal.one_of:
        worst = np.maximum(worst, excess[:, first : first + len(N)].min(axis=1))
        first += len(N)
    return np.asarray(worst)
