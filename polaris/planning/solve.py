"""`plan`: the reference trajectory, by branch and bound over separating facets."""

import warnings
from collections.abc import Callable
from dataclasses import replace
from time import perf_counter
from typing import NoReturn

import numpy as np

from ..model.errors import ClockWarning, NotCertified, OutOfTime
from . import backends, diagnose
from .effort import SearchEffort, Spare
from .model import by_back_end
from .problem import SOLVERS, Plan, PlannerOptions, PlanProblem, Stage
from .recheck import certified
from .rows import PlanRows
from .search import Candidate, PathSearch, set_targets
from .tree import SearchOutcome, branch

MARGIN_SHARE = 0.75
"""Share of the effort left that the largest margin may take in all, so that least fuel gets its own."""

BOOKED_MOST = 0.05  # largest tightening [m] of any row for which "no solution exists" is still said

MARGIN_TRADE = 1e-4
"""If the full margin is out of reach: share of it that may be traded for a velocity change as
large as that of the cheapest transfer without obstacles."""

NEITHER = "the planner neither found a plan nor proved that there is none"


def plan(problem: PlanProblem, options: PlannerOptions | None = None) -> Plan:
    """Find a certified reference (safeConstraints, section III-C).

    The effort is limited by counts, so the same problem gives the same plan on any machine, unless the
    wall clock has to step in: then the plan says so, and a `ClockWarning` is issued.

    Raises
    ------
    SynthesisInfeasible
        No solution exists; the message names what to relax and by how much.
    NotCertified
        Nothing was found with the effort given (`OutOfTime`: in the time given), or what was found
        failed its re-check.
    ScenarioError
        The solver asked for is not installed, or refuses a model of this size.
    """
    options = options or PlannerOptions()
    answer = Planner(problem, options).run()
    if answer.cut_by_clock:
        limit, cut = f"planner.time_limit_s = {options.time_limit}", ", ".join(answer.cut_by_clock)
        reason = f"{limit} ended the planner's search early ({cut}): another machine or run may find another"
        remedy = "raise the limit, or lower planner.max_linear_programs"
        warnings.warn(f"{reason} plan; {remedy}", ClockWarning, stacklevel=2)
    return answer


class Planner:
    """One run of `plan`. Lazy: cells enter the program when a relaxed solution lacks clearance there.

    Every relaxation bounds the optimum from below; the run ends when the relaxed solution keeps all
    rows of the program and passes the exact re-check, or when the best certified path is within the
    gap of the bound.
    """

    def __init__(self, problem: PlanProblem, options: PlannerOptions) -> None:
        self.problem, self.options = problem, options
        backends.require(options.solver)
        start = perf_counter()
        self.rows = PlanRows(problem)
        self.search = PathSearch(self.rows, options.deadline)
        self.effort = SearchEffort(self.search, options, start)

    def run(self) -> Plan:
        """All stages: least fuel at the full margin; where that is out of reach, at the largest margin."""
        self.effort.report("path search")
        base = self.search.solve({})
        if base is None:
            self._none_because(diagnose.unreachable)
        scale = max(base.fuel, 1e-3 * float(np.sum(self.rows.price * self.rows.limit)), 1e-9)
        top = set_targets(self.search, base)
        if top is None:
            self._none_because(diagnose.blocked)
        furthest = self.problem.objective == "distance" and top > 0
        price = scale / MARGIN_TRADE / top if top > 0 else 0.0
        first = self._first(top, price, 10 * scale / MARGIN_TRADE)
        full = replace(first, level=top) if first is not None and first.level >= top * (1 - 1e-9) else None
        if not furthest:
            self.search.set_prices(top, top)
            outcome = self._minimise("fuel", full, lambda path: top > 0 and path is None)
            if outcome.best is not None:
                return self._certify(outcome.best, outcome.best.fuel, outcome.bound, outcome.status)
            if top == 0:
                self._none(outcome.status)
        self.search.set_prices(0.0, top, price)
        share = 1.0 if furthest else MARGIN_SHARE
        reached = self._minimise("margin", first, lambda path: not furthest and path is not None, share)
        best = reached.best
        if best is None:
            self._none(reached.status)
        unit = 1.0 if furthest else self.problem.extra_margin
        bound = min(best.level + (self.search.value(best) - reached.bound) / price, top)
        if furthest:
            return self._certify(best, best.level * unit, bound * unit, reached.status)
        full_margin = best.level >= top * (1 - 1e-6)
        level = top if full_margin else best.level
        self.search.set_prices(level, level)
        outcome = self._minimise("fuel at the margin found", replace(best, level=level), lambda path: False)
        assert outcome.best is not None
        if full_margin:  # the first stage gave up too early
            return self._certify(outcome.best, outcome.best.fuel, outcome.bound, outcome.status)
        status = reached.status if reached.status != "optimal" else outcome.status
        return self._certify(outcome.best, level * unit, bound * unit, status)

    def _first(self, top: float, margin_price: float, short_price: float) -> Candidate | None:
        """A path found without branching, by way of paths that lack clearance; None if it still does."""
        start = perf_counter()
        self.search.set_prices(0.0, top, margin_price, short_price)
        path = self.search.first()
        self.effort.add_time("path_search", start)
        usable = path is not None and path.short == 0
        by, status = "linear programs by HiGHS", "found" if usable else "none"
        self.effort.stages.append(Stage("path search", by, status, self.search.solves, 0))
        return path if usable else None

    def _minimise(
        self, stage: str, best: Candidate | None, spare: Spare, share: float = 1.0
    ) -> SearchOutcome:
        """Least objective at the prices set with all cells certified, with a share of the effort left.

        `spare` says whether the stage may be given up early with the path known by then.
        """
        start, solves = perf_counter(), self.search.solves
        allowed = self.effort.allow(share, spare)
        if self.options.solver == "facets":
            outcome = branch(
                self.search,
                best,
                self.options.gap,
                lambda path: allowed.limit_reached(path, self.effort.used),
                lambda top, bound: self.effort.report(stage, top, bound),
            )
            self.effort.add_time(stage.replace(" ", "_"), start)
            self.effort.stats["nodes"] += outcome.nodes
        else:
            outcome = by_back_end(self.effort, stage, best, allowed)
        by, solves = SOLVERS[self.options.solver], self.search.solves - solves
        self.effort.stages.append(Stage(stage, by, outcome.status, solves, int(outcome.nodes)))
        return outcome

    def _out_of_time(self) -> NoReturn:
        raise OutOfTime(f"no plan within planner.time_limit_s = {self.options.time_limit}: {NEITHER}")

    def _none(self, status: str) -> NoReturn:
        if status == "infeasible":
            self._none_because(diagnose.blocked)
        if self.effort.cut_by_clock:
            self._out_of_time()
        name = "max_linear_programs" if self.options.solver == "facets" else "max_nodes"
        limit = f"planner.{name} = {getattr(self.options, name)}"
        raise NotCertified(f"no plan within the effort limit ({limit}): {NEITHER}")

    def _none_because(self, explain: Callable[[PlanRows, float], NoReturn]) -> NoReturn:
        if self.effort.remaining_s <= 0:
            self._out_of_time()
        # The program tightens every facet by a length. While that is small, "no solution" is an
        # answer; where re-checks have forced it up, it only says that this program has none.
        tightening = max((float(b.max()) for b in self.rows.booking), default=0.0)
        if tightening > BOOKED_MOST:
            reason = f"with the {tightening:.3g} m that the re-check requires between waypoints"
            rule = "the program has no solution; take smaller steps"
            raise NotCertified(f"no certified plan: {reason}, {rule}")
        explain(self.rows, self.search.deadline)

    def _certify(self, path: Candidate, value: float, bound: float, status: str) -> Plan:
        self.effort.stats["lps"] = self.search.solves
        self.effort.seconds["total"] = perf_counter() - self.effort.start
        nu = path.z.reshape(self.problem.K, -1) * self.problem.system.u_max
        targets = np.array([e[: self.problem.K, 0] for e in self.rows.extra])
        return certified(
            self.problem,
            nu,
            targets.reshape(-1, self.problem.K),
            value,
            bound,
            status,
            solver=self.options.solver,
            seconds=self.effort.seconds,
            stats=self.effort.stats,
            stages=tuple(self.effort.stages),
            cut_by_clock=self.effort.cut_by_clock,
        )
