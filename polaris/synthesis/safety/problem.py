"""The mathematical problem of section II that the two algorithms solve, without a file."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from reach.sets.zonotope import Zonotope as Zonotope  # the door of the package finds it here
from reach.short_repr import short_repr

from ...model.allocation import Allocation
from ...model.checks import MAX_STEPS, non_negative, number, one_of, positive, whole
from ...model.craft import Craft
from ...model.errors import ScenarioError
from ...model.system import Array, LinearSystem, velocities
from ...planning.goals import Goal
from ...planning.problem import Objective, PlannerOptions
from ..tracker.feedback import Feedback, choose_feedback
from ..tracker.lqr import lqr_gain
from .passive import DriftRequirement

RECOVERABLE_KINDS = ("polytope", "ball")

RECOURSE = ("replan", "none")


@dataclass(frozen=True, eq=False)
class PoweredAbort:
    """Requirement on S from every instant of the schedule: reach an orbit, safely."""

    goal: Goal | None = None  # the orbit; None for the schedule's own goal
    tolerance: float | None = None  # distance that counts as reached [m], as `Problem.goal_tolerance`
    within: float | None = None  # time that it may take [s]; needed with an orbit of its own
    budget: float | None = None  # velocity change that S may spend on it [m/s]
    required: bool = False  # whether a schedule with a step from which it is not proven is refused
    velocity_tolerance: float | None = None  # as `Problem.goal_velocity_tolerance` [m/s]


@short_repr
@dataclass(frozen=True, eq=False)
class Problem:
    """Input of Algorithm 1.

    Parameters
    ----------
    system : Craft or LinearSystem
        Controlled system; one without errors unless it is a `Craft`.
    initial_set : Zonotope
        Theta, in absolute coordinates (m, m/s).
    unsafe : tuple of obstacles
        Objects with ``timed_polytopes(system, delta, cells)`` (see `polaris.model.scene.obstacles`).
    K : int
        Number of steps.
    delta : float
        Step [s]; the horizon is ``T = K delta``.
    Q, R : array_like
        LQR weights of the tracker, matrices or diagonals.
    goal : Goal
        Where the reference must end.
    goal_tolerance : float or None
        Length [m], in the goal's own scaling, within which the goal counts as reached; None for what
        `polaris.synthesis.schedule.arrival.Arrival` says.
    goal_velocity_tolerance : float or None
        Velocity [m/s] that counts as `goal_tolerance` does, which it needs; None for what `Arrival` says.
    goal_inset : float
        Length [m] by which the reference meets the goal's inequalities: clearance for errors at the end. No
        claim rests on it.
    recoverable : {"polytope", "ball"}
        Kind of recoverable set, from the widest to the printed one, which proves nothing.
    recourse : {"none", "replan"}
        Whether `synthesize` may plan the reference with the experimental controllers in view; with ``none``
        it is the one reference of the printed Algorithm 1.
    period : float or None
        Control period [s], in which commands are renewed once and held; None for a quarter of the fastest
        closed-loop time constant, rounded to a whole part of the step.
    bound : {"envelope", "lyapunov"}
        Method of Lemma 1 (used by the balls).
    weight : {"auto", "identity"} or array_like
        Weight of the norm of Lemma 1.
    objective : {"margin_then_fuel", "distance", "fuel"}
        Goal of the planner: the extra margin and then least velocity change; most distance; least fuel.
    extra_margin : float
        Clearance [m] wanted beyond the tightening by S's own tube: the slack left to U.
    thrust_reserve : float
        Share of the thrust limits, in [0, 1), that the reference leaves beyond the tightening by S's tube.
    thrust_share : float, optional
        Share of the thrust limits, in (0, 1], that S's feedback may demand when it takes over: errors of
        thrusters are bounded for it, and for less and less from there on. Without it `synthesize` tries
        some and keeps the best; `get_safety` takes the least of them.
    planner : PlannerOptions
        Solver, time limit, gap.
    gains : tuple of ndarray
        Gains of the experimental controllers, so that a period that is not given is short enough for them.
    abort : DriftRequirement or None
        Requirement on the drift should all thrust stop; None for nothing.
    powered : PoweredAbort or None
        Requirement on an abort with thrust; None for nothing.
    tank : float or None
        Velocity change [m/s] that there is propellant for, if that is known.
    allocation : Allocation or None
        Thrusters that make the inputs in every fault, if the limits come from them.
    """

    system: Craft
    initial_set: Zonotope
    unsafe: tuple[Any, ...]
    K: int
    delta: float
    Q: ArrayLike
    R: ArrayLike
    goal: Goal
    goal_tolerance: float | None = None
    goal_velocity_tolerance: float | None = None
    goal_inset: float = 0.0
    recoverable: str = "polytope"
    recourse: str = "none"
    period: float | None = None
    bound: str = "envelope"
    weight: ArrayLike | str = "auto"
    objective: Objective = "margin_then_fuel"
    extra_margin: float = 0.0
    thrust_reserve: float = 0.2
    thrust_share: float | None = None
    planner: PlannerOptions = field(default_factory=PlannerOptions)
    gains: tuple[Array, ...] = ()
    abort: DriftRequirement | None = None
    powered: PoweredAbort | None = None
    tank: float | None = None
    allocation: Allocation | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "system", Craft.from_system(self.system))
        if not isinstance(self.initial_set, Zonotope):
            raise ScenarioError("initial_set", type(self.initial_set).__name__, "must be a reach.Zonotope")
        if self.initial_set.batch or self.initial_set.dim != self.system.n:
            rule = f"must be one set of {self.system.n} states"
            raise ScenarioError("initial_set", self.initial_set.c.shape, rule)
        if whole("K", self.K, 1) > MAX_STEPS:
            raise ScenarioError("K", self.K, f"must be at most {MAX_STEPS} steps")
        positive("delta", self.delta, "s")
        if self.period is not None:
            positive("feedback.period_s", self.period, "s")
        if not isinstance(self.goal, Goal):
            raise ScenarioError("goal", type(self.goal).__name__, "must be one of polaris.planning's goals")
        bodies = self.unsafe if isinstance(self.unsafe, (tuple, list)) else None
        if bodies is None or not all(hasattr(body, "timed_polytopes") for body in bodies):
            raise ScenarioError(
                "unsafe", self.unsafe, "must be a tuple of obstacles (polaris.model.scene.obstacles)"
            )
        if not isinstance(self.planner, PlannerOptions):
            raise ScenarioError("planner", type(self.planner).__name__, "must be PlannerOptions")
        object.__setattr__(self, "goal", self.goal.for_system(self.system))
        if self.goal_tolerance is not None:
            positive("goal.tolerance_m", self.goal_tolerance, "m")
        if self.goal_velocity_tolerance is not None:
            positive("goal.velocity_tolerance_m_s", self.goal_velocity_tolerance, "m/s")
            if self.goal_tolerance is None:
                raise ScenarioError("goal.tolerance_m", None, "must be given with velocity_tolerance_m_s")
            require_velocities(self.system, self.goal, "goal", self.goal_velocity_tolerance)
        if self.powered is not None and self.powered.velocity_tolerance is not None:
            orbit = self.powered.goal or self.goal
            require_velocities(self.system, orbit, "abort.orbit", self.powered.velocity_tolerance)
        non_negative("goal_inset", self.goal_inset, "m")
        non_negative("extra_margin", self.extra_margin, "m")
        if not 0 <= number("thrust_reserve", self.thrust_reserve) < 1:
            raise ScenarioError("thrust_reserve", self.thrust_reserve, "must be in [0, 1)")
        one_of("recoverable", self.recoverable, RECOVERABLE_KINDS)
        if not replace(self.system, transients=()).ideal and self.recoverable != "polytope":
            rule = "must be 'polytope' with [navigation], [thrusters] or [timing]"
            raise ScenarioError("recoverable.kind", self.recoverable, rule)
        share = self.thrust_share
        if share is not None and not 0 < number("tracking.thrust_share", share) <= 1:
            raise ScenarioError("tracking.thrust_share", share, "must be above 0 and at most 1")
        one_of("recourse", self.recourse, RECOURSE)

    @cached_property
    def gain(self) -> Array:
        """Gain of the safety controller, shape (m, n)."""
        return lqr_gain(self.system, self.Q, self.R)

    @cached_property
    def feedback(self) -> Feedback:
        """Nodes per step, at which commands are renewed."""
        return choose_feedback(self.system, [self.gain, *self.gains], self.delta, self.period)


def require_velocities(system: LinearSystem, goal: Goal, key: str, tolerance: float) -> None:
    """Raise a ScenarioError unless a tolerance of velocities bounds some of every coordinate's."""
    rates, conditions = velocities(system.A, system.position), goal.for_system(system).conditions
    if not rates.any(axis=1).all():
        rule = "must be left out, as a coordinate of the position has no velocity among the states (C A x)"
        raise ScenarioError(f"{key}.velocity_tolerance_m_s", tolerance, rule)
    if not np.vstack([conditions.E, conditions.G])[:, rates.any(axis=0)].any():
        rule = "must be left out, as the goal sets no condition on velocities"
        raise ScenarioError(f"{key}.velocity_tolerance_m_s", tolerance, rule)


ARGUMENTS = ("initial_set", "K", "delta", "Q", "R", "goal")  # arguments that a bare system requires besides


def as_problem(source: Any, arguments: Mapping[str, Any], options: Mapping[str, Any]) -> Problem:
    """Return the argument of `get_safety`, in any of its forms, as a `Problem`.

    `arguments` are the positional ones but the first, by name, which only a bare system reads; `options`
    further fields of `Problem`.
    """
    if callable(getattr(source, "problem", None)):
        source = source.problem()
    if isinstance(source, Problem):
        return replace(source, **options) if options else source
    if not isinstance(source, LinearSystem) and not all(hasattr(source, name) for name in "ABC"):
        rule = "must be a Scenario (polaris.load_scenario reads a file), a Problem, a LinearSystem or a"
        label = source if isinstance(source, str) else type(source).__name__
        raise ScenarioError("problem", label, f"{rule} control.StateSpace")
    values = {"goal": None, **arguments, **options}
    missing = [name for name in ARGUMENTS if values[name] is None]
    if missing:
        raise TypeError(f"get_safety(system, ...) also needs {', '.join(missing)}")
    if not isinstance(source, LinearSystem):
        if short := [name for name in ("u_max", "C") if name not in values]:
            rule = "C maps the state to the position, one row per axis"
            raise TypeError(f"get_safety(control.StateSpace, ...) also needs {', '.join(short)}; {rule}")
        extra = {name: values.pop(name) for name in ("u_max", "w_max", "D", "C", "mass") if name in values}
        source = LinearSystem.from_statespace(source, **extra)
    wrong = sorted(set(values) - {field.name for field in fields(Problem)})
    if wrong:
        raise TypeError(f"get_safety(LinearSystem, ...) does not take {', '.join(wrong)}")
    if not isinstance(values["unsafe"], Iterable):
        raise ScenarioError(
            "unsafe", type(values["unsafe"]).__name__, "must be a tuple of obstacles, even of one"
        )
    return Problem(source, **values | {"unsafe": tuple(values["unsafe"])})
