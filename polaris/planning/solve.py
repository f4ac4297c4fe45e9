"""`plan`: the reference trajectory, by a mixed-integer program over the cells that matter."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from time import perf_counter

import numpy as np

from ..errors import NotCertified
from ..system import Array
from . import diagnose
from .model import Answer, Model, Task
from .problem import Plan, PlannerOptions, PlanProblem, Progress
from .recheck import Recheck
from .rows import Rows
from .search import Candidate, Cell, Levels, PathSearch

MAX_ROUNDS = 60
MARGIN_BACKOFF = 1e-4
"""Share of the largest margin that is given back before the velocity change is minimised, so that
the second program is not confined to a single point."""


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
        base = self.search.solve({}, ())
        if base is None:
            self._time_or(lambda: diagnose.unreachable(self.rows, self.deadline))
            raise AssertionError("unreachable")
        objective = self.problem.objective
        target = self._targets(base)
        scale = max(base.fuel, 1e-3 * float(np.sum(self.rows.price * self.rows.limit)), 1e-9)
        top = 1.0 if objective == "margin_then_fuel" else target
        levels = Levels(0.0, 0.0 if objective == "fuel" else top)
        self.search.set_levels(levels, 300 * scale / max(top, 1e-9), 3000 * scale)
        if objective == "distance":
            self.search.set_fuel_price(1e-3)
        best = self.search.run(patience=min(2.0, 0.2 * self.options.time_limit))
        self.seconds["path_search"] = perf_counter() - begun
        cells = frozenset(self.search.seen)
        bound, status = base.fuel, "optimal"
        if levels.high > 0 and (best is None or best.short > 0 or best.level < levels.high * (1 - 1e-9)):
            best, bound, status = self._margin(levels, best, cells)
            high = best.level if best.level >= levels.high * (1 - 1e-9) else best.level * (1 - MARGIN_BACKOFF)
            levels = Levels(high, high)
        else:
            levels = Levels(levels.high, levels.high)
        reached = levels.high
        self.search.set_levels(levels, 0.0, np.inf)
        self.search.set_fuel_price(1.0)
        if best is not None and (best.short > 0 or best.level < reached):
            best = self.search.dive({}, best.sides, best.choice)
        elif best is not None:
            best = self.search.improve(replace(best, level=reached))
        if objective == "distance":
            final = best
            value = reached
        else:
            final, bound, status = self._fuel(levels, best, frozenset(self.search.seen | cells), base.fuel)
            value = final.fuel
        if final is None:
            raise NotCertified("found but not certified: a plan with the largest distance failed its re-check")
        return self._certify(final, value, bound, status)

    def _targets(self, base: Candidate) -> float:
        """Fill in the extra margin wanted per cell; returns the top of the margin variable."""
        problem, rows = self.problem, self.rows
        if problem.objective == "fuel":
            return 0.0
        if problem.objective == "distance":
            for extra in rows.extra:
                extra[: problem.K] = 1.0
            # the first cell starts at a known place, which bounds the distance whatever the plan
            start = [
                float(np.max(s[0])) for s in self.search.recheck(base).surplus
            ]
            reach = [self._room(i, 0, np.inf) for i in range(len(rows.extra))]
            cap = max(min([max(a, b) for a, b in zip(start, reach, strict=True)], default=0.0), 0.0)
            return min(cap, problem.extra_margin) if problem.extra_margin > 0 else cap
        want = problem.extra_margin
        surplus = self.search.recheck(base).surplus
        for i, extra in enumerate(rows.extra):
            extra[: problem.K] = want
            if want == 0:
                continue
            for cells in (range(problem.K), range(problem.K - 1, -1, -1)):
                for k in cells:
                    if np.max(surplus[i][k]) >= want:
                        break
                    room = self._room(i, k, want)
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
            path = search.solve({(i, k): f}, ())
            if path is not None:
                best = max(best, path.level)
            if best >= want * (1 - 1e-9):
                break
        rows.extra[i][k] = old
        search.set_fuel_price(1.0)
        return best * (1 - 1e-6) if best > 0 else best

    def _margin(self, levels: Levels, best: Candidate | None, cells: frozenset[Cell]
                ) -> tuple[Candidate, float, str]:
        """Largest margin variable, with all cells certified."""
        begun = perf_counter()
        usable = best if best is not None and best.short == 0 else None
        task = Task(cells, fuel=0.0, margin=1.0, levels=levels)
        found, bound, status = self._lazy("margin", task, usable, lambda c: -c.level, -levels.high)
        self.seconds["margin"] = perf_counter() - begun
        return found, -bound, status

    def _fuel(self, levels: Levels, best: Candidate | None, cells: frozenset[Cell], floor: float
              ) -> tuple[Candidate, float, str]:
        """Least velocity change at a given margin, with all cells certified."""
        begun = perf_counter()
        found, bound, status = self._lazy("fuel", Task(cells, levels=levels), best, lambda c: c.fuel, floor)
        self.seconds["fuel"] = perf_counter() - begun
        return found, bound, status

    def _lazy(self, stage, task, best, value, floor):  # type: ignore[no-untyped-def]
        options, bound = self.options, floor
        needs_sides = best is None or any(s >= 0 for s in best.sides)
        tries: dict[Cell, int] = {}
        for _ in range(MAX_ROUNDS):
            if best is not None and value(best) - bound <= options.gap * abs(value(best)) + 1e-9:
                return best, bound, "optimal"
            if self.left <= 0:
                break
            self.stats["rounds"] += 1
            budget = best.fuel * (1 + 1e-6) + 1e-9 if best is not None and task.fuel else np.inf
            begun = perf_counter()
            task = replace(task, budget=budget, one_of=needs_sides)
            model = Model(self.rows, task, self.search.reachable)
            self._add_time("build", begun)
            answer = self._run(model, stage, best, value)
            if answer.status == "infeasible":
                if best is not None:
                    return best, value(best), "optimal"
                self._time_or(lambda: diagnose.blocked(self, task.cells))
            bound = max(bound, answer.bound)
            if answer.path is None:
                break
            path, lacking, sides_ok = self._polish(answer.path, task)
            if path is not None and not lacking and sides_ok and (best is None or value(path) < value(best)):
                best = path
            if answer.status == "time":
                break
            if path is None or (not lacking and sides_ok):
                if best is not None:
                    return best, bound, "optimal"
                break
            needs_sides = needs_sides or not sides_ok
            for cell in lacking:
                tries[cell] = tries.get(cell, 0) + 1
            task = replace(task, cells=task.cells | lacking.keys())
        if best is None:
            raise NotCertified(
                f"none found in the time given ({options.time_limit:g} s): the planner neither found a plan nor "
                "proved that there is none"
            )
        return best, bound, "time_limit"

    def _run(self, model: Model, stage: str, best: Candidate | None, value) -> Answer:  # type: ignore[no-untyped-def]
        begun = perf_counter()
        top = value(best) if best is not None else np.inf

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

    def _polish(self, path: Candidate, task: Task) -> tuple[Candidate | None, dict[Cell, float], bool]:
        """Solve again with the facets fixed, so that no big-M and no integer tolerance is left."""
        search = self.search
        if not task.fuel:
            level = max(path.level - 1e-7 * max(1.0, task.levels.high), task.levels.low)
            search.set_levels(Levels(level, level), 0.0, np.inf)
        goal = self.problem.goal.conditions
        sides = path.sides if path.sides else tuple(-1 for _ in goal.one_of)
        clean = search.solve(path.choice, sides)
        if clean is None:
            return None, {}, True
        for _ in range(4):
            check = search.recheck(clean)
            lacking = search.lacking(clean, check)
            again = {c: v for c, v in lacking.items() if c in clean.choice}
            if not again:
                break
            search.book(again, clean.choice)
            retry = search.solve(clean.choice, sides)
            if retry is None:
                break
            clean = retry
        last = check.reference.chi[-1]
        met = all(np.max(N @ last - c) >= -1e-6 * goal.scale for N, c in goal.one_of)
        return clean, lacking, met

    def _add_time(self, part: str, begun: float) -> None:
        self.seconds[part] = self.seconds.get(part, 0.0) + perf_counter() - begun

    def _time_or(self, explain) -> None:  # type: ignore[no-untyped-def]
        if self.left <= 0:
            raise NotCertified(
                f"none found in the time given ({self.options.time_limit:g} s): the planner neither found a plan "
                "nor proved that there is none"
            )
        explain()

    def _certify(self, path: Candidate, value: float, bound: float, status: str) -> Plan:
        problem, K = self.problem, self.problem.K
        check: Recheck = self.search.recheck(path)
        wanted = np.array([e[:K, 0] for e in self.rows.extra]).reshape(len(problem.unsafe), K)
        best, facets = (check.best() if problem.unsafe else (np.zeros((0, problem.cells)),) * 2)
        missing = require(problem, check, best)
        if missing:
            raise NotCertified(f"found but not certified: {missing}")
        nu = check.reference.nu
        self.seconds["total"] = perf_counter() - self.begun
        extra: Array = best[:, :K]
        return Plan(
            chi=check.reference.chi, nu=nu, facets=np.asarray(facets[:, :K], dtype=int),
            tail_facets=np.asarray(facets[:, K:], dtype=int), margin=float(np.min(extra, initial=np.inf)),
            extra=extra, wanted=wanted, delta_v=float(np.sum(np.abs(nu)) * problem.delta / problem.system.mass),
            status=status, objective=value, bound=bound, gap=relative_gap(value, bound),
            seconds=dict(self.seconds), solver=self.options.solver, stats=dict(self.stats),
        )


def relative_gap(value: float, bound: float) -> float:
    """Relative distance of a value and its bound, infinite while either is missing."""
    if not (np.isfinite(value) and np.isfinite(bound)):
        return np.inf
    return abs(value - bound) / max(abs(value), 1e-9)


def require(problem: PlanProblem, check: Recheck, best: Array) -> str:
    """What a re-check finds wrong, or an empty string."""
    if best.size and np.min(best) < 0:
        i, k = np.unravel_index(np.argmin(best), best.shape)
        return (f"clearance from {problem.unsafe[i].name} in cell {k} is {-best[i, k]:.3g} m short of its margin "
                f"({problem.required(int(i))[k].max():.3g} m)")
    amount, name = check.goal
    if amount > 0:
        return f"the goal is missed by {amount:.3g} of its scale: {name}"
    return ""
