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

    from .clearance import Clearance
    from .comparison import Flights, Flown, compare
    from .controllers import AffineController, AnyThrust, Controller, Flight
    from .end_condition import EndCondition
    from .error_bounds import ErrorBounds
    from .errors import NotCertified, PolarisError, ScenarioError, SynthesisInfeasible
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
    from .planning.problem import Plan, PlannerOptions, Progress
    from .problem import Problem
    from .recoverable import Margin, RecoverableSet
    from .reference import Reference
    from .runfolder import RunFolder, read_run, write_run
    from .safety import Safety, get_safety
    from .scenario import Scenario, bundled_scenarios, load_scenario
    from .schedule import Schedule, Step
    from .simulation import Runs, simulate
    from .synthesis import SwitchingRules, synthesize
    from .system import LinearSystem
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
        "NotCertified",
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
    "reach.zonotope": ("Zonotope",),
}
"""Module of every public name."""

_HOME = {name: home for home, names in _HOMES.items() for name in names}

__all__ = [
    "AffineController",
    "AnyThrust",
    "BallObstacle",
    "Box",
    "BoxObstacle",
    "Clearance",
    "Controller",
    "EllipticalNMT",
    "EndCondition",
    "Environment",
    "ErrorBounds",
    "Failure",
    "Falsification",
    "Feedback",
    "Flight",
    "Flights",
    "Flown",
    "Goal",
    "KeepInCone",
    "KeepInPolytope",
    "LinearNMT",
    "LinearSystem",
    "Margin",
    "Metrics",
    "ModelError",
    "NotCertified",
    "Obstacle",
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
    "Safety",
    "SatelliteObstacle",
    "Scenario",
    "ScenarioError",
    "Schedule",
    "StationaryPoint",
    "Step",
    "SwitchingRules",
    "SynthesisInfeasible",
    "TimedPolytope",
    "Tracking",
    "TrueFlights",
    "Zonotope",
    "__version__",
    "bundled_scenarios",
    "clohessy_wiltshire",
    "compare",
    "elliptical_nmt",
    "evaluate",
    "falsify",
    "fly_true",
    "free_flight",
    "get_safety",
    "load_scenario",
    "model_error",
    "plot_reference",
    "plot_schedule",
    "read_run",
    "replay",
    "simulate",
    "synthesize",
    "write_case",
    "write_run",
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
