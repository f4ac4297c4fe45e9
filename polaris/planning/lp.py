"""A linear program that grows: HiGHS kept warm while rows come and go.

The mixed-integer program goes through PuLP (`model`); the hundreds of small linear programs of the
path search do not, because they differ by a few rows and the simplex basis carries over.
"""

import os
from functools import cache
from typing import Any

import numpy as np

from ..model.errors import NotCertified
from ..model.system import Array
from ..model.tolerances import SOLVER_FEASIBILITY

ITERATIONS = 1_000_000  # most simplex iterations of one program, hundreds of times more than one takes
FAR = 1e6  # range of what is unlimited: no row of the planner gets as many lengths away from its bound


@cache
def silent_highspy() -> Any:
    """Import HiGHS; its first solver's print to standard output is suppressed.

    From version 1.16 on the constructor prints a licence notice, before it reads any option. C code prints
    it, so that the file descriptor itself is led elsewhere meanwhile.
    """
    import highspy

    try:
        stdout = os.dup(1)
    except OSError:  # standard output is closed
        return highspy
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1)
    try:
        make: Any = highspy.Highs  # its constructor carries no types
        make()
    finally:
        os.dup2(stdout, 1)
        os.close(null)
        os.close(stdout)
    return highspy


class GrowingLP:
    """``min cost x  s.t.  lower <= A x <= upper, low <= x <= high`` with rows added and taken back."""

    def __init__(self, cost: Array, low: Array, high: Array) -> None:
        self._highspy = highspy = silent_highspy()
        self.highs: Any = highspy.Highs()
        self._set(output_flag=False, threads=1, presolve="off", solver="simplex")
        self._set(primal_feasibility_tolerance=SOLVER_FEASIBILITY, simplex_iteration_limit=ITERATIONS)
        n = len(cost)
        empty_i, empty = np.zeros(0, dtype=np.int32), np.zeros(0)
        self.highs.addCols(n, cost, low, high, 0, np.zeros(n, dtype=np.int32), empty_i, empty)
        self._ranges = np.asarray(high - low, dtype=float)
        self._a, self._least, self._slack = [np.zeros((0, n))], [np.zeros(0)], [np.zeros(0)]
        self.rows = 0
        self.out_of_time = False

    def add(self, a: Array, lower: Array | float, upper: Array | float) -> None:
        """Add rows ``lower <= a x <= upper``, a of shape (R, n)."""
        R = len(a)
        if R == 0:
            return
        inf = self._highspy.kHighsInf
        low = np.clip(np.broadcast_to(np.asarray(lower, dtype=float), (R,)), -inf, inf)
        high = np.clip(np.broadcast_to(np.asarray(upper, dtype=float), (R,)), -inf, inf)
        entries = np.nonzero(a)
        starts = np.searchsorted(entries[0], np.arange(R)).astype(np.int32)
        self.highs.addRows(R, low, high, len(entries[0]), starts, entries[1].astype(np.int32), a[entries])
        self._a.append(a)
        self._least.append(low)
        self._slack.append(high - low)
        self.rows += R

    def take_back(self, rows: int) -> None:
        """Remove every row but the first `rows`, which must end where a block of `add` ended."""
        drop = np.arange(rows, self.rows, dtype=np.int32)
        if len(drop):
            self.highs.deleteRows(len(drop), drop)
        while self.rows > rows:
            self.rows -= len(self._a.pop())
            self._least.pop()
            self._slack.pop()

    def price(self, first: int, cost: Array) -> None:
        """Change the costs of consecutive columns."""
        columns = np.arange(first, first + len(cost), dtype=np.int32)
        self.highs.changeColsCost(len(cost), columns, cost)

    def limit(self, first: int, low: Array, high: Array) -> None:
        """Change the bounds of consecutive columns."""
        columns = np.arange(first, first + len(low), dtype=np.int32)
        self.highs.changeColsBounds(len(low), columns, low, high)
        self._ranges[columns] = high - low

    def basis(self) -> Any:
        """The simplex basis as it stands, to be given back to `use`."""
        return self.highs.getBasis()

    def use(self, basis: Any) -> None:
        """Start the next solve from a basis taken when the same rows were in place; more may follow."""
        if len(basis.row_status) == self.rows:
            self.highs.setBasis(basis)

    def solve(self, seconds: float) -> tuple[float, Array] | None:
        """Optimal value and point, or None where there is none, or no time (then `out_of_time` is set)."""
        status, kind = self._run(seconds), self._highspy.HighsModelStatus
        if status not in (kind.kOptimal, kind.kInfeasible, kind.kTimeLimit):
            # a stale basis, pivoting once made stricter or huge costs can leave the simplex stuck: once more
            # in a solver of its own, costs near 1, then bounds, too
            stuck, self.highs = self.highs, type(self.highs)()
            self.highs.passOptions(stuck.getOptions())
            self.highs.passModel(stuck.getLp())
            largest = max(np.abs(stuck.getLp().col_cost_).max(), 1.0)
            scaled = {"presolve": "on", "user_objective_scale": -int(np.log2(largest))}
            ends = np.abs([*stuck.getLp().col_lower_, *stuck.getLp().col_upper_])
            widest = max(np.max(ends[np.isfinite(ends)], initial=1.0), 1.0)
            for scaling in (scaled, scaled | {"user_bound_scale": -int(np.log2(widest))}):
                self._set(**scaling)
                status = self._run(seconds)
                self._set(presolve="off", user_objective_scale=0, user_bound_scale=0)
                if status in (kind.kOptimal, kind.kInfeasible, kind.kTimeLimit):
                    break
        if status == kind.kOptimal:
            return float(self.highs.getObjectiveValue()), np.array(self.highs.getSolution().col_value)
        self.out_of_time = status == kind.kTimeLimit
        if self.out_of_time or status in (kind.kInfeasible, kind.kUnboundedOrInfeasible):
            return None
        raise NotCertified(f"a linear program of the planner ended without a solution ({status})")

    def _set(self, **options: Any) -> None:
        for name, value in options.items():
            self.highs.setOptionValue(name, value)

    def _run(self, seconds: float) -> Any:
        self._set(time_limit=self.highs.getRunTime() + max(seconds, 0.01))
        self.highs.run()
        return self.highs.getModelStatus()

    def constraints(self) -> tuple[Array, Array]:
        """The rows as they stand, shape (R, n), and the least that each must come to, shape (R,)."""
        return np.vstack(self._a), np.concatenate(self._least)

    def ray(self) -> Array:
        """Return weights of rows, (R,), that prove the program just solved infeasible; zeros if not known."""
        has_ray, weights = self.highs.getDualRay()[1:]
        return np.asarray(weights, dtype=float) if has_ray else np.zeros(self.rows)

    def costs(self, a: Array, shortfall: Array) -> Array:
        """Lower bounds, shape (J,), on the loss of the optimum if one more row has to hold, without solving.

        At the optimum just found every variable and slack that is not basic can only move into the
        program, at its reduced cost. Written over these, a new row ``a x >= need`` needs a certain amount of
        movement; the cheapest way to pay for it is a continuous knapsack. What it leaves out are the
        bounds of the basic variables, so the true cost is the same or higher.

        Each row of a, shape (J, n), stands on its own and lacks ``need - a x``. The bound is infinite where
        no movement is enough.
        """
        basis, point = self.highs.getBasis(), self.highs.getSolution()
        status = self._highspy.HighsBasisStatus
        basic, upper = int(status.kBasic), int(status.kUpper)
        columns, rows = (np.array([int(s) for s in side]) for side in (basis.col_status, basis.row_status))
        idle, tight = columns != basic, rows != basic
        A = np.vstack(self._a)[tight]
        lead = _solve(A[:, ~idle].T, a[:, ~idle].T)
        if lead is None:
            return np.zeros(len(a))
        sign = np.where(np.r_[columns[idle], rows[tight]] == upper, -1.0, 1.0)
        ranges = np.minimum(np.r_[self._ranges[idle], np.concatenate(self._slack)[tight]], FAR)
        gain = np.maximum(np.hstack([a[:, idle] - lead.T @ A[:, idle], lead.T]) * sign, 0.0)
        price = np.r_[np.array(point.col_dual)[idle], np.array(point.row_dual)[tight]] * sign
        rate = np.divide(np.maximum(price, 0.0), gain, out=np.zeros(gain.shape), where=gain > 0)
        order = np.argsort(rate, axis=1)
        steps = np.take_along_axis(gain * ranges, order, axis=1)
        reached = np.cumsum(steps, axis=1)
        paid = np.clip(shortfall[:, None] - (reached - steps), 0.0, steps)
        cost = np.sum(paid * np.take_along_axis(rate, order, axis=1), axis=1)
        return np.where(reached[:, -1] < shortfall * (1 - 1e-6) - 1e-6, np.inf, cost)


def _solve(M: Array, b: Array) -> Array | None:
    """Solution of ``M x = b``, or None where M is not square or too close to singular to trust it."""
    try:
        x = np.linalg.solve(M, b)
    except np.linalg.LinAlgError:
        return None
    error, size = np.max(np.abs(M @ x - b), initial=0.0), np.max(np.abs(b), initial=1.0)
    return np.asarray(x) if error <= 1e-9 * size else None
