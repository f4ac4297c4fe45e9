"""The mixed-integer program (eqs. 14-23, corrected), written in PuLP and solved by HiGHS or Gurobi."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np

from ..system import Array
from .lp import GrowingLP
from .problem import PlannerOptions
from .rows import Rows
from .search import Candidate, Cell, Levels


@dataclass(eq=False)
class Answer:
    """What the back end returned.

    Attributes
    ----------
    status : str
        "optimal", "infeasible" or "time".
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


@dataclass(frozen=True, eq=False)
class Task:
    """One program: what is minimised and which cells are constrained.

    Attributes
    ----------
    cells : frozenset of (int, int)
        Constrained cells, as (unsafe set, cell).
    fuel, margin : float
        Prices of velocity change [1/(m/s)] and of missing margin.
    levels : Levels
        Range of the margin variable.
    budget : float
        Upper bound on the velocity change [m/s].
    one_of : bool
        Whether to state the disjunctions of the goal (left out while the relaxation meets them).
    decided : tuple or None
        Facets per cell and sides of the goal that are decided already; no binary is left then.
    """

    cells: frozenset[Cell]
    fuel: float = 1.0
    margin: float = 0.0
    levels: Levels = Levels(0.0, 0.0)
    budget: float = np.inf
    one_of: bool = True
    decided: tuple[dict[Cell, int], tuple[int, ...]] | None = None


class Model:
    """The PuLP model of one `Task`."""

    def __init__(self, rows: Rows, task: Task, reachable: Callable[[int, int, int], bool]) -> None:
        import pulp

        self.pulp, self.rows, self.task = pulp, rows, task
        self.lp: Any = pulp.LpProblem("reference", pulp.LpMinimize)
        K, m, n = rows.problem.K, rows.problem.system.m, rows.problem.system.n
        up = rows.limit.tolist()
        self.plus = [self._new(f"p{j // m}_{j % m}", 0.0, up[j]) for j in range(rows.N)]
        self.minus = [self._new(f"m{j // m}_{j % m}", 0.0, up[j]) for j in range(rows.N)]
        self.s = self._new("s", task.levels.low, task.levels.high)
        self.frame = goal_frame(rows)
        self.x = [[self._new(f"x{k}_{i}", None, None) for i in range(n)] for k in range(1, K + 1)]
        self.xK = self.x[-1]
        self.inputs = self.plus + self.minus
        price = np.r_[rows.price, rows.price] * task.fuel
        self.lp.setObjective(self._sum(self.inputs, price) + self._sum([self.s], np.array([-task.margin])))
        self.z: dict[tuple[int, int, int], Any] = {}
        self.sides: list[list[Any]] = []
        self.impossible: Cell | None = None
        if np.isfinite(task.budget):
            self.lp += self._sum(self.inputs, np.r_[rows.price, rows.price]) <= task.budget
        self._dynamics(K, m)
        self._goal(K)
        for cell in sorted(task.cells, key=lambda c: (c[1], c[0])):
            self._cell(cell, reachable)

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

    def _at(self, k: int, g: Array, h: Array) -> tuple[Any, float]:
        """Expression and constant of ``g x_k + h z_k``, rows as `Rows.local` returns them."""
        K, m = self.rows.problem.K, self.rows.problem.system.m
        if k == 0:
            where, constant = self._sum([], np.zeros(0)), float(g @ self.rows.problem.x0)
        else:
            where, constant = self._sum(self.x[min(k, K) - 1], g @ np.linalg.inv(self.frame)), 0.0
        if k < K:
            inputs = self.plus[k * m : (k + 1) * m] + self.minus[k * m : (k + 1) * m]
            where = where + self._sum(inputs, np.r_[h, -h])
        return where, constant

    def _goal(self, K: int) -> None:
        rows, goal = self.rows, self.rows.problem.goal.conditions
        back = np.linalg.inv(self.frame)
        for g, rhs in zip(goal.E @ back / rows.length, goal.e / rows.length, strict=True):
            self.lp += self._sum(self.xK, g) == float(rhs)
        for g, rhs in zip(goal.G @ back / rows.length, goal.g / rows.length, strict=True):
            self.lp += self._sum(self.xK, g) <= float(rhs)
        if self.task.decided is not None:
            for (N, c), side in zip(goal.one_of, self.task.decided[1], strict=False):
                if side >= 0:
                    g = N[side] @ back / rows.length
                    self.lp += self._sum(self.xK, g) >= float(c[side] / rows.length)
        for group, (N, c) in enumerate(goal.one_of if self.task.one_of else ()):
            binaries = [self._new(f"goal{group}_{j}", 0.0, 1.0, binary=True) for j in range(len(N))]
            # every row is bounded below by the goal's own inequalities or by the thrust limits
            floor = -rows.extreme(rows.state_rows(-N, K), self.task.budget) + N @ rows.free[K]
            floor = np.maximum(floor, goal_floor(goal.G, goal.g, N))
            big = np.maximum((c - floor) / rows.length, 0.0)
            for j, g in enumerate(N @ back / rows.length):
                self.lp += self._sum([*self.xK, binaries[j]], np.r_[g, -big[j]]) >= float(
                    c[j] / rows.length - big[j]
                )
            self.lp += self.pulp.lpSum(binaries) >= 1
            self.sides.append(binaries)

    def _cell(self, cell: Cell, reachable: Callable[[int, int, int], bool]) -> None:
        i, k = cell
        rows, task = self.rows, self.task
        options = []
        facets = (
            range(len(rows.problem.unsafe[i].normals)) if task.decided is None else [task.decided[0][cell]]
        )
        for f in facets:
            part = rows.cell(i, k, f)
            if task.decided is not None:
                options.append((f, part, np.full(len(part.need), 1e3)))
                continue
            most = rows.extreme(part.a, task.budget)
            need = part.need + part.slope * task.levels.low
            if np.all(most >= need - 1e-9) and reachable(i, k, f):
                options.append((f, part, part.need + part.slope * task.levels.high + most))
        if not options:
            self.impossible = cell
            return
        binaries = []
        for f, part, big in options:
            only = len(options) == 1
            if not only:
                self.z[(i, k, f)] = self._new(f"z{i}_{k}_{f}", 0.0, 1.0, binary=True)
                binaries.append(self.z[(i, k, f)])
            else:
                self.z[(i, k, f)] = None
            for g, h, rhs, M in zip(*rows.local(i, k, f), big, strict=True):
                if M <= 0 and not only:
                    continue
                row, constant = self._at(k, g, h)
                need = rhs - constant
                row = row + self._sum([self.s], np.array([-part.slope]))
                if only:
                    self.lp += row >= float(need)
                else:
                    self.lp += row - float(M) * binaries[-1] >= float(need - M)
        if binaries:
            self.lp += self.pulp.lpSum(binaries) == 1

    def solve(
        self,
        options: PlannerOptions,
        seconds: float,
        start: Candidate | None = None,
        listen: Callable[[float, float], None] | None = None,
    ) -> Answer:
        """Run the back end, from a start if there is one."""
        from . import backends

        if self.impossible is not None:
            return Answer("infeasible", None, np.inf, np.inf, {})
        if start is not None:
            self._warm(start)
        begun = perf_counter()
        status, bound, nodes = backends.run(self.lp, options, seconds, start is not None, listen)
        stats = {
            "rows": float(self.lp.numConstraints()),
            "cols": float(self.lp.numVariables()),
            "binaries": float(sum(v is not None for v in self.z.values()) + sum(map(len, self.sides))),
            "nodes": nodes,
            "solver_seconds": perf_counter() - begun,
        }
        if status in ("infeasible", "none"):
            return Answer("infeasible" if status == "infeasible" else "time", None, np.inf, bound, stats)
        z = np.array(
            [(p.varValue or 0.0) - (q.varValue or 0.0) for p, q in zip(self.plus, self.minus, strict=True)]
        )
        choice = {}
        for (i, k, f), var in self.z.items():
            if var is None or var.varValue > 0.5:
                choice[(i, k)] = f
        sides = tuple(int(np.argmax([v.varValue for v in group])) for group in self.sides)
        fuel = float(np.sum(self.rows.price * np.abs(z)))
        # PuLP leaves variables that no row mentions without a value
        level = self.task.levels.high if self.s.varValue is None else float(self.s.varValue)
        path = Candidate(z, level, 0.0, fuel, choice, sides)
        return Answer(status, path, float(self.lp.objective.value()), bound, stats)

    def _warm(self, path: Candidate) -> None:
        for j, value in enumerate(path.z):
            self.plus[j].setInitialValue(max(float(value), 0.0), check=False)
            self.minus[j].setInitialValue(max(-float(value), 0.0), check=False)
        self.s.setInitialValue(path.level, check=False)
        for (i, k, f), var in self.z.items():
            if var is not None and (i, k) in path.choice:
                var.setInitialValue(float(path.choice[(i, k)] == f), check=False)
        states = self.rows.trajectory(path.z)[0]
        last = states[self.rows.problem.K]
        for variables, state in zip(self.x, states[1:] @ self.frame.T, strict=False):
            for var, value in zip(variables, state, strict=True):
                var.setInitialValue(float(value), check=False)
        for (N, c), group in zip(self.rows.problem.goal.conditions.one_of, self.sides, strict=False):
            side = int(np.argmax(N @ last - c))
            for j, var in enumerate(group):
                var.setInitialValue(float(j == side), check=False)


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
            answer = lp.solve(1.0)
            if answer is not None:
                out[j] = answer[0]
    return out
