"""The program solved by a back end, lazily: cells enter when its solution lacks clearance there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np

from .backends import Limits
from .model import Answer, Model
from .rows import Key
from .search import Candidate, PathSearch
from .tree import Outcome

if TYPE_CHECKING:
    from .solve import Planner

MAX_ROUNDS = 60
MAX_BOOKINGS = 4

Spare = Callable[[Candidate | None], bool]
"""Whether a stage may be given up early with the path known by then."""


@dataclass(frozen=True)
class Allowance:
    """How far a stage may go: a count of linear programs or nodes, and a value of `time.perf_counter`."""

    effort: float
    deadline: float

    def spent(self, used: float) -> str:
        """What stops the stage, or an empty string."""
        if used >= self.effort:
            return "effort_limit"
        return "time_limit" if perf_counter() > self.deadline else ""


def by_back_end(
    planner: Planner, stage: str, best: Candidate | None, early: Allowance, late: Allowance, spare: Spare
) -> Outcome:
    """The back end decides the binaries; cells enter when its solution lacks clearance there."""
    search, gap, before = planner.search, planner.options.gap, planner.stats["nodes"]
    cells = frozenset(best.choice if best is not None else ())
    bound, ended = -np.inf, "effort_limit"

    def within() -> bool:
        value = search.value(best) if best is not None else np.inf
        return value - bound <= gap * abs(value) + 1e-9

    def outcome(status: str) -> Outcome:
        return Outcome(best, bound, status, int(planner.stats["nodes"] - before))

    for _ in range(MAX_ROUNDS):
        if best is not None and within():
            break
        stopped = (early if spare(best) else late).spent(planner.used)
        if stopped:
            return outcome(stopped)
        planner.stats["rounds"] += 1
        begun = perf_counter()
        by_fuel = best is not None and search.margin_price == 0
        budget = best.fuel * (1 + 1e-6) + 1e-9 if best is not None and by_fuel else np.inf
        model = Model(search, cells, budget)
        planner.add_time("model", begun)
        answer = _run(planner, model, stage, best, _limits(planner, best, early, late, spare))
        if answer.status == "infeasible":
            bound = search.value(best) if best is not None else np.inf
            return outcome("infeasible" if best is None else "optimal")
        bound = max(bound, answer.bound)
        path, lacking = _polished(search, answer.path) if answer.path is not None else (None, {})
        if path is not None and lacking:
            path = search.dive(path.choice)
        if path is not None and (best is None or search.value(path) < search.value(best)):
            best = path
        if answer.status != "optimal" or not lacking:
            ended = answer.status if answer.status != "optimal" else ended
            break
        cells = cells | lacking.keys()
    return outcome("optimal" if best is not None and within() else ended)


def _limits(
    planner: Planner, best: Candidate | None, early: Allowance, late: Allowance, spare: Spare
) -> Limits:
    """What is allowed, less what is used. A search that finds nothing may have to end early."""
    now, used = perf_counter(), planner.used
    last = early if best is not None and spare(best) else late
    limits = Limits(max(int(last.effort - used), 1), last.deadline - now)
    if best is None and spare(None):
        return replace(limits, patience_nodes=early.effort - used, patience_seconds=early.deadline - now)
    return limits


def _run(planner: Planner, model: Model, stage: str, best: Candidate | None, limits: Limits) -> Answer:
    begun = perf_counter()
    top = planner.search.value(best) if best is not None else np.inf

    def listen(incumbent: float, bound: float) -> None:
        planner.report(stage, min(top, incumbent), bound)

    start = None
    if best is not None:
        seen = planner.search.look(best)
        facets = {key: planner.search.pick(key, seen) for key, _ in model.z}
        start = replace(best, choice=facets | best.choice)
    answer = model.solve(planner.options, limits, start, listen if planner.options.progress else None)
    planner.add_time("solver", begun)
    for name in ("rows", "cols", "binaries"):
        planner.stats[name] = max(planner.stats[name], answer.stats.get(name, 0))
    planner.stats["nodes"] += answer.stats["nodes"]
    return answer


def _polished(search: PathSearch, path: Candidate) -> tuple[Candidate | None, dict[Key, float]]:
    """Solve again with the facets fixed, so that no big-M and no integer tolerance is left.

    Returns the path and the cells where it lacks clearance.
    """
    for _ in range(MAX_BOOKINGS):
        clean = search.solve(path.choice)
        if clean is None:
            break
        seen = search.look(clean)
        lacking = search.lacking(clean, seen)
        if lacking or search.confirmed(clean, seen):
            return clean, lacking
    return None, {}
