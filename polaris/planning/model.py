"""The mixed-integer program (eqs. 14-23, corrected), written in PuLP and solved by a back end, lazily.

Disjunctions enter the program when its solution lacks clearance there.
"""

from collections.abc import Callable, Collection, Iterable
from itertools import chain
from operator import eq, ge, le
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..model.system import Array
from . import backends
from .effort import Allowance, SearchEffort
from .lp import GrowingLP
from .rows import Key, PlanRows
from .search import Candidate, PathSearch
from .tree import SearchOutcome

MAX_ROUNDS = 60
MAX_BOOKINGS = 4


class Model:
    """The PuLP model of the program at the prices of a search, over some disjunctions.

    Its variables are the input shares either way, the margin variable s, the states at the waypoints, and the
    binaries. The states stay in it although the inputs determine them: the rows are then sparse, which is
    worth more to a branch-and-cut code than fewer columns.

    `cells` are the disjunctions to state; `budget` is a velocity change [m/s] that some optimal path is known
    to keep.
    """

    def __init__(self, search: PathSearch, cells: Collection[Key], budget: float = np.inf) -> None:
        import pulp

        self.pulp, self.search, self.rows, self.budget = pulp, search, search.rows, budget
        self.lp: Any = pulp.LpProblem("reference", pulp.LpMinimize)
        self.frame = goal_frame(self.rows)
        self.back = np.linalg.inv(self.frame)
        self.K, m, new = self.rows.problem.K, self.rows.problem.system.m, self.lp.add_variable
        limit, steps, n = self.rows.limit.tolist(), range(1, self.K + 1), len(self.frame)
        self.plus = [new(f"p{j // m}_{j % m}", 0.0, top) for j, top in enumerate(limit)]
        self.minus = [new(f"m{j // m}_{j % m}", 0.0, top) for j, top in enumerate(limit)]
        self.s = new("s", search.low, search.high)
        self.x = [[new(f"x{k}_{i}") for i in range(n)] for k in steps]
        inputs, price = self.plus + self.minus, np.tile(self.rows.price, 2)
        cost = np.r_[price * search.fuel_price, -search.margin_price]
        self.lp.setObjective(self._sum([*inputs, self.s], cost.tolist()))
        if np.isfinite(budget):
            self._add(inputs, price[None], le, budget)
        self._dynamics()
        goal, unit = self.rows.problem.goal.conditions, self.rows.goal_length
        self._add(self.x[-1], goal.E @ self.back / unit, eq, goal.e / unit)
        self._add(self.x[-1], goal.G @ self.back / unit, le, goal.g / unit)
        self.z: dict[tuple[Key, int], Any] = {}
        self.impossible = not all(self._one_of(key) for key in sorted(cells, key=lambda c: (c[1], c[0])))

    def _sum(self, variables: Iterable[Any], weights: list[float]) -> Any:
        terms = [(v, w) for v, w in zip(variables, weights, strict=True) if w != 0.0]
        return self.pulp.LpAffineExpression(terms)

    def _add(
        self, variables: list[Any], a: Array, relation: Callable[[Any, float], Any], rhs: ArrayLike
    ) -> None:
        """Add a row of some variables for each of a, of shape (R, variables): equal, at most or at least."""
        for weights, value in zip(a.tolist(), np.broadcast_to(rhs, len(a)).tolist(), strict=True):
            self.lp += relation(self._sum(variables, weights), value)

    def _inputs(self, k: int) -> list[Any]:
        """Input shares of step k, either way; none at the last waypoint."""
        m = len(self.plus) // self.K
        step = slice(k * m, (k + 1) * m)
        return self.plus[step] + self.minus[step]

    def _dynamics(self) -> None:
        """States at the waypoints (eq. 14), in units that make them numbers near 1."""
        rows, W = self.rows, self.frame
        A = W @ rows.Ad @ np.linalg.inv(W)
        B = W @ rows.Bd * rows.problem.system.u_max
        block = np.hstack([B, -B, -np.eye(len(W))])
        self._add(self._inputs(0) + self.x[0], block, eq, -(A @ W @ rows.problem.x0))
        for k in range(1, self.K):
            self._add(self._inputs(k) + self.x[k] + self.x[k - 1], np.hstack([block, A]), eq, 0.0)

    def _one_of(self, key: Key) -> bool:
        """State one disjunction, with big-M as small as the input limits allow; False if none can hold."""
        rows, search = self.rows, self.search
        options = rows.options(key)
        largest = rows.extreme(options.a, self.budget)
        least = -largest
        if key[0] < 0:  # the goal's own inequalities bound its rows too
            goal = rows.problem.goal.conditions
            floor = goal_floor(goal.G, goal.g, goal.one_of[key[1]][0]) / rows.goal_length
            least = np.maximum(least, floor[:, None] - options.free)
        big_m = options.at_least + options.slope * search.high - least
        feasible = np.all(largest >= options.at_least + options.slope * search.low - 1e-9, axis=1)
        chosen, k = np.nonzero(feasible)[0].tolist(), options.at
        at_least = options.at_least + (options.free if k else 0.0)
        variables = (self.x[k - 1] if k else []) + self._inputs(k) + [self.s]
        binaries = []
        for j in chosen:
            parts = [options.g[j] @ self.back] if k else []
            parts += [options.h[j], -options.h[j]] if k < self.K else []
            a = np.hstack([*parts, np.full((len(at_least[j]), 1), -options.slope)])
            if len(chosen) == 1:
                self.z[key, j] = None
                self._add(variables, a, ge, at_least[j])
                continue
            z = self.z[key, j] = self.lp.add_variable(f"z{key[0] + 1}_{key[1]}_{j}", cat="Binary")
            binaries.append(z)
            M, open_ = big_m[j][:, None], big_m[j] > 0
            self._add([*variables, z], np.hstack([a, -M])[open_], ge, (at_least[j] - big_m[j])[open_])
        if binaries:
            self.lp += self.pulp.lpSum(binaries) == 1
        return bool(chosen)

    def begin_at(self, path: Candidate) -> None:
        """Give the variables the values of a path, where a back end starts."""
        checked = self.search.look(path)
        states = (checked.states[1:] @ self.frame.T).ravel()
        values = np.r_[np.maximum(path.z, 0.0), np.maximum(-path.z, 0.0), path.level, states]
        variables = [*self.plus, *self.minus, self.s, *chain.from_iterable(self.x)]
        for variable, value in zip(variables, values.tolist(), strict=True):
            variable.setInitialValue(value, check=False)
        for (key, j), z in self.z.items():
            if z is not None:
                facet = path.choice[key] if key in path.choice else self.search.pick(key, checked)
                z.setInitialValue(float(j == facet), check=False)

    def path(self) -> Candidate:
        """The solution as a path."""
        # PuLP leaves variables that no row mentions without a value
        plus, minus = (np.array([v.varValue or 0.0 for v in side]) for side in (self.plus, self.minus))
        level = self.search.high if self.s.varValue is None else float(self.s.varValue)
        choice = {key: j for (key, j), z in self.z.items() if z is None or z.varValue > 0.5}
        z = plus - minus
        return Candidate(z, level, 0.0, float(np.sum(self.rows.price * np.abs(z))), choice)


def goal_frame(rows: PlanRows) -> Array:
    """Diagonal scaling that makes every entry of the last state a number near 1, shape (n, n)."""
    system = rows.problem.system
    reach = np.abs(rows.state_rows(np.eye(system.n), rows.problem.K)) @ rows.limit
    drift = np.maximum(np.abs(rows.free[rows.problem.K]), 1e-3 * reach + 1e-9)
    typical = np.sqrt(np.maximum(reach, 1e-9) * drift)
    position = np.abs(system.position).sum(axis=0) > 0
    return np.diag(np.where(position, 1 / rows.length, 1 / np.maximum(typical, 1e-9)))


def goal_floor(G: Array, g: Array, N: Array) -> Array:
    """Smallest value of each row of N over ``G x <= g``, -inf where unbounded, shape (J,)."""
    out = np.full(len(N), -np.inf)
    if len(G):
        n = N.shape[1]
        for j, row in enumerate(N):
            lp = GrowingLP(row, np.full(n, -np.inf), np.full(n, np.inf))
            lp.add(G, -np.inf, g)
            answer = lp.solve(np.inf)
            if answer is not None:
                out[j] = answer[0]
    return out


def by_back_end(
    effort: SearchEffort, stage: str, best: Candidate | None, allowed: Allowance
) -> SearchOutcome:
    """The back end decides the binaries; cells enter when its solution lacks clearance there."""
    search, gap, before = effort.search, effort.options.gap, effort.stats["nodes"]
    cells = frozenset(best.choice if best is not None else ())
    bound, ended = -np.inf, "effort_limit"

    def within() -> bool:
        value = search.value(best) if best is not None else np.inf
        return value - bound <= gap * abs(value) + 1e-9

    def outcome(status: str) -> SearchOutcome:
        return SearchOutcome(best, bound, status, int(effort.stats["nodes"] - before))

    for _ in range(MAX_ROUNDS):
        if best is not None and within():
            break
        if stopped := allowed.limit_reached(best, effort.used):
            return outcome(stopped)
        effort.stats["rounds"] += 1
        start = perf_counter()
        by_fuel = best is not None and search.margin_price == 0
        budget = best.fuel * (1 + 1e-6) + 1e-9 if best is not None and by_fuel else np.inf
        model = Model(search, cells, budget)
        effort.add_time("model", start)
        answer = _run(effort, model, stage, best, allowed)
        if answer.status == "infeasible":
            bound = search.value(best) if best is not None else np.inf
            return outcome("infeasible" if best is None else "optimal")
        bound = max(bound, answer.bound)
        path, lacking = _polished(search, model.path()) if answer.solved else (None, {})
        if path is not None and lacking:
            path = search.dive(path.choice)
        if path is not None and (best is None or search.value(path) < search.value(best)):
            best = path
        if answer.status != "optimal" or not lacking:
            ended = answer.status if answer.status != "optimal" else ended
            break
        cells = cells | lacking.keys()
    return outcome("optimal" if best is not None and within() else ended)


def _run(
    effort: SearchEffort, model: Model, stage: str, best: Candidate | None, allowed: Allowance
) -> backends.BackendResult:
    """Solve a model from the best path, and account for it."""
    if model.impossible:
        return backends.BackendResult("infeasible", False, np.inf, 0.0)
    start, top = perf_counter(), effort.search.value(best) if best is not None else np.inf
    used = effort.used

    def hear(incumbent: float, bound: float, nodes: float) -> str:
        effort.report(stage, min(top, incumbent), bound)
        no_plan = best is None and incumbent == np.inf  # a search that finds nothing may have to end early
        return allowed.limit_reached(None, used + nodes) if no_plan and allowed.spare(None) else ""

    if best is not None:
        model.begin_at(best)
    index = 0 if best is not None and allowed.spare(best) else 1
    nodes, seconds = max(int(allowed.effort[index] - used), 1), allowed.deadline[index] - start
    answer = backends.run(model.lp, effort.options, nodes, seconds, hear)
    effort.add_time("solver", start)
    binaries = sum(z is not None for z in model.z.values())
    sizes = {"rows": model.lp.numConstraints(), "cols": model.lp.numVariables(), "binaries": binaries}
    effort.stats |= {name: max(effort.stats[name], float(size)) for name, size in sizes.items()}
    effort.stats["nodes"] += answer.nodes
    return answer


def _polished(search: PathSearch, path: Candidate) -> tuple[Candidate | None, dict[Key, float]]:
    """Solve again with the facets fixed, so that no big-M and no integer tolerance is left.

    Returns the path and the cells where it lacks clearance.
    """
    for _ in range(MAX_BOOKINGS):
        clean = search.solve(path.choice)
        if clean is None:
            break
        checked = search.look(clean)
        lacking = search.lacking(clean, checked)
        if lacking or search.confirmed(clean, checked):
            return clean, lacking
    return None, {}
