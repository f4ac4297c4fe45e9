"""Implicit ASIF: the input nearest to the desired one from which S can still take over.

The safe set is implied by the backup controller: the states from which S keeps every limit to the end.
In error coordinates S's flight is linear, so the condition that the state at the next decision is in the
set is a set of linear rows in the input held until then, exact in discrete time: one quadratic program per
decision. Estimate error, disturbance and the path between nodes tighten limits as in the online monitor,
and where no input satisfies all rows S itself flies. That makes it a proof, by the same argument.
"""

import numpy as np

from ...model.checks import positive
from ...model.errors import ScenarioError
from ...model.system import Array
from ...model.tolerances import ROUNDING
from ..decision_grid import DecisionGrid
from ..method import BUFFER, FILTERED, Choice, Method, Observation, Option
from ..permission import ErrorMotion, Permission
from ..projection import FILTERED as SOLVED
from ..projection import project
from ..recovery import Recovery, extended

SLACK = 1e-6  # share of the clearance kept free for what the solver leaves unsatisfied
UNLIMITED = 1e200  # clearance of a row that nothing limits


def _slope(field: str, value: object) -> float:
    """Check the share of the clearance of a row that one decision may use up."""
    if positive(field, value, "") > 1:
        raise ScenarioError(field, value, "must be above 0 and at most 1")
    return float(value)  # type: ignore[arg-type]


class ImplicitASIF(Method):
    """The filter; `NotCertified` if the initial set is not inside the first recoverable set.

    `slope`, above 0 and at most 1, is the share of a row's clearance that one decision may use up: the
    slope of a linear class-K function in discrete time, times the period. Below 1 inputs are bent earlier
    and less; where that leaves none, all of the clearance counts.
    """

    key, name, place, proven = "asif_implicit", "Implicit ASIF", 8, True
    how = "nearest input from which S can still take over, by rows of the recoverable sets, with all errors"
    options = (
        Option(
            "slope",
            "share of the clearance of a row that one decision may use up",
            "1",
            (0.01, 0.1, 1.0),
            check=_slope,
        ),
        BUFFER,
    )
    reach = "state estimate within its error bound"
    reasons = ("desired input", "filtered", "no input is recoverable: S")

    def __init__(self, grid: DecisionGrid, slope: float = 1.0, buffer: float | None = None) -> None:
        super().__init__(grid, buffer)
        self.slope = _slope("slope", slope)
        self.settings["slope"] = self.slope
        self.recovery = Recovery.certified(grid, self.grid)
        before = ErrorMotion.any_thrust(self.recovery) if grid.delay else None
        self.prospect = Permission(self.recovery, before, ErrorMotion.held_input(self.recovery))
        # What an input of full thrust (per axis) held until the next moment of effect adds at its end.
        phi, step = self.recovery.open_flow.phi, self.recovery.open_flow.input_map(grid.system.B)
        moves = [step * grid.system.u_max]
        for _ in range(grid.nodes - 1):
            moves.append(phi @ moves[-1] + moves[0])
        facets = self.recovery.matrix[: len(self.recovery.intersample), :-1]
        none = np.zeros((0, grid.system.m))
        self.inner_moves = np.vstack([none, *(facets @ move for move in moves[:-1])])
        self.rows = self.prospect.demand.tall[:, :-2] @ moves[-1]
        self.row_sums = np.abs(self.rows).sum(axis=1)
        W = grid.tracking.W
        norms = (float(np.linalg.norm(np.abs(W @ move).sum(axis=1))) for move in moves)
        self.push = max(norms) * (1 + ROUNDING)

    def decide(self, observed: Observation) -> Choice:
        """Solve one program for every run whose desired input is not recoverable."""
        grid, recovery, demand = self.grid, self.recovery, self.prospect.demand
        k, R = observed.k, len(observed.estimate)
        node = k * grid.nodes + grid.delay + grid.nodes
        if node > grid.last:
            return Choice(np.zeros(R, dtype=int), np.full(R, -np.inf), np.full(R, 2), observed.desired)
        e = observed.estimate - grid.xi[k * grid.nodes]
        end_error = e @ self.prospect.end.M.T + self.prospect.end.offset[k * grid.nodes]
        size = self.prospect.size(k, e) + self.push
        # The quick bound on far rows counts the tightest limit of all times: if it refuses, rows are exact.
        count = len(demand.tall) if (demand.base + demand.slope * size > 1).any() else demand.near
        rows, largest, first = self.rows[:count], self.row_sums[:count], node * len(recovery.rows)
        window = recovery.reciprocals[first : first + count]
        tightening = extended(end_error, size) @ demand.tall[:count].T
        limit = np.minimum(recovery.window(node)[:count], UNLIMITED)
        slack = SLACK * np.abs(limit)
        limit = limit - slack
        clearance = limit - tightening
        allowed = clearance - self._reserve(k, e, limit)
        desired = observed.desired / grid.system.u_max
        margins = (allowed - desired @ rows.T) * window
        margin, u = margins.min(axis=1), desired.copy()
        infeasible = size > recovery.far(node)
        for run in np.flatnonzero((margin < 0) & ~infeasible):
            for clearances in (allowed, clearance) if self.slope < 1 else (clearance,):
                near = clearances[run] < largest
                answer = project(-rows[None, near], -clearances[None, run, near], desired[None, run], 1.0)
                if answer.status[0] <= SOLVED:
                    u[run] = answer.u[0]
                    break
            else:
                infeasible[run] = True
        # Whatever the solver says, what it found is checked; what cannot be worked out is not met.
        infeasible |= ~(clearance - u @ rows.T >= -slack).all(axis=1)
        infeasible |= ~(self.prospect.inner_share(k, e, size, u @ self.inner_moves.T) <= 1)
        mode = np.where(infeasible, 0, FILTERED)
        reasons = np.where(infeasible, 2, np.where((margin < 0) & (u != desired).any(axis=1), 1, 0))
        return Choice(mode, margin, reasons, u * grid.system.u_max)

    def _reserve(self, k: int, e: Array, limit: Array) -> Array | float:
        """Clearance that this decision must leave, (R, rows): a share of that of S from now on."""
        if self.slope == 1:
            return 0.0
        demand, r = self.prospect.demand, len(self.recovery.rows)
        later = (self.grid.delay + self.grid.nodes) * r  # the same instants, seen from now
        rows = demand.tall[later : later + demand.near]
        size = np.linalg.norm(e @ self.grid.tracking.W.T, axis=1) + self.prospect.radius
        tightening = extended(e, size) @ rows.T
        reserve = np.zeros((len(e), len(limit)))
        reserve[:, : len(rows)] = np.maximum(limit[: len(rows)] - tightening, 0.0)
        return (1 - self.slope) * reserve
