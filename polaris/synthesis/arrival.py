"""The goal as a claim: when every flight is proven to be within a tolerance of it, or how far off."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from reach.sets.zonotope import Zonotope

from ..model.system import Array
from ..model.tolerances import ROUNDING
from ..planning.goals import GoalConditions
from .clearance import error_tube
from .end_condition import in_hills_frame
from .get_safety import Safety
from .problem import Problem
from .tracking import Tracking

GOAL_SHARE = 0.05
"""Share of the goal's size within which it counts as reached, where no length is given."""
SOON = 0.25
"""Share of the horizon in which a velocity error has become the length that it counts for."""


@dataclass(frozen=True)
class Arrival:
    """What is proven of the goal, S flying from T on.

    Lengths are the goal's own: each of its conditions is scaled so that what is missing is in metres
    (`polaris.planning.goals.GoalConditions`), but a velocity counts for no more than the length it makes in a
    quarter of the horizon.

    Attributes
    ----------
    reached : {True, False, "not_proven"}
        Whether every admissible flight meets the goal's conditions, within the tolerance, at `by`; False if
        not even the middle of the tube ever does.
    by : float or None
        When [s].
    distance : float
        Bound [m] on how far a flight may be from the goal at `by`, or at its best where that is not proven.
    tolerance : float
        What counts as reached [m]: as given, else `GOAL_SHARE` of the goal's size, or what S needs to hold a
        goal, if that is more.
    drift : float or None
        Bound [m] on the secular drift per orbit at that time; None outside Hill's frame.
    delta_v : float
        Velocity change until then [m/s], at most.
    """

    reached: bool | str
    by: float | None
    distance: float
    tolerance: float
    drift: float | None
    delta_v: float


def arrival(safety: Safety, final: Zonotope, spent: float) -> Arrival:
    """What is proven of the goal at the nodes from T on, under S, until the end of the coasting tail.

    `final` holds the errors at T, `spent` bounds the velocity change [m/s] until then.
    """
    problem, tracking, reference = safety.problem, safety.tracking, safety.reference
    goal, K, h = problem.goal.conditions, problem.K, tracking.flow.h
    rows = np.vstack([goal.E, -goal.E, goal.G, *(-N for N, _ in goal.one_of)])
    sides = np.concatenate([goal.e, -goal.e, goal.g, *(-c for _, c in goal.one_of)])
    weight = _weights(problem, rows)
    rows, sides = rows * weight[:, None], sides * weight
    cells = reference.fine(tracking.feedback.nodes_per_cell)[K:]
    states = np.concatenate([reference.chi[K][None], *(cell[1:] for cell in cells)])
    need, centre = _needs(safety, final, rows)
    lag = np.minimum(np.arange(len(states)), len(need) - 1)
    beyond = states @ rows.T - sides
    size = ROUNDING * (np.abs(states) @ np.abs(rows).T + np.abs(sides))
    most = _distance(goal, beyond + need[lag] + size)
    tolerance = problem.goal_tolerance
    if tolerance is None:
        tolerance = max(GOAL_SHARE * goal.scale, _to_hold(tracking, rows) * (1 + GOAL_SHARE))
    within = np.flatnonzero(most <= tolerance) if safety.guarantee == "proved" else np.zeros(0, dtype=int)
    best = int(within[0]) if len(within) else int(np.argmin(most))
    near = bool(np.min(_distance(goal, beyond + centre[lag])) <= tolerance)
    return Arrival(
        reached=True if len(within) else "not_proven" if near else False,
        by=K * problem.delta + best * h if len(within) else None,
        distance=float(most[best]),
        tolerance=tolerance,
        drift=_drift(safety, final, states[best], best),
        delta_v=(spent + _correcting(safety, final, best)) * (1 + ROUNDING),
    )


def _weights(problem: Problem, rows: Array) -> Array:
    """Weights of the goal's rows: a velocity counts as the length it makes in `SOON` of the horizon."""
    length = np.linalg.norm(rows, axis=1)
    velocity = np.all(rows @ problem.system.position.T == 0, axis=1) & (length > 0)
    rate = np.divide(1.0, length, out=np.ones(len(rows)), where=velocity)
    soon = 1 / (SOON * problem.K * problem.delta)
    return np.where(velocity, np.minimum(rate / soon, 1.0), 1.0)


def _needs(safety: Safety, final: Zonotope, rows: Array) -> tuple[Array, Array]:
    """What errors need along rows at every node after T, and what their middle does, shapes (memory + 3, r).

    The last entries hold for every later node.
    """
    tracking = safety.tracking
    carried = rows @ tracking.transitions
    centre, spread = carried @ final.c, np.abs(carried @ final.G).sum(axis=-1)
    need = centre + spread + tracking.flow.disturbance_support(rows, len(carried) - 1)
    need = np.vstack([need, error_tube(tracking, final, rows).need[-1]])
    need = need + safety.clearance.jump_need(rows) + safety.clearance.round_off(rows)
    return need + ROUNDING * np.abs(need), np.vstack([centre, np.zeros(len(rows))])


def _to_hold(tracking: Tracking, rows: Array) -> float:
    """What S needs along the rows against the disturbance once it has forgotten where it came from [m]."""
    return float(np.max(tracking.flow.disturbance_support(rows, tracking.memory + 1)[-1], initial=0.0))


def _correcting(safety: Safety, final: Zonotope, nodes: int) -> float:
    """Bound on S's velocity change over so many periods after T [m/s]; the reference coasts."""
    tracking, system = safety.tracking, safety.problem.system
    both = np.vstack([tracking.gain, -tracking.gain])
    need = error_tube(tracking, final, both).need
    need = need + safety.clearance.jump_need(both) + safety.clearance.round_off(both)
    most = need.reshape(len(need), 2, -1).max(axis=1) + system.command_error(tracking.gain)
    most = np.minimum(most, system.u_max)
    thrust = (most + system.thrusters.error(most)).sum(axis=1)
    at = thrust[np.minimum(np.arange(nodes + 1), len(thrust) - 1)]
    return float(np.maximum(at[:-1], at[1:]).sum() * tracking.flow.h / system.mass)


def _distance(goal: GoalConditions, over: Array) -> Array:
    """Largest excess over the goal's conditions [m], given that of every row, shape (nodes,)."""
    fixed = 2 * len(goal.E) + len(goal.G)
    worst = np.max(over[:, :fixed], axis=1, initial=0.0)
    first = fixed
    for N, _ in goal.one_of:
        worst = np.maximum(worst, over[:, first : first + len(N)].min(axis=1))
        first += len(N)
    return np.asarray(worst)


def _drift(safety: Safety, final: Zonotope, x: Array, node: int) -> float | None:
    """Bound on the along-track drift per orbit, ``6 pi |2 x + v_y / eta|``, at a node after T [m]."""
    system = safety.problem.system
    if not in_hills_frame(system) or system.mean_motion is None:
        return None
    row = np.array([[2.0, 0.0, 0.0, 0.0, 1 / system.mean_motion, 0.0]])
    both = np.vstack([row, -row])
    need = _needs(safety, final, both)[0]
    size = ROUNDING * (np.abs(both) @ np.abs(x))
    return float(6 * np.pi * np.max(both @ x + size + need[min(node, len(need) - 1)]) * (1 + ROUNDING))
