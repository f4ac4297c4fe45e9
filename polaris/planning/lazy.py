"""The program solved by a back end, lazily: cells enter when its solution lacks clearance there."""

from __future__ import annotations

from dataclasses import replace
from time import perf_counter

import numpy as np

from .backends import Found, Limits
from .effort import Allowance, Effort, Spare
from .model import Model
from .rows import Key
from .search import Candidate, PathSearch
from .tree import Outcome

MAX_ROUNDS = 60
MAX_BOOKINGS = 4


def by_back_end(
    effort: Effort, stage: str, best: Candidate | None, early: Allowance, late: Allowance, spare: Spare
) -> Outcome:
    """The back end decides the binaries; cells enter when its solution lacks clearance there."""
    search, gap, before = effort.search, effort.options.gap, effort.stats["nodes"]
    cells = frozenset(best.choice if best is not None else ())
    bound, ended = -np.inf, "effort_limit"

    def within() -> bool:
        value = search.value(best) if best is not None else np.inf
        return value - bound <= gap * abs(value) + 1e-9

    def outcome(status: str) -> Outcome:
        return Outcome(best, bound, status, int(effort.stats["nodes"] - before))

    for _ in range(MAX_ROUNDS):
        if best is not None and within():
            break
        stopped = (early if spare(best) else late).spent(effort.used)
        if stopped:
            return outcome(stopped)
        effort.stats["rounds"] += 1
        begun = perf_counter()
        by_fuel = best is not None and search.margin_price == 0
        budget = best.fuel * (1 + 1e-6) + 1e-9 if best is not None and by_fuel else np.inf
        model = Model(search, cells, budget)
        effort.add_time("model", begun)
        answer, solution = _run(effort, model, stage, best, _limits(effort, best, early, late, spare))
        if answer.status == "infeasible":
            bound = search.value(best) if best is not None else np.inf
            return outcome("infeasible" if best is None else "optimal")
        bound = max(bound, answer.bound)
        path, lacking = _polished(search, solution) if solution is not None else (None, {})
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
    effort: Effort, best: Candidate | None, early: Allowance, late: Allowance, spare: Spare
) -> Limits:
    """What is allowed, less what is used. A search that finds nothing may have to end early."""
    now, used = perf_counter(), effort.used
    last = early if best is not None and spare(best) else late
    limits = Limits(max(int(last.effort - used), 1), last.deadline - now)
    if best is None and spare(None):
        return replace(limits, patience_nodes=early.effort - used, patience_seconds=early.deadline - now)
    return limits


def _run(
    effort: Effort, model: Model, stage: str, best: Candidate | None, limits: Limits
) -> tuple[Found, Candidate | None]:
    begun = perf_counter()
    top = effort.search.value(best) if best is not None else np.inf

    def listen(incumbent: float, bound: float) -> None:
        effort.report(stage, min(top, incumbent), bound)

    start = None
    if best is not None:
        seen = effort.search.look(best)
        facets = {key: effort.search.pick(key, seen) for key, _ in model.z}
        start = replace(best, choice=facets | best.choice)
    found = model.solve(effort.options, limits, start, listen if effort.options.progress else None)
    effort.add_time("solver", begun)
    sizes = {"rows": model.count, "cols": model.cols, "binaries": model.binaries}
    effort.stats |= {name: max(effort.stats[name], float(size)) for name, size in sizes.items()}
    effort.stats["nodes"] += found[0].nodes
    return found


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
