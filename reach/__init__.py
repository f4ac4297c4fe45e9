"""Reachable sets of linear systems: zonotopes, tubes sound in continuous time, relaxations.

A library of its own: it needs numpy and scipy only. Names are imported when first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .answer import Answer
    from .automaton import HybridAutomaton, Mode, Transition
    from .ball import ball_generators
    from .containment import contains
    from .convex import ConvexSet
    from .ellipsoid import Ellipsoid
    from .errors import ReachError, ReachWarning, Unresolved
    from .fan import Fan
    from .flow import LinearFlow, state_scale
    from .hulls import enclosing_hull
    from .hybrid import hybrid_tube
    from .hybrid_replay import replay_hybrid
    from .hybrid_simulation import HybridTrajectory, Visit, simulate_hybrid
    from .hybrid_verification import HybridVerdict, falsify_hybrid, verify_hybrid
    from .intersection import meet_halfspace
    from .interval import Interval
    from .lazy import AffineImage, MinkowskiSum
    from .linear import discretize, growth, powers
    from .ltv import LTVSystem, ltv_support_tube, ltv_zonotope_tube
    from .meet import Intersection
    from .norms import NormBracket, largest_norm
    from .outlines import outline
    from .polytope import HPolytope
    from .reduction import reduce, reduction_loss
    from .relaxation import clip_relaxation
    from .segments import HybridTube, Segment
    from .separation import disjoint
    from .signals import Signal
    from .specification import Always, Never, Verdict
    from .systems import LinearSystem
    from .trajectory import Trajectory, simulate, worst_case
    from .tube_support import SupportTube, support_tube
    from .tube_zonotope import ZonotopeTube, zonotope_tube
    from .varying import Varying
    from .verification import verify
    from .zonotope import Zonotope

_HOMES = {
    ".answer": ("Answer",),
    ".automaton": ("HybridAutomaton", "Mode", "Transition"),
    ".ball": ("ball_generators",),
    ".containment": ("contains",),
    ".convex": ("ConvexSet",),
    ".ellipsoid": ("Ellipsoid",),
    ".errors": ("ReachError", "ReachWarning", "Unresolved"),
    ".fan": ("Fan",),
    ".flow": ("LinearFlow", "state_scale"),
    ".hulls": ("enclosing_hull",),
    ".hybrid": ("hybrid_tube",),
    ".hybrid_replay": ("replay_hybrid",),
    ".hybrid_simulation": ("HybridTrajectory", "Visit", "simulate_hybrid"),
    ".hybrid_verification": ("HybridVerdict", "falsify_hybrid", "verify_hybrid"),
    ".intersection": ("meet_halfspace",),
    ".interval": ("Interval",),
    ".lazy": ("AffineImage", "MinkowskiSum"),
    ".ltv": ("LTVSystem", "ltv_support_tube", "ltv_zonotope_tube"),
    ".linear": ("discretize", "growth", "powers"),
    ".meet": ("Intersection",),
    ".norms": ("NormBracket", "largest_norm"),
    ".outlines": ("outline",),
    ".polytope": ("HPolytope",),
    ".reduction": ("reduce", "reduction_loss"),
    ".relaxation": ("clip_relaxation",),
    ".segments": ("HybridTube", "Segment"),
    ".separation": ("disjoint",),
    ".trajectory": ("Trajectory", "simulate", "worst_case"),
    ".tube_support": ("SupportTube", "support_tube"),
    ".signals": ("Signal",),
    ".systems": ("LinearSystem",),
    ".varying": ("Varying",),
    ".specification": ("Always", "Never", "Verdict"),
    ".verification": ("verify",),
    ".zonotope": ("Zonotope",),
    ".tube_zonotope": ("ZonotopeTube", "zonotope_tube"),
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
