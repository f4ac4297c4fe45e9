"""The page of the inspection problem: a flight, a fuel limit, or a campaign (tables alone)."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from markupsafe import Markup

from ...runs.files.folder import RunFolder
from ..scene.inspections import flight_timeline, flight_view, fuel_timeline, fuel_view
from ..tables import Cell, Measure, Table, constraints, studies, value_cell
from .page import Page, badge, macros, reading, table
from .timelines import page_data

PLACE = np.eye(3, 6)  # the position of a deputy, of its state

LIMITS = (
    "That the next program of the filter has a solution, unless it says so above.",
    "Anything if an assumption fails: another motion, later commands, larger errors of thrust or estimates.",
    "Anything beyond this flight: simulated flights illustrate, they prove nothing.",
)

ELSEWHERE = {  # keys of a summary that the table of its values leaves out
    *("schema_version", "scenario", "kind", "title", "guarantee", "definitions", "seconds", "versions"),
    *("created", "constraints", "barriers", "studies"),
}


def inspection_page(folder: RunFolder) -> Page:
    """The report of a run folder of the inspection problem."""
    summary, kind = folder.summary, folder.scenario.kind
    claim = summary["guarantee"]
    kinds = macros("run.html")
    lead = Markup(kinds.lead(summary["scenario"], badge(claim["kind"]), summary.get("safe")))
    data: dict[str, Any] = {}
    parts = [("numbers", "Metrics", _values(summary))]
    if kind == "inspection":
        run = folder.plot_data()
        data = page_data(flight_view(run), flight_timeline(run, folder.scenario.families()), PLACE)
        parts.insert(0, ("constraints", "Constraints", table(constraints(summary))))
    elif kind == "fuel_limit":
        data = page_data(fuel_view(run := folder.plot_data()), fuel_timeline(run), PLACE)
    else:
        parts.insert(0, ("studies", "Studies", table(studies(summary))))
    section = Markup(kinds.other_guarantee(claim, badge(claim["kind"]), LIMITS))
    parts.append(("guarantee", "What is claimed", section))
    return Page(str(summary["title"]), lead, (*parts, reading(summary)), data, summary)


def _values(summary: Mapping[str, Any]) -> Markup:
    """Every value of a summary that is not shown elsewhere."""
    rows = []
    for key, value in summary.items():
        if key in ELSEWHERE:
            continue
        for title, name, one in _flat(Measure.from_key(key).title, key, value):
            unit = "s" if key.endswith("_seconds") else Measure.from_key(name).unit
            rows.append([Cell(title), value_cell(one, key, "" if unit == "%" else unit)])
    return table(Table("Values of summary.json", ["", "value"], rows))


def _flat(title: str, key: str, value: Any) -> Iterator[tuple[str, str, Any]]:
    """Title, key and value of everything in a value of a summary, however deep."""
    if not isinstance(value, Mapping):
        yield title, key, "none" if value in ([], ()) else value
        return
    for name, one in value.items():
        yield from _flat(f"{title}, {name.replace('_', ' ')}", name, one)
