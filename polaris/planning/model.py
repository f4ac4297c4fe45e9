"""The mixed-integer program (eqs. 14-23, corrected) by a back end, lazily.

Disjunctions enter the program when its solution lacks clearance there.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from time import perf_counter

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..model.system import Array
from . import backends
from .effort import Allowance, Effort
from .lp import GrowingLP
from .rows import Key, Rows
from .search import Candidate, PathSearch
from .tree import Outcome

MAX_ROUNDS = 60
MAX_BOOKINGS = 4

Columns = NDArray[np.int_]


class Model:
    """The program at the prices of a search, over some disjunctions.

    Its columns are the input shares either way, the margin variable s, the states at the waypoints, and the
    binaries. The states stay in it although the inputs determine them: the rows are then sparse, which is
    worth more to a branch-and-cut code than fewer columns.

    `cells` are the disjunctions to state; `budget` is a velocity change [m/s] that some optimal path is known
    to keep.
    """

    def __init__(self, search: PathSearch, cells: Collection[Key], budget: float = np.inf) -> None:
        self.search, self.rows, self.budget = search, search.rows, budget
        self.K, self.n, self.N = self.rows.problem.K, self.rows.problem.system.n, self.rows.N
        self.frame = goal_frame(self.rows)
        self.back = np.linalg.inv(self.frame)
        self.cols, self.count = 2 * self.N + 1 + self.K * self.n, 0
        self.entries: list[tuple[Columns, Columns, Array]] = []
        self.sides: list[tuple[Array, Array]] = []
        if np.isfinite(budget):
            self._add(np.arange(2 * self.N), np.r_[self.rows.price, self.rows.price][None], -np.inf, budget)
        self._dynamics()
        goal, unit, last = self.rows.problem.goal.conditions, self.rows.length, self._state(self.K)
        self._add(last, goal.E @ self.back / unit, goal.e / unit, goal.e / unit)
        self._add(last, goal.G @ self.back / unit, -np.inf, goal.g / unit)
        self.z: dict[tuple[Key, int], int | None] = {}
        self.impossible = not all(self._one_of(key) for key in sorted(cells, key=lambda c: (c[1], c[0])))

    def _add(self, columns: Columns, a: Array, lower: ArrayLike, upper: ArrayLike) -> None:
        """Add rows ``lower <= a x[columns] <= upper``, a of shape (R, C)."""
        R, C = a.shape
        at = np.repeat(np.arange(self.count, self.count + R), C)
        self.entries.append((at, np.tile(columns, R), a.ravel()))
        self.sides.append((np.broadcast_to(lower, R), np.broadcast_to(upper, R)))
        self.count += R

    def _state(self, k: int) -> Columns:
        """Columns of the state at waypoint k >= 1."""
        return 2 * self.N + 1 + (k - 1) * self.n + np.arange(self.n)

    def _inputs(self, k: int) -> Columns:
        """Columns of the input shares of step k, either way."""
        m = self.N // self.K
        plus = k * m + np.arange(m)
        return np.concatenate([plus, self.N + plus])

    def _dynamics(self) -> None:
        """States at the waypoints (eq. 14), in units that make them numbers near 1."""
        rows, W = self.rows, self.frame
        A = W @ rows.Ad @ np.linalg.inv(W)
        B = W @ rows.Bd * rows.problem.system.u_max
        here = np.hstack([B, -B, -np.eye(self.n)])
        for k in range(self.K):
            columns = np.r_[self._inputs(k), self._state(k + 1)]
            if k:
                self._add(np.r_[columns, self._state(k)], np.hstack([here, A]), 0.0, 0.0)
            else:
                start = -(A @ W @ rows.problem.x0)
                self._add(columns, here, start, start)

    def _one_of(self, key: Key) -> bool:
        """State one disjunction, with big-M as small as the input limits allow; False if none can hold."""
        rows, search = self.rows, self.search
        options = rows.options(key)
        most = rows.extreme(options.a, self.budget)
        least = -most
        if key[0] < 0:  # the goal's own inequalities bound its rows too
            goal = rows.problem.goal.conditions
            floor = goal_floor(goal.G, goal.g, goal.one_of[key[1]][0]) / rows.length
            least = np.maximum(least, floor[:, None] - options.free)
        big = options.need + options.slope * search.high - least
        can = np.all(most >= options.need + options.slope * search.low - 1e-9, axis=1)
        chosen, k = np.nonzero(can)[0].tolist(), options.at
        need = options.need + (options.free if k else 0.0)
        where = [self._state(k)] if k else []
        where += [self._inputs(k)] if k < self.K else []
        binaries = self.cols + np.arange(len(chosen) if len(chosen) > 1 else 0)
        for j in chosen:
            parts = [options.g[j] @ self.back] if k else []
            parts += [options.h[j], -options.h[j]] if k < self.K else []
            a = np.hstack([*parts, np.full((len(need[j]), 1), -options.slope)])
            columns = np.r_[(*where, 2 * self.N)]
            if not len(binaries):
                self.z[key, j] = None
                self._add(columns, a, need[j], np.inf)
                continue
            z, M, open_ = self.cols, big[j][:, None], big[j] > 0
            self.z[key, j], self.cols = z, z + 1
            self._add(np.r_[columns, z], np.hstack([a, -M])[open_], (need[j] - big[j])[open_], np.inf)
        if len(binaries):
            self._add(binaries, np.ones((1, len(binaries))), 1.0, 1.0)
        return bool(chosen)

    def path(self, x: Array) -> Candidate:
        """A solution as a path."""
        z = x[: self.N] - x[self.N : 2 * self.N]
        choice = {key: j for (key, j), column in self.z.items() if column is None or x[column] > 0.5}
        fuel = float(np.sum(self.rows.price * np.abs(z)))
        return Candidate(z, float(x[2 * self.N]), 0.0, fuel, choice)

    @property
    def binaries(self) -> int:
        """Number of binaries, the last columns."""
        return self.cols - 2 * self.N - 1 - self.K * self.n

    def program(self, start: Candidate | None) -> backends.Program:
        """The matrices, with a path to start from."""
        from scipy.sparse import csr_array

        search, states, binary = self.search, np.full(self.K * self.n, np.inf), np.zeros(self.binaries)
        price, most = np.tile(self.rows.price, 2), np.tile(self.rows.limit, 2)
        at, columns, values = (np.concatenate(parts) for parts in zip(*self.entries, strict=True))
        A = csr_array((values, (at, columns)), shape=(self.count, self.cols))
        A.eliminate_zeros()
        return backends.Program(
            cost=np.r_[price * search.fuel_price, -search.margin_price, np.zeros(len(states)), binary],
            low=np.r_[np.zeros(len(most)), search.low, -states, binary],
            high=np.r_[most, search.high, states, binary + 1],
            A=A,
            lower=np.concatenate([lower for lower, _ in self.sides]),
            upper=np.concatenate([upper for _, upper in self.sides]),
            binaries=self.binaries,
            start=None if start is None else self._point(start),
        )

    def _point(self, path: Candidate) -> Array:
        """A path as a point of the program."""
        x = np.empty(self.cols)
        x[: 2 * self.N + 1] = np.r_[np.maximum(path.z, 0.0), np.maximum(-path.z, 0.0), path.level]
        seen = self.search.look(path)
        x[2 * self.N + 1 : self.cols - self.binaries] = (seen.states[1:] @ self.frame.T).ravel()
        for (key, j), column in self.z.items():
            if column is not None:
                x[column] = j == (path.choice[key] if key in path.choice else self.search.pick(key, seen))
        return x


def goal_frame(rows: Rows) -> Array:
    """Diagonal scaling that makes every entry of the last state a number near 1, shape (n, n)."""
    system = rows.problem.system
    reach = np.abs(rows.state_rows(np.eye(system.n), rows.problem.K)) @ rows.limit
    typical = np.sqrt(
        np.maximum(reach, 1e-9) * np.maximum(np.abs(rows.free[rows.problem.K]), 1e-3 * reach + 1e-9)
    )
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


def by_back_end(effort: Effort, stage: str, best: Candidate | None, allowed: Allowance) -> Outcome:
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
        if stopped := allowed.spent(best, effort.used):
            return outcome(stopped)
        effort.stats["rounds"] += 1
        begun = perf_counter()
        by_fuel = best is not None and search.margin_price == 0
        budget = best.fuel * (1 + 1e-6) + 1e-9 if best is not None and by_fuel else np.inf
        model = Model(search, cells, budget)
        effort.add_time("model", begun)
        answer = _run(effort, model, stage, best, _limits(effort.used, best, allowed))
        if answer.status == "infeasible":
            bound = search.value(best) if best is not None else np.inf
            return outcome("infeasible" if best is None else "optimal")
        bound = max(bound, answer.bound)
        path, lacking = (None, {}) if answer.x is None else _polished(search, model.path(answer.x))
        if path is not None and lacking:
            path = search.dive(path.choice)
        if path is not None and (best is None or search.value(path) < search.value(best)):
            best = path
        if answer.status != "optimal" or not lacking:
            ended = answer.status if answer.status != "optimal" else ended
            break
        cells = cells | lacking.keys()
    return outcome("optimal" if best is not None and within() else ended)


def _limits(used: float, best: Candidate | None, allowed: Allowance) -> backends.Limits:
    """What is allowed, less what is used. A search that finds nothing may have to end early."""
    spare, now = allowed.spare(best), perf_counter()
    nodes, seconds = [most - used for most in allowed.effort], [end - now for end in allowed.deadline]
    which = 0 if spare and best is not None else 1
    limits = backends.Limits(max(int(nodes[which]), 1), seconds[which])
    if spare and best is None:
        return replace(limits, patience_nodes=nodes[0], patience_seconds=seconds[0])
    return limits


def _run(
    effort: Effort, model: Model, stage: str, best: Candidate | None, limits: backends.Limits
) -> backends.Found:
    """Solve a model from the best path, and account for it."""
    if model.impossible:
        return backends.Found("infeasible", None, np.inf, 0.0)
    begun, top = perf_counter(), effort.search.value(best) if best is not None else np.inf

    def listen(incumbent: float, bound: float) -> None:
        effort.report(stage, min(top, incumbent), bound)

    found = backends.run(model.program(best), effort.options, limits, listen)
    effort.add_time("solver", begun)
    sizes = {"rows": model.count, "cols": model.cols, "binaries": model.binaries}
    effort.stats |= {name: max(effort.stats[name], float(size)) for name, size in sizes.items()}
    effort.stats["nodes"] += found.nodes
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
