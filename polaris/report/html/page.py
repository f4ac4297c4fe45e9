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
from string import Template
from typing import Any

from .tables import Measure, details, escaped, items

SCRIPTS = ("tables.js", "scene.js", "timelines.js", "main.js")


@dataclass(frozen=True)
class Page:
    """What a report says: title, HTML under it, sections (key, title, HTML), data for scripts, the summary.

    The scene and the timelines come first (if ``scene`` is drawn), definitions and versions last.
    """

    title: str
    lead: str
    sections: tuple[tuple[str, str, str], ...]
    data: dict[str, Any] = field(default_factory=dict)
    summary: Mapping[str, Any] = field(default_factory=dict)


def page_html(page: Page) -> str:
    """The whole file; it makes no connections, and runs no scripts but those that it was written with."""
    drawn = "scene" in page.data
    scripts = [plotly(), own_script()] if drawn else [own_script()]
    sections = [*([("flight", "The flight", resource("flight.html"))] if drawn else []), *page.sections]
    versions = ", ".join(f"{name} {version}" for name, version in page.summary.get("versions", {}).items())
    digests = (base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in scripts)
    made = escaped(page.summary.get("created", "an unknown date"))
    return Template(resource("page.html")).substitute(
        hashes=" ".join(f"'sha256-{digest}'" for digest in digests),
        title=escaped(page.title),
        style=resource("report.css"),
        lead=page.lead,
        links="".join(f'<li><a href="#{key}">{escaped(title)}</a></li>' for key, title, _ in sections),
        body="\n".join(
            f'<section id="{key}" aria-labelledby="{key}-h">\n<h2 id="{key}-h">{escaped(title)}</h2>\n{inner}'
            "\n</section>"
            for key, title, inner in sections
        ),
        footer=f"<p>Made by polaris report. Folder of {made}; {escaped(versions)}.</p>",
        data=script_json(page.data),
        scripts="\n".join(f"<script>{text}</script>" for text in scripts),
    )


def reading(summary: Mapping[str, Any], note: str = "") -> tuple[str, str, str]:
    """The section that says how to read the page: a note, and what each metric means, as the folder says."""
    told = summary.get("definitions", {})
    texts = items(f"{Measure.of(key).title} ({key}): {text}" for key, text in told.items())
    inner = f"<p>{note}</p>" if note else ""
    if told:
        inner += details("Definitions of the metrics", texts)
    return "reading", "How to read this", inner


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
