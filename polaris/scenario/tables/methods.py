"""The scenario file's models of the methods: tracking, recoverable sets, planner, switching schedule."""

from typing import Literal

from ...model import keys as f
from ...planning.problem import Objective, PlannerOptions
from ...synthesis.schedule.rules import SwitchingRules
from .fields import Described, ScenarioPart, unit


class TrackingTable(ScenarioPart):
    """The tracking controller of section III-A and the bound on its error."""

    Q: f.DiagonalOrMatrix = unit("1/state^2")
    """LQR weight of the state, a list for a diagonal."""
    R: f.DiagonalOrMatrix = unit("1/input^2")
    """LQR weight of the input."""
    bound: Literal["envelope", "lyapunov"] = unit("-", default="envelope")
    """Bound on the tracking error (Lemma 1): `envelope` by matrix exponentials (tighter), or `lyapunov`."""
    thrust_share: f.Real | None = unit("-", default=None, gt=0, le=1)
    """Largest share of the thrust limits that S's feedback may demand at a hand-over, by which thruster
    errors count; by default the best of a few values."""
    weight: f.WordOrWeights = unit("-", default="auto")
    """Weights of the norm in this bound: `auto` for the closed loop, `identity` (loose), or n numbers."""


class RecoverableTable(ScenarioPart):
    """States from which S recovers (Definition 1)."""

    kind: Literal["polytope", "ball"] = unit("-", default="polytope")
    """`polytope`: facets of the plan carried back in time. `ball`: eqs. 11-12 in the weighted norm, with all
    clearances ahead and thrust limits."""
    GONE = {"recourse=in_view": "is now called replan"}
    recourse: Literal["replan", "none"] = unit("-", default="replan")
    """`replan`: the safe reference may be planned along U's path, so that S acts only where it must. `none`:
    that of the printed Algorithm 1."""


class PlannerTable(Described, makes=PlannerOptions):
    """Objective of the planner, and its options."""

    objective: Objective = unit("-", default="margin_then_fuel")
    """`margin_then_fuel`: extra_margin_m where possible, then least fuel. `fuel`: least fuel. `distance`:
    largest clearance (eq. 19)."""
    extra_margin_m: f.NonNegative = unit("m", default=0.0)
    """Desired clearance beyond S's tightening, left to U."""
    thrust_reserve: f.Real = unit("-", default=0.2, ge=0, lt=1)
    """Share of the thrust limits left to U beyond S's feedback from the initial set."""


class ScheduleTable(Described, makes=SwitchingRules):
    """Choice of the switching schedule (Algorithm 2 and beyond)."""

    bound_programs: f.Whole = unit("-", default=400, ge=0, le=10**9)
    """Approximate number of linear programs for the bound on U's share over all schedules; 0 for no bound."""
