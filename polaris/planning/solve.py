"""`plan`: the reference trajectory, by a mixed-integer program over the cells that matter."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from time import perf_counter
from typing import NoReturn

import numpy as np

from ..errors import NotCertified
from . import diagnose
from .certify import certified, relative_gap
from .model import Answer, Model, Task
from .problem import Plan, PlannerOptions, PlanProblem, Progress
from .rows import Rows
from .search import Candidate, Cell, Levels, PathSearch
from .tree import Outcome, branch

MAX_ROUNDS = 60
MAX_BOOKINGS = 4
MAX_NODES = 20_000
TREE_SHARE = 0.7
"""Share of the time left that the tree may use before what is open goes to the back end."""

SECONDS_PER_ROW = 5e-4
"""Rough time to build a row of the model; a program that would take more than a tenth of the time
left to write down is not handed to the back end."""

MARGIN_SHARE = 0.25
"""Share of the time left spent on proving that no larger margin exists, once a plan is known."""

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
        self.begun = perf_counter()
        self.deadline = self.begun + options.time_limit
        self.rows = Rows(problem)
        self.search = PathSearch(self.rows, self.deadline)
        self.seconds: dict[str, float] = {}
        self.stats: dict[str, float] = {"rows": 0, "cols": 0, "binaries": 0, "nodes": 0, "rounds": 0}
        self._last_report = -np.inf

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
        """All phases."""
        self.report("path search")
        begun = perf_counter()
        groups = len(self.problem.goal.conditions.one_of)
        base = self.search.solve({}, (-1,) * groups)
        if base is None:
            self._time_or(lambda: diagnose.unreachable(self))
        assert base is not None
        scale = max(base.fuel, 1e-3 * float(np.sum(self.rows.price * self.rows.limit)), 1e-9)
        top = self._targets(base)
        margin_price = scale * (1 / MARGIN_TRADE if top > 0 else 0.0) / max(top, 1e-9)
        self.search.set_levels(Levels(0.0, top), margin_price, 10 * scale / MARGIN_TRADE)
        best = self.search.first()
        if best is not None and best.short > 0:
            best = None
        self._add_time("path_search", begun)
        if top > 0 and (best is None or best.level < top * (1 - 1e-9)):
            self.search.set_levels(Levels(0.0, top), margin_price, np.inf)
            best, bound, status = self._minimise("margin", best)
            if best.level < top * (1 - 1e-6) or self.problem.objective == "distance":
                unit = 1.0 if self.problem.objective == "distance" else self.problem.extra_margin
                most = min(best.level + (self.search.value(best) - bound) / margin_price, top)
                return self._certify(best, best.level * unit, most * unit, status)
        if best is not None:
            best = replace(best, level=top)
        if self.problem.objective == "distance":
            assert best is not None
            return self._certify(best, top, top, "optimal")
        self.search.set_levels(Levels(top, top), 0.0, np.inf)
        best, bound, status = self._minimise("fuel", best)
        return self._certify(best, best.fuel, bound, status)

    def _targets(self, base: Candidate) -> float:
        """Fill in the extra margin wanted per cell; returns the top of the margin variable."""
        problem, rows = self.problem, self.rows
        if problem.objective == "distance":
            for extra in rows.extra:
                extra[: problem.K] = 1.0
            # the first cell starts at a known place, which bounds the distance whatever the plan
            start = [float(np.max(s[0])) for s in self.search.recheck(base).surplus]
            reach = [self._room(i, 0, np.inf) for i in range(len(rows.extra))]
            cap = max(min([max(a, b) for a, b in zip(start, reach, strict=True)], default=0.0), 0.0)
            return min(cap, problem.extra_margin) if problem.extra_margin > 0 else cap
        want = problem.extra_margin if problem.objective == "margin_then_fuel" else 0.0
        surplus = self.search.recheck(base).surplus
        for i, extra in enumerate(rows.extra):
            extra[: problem.K] = want
            for cells in (range(problem.K), range(problem.K - 1, -1, -1)):
                for k in cells:
                    if np.max(surplus[i][k]) >= want:
                        break
                    room = self._room(i, k, want)
                    if room < 0:
                        self._time_or(lambda: diagnose.blocked(self))
                    extra[k] = min(extra[k, 0], max(room, 0.0))
                    if room >= want:
                        break
        return 1.0 if want > 0 else 0.0

    def _room(self, i: int, k: int, want: float) -> float:
        """Largest extra clearance [m] any path to the goal can have in one cell, at most `want`."""
        search, rows = self.search, self.rows
        best = -np.inf
        old = rows.extra[i][k, 0]
        rows.extra[i][k] = 1.0
        search.set_levels(Levels(-1e6, min(want, 1e6)), 1e3, np.inf)
        search.set_fuel_price(1e-6)
        for f in range(len(self.problem.unsafe[i].normals)):
            path = search.solve({(i, k): f}, (-1,) * len(self.problem.goal.conditions.one_of))
            if path is not None:
                best = max(best, path.level)
            if best >= want * (1 - 1e-9):
                break
        rows.extra[i][k] = old
        search.set_fuel_price(1.0)
        return best * (1 - 1e-6) if best > 0 else best

    def _minimise(self, stage: str, best: Candidate | None) -> tuple[Candidate, float, str]:
        """Least objective at the prices and levels set, all cells certified; path, bound and status."""
        begun = perf_counter()
        found: Outcome | None = None
        hurry = stage == "margin" and best is not None and self.problem.objective != "distance"
        stop = begun + (MARGIN_SHARE if hurry else 1.0) * self.left
        if self.options.branching == "facets":
            found = branch(
                self.search,
                best,
                self.options.gap,
                stop,
                MAX_NODES,
                lambda top, bound: self.report(stage, top, bound),
                (begun + TREE_SHARE * self.left, self._max_cells()),
            )
            best = found.best
            self.stats["nodes"] += found.nodes
        self._add_time(stage, begun)
        if found is not None and found.status == "infeasible" and best is None:
            self._time_or(lambda: diagnose.blocked(self))
        if found is not None and found.status == "optimal":
            assert best is not None
            return self._close(stage, best, found.bound)
        if found is not None and hurry and best is not None:
            return best, found.bound, "time_limit"
        return self._lazy(stage, best, found)

    def _close(self, stage: str, best: Candidate, bound: float) -> tuple[Candidate, float, str]:
        """Every binary is decided: what is left of the program has none, and the back end solves it."""
        search, begun = self.search, perf_counter()
        task = Task(
            frozenset(best.choice),
            search.fuel_price,
            search.prices[0],
            levels=search.levels,
            one_of=False,
            decided=(dict(best.choice), best.sides),
        )
        answer = self._run(Model(self.rows, task, search.reachable), stage, None)
        self._add_time("model", begun)
        if answer.path is not None:
            path, lacking, met = self._polished(replace(answer.path, choice=best.choice, sides=best.sides))
            if path is not None and not lacking and met and search.value(path) <= search.value(best):
                best = path
        return best, min(bound, search.value(best)), "optimal"

    def _max_cells(self) -> int:
        """Constrained cells a model may have to be built in a tenth of the time left."""
        facets = max((len(body.normals) for body in self.problem.unsafe), default=1)
        rows = facets * len(self.rows.control_points[2])
        return int(0.1 * self.left / (SECONDS_PER_ROW * rows))

    def _lazy(
        self, stage: str, best: Candidate | None, known: Outcome | None
    ) -> tuple[Candidate, float, str]:
        """The back end decides the binaries; cells enter when its solution lacks clearance there."""
        options, search = self.options, self.search
        bound = known.bound if known is not None else -np.inf
        cells = known.cells if known is not None else frozenset(best.choice if best is not None else ())
        if len(cells) > self._max_cells():
            cells = frozenset(best.choice) if best is not None else frozenset()
        one_of = best is None or any(side >= 0 for side in best.sides)
        for _ in range(MAX_ROUNDS):
            if (
                best is not None
                and search.value(best) - bound <= options.gap * abs(search.value(best)) + 1e-9
            ):
                return best, bound, "optimal"
            if self.left <= 0:
                break
            self.stats["rounds"] += 1
            budget = np.inf
            if best is not None and search.prices[0] == 0:
                budget = best.fuel * (1 + 1e-6) + 1e-9
            begun = perf_counter()
            task = Task(
                cells, search.fuel_price, search.prices[0], levels=search.levels, budget=budget, one_of=one_of
            )
            model = Model(self.rows, task, search.reachable)
            self._add_time("model", begun)
            answer = self._run(model, stage, best)
            if answer.status == "infeasible":
                if best is not None:
                    return best, search.value(best), "optimal"
                self._time_or(lambda: diagnose.blocked(self))
            bound = max(bound, answer.bound)
            if answer.path is None:
                break
            path, lacking, met = self._polished(answer.path)
            if (
                path is not None
                and not lacking
                and met
                and (best is None or search.value(path) < search.value(best))
            ):
                best = path
            if answer.status == "time" or path is None or (not lacking and met):
                break
            one_of = one_of or not met
            cells = cells | lacking.keys()
        if best is None:
            self._out_of_time()
        assert best is not None
        within = search.value(best) - bound <= options.gap * abs(search.value(best)) + 1e-9
        return best, bound, "optimal" if within else "time_limit"

    def _run(self, model: Model, stage: str, best: Candidate | None) -> Answer:
        begun = perf_counter()
        top = self.search.value(best) if best is not None else np.inf

        def listen(incumbent: float, bound: float) -> None:
            self.report(stage, min(top, incumbent), bound)

        start = None
        if best is not None:
            _, facets = self.search.recheck(best).best()
            everywhere = {c: best.choice.get(c, int(facets[c])) for c in model.task.cells}
            start = replace(best, choice=everywhere)
        answer = model.solve(self.options, self.left, start, listen if self.options.progress else None)
        self._add_time("solver", begun)
        for name in ("rows", "cols", "binaries"):
            self.stats[name] = max(self.stats[name], answer.stats.get(name, 0))
        self.stats["nodes"] += answer.stats.get("nodes", 0)
        return answer

    def _polished(self, path: Candidate) -> tuple[Candidate | None, dict[Cell, float], bool]:
        """Solve again with the facets fixed, so that no big-M and no integer tolerance is left."""
        search, goal = self.search, self.problem.goal.conditions
        clean = search.solve(path.choice, path.sides if path.sides else (-1,) * len(goal.one_of))
        lacking: dict[Cell, float] = {}
        for _ in range(MAX_BOOKINGS):
            if clean is None:
                return None, lacking, True
            check = search.recheck(clean)
            lacking = search.lacking(clean, check)
            short = {c: v for c, v in lacking.items() if c in clean.choice}
            if not short:
                break
            search.book(short, clean.choice)
            clean = search.solve(clean.choice, clean.sides)
        last = check.reference.chi[-1]
        met = all(np.max(N @ last - c) >= -1e-6 * goal.scale for N, c in goal.one_of)
        return clean, lacking, met

    def _add_time(self, part: str, begun: float) -> None:
        self.seconds[part] = self.seconds.get(part, 0.0) + perf_counter() - begun

    def _out_of_time(self) -> NoReturn:
        raise NotCertified(
            f"none found in the time given ({self.options.time_limit:g} s): the planner neither found a plan "
            "nor proved that there is none"
        )

    def _time_or(self, explain: Callable[[], NoReturn]) -> NoReturn:
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
        explain()

    def _certify(self, path: Candidate, value: float, bound: float, status: str) -> Plan:
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
            self.options.solver,
            self.seconds,
            self.stats,
        )
