"""What the command line shows of a trade-off."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from typing import Any

from rich.console import Console

from ...model.checks import counted
from ...synthesis.recoverable import directed
from .printing import Printout, table

HEADS = ("", "share of U", "switches", "mean m/s", "largest", "proven", "goal by s", "safe until s")
"""Of the table; velocity changes are simulated (mean and largest) and proven never to be exceeded."""


def show_tradeoff(summary: Mapping[str, Any], folder: str, console: Console | None = None) -> None:
    """Print the points, those that no other outdoes marked, and where their folders lie."""
    out, points = Printout(console), summary["points"]
    out.say(f"{summary['title']}: {counted(len(points), 'schedule')}", "bold")
    out.table(table(*HEADS, wrap=0, rows=map(_row, points)), 90)
    out.say("* no other is as good in all of share, mean velocity change, switches, goal and guarantee.")
    out.say(f"Trade-off: {folder}")
    out.say(f"One of them in detail: polaris report {shlex.quote(folder + '/' + points[0]['folder'])}")


def _row(point: Mapping[str, Any]) -> tuple[str, ...]:
    proved = point["guarantee"] == "proved"
    until = "for all time" if point["until_s"] is None else f"{point['until_s']:.6g}"
    return (
        f"{'*' if point['non_dominated'] else ' '} {point['folder']}",
        f"{point['share']:.1%}",
        str(point["switches"]),
        *(f"{point[key]:.4g}" for key in ("delta_v_m_s", "delta_v_max_m_s")),
        directed(point["delta_v_most_m_s"], ".4g", up=True) if proved else "not proven",
        f"{point['goal_by_s']:.6g}" if point["goal_reached"] is True else "not proven",
        until if proved else "not proven",
    )
