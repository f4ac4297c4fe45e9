"""What the command line shows of results, by kind."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from .comparison import show_comparison, show_tradeoff
from .inspection import show_campaign, show_flight, show_fuel
from .schedule import show_summary

__all__ = ["SUMMARIES", "show_campaign", "show_comparison", "show_summary"]

SUMMARIES: dict[str, Callable[[Any, str], None]] = {
    "schedule": show_summary,
    "inspection": show_flight,
    "fuel_limit": show_fuel,
    "monte_carlo": show_campaign,
    "comparison": show_comparison,
    "tradeoff": show_tradeoff,
}
"""What prints the summary of a run folder."""
