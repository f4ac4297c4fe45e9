"""Campaigns: any number of runs over scenarios, seeds and grids of values, on any executor."""

from .cases import Case, make_cases, parse_grid
from .drive import Interrupted, run_campaign
from .folder import CampaignFolder, read_campaign
from .plan import Plan
from .workers import Workers, cluster, local

__all__ = [
    "CampaignFolder",
    "Case",
    "Interrupted",
    "Plan",
    "Workers",
    "cluster",
    "local",
    "make_cases",
    "parse_grid",
    "read_campaign",
    "run_campaign",
]
