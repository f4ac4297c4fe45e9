"""Algorithm 2, Polaris: which controller flies when, decided before the flight."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from reach.sets.zonotope import Zonotope

from ..model.checks import of_kind, positive, whole
from ..model.errors import ScenarioError
from .controllers import Controller, Flight
from .get_safety import Safety, get_safety
from .problem import Problem
from .recoverable import Margin, contains_flight
from .same_system import check_controller, check_flight, check_safety
from .schedule import Schedule, Step, describe_guarantee

SAFETY = 0
"""Mode number of S (section II)."""


@dataclass(frozen=True)
class SwitchingRules:
    """Options of Algorithm 2 beyond the paper.

    Parameters
    ----------
    strategy : {"greedy", "look_ahead"}
        ``greedy`` is Algorithm 2 as printed: U whenever it is contained. ``look_ahead`` searches for
        the schedule with most (weighted) use of U. It is never worse than greedy, nor than itself under
        stricter rules (dwell times above 8 steps: those of `polaris.synthesis.look_ahead.rungs`).
    min_dwell : int
        Steps a controller keeps, once switched to.
    max_switches : int or None
        Cap on the number of switches. One is always held back for the return to S, so a cap of 0
        leaves S alone, and the last one may stay unused.
    weights : tuple of float
        Worth of one step under each experimental controller, in their order of preference.
    beam : int
        Schedules that ``look_ahead`` keeps at every step for each number of switches and controller.
    """

    strategy: str = "greedy"
    min_dwell: int = 1
    max_switches: int | None = None
    weights: tuple[float, ...] = ()
    beam: int = 1

    def __post_init__(self) -> None:
        if self.strategy not in ("greedy", "look_ahead"):
            raise ScenarioError("schedule.strategy", self.strategy, "must be 'greedy' or 'look_ahead'")
        whole("schedule.min_dwell_steps", self.min_dwell, 1)
        whole("schedule.beam", self.beam, 1)
        if self.max_switches is not None:
            whole("schedule.max_switches", self.max_switches, 0)
        for weight in self.weights:
            positive("schedule.weights", weight, "-")


@dataclass(frozen=True, eq=False)
class _Branch:
    """A schedule under construction: the set reached at step k, and how it came about."""

    reached: Zonotope
    steps: tuple[tuple[int, Flight, Margin | None], ...] = ()
    mode: int = SAFETY
    held: int = 0
    switches: int = 0
    worth: float = 0.0

    @property
    def k(self) -> int:
        return len(self.steps)


def synthesize(
    scenario: Any,
    safety: Safety | None = None,
    experimental: Sequence[Controller] | None = None,
    rules: SwitchingRules | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Schedule:
    """Algorithm 2: the switching schedule, proven before the flight.

    Parameters
    ----------
    scenario : Scenario, Problem or Safety
        A `Safety` stands for its own problem (then give the experimental controllers).
    safety : Safety, optional
        Result of `get_safety`; computed if not given.
    experimental : sequence of Controller, optional
        In order of preference; a scenario brings its own.
    rules : SwitchingRules, optional
        A scenario brings its own.
    progress : callable, optional
        Called with (step, steps), once per step.

    Returns
    -------
    Schedule

    Raises
    ------
    ScenarioError, SynthesisInfeasible, NotCertified
        See `get_safety`.
    """
    if isinstance(scenario, Safety):
        safety, scenario = scenario, scenario.problem
    safety = get_safety(scenario) if safety is None else safety  # line 2
    of_kind("safety", safety, Safety, "polaris.get_safety")
    if experimental is None:
        experimental = scenario.controllers(safety) if hasattr(scenario, "controllers") else ()
    if rules is None:
        rules = scenario.switching_rules() if hasattr(scenario, "switching_rules") else SwitchingRules()
    _check(scenario, safety, experimental, rules)
    started = time.perf_counter()
    controllers: tuple[Controller, ...] = (safety.controller, *experimental)
    search = _Search(safety, controllers, rules)
    branch = search.look_ahead(progress) if rules.strategy == "look_ahead" else search.greedy(progress)
    steps = with_margins(safety, branch.steps)
    seconds = {**safety.seconds, "schedule": time.perf_counter() - started}
    schedule = Schedule(safety, controllers, steps, branch.reached, "", (), seconds)
    kind, assumptions = describe_guarantee(schedule)
    return replace(schedule, guarantee=kind, assumptions=assumptions)


@dataclass(frozen=True, eq=False)
class _Search:
    safety: Safety
    controllers: tuple[Controller, ...]
    rules: SwitchingRules

    def greedy(self, progress: Callable[[int, int], None] | None = None) -> _Branch:
        """Lines 4 to 21: at every step the first controller whose tube is recoverable, else S."""
        K = self.safety.problem.K
        branch = _Branch(self.safety.start)
        while branch.k < K:
            branch = next(iter(self.options(branch)))
            if progress:
                progress(branch.k, K)
        return branch

    def look_ahead(self, progress: Callable[[int, int], None] | None = None) -> _Branch:
        """The best of many schedules, each proven step by step as the greedy one (`look_ahead`)."""
        from .look_ahead import LookAhead

        def prove(start: Zonotope, k: int, mode: int) -> Zonotope | None:
            flown = self.step(start, k, mode)
            return None if flown is None else flown[0].end

        W, modes = self.safety.tracking.W, range(len(self.controllers))
        search = LookAhead(
            self.safety.start,
            self.safety.problem.K,
            prove,
            lambda reached: float(reached.norm_bound(W)),
            tuple(self.worth(mode) for mode in modes),
            self.rules.beam,
        )
        branch = _Branch(self.safety.start)
        for mode in search.best(self.rules.min_dwell, self.rules.max_switches, progress):
            found = self.fly(branch, mode, 1)
            assert found is not None  # it was proven before, and nothing here is random
            branch = found
        return branch

    def options(self, branch: _Branch) -> Iterable[_Branch]:
        """Ways to go on from a branch, the preferred one first; S last, and always possible."""
        settled = branch.k == 0 or branch.held >= self.rules.min_dwell
        for mode in range(1, len(self.controllers)):
            if mode == branch.mode and branch.k > 0:
                following = self.fly(branch, mode, 1)
            elif settled and self.may_switch(branch, mode):
                # Once switched to, U must last: every step of its dwell has to be contained.
                following = self.fly(branch, mode, self.rules.min_dwell)
            else:
                continue
            if following is not None:
                yield following
        flown = self.fly(branch, SAFETY, 1)  # U has always flown its whole dwell, so S may take over
        assert flown is not None
        yield flown

    def may_switch(self, branch: _Branch, mode: int) -> bool:
        """Whether the cap allows going to `mode` and, should it fail, back to S."""
        if self.rules.max_switches is None or branch.k == 0:
            spent = 0
        else:
            spent = branch.switches + (mode != branch.mode)
        cap = self.rules.max_switches
        return cap is None or spent + 1 <= cap

    def fly(self, branch: _Branch, mode: int, steps: int) -> _Branch | None:
        """Let one controller fly the next steps; None if it is not proven recoverable throughout."""
        K = self.safety.problem.K
        for _ in range(min(steps, K - branch.k)):
            flown = self.step(branch.reached, branch.k, mode)
            if flown is None:
                return None
            flight, margin = flown
            switched = branch.k > 0 and mode != branch.mode
            branch = _Branch(
                flight.end,
                (*branch.steps, (mode, flight, margin)),
                mode,
                1 if switched or branch.k == 0 else branch.held + 1,
                branch.switches + switched,
                branch.worth + self.worth(mode),
            )
        return branch

    def step(self, start: Zonotope, k: int, mode: int) -> tuple[Flight, Margin | None] | None:
        """Lines 12 and 13: the tube of one controller over step k, if it is proven recoverable."""
        controller = self.controllers[mode]
        flight = check_flight(controller, start, controller.fly(start, k), self.safety)  # GetReach
        if mode == SAFETY:
            return flight, None  # S stays safe from where it took over: `with_margins` says by how much
        if flight.refused:
            return None
        margin = contains_flight(self.safety.recoverable, k, flight)
        return (flight, margin) if margin.inside else None

    def worth(self, mode: int) -> float:
        """Worth of one step under a mode; S is worth nothing."""
        if mode == SAFETY:
            return 0.0
        return self.rules.weights[mode - 1] if mode - 1 < len(self.rules.weights) else 1.0


def _check(scenario: Any, safety: Safety, experimental: Sequence[Controller], rules: SwitchingRules) -> None:
    """Refuse what does not belong together: its tubes would mean nothing."""
    problem = scenario.problem() if callable(getattr(scenario, "problem", None)) else scenario
    if not isinstance(experimental, Sequence) or isinstance(experimental, str):
        rule = "must be a list of controllers, even of one"
        raise ScenarioError("experimental", type(experimental).__name__, rule)
    check_safety(safety, problem if isinstance(problem, Problem) else safety.problem)
    for controller in experimental:
        check_controller(controller, safety)
    if len(rules.weights) > len(experimental):
        given = f"{len(rules.weights)} weights"
        raise ScenarioError(
            "schedule.weights", given, f"must be at most one per controller ({len(experimental)})"
        )


def with_margins(safety: Safety, flown: Sequence[tuple[int, Flight, Margin | None]]) -> tuple[Step, ...]:
    """The chosen steps, with the margins of those under S filled in (the proof does not need them)."""
    return tuple(
        Step(mode, flight, margin or contains_flight(safety.recoverable, k, flight))
        for k, (mode, flight, margin) in enumerate(flown)
    )


__all__ = ["SwitchingRules", "synthesize"]
