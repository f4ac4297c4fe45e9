"""The choices that Algorithm 2 leaves: which controller comes first, how long it lasts, how many switches."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any
from weakref import WeakKeyDictionary

from reach.sets.zonotope import Zonotope

from ...model.checks import of_kind
from ...model.errors import ScenarioError
from ..controllers.black_box import BlackBox
from ..controllers.controllers import AffineController, Controller, TubeSegment, beside_errors
from ..safety.attempts import StageClock
from ..safety.get_safety import Safety
from ..safety.passive import clear
from ..safety.problem import Problem
from .look_ahead import SAFETY, LookAhead
from .rules import SwitchingRules
from .same_system import check_controller, check_safety, check_segment
from .schedule import Schedule, Step, drift_of


@dataclass(frozen=True, eq=False)
class PartialSchedule:
    """A schedule under construction: the set reached at step k, and how it came about."""

    reached: Zonotope
    steps: tuple[Step, ...] = ()
    dwell: int = 0
    switches: int = 0

    @property
    def k(self) -> int:
        """Number of steps decided."""
        return len(self.steps)

    @property
    def mode(self) -> int:
        """Mode of the last step; S before the first."""
        return self.steps[-1].mode if self.steps else SAFETY


@dataclass(frozen=True, eq=False)
class ScheduleSearch:
    """Controllers over one `Safety`, and the rules by which they take turns.

    `intended` holds the mode for which the reference was planned, step by step, if it was planned with U in
    view; then no other experimental controller is tried. `came` holds where the step began that ends in a
    set, and its mode.
    """

    safety: Safety
    controllers: tuple[Controller, ...]
    rules: SwitchingRules
    progress: Callable[[int, int], None] | None = None
    clock: StageClock = field(
        default_factory=StageClock
    )  # of the whole synthesis, which searches made from this one share
    intended: tuple[int, ...] | None = None
    came: WeakKeyDictionary[Zonotope, tuple[Zonotope, int]] = field(default_factory=WeakKeyDictionary)

    @classmethod
    def from_scenario(
        cls,
        scenario: Any,
        safety: Safety,
        experimental: Sequence[Controller] | None,
        rules: SwitchingRules | None,
        progress: Callable[[int, int], None] | None,
        fits: bool = False,
        clock: StageClock | None = None,
    ) -> "ScheduleSearch":
        """Take controllers and rules from the scenario where not given; refuse any that do not fit.

        What does not belong together is refused because its tubes would mean nothing; a safety that has just
        been made from the scenario `fits`.
        """
        of_kind("safety", safety, Safety, "polaris.get_safety")
        if experimental is None:
            experimental = scenario.controllers(safety) if hasattr(scenario, "controllers") else ()
        if rules is None:
            rules = scenario.switching_rules() if hasattr(scenario, "switching_rules") else SwitchingRules()
        problem = scenario.problem() if callable(getattr(scenario, "problem", None)) else scenario
        if not isinstance(experimental, Sequence) or isinstance(experimental, str):
            rule = "must be a list of controllers, even of one"
            raise ScenarioError("experimental", type(experimental).__name__, rule)
        if not fits:
            check_safety(safety, problem if isinstance(problem, Problem) else safety.problem)
        for controller in experimental:
            check_controller(controller, safety)
        if len(rules.weights) > len(experimental):
            rule = f"must be at most one per controller ({len(experimental)})"
            raise ScenarioError("schedule.weights", f"{len(rules.weights)} weights", rule)
        return cls(safety, (safety.controller, *experimental), rules, progress, clock or StageClock())

    def candidates(self, k: int) -> Sequence[int]:
        """Experimental controllers to try in step k: in order of preference, or the one that is intended."""
        if self.intended is None:
            return range(1, len(self.controllers))
        return [mode for mode in self.intended[k : k + 1] if mode != SAFETY]

    def options(self, branch: PartialSchedule) -> Iterator[tuple[int, int]]:
        """Modes to try from a branch, each with the steps it must last; S last, and always possible."""
        k, K, cap = branch.k, self.safety.problem.K, self.rules.max_switches
        if self.rules.strategy == "look_ahead" and self.intended is None:
            yield self.planned[k], 1  # proven before; a law that answers otherwise now gives way to S
            yield SAFETY, 1
            return
        if self.progress and k:
            self.progress(k, K)
        settled = k == 0 or branch.dwell >= self.rules.min_dwell
        switches = branch.switches + (k > 0) + 1  # there, and back to S should it fail
        for mode in self.candidates(k):
            if mode == branch.mode:
                yield mode, 1
            elif settled and (cap is None or switches <= cap):
                yield mode, self.rules.min_dwell
        yield SAFETY, 1  # U has always flown its whole dwell, so S may take over

    def extend(self, branch: PartialSchedule, mode: int, steps: int) -> PartialSchedule | None:
        """Let one controller fly the next steps; None if it is not proven recoverable throughout."""
        for _ in range(min(steps, self.safety.problem.K - branch.k)):
            tube = self.tube(branch.reached, branch.k, mode)
            if tube is None:
                return None
            step = Step(mode, tube, branch.k, self.safety.recoverable)
            switched = branch.k > 0 and mode != branch.mode
            dwell = 1 if switched or branch.k == 0 else branch.dwell + 1
            branch = PartialSchedule(tube.end, (*branch.steps, step), dwell, branch.switches + switched)
        return branch

    def tube(self, start: Zonotope, k: int, mode: int) -> TubeSegment | None:
        """Lines 12, 13 and 18: the tube of one controller over step k, if it is proven recoverable."""
        controller, tracking = self.controllers[mode], self.safety.tracking
        recalls = isinstance(controller, BlackBox) and controller.memory
        states = start if isinstance(controller, AffineController) else tracking.true_error(start)
        claimed = controller.propagate(states, k, *([self._before(start)] if recalls else []))  # GetReach
        tube = check_segment(controller, states, claimed, self.safety)
        tube = beside_errors(tube, start, self.safety.controller)
        self.came[tube.end] = start, mode
        if mode == SAFETY:
            return tube  # S stays safe from where it took over
        if tube.refused or not self.safety.recoverable.holds(k, tube.states, tube.intersample):
            return None
        abort = self.safety.problem.abort
        if abort is not None and abort.required and not clear(drift_of(self.safety, tube, k)):
            return None
        return tube

    def _before(self, reached: Zonotope) -> list[tuple[Zonotope, Controller]]:
        """Return the start of each step that leads to a set, and the controller that flew it."""
        steps: list[tuple[Zonotope, Controller]] = []
        while reached in self.came:
            reached, mode = self.came[reached]
            steps.insert(0, (self.safety.tracking.true_error(reached), self.controllers[mode]))
        return steps

    @cached_property
    def planned(self) -> tuple[int, ...]:
        """Modes of the best of many schedules, each proven step by step as the greedy one (`look_ahead`)."""

        def prove(start: Zonotope, k: int, mode: int) -> Zonotope | None:
            tube = self.tube(start, k, mode)
            return None if tube is None else tube.end

        W = self.safety.tracking.W
        search = LookAhead(
            self.safety.start,
            self.safety.problem.K,
            prove,
            lambda reached: float(self.safety.tracking.error(reached).norm_bound(W)),
            self.rules.mode_values(len(self.controllers)),
            self.rules.beam,
        )
        return search.best(self.rules.min_dwell, self.rules.max_switches, self.progress)

    def schedule(self, branch: PartialSchedule) -> Schedule:
        """Return the schedule that a complete branch stands for, with its proofs."""
        if self.progress and self.rules.strategy == "greedy":
            self.progress(branch.k, branch.k)
        return Schedule(self.safety, self.controllers, branch.steps, branch.reached)
