"""A linear program that grows: HiGHS kept warm while rows come and go.

The mixed-integer program goes through PuLP (`model`); the hundreds of small linear programs of the
path search do not, because they differ by a few rows and the simplex basis carries over.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import NotCertified
from ..system import Array
from ..tolerances import SOLVER_FEASIBILITY


class GrowingLP:
    """``min cost x  s.t.  lower <= A x <= upper, low <= x <= high`` with rows added and taken back.

    Parameters
    ----------
    cost, low, high : ndarray, shape (n,)
    """

    def __init__(self, cost: Array, low: Array, high: Array) -> None:
        import highspy

        self._highspy = highspy
        make: Any = highspy.Highs  # its constructor carries no types
        self.highs: Any = make()
        self.highs.setOptionValue("output_flag", False)
        self.highs.setOptionValue("threads", 1)
        self.highs.setOptionValue("presolve", "off")
        self.highs.setOptionValue("solver", "simplex")
        self.highs.setOptionValue("primal_feasibility_tolerance", SOLVER_FEASIBILITY)
        n = len(cost)
        empty_i, empty = np.zeros(0, dtype=np.int32), np.zeros(0)
        self.highs.addCols(n, cost, low, high, 0, np.zeros(n, dtype=np.int32), empty_i, empty)
        self.n = n
        self.rows = 0
        self.solves = 0

    def add(self, a: Array, lower: Array | float, upper: Array | float) -> None:
        """Add rows ``lower <= a x <= upper``, a of shape (R, n)."""
        a = np.atleast_2d(a)
        R = len(a)
        if R == 0:
            return
        inf = self._highspy.kHighsInf
        lo = np.clip(np.broadcast_to(np.asarray(lower, dtype=float), (R,)), -inf, inf).copy()
        up = np.clip(np.broadcast_to(np.asarray(upper, dtype=float), (R,)), -inf, inf).copy()
        where = np.nonzero(a)
        starts = np.searchsorted(where[0], np.arange(R)).astype(np.int32)
        self.highs.addRows(R, lo, up, len(where[0]), starts, where[1].astype(np.int32), a[where])
        self.rows += R

    def take_back(self, rows: int) -> None:
        """Remove every row but the first `rows`."""
        if self.rows > rows:
            drop = np.arange(rows, self.rows, dtype=np.int32)
            self.highs.deleteRows(len(drop), drop)
            self.rows = rows

    def change(self, column: int, cost: float, low: float, high: float) -> None:
        """Change cost and bounds of one column."""
        self.highs.changeColCost(column, cost)
        self.highs.changeColBounds(column, low, high)

    def basis(self) -> Any:
        """The simplex basis as it stands, to be given back to `use`."""
        return self.highs.getBasis()

    def use(self, basis: Any) -> None:
        """Start the next solve from a basis taken when the same rows were in place."""
        if len(basis.row_status) == self.rows:
            self.highs.setBasis(basis)

    def solve(self, seconds: float) -> tuple[float, Array] | None:
        """Optimal value and point, or None where there is none (or no time)."""
        status, kind = self._run(seconds), self._highspy.HighsModelStatus
        if status not in (kind.kOptimal, kind.kInfeasible, kind.kTimeLimit):
            # a stale basis can leave the simplex method stuck: once more from scratch
            self.highs.clearSolver()
            self.highs.setOptionValue("presolve", "on")
            status = self._run(seconds)
            self.highs.setOptionValue("presolve", "off")
        if status == kind.kOptimal:
            return float(self.highs.getObjectiveValue()), np.array(self.highs.getSolution().col_value)
        if status in (kind.kInfeasible, kind.kUnboundedOrInfeasible, kind.kTimeLimit):
            return None
        raise NotCertified(f"a linear program of the planner ended without an answer ({status})")

    def _run(self, seconds: float) -> Any:
        self.highs.setOptionValue("time_limit", self.highs.getRunTime() + max(seconds, 0.01))
        self.highs.run()
        self.solves += 1
        return self.highs.getModelStatus()
