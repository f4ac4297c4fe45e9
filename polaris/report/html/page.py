"""One HTML file with everything in it: tables, data, scripts, plotly. It asks the network for nothing.

Values are short, escaped, and never NaN, infinity or null in front of a reader.
"""

import base64
import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import markupsafe
import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined, Template
from markupsafe import Markup

from ...model.errors import escape_controls
from ...simulation.metrics import possible
from ...synthesis.safety.recoverable import directed
from .assets import own_script, plotly, resource

ABSENT = {
    "min_distance_m": ("none", "there is no unsafe set"),
    "min_distance_mean_m": ("none", "there is no unsafe set"),
    "min_ttc_s": ("∞", "no run was ever on a collision course"),
    "min_ttc_free_drift_s": ("∞", "no run was ever on a collision course with its thrusters off"),
    "max_thrust_ratio_safety": ("none", "this controller never flew"),
    "max_thrust_ratio_experimental": ("none", "this controller never flew"),
    "until_s": ("∞", "for all time"),
}
"""Meaning of null by key: see the table in ``docs/guarantees.md``."""

TITLES = {
    "runs": "simulated runs",
    "min_distance_m": "least distance to an unsafe set",
    "violations": "violations",
    "min_distance_mean_m": "least distance, mean over runs",
    "mean_distance_m": "distance, mean over time and runs",
    "min_ttc_s": "least time to collision, straight on",
    "min_ttc_free_drift_s": "least time to collision, free drift",
    "drift_horizon_s": "time that free drift is followed for",
    "experimental_share": "share of experimental control",
    "switches": "switches",
    "delta_v_m_s": "velocity change, mean",
    "delta_v_max_m_s": "velocity change, largest",
    "collided": "any run enters an unsafe set",
    "collided_runs": "runs that enter an unsafe set",
    "deviation": "input other than U's, mean",
    "max_thrust_ratio": "largest demand of thrust",
    "max_thrust_ratio_safety": "largest demand of thrust by S",
    "max_thrust_ratio_experimental": "largest demand of thrust by U",
    "decision_median_us": "time of a decision, median",
    "decision_p99_us": "time of a decision, 99th percentile",
    "synthesis_s": "time of synthesis",
}
"""Titles of metrics, in the order of tables."""

SUFFIXES = {"_m_s2": "m/s²", "_m_s": "m/s", "_us": "µs", "_ms": "ms", "_s": "s", "_m": "m", "_N": "N"}
BAD = ("collided", "collided_runs", "violations", "min_distance_m")
"""Metrics that tell of a collision: any that is true or above 0, and a distance that is negative."""

BADGES = {
    "proved": ("proved", "✓ proved"),
    "statistical": ("limited", "≈ statistical"),
    "per_period": ("limited", "≈ per period"),
    "by_prediction": ("limited", "≈ by prediction"),
    "all_time": ("proved", "✓ for all time"),
    "none": ("nothing", "✕ nothing proven"),
}
"""Class and text of a badge, by kind of guarantee."""

MOST = 4  # columns of a table that have room on any screen
ROUND_OFF = 1e-12  # values below this are what rounding leaves of a zero, in any unit of a metric
MOST_WHOLE = 1e7  # numbers below this have no exponent


@cache
def template(name: str) -> Template:
    """A template of this package; whatever is not markup already is escaped in it."""
    loader = PackageLoader("polaris.report.html", "static")
    how: dict[str, Any] = {"autoescape": True, "undefined": StrictUndefined, "finalize": _visible}
    return Environment(loader=loader, **how).get_template(name)


def macros(name: str = "parts.html") -> Any:
    """Its macros, as functions that give markup."""
    return template(name).module


def shown(value: Any, key: str = "", form: str = ".4g", unit: str = "") -> Markup:
    """A value of a file as HTML, numbers in a form with a unit; `ABSENT` says by key what null means."""
    after = f" {unit}".replace("^2", "²") if unit else ""
    if value is None:
        return _without_number(*ABSENT.get(key, ("none", "no value")))
    if isinstance(value, bool):
        return escape("yes" if value else "no")
    if isinstance(value, (list, tuple)):
        return Markup(", ").join(shown(item, key, form) for item in value) + (after if value else "")
    if isinstance(value, Mapping):
        parts = (
            escape(str(name).replace("_", " ") + " ") + shown(one, key, form) for name, one in value.items()
        )
        return Markup(", ").join(parts) + (after if value else "")
    if not isinstance(value, (int, float)):
        return escape(str(value))
    if np.isnan(value):
        return _without_number("none", "no value")
    if np.isinf(value):
        return _without_number(*(("∞", "infinite") if value > 0 else ("−∞", "minus infinite")))
    if form == ".4g":
        return escape(number(value) + after)
    return escape(f"{value:{form}}" + after)


def number(value: float) -> str:
    """A number with four digits, whole ones with all; what rounding leaves of a zero is 0."""
    if isinstance(value, int):
        return f"{value:d}"
    if abs(value) < ROUND_OFF:
        return "0"
    return f"{value:.0f}" if 1e4 <= abs(value) < MOST_WHOLE else f"{value:.4g}"


def _without_number(text: str, why: str) -> Markup:
    return Markup(macros().without_number(text, why))


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


@dataclass(frozen=True)
class Cell:
    """One cell: HTML, what it is sorted by (None comes last), whether it tells of what must not happen."""

    html: str
    sort: float | str | None = None
    bad: bool = False
    text: bool = False


def text_cell(text: Any) -> Cell:
    """A cell with text from a file."""
    return Cell(escape(str(text)), str(text), text=True)


def number_cell(value: Any, key: str = "", form: str = ".4g", unit: str = "") -> Cell:
    """A cell with a value of a file; see `shown`."""
    return Cell(shown(value, key, form, unit), value if _is_number(value) and value == value else None)


@dataclass(frozen=True)
class Measure:
    """A metric: its key, title and unit, and whether it is a share, shown in per cent."""

    key: str
    title: str
    unit: str
    percent: bool

    @classmethod
    def of(cls, key: str) -> "Measure":
        """From its key, whose end names the unit; metrics nobody has heard of are shown too."""
        share = key.endswith("_share") or "_ratio" in key
        suffix = "" if share else next((end for end in SUFFIXES if key.endswith(end)), "")
        title = TITLES.get(key, key.removesuffix(suffix).replace("_", " "))
        return cls(key, title, "%" if share else SUFFIXES.get(suffix, ""), share)

    @classmethod
    def known(cls, *tables: Mapping[str, Any]) -> list["Measure"]:
        """All that occur in some tables, in the order of `TITLES`; those nobody has heard of last."""
        keys = {key for table in tables for key in table}
        return [cls.of(key) for key in (*(key for key in TITLES if key in keys), *sorted(keys - set(TITLES)))]

    @property
    def head(self) -> str:
        """Title with the unit."""
        return f"{self.title} ({self.unit})" if self.unit else self.title

    def text(self, value: Any, unit: bool = True, proven: bool = False) -> str:
        """A value as HTML; one that is proven to be left is rounded down."""
        told = self.unit if unit else ""
        if proven and _is_number(value) and np.isfinite(value):
            text = directed(value, ".1%")[:-1] if self.percent else directed(value, ".4g")
            return f"{text} {told}" if unit else text
        if self.percent and _is_number(value):
            return shown(100.0 * value, self.key, ".1f", told)
        return shown(value, self.key, ".4g", told)

    def cell(self, value: Any, unit: bool = True, difference: bool = False) -> Cell:
        """A value, or a mean with its bounds, as a cell, marked if it tells of a collision."""
        if not isinstance(value, Mapping):
            return Cell(self.text(value, unit), number_cell(value).sort, not difference and self._bad(value))
        mean, low, high, worst = (value.get(name) for name in ("mean", "low", "high", "worst"))
        least, most = possible(self.key, difference)  # folders of older versions know no limits
        low, high = (None if v is None else min(max(v, least), most) for v in (low, high))
        told = escape(self.text(mean, unit=False))
        if low is not None or high is not None:
            told += macros().range(escape(self.text(low, False)) + " to " + self.text(high, False))
        if worst is not None and self.key != "violations":  # a count over all runs: there is no worst one
            told += macros().range(escape("worst ") + self.text(worst, False))
        bad = not difference and self._bad(mean if worst is None else worst)
        return Cell(told, number_cell(mean).sort, bad)

    def _bad(self, value: Any) -> bool:
        if self.key not in BAD or value is None:
            return False
        return bool(value < 0) if self.key.endswith("_m") else bool(value > 0)


def table(caption: str, heads: Sequence[str], rows: Iterable[Sequence[Cell]], sort: bool = False) -> Markup:
    """A table whose first column names the rows."""
    return Markup(macros().table(caption, heads, list(rows), sort, len(heads) > MOST))


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
    """The section that says how to read the page: a note, and what each metric means, as the folder says."""
    known = summary.get("definitions", {})
    told = [f"{Measure.of(key).title} ({key}): {text}" for key, text in known.items()]
    return "reading", "How to read this", Markup(macros().reading(note, told))


def script_json(data: Any) -> str:
    """JSON that is inert inside ``<script>``: no text in it can end the element."""
    text = json.dumps(data, allow_nan=False, ensure_ascii=False, separators=(",", ":"))
    for mark in ("<", ">", "&"):
        text = text.replace(mark, f"\\u{ord(mark):04x}")
    return escape_controls(text)


def escape(value: Any) -> Markup:
    """Return a text that HTML shows as it is."""
    return markupsafe.escape(value if isinstance(value, Markup) else _visible(str(value)))


def _visible(value: Any) -> Any:
    """Return a text without control characters, and anything else as it is."""
    return escape_controls(value) if type(value) is str else value
