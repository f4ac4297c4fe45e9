"""Campaigns: any number of runs over scenarios, seeds and grids of values, on any executor."""

from .batch import Case
from .drive import Interrupted, run_campaign
from .folder import CampaignFolder, read_campaign
from .inspections import InspectionRuns
from .plan import CampaignPlan, make_cases, parse_grid
from .replay import Replayed, find_worst, replay_run
from .schedules import ScheduleRuns
from .workers import Workers, cluster, local

__all__ = [
    "CampaignFolder",
    "CampaignPlan",
    "Case",
    "InspectionRuns",
    "Interrupted",
    "Replayed",
    "ScheduleRuns",
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
