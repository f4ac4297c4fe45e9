"""The inspection problem: barrier constraints, filters, simplex, fuel limit, Monte Carlo.

After Dunlap, van Wijk, Hobbs: Run Time Assurance for Autonomous Spacecraft Inspection (2023), with the
corrections that ``docs/inspection-theory.md`` lists.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .backup.parking import Coast, Outlook, Parking
    from .backup.tracker import Tracker
    from .constraints.allowable_set import allowable
    from .constraints.families import Families, Rows
    from .constraints.motion import SampledData
    from .constraints.strengthening import Strengthening
    from .filters.asif import ActiveSetFilter
    from .filters.decision import Backup, Decision, RunTimeFilter
    from .filters.explicit import Centralized, Decentralized, Filtered
    from .filters.fuel import FuelLimit
    from .filters.implicit import ImplicitASIF
    from .filters.simplex import ExplicitSimplex, ImplicitSimplex
    from .flights.fuel_run import FuelRun, fly_fuel_limit
    from .flights.primary import LQR, NoInput, Phases
    from .flights.sampling import initial_conditions
    from .flights.simulation import InspectionRun, fly, fly_one
    from .flights.studies import Outcome, Study, fly_block
    from .inspection import Inspection

_HOMES = {
    ".constraints.allowable_set": ("allowable",),
    ".filters.asif": ("ActiveSetFilter",),
    ".backup.parking": ("Coast", "Outlook", "Parking"),
    ".filters.decision": ("Backup", "Decision", "RunTimeFilter"),
    ".constraints.families": ("Families", "Rows"),
    ".filters.explicit": ("Centralized", "Decentralized", "Filtered"),
    ".filters.fuel": ("FuelLimit",),
    ".flights.fuel_run": ("FuelRun", "fly_fuel_limit"),
    ".filters.implicit": ("ImplicitASIF",),
    ".inspection": ("Inspection",),
    ".flights.studies": ("Outcome", "Study", "fly_block"),
    ".flights.primary": ("LQR", "NoInput", "Phases"),
    ".constraints.motion": ("SampledData",),
    ".flights.sampling": ("initial_conditions",),
    ".filters.simplex": ("ExplicitSimplex", "ImplicitSimplex"),
    ".flights.simulation": ("InspectionRun", "fly", "fly_one"),
    ".constraints.strengthening": ("Strengthening",),
    ".backup.tracker": ("Tracker",),
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
    "fly_block",
    "fly_fuel_limit",
    "fly_one",
    "initial_conditions",
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
