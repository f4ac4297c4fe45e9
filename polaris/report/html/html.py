"""Pieces of HTML: tables, badges, lists. Every text from a file is escaped here."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from .numbers import escaped, shown

BADGES = {
    "proved": ("proved", "✓ proved"),
    "statistical": ("limited", "≈ statistical"),
    "per_period": ("limited", "≈ per period"),
    "by_prediction": ("limited", "≈ by prediction"),
    "none": ("nothing", "✕ nothing proven"),
}
"""Class and text of a badge, by kind of guarantee."""

MOST = 4
"""Columns of a table that have room on any screen."""


@dataclass(frozen=True)
class Cell:
    """One cell of a table.

    Attributes
    ----------
    html : str
        Contents, escaped already.
    sort : float, str or None
        What the column is sorted by; None comes last, whichever way.
    bad : bool
        Whether it tells of something that must not happen.
    text : bool
        Whether it is a text, set to the left.
    """

    html: str
    sort: float | str | None = None
    bad: bool = False
    text: bool = False


def text_cell(text: Any) -> Cell:
    """A cell with text from a file."""
    return Cell(escaped(text), str(text), text=True)


def number_cell(value: Any, key: str = "", form: str = ".4g", unit: str = "") -> Cell:
    """A cell with a value of a file; see `numbers.shown`."""
    plain = isinstance(value, (int, float)) and not isinstance(value, bool)
    return Cell(shown(value, key, form, unit), value if plain and value == value else None)


def table(caption: str, heads: Sequence[str], rows: Iterable[Sequence[Cell]], sort: bool = False) -> str:
    """A table whose first column names the rows; where it has no room its rows become cards.

    Parameters
    ----------
    caption, heads : str
        Escaped here.
    rows : iterable of sequences of Cell
    sort : bool
        Whether readers can sort it by each column.
    """
    rows = list(rows)
    told = []
    for column, head in enumerate(heads):
        text = f'<button type="button">{escaped(head)}</button>' if sort else escaped(head)
        left = ' class="text"' if rows and rows[0][column].text else ""
        told.append(f'<th scope="col"{left}>{text}</th>')
    body = "\n".join(
        "<tr>" + "".join(_cell(*one) for one in zip(row, heads, range(len(row)), strict=True)) + "</tr>"
        for row in rows
    )
    kinds = [name for name, wanted in (("sortable", sort), ("wide", len(heads) > MOST)) if wanted]
    kind = f' class="{" ".join(kinds)}"' if kinds else ""
    return (
        f'<div class="scroll" role="region" tabindex="0" aria-label="{escaped(caption)}">'
        f"<table{kind}><caption>{escaped(caption)}</caption>"
        f"<thead><tr>{''.join(told)}</tr></thead>\n<tbody>\n{body}\n</tbody></table></div>"
    )


def _cell(cell: Cell, head: str, column: int) -> str:
    sort = "" if cell.sort is None else escaped(cell.sort)
    names = " ".join(name for name, wanted in (("bad", cell.bad), ("text", cell.text)) if wanted)
    kind = f' class="{names}"' if names else ""
    if column == 0:
        return f'<th scope="row"{kind} data-sort="{sort}">{cell.html}</th>'
    return f'<td{kind} data-sort="{sort}" data-head="{escaped(head)}">{cell.html}</td>'


def badge(kind: Any) -> str:
    """The kind of a guarantee, by colour, sign and word."""
    look, text = BADGES.get(str(kind), ("limited", escaped(kind)))
    return f'<span class="badge {look}">{text}</span>'


def items(texts: Iterable[Any]) -> str:
    """A list of texts."""
    return "<ul>" + "".join(f"<li>{escaped(text)}</li>" for text in texts) + "</ul>"


def section(key: str, title: str, inner: str) -> str:
    """A part of the page, under a heading."""
    head = f'<h2 id="{key}-h">{escaped(title)}</h2>'
    return f'<section id="{key}" aria-labelledby="{key}-h">\n{head}\n{inner}\n</section>'
