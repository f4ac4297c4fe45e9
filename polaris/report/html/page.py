"""One HTML file with everything in it: tables, data, scripts, plotly. It asks the network for nothing."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from typing import Any

from markupsafe import Markup

from .tables import Measure, macros, template

SCRIPTS = ("tables.js", "scene.js", "timelines.js", "main.js")


@dataclass(frozen=True)
class Page:
    """What a report says: title, HTML under it, sections (key, title, HTML), data for scripts, the summary.

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
    """The section that says how to read the page: a note, and what each metric means, as the folder says."""
    known = summary.get("definitions", {})
    told = [f"{Measure.of(key).title} ({key}): {text}" for key, text in known.items()]
    return "reading", "How to read this", Markup(macros().reading(note, told))


def script_json(data: Any) -> str:
    """JSON that is inert inside ``<script>``: no text in it can end the element."""
    text = json.dumps(data, allow_nan=False, ensure_ascii=False, separators=(",", ":"))
    for mark in ("<", ">", "&", "\u2028", "\u2029"):
        text = text.replace(mark, f"\\u{ord(mark):04x}")
    return text


def own_script() -> str:
    """The scripts of this package as one, with no names left in the page."""
    joined = "\n".join(resource(name) for name in SCRIPTS)
    return f'(function () {{\n"use strict";\n{joined}}})();'


def resource(name: str) -> str:
    """A file that comes along with this package."""
    return (files(__package__) / "static" / name).read_text(encoding="utf-8")


@cache
def plotly() -> str:
    """plotly.js, safe inside ``<script>``."""
    from plotly.offline import get_plotlyjs

    # HTML ends a script at these letters wherever they stand, in a string of the script too.
    return re.sub(r"</(script)", r"<\\/\1", get_plotlyjs(), flags=re.IGNORECASE)
