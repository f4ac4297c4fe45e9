"""One HTML file with everything in it: tables, data, scripts, plotly. It asks the network for nothing."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from typing import Any

from .html import section
from .numbers import escaped, script_json

SCRIPTS = ("tables.js", "scene.js", "timelines.js", "main.js")


@dataclass(frozen=True)
class Page:
    """What a report says.

    Attributes
    ----------
    title : str
        Of the scenario; escaped when the page is written.
    lead : str
        HTML right under the title.
    sections : tuple of (key, title, HTML)
        In the order of the page; the scene and the timelines come first, if there are any.
    data : dict
        What the scripts draw; without ``scene`` nothing is drawn.
    footer : str
        HTML at the end.
    """

    title: str
    lead: str
    sections: tuple[tuple[str, str, str], ...]
    data: dict[str, Any] = field(default_factory=dict)
    footer: str = ""


def page_html(page: Page) -> str:
    """The whole file."""
    data = script_json(page.data)
    drawn = "scene" in page.data
    scripts = [plotly(), own_script()] if drawn else [own_script()]
    sections = [*([("flight", "The flight", resource("flight.html"))] if drawn else []), *page.sections]
    links = "".join(f'<li><a href="#{key}">{escaped(title)}</a></li>' for key, title, _ in sections)
    body = "\n".join(section(key, title, inner) for key, title, inner in sections)
    return "\n".join(
        [
            "<!DOCTYPE html>",
            '<html lang="en">',
            "<head>",
            '<meta charset="utf-8">',
            f'<meta http-equiv="Content-Security-Policy" content="{policy(scripts)}">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            '<link rel="icon" href="data:,">',
            f"<title>{escaped(page.title)} - Polaris report</title>",
            f"<style>\n{resource('report.css')}</style>",
            "</head>",
            "<body>",
            f"<header>\n<h1>{escaped(page.title)}</h1>\n{page.lead}\n"
            f'<nav aria-label="Parts of this report"><ul>{links}</ul></nav>\n</header>',
            f"<main>\n{body}\n</main>",
            f"<footer>{page.footer}</footer>",
            f'<script type="application/json" id="data">{data}</script>',
            *[f"<script>{text}</script>" for text in scripts],
            "</body>",
            "</html>",
            "",
        ]
    )


def policy(scripts: Sequence[str]) -> str:
    """Content Security Policy: no connections, and no scripts but those that this page was written with."""
    hashes = " ".join(f"'sha256-{_digest(text)}'" for text in scripts)
    return (
        f"default-src 'none'; connect-src 'none'; script-src {hashes}; style-src 'unsafe-inline'; "
        "img-src data: blob:; base-uri 'none'; form-action 'none'"
    )


def _digest(text: str) -> str:
    return base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


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
