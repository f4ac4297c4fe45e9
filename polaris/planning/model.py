"""The mixed-integer program (eqs. 14-23, corrected), written in PuLP and solved by HiGHS or Gurobi."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..model.system import Array
from . import backends
from .lp import GrowingLP
from .problem import PlannerOptions
from .rows import Key, Rows
from .search import Candidate, PathSearch


@dataclass(eq=False)
class Answer:
    """What the back end returned.

    Attributes
    ----------
    status : str
        "optimal", "infeasible", "effort_limit" or "time_limit".
    path : Candidate or None
        Best solution, if any.
    value, bound : float
        Objective and proven bound, in the sense of minimisation.
    stats : dict
        Sizes and nodes.
    """

    status: str
    path: Candidate | None
    value: float
    bound: float
    stats: dict[str, float]


class Model:
    """The PuLP model of the program at the prices of a search, over some disjunctions.

    `cells` are the disjunctions to state; `budget` is a velocity change [m/s] that some optimal path is known
    to keep.
    """

    def __init__(self, search: PathSearch, cells: Collection[Key], budget: float = np.inf) -> None:
        import pulp

        self.pulp, self.search, self.rows, self.levels = pulp, search, search.rows, search.levels
        self.lp: Any = pulp.LpProblem("reference", pulp.LpMinimize)
        rows, system = self.rows, search.rows.problem.system
        up, m = rows.limit.tolist(), system.m
        self.plus = [self._new(f"p{j // m}_{j % m}", 0.0, up[j]) for j in range(rows.N)]
        self.minus = [self._new(f"m{j // m}_{j % m}", 0.0, up[j]) for j in range(rows.N)]
        self.s = self._new("s", self.levels.low, self.levels.high)
        self.frame = goal_frame(rows)
        self.back = np.linalg.inv(self.frame)
        K = rows.problem.K
        self.x = [[self._new(f"x{k}_{i}", None, None) for i in range(system.n)] for k in range(1, K + 1)]
        inputs, price, self.budget = self.plus + self.minus, np.r_[rows.price, rows.price], budget
        self.lp.setObjective(
            self._sum(inputs, price * search.fuel_price)
            + self._sum([self.s], np.array([-search.margin_price]))
        )
        if np.isfinite(budget):
            self.lp += self._sum(inputs, price) <= budget
        self._dynamics(K, m)
        self._goal()
        self.z: dict[tuple[Key, int], Any] = {}
        self.impossible = not all(self._one_of(key) for key in sorted(cells, key=lambda c: (c[1], c[0])))

    def _new(self, name: str, low: float | None, high: float | None, binary: bool = False) -> Any:
        add = getattr(self.lp, "add_variable", None)  # PuLP before 3.3 has only the constructor
        make = add if add is not None else self.pulp.LpVariable
        return make(name, low, high, cat="Binary" if binary else "Continuous")

    def _sum(self, variables: Iterable[Any], weights: Array) -> Any:
        return self.pulp.LpAffineExpression(
            [(v, w) for v, w in zip(variables, weights.tolist(), strict=True) if w != 0.0]
        )

    def _dynamics(self, K: int, m: int) -> None:
        """States at the waypoints (eq. 14), in units that make them numbers near 1.

        They stay in the model although the inputs determine them: the rows are then sparse, which is
        worth more to a branch-and-cut code than fewer columns.
        """
        rows, W = self.rows, self.frame
        A = W @ rows.Ad @ np.linalg.inv(W)
        B = W @ rows.Bd * rows.problem.system.u_max
        start = A @ W @ rows.problem.x0
        for k in range(K):
            inputs = self.plus[k * m : (k + 1) * m] + self.minus[k * m : (k + 1) * m]
            for i, state in enumerate(self.x[k]):
                row = self._sum(inputs, np.r_[B[i], -B[i]]) - state
                if k:
                    self.lp += row + self._sum(self.x[k - 1], A[i]) == 0.0
                else:
                    self.lp += row == -float(start[i])

    def _at(self, k: int, g: Array, h: Array) -> Any:
        """Expression ``g x_k + h z_k`` without its constant, rows as in `Options`."""
        K, m = self.rows.problem.K, self.rows.problem.system.m
        where = self._sum(self.x[k - 1], g @ self.back) if k else self._sum([], np.zeros(0))
        if k < K:
            inputs = self.plus[k * m : (k + 1) * m] + self.minus[k * m : (k + 1) * m]
            where = where + self._sum(inputs, np.r_[h, -h])
        return where

    def _goal(self) -> None:
        goal, unit = self.rows.problem.goal.conditions, self.rows.length
        for g, rhs in zip(goal.E @ self.back / unit, goal.e / unit, strict=True):
            self.lp += self._sum(self.x[-1], g) == float(rhs)
        for g, rhs in zip(goal.G @ self.back / unit, goal.g / unit, strict=True):
            self.lp += self._sum(self.x[-1], g) <= float(rhs)

    def _one_of(self, key: Key) -> bool:
        """State one disjunction, with big-M as small as the input limits allow; False if none can hold."""
        rows, levels = self.rows, self.levels
        options = rows.options(key)
        most = rows.extreme(options.a, self.budget)
        least = -most
        if key[0] < 0:  # the goal's own inequalities bound its rows too
            goal = rows.problem.goal.conditions
            floor = goal_floor(goal.G, goal.g, goal.one_of[key[1]][0]) / rows.length
            least = np.maximum(least, floor[:, None] - options.free)
        big = options.need + options.slope * levels.high - least
        can = np.all(most >= options.need + options.slope * levels.low - 1e-9, axis=1)
        chosen = np.nonzero(can)[0].tolist()
        binaries = []
        for j in chosen:
            z = self._new(f"z{key[0] + 1}_{key[1]}_{j}", 0.0, 1.0, binary=True) if len(chosen) > 1 else None
            self.z[key, j] = z
            binaries += [z] if z is not None else []
            for r, M in enumerate(big[j].tolist()):
                if M <= 0 and z is not None:
                    continue
                need = float(options.need[j, r] + (options.free[j, r] if options.at else 0.0))
                row = self._at(options.at, options.g[j, r], options.h[j, r])
                row = row + self._sum([self.s], np.array([-options.slope]))
                self.lp += row >= need if z is None else row - M * z >= need - M
        if binaries:
            self.lp += self.pulp.lpSum(binaries) == 1
        return bool(chosen)

    def solve(
        self,
        options: PlannerOptions,
        limits: backends.Limits,
        start: Candidate | None = None,
        listen: Callable[[float, float], None] | None = None,
    ) -> Answer:
        """Run the back end, from a start if there is one."""
        if self.impossible:
            return Answer("infeasible", None, np.inf, np.inf, {"nodes": 0.0})
        if start is not None:
            self._warm(start)
        status, solved, bound, nodes = backends.run(self.lp, options, limits, start is not None, listen)
        stats = {
            "rows": float(self.lp.numConstraints()),
            "cols": float(self.lp.numVariables()),
            "binaries": float(sum(v is not None for v in self.z.values())),
            "nodes": nodes,
        }
        if not solved:
            return Answer(status, None, np.inf, bound, stats)
        z = np.array(
            [(p.varValue or 0.0) - (q.varValue or 0.0) for p, q in zip(self.plus, self.minus, strict=True)]
        )
        choice = {key: j for (key, j), var in self.z.items() if var is None or var.varValue > 0.5}
        fuel = float(np.sum(self.rows.price * np.abs(z)))
        # PuLP leaves variables that no row mentions without a value
        level = self.levels.high if self.s.varValue is None else float(self.s.varValue)
        path = Candidate(z, level, 0.0, fuel, choice)
        return Answer(status, path, float(self.lp.objective.value()), bound, stats)

    def _warm(self, path: Candidate) -> None:
        for j, value in enumerate(path.z):
            self.plus[j].setInitialValue(max(float(value), 0.0), check=False)
            self.minus[j].setInitialValue(max(-float(value), 0.0), check=False)
        self.s.setInitialValue(path.level, check=False)
        for (key, j), var in self.z.items():
            if var is not None and key in path.choice:
                var.setInitialValue(float(path.choice[key] == j), check=False)
        states = self.search.look(path).states[1:] @ self.frame.T
        for variables, state in zip(self.x, states, strict=True):
            for var, value in zip(variables, state, strict=True):
                var.setInitialValue(float(value), check=False)


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
