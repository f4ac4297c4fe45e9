"""The page of a run folder of the inspection problem: a flight, a fuel limit, or a campaign."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ...model.checks import counted
from ...runs.folder import RunFolder
from ...runs.inspection import MEANING
from . import claims
from .html import Cell, badge, number_cell, table, text_cell
from .inspection_page import flight_data, fuel_data
from .measures import Measure
from .numbers import escaped
from .page import Page
from .run_report import definitions, footer

LIMITS = (
    "That the next program of the filter has a solution, unless it says so above.",
    "Anything about motion that differs from the model, states that are not known exactly, or late commands.",
    "Anything beyond this flight: simulated flights illustrate, they prove nothing.",
)

OWN = (
    "schema_version",
    "scenario",
    "kind",
    "title",
    "guarantee",
    "definitions",
    "seconds",
    "versions",
    "created",
)
"""Keys of a summary that the table of its values leaves out."""


def inspection_page(folder: RunFolder) -> Page:
    """The report of a run folder of the inspection problem.

    Raises
    ------
    ScenarioError
        If a file in it is missing or damaged.
    """
    summary, kind = folder.summary, folder.scenario.kind
    claim = summary["guarantee"]
    lead = f"<p>{badge(claim['kind'])} Scenario <code>{escaped(summary['scenario'])}</code>.</p>"
    data: dict[str, Any] = {}
    parts: list[tuple[str, str, str]]
    if kind == "inspection":
        data = flight_data(folder)
        parts = [
            ("constraints", "Constraints", _constraints(summary)),
            ("numbers", "Metrics", _values(summary)),
        ]
    elif kind == "fuel_limit":
        data = fuel_data(folder.picture())
        parts = [("numbers", "Metrics", _values(summary))]
    else:
        parts = [("studies", "Studies", _studies(summary)), ("numbers", "Metrics", _values(summary))]
    return Page(
        str(summary["title"]),
        lead + _verdict(summary),
        (
            *parts,
            ("guarantee", "What is claimed", claims.other_guarantee(claim, LIMITS)),
            ("reading", "How to read this", definitions(summary.get("definitions", {}))),
        ),
        data,
        footer(summary),
    )


def _verdict(summary: Mapping[str, Any]) -> str:
    if "safe" not in summary:
        return ""
    if summary["safe"]:
        return "<p>No constraint is violated in this flight.</p>"
    return '<div class="loud" role="alert"><strong>A CONSTRAINT IS VIOLATED</strong> in this flight.</div>'


def _constraints(summary: Mapping[str, Any]) -> str:
    rows = []
    for row in summary["constraints"]:
        least, share = row["least"], Measure.of("violated_share")
        rows.append(
            [
                Cell(escaped(row["constraint"])),
                text_cell(MEANING.get(row["constraint"], (row["meaning"], ""))[0]),
                Cell(number_cell(least, unit=row["unit"]).html, least, bad=least is not None and least < 0),
                number_cell(row["time_s"], unit="s"),
                text_cell(", ".join(map(str, row["deputies"]))),
                Cell(
                    share.text(row["violated_share"]), row["violated_share"], bad=bool(row["violated_share"])
                ),
            ]
        )
    heads = ["constraint", "meaning", "least", "at", "deputies", "share of instants violated"]
    return table(
        "Least value of every constraint over the flight; negative is a violation", heads, rows, sort=True
    )


def _values(summary: Mapping[str, Any]) -> str:
    """Every value of a summary that is not shown elsewhere."""
    rows = []
    for key, value in summary.items():
        if key in (*OWN, "constraints", "barriers", "studies"):
            continue
        inner = value.items() if isinstance(value, Mapping) else [("", value)]
        for name, one in inner:
            unit = "s" if key.endswith("_seconds") else Measure.of(name or key).unit
            title = " ".join(part for part in (Measure.of(key).title, name.replace("_", " ")) if part)
            rows.append([Cell(escaped(title)), number_cell(one, key, unit="" if unit == "%" else unit)])
    return table("Values of summary.json", ["", "value"], rows)


def _studies(summary: Mapping[str, Any]) -> str:
    kinds = sorted({kind for study in summary["studies"] for kind in study["failures"]})
    share = Measure.of("success_share")
    rows = [
        [
            Cell(escaped(study["name"])),
            number_cell(study["successes"]),
            Cell(share.text(study["success_share"]), study["success_share"]),
            Cell(share.text(study["success_share_lower_95"]), study["success_share_lower_95"]),
            Cell(share.text(study["interventions_share"]), study["interventions_share"]),
            number_cell(study["delta_v_mean_m_s"], unit="m/s"),
            *(
                Cell(str(count), count, bad=count > 0)
                for count in (int(study["failures"].get(kind, 0)) for kind in kinds)
            ),
        ]
        for study in summary["studies"]
    ]
    heads = ["study", "safe runs", "share", "at least, 95 %", "interventions", "velocity change", *kinds]
    return table(f"{counted(summary['runs'], 'run')} each", heads, rows, sort=True)
