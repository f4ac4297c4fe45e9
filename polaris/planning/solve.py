"""`plan`: the reference trajectory, by a mixed-integer program over the cells that matter."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from time import perf_counter
from typing import NoReturn

import numpy as np

from ..errors import NotCertified
from . import backends, diagnose
from .certify import certified, relative_gap
from .model import Answer, Model
from .problem import Plan, PlannerOptions, PlanProblem, Progress
from .rows import Key, Rows
from .search import Candidate, Levels, PathSearch
from .targets import set_targets
from .tree import Outcome, branch

MAX_ROUNDS = 60
MAX_BOOKINGS = 4
MAX_NODES = 20_000
TREE_SHARE = 0.7
"""Share of the time left that the tree may use before what is open goes to the back end."""

SECONDS_PER_ROW = 5e-4
"""Rough time to build a row of the model; a program that would take more than a tenth of the time
left to write down is not handed to the back end."""

SPARE_SHARE = 0.25
"""Share of the time left for a phase that can be given up: looking for a first path with the full
margin, and proving that no larger margin exists once a path is known."""

BOOKED_MOST = 0.05
"""Largest length [m] booked on any row for which "no solution exists" is still said."""

MARGIN_TRADE = 1e-4
"""Where the full margin is out of reach: share of it that may be traded for a velocity change as
large as that of the cheapest transfer without obstacles."""


def plan(problem: PlanProblem, options: PlannerOptions | None = None) -> Plan:
    """Find a certified reference (safeConstraints, section III-C).

    Raises
    ------
    SynthesisInfeasible
        No solution exists; the message names what to relax and by how much.
    NotCertified
        Nothing was found in the time given, or what was found failed its re-check.
    ScenarioError
        The solver asked for is not installed, or refuses a model of this size.
    """
    return Planner(problem, options or PlannerOptions()).run()


class Planner:
    """One run of `plan`. Lazy: cells enter the program when a relaxed solution lacks clearance there.

    Every relaxation bounds the optimum from below; the run ends when the relaxed solution passes the
    exact re-check in all cells, or when the best certified path is within the gap of the bound.
    """

    def __init__(self, problem: PlanProblem, options: PlannerOptions) -> None:
        self.problem, self.options = problem, options
        backends.require(options.solver)
        self.begun = perf_counter()
        self.rows = Rows(problem)
        self.search = PathSearch(self.rows, self.begun + options.time_limit)
        self.seconds: dict[str, float] = {}
        self.stats = dict.fromkeys(("rows", "cols", "binaries", "nodes", "rounds", "lps"), 0.0)
        self._last_report = -np.inf

    @property
    def deadline(self) -> float:
        """Value of `time.perf_counter` at which to stop."""
        return self.search.deadline

    @property
    def left(self) -> float:
        """Seconds left."""
        return self.deadline - perf_counter()

    def report(self, stage: str, incumbent: float = np.inf, bound: float = -np.inf) -> None:
        """Tell the progress callback, a few times a second at most."""
        now = perf_counter()
        if self.options.progress is not None and now - self._last_report > 0.1:
            self._last_report = now
            gap = relative_gap(incumbent, bound)
            self.options.progress(Progress(stage, now - self.begun, incumbent, bound, gap))

    def run(self) -> Plan:
        """All phases: least fuel at the full margin; where that is out of reach, the largest margin."""
        self.report("path search")
        base = self.search.solve({})
        if base is None:
            self._none_because(diagnose.unreachable)
        assert base is not None
        scale = max(base.fuel, 1e-3 * float(np.sum(self.rows.price * self.rows.limit)), 1e-9)
        top = set_targets(self.search, base)
        if top is None:
            self._none_because(diagnose.blocked)
        assert top is not None
        furthest = self.problem.objective == "distance" and top > 0
        price = scale / MARGIN_TRADE / top if top > 0 else 0.0
        some = self._first(Levels(0.0, top), price, 10 * scale / MARGIN_TRADE)
        full = replace(some, level=top) if some is not None and some.level >= top * (1 - 1e-9) else None
        if not furthest:
            found = self._minimise("fuel", full, Levels(top, top), 0.0, lambda path: top > 0 and path is None)
            if found.best is not None:
                return self._certify(found.best, found.best.fuel, found.bound, found.status)
            if top == 0:
                self._none(found.status)
        found = self._minimise(
            "margin", some, Levels(0.0, top), price, lambda path: not furthest and path is not None
        )
        best = found.best
        if best is None:
            self._none(found.status)
        assert best is not None
        if not furthest and best.level >= top * (1 - 1e-6):  # the first phase gave up too early
            full = replace(best, level=top)
            found = self._minimise("fuel", full, Levels(top, top), 0.0, lambda path: False)
            assert found.best is not None
            return self._certify(found.best, found.best.fuel, found.bound, found.status)
        unit = 1.0 if furthest else self.problem.extra_margin
        most = min(best.level + (self.search.value(best) - found.bound) / price, top)
        return self._certify(best, best.level * unit, most * unit, found.status)

    def _first(self, levels: Levels, margin_price: float, short_price: float) -> Candidate | None:
        """A path found without branching, by way of paths that lack clearance; None if it still does."""
        begun = perf_counter()
        self.search.set_prices(levels, margin_price, short_price)
        path = self.search.first()
        self._add_time("path_search", begun)
        return path if path is not None and path.short == 0 else None

    def _minimise(
        self,
        stage: str,
        best: Candidate | None,
        levels: Levels,
        margin_price: float,
        spare: Callable[[Candidate | None], bool],
    ) -> Outcome:
        """Least objective with all cells certified.

        `spare` says whether the phase may be given up early with the path known by then.
        """
        search = self.search
        search.set_prices(levels, margin_price)
        begun, most = perf_counter(), self._max_cells()
        early, hand_over = begun + SPARE_SHARE * self.left, begun + TREE_SHARE * self.left
        if self.options.branching == "solver":
            cells = frozenset(best.choice if best is not None else ())
            return self._lazy(stage, best, -np.inf, cells, early if spare(best) else self.deadline)

        def stop(path: Candidate | None, cells: int, lps: int) -> bool:
            now = perf_counter()
            if lps > MAX_NODES or now > self.deadline:
                return True
            return now > early if spare(path) else now > hand_over and cells <= most

        found = branch(
            search, best, self.options.gap, stop, lambda top, bound: self.report(stage, top, bound)
        )
        self.stats["nodes"] += found.nodes
        self._add_time(stage, begun)
        if found.status != "time_limit" or spare(found.best):
            return found
        cells = found.cells
        if len(cells) > most:
            cells = frozenset(found.best.choice if found.best is not None else ())
        return self._lazy(stage, found.best, found.bound, cells, self.deadline)

    def _max_cells(self) -> int:
        """Constrained cells a model may have to be built in a tenth of the time left."""
        facets = max((len(body.normals) for body in self.problem.unsafe), default=1)
        rows = facets * len(self.rows.control_points[2])
        return int(0.1 * self.left / (SECONDS_PER_ROW * rows))

    def _lazy(
        self, stage: str, best: Candidate | None, bound: float, cells: frozenset[Key], until: float
    ) -> Outcome:
        """The back end decides the binaries; cells enter when its solution lacks clearance there."""
        search, gap = self.search, self.options.gap

        def within() -> bool:
            value = search.value(best) if best is not None else np.inf
            return value - bound <= gap * abs(value) + 1e-9

        for _ in range(MAX_ROUNDS):
            if (best is not None and within()) or perf_counter() > until:
                break
            self.stats["rounds"] += 1
            begun = perf_counter()
            by_fuel = best is not None and search.margin_price == 0
            budget = best.fuel * (1 + 1e-6) + 1e-9 if best is not None and by_fuel else np.inf
            model = Model(search, cells, budget)
            self._add_time("model", begun)
            answer = self._run(model, stage, best, until - perf_counter())
            if answer.status == "infeasible":
                if best is None:
                    return Outcome(None, np.inf, "infeasible")
                return Outcome(best, search.value(best), "optimal")
            bound = max(bound, answer.bound)
            path, lacking = self._polished(answer.path) if answer.path is not None else (None, {})
            if path is not None and not lacking and (best is None or search.value(path) < search.value(best)):
                best = path
            if answer.status == "time" or not lacking:
                break
            cells = cells | lacking.keys()
        return Outcome(best, bound, "optimal" if best is not None and within() else "time_limit")

    def _run(self, model: Model, stage: str, best: Candidate | None, seconds: float) -> Answer:
        begun = perf_counter()
        top = self.search.value(best) if best is not None else np.inf

        def listen(incumbent: float, bound: float) -> None:
            self.report(stage, min(top, incumbent), bound)

        start = None
        if best is not None:
            check = self.search.recheck(best)
            facets = {key: self.search.pick(key, check) for key, _ in model.z}
            start = replace(best, choice=facets | best.choice)
        answer = model.solve(self.options, seconds, start, listen if self.options.progress else None)
        self._add_time("solver", begun)
        for name in ("rows", "cols", "binaries"):
            self.stats[name] = max(self.stats[name], answer.stats.get(name, 0))
        self.stats["nodes"] += answer.stats.get("nodes", 0)
        return answer

    def _polished(self, path: Candidate) -> tuple[Candidate | None, dict[Key, float]]:
        """Solve again with the facets fixed, so that no big-M and no integer tolerance is left.

        Returns the path and the cells where it lacks clearance.
        """
        search = self.search
        for _ in range(MAX_BOOKINGS):
            clean = search.solve(path.choice)
            if clean is None:
                break
            lacking = search.lacking(clean, search.recheck(clean))
            if not search.book(lacking, path.choice):
                return clean, lacking
        return None, {}

    def _add_time(self, part: str, begun: float) -> None:
        self.seconds[part] = self.seconds.get(part, 0.0) + perf_counter() - begun

    def _out_of_time(self) -> NoReturn:
        raise NotCertified(
            f"none found in the time given ({self.options.time_limit:g} s): the planner neither found a plan "
            "nor proved that there is none"
        )

    def _none(self, status: str) -> NoReturn:
        if status != "infeasible":
            self._out_of_time()
        self._none_because(diagnose.blocked)

    def _none_because(self, explain: Callable[[Planner], NoReturn]) -> NoReturn:
        if self.left <= 0:
            self._out_of_time()
        # The program keeps a booked length from every facet. While that is small, "no solution" is an
        # answer; where re-checks have forced it up, it only says that this program has none.
        booked = max((float(b.max()) for b in self.rows.booking), default=0.0)
        if booked > BOOKED_MOST:
            raise NotCertified(
                f"no certified plan: with the {booked:.3g} m that the re-check asked to book between the "
                "waypoints, the program has no solution; take smaller steps"
            )
        explain(self)

    def _certify(self, path: Candidate, value: float, bound: float, status: str) -> Plan:
        self.stats["lps"] = self.search.solves
        self.seconds["total"] = perf_counter() - self.begun
        nu = path.z.reshape(self.problem.K, -1) * self.problem.system.u_max
        wanted = np.array([e[: self.problem.K, 0] for e in self.rows.extra])
        return certified(
            self.problem,
            nu,
            wanted.reshape(-1, self.problem.K),
            value,
            bound,
            status,
            self.options.solver if self.stats["rounds"] else "highs",
            self.seconds,
            self.stats,
        )
