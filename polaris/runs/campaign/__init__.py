"""Campaigns: any number of runs over scenarios, seeds and grids of values, on any executor."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .cases import Case, make_cases, parse_grid
    from .drive import Interrupted, run_campaign
    from .folder import CampaignFolder, read_campaign
    from .plan import Plan
    from .replay import Replayed, find_worst, replay_run
    from .workers import Workers, cluster, local

_PLACES = {
    "cases": ("Case", "make_cases", "parse_grid"),
    "drive": ("Interrupted", "run_campaign"),
    "folder": ("CampaignFolder", "read_campaign"),
    "plan": ("Plan",),
    "replay": ("Replayed", "find_worst", "replay_run"),
    "workers": ("Workers", "cluster", "local"),
}

__all__ = [
    "CampaignFolder",
    "Case",
    "Interrupted",
    "Plan",
    "Replayed",
    "Workers",
    "cluster",
    "find_worst",
    "local",
    "make_cases",
    "parse_grid",
    "read_campaign",
    "replay_run",
    "run_campaign",
]


def __getattr__(name: str) -> Any:
    # A worker needs `batch` alone: what only the campaign needs is imported when it is asked for.
    for module, names in _PLACES.items():
        if name in names:
            return getattr(import_module(f".{module}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
