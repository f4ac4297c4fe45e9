"""Reachable sets of linear systems: zonotopes, tubes sound in continuous time, relaxations.

A library of its own: it needs numpy and scipy only. Names are imported when first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .hybrid.automaton import HybridAutomaton, Mode, Transition
    from .hybrid.replay import replay_hybrid
    from .hybrid.segments import HybridTube, Segment
    from .hybrid.simulation import HybridTrajectory, Visit, simulate_hybrid
    from .hybrid.tube import hybrid_tube
    from .hybrid.verification import HybridVerdict, falsify_hybrid, verify_hybrid
    from .numerics.errors import ReachError, ReachWarning, Unresolved
    from .numerics.linear import discretize, growth, powers
    from .numerics.relaxation import clip_relaxation
    from .sets.answer import Answer
    from .sets.ball import ball_generators
    from .sets.containment import contains
    from .sets.convex import ConvexSet
    from .sets.ellipsoid import Ellipsoid
    from .sets.hulls import enclosing_hull
    from .sets.intersection import meet_halfspace
    from .sets.interval import Interval
    from .sets.lazy import AffineImage, MinkowskiSum
    from .sets.meet import Intersection
    from .sets.norms import NormBracket, largest_norm
    from .sets.outlines import outline
    from .sets.polytope import HPolytope
    from .sets.reduction import reduce, reduction_loss
    from .sets.separation import disjoint
    from .sets.zonotope import Zonotope
    from .tubes.flow import LinearFlow, state_scale
    from .tubes.flowpipes import Fan
    from .tubes.ltv import LTVSystem, ltv_support_tube, ltv_zonotope_tube
    from .tubes.signals import Signal
    from .tubes.support_tube import SupportTube, support_tube
    from .tubes.systems import LinearSystem
    from .tubes.trajectory import Trajectory, simulate, worst_case
    from .tubes.varying import Varying
    from .tubes.zonotope_tube import ZonotopeTube, zonotope_tube
    from .verify.specification import Always, Never, Verdict
    from .verify.verification import verify

_HOMES = {
    ".sets.answer": ("Answer",),
    ".hybrid.automaton": ("HybridAutomaton", "Mode", "Transition"),
    ".sets.ball": ("ball_generators",),
    ".sets.containment": ("contains",),
    ".sets.convex": ("ConvexSet",),
    ".sets.ellipsoid": ("Ellipsoid",),
    ".numerics.errors": ("ReachError", "ReachWarning", "Unresolved"),
    ".tubes.flowpipes": ("Fan",),
    ".tubes.flow": ("LinearFlow", "state_scale"),
    ".sets.hulls": ("enclosing_hull",),
    ".hybrid.tube": ("hybrid_tube",),
    ".hybrid.replay": ("replay_hybrid",),
    ".hybrid.simulation": ("HybridTrajectory", "Visit", "simulate_hybrid"),
    ".hybrid.verification": ("HybridVerdict", "falsify_hybrid", "verify_hybrid"),
    ".sets.intersection": ("meet_halfspace",),
    ".sets.interval": ("Interval",),
    ".sets.lazy": ("AffineImage", "MinkowskiSum"),
    ".tubes.ltv": ("LTVSystem", "ltv_support_tube", "ltv_zonotope_tube"),
    ".numerics.linear": ("discretize", "growth", "powers"),
    ".sets.meet": ("Intersection",),
    ".sets.norms": ("NormBracket", "largest_norm"),
    ".sets.outlines": ("outline",),
    ".sets.polytope": ("HPolytope",),
    ".sets.reduction": ("reduce", "reduction_loss"),
    ".numerics.relaxation": ("clip_relaxation",),
    ".hybrid.segments": ("HybridTube", "Segment"),
    ".sets.separation": ("disjoint",),
    ".tubes.trajectory": ("Trajectory", "simulate", "worst_case"),
    ".tubes.support_tube": ("SupportTube", "support_tube"),
    ".tubes.signals": ("Signal",),
    ".tubes.systems": ("LinearSystem",),
    ".tubes.varying": ("Varying",),
    ".verify.specification": ("Always", "Never", "Verdict"),
    ".verify.verification": ("verify",),
    ".sets.zonotope": ("Zonotope",),
    ".tubes.zonotope_tube": ("ZonotopeTube", "zonotope_tube"),
}
"""Module of every public name."""

_HOME = {name: home for home, names in _HOMES.items() for name in names}

__all__ = [
    "AffineImage",
    "Always",
    "Answer",
    "ConvexSet",
    "Ellipsoid",
    "Fan",
    "HPolytope",
    "HybridAutomaton",
    "HybridTrajectory",
    "HybridTube",
    "HybridVerdict",
    "Intersection",
    "Interval",
    "LTVSystem",
    "LinearFlow",
    "LinearSystem",
    "MinkowskiSum",
    "Mode",
    "Never",
    "NormBracket",
    "ReachError",
    "ReachWarning",
    "Segment",
    "Signal",
    "SupportTube",
    "Trajectory",
    "Transition",
    "Unresolved",
    "Varying",
    "Verdict",
    "Visit",
    "Zonotope",
    "ZonotopeTube",
    "ball_generators",
    "clip_relaxation",
    "contains",
    "discretize",
    "disjoint",
    "enclosing_hull",
    "falsify_hybrid",
    "growth",
    "ltv_support_tube",
    "ltv_zonotope_tube",
    "hybrid_tube",
    "largest_norm",
    "meet_halfspace",
    "outline",
    "powers",
    "reduce",
    "reduction_loss",
    "replay_hybrid",
    "simulate",
    "simulate_hybrid",
    "state_scale",
    "support_tube",
    "verify",
    "verify_hybrid",
    "worst_case",
    "zonotope_tube",
]


def __getattr__(name: str) -> Any:
    """Import a public name when it is first asked for."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(_HOME[name], __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
