"""The page of an ordinary run folder."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ...rta.arena import Shown
from ...runs.folder import RunFolder
from ..scene.items import modes_per_node
from ..scene.palette import PILOTS
from . import claims
from .html import Cell, badge, items, table
from .measures import TITLES, Measure
from .numbers import escaped
from .page import Page
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
    """The report of a run folder.

    Raises
    ------
    ScenarioError
        If a file in it is missing or damaged.
    """
    summary = folder.summary
    claim, recoverable = summary["guarantee"], str(summary["synthesis"]["recoverable"])
    proved = claim["kind"] == "proved"
    told = f"safe {claims.reach(claim)}" if proved else "no claim"
    name = escaped(summary["scenario"])
    lead = f"<p>{badge(claim['kind'])} {escaped(told)}. Scenario <code>{name}</code>.</p>"
    if not proved:
        lead += claims.loud(recoverable)
    return Page(
        str(summary["title"]),
        lead,
        (
            ("numbers", "Metrics", metrics(summary)),
            ("guarantee", "The guarantee", claims.guarantee(claim, recoverable)),
            ("synthesis", "Synthesis", synthesis(summary)),
            (
                "reading",
                "How to read this",
                f"<p>{NOTE} {SLICE}</p>" + definitions(summary.get("definitions", {})),
            ),
        ),
        run_data(folder),
        footer(summary),
    )


def run_data(folder: RunFolder) -> dict[str, Any]:
    """What the page's script draws of a run folder.

    Raises
    ------
    ScenarioError
        If a file is missing or damaged.
    """
    picture, flown = folder.picture(), []
    for key, (name, _, colour, dash) in PILOTS.items():
        if key in picture.flights:
            item = picture.flights[key]
            who = np.tile(modes_per_node(item), (len(item.labels), 1))
            runs = Shown(item.labels, item.times, item.states, item.inputs, who, item.nearest, [])
            look = {"colour": colour, "dash": dash, "on": key == "polaris"}
            flown.append(Flown(key, name, look, runs, item.input_range))
    return flight_data(picture, flown, folder.summary["guarantee"]["kind"] == "proved", "mode")


def metrics(summary: Mapping[str, Any]) -> str:
    """Metrics of S alone, U alone and the schedule."""
    who = [key for key in ("safety", "experimental", "polaris") if key in summary]
    known = {key for name in who for key in summary[name]} - {"controller"}
    order = [key for key in TITLES if key in known] + sorted(known - set(TITLES))
    rows = []
    for key in order:
        measure = Measure.of(key)
        rows.append([Cell(escaped(measure.title)), *(measure.cell(summary[name].get(key)) for name in who)])
    return table(
        "From simulated runs, under random and worst-case disturbances",
        ["", *(PILOTS[name][0] for name in who)],
        rows,
    )


def synthesis(summary: Mapping[str, Any]) -> str:
    """What the synthesis found, and how long it took."""
    found = summary["synthesis"]
    plan, seconds = found["planner"], found["seconds"]
    start = Measure.of("start_share")
    rows = [
        ("recoverable sets", escaped(found["recoverable"])),
        ("plan", f"{escaped(plan['status'])} ({escaped(plan.get('solver_name', plan['solver']))})"),
        ("clearance of the plan beyond the tube", Measure.of("margin_m").text(plan["margin_m"], proven=True)),
        ("velocity change of the plan", Measure.of("delta_v_m_s").text(plan["delta_v_m_s"])),
        (
            "room left at the start",
            f"{start.text(found['start_margin'], proven=True)}, least at {escaped(found['start_limit'])}",
        ),
        ("time of synthesis", Measure.of("total_s").text(seconds["total"])),
    ]
    return table("Before the flight", ["", ""], [[Cell(name), Cell(text)] for name, text in rows])


def definitions(told: Mapping[str, Any]) -> str:
    """What each metric means, as the folder says."""
    if not told:
        return ""
    return (
        "<details><summary>Definitions of the metrics</summary>"
        + items(f"{Measure.of(key).title} ({key}): {text}" for key, text in told.items())
        + "</details>"
    )


def footer(summary: Mapping[str, Any]) -> str:
    """When and with what the folder was made."""
    versions = ", ".join(f"{name} {version}" for name, version in summary.get("versions", {}).items())
    made = escaped(summary.get("created", "an unknown date"))
    return f"<p>Made by polaris report. Folder of {made}; {escaped(versions)}.</p>"
