"""Printing of results: lines that no terminal breaks, and tables without rules."""

from collections.abc import Iterable, Mapping
from typing import Any

from rich.console import Console
from rich.segment import Segment, Segments
from rich.table import Table
from rich.text import Text

from ...model.errors import escape_controls
from ...report.tables import Table as Cells

RED = "bold red"


def print_line(text: str, style: str = "") -> None:
    """Print a line; no terminal obeys a name in it."""
    Console(highlight=False).print(Text(escape_controls(text), style=style), soft_wrap=True)


def show_table(grid: Table, width: int = 0) -> None:
    """Print a table, at least so wide: numbers that are cut off say nothing."""
    console = Console(highlight=False)
    console.width = max(console.width, width)
    parts = (Segment(escape_controls(part.text), part.style, part.control) for part in console.render(grid))
    console.print(Segments(parts), end="")


def show_claim(claim: Mapping[str, Any]) -> None:
    """Print a guarantee of the inspection problem and its assumptions."""
    print_line(f"Guarantee: {str(claim['kind']).replace('_', ' ')}; {claim['reason']}.", "bold")
    if claim.get("periods") and claim["kind"] == "per_period":
        print_line(f"Periods covered: {claim['periods_covered']} of {claim['periods']} of this flight.")
    print_line("Assumptions:")
    assume(claim["assumptions"])


def assume(assumptions: Iterable[str]) -> None:
    """Print assumptions, one a line."""
    for assumption in assumptions:
        print_line(f"  - {assumption}")


def table(*heads: str, words: int = 1, wrap: int = 99, rows: Iterable[tuple[str | Text, ...]] = ()) -> Table:
    """Make a table with columns of words, then of numbers; the first `wrap` may break; heads may be empty."""
    grid = Table(box=None, pad_edge=False, header_style="bold", show_header=any(heads))
    for k, head in enumerate(heads):
        grid.add_column(Text(head), justify="left" if k < words else "right", no_wrap=k >= wrap)
    for row in rows:
        grid.add_row(*row)
    return grid


def show_cells(cells: Cells, width: int = 0) -> None:
    """Print a table that pages show, too; its caption is the head of the first column if that has none."""
    first, *heads = cells.heads
    grid = table(first or cells.caption, *heads)
    for column, cell in zip(grid.columns[1:], cells.rows[0][1:], strict=True):
        column.justify = "left" if cell.words else "right"
    for row in cells.rows:
        grid.add_row(*(warning_text(cell.text, cell.alarm) for cell in row))
    show_table(grid, width)


def warning_text(text: str, bad: bool) -> Text:
    """Return a text, in red if it tells of something bad."""
    return Text(text, style=RED if bad else "")
