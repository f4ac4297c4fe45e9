"""Problem of the planner (`PlanProblem`), its options (`PlannerOptions`) and its answer (`Plan`)."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from time import perf_counter
from typing import Annotated, Literal, get_args

import numpy as np
from pydantic import Field

from reach.short_repr import short_repr

from ..model.checks import non_negative, one_of, positive, shaped, whole
from ..model.errors import ScenarioError
from ..model.keys import Key, Real, Whole, check_fields
from ..model.scene.timed_polytope import TimedPolytope
from ..model.system import Array, LinearSystem
from .goals import Goal

Count = Annotated[Whole, Field(ge=1, le=10**9)]
Objective = Literal["margin_then_fuel", "distance", "fuel"]
SOLVERS = {
    "facets": "branch and bound over the facets of unsafe sets, linear programs by HiGHS",
    "highs": "mixed-integer program by HiGHS",
    "gurobi": "mixed-integer program by Gurobi",
}
"""Solvers that decide the separating facets, and their names in summaries."""
REPLAN = "replan"
"""Status of a plan that follows an experimental controller: certified, but the cheapest of nothing."""
KNOWN = "known"  # status of a plan that was found before, and is only read


@dataclass(frozen=True, eq=False)
class PlanProblem:
    """One planning problem (section III-C): steer from `x0` to `goal` and keep clear of `unsafe`.

    Of the objectives `fuel` is the least velocity change; `distance` the largest smallest clearance (eq. 19),
    at any price; `margin_then_fuel` the `extra_margin` on top of `margins`, or as much of it as there is,
    then the least velocity change. Of each facet, should it be the separating one, the clearance in `margins`
    is kept over the whole of the cell (the error tube; the path's intersample bound is *not*
    included, the planner takes care of it).
    """

    system: LinearSystem
    x0: Array  # state at time 0, (n,)
    K: int  # number of steps
    delta: float  # length of a step [s]
    unsafe: tuple[TimedPolytope, ...]  # over at least ``K + tail_cells`` cells, or static (then it is held)
    margins: tuple[Array, ...]  # clearance [m] from each facet of each unsafe set, (K, F)
    u_limit: Array  # tightened input limits ``|nu_k,i| <= u_limit[k, i]``, (K, m)
    goal: Goal
    objective: Objective = "margin_then_fuel"
    extra_margin: float = 0.0  # clearance [m] wanted on top; of `distance` a cap on it, if positive
    tail_cells: int = 0  # cells of coasting after K, clear with the margins of the last cell and no extra one

    def __post_init__(self) -> None:
        set_field, sys = object.__setattr__, self.system
        whole("planner.K", self.K, 1)
        whole("planner.tail_cells", self.tail_cells, 0)
        positive("planner.delta", self.delta, "s")
        non_negative("planner.extra_margin", self.extra_margin, "m")
        one_of("planner.objective", self.objective, get_args(Objective))
        set_field(self, "x0", shaped("planner.x0", self.x0, (sys.n,)))
        set_field(self, "u_limit", shaped("planner.u_limit", self.u_limit, (self.K, sys.m)))
        if np.any(self.u_limit < 0):
            raise ScenarioError("planner.u_limit", float(self.u_limit.min()), "must all be >= 0")
        if self.goal.n != sys.n:
            raise ScenarioError("planner.goal", self.goal.n, f"must be a goal for {sys.n} states")
        if len(self.margins) != len(self.unsafe):
            raise ScenarioError("planner.margins", len(self.margins), f"must be {len(self.unsafe)} arrays")
        margins = [
            shaped(f"planner.margins[{i}]", margin, (self.K, len(body.normals)))
            for i, (body, margin) in enumerate(zip(self.unsafe, self.margins, strict=True))
        ]
        set_field(self, "margins", tuple(margins))
        for i, body in enumerate(self.unsafe):
            if body.cells < self.cells and not (body.static and body.cells >= 1):
                raise ScenarioError(f"planner.unsafe[{i}]", body.cells, f"must cover {self.cells} cells")

    @property
    def cells(self) -> int:
        """Cells checked: K planned ones and the coasting tail."""
        return self.K + self.tail_cells

    def offsets(self, i: int) -> Array:
        """Offsets [m] of unsafe set i over all cells, shape (cells, 2, F); static sets are held."""
        body = self.unsafe[i]
        return body.offsets[np.minimum(np.arange(self.cells), body.cells - 1)]

    def required(self, i: int) -> Array:
        """Clearance [m] to keep from each facet of unsafe set i, without extra, shape (cells, F)."""
        return self.margins[i][np.minimum(np.arange(self.cells), self.K - 1)]


@dataclass(frozen=True)
class Progress:
    """Progress of a run of the planner, as a callback receives it.

    Attributes
    ----------
    stage : str
        Name of the stage of the search.
    seconds : float
        Since the start of `plan`.
    incumbent, bound : float
        Objective of the best plan so far and proven bound (m/s for fuel, m or share for margins).
    gap : float
        Relative distance between the two.
    """

    stage: str
    seconds: float
    incumbent: float = np.inf
    bound: float = -np.inf
    gap: float = np.inf


@short_repr
@dataclass(frozen=True)
class PlannerOptions:
    """The mixed-integer program behind the reference (section III-C).

    Parameters
    ----------
    solver : {"facets", "highs", "gurobi"}
        `facets`: branch and bound over linear programs. `highs`, `gurobi` (an extra): a mixed-integer
        program.
    max_linear_programs : int
        Limit of linear programs (`facets`).
    max_nodes : int
        Limit of nodes (`highs`, `gurobi`).
    time_limit : float [s], optional
        Wall-time limit of each plan, which makes results depend on the machine.
    gap : float
        Relative optimality gap.
    threads : int or None
        Threads of a back end; None leaves their number to it, and the plan to the machine.
    progress : callable, optional
        Called with a `Progress`, at most a few times a second.
    """

    solver: Annotated[str, Key("solver", "-", Literal["facets", "highs", "gurobi"])] = "facets"
    max_linear_programs: Annotated[int, Key("max_linear_programs", "-", Count)] = 10_000
    max_nodes: Annotated[int, Key("max_nodes", "-", Count)] = 10_000
    time_limit: Annotated[float | None, Key("time_limit_s", "s", Annotated[Real, Field(gt=0, le=1e6)])] = None
    gap: Annotated[float, Key("gap", "-", Annotated[Real, Field(ge=0, lt=1)])] = 1e-3
    threads: int | None = 1
    progress: Callable[[Progress], None] | None = None

    def __post_init__(self) -> None:
        check_fields(self, "planner")

    @property
    def deadline(self) -> float:
        """Value of `time.perf_counter` at which a search that begins now stops; infinite without a clock."""
        return np.inf if self.time_limit is None else perf_counter() + self.time_limit


@dataclass(frozen=True)
class Stage:
    """One stage of the search.

    Attributes
    ----------
    name : str
        "path search", "fuel" (least velocity change at the full margin), "margin" (largest margin), or
        "fuel at the margin found".
    by : str
        Solver of the stage: out of `SOLVERS`, or plain linear programs.
    status : str
        "optimal" (to the gap), "infeasible", "found" or "none" for the path search, or what stopped it:
        "effort_limit" (counted, the same everywhere) or "time_limit" (the wall clock).
    linear_programs, nodes : int
        Linear programs solved by the planner itself; nodes of the branch and bound, whoever did it.
    """

    name: str
    by: str
    status: str
    linear_programs: int
    nodes: int


@short_repr
@dataclass(frozen=True, eq=False)
class Plan:
    """A certified plan: every number below was re-computed from the inputs, not read from a solver.

    Attributes
    ----------
    chi : ndarray, shape (K+1, n)
        States at the waypoints, propagated exactly.
    nu : ndarray, shape (K, m)
        Inputs.
    facets : ndarray of int, shape (n_o, K)
        Separating facet of every unsafe set in every cell.
    tail_facets : ndarray of int, shape (n_o, tail_cells)
        Separating facets in the coasting tail.
    margin : float
        Smallest clearance [m] in position beyond `margins`, over all planned cells and continuous time.
    extra : ndarray, shape (n_o, K)
        Clearance [m] beyond `margins` per unsafe set and cell.
    desired : ndarray, shape (n_o, K)
        Extra clearance [m] asked for per unsafe set and cell: `extra_margin`, or less where the start
        and the goal do not allow it.
    delta_v : float
        Velocity change [m/s].
    status : str
        "optimal" (to the gap), "effort_limit" or "time_limit", as in `Stage`; or `IN_VIEW` or `KNOWN`.
    objective, bound, gap : float
        Objective of the last phase: `delta_v` [m/s], or the extra clearance [m] for `distance` and where
        `extra_margin` is out of reach; its proven bound for the model solved; the relative gap.
    seconds : mapping
        Wall time by part [s].
    solver : str
        Solver that decided the separating facets, out of `SOLVERS`.
    stages : tuple of Stage
        Stages of the search, their solvers, and how they ended.
    cut_by_clock : tuple of str
        Stages that the wall clock ended early: if there are any, another machine may find another plan.
    stats : mapping
        Linear programs solved (lps), nodes, calls of the back end (rounds), size of its largest model
        (rows, cols, binaries).
    """

    chi: Array
    nu: Array
    facets: np.ndarray
    tail_facets: np.ndarray
    margin: float
    extra: Array
    desired: Array
    delta_v: float
    status: str
    objective: float
    bound: float
    gap: float
    seconds: Mapping[str, float] = field(default_factory=dict)
    solver: str = "facets"
    stats: Mapping[str, float] = field(default_factory=dict)
    stages: tuple[Stage, ...] = ()
    cut_by_clock: tuple[str, ...] = ()


def relative_gap(value: float, bound: float) -> float:
    """Relative distance of a value and its bound, infinite while either is missing."""
    if not (np.isfinite(value) and np.isfinite(bound)):
        return np.inf
    return abs(value - bound) / max(abs(value), 1e-9)
