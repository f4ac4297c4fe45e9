"""Scenarios of switching schedules: what Algorithms 1 and 2 are asked."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from reach.sets.zonotope import Zonotope

from ..model.checks import counted
from ..model.system import LinearSystem
from . import numerics, rules
from .base import Scenario, kept
from .fields import whole_parts
from .tables import SampledFeedback, ScenarioModel, Simulation

if TYPE_CHECKING:
    from ..model.obstacle import Obstacle
    from ..planning.goals import Goal
    from ..synthesis.controllers import Controller
    from ..synthesis.get_safety import Safety
    from ..synthesis.problem import Problem
    from ..synthesis.search import SwitchingRules


class ScheduleScenario(Scenario):
    """A scenario of a switching schedule; see `Scenario`."""

    model: ScenarioModel
    MODEL = ScenarioModel

    def _check(self) -> None:
        model = self.model
        rules.check_system(model)
        system = self.system()
        rules.check_shapes(model, system)
        rules.check_time(model)
        numerics.check_numerics(model, system)
        for path, Q, R in numerics.weights(model):
            numerics.check_weights(path, Q, R, system)
        rules.check_names(model)
        rules.check_scene(model, self.obstacles(), system)
        self.goal()
        rules.check_start_and_goal(model, self.obstacles(), system, self.initial_set())

    def outline(self) -> str:
        """What it describes, on one line."""
        system, sets = self.system(), len(self.model.obstacles) + len(self.model.keep_in)
        return (
            f"{counted(system.n, 'state')}, {counted(system.m, 'input')},"
            f" {counted(self.steps, 'step')} of {self.step:g} s, unsafe sets: {sets},"
            f" experimental controllers: {len(self.model.experimental)}"
        )

    @property
    def steps(self) -> int:
        """Number K of steps."""
        count = whole_parts(self.model.horizon.duration_s, self.model.horizon.step_s)
        assert count is not None  # checked on construction
        return count

    @property
    def step(self) -> float:
        """Step delta [s]."""
        return self.model.horizon.step_s

    @property
    def simulation(self) -> Simulation:
        """Closed-loop runs."""
        return self.model.simulation

    @kept
    def system(self) -> LinearSystem:
        """The controlled system, how well its state is known, and its thrusters."""
        system, navigation, thrusters = self.model.system.build(), self.model.navigation, self.model.thrusters
        if navigation is not None:
            system = replace(system, estimate_error=navigation.build(system))
        if thrusters is not None:
            system = replace(system, thrusters=thrusters.build(system, self._period))
        return system

    @property
    def _period(self) -> float | None:
        """Control period of sampled feedback [s]."""
        feedback = self.model.feedback
        return feedback.period_s if isinstance(feedback, SampledFeedback) else None

    @kept
    def initial_set(self) -> Zonotope:
        """The initial set Theta, shape (n,); a ball is enclosed by a zonotope."""
        return self.model.initial_set.build(self.system())

    @kept
    def obstacles(self) -> tuple[Obstacle, ...]:
        """Unsafe sets of the perception oracle, grown by the chaser: obstacles first, then keep-in sets."""
        radius = 0.0 if self.model.chaser is None else self.model.chaser.radius_m
        return tuple(part.build(path).grown(radius) for path, part in self.model.scene_parts())

    @kept
    def goal(self) -> Goal:
        """Where the reference must end."""
        return self.model.goal.build(self.system())

    def controllers(self, safety: Safety) -> tuple[Controller, ...]:
        """The experimental controllers on a safety controller's reference, in order of preference.

        Raises
        ------
        ScenarioError
            If one is malformed.
        SynthesisInfeasible, NotCertified
            If the plan that an ``unaware`` reference stands for cannot be found.
        """
        from .experimental import build_controllers

        return build_controllers(self.model, safety)

    @kept
    def problem(self) -> Problem:
        """The problem that Algorithm 1 is asked."""
        from ..planning.problem import PlannerOptions
        from ..synthesis.problem import Problem
        from .experimental import gains_of

        system, tracking, given = self.system(), self.model.tracking, self.model.planner.arguments()
        weight = tracking.weight
        return Problem(
            system=system,
            initial_set=self.initial_set(),
            unsafe=self.obstacles(),
            K=self.steps,
            delta=self.step,
            Q=numerics.full_weight(tracking.Q),
            R=numerics.full_weight(tracking.R),
            goal=self.goal(),
            goal_tolerance=self.model.goal.tolerance_m,
            recoverable=self.model.recoverable.kind,
            recourse=self.model.recoverable.recourse,
            period=self._period,
            bound=tracking.bound,
            weight=weight if isinstance(weight, str) else numerics.full_weight(weight),
            objective=given.pop("objective"),
            extra_margin=given.pop("extra_margin"),
            thrust_reserve=given.pop("thrust_reserve"),
            thrust_share=tracking.thrust_share,
            planner=PlannerOptions(**given),
            gains=gains_of(self.model, system),
        )

    def switching_rules(self) -> SwitchingRules:
        """Options of Algorithm 2."""
        from ..synthesis.search import SwitchingRules

        rules = self.model.schedule
        weights = tuple(spec.weight for spec in self.model.experimental)
        return SwitchingRules(
            rules.strategy,
            rules.min_dwell_steps,
            rules.max_switches,
            weights,
            rules.beam,
            rules.delta_v_price,
            rules.switch_price,
            rules.delta_v_max_m_s,
        )
