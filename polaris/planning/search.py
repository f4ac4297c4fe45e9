"""Good paths quickly: linear programs with the separating facets fixed, and a local search over them.

A path found here is a feasible point of the mixed-integer program; its velocity change bounds how far
the optimal path can stray, which is what makes the program small and its big-M tight.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import numpy as np

from ..model.system import Array
from ..model.tolerances import SOLVER_FEASIBILITY
from .lp import GrowingLP
from .recheck import recheck
from .reference import Reference
from .rows import Key, PlanRows

GOAL_SLACK = 1e-9  # share of the goal's scale by which a disjunction of the goal may be missed unnoticed

ROW_SLACK = 10 * SOLVER_FEASIBILITY
"""Length, in units of `PlanRows.length`, by which a path may miss rows that its program did not state."""


@dataclass(eq=False)
class Candidate:
    """A path: input shares z, shape (N,), and the settings it was made with.

    `level` is the value of the margin variable s; `short` the length [m] by which required clearances had to
    be relaxed, 0 for a usable path; `fuel` the velocity change [m/s]; `choice` the facet of every constrained
    cell, and the row of every constrained disjunction of the goal.
    """

    z: Array
    level: float
    short: float
    fuel: float
    choice: dict[Key, int] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class CheckedPath:
    """A path against all rows: states at the waypoints, (K+1, n), and `PlanRows.surplus` [m]."""

    states: Array
    surplus: tuple[Array, ...]


class PathSearch:
    """Linear programs over input shares (z+, z-), the margin variable s and a shortfall e [length].

    Clearances must exceed `margins` by ``extra * s``. `deadline` is the value of `time.perf_counter` at which
    to stop; it is past as soon as a program has run out of time. `more` is the number of further variables,
    free of charge and zero until told otherwise, of which no row here speaks.
    """

    def __init__(self, rows: PlanRows, deadline: float, more: int = 0) -> None:
        self.rows, self.deadline, self.more = rows, deadline, more
        K, unit = rows.problem.K, rows.goal_length
        high = np.r_[rows.limit, rows.limit, np.zeros(2 + more)]
        self.lp = GrowingLP(np.zeros(len(high)), np.zeros(len(high)), high)
        goal, last = rows.problem.goal.conditions, rows.free[K]
        for g, rhs, top in ((goal.E, goal.e, 0.0), (-goal.G, -goal.g, np.inf)):
            at_least = (rhs - g @ last) / unit
            self.lp.add(self._wide(rows.state_rows(g, K) / unit, 0.0, 0.0), at_least, at_least + top)
        self.base = self.lp.rows
        self.solves = 0
        self.set_prices(0.0, 0.0)

    def set_prices(
        self, low: float, high: float, margin: float = 0.0, short: float = np.inf, fuel: float = 1.0
    ) -> None:
        """Range of s; prices of s, of the shortfall (infinite: none allowed) and of fuel."""
        self.low, self.high = low, high
        self.margin_price, self.short_price, self.fuel_price = margin, short, fuel
        s, free = 2 * self.rows.N, bool(np.isfinite(short))
        fuel_cost = self.rows.price * fuel
        self.lp.price(0, np.r_[fuel_cost, fuel_cost, -margin, short if free else 0.0])
        self.lp.limit(s, np.array([low, 0.0]), np.array([high, np.inf if free else 0.0]))

    def value(self, path: Candidate) -> float:
        """Objective of a path at the prices set."""
        value = self.fuel_price * path.fuel - self.margin_price * path.level
        return value + (self.short_price * path.short / self.rows.length if path.short > 0 else 0.0)

    def solve(self, choice: Mapping[Key, int], start: tuple[Any, int] | None = None) -> Candidate | None:
        """The best path with these facets, or None; from the basis there was with the first few of them."""
        self.lp.take_back(self.base)
        parts = list(choice.items())
        if start is not None:
            basis, count = start
            self._add(parts[:count])
            self.lp.use(basis)
            parts = parts[count:]
        self._add(parts)
        self.solves += 1
        answer = self.lp.solve(self.deadline - perf_counter())
        if answer is None:
            if self.lp.out_of_time:  # not to be taken for infeasible: nothing more is asked
                self.deadline = min(self.deadline, perf_counter() - 1e-3)
            return None
        x, N = answer[1], self.rows.N
        z = x[:N] - x[N : 2 * N]
        fuel = float(np.sum(self.rows.price * np.abs(z)))
        short = x[2 * N + 1] * self.rows.length
        return Candidate(z, x[2 * N], short if short > 1e-9 else 0.0, fuel, dict(choice))

    def _add(self, parts: list[tuple[Key, int]]) -> None:
        if parts:
            options = [self.rows.options(key) for key, _ in parts]
            chosen = zip(options, parts, strict=True)
            rows = [self._wide(o.a[j], o.slope, float(i >= 0)) for o, ((i, _), j) in chosen]
            at_least = [o.at_least[j] for o, (_, j) in zip(options, parts, strict=True)]
            self.lp.add(np.vstack(rows), np.concatenate(at_least), np.inf)

    def _wide(self, a: Array, slope: float, elastic: float) -> Array:
        N, wide = self.rows.N, np.zeros((*a.shape[:-1], 2 * self.rows.N + 2 + self.more))
        wide[..., :N], wide[..., N : 2 * N], wide[..., 2 * N], wide[..., 2 * N + 1] = a, -a, -slope, elastic
        return wide

    def bounds(self, path: Candidate, keys: Collection[Key]) -> dict[Key, Array]:
        """Lower bounds on the objective with each alternative added to the program `path` solves.

        That program must be the last one solved.
        """
        if not keys:
            return {}
        a, shortfalls, sizes = [], [], []
        for key in keys:
            o, elastic = self.rows.options(key), float(key[0] >= 0)
            short = o.at_least - o.a @ path.z + o.slope * path.level - elastic * path.short / self.rows.length
            worst = np.argmax(short, axis=1)
            each = np.arange(len(worst))
            a.append(self._wide(o.a[each, worst], o.slope, elastic))
            shortfalls.append(short[each, worst])
            sizes.append(len(worst))
        cost = self.lp.costs(np.vstack(a), np.concatenate(shortfalls))
        value = self.value(path)
        parts = np.split(value + cost, np.cumsum(sizes)[:-1])
        return dict(zip(keys, parts, strict=True))

    def look(self, path: Candidate) -> CheckedPath:
        """A candidate against all rows of the program."""
        problem = self.rows.problem
        nu = path.z.reshape(problem.K, -1) * problem.system.u_max
        reference = Reference.propagate(problem.system, problem.delta, problem.x0, nu)
        return CheckedPath(reference.chi, self.rows.surplus(reference.extend(problem.tail_cells)))

    def lacking(self, path: Candidate, checked: CheckedPath) -> dict[Key, float]:
        """Disjunctions not stated yet of which the path keeps no alternative, with the shortfall [m].

        This is the program itself, whoever solves it: a path that lacks nothing is feasible in it.
        """
        out: dict[Key, float] = {}
        for i, surplus in enumerate(checked.surplus):
            gap = surplus.max(axis=1) - self.rows.extra[i][:, 0] * path.level + path.short
            short = np.nonzero(gap < -ROW_SLACK * self.rows.length)[0].tolist()
            out |= {(i, k): -float(gap[k]) for k in short if (i, k) not in path.choice}
        goal, last = self.rows.problem.goal.conditions, checked.states[-1]
        for group, (N, c) in enumerate(goal.one_of):
            clearance = float(np.max(N @ last - c))
            if clearance < -GOAL_SLACK * goal.scale and (-1, group) not in path.choice:
                out[-1, group] = -clearance
        return out

    def confirmed(self, path: Candidate, checked: CheckedPath) -> bool:
        """Exact re-check of a path that lacks nothing. Where it fails, the tightening grows."""
        problem, certified = self.rows.problem, True
        check = recheck(problem, path.z.reshape(problem.K, -1) * problem.system.u_max)
        for i, surplus in enumerate(check.surplus):
            gap = surplus.max(axis=1) - self.rows.extra[i][:, 0] * path.level + path.short
            for k in np.nonzero(gap < 0)[0].tolist():
                facet = path.choice.get((i, k), int(np.argmax(checked.surplus[i][k])))
                self.rows.booking[i][k, facet] += 1.5 * -float(gap[k]) + 1e-4
                certified = False
        return certified

    def dive(self, start: Mapping[Key, int], rounds: int = 12) -> Candidate | None:
        """Add cells as they are found lacking until none is; None if it does not settle.

        Each gets the facet beyond which the path has most clearance, or least to make up for.
        """
        choice = dict(start)
        for _ in range(rounds):
            path = self.solve(choice)
            if path is None or perf_counter() > self.deadline:
                return None
            checked = self.look(path)
            lacking = self.lacking(path, checked)
            if not lacking and self.confirmed(path, checked):
                return path
            choice |= {key: self.pick(key, checked) for key in lacking}
        return None

    def pick(self, key: Key, checked: CheckedPath) -> int:
        """The alternative with most clearance."""
        if key[0] < 0:
            N, c = self.rows.problem.goal.conditions.one_of[key[1]]
            return int(np.argmax(N @ checked.states[-1] - c))
        return int(np.argmax(checked.surplus[key[0]][key[1]]))

    def improve(self, path: Candidate, rounds: int = 6) -> Candidate:
        """Re-choose facets where the path has most clearance, and solve again, while it pays."""
        for _ in range(rounds):
            checked = self.look(path)
            improved = self.dive({key: self.pick(key, checked) for key in path.choice}, rounds=4)
            if improved is None or self.value(improved) > self.value(path) - 1e-5 * abs(path.fuel):
                break
            path = improved
        return path

    def first(self) -> Candidate | None:
        """A good path without branching: the nearest facets, then local improvement."""
        path = self.dive({})
        return self.improve(path) if path is not None else None


def set_targets(search: PathSearch, base: Candidate) -> float | None:
    """Fill in the extra margin wanted per cell, ``rows.extra * s``; return the top of the margin variable s.

    It is wanted of sets in position; of limits on the whole state the margins required are enough. `base` is
    the cheapest path without unsafe sets. None if no path to the goal can keep some cell clear.
    """
    problem, extras = search.rows.problem, search.rows.extra
    surplus, margin = search.look(base).surplus, problem.extra_margin
    bodies = [i for i, body in enumerate(problem.unsafe) if not body.of_state]
    if problem.objective == "distance":
        for i in bodies:
            extras[i][: problem.K] = 1.0
        # the first cell starts at a known place, which bounds the distance whatever the plan
        reach = [max(float(np.max(surplus[i][0])), _clearance(search, i, 0, np.inf)) for i in bodies]
        cap = max(min(reach, default=0.0), 0.0)
        return min(cap, margin) if margin > 0 else cap
    target = margin if problem.objective == "margin_then_fuel" else 0.0
    for i, extra in enumerate(extras):
        margin = target if i in bodies else 0.0
        extra[: problem.K] = margin
        for cells in (range(problem.K), range(problem.K - 1, -1, -1)):
            for k in cells:
                if np.max(surplus[i][k]) >= margin:
                    break
                clearance = _clearance(search, i, k, margin)
                if clearance < 0:
                    return None
                extra[k] = min(extra[k, 0], clearance)
                if clearance >= margin:
                    break
    return 1.0 if target > 0 and bodies else 0.0


def _clearance(search: PathSearch, i: int, k: int, cap: float) -> float:
    """Largest extra clearance [m] any path to the goal can have in one cell, at most `cap`."""
    best, extra = -np.inf, search.rows.extra[i]
    old, extra[k] = extra[k, 0], 1.0
    search.set_prices(-1e6, min(cap, 1e6), margin=1e3, fuel=1e-6)
    for f in range(len(search.rows.problem.unsafe[i].normals)):
        path = search.solve({(i, k): f})
        best = best if path is None else max(best, path.level)
        if best >= cap * (1 - 1e-9):
            break
    extra[k] = old
    return best * (1 - 1e-6) if best > 0 else best
