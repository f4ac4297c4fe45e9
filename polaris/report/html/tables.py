"""Values, tables and lists as HTML: short, escaped, and never NaN, infinity or null in front of a reader."""

from __future__ import annotations

import html
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...simulation.metrics import possible
from ...synthesis.recoverable import directed

ABSENT = {
    "min_distance_m": ("none", "there is no unsafe set"),
    "min_distance_mean_m": ("none", "there is no unsafe set"),
    "min_ttc_s": ("∞", "no run was ever on a collision course"),
    "min_ttc_free_drift_s": ("∞", "no run was ever on a collision course with its thrusters off"),
    "max_thrust_ratio_safety": ("none", "this controller never flew"),
    "max_thrust_ratio_experimental": ("none", "this controller never flew"),
    "until_s": ("∞", "for all time"),
}
"""What null says, by key: see the table in ``docs/guarantees.md``."""

TITLES = {
    "runs": "simulated runs",
    "min_distance_m": "least distance to an unsafe set",
    "violations": "violations",
    "min_distance_mean_m": "least distance, mean over runs",
    "mean_distance_m": "distance, mean over time and runs",
    "min_ttc_s": "least time to collision, straight on",
    "min_ttc_free_drift_s": "least time to collision, free drift",
    "drift_horizon_s": "free drift is looked at for",
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
"""What metrics are called, in the order of tables."""

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


# -- values -----------------------------------------------------------------------------------------


def escaped(text: Any) -> str:
    """Text from a file as HTML, in elements and in attributes."""
    return html.escape(str(text), quote=True)


def shown(value: Any, key: str = "", form: str = ".4g", unit: str = "") -> str:
    """A value of a file as HTML, numbers in a form with a unit; `ABSENT` says by key what null means."""
    after = f" {unit}" if unit else ""
    if value is None:
        return _without_number(*ABSENT.get(key, ("none", "no value")))
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, (list, tuple)):
        return ", ".join(shown(item, key, form) for item in value) + (after if value else "")
    if not isinstance(value, (int, float)):
        return escaped(value)
    if np.isnan(value):
        return _without_number("none", "no value")
    if np.isinf(value):
        return _without_number(*(("∞", "infinite") if value > 0 else ("−∞", "minus infinite")))
    return (f"{value:d}" if isinstance(value, int) and form == ".4g" else f"{value:{form}}") + after


def _without_number(text: str, why: str) -> str:
    return f'<span class="none" title="{escaped(why)}">{text}</span>'


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


# -- cells ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Cell:
    """One cell: HTML, what it is sorted by (None comes last), whether it tells of what must not happen."""

    html: str
    sort: float | str | None = None
    bad: bool = False
    text: bool = False


def text_cell(text: Any) -> Cell:
    """A cell with text from a file."""
    return Cell(escaped(text), str(text), text=True)


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
    def of(cls, key: str) -> Measure:
        """From its key, whose end names the unit; metrics nobody has heard of are shown too."""
        share = key.endswith("_share") or "_ratio" in key
        suffix = "" if share else next((end for end in SUFFIXES if key.endswith(end)), "")
        title = TITLES.get(key, key.removesuffix(suffix).replace("_", " "))
        return cls(key, title, "%" if share else SUFFIXES.get(suffix, ""), share)

    @classmethod
    def known(cls, *tables: Mapping[str, Any]) -> list[Measure]:
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
        told = self.text(mean, unit=False)
        if low is not None or high is not None:
            told += f'<span class="range">{self.text(low, False)} to {self.text(high, False)}</span>'
        if worst is not None and self.key != "violations":  # a count over all runs: there is no worst one
            told += f'<span class="range">worst {self.text(worst, False)}</span>'
        bad = not difference and self._bad(mean if worst is None else worst)
        return Cell(told, number_cell(mean).sort, bad)

    def _bad(self, value: Any) -> bool:
        if self.key not in BAD or value is None:
            return False
        return bool(value < 0) if self.key.endswith("_m") else bool(value > 0)


# -- tables and lists -------------------------------------------------------------------------------


def table(caption: str, heads: Sequence[str], rows: Iterable[Sequence[Cell]], sort: bool = False) -> str:
    """A table whose first column names the rows; caption and heads are escaped here."""
    rows = list(rows)
    told = []
    for column, head in enumerate(heads):
        text = f'<button type="button">{escaped(head)}</button>' if sort else escaped(head)
        told.append(f'<th scope="col"{_classes(text=bool(rows) and rows[0][column].text)}>{text}</th>')
    body = "\n".join(
        "<tr>" + "".join(_cell(*one) for one in zip(row, heads, range(len(row)), strict=True)) + "</tr>"
        for row in rows
    )
    return (
        f'<div class="scroll" role="region" tabindex="0" aria-label="{escaped(caption)}">'
        f"<table{_classes(sortable=sort, wide=len(heads) > MOST)}><caption>{escaped(caption)}</caption>"
        f"<thead><tr>{''.join(told)}</tr></thead>\n<tbody>\n{body}\n</tbody></table></div>"
    )


def _cell(cell: Cell, head: str, column: int) -> str:
    tag, more = ("td", f' data-head="{escaped(head)}"') if column else ("th", "")
    kind = _classes(bad=cell.bad, text=cell.text)
    sort = "" if cell.sort is None else escaped(cell.sort)
    scope = "" if column else ' scope="row"'
    return f'<{tag}{scope}{kind} data-sort="{sort}"{more}>{cell.html}</{tag}>'


def _classes(**wanted: bool) -> str:
    names = " ".join(name for name, one in wanted.items() if one)
    return f' class="{names}"' if names else ""


def badge(kind: Any) -> str:
    """The kind of a guarantee, by colour, sign and word."""
    look, text = BADGES.get(str(kind), ("limited", escaped(kind)))
    return f'<span class="badge {look}">{text}</span>'


def items(texts: Iterable[Any]) -> str:
    """A list of texts."""
    return "<ul>" + "".join(f"<li>{escaped(text)}</li>" for text in texts) + "</ul>"


def details(summary: str, inner: str) -> str:
    """A part that can be unfolded."""
    return f"<details><summary>{escaped(summary)}</summary>{inner}</details>"
