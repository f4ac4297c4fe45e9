"""The page of an ordinary run folder."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ...runs.folder import RunFolder
from ..scene.palette import PILOTS
from . import claims
from .page import Page, reading
from .tables import Cell, Measure, badge, escaped, table
from .timelines import Flown, flight_data

NOTE = (
    "Drawn paths keep at most 400 samples of a run; the tables use all of them. Bands reach over all "
    "simulated runs, lines are the run shown. The distance of the run shown is taken from where other "
    "satellites are nominally, the band from where they truly were."
)
SLICE = (
    "The recoverable set (yellow) is cut through the state of the run shown, at the time written at it: "
    "then it is filled, and dashed until the next one."
)


def run_page(folder: RunFolder) -> Page:
    """The report of a run folder."""
    summary = folder.summary
    claim, recoverable = summary["guarantee"], str(summary["synthesis"]["recoverable"])
    proved = claim["kind"] == "proved"
    told = f"safe {claims.reach(claim)}" if proved else "no claim"
    name = escaped(summary["scenario"])
    lead = f"<p>{badge(claim['kind'])} {escaped(told)}. Scenario <code>{name}</code>.</p>"
    picture = folder.picture()
    flown = [
        Flown(key, name, {"colour": colour, "dash": dash, "on": key == "polaris"}, picture.flights[key])
        for key, (name, _, colour, dash) in PILOTS.items()
        if key in picture.flights
    ]
    return Page(
        str(summary["title"]),
        lead + ("" if proved else claims.loud(recoverable)),
        (
            ("numbers", "Metrics", metrics(summary)),
            ("guarantee", "The guarantee", claims.guarantee(claim, recoverable)),
            ("synthesis", "Synthesis", synthesis(summary)),
            reading(summary, f"{NOTE} {SLICE}"),
        ),
        flight_data(picture, flown, proved, "mode"),
        summary,
    )


def metrics(summary: Mapping[str, Any]) -> str:
    """Metrics of S alone, U alone and the schedule."""
    who = [key for key in ("safety", "experimental", "polaris") if key in summary]
    rows = [
        [Cell(escaped(one.title)), *(one.cell(summary[name].get(one.key)) for name in who)]
        for one in Measure.known(*(summary[name] for name in who))
        if one.key != "controller"
    ]
    heads = ["", *(PILOTS[name][0] for name in who)]
    return table("From simulated runs, under random and worst-case disturbances", heads, rows)


def synthesis(summary: Mapping[str, Any]) -> str:
    """What the synthesis found, and how long it took."""
    found = summary["synthesis"]
    plan, start = found["planner"], Measure.of("start_share")
    room = start.text(found["start_margin"], proven=True)
    rows = {
        "recoverable sets": escaped(found["recoverable"]),
        "plan": f"{escaped(plan['status'])} ({escaped(plan.get('solver_name', plan['solver']))})",
        "clearance of the plan beyond the tube": Measure.of("margin_m").text(plan["margin_m"], proven=True),
        "velocity change of the plan": Measure.of("delta_v_m_s").text(plan["delta_v_m_s"]),
        "room left at the start": f"{room}, least at {escaped(found['start_limit'])}",
        "time of synthesis": Measure.of("total_s").text(found["seconds"]["total"]),
    }
    return table("Before the flight", ["", ""], [[Cell(name), Cell(text)] for name, text in rows.items()])
