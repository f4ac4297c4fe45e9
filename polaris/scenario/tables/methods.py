"""The scenario file's models of the methods: tracking, recoverable sets, planner, switching schedule."""

from typing import Literal

from ...model import keys as f
from ...planning.problem import Objective, PlannerOptions
from ...synthesis.schedule.rules import SwitchingRules
from .fields import Described, ScenarioPart, unit


class Tracking(ScenarioPart):
    """The tracking controller of section III-A and the bound on its error."""

    Q: f.DiagonalOrMatrix = unit("1/unit of the state^2")
    """LQR state weight: its diagonal (n numbers) or the full matrix. Positive semidefinite."""
    R: f.DiagonalOrMatrix = unit("1/unit of the input^2")
    """LQR input weight: its diagonal (m numbers) or the full matrix. Positive definite."""
    bound: Literal["envelope", "lyapunov"] = unit("-", default="envelope")
    """How the norm of the tracking error is bounded (Lemma 1): an envelope of the matrix exponential
    (tighter), or a Lyapunov function."""
    thrust_share: f.Real | None = unit("-", default=None, gt=0, le=1)
    """Share of the thrust limits that the safety controller's feedback may demand when it takes over. Errors
    of thrusters count for so much, and for less and less from there on. Without a number, the best of few."""
    weight: f.WordOrWeights = unit("-", default="auto")
    """Weighted norm of that bound: chosen for the closed loop, none (m and m/s in one norm, loose), or the
    diagonal of W, n numbers > 0."""


class Recoverable(ScenarioPart):
    """States from which the safety controller recovers (Definition 1)."""

    kind: Literal["polytope", "ball"] = unit("-", default="polytope")
    """`polytope`: facets of the plan carried back in time, exact for them. `ball`: eqs. 11-12 in the weighted
    norm with the clearance still ahead, thrust limits included."""
    recourse: Literal["in_view", "none"] = unit("-", default="in_view")
    """`in_view`: the safe reference may be planned along the path of an experimental controller, so that the
    safety controller acts only where it must. `none`: the one of the printed Algorithm 1."""


class Planner(Described, makes=PlannerOptions):
    """Objective of the planner, and its options."""

    objective: Objective = unit("-", default="margin_then_fuel")
    """`margin_then_fuel`: reach extra_margin_m where there is room, then least fuel. `fuel`: least fuel.
    `distance`: eq. 19, largest clearance at any price."""
    extra_margin_m: f.NonNegative = unit("m", default=0.0)
    """Clearance wanted beyond the tracking error, for the experimental controller."""
    thrust_reserve: f.Real = unit("-", default=0.2, ge=0, lt=1)
    """Share of the thrust limits the reference leaves to the tracker beyond what the initial set needs; room
    for the experimental controller, as extra_margin_m is."""


class Schedule(Described, makes=SwitchingRules):
    """Choice of the switching schedule (Algorithm 2 and beyond)."""

    bound_programs: f.Whole = unit("-", default=400, ge=0, le=10**9)
    """Linear programs, about, spent on a proven bound on the time under experimental controllers over all
    schedules; 0 for none."""
