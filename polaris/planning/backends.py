"""The two back ends of PuLP, in process: HiGHS with a warm start, and Gurobi."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import numpy as np

from ..errors import ScenarioError
from ..tolerances import SOLVER_FEASIBILITY
from .problem import PlannerOptions

Listen = Callable[[float, float], None]


def require(solver: str) -> None:
    """Refuse a back end that is not installed."""
    if solver == "gurobi" and find_spec("gurobipy") is None:
        raise ScenarioError(
            "planner.solver",
            "gurobi",
            "needs the package gurobipy: install the extra 'gurobi', or use the solver highs",
        )


def run(
    lp: Any, options: PlannerOptions, seconds: float, warm: bool, listen: Listen | None
) -> tuple[str, float, float]:
    """Solve a PuLP model in place.

    Returns
    -------
    status : str
        "optimal", "time" (stopped with a solution), "none" (stopped without) or "infeasible".
    bound : float
        Proven lower bound on the objective.
    nodes : float
        Branch-and-bound nodes.
    """
    solve = _highs if options.solver == "highs" else _gurobi
    return solve(lp, options, max(seconds, 0.05), warm, listen)


def _highs(
    lp: Any, options: PlannerOptions, seconds: float, warm: bool, listen: Listen | None
) -> tuple[str, float, float]:
    import highspy
    import pulp

    class WarmHiGHS(pulp.HiGHS):  # type: ignore[misc]
        """PuLP's HiGHS with a warm start, which PuLP offers for other solvers only."""

        def callSolver(self, lp: Any) -> None:
            if warm:
                known = [(v.index, v.varValue) for v in lp.variables() if v.varValue is not None]
                if known:
                    index, value = zip(*known, strict=True)
                    lp.solverModel.setSolution(
                        len(index), np.array(index, dtype=np.int32), np.array(value, dtype=float)
                    )
            lp.solverModel.run()

    def hear(kind: Any, message: str, data: Any, answer: Any, user: Any) -> None:
        if listen is not None:
            listen(data.mip_primal_bound, data.mip_dual_bound)

    kinds = [highspy.cb.HighsCallbackType.kCallbackMipInterrupt] if listen is not None else None
    solver = WarmHiGHS(
        msg=False,
        gapRel=options.gap / 2,
        timeLimit=seconds,
        threads=options.threads,
        callbackTuple=(hear, None) if listen is not None else None,
        callbacksToActivate=kinds,
        primal_feasibility_tolerance=SOLVER_FEASIBILITY,
        mip_feasibility_tolerance=SOLVER_FEASIBILITY,
    )
    lp.solve(solver)
    model = lp.solverModel
    status, info = model.getModelStatus(), model.getInfo()
    kind = highspy.HighsModelStatus
    bound, nodes = float(info.mip_dual_bound), float(max(info.mip_node_count, 0))
    if not np.isfinite(bound) or info.mip_node_count < 0:
        bound = float(info.objective_function_value) if status == kind.kOptimal else -np.inf
    if status in (kind.kInfeasible, kind.kUnboundedOrInfeasible):
        return "infeasible", np.inf, nodes
    if info.primal_solution_status != 2:  # kSolutionStatusFeasible
        return "none", bound, nodes
    return ("optimal" if status == kind.kOptimal else "time"), bound, nodes


def _gurobi(
    lp: Any, options: PlannerOptions, seconds: float, warm: bool, listen: Listen | None
) -> tuple[str, float, float]:
    import gurobipy as gp
    import pulp

    def hear(model: Any, where: int) -> None:
        if listen is not None and where == gp.GRB.Callback.MIP:
            listen(model.cbGet(gp.GRB.Callback.MIP_OBJBST), model.cbGet(gp.GRB.Callback.MIP_OBJBND))

    more = {} if options.threads is None else {"Threads": options.threads}
    solver = pulp.GUROBI(
        msg=False,
        gapRel=options.gap / 2,
        timeLimit=seconds,
        warmStart=warm,
        FeasibilityTol=SOLVER_FEASIBILITY * 10,
        IntFeasTol=SOLVER_FEASIBILITY * 10,
        **more,
    )
    try:
        lp.solve(solver, callback=hear if listen is not None else None)
    except gp.GurobiError as error:
        raise ScenarioError(
            "planner.solver",
            "gurobi",
            f"Gurobi refused the model ({error}); use the solver highs, or a licence without size limit",
        ) from error
    model, grb = lp.solverModel, gp.GRB
    bound = float(model.ObjBound) if model.IsMIP else -np.inf
    nodes = float(model.NodeCount) if model.IsMIP else 0.0
    if model.Status in (grb.INFEASIBLE, grb.INF_OR_UNBD):
        return "infeasible", np.inf, nodes
    if model.SolCount == 0:
        return "none", bound, nodes
    if model.Status == grb.OPTIMAL:
        return "optimal", bound if model.IsMIP else float(model.ObjVal), nodes
    return "time", bound, nodes
