"""Reasons for no plan: relaxations of the problem, each naming the condition to relax and by how much."""

import re
from dataclasses import replace
from time import perf_counter
from typing import Any, NoReturn

import numpy as np

from ..model.checks import counted
from ..model.errors import SynthesisInfeasible
from ..model.scene.state_limits import RATE
from ..model.scene.timed_polytope import TimedPolytope
from ..model.system import Array
from .lp import GrowingLP
from .problem import PlanProblem
from .rows import PlanRows
from .search import Candidate, PathSearch
from .tree import branch

FACTORS = (1.25, 1.5, 2.0, 3.0, 5.0, 10.0)
WITHIN = re.compile(r"within(?:-(\d+))?\[\d+\]")  # sides of boxes in which bounds of navigation hold
GROWN = 0.01  # growth [m] of a half-width from which on the place of an obstacle counts as uncertain
EFFORT = 1000  # most linear programs solved to find by how much margins must give way


def unreachable(rows: PlanRows, deadline: float) -> NoReturn:
    """The goal is out of reach even without unsafe sets."""
    problem, goal = rows.problem, rows.problem.goal
    miss = _miss(rows, deadline - perf_counter())
    factor = _thrust_factor(rows, deadline - perf_counter())
    condition = (
        f"The goal ({goal.describe()}) cannot be reached in {counted(problem.K, 'step')} of"
        f" {problem.delta:g} s within the input limits, even without unsafe sets:"
        f" it is missed by {miss:.3g} m at best."
    )
    relax = "change the goal or the number of steps, as larger input limits do not help."
    if factor is not None:
        limits = f"input limits {factor:.3g} times as large (when tightened)"
        relax = f"{limits}, a longer horizon or a wider goal."
    elif not np.all(rows.limit):
        relax = "a smaller planner.thrust_reserve or initial set, or larger input limits."
    raise SynthesisInfeasible(condition, miss, relax)


def blocked(rows: PlanRows, deadline: float) -> NoReturn:
    """The goal can be reached, but not clear of the unsafe sets."""
    problem = rows.problem
    _start(problem)
    short, proven = _shortfall(rows, deadline)
    helpful = _droppable(problem, deadline)
    larger = (f for f in FACTORS if perf_counter() < deadline)
    factor = next((f for f in larger if _works(problem, deadline, u_limit=problem.u_limit * f)), None)
    amount, remedies = "", list[str]()
    if short is not None:
        amount = f" ({'' if proven else 'at most '}{short:.3g} m short{_lengths(*problem.unsafe)})"
        remedies = [f"{short:.3g} m less margin ({_smaller_margins(problem, short, deadline)})"]
    condition = (
        f"The goal ({problem.goal.describe()}) can be reached within the input limits, but not with the "
        f"margins required from the unsafe sets{amount}."
    )
    if helpful:
        remedies.append("without " + " or without ".join(helpful))
    if factor is not None:
        remedies.append(f"input limits {factor:g} times as large")
    relax = (", or ".join(remedies) or "a longer horizon or another goal") + "."
    if perf_counter() > deadline:
        relax += " (The time limit ended the search for these values.)"
    raise SynthesisInfeasible(condition, short, relax)


def _start(problem: PlanProblem) -> None:
    """The start itself may be too close; no plan mends that."""
    for i, body in enumerate(problem.unsafe):
        clear = body.rows(problem.system) @ problem.x0 - problem.offsets(i)[0, 0]
        required = problem.required(i)[0]
        side = int(np.argmax(clear - required))
        if (short := float(required[side] - clear[side])) > 0:
            if body.keep_in:
                raise _outside(body, float(required[side]), float(clear[side]))
            raise SynthesisInfeasible(
                f"The start is {short:.3g} m too close to {body.name}: a margin of {required[side]:.3g} m is "
                f"required, the clearance is {clear[side]:.3g} m{_lengths(body)}.",
                short,
                f"start further away, or at least {short:.3g} m less margin.",
            )


def _outside(body: TimedPolytope, required: float, inside: float) -> SynthesisInfeasible:
    """Return the error of a start that is outside a set to stay inside, or too near one of its sides."""
    label, box = f"{body.name}, a side of a set to stay inside", WITHIN.fullmatch(body.name)
    if box is not None:
        axis = int(np.argmax(np.abs(body.normals[0])))
        sign = "-" if body.normals[0, axis] > 0 else "+"
        table = "navigation" if box[1] is None else f"navigation.phases[{box[1]}]"
        label = f"the {sign} side, along axis {axis}, of the box to stay inside by within_m of {table}"
    side, short = "inside" if inside >= 0 else "outside", required - inside
    return SynthesisInfeasible(
        f"The start is {abs(inside):.3g} m {side} {label}; it must be {required:.3g} m inside: the"
        f" safety controller may need as much{_lengths(body)}.",
        short,
        f"make the set at least {short:.3g} m larger there, or start as much further inside.",
    )


def _lengths(*bodies: TimedPolytope) -> str:
    """Say how velocities count where lengths are those of limits on the whole state."""
    return f", 1 m/s counting as {1 / RATE:g} m" if any(body.of_state for body in bodies) else ""


def _shortfall(rows: PlanRows, stop: float) -> tuple[float | None, bool]:
    """Least length [m] by which all margins must give way, and whether that is proven."""
    search = PathSearch(rows, stop)
    search.set_prices(0.0, 0.0, short=1e3, fuel=1e-3)
    path = search.first()
    half, limit = perf_counter() + 0.5 * max(stop - perf_counter(), 0.0), search.solves + EFFORT

    def spent(best: Candidate | None) -> str:
        return "effort_limit" if search.solves >= limit else "time_limit" if perf_counter() > half else ""

    outcome = branch(search, path, 0.02, spent)
    if outcome.best is None:
        return None, False
    return outcome.best.short, outcome.status == "optimal"


def _smaller_margins(problem: PlanProblem, short: float, stop: float) -> str:
    """Say what makes margins smaller: obstacles known better if they make most of the shortfall [m]."""
    names, unsafe = [], list(problem.unsafe)
    for i, body in enumerate(unsafe):
        opposite = np.argmin(body.normals @ body.normals.T, axis=1)
        widths = body.offsets + body.offsets[..., opposite]
        growth = np.maximum(widths - widths[0, 0], 0.0) / 2
        if np.allclose(body.normals[opposite], -body.normals) and np.max(growth) > GROWN:
            unsafe[i] = replace(body, offsets=body.offsets - growth)
            names.append(body.name)
    certain = _shortfall(PlanRows(replace(problem, unsafe=tuple(unsafe))), stop)[0] if names else None
    if certain is None or not (part := short - certain) > short / 2:
        return "a smaller initial set or disturbance, a stiffer gain"
    whose = " and ".join(f"{name}'s place" for name in names)
    keys = "disturbance_max, thrust_accel_max or state_half_widths"
    return f"{part:.3g} m of them are the uncertainty of {whose} by then: a smaller {keys}"


def _works(problem: PlanProblem, stop: float, **changes: Any) -> bool:
    """Return True if the quick search finds a plan of a changed problem."""
    search = PathSearch(PlanRows(replace(problem, objective="fuel", **changes)), stop)
    search.set_prices(0.0, 0.0, short=1e4)
    path = search.first()
    return path is not None and path.short == 0


def _droppable(problem: PlanProblem, stop: float) -> list[str]:
    """Names of unsafe sets without any one of which there is a plan."""
    names, unsafe, margins = [], problem.unsafe, problem.margins
    for i, body in enumerate(unsafe):
        fewer = {"unsafe": unsafe[:i] + unsafe[i + 1 :], "margins": margins[:i] + margins[i + 1 :]}
        if perf_counter() < stop and _works(problem, stop, **fewer):
            names.append(body.name)
    return names


def _goal_program(rows: PlanRows, top: Array, elastic: float) -> GrowingLP:
    """Least extra variable with which the goal's conditions hold, without unsafe sets.

    `top`, shape (2 N + 1,), bounds the input shares either way and the extra variable, each unit of which
    relaxes every row by `elastic` units of `PlanRows.length`.
    """
    goal, N = rows.problem.goal.conditions, rows.N
    lp = GrowingLP(np.r_[np.zeros(2 * N), 1.0], np.zeros(2 * N + 1), top)
    G, g = np.vstack([goal.G, goal.E, -goal.E]), np.r_[goal.g, goal.e, -goal.e]
    a = rows.state_rows(G, rows.problem.K) / rows.length
    tightening = (g - G @ rows.free[rows.problem.K]) / rows.length
    lp.add(np.hstack([a, -a, np.full((len(a), 1), -elastic)]), -np.inf, tightening)
    return lp


def _miss(rows: PlanRows, seconds: float) -> float:
    """Smallest residual [m] of the goal within the input limits."""
    answer = _goal_program(rows, np.r_[rows.limit, rows.limit, np.inf], 1.0).solve(seconds)
    return np.inf if answer is None else answer[0] * rows.length


def _thrust_factor(rows: PlanRows, seconds: float) -> float | None:
    """Smallest factor on the input limits with which the goal is reached, without unsafe sets."""
    lp = _goal_program(rows, np.full(2 * rows.N + 1, np.inf), 0.0)
    limits = np.r_[rows.limit, rows.limit]
    lp.add(np.hstack([np.eye(2 * rows.N), -limits[:, None]]), -np.inf, 0.0)
    answer = lp.solve(seconds)
    return None if answer is None else answer[0]
