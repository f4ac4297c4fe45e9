"""The page of a comparison of methods on one scenario."""

import base64
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from ...model.files import parse_json, read_text
from ...runs.comparison import ComparisonData
from ...runs.files.folder import RunFolder
from ...synthesis.safety.recoverable import directed
from ..scene.items import Actor
from ..scene.palette import method_style
from ..tables import Cell, Measure, Table, number, seldom_flown, value_cell, words
from .page import Page, details, macros, reading, table
from .run_report import NOTE, guarantee_section, schedule_data

FIRST = 4  # methods that are shown at first; the others can be chosen
MOST_STRETCHES = 40  # stretches of alike decisions that are listed of each method

Methods = Sequence[Mapping[str, Any]]


def comparison_page(folder: RunFolder) -> Page:
    """The report of a comparison folder."""
    picture: ComparisonData = folder.plot_data()
    results, summary = picture.table, picture.run.summary
    methods, claim = results["methods"], summary["guarantee"]
    lead = Markup("<p>{} methods flown under the same conditions. Scenario <code>{}</code>.</p>")
    lead = lead.format(len(methods), results["scenario"])
    names = {method["key"]: str(method["name"]) for method in methods}
    return Page(
        f"{results['title']}: comparison",
        lead + _tradeoffs(methods),
        (
            ("methods", "Methods compared", _methods(methods) + _protocol(results["protocol"])),
            ("claims", "What each method claims", _claims(methods)),
            ("paired", "Differences, run by run", _paired(results["paired"], names)),
            ("decisions", "Decisions of the run shown", _decisions(folder.path / "decisions.jsonl", names)),
            ("guarantee", "The guarantee of the schedule", guarantee_section(claim)),
            reading(results, NOTE),
        ),
        comparison_data(picture, claim["kind"] == "proved"),
        summary,
    )


def comparison_data(picture: ComparisonData, proved: bool) -> dict[str, Any]:
    """Return the plot data of a comparison; methods without flights are left out."""
    controllers: list[Actor] = []
    for method in (method for method in picture.table["methods"] if method["key"] in picture.shown):
        count, key, name = len(controllers), str(method["key"]), str(method["name"])
        controllers.append(Actor(key, name, name, *method_style(count), picture.shown[key], count < FIRST))
    envelopes = [one.flights for one in controllers[:FIRST] if np.isfinite(one.flights.nearest[0]).all()]
    least = [(float(one.nearest[0].min()), float(one.times[np.argmin(one.nearest[0])])) for one in envelopes]
    opened = (min(least)[1] if least else 0.0) or None  # not at the start
    bare = replace(picture.run.plot_data(), slices=None)
    return schedule_data(bare, controllers, proved, by="pilot", opened=opened)


def _tradeoffs(methods: Methods) -> Markup:
    """The figure of every method's gains and losses, within the page."""
    from ..figures.comparison import tradeoffs_png

    caption = (
        "What each method gains and loses: means over all runs with 95 % confidence bounds, a stroke for the"
        " worst run. Green: with a proof; red: without."
    )
    return Markup(macros().picture(base64.b64encode(tradeoffs_png(methods)).decode(), caption))


def _claim(method: Mapping[str, Any], reason: str = "") -> Cell:
    kind = str(method["guarantee"])
    return Cell(kind, kind, words=True, reason=reason, badge=kind)


def _methods(methods: Methods) -> Markup:
    measures = Measure.in_tables(*(method.get("metrics") or {} for method in methods))
    rows = []
    for method in methods:
        values, name = method.get("metrics") or {}, str(method["name"])
        note = "" if method.get("available", True) else " (not available)"
        cells = [one.cell(values[one.key], unit=False) if one.key in values else Cell("") for one in measures]
        warning = seldom_flown(method)
        named = Cell(name + note, name, lines=(warning,) if warning else ())
        rows.append([named, _claim(method, method.get("reach") or ""), *cells])
    caption = "Mean over runs, of violations the number of runs, with 95 % confidence bounds; changes to and"
    caption += " from filtered inputs count as switches; select a head to sort"
    return table(Table(caption, ["method", "guarantee", *(one.head for one in measures)], rows, sort=True))


def _protocol(protocol: Mapping[str, Any]) -> Markup:
    measures = [Measure.from_key(key) for key in protocol if key != "statement"]
    rows = [[Cell(one.title), value_cell(protocol[one.key], one.key, one.unit)] for one in measures]
    statement = protocol.get("statement")
    text = Markup("<p>{}</p>").format(statement) if statement else ""
    return Markup("<h3>How it was compared</h3>") + text + table(Table("Protocol", ["", "value"], rows))


def _claims(methods: Methods) -> Markup:
    rows = []
    for method in methods:
        claim = words(method.get("reach") or "none"), words(method.get("note") or "")
        rows.append([Cell(str(method["name"])), _claim(method), *claim])
    heads = ["method", "guarantee", "reach", "decisions by reason"]
    return table(Table("How far each claim goes", heads, rows))


def _paired(paired: Iterable[Mapping[str, Any]], names: Mapping[str, str]) -> Markup:
    """One table for each method that others are compared with: a row per method, a column per metric."""
    groups: dict[str, dict[str, dict[str, Cell]]] = {}
    for one in paired:
        cells = groups.setdefault(one["against"], {}).setdefault(one["method"], {})
        cells[one["metric"]] = _difference(one)
    tables = []
    for against, others in groups.items():
        keys = dict.fromkeys(key for cells in others.values() for key in cells)
        measures = [Measure.from_key(key) for key in keys]
        rows = []
        for key, cells in others.items():
            name = names.get(key, key)
            rows.append([Cell(name, name), *(cells.get(one.key, Cell("")) for one in measures)])
        caption = (
            f"Method minus {names.get(against, against)}, in the same runs; mean and 95 % confidence bounds;"
            " a difference whose bounds include 0 says so"
        )
        tables.append(table(Table(caption, ["method", *(one.head for one in measures)], rows, sort=True)))
    return Markup("\n").join(tables) or Markup("<p>None were computed.</p>")


def _difference(one: Mapping[str, Any]) -> Cell:
    low, high = one["low"], one["high"]
    bounds = {"mean": one["difference"], "low": low, "high": high}
    cell = Measure.from_key(one["metric"]).cell(bounds, difference=True)
    if low is None or high is None or low > 0 or high < 0 or low == high:
        return cell
    return replace(cell, lines=(*cell.lines, "bounds include 0"))


Decisions = list[dict[str, Any]]


def stretches(lines: Iterable[str]) -> dict[str, list[Decisions]]:
    """Decisions (JSON, one per line) by method, those in a row with the same mode and reason together."""
    rows: dict[str, Decisions] = {}
    for row in (parse_json(line) for line in lines if line.strip()):
        rows.setdefault(str(row["method"]), []).append(row)
    return {
        key: [list(group) for _, group in groupby(decisions, lambda row: (row["mode"], row.get("reason")))]
        for key, decisions in rows.items()
    }


def _decisions(path: Path, names: Mapping[str, str]) -> Markup:
    """Return the decisions of each online method, with their reasons."""
    if not path.is_file():
        return Markup("<p>This folder has no log of decisions.</p>")
    logged = stretches(read_text(path).split("\n"))
    logs = Markup("\n").join(details(names.get(key, key), _log(groups)) for key, groups in logged.items())
    return logs or Markup("<p>The log is empty.</p>")


def _log(groups: Sequence[Decisions]) -> Markup:
    rows = []
    for group in groups[:MOST_STRETCHES]:
        first, last = group[0], group[-1]
        least = min((one["margin"] for one in group if one.get("margin") is not None), default=None)
        margin = value_cell(least)
        if least is not None and np.isfinite(least):
            margin = Cell(directed(least, ".4g"), least)  # a share of clearance left is rounded down
        time = Cell(f"{number(first['t'])} to {number(last['t'])} s", first["t"])
        flies = words({0: "S", -1: "filtered"}.get(first["mode"], f"U ({first['mode']})"))
        rows.append([time, flies, value_cell(len(group)), margin, words(first.get("reason") or "none")])
    total, changes = sum(map(len, groups)), len(groups)
    heads = ["time", "who flies", "decisions", "least margin", "reason"]
    body = table(Table(f"{total} decisions in {changes} stretches of the same reason", heads, rows))
    notes = [f"and {changes - MOST_STRETCHES} more"] if changes > MOST_STRETCHES else []
    return body + (Markup(macros().items(notes)) if notes else "")
