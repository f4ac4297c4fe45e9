"""Two back ends of PuLP, in process: HiGHS with a warm start, and Gurobi; same limits and tolerances."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import count
from typing import Any

import numpy as np

from reach.numerics.packages import unusable

from ..model.errors import ScenarioError
from ..model.tolerances import SOLVER_FEASIBILITY
from .lp import silent_highspy
from .problem import PlannerOptions

Hear = Callable[[float, float, float], str]
"""Told incumbent (infinite while there is none), bound and nodes; answers why to stop, or an empty string."""

ASKED, PIVOTS = 100, 1000
"""Questions of HiGHS whether to go on, and simplex iterations of Gurobi, per node that they are allowed.

They bound the work at one node, cuts, heuristics and restarts of the root included: 20 questions are usual.
"""


@dataclass(frozen=True)
class BackendResult:
    """Answer of a back end: whether it has a solution; proven lower bound on the objective; nodes searched.

    Its status is "optimal", "infeasible", or what stopped it ("effort_limit" of nodes, or "time_limit").
    """

    status: str
    solved: bool
    bound: float
    nodes: float


def require(solver: str) -> None:
    """Refuse a back end that is not installed."""
    if solver == "gurobi" and (reason := unusable("gurobipy")):
        raise ScenarioError("planner.solver", "gurobi", f"{reason}, or use another solver")


def run(lp: Any, options: PlannerOptions, nodes: int, seconds: float, hear: Hear) -> BackendResult:
    """Solve a PuLP model in place, from the values that its variables have, if any, within nodes and time."""
    solve = _gurobi if options.solver == "gurobi" else _highs
    return solve(lp, options, nodes, max(seconds, 0.05), hear)


def _warm_highs(**options: Any) -> Any:
    """PuLP's HiGHS with a warm start, which PuLP offers for other solvers only."""
    import pulp

    class WarmHiGHS(pulp.HiGHS):  # type: ignore[misc]
        def callSolver(self, lp: Any) -> None:
            start = [(v.index, v.varValue) for v in lp.variables() if v.varValue is not None]
            if start:
                index, value = zip(*start, strict=True)
                lp.solverModel.setSolution(len(index), np.array(index, dtype=np.int32), np.array(value))
            lp.solverModel.run()

        def findSolutionValues(self, lp: Any) -> tuple[int, int]:
            try:
                status: tuple[int, int] = super().findSolutionValues(lp)
            except KeyError:  # statuses that PuLP has no word for, as of a limit on nodes; values are set
                status = (pulp.LpStatusNotSolved, pulp.LpSolutionNoSolutionFound)
            return status

    return WarmHiGHS(msg=False, **options)


def _highs(lp: Any, options: PlannerOptions, limit: int, seconds: float, hear: Hear) -> BackendResult:
    highspy = silent_highspy()
    kind, gave_up, calls = highspy.HighsModelStatus, [""], count()

    def ask(event: Any, message: str, data: Any, answer: Any, user: Any) -> None:
        gave_up[0] = hear(data.mip_primal_bound, data.mip_dual_bound, data.mip_node_count) or gave_up[0]
        gave_up[0] = gave_up[0] or ("effort_limit" if next(calls) >= ASKED * limit else "")
        answer.user_interrupt = bool(gave_up[0])

    solver = _warm_highs(
        gapRel=options.gap / 2,
        timeLimit=seconds,
        threads=options.threads,
        callbackTuple=(ask, None),
        callbacksToActivate=[highspy.cb.HighsCallbackType.kCallbackMipInterrupt],
        mip_max_nodes=limit,
        primal_feasibility_tolerance=SOLVER_FEASIBILITY,
        mip_feasibility_tolerance=SOLVER_FEASIBILITY,
    )
    lp.solve(solver)
    status, info = lp.solverModel.getModelStatus(), lp.solverModel.getInfo()
    bound, nodes = float(info.mip_dual_bound), float(max(info.mip_node_count, 0))
    if not np.isfinite(bound) or info.mip_node_count < 0:
        bound = float(info.objective_function_value) if status == kind.kOptimal else -np.inf
    if status in (kind.kInfeasible, kind.kUnboundedOrInfeasible):
        return BackendResult("infeasible", False, np.inf, nodes)
    solved = info.primal_solution_status == 2  # kSolutionStatusFeasible
    ended = "time_limit" if status == kind.kTimeLimit else "effort_limit"
    return BackendResult("optimal" if status == kind.kOptimal else gave_up[0] or ended, solved, bound, nodes)


def _gurobi(lp: Any, options: PlannerOptions, limit: int, seconds: float, hear: Hear) -> BackendResult:
    import gurobipy as gp
    import pulp

    grb, gave_up = gp.GRB, [""]

    def ask(model: Any, where: int) -> None:
        if where != grb.Callback.MIP:
            return
        names = ("MIP_OBJBST", "MIP_OBJBND", "MIP_NODCNT")
        incumbent, bound, nodes = (model.cbGet(getattr(grb.Callback, name)) for name in names)
        gave_up[0] = hear(incumbent if incumbent < grb.INFINITY else np.inf, bound, nodes) or gave_up[0]
        if gave_up[0]:
            model.terminate()

    settings = {
        "timeLimit": seconds if np.isfinite(seconds) else None,
        "MIPGap": options.gap / 2,  # PuLP's own argument passes a gap of 0 over
        "NodeLimit": limit,
        "IterationLimit": PIVOTS * limit,
        "FeasibilityTol": SOLVER_FEASIBILITY,
        "IntFeasTol": SOLVER_FEASIBILITY,
        "Threads": 0 if options.threads is None else options.threads,
    }
    try:
        # an environment of its own: the default one writes its licence to standard output
        with gp.Env(params={"OutputFlag": 0}) as env:
            solver = pulp.GUROBI(msg=False, env=env, warmStart=True, **settings)
            try:
                lp.solve(solver, callback=ask)
                return _gurobi_answer(lp.solverModel, grb, gave_up[0])
            finally:
                solver.close()
    except gp.GurobiError as error:
        rule = f"is refused by Gurobi ({error}); use another solver, or a licence without size limit"
        raise ScenarioError("planner.solver", "gurobi", rule) from error


def _gurobi_answer(model: Any, grb: Any, gave_up: str) -> BackendResult:
    nodes = float(model.NodeCount) if model.IsMIP else 0.0
    if model.Status in (grb.INFEASIBLE, grb.INF_OR_UNBD):
        return BackendResult("infeasible", False, np.inf, nodes)
    optimal = model.Status == grb.OPTIMAL
    bound = float(model.ObjBound) if model.IsMIP else float(model.ObjVal) if optimal else -np.inf
    ended = "time_limit" if model.Status == grb.TIME_LIMIT else "effort_limit"
    return BackendResult("optimal" if optimal else gave_up or ended, model.SolCount > 0, bound, nodes)
