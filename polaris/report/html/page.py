"""One HTML file with everything in it: tables, data, scripts, plotly. It asks the network for nothing.

Values are short, escaped, and never NaN, infinity or null in front of a reader.
"""

import base64
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined, Template
from markupsafe import Markup

from ...model.errors import escape_controls
from ..tables import Cell, Measure, Table
from .assets import own_script, plotly, resource

BADGES = {  # class and text of a badge, by kind of guarantee
    "proved": ("proved", "✓ proved"),
    "statistical": ("limited", "≈ statistical"),
    "per_period": ("limited", "≈ per period"),
    "by_prediction": ("limited", "≈ by prediction"),
    "all_time": ("proved", "✓ for all time"),
    "none": ("nothing", "✕ nothing proven"),
}

MOST = 4  # columns of a table that have room on any screen


@cache
def template(name: str) -> Template:
    """A template of this package; whatever is not markup already is escaped in it."""
    loader = PackageLoader("polaris.report.html", "static")
    options: dict[str, Any] = {"autoescape": True, "undefined": StrictUndefined, "finalize": _visible}
    return Environment(loader=loader, **options).get_template(name)


def macros(name: str = "parts.html") -> Any:
    """Return the macros of a template, as functions that give markup."""
    return template(name).module


def table(contents: Table) -> Markup:
    """Return a table as HTML."""
    parts = macros()

    def cell(one: Cell) -> Markup:
        return Markup(parts.cell(one, badge(one.badge) if one.badge else ""))

    return Markup(parts.table(contents, cell, len(contents.heads) > MOST))


def badge(kind: Any) -> Markup:
    """The kind of a guarantee, by colour, sign and word."""
    return Markup(macros().badge(*BADGES.get(str(kind), ("limited", str(kind)))))


def details(summary: str, inner: str) -> Markup:
    """A part that can be unfolded."""
    return Markup(macros().details(summary, inner))


@dataclass(frozen=True)
class Page:
    """Contents of a report: title, HTML under it, sections (key, title, HTML), plot data, the summary.

    The scene and the timelines come first (if ``scene`` is drawn), definitions and versions last.
    """

    title: str
    lead: str
    sections: tuple[tuple[str, str, Markup], ...]
    data: dict[str, Any] = field(default_factory=dict)
    summary: Mapping[str, Any] = field(default_factory=dict)


def page_html(page: Page) -> str:
    """The whole file; it makes no connections, and runs no scripts but those that it was written with."""
    drawn = "scene" in page.data
    scripts = [Markup(text) for text in ([plotly(), own_script()] if drawn else [own_script()])]
    flight = [("flight", "The flight", Markup(resource("flight.html")))] if drawn else []
    digests = (base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in scripts)
    return template("page.html").render(
        page=page,
        hashes=Markup(" ".join(f"'sha256-{digest}'" for digest in digests)),
        style=Markup(resource("report.css")),
        sections=[*flight, *page.sections],
        versions=", ".join(f"{name} {version}" for name, version in page.summary.get("versions", {}).items()),
        data=Markup(script_json(page.data)),
        scripts=scripts,
    )


def reading(summary: Mapping[str, Any], note: str = "") -> tuple[str, str, Markup]:
    """The section that says how to read the page: a note, and the folder's meaning of each metric."""
    definitions = summary.get("definitions", {})
    meanings = [f"{Measure.from_key(key).title} ({key}): {text}" for key, text in definitions.items()]
    return "reading", "How to read this", Markup(macros().reading(note, meanings))


def script_json(data: Any) -> str:
    """JSON that is inert inside ``<script>``: no text in it can end the element."""
    text = json.dumps(data, allow_nan=False, ensure_ascii=False, separators=(",", ":"))
    for mark in ("<", ">", "&"):
        text = text.replace(mark, f"\\u{ord(mark):04x}")
    return escape_controls(text)


def _visible(value: Any) -> Any:
    """Return a text without control characters, and anything else as it is."""
    return escape_controls(value) if type(value) is str else value
