"""Synthesis of reference trajectories (section III-C): the mixed-integer program and its re-check."""

from .goal import Goal, GoalConditions
from .goals import Box, EllipticalNMT, LinearNMT, StationaryPoint
from .problem import Plan, PlannerOptions, PlanProblem, Progress
from .recheck import Recheck, recheck
from .solve import plan

__all__ = [
    "Box",
    "EllipticalNMT",
    "Goal",
    "GoalConditions",
    "LinearNMT",
    "Plan",
    "PlanProblem",
    "PlannerOptions",
    "Progress",
    "Recheck",
    "StationaryPoint",
    "plan",
    "recheck",
]
