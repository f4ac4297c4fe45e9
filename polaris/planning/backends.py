"""A mixed-integer program as matrices, and two back ends in process that solve it: HiGHS and Gurobi.

Both have the same limits and tolerances, and start from a point if there is one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np

from ..model.errors import ScenarioError
from ..model.system import Array
from ..model.tolerances import SOLVER_FEASIBILITY
from .problem import PlannerOptions

Listen = Callable[[float, float], None]


@dataclass(frozen=True, eq=False)
class Program:
    """``min cost x  s.t.  lower <= A x <= upper, low <= x <= high``, the last columns binary.

    Attributes
    ----------
    cost, low, high : ndarray, shape (n,)
    A : scipy.sparse.csr_array, shape (R, n)
    lower, upper : ndarray, shape (R,)
    binaries : int
        Number of binary columns.
    start : ndarray, shape (n,), or None
        A point to start from.
    """

    cost: Array
    low: Array
    high: Array
    A: Any
    lower: Array
    upper: Array
    binaries: int
    start: Array | None


@dataclass(frozen=True, eq=False)
class Found:
    """Answer of a back end: solution x, if any; proven lower bound on the objective; nodes searched.

    Its status is "optimal", "infeasible", or what stopped it ("effort_limit" of nodes, or "time_limit").
    """

    status: str
    x: Array | None
    bound: float
    nodes: float


@dataclass(frozen=True)
class Limits:
    """How long a back end may search: nodes, and wall time [s] as the last resort.

    Its patience is the same while it has found nothing.
    """

    nodes: int
    seconds: float
    patience_nodes: float = np.inf
    patience_seconds: float = np.inf

    def given_up(self, found: bool, nodes: float, seconds: float) -> str:
        """Why to stop a search that has found nothing, or an empty string."""
        if found:
            return ""
        if nodes >= self.patience_nodes:
            return "effort_limit"
        return "time_limit" if seconds >= self.patience_seconds else ""


def require(solver: str) -> None:
    """Refuse a back end that is not installed."""
    if solver == "gurobi" and find_spec("gurobipy") is None:
        rule = "needs the package gurobipy: install the extra 'gurobi', or use another solver"
        raise ScenarioError("planner.solver", "gurobi", rule)


def run(program: Program, options: PlannerOptions, limits: Limits, listen: Listen) -> Found:
    """Solve a program; `listen` is told the incumbent and the bound."""
    solve = _gurobi if options.solver == "gurobi" else _highs
    return solve(program, options, limits, listen)


def _highs(program: Program, options: PlannerOptions, limits: Limits, listen: Listen) -> Found:
    import highspy

    make: Any = highspy.Highs  # its constructor carries no types
    model, kind, gave_up = make(), highspy.HighsModelStatus, [""]
    settings = {
        "output_flag": False,
        "threads": options.threads,
        "time_limit": max(limits.seconds, 0.05),
        "mip_rel_gap": options.gap / 2,
        "mip_max_nodes": limits.nodes,
        "primal_feasibility_tolerance": SOLVER_FEASIBILITY,
        "mip_feasibility_tolerance": SOLVER_FEASIBILITY,
    }
    for name, value in settings.items():
        if value is not None:
            model.setOptionValue(name, value)
    (R, n), none = program.A.shape, np.zeros(0, dtype=np.int32)
    model.addCols(
        n, program.cost, program.low, program.high, 0, np.zeros(n, dtype=np.int32), none, np.zeros(0)
    )
    A = program.A
    model.addRows(R, program.lower, program.upper, A.nnz, A.indptr[:-1], A.indices, A.data)
    if count := program.binaries:
        whole = np.full(count, highspy.HighsVarType.kInteger)
        model.changeColsIntegrality(count, np.arange(n - count, n, dtype=np.int32), whole)
    if program.start is not None:
        model.setSolution(n, np.arange(n, dtype=np.int32), program.start)

    def hear(what: Any, message: str, data: Any, answer: Any, user: Any) -> None:
        listen(data.mip_primal_bound, data.mip_dual_bound)
        found = bool(data.mip_primal_bound < highspy.kHighsInf)
        gave_up[0] = limits.given_up(found, data.mip_node_count, data.running_time) or gave_up[0]
        answer.user_interrupt = bool(gave_up[0])

    model.setCallback(hear, None)
    model.startCallback(highspy.cb.HighsCallbackType.kCallbackMipInterrupt)
    model.run()
    status, info = model.getModelStatus(), model.getInfo()
    bound, nodes = float(info.mip_dual_bound), float(max(info.mip_node_count, 0))
    if not np.isfinite(bound) or info.mip_node_count < 0:
        bound = float(info.objective_function_value) if status == kind.kOptimal else -np.inf
    if status in (kind.kInfeasible, kind.kUnboundedOrInfeasible):
        return Found("infeasible", None, np.inf, nodes)
    solved = info.primal_solution_status == 2  # kSolutionStatusFeasible
    x = np.array(model.getSolution().col_value) if solved else None
    ended = "time_limit" if status == kind.kTimeLimit else "effort_limit"
    return Found("optimal" if status == kind.kOptimal else gave_up[0] or ended, x, bound, nodes)


def _gurobi(program: Program, options: PlannerOptions, limits: Limits, listen: Listen) -> Found:
    import gurobipy as gp

    grb, gave_up = gp.GRB, [""]

    def hear(model: Any, where: int) -> None:
        if where != grb.Callback.MIP:
            return
        asked = ("MIP_OBJBST", "MIP_OBJBND", "MIP_NODCNT", "RUNTIME")
        best, bound, nodes, seconds = (model.cbGet(getattr(grb.Callback, what)) for what in asked)
        listen(best, bound)
        gave_up[0] = limits.given_up(best < grb.INFINITY, nodes, seconds) or gave_up[0]
        if gave_up[0]:
            model.terminate()

    settings = {
        "TimeLimit": max(limits.seconds, 0.05),
        "MIPGap": options.gap / 2,
        "NodeLimit": limits.nodes,
        "FeasibilityTol": SOLVER_FEASIBILITY,
        "IntFeasTol": SOLVER_FEASIBILITY,
        "Threads": 0 if options.threads is None else options.threads,
    }
    try:
        # an environment of its own: the default one writes its licence to standard output
        with gp.Env(params={"OutputFlag": 0}) as env, gp.Model(env=env) as model:
            for name, value in settings.items():
                model.setParam(name, value)
            count = len(program.cost)
            types = [grb.CONTINUOUS] * (count - program.binaries) + [grb.BINARY] * program.binaries
            x = model.addMVar(count, program.low, program.high, program.cost, types)
            least = np.isfinite(program.lower)
            sense = np.where(program.lower == program.upper, "=", np.where(least, ">", "<"))
            model.addMConstr(program.A, x, sense, np.where(least, program.lower, program.upper))
            if program.start is not None:
                x.Start = program.start
            model.optimize(hear)
            return _gurobi_answer(model, x, grb, gave_up[0])
    except gp.GurobiError as error:
        rule = f"Gurobi refused the model ({error}); use another solver, or a licence without size limit"
        raise ScenarioError("planner.solver", "gurobi", rule) from error


def _gurobi_answer(model: Any, x: Any, grb: Any, gave_up: str) -> Found:
    nodes = float(model.NodeCount) if model.IsMIP else 0.0
    if model.Status in (grb.INFEASIBLE, grb.INF_OR_UNBD):
        return Found("infeasible", None, np.inf, nodes)
    optimal, solved = model.Status == grb.OPTIMAL, model.SolCount > 0
    bound = float(model.ObjBound) if model.IsMIP else float(model.ObjVal) if optimal else -np.inf
    ended = "time_limit" if model.Status == grb.TIME_LIMIT else "effort_limit"
    status = "optimal" if optimal else gave_up or ended
    return Found(status, np.array(x.X) if solved else None, bound, nodes)
