"""Run time assurance of spacecraft by switching schedules that are proven before the flight.

>>> import polaris
>>> scenario = polaris.load_scenario("static")
>>> safety = polaris.get_safety(scenario)                 # Algorithm 1
>>> schedule = polaris.synthesize(scenario, safety)       # Algorithm 2
>>> runs = polaris.simulate(schedule, n=1000, seed=0)
>>> runs.metrics().summary()["min_distance_m"] > 0
True

Names are imported when they are first used, so that ``import polaris`` costs next to nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from reach.sets.zonotope import Zonotope

    from .model.errors import (
        ClockWarning,
        NotCertified,
        OutOfTime,
        PolarisError,
        ScenarioError,
        SynthesisInfeasible,
    )
    from .model.hill import clohessy_wiltshire, elliptical_nmt, free_flight
    from .model.keep_in import KeepInCone, KeepInPolytope
    from .model.obstacle import Obstacle
    from .model.obstacles import BallObstacle, BoxObstacle, PolytopeObstacle
    from .model.satellite import SatelliteObstacle
    from .model.system import LinearSystem
    from .model.timed_polytope import TimedPolytope
    from .planning.goal import Goal
    from .planning.goals import Box, EllipticalNMT, LinearNMT, StationaryPoint
    from .planning.problem import Plan, PlannerOptions, Progress, Stage
    from .planning.reference import Reference
    from .report import write_report
    from .report.figures import plot_reference, plot_schedule
    from .rta.arena import Comparison, compare_methods
    from .rta.estimate import Measurement
    from .rta.method import Choice, Claim, Method, Seen
    from .rta.monitor import Monitor
    from .rta.online.decision_log import DecisionLog, read_log
    from .rta.online.loop import Command, FlightLoop
    from .rta.online.replay import replay_log
    from .rta.online.runtime import OnlineMonitor
    from .rta.online.runtime_options import Answer, RuntimeOptions
    from .rta.outcome import Outcome
    from .rta.scene import Scene
    from .runs.campaign import CampaignFolder, CampaignPlan, make_cases, read_campaign, run_campaign
    from .runs.case import replay, write_case
    from .runs.comparison import ComparisonFolder, read_comparison, write_comparison
    from .runs.folder import RunFolder, read_run, write_run
    from .scenario.scenario import Scenario, bundled_scenarios, load_scenario
    from .simulation.baselines import Flights, Flown, compare
    from .simulation.falsification.search import Failure, Falsification, falsify
    from .simulation.metrics import Metrics
    from .simulation.orbit.environment import Environment
    from .simulation.orbit.model_error import ModelError, model_error
    from .simulation.orbit.truth import TrueFlights, fly_true
    from .simulation.run_metrics import Runs, evaluate
    from .simulation.simulate import simulate
    from .synthesis.clearance import Clearance
    from .synthesis.controllers import AffineController, AnyThrust, Controller, TubeSegment
    from .synthesis.end_condition import EndCondition
    from .synthesis.error_bounds import ErrorBounds
    from .synthesis.get_safety import Safety, get_safety
    from .synthesis.problem import Problem
    from .synthesis.recoverable import Margin, RecoverableSet
    from .synthesis.schedule import Schedule, Step
    from .synthesis.search import SwitchingRules
    from .synthesis.synthesize import synthesize
    from .synthesis.tracking import Feedback, Tracking
    from .traces import TraceMetrics, evaluate_trace, read_trace, write_trace

    __version__: str

_HOMES = {
    ".synthesis.clearance": ("Clearance",),
    ".simulation.baselines": (
        "Flights",
        "Flown",
        "compare",
    ),
    ".synthesis.controllers": (
        "AffineController",
        "AnyThrust",
        "Controller",
        "TubeSegment",
    ),
    ".synthesis.end_condition": ("EndCondition",),
    ".synthesis.error_bounds": ("ErrorBounds",),
    ".model.errors": (
        "ClockWarning",
        "NotCertified",
        "OutOfTime",
        "PolarisError",
        "ScenarioError",
        "SynthesisInfeasible",
    ),
    ".simulation.metrics": ("Metrics",),
    ".simulation.run_metrics": ("Runs", "evaluate"),
    ".runs.case": ("replay", "write_case"),
    ".simulation.falsification.search": ("Failure", "Falsification", "falsify"),
    ".report.figures": (
        "plot_reference",
        "plot_schedule",
    ),
    ".model.hill": (
        "clohessy_wiltshire",
        "elliptical_nmt",
        "free_flight",
    ),
    ".model.obstacle": ("Obstacle",),
    ".model.obstacles": ("BallObstacle", "BoxObstacle", "PolytopeObstacle"),
    ".model.keep_in": ("KeepInCone", "KeepInPolytope"),
    ".model.satellite": ("SatelliteObstacle",),
    ".simulation.orbit.environment": ("Environment",),
    ".simulation.orbit.model_error": ("ModelError", "model_error"),
    ".simulation.orbit.truth": ("TrueFlights", "fly_true"),
    ".planning.goal": ("Goal",),
    ".planning.goals": (
        "Box",
        "EllipticalNMT",
        "LinearNMT",
        "StationaryPoint",
    ),
    ".planning.problem": (
        "Plan",
        "PlannerOptions",
        "Progress",
        "Stage",
    ),
    ".synthesis.problem": ("Problem",),
    ".synthesis.recoverable": (
        "Margin",
        "RecoverableSet",
    ),
    ".planning.reference": ("Reference",),
    ".runs.folder": (
        "RunFolder",
        "read_run",
        "write_run",
    ),
    ".synthesis.get_safety": (
        "Safety",
        "get_safety",
    ),
    ".scenario.scenario": (
        "Scenario",
        "bundled_scenarios",
        "load_scenario",
    ),
    ".synthesis.schedule": (
        "Schedule",
        "Step",
    ),
    ".simulation.simulate": ("simulate",),
    ".synthesis.search": ("SwitchingRules",),
    ".synthesis.synthesize": ("synthesize",),
    ".model.system": ("LinearSystem",),
    ".synthesis.tracking": (
        "Feedback",
        "Tracking",
    ),
    ".model.timed_polytope": ("TimedPolytope",),
    ".runs.campaign": ("CampaignFolder", "CampaignPlan", "make_cases", "read_campaign", "run_campaign"),
    ".report": ("write_report",),
    ".rta.arena": ("Comparison", "compare_methods"),
    ".rta.online.decision_log": ("DecisionLog", "read_log"),
    ".rta.estimate": ("Measurement",),
    ".runs.comparison": ("ComparisonFolder", "read_comparison", "write_comparison"),
    ".rta.online.loop": ("Command", "FlightLoop"),
    ".rta.method": ("Choice", "Claim", "Method", "Seen"),
    ".rta.monitor": ("Monitor",),
    ".rta.outcome": ("Outcome",),
    ".rta.online.replay": ("replay_log",),
    ".rta.online.runtime": ("OnlineMonitor",),
    ".rta.online.runtime_options": ("Answer", "RuntimeOptions"),
    ".rta.scene": ("Scene",),
    ".traces": ("TraceMetrics", "evaluate_trace", "read_trace", "write_trace"),
    "reach.sets.zonotope": ("Zonotope",),
}
"""Module of every public name."""

_HOME = {name: home for home, names in _HOMES.items() for name in names}

__all__ = [
    "AffineController",
    "Answer",
    "AnyThrust",
    "BallObstacle",
    "Box",
    "BoxObstacle",
    "CampaignFolder",
    "CampaignPlan",
    "Choice",
    "Claim",
    "Clearance",
    "ClockWarning",
    "Command",
    "Comparison",
    "ComparisonFolder",
    "Controller",
    "DecisionLog",
    "EllipticalNMT",
    "EndCondition",
    "Environment",
    "ErrorBounds",
    "Failure",
    "Falsification",
    "Feedback",
    "FlightLoop",
    "Flights",
    "Flown",
    "Goal",
    "KeepInCone",
    "KeepInPolytope",
    "LinearNMT",
    "LinearSystem",
    "Margin",
    "Measurement",
    "Method",
    "Metrics",
    "ModelError",
    "Monitor",
    "NotCertified",
    "Obstacle",
    "OnlineMonitor",
    "OutOfTime",
    "Outcome",
    "Plan",
    "PlannerOptions",
    "PolarisError",
    "PolytopeObstacle",
    "Problem",
    "Progress",
    "RecoverableSet",
    "Reference",
    "RunFolder",
    "Runs",
    "RuntimeOptions",
    "Safety",
    "SatelliteObstacle",
    "Scenario",
    "ScenarioError",
    "Scene",
    "Schedule",
    "Seen",
    "Stage",
    "StationaryPoint",
    "Step",
    "SwitchingRules",
    "SynthesisInfeasible",
    "TimedPolytope",
    "TraceMetrics",
    "Tracking",
    "TrueFlights",
    "TubeSegment",
    "Zonotope",
    "__version__",
    "bundled_scenarios",
    "clohessy_wiltshire",
    "compare",
    "compare_methods",
    "elliptical_nmt",
    "evaluate",
    "evaluate_trace",
    "falsify",
    "fly_true",
    "free_flight",
    "get_safety",
    "load_scenario",
    "make_cases",
    "model_error",
    "plot_reference",
    "plot_schedule",
    "read_campaign",
    "read_comparison",
    "read_log",
    "read_run",
    "read_trace",
    "replay",
    "replay_log",
    "run_campaign",
    "simulate",
    "synthesize",
    "write_case",
    "write_comparison",
    "write_report",
    "write_run",
    "write_trace",
]


def __getattr__(name: str) -> Any:
    """Import a public name when it is first asked for."""
    if name == "__version__":
        from .model.version import version

        value: Any = version()
    elif name in _HOME:
        value = getattr(import_module(_HOME[name], __name__), name)
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
