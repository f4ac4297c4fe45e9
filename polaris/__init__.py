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
    from reach.zonotope import Zonotope

    from .campaign import CampaignFolder, make_cases, read_campaign, run_campaign
    from .clearance import Clearance
    from .comparison import Flights, Flown, compare
    from .controllers import AffineController, AnyThrust, Controller, Flight
    from .end_condition import EndCondition
    from .error_bounds import ErrorBounds
    from .errors import (
        ClockWarning,
        NotCertified,
        OutOfTime,
        PolarisError,
        ScenarioError,
        SynthesisInfeasible,
    )
    from .evaluation import Metrics, evaluate
    from .falsification.case import replay, write_case
    from .falsification.search import Failure, Falsification, falsify
    from .figures import plot_reference, plot_schedule
    from .hill import clohessy_wiltshire, elliptical_nmt, free_flight
    from .obstacle_base import Obstacle
    from .obstacles import (
        BallObstacle,
        BoxObstacle,
        KeepInCone,
        KeepInPolytope,
        PolytopeObstacle,
        SatelliteObstacle,
    )
    from .orbit.environment import Environment
    from .orbit.model_error import ModelError, model_error
    from .orbit.truth import TrueFlights, fly_true
    from .planning.conditions import Goal
    from .planning.goals import Box, EllipticalNMT, LinearNMT, StationaryPoint
    from .planning.problem import Plan, PlannerOptions, Progress, Stage
    from .problem import Problem
    from .recoverable import Margin, RecoverableSet
    from .reference import Reference
    from .report import write_report
    from .rta.arena import Comparison, compare_methods
    from .rta.decision_log import DecisionLog, read_log
    from .rta.estimate import Measurement
    from .rta.folder import ComparisonFolder, read_comparison, write_comparison
    from .rta.loop import Command, FlightLoop
    from .rta.method import Choice, Claim, Method, Seen
    from .rta.monitor import Monitor
    from .rta.outcome import Outcome
    from .rta.replay import replay_log
    from .rta.runtime import OnlineMonitor
    from .rta.runtime_options import Answer, RuntimeOptions
    from .rta.scene import Scene
    from .runfolder import RunFolder, read_run, write_run
    from .safety import Safety, get_safety
    from .scenario import Scenario, bundled_scenarios, load_scenario
    from .schedule import Schedule, Step
    from .simulation import Runs, simulate
    from .synthesis import SwitchingRules, synthesize
    from .system import LinearSystem
    from .traces import TraceMetrics, evaluate_trace, read_trace, write_trace
    from .tracking import Feedback, Tracking
    from .unsafe import TimedPolytope

    __version__: str

_HOMES = {
    ".clearance": ("Clearance",),
    ".comparison": (
        "Flights",
        "Flown",
        "compare",
    ),
    ".controllers": (
        "AffineController",
        "AnyThrust",
        "Controller",
        "Flight",
    ),
    ".end_condition": ("EndCondition",),
    ".error_bounds": ("ErrorBounds",),
    ".errors": (
        "ClockWarning",
        "NotCertified",
        "OutOfTime",
        "PolarisError",
        "ScenarioError",
        "SynthesisInfeasible",
    ),
    ".evaluation": (
        "Metrics",
        "evaluate",
    ),
    ".falsification.case": ("replay", "write_case"),
    ".falsification.search": ("Failure", "Falsification", "falsify"),
    ".figures": (
        "plot_reference",
        "plot_schedule",
    ),
    ".hill": (
        "clohessy_wiltshire",
        "elliptical_nmt",
        "free_flight",
    ),
    ".obstacle_base": ("Obstacle",),
    ".obstacles": (
        "BallObstacle",
        "BoxObstacle",
        "KeepInCone",
        "KeepInPolytope",
        "PolytopeObstacle",
        "SatelliteObstacle",
    ),
    ".orbit.environment": ("Environment",),
    ".orbit.model_error": ("ModelError", "model_error"),
    ".orbit.truth": ("TrueFlights", "fly_true"),
    ".planning.conditions": ("Goal",),
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
    ".problem": ("Problem",),
    ".recoverable": (
        "Margin",
        "RecoverableSet",
    ),
    ".reference": ("Reference",),
    ".runfolder": (
        "RunFolder",
        "read_run",
        "write_run",
    ),
    ".safety": (
        "Safety",
        "get_safety",
    ),
    ".scenario": (
        "Scenario",
        "bundled_scenarios",
        "load_scenario",
    ),
    ".schedule": (
        "Schedule",
        "Step",
    ),
    ".simulation": (
        "Runs",
        "simulate",
    ),
    ".synthesis": (
        "SwitchingRules",
        "synthesize",
    ),
    ".system": ("LinearSystem",),
    ".tracking": (
        "Feedback",
        "Tracking",
    ),
    ".unsafe": ("TimedPolytope",),
    ".campaign": ("CampaignFolder", "make_cases", "read_campaign", "run_campaign"),
    ".report": ("write_report",),
    ".rta.arena": ("Comparison", "compare_methods"),
    ".rta.decision_log": ("DecisionLog", "read_log"),
    ".rta.estimate": ("Measurement",),
    ".rta.folder": ("ComparisonFolder", "read_comparison", "write_comparison"),
    ".rta.loop": ("Command", "FlightLoop"),
    ".rta.method": ("Choice", "Claim", "Method", "Seen"),
    ".rta.monitor": ("Monitor",),
    ".rta.outcome": ("Outcome",),
    ".rta.replay": ("replay_log",),
    ".rta.runtime": ("OnlineMonitor",),
    ".rta.runtime_options": ("Answer", "RuntimeOptions"),
    ".rta.scene": ("Scene",),
    ".traces": ("TraceMetrics", "evaluate_trace", "read_trace", "write_trace"),
    "reach.zonotope": ("Zonotope",),
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
    "Flight",
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
        from .version import version

        value: Any = version()
    elif name in _HOME:
        value = getattr(import_module(_HOME[name], __name__), name)
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
