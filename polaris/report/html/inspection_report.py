"""The page of a run folder of the inspection problem: a flight, a fuel limit, or a campaign."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ...model.checks import counted
from ...runs.folder import RunFolder
from ...runs.inspection_summary import MEANING
from . import claims
from .inspection_page import flight_data, fuel_data
from .page import Page, reading
from .tables import Cell, Measure, badge, escaped, number_cell, table, text_cell

LIMITS = (
    "That the next program of the filter has a solution, unless it says so above.",
    "Anything about motion that differs from the model, states that are not known exactly, or late commands.",
    "Anything beyond this flight: simulated flights illustrate, they prove nothing.",
)

ELSEWHERE = {
    *("schema_version", "scenario", "kind", "title", "guarantee", "definitions", "seconds", "versions"),
    *("created", "constraints", "barriers", "studies"),
}
"""Keys of a summary that the table of its values leaves out."""


def inspection_page(folder: RunFolder) -> Page:
    """The report of a run folder of the inspection problem."""
    summary, kind = folder.summary, folder.scenario.kind
    claim = summary["guarantee"]
    lead = f"<p>{badge(claim['kind'])} Scenario <code>{escaped(summary['scenario'])}</code>.</p>"
    if "safe" in summary and summary["safe"]:
        lead += "<p>No constraint is violated in this flight.</p>"
    elif "safe" in summary:
        told = "<strong>A CONSTRAINT IS VIOLATED</strong> in this flight."
        lead += f'<div class="loud" role="alert">{told}</div>'
    data: dict[str, Any] = {}
    parts = [("numbers", "Metrics", _values(summary))]
    if kind == "inspection":
        data = flight_data(folder)
        parts.insert(0, ("constraints", "Constraints", _constraints(summary)))
    elif kind == "fuel_limit":
        data = fuel_data(folder.picture())
    else:
        parts.insert(0, ("studies", "Studies", _studies(summary)))
    parts.append(("guarantee", "What is claimed", claims.other_guarantee(claim, LIMITS)))
    return Page(str(summary["title"]), lead, (*parts, reading(summary)), data, summary)


def _share(value: Any, bad: bool = False) -> Cell:
    return Cell(Measure.of("_share").text(value), value, bad=bad)


def _constraints(summary: Mapping[str, Any]) -> str:
    rows = [
        [
            Cell(escaped(row["constraint"])),
            text_cell(MEANING.get(row["constraint"], (row["meaning"], ""))[0]),
            Cell(
                number_cell(row["least"], unit=row["unit"]).html,
                row["least"],
                bad=row["least"] is not None and row["least"] < 0,
            ),
            number_cell(row["time_s"], unit="s"),
            text_cell(", ".join(map(str, row["deputies"]))),
            _share(row["violated_share"], bad=bool(row["violated_share"])),
        ]
        for row in summary["constraints"]
    ]
    heads = ["constraint", "meaning", "least", "at", "deputies", "share of instants violated"]
    caption = "Least value of every constraint over the flight; negative is a violation"
    return table(caption, heads, rows, sort=True)


def _values(summary: Mapping[str, Any]) -> str:
    """Every value of a summary that is not shown elsewhere."""
    rows = []
    for key, value in summary.items():
        if key in ELSEWHERE:
            continue
        for name, one in value.items() if isinstance(value, Mapping) else [("", value)]:
            unit = "s" if key.endswith("_seconds") else Measure.of(name or key).unit
            title = " ".join(part for part in (Measure.of(key).title, name.replace("_", " ")) if part)
            rows.append([Cell(escaped(title)), number_cell(one, key, unit="" if unit == "%" else unit)])
    return table("Values of summary.json", ["", "value"], rows)


def _studies(summary: Mapping[str, Any]) -> str:
    kinds = sorted({kind for study in summary["studies"] for kind in study["failures"]})
    rows = []
    for study in summary["studies"]:
        shares = (study[key] for key in ("success_share", "success_share_lower_95", "interventions_share"))
        counts = (int(study["failures"].get(kind, 0)) for kind in kinds)
        rows.append(
            [
                Cell(escaped(study["name"])),
                number_cell(study["successes"]),
                *map(_share, shares),
                number_cell(study["delta_v_mean_m_s"], unit="m/s"),
                *(Cell(str(count), count, bad=count > 0) for count in counts),
            ]
        )
    heads = ["study", "safe runs", "share", "at least, 95 %", "interventions", "velocity change", *kinds]
    return table(f"{counted(summary['runs'], 'run')} each", heads, rows, sort=True)
