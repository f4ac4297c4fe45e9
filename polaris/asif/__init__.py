"""The inspection problem: barrier constraints, filters, simplex, fuel limit, Monte Carlo.

After Dunlap, van Wijk, Hobbs: Run Time Assurance for Autonomous Spacecraft Inspection (2023), with the
corrections that ``docs/inspection-theory.md`` lists.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .allowable_set import allowable
    from .asif import ActiveSetFilter
    from .backup import Coast, Outlook, Parking
    from .decision import Backup, Decision, RunTimeFilter
    from .families import Families, Rows
    from .filters import Centralized, Decentralized, Filtered
    from .fuel import FuelLimit
    from .fuel_run import FuelRun, fly_fuel_limit
    from .implicit import ImplicitASIF
    from .inspection import Inspection
    from .outcome import Outcome, Study
    from .primary import LQR, NoInput, Phases
    from .sampled import SampledData
    from .sampling import initial_conditions
    from .scenario import InspectionScenario, load_inspection
    from .simplex import ExplicitSimplex, ImplicitSimplex
    from .simulation import InspectionRun, fly, fly_one
    from .strengthening import Strengthening
    from .studies import monte_carlo
    from .tracker import Tracker

_HOMES = {
    ".allowable_set": ("allowable",),
    ".asif": ("ActiveSetFilter",),
    ".backup": ("Coast", "Outlook", "Parking"),
    ".decision": ("Backup", "Decision", "RunTimeFilter"),
    ".families": ("Families", "Rows"),
    ".filters": ("Centralized", "Decentralized", "Filtered"),
    ".fuel": ("FuelLimit",),
    ".fuel_run": ("FuelRun", "fly_fuel_limit"),
    ".implicit": ("ImplicitASIF",),
    ".inspection": ("Inspection",),
    ".studies": ("monte_carlo",),
    ".outcome": ("Outcome", "Study"),
    ".primary": ("LQR", "NoInput", "Phases"),
    ".sampled": ("SampledData",),
    ".sampling": ("initial_conditions",),
    ".scenario": ("InspectionScenario", "load_inspection"),
    ".simplex": ("ExplicitSimplex", "ImplicitSimplex"),
    ".simulation": ("InspectionRun", "fly", "fly_one"),
    ".strengthening": ("Strengthening",),
    ".tracker": ("Tracker",),
}
"""Module of every public name."""

_HOME = {name: home for home, names in _HOMES.items() for name in names}

__all__ = [
    "LQR",
    "ActiveSetFilter",
    "Backup",
    "Centralized",
    "Coast",
    "Decentralized",
    "Decision",
    "ExplicitSimplex",
    "Families",
    "Filtered",
    "FuelLimit",
    "FuelRun",
    "ImplicitASIF",
    "ImplicitSimplex",
    "Inspection",
    "InspectionRun",
    "InspectionScenario",
    "NoInput",
    "Outcome",
    "Outlook",
    "Parking",
    "Phases",
    "Rows",
    "RunTimeFilter",
    "SampledData",
    "Strengthening",
    "Study",
    "Tracker",
    "allowable",
    "fly",
    "fly_fuel_limit",
    "fly_one",
    "initial_conditions",
    "load_inspection",
    "monte_carlo",
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
