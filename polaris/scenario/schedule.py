"""Scenarios of switching schedules: the problem of Algorithms 1 and 2."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from reach.numerics.files import read_regular
from reach.sets.zonotope import Zonotope

from ..model.checks import counted
from ..model.craft import Array, Craft
from ..model.errors import ScenarioError
from ..model.tolerances import ROUNDING
from . import rules
from .base import Scenario, cached
from .reading import write_toml
from .tables.errors import TimingTable, allocation, timed, transients
from .tables.fields import whole_parts
from .tables.scene import BlackBoxTable, Neural
from .tables.schedule import ScenarioModel, SimulationTable

if TYPE_CHECKING:
    from ..model.allocation import Allocation
    from ..model.scene.obstacle import Obstacle
    from ..planning.goals import Goal
    from ..synthesis.controllers.black_box import Ask
    from ..synthesis.controllers.controllers import Controller
    from ..synthesis.controllers.policy import Policy
    from ..synthesis.safety.get_safety import Safety
    from ..synthesis.safety.problem import Problem
    from ..synthesis.schedule.rules import SwitchingRules


class ScheduleScenario(Scenario):
    """A scenario of a switching schedule; see `Scenario`."""

    model: ScenarioModel
    MODEL = ScenarioModel

    @classmethod
    def with_sources(
        cls, document: Mapping[str, Any], folder: Path | None, source: str | None
    ) -> tuple[Mapping[str, Any], tuple[str, ...]]:
        """Put numbers in place of the elements and ephemerides of the target's orbit and the start set."""
        from .orbit_sources import with_sources

        return with_sources(document, folder, source)

    def _check(self) -> None:
        model = self.model
        rules.check_system(model)
        plain = model.system.build()  # the period of the errors may be chosen by what comes first
        rules.check_shapes(model, plain)
        rules.check_time(model)
        rules.check_numerics(model, plain)
        for path, Q, R in rules.weights(model):
            rules.check_weights(path, Q, R, plain)
        system = self.system()
        rules.check_names(model)
        rules.check_scene(model, self.obstacles(), system)
        self.goal()
        rules.check_start_and_goal(model, self.obstacles(), system, self.initial_set())
        self.policies()
        late = [fault for fault in (each.build() for each in model.faults) if fault.isolation > 0]
        if late and min(fault.isolation for fault in late) < self.period():
            rule = f"must be isolated at once, or take at least the control period of {self.period():g} s"
            raise ScenarioError("faults", [(fault.name, fault.isolation) for fault in late], rule)
        pushing = [fault.name for fault in late if fault.name != "navigation_lost"]
        if pushing and system.observer is not None and system.timing.missed:
            rule = "must be known at once with navigation.measurement, unless timing.missed_periods = 0"
            raise ScenarioError("faults", pushing[0], rule)
        abort, bounds = model.abort, model.navigation
        parts = () if bounds is None else (bounds, *bounds.phases, bounds.measurement or bounds)
        drifts = abort is not None and abort.build(system) is not None and abort.keep_in
        if drifts and any(part.within_m is not None for part in parts):
            rule = "must be false with within_m in navigation, as a drift needs no navigation"
            raise ScenarioError("abort.keep_in", True, rule)
        if model.abort is not None:
            model.abort.check(system, self.step)

    def outline(self) -> str:
        """Describe the scenario on one line."""
        system, sets = self.system(), len(self.model.obstacles) + len(self.model.keep_in)
        chosen = f" (commands each {self.period():g} s)" if self.model.feedback.period_s is None else ""
        return (
            f"{counted(system.n, 'state')}, {counted(system.m, 'input')},"
            f" {counted(self.steps, 'step')} of {self.step:g} s{chosen}, keep-out and keep-in zones: {sets},"
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
    def simulation(self) -> SimulationTable:
        """Closed-loop runs."""
        return self.model.simulation

    @cached
    def system(self) -> Craft:
        """Return the controlled system, how well its state is known and how late, and its thrusters."""
        model, system = self.model, Craft.from_system(self.model.system.build())
        allocation, limits = self.allocation(), system.u_max
        if model.thrusters is not None:
            system = replace(system, nozzles=model.thrusters.nozzles(allocation))
            errors = model.thrusters.build(system, self.period(), allocation is None)
            system = replace(system, thrusters=errors)
        if allocation is not None:
            system = replace(system, u_max=allocation.u_max)
        if (model.navigation, model.thrusters, model.timing) == (None, None, None):
            return system
        period, timing = self.period(), (model.timing or TimingTable()).make("timing")
        if model.navigation is not None:
            horizon, late = (self.steps, self.step), any(x.build().isolation > 0 for x in model.faults)
            system = model.navigation.apply(system, horizon, period, timing, late)
        return timed(system, timing, period, model.thrusters, limits, model.faults)

    @cached
    def allocation(self) -> Allocation | None:
        """Return the allocation of inputs to thrusters in every fault, where anything is said of it."""
        thrusters, faults = self.model.thrusters, self.model.faults
        base = allocation(thrusters, faults, self.model.system.build().u_max)
        return base if thrusters is None else thrusters.in_turn(base, self.period(), faults)

    @cached
    def period(self) -> float:
        """Control period [s]: the file's, or the one that is chosen without it."""
        if (period := self.model.feedback.period_s) is not None:
            return period
        from ..synthesis.tracker.feedback import choose_feedback
        from ..synthesis.tracker.lqr import lqr_gain
        from .experimental import gains_of

        system, tracking = self.model.system.build(), self.model.tracking
        gain = lqr_gain(system, rules.full_weight(tracking.Q), rules.full_weight(tracking.R))
        gains = [gain, *gains_of(self.model, system)]
        return self.step / choose_feedback(system, gains, self.step, None).nodes_per_cell

    @cached
    def initial_set(self) -> Zonotope:
        """Return the initial set Theta, shape (n,); a ball is enclosed by a zonotope."""
        return self.model.initial_set.build(self.system())

    @cached
    def obstacles(self) -> tuple[Obstacle, ...]:
        """Unsafe sets of the perception oracle, grown by the chaser: obstacles first, then keep-in sets."""
        radius = 0.0 if self.model.chaser is None else self.model.chaser.radius_m
        system, parts = self.system(), [part.make(path) for path, part in self.model.scene_parts()]
        if self.model.navigation is not None:
            parts += self.model.navigation.kept_within(system, (self.steps, self.step))
        offset = float(np.linalg.norm(np.abs(system.position) @ system.state_offset)) * (1 + ROUNDING)
        return tuple(part.blurred(system.timing.clock, offset).inflated(radius) for part in parts)

    @cached
    def goal(self) -> Goal:
        """Return the goal at which the reference must end."""
        goal: Goal = self.model.goal.build(self.system())
        return goal

    def controllers(
        self,
        safety: Safety,
        boxes: Mapping[str, Ask | None] | None = None,
        planned: Mapping[str, Array] | None = None,
    ) -> tuple[Controller, ...]:
        """Return the experimental controllers on a safety controller's reference, in order of preference.

        Parameters
        ----------
        safety : Safety
            Result of `get_safety`.
        boxes : mapping, optional
            What is asked of its black boxes, by their names.
        planned : mapping, optional
            Inputs (K, m) of plans that ``unaware`` references stand for, by the names of their controllers;
            others are planned.

        Raises
        ------
        ScenarioError
            If one is malformed, or a black box is not given.
        SynthesisInfeasible, NotCertified
            If the plan that an ``unaware`` reference stands for cannot be found.
        """
        from .experimental import build_controllers

        self.check_black_boxes(boxes)
        return build_controllers(self.model, safety, self.policies(), boxes or {}, planned or {})

    def check_black_boxes(self, boxes: Mapping[str, Ask | None] | Collection[str] | None) -> None:
        """Raise `ScenarioError` unless exactly the black boxes of the scenario are given, by their names."""
        supplied = [name for name in boxes or () if not isinstance(boxes, Mapping) or boxes[name] is not None]
        paths = {
            spec.name: path for path, spec in self.model.controllers() if isinstance(spec, BlackBoxTable)
        }
        for name in supplied:
            if name not in paths:
                rule = f"must be one of the scenario's black boxes ({', '.join(paths) or 'none'})"
                raise ScenarioError("black box", name, rule)
        for name, path in paths.items():
            if name not in supplied:
                rule = "must be given with `polaris run --black-box NAME=COMMAND`, or from Python"
                raise ScenarioError(path, name, rule)

    @property
    def asked(self) -> dict[str, Any]:
        """Probability, confidence and seed of the statement about its black boxes."""
        specs = [spec for spec in self.model.experimental if isinstance(spec, BlackBoxTable)]
        statement = min(spec.probability for spec in specs), max(spec.confidence for spec in specs)
        return {"probability": statement[0], "confidence": statement[1], "seed": self.simulation.seed}

    @cached
    def policies(self) -> dict[str, tuple[Path, Policy]]:
        """Neural networks and their files, by the name of their controller."""
        if not any(isinstance(spec, Neural) for spec in self.model.experimental):
            return {}
        from .experimental import read_policies

        return read_policies(self.model, self.system(), self.obstacles(), self.folder)

    def text_elsewhere(self) -> str:
        """TOML with the whole paths of networks; their digests are noted, as the text stands for them."""
        if not self.files():
            return self.to_toml()
        digests = (hashlib.sha256(read_regular(file)).hexdigest() for file in self.files())
        return self._with_paths(lambda file: str(file.resolve())) + "".join(f"# {each}\n" for each in digests)

    def _copied(self) -> str:
        adjacent = all(file.name == spec.path for spec, file in self._networks())
        return super()._copied() if adjacent else self._with_paths(lambda file: file.name)

    def _networks(self) -> list[tuple[Neural, Path]]:
        specs = [spec for spec in self.model.experimental if isinstance(spec, Neural)]
        return [(spec, self.policies()[spec.name][0]) for spec in specs]

    def _with_paths(self, place: Callable[[Path], str]) -> str:
        """TOML with other paths of its networks."""
        data, paths = self.to_dict(), {spec.name: place(file) for spec, file in self._networks()}
        for table in data["experimental"]:
            if table["name"] in paths:
                table["path"] = paths[table["name"]]
        return write_toml(data)

    def files(self) -> list[Path]:
        """Files besides its own that it names."""
        return sorted({file for file, _ in self.policies().values()})

    @cached
    def problem(self) -> Problem:
        """Return the problem that Algorithm 1 is asked."""
        from ..synthesis.safety.problem import Problem
        from .experimental import gains_of

        system, tracking, planner = self.system(), self.model.tracking, self.model.planner
        weight, gains = tracking.weight, gains_of(self.model, system)
        unsteered = np.zeros((system.m, system.n))
        networks = (self.policies()[spec.name][1] for spec, _ in self._networks() if self.model.faults)
        steepest = [each.steepest(system, self.obstacles()) for each in networks]
        boxes = any(isinstance(spec, BlackBoxTable) for spec in self.model.experimental)
        one = system.m if system.timing.pulse_place == "staggered" and system.nozzles is None else 1
        late = transients(self.model.faults, self.allocation(), (unsteered, *gains), steepest, boxes, one)
        system = replace(system, transients=late)
        return Problem(
            system=system,
            initial_set=self.initial_set(),
            unsafe=self.obstacles(),
            K=self.steps,
            delta=self.step,
            Q=rules.full_weight(tracking.Q),
            R=rules.full_weight(tracking.R),
            goal=self.goal(),
            goal_tolerance=self.model.goal.tolerance_m,
            goal_velocity_tolerance=self.model.goal.velocity_tolerance_m_s,
            recoverable=self.model.recoverable.kind,
            recourse=self.model.recoverable.recourse,
            period=self.period(),
            bound=tracking.bound,
            weight=weight if isinstance(weight, str) else rules.full_weight(weight),
            objective=planner.objective,
            extra_margin=planner.extra_margin_m,
            thrust_reserve=planner.thrust_reserve,
            thrust_share=tracking.thrust_share,
            planner=planner.make("planner"),
            gains=gains,
            allocation=self.allocation(),
            tank=None if self.model.tank is None else self.model.tank.delta_v_m_s,
            abort=None if self.model.abort is None else self.model.abort.build(system),
            powered=None if self.model.abort is None else self.model.abort.powered(system),
        )

    def switching_rules(self) -> SwitchingRules:
        """Options of Algorithm 2."""
        weights = tuple(spec.weight for spec in self.model.experimental)
        switching: SwitchingRules = self.model.schedule.make("schedule", weights=weights)
        return switching
