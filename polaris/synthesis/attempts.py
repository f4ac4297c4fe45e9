"""Which references Algorithm 1 tries, what it proves of each after T, and how long it takes."""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ..model.errors import ClockWarning, NotCertified, OutOfTime, SynthesisInfeasible
from ..model.system import Array
from ..planning.problem import Plan, PlanProblem
from ..planning.reference import Reference
from ..planning.solve import plan
from .end_condition import EndCondition, coast, judge_end, tail_length
from .planning_problem import find_plan, perceive_unsafe, plan_problem
from .problem import Problem
from .recoverable import Margin, RecoverableSet
from .tracking import Tracking


class Clock:
    """Wall time by stage [s]; a stage named twice adds up."""

    def __init__(self) -> None:
        self.laps: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, stage: str) -> None:
        """End a stage, which began where the last one ended."""
        now = time.perf_counter()
        self.laps[stage] = self.laps.get(stage, 0.0) + now - self._last
        self._last = now


class Attempts:
    """References to try in turn: with the coasting tail, without it, and planned again for safe coasting.

    The last only where nothing but the time after T stands in the way, and no plan is given. `plan`, `margin`
    (of `start`, Theta about the reference, in the first recoverable set) and `cut_by_clock` are those of the
    last attempt, `end` that of the last one with a tail; `unsafe` is what is perceived until the tail's end.
    """

    plan: Plan
    margin: Margin
    end: EndCondition

    def __init__(self, problem: Problem, tracking: Tracking, clock: Clock, given: Plan | None = None) -> None:
        self.problem, self.tracking, self.clock, self.given = problem, tracking, clock, given
        self.tail = tail_length(tracking)
        self.unsafe = perceive_unsafe(problem, problem.K + self.tail)
        self.start = problem.initial_set - problem.initial_set.c
        self.cut_by_clock: tuple[str, ...] = ()

    def __iter__(self) -> Iterator[tuple[Reference, Array]]:
        """References, and the jump into the tail of each (see `coast`)."""
        if self.given is not None:
            yield from self._references(self.given)
            return
        asked = plan_problem(self.problem, self.tracking, self.unsafe)
        self.clock.lap("bounds")
        found = find_plan(asked, self.problem.planner)
        self.cut_by_clock = found.cut_by_clock
        self.clock.lap("plan")
        yield from self._references(found)
        if not self.margin.inside:
            return
        self.clock.lap("recoverable")
        again = self._with_coasting(asked)
        self.clock.lap("plan")
        if again is not None:
            yield from self._references(again)

    def _with_coasting(self, asked: PlanProblem) -> Plan | None:
        """The plan again, so that coasting after its end is safe; None if there is none to be had."""
        try:
            found = plan(replace(asked, tail_cells=self.tail), self.problem.planner)
        except OutOfTime as error:
            self.cut_by_clock += ("plan with coasting",)
            warnings.warn(f"safe coasting after the end: {error}", ClockWarning, stacklevel=4)
            return None
        except (SynthesisInfeasible, NotCertified):
            return None
        self.cut_by_clock += tuple(f"{stage} with coasting" for stage in found.cut_by_clock)
        return found

    def _references(self, found: Plan) -> Iterator[tuple[Reference, Array]]:
        self.plan, problem = found, self.problem
        planned = Reference.propagate(problem.system, problem.delta, problem.initial_set.c, found.nu)
        yield coast(planned, self.tail)
        yield planned, np.zeros(problem.system.n)

    def settled(self, reference: Reference, recoverable: RecoverableSet) -> bool:
        """Take down what an attempt proves; whether it is more than the next one could."""
        self.margin = recoverable.margin_at(0, self.start)
        if reference.cells > self.problem.K:
            self.end = judge_end(
                self.tracking, reference, self.problem.K, self.tail, self.unsafe, self.margin
            )
        return self.end.proven

    def require_start(self, recoverable: RecoverableSet) -> None:
        """Refuse an initial set that is not inside the first recoverable set, unless nothing is claimed."""
        if not self.margin.inside and recoverable.guarantee == "proved":
            raise SynthesisInfeasible(
                f"the initial set is not inside the first recoverable set ({recoverable.kind}): "
                f"{self.margin}.",
                self.margin.need - self.margin.room,
                "shrink the initial set, raise the thrust limits or take smaller steps"
                + ("." if recoverable.kind == "polytope" else ", or use recoverable kind 'polytope'."),
            )
