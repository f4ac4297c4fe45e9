"""How results are printed: lines that no terminal breaks, and tables without rules."""

from collections.abc import Iterable, Mapping
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

RED = "bold red"


class Printout:
    """Prints to a console, by default to standard output."""

    def __init__(self, console: Console | None = None) -> None:
        self.console = console or Console(highlight=False)

    def say(self, text: str, style: str = "") -> None:
        """Print a line."""
        self.console.print(Text(text, style=style), soft_wrap=True)

    def table(self, shown: Table, width: int = 0) -> None:
        """Print a table, at least so wide: numbers that are cut off say nothing."""
        wide = Console(file=self.console.file, highlight=False, width=max(self.console.width, width))
        (wide if width else self.console).print(shown)

    def claim(self, claim: Mapping[str, Any]) -> None:
        """Print what is claimed, and on what assumptions."""
        self.say(f"Guarantee: {str(claim['kind']).replace('_', ' ')}; {claim['reason']}.", "bold")
        if claim.get("periods") and claim["kind"] == "per_period":
            covered = f"{claim['periods_covered']} of {claim['periods']} periods"
            self.say(f"That is {covered} of this flight, assuming that")
        self.assume(claim["assumptions"])

    def assume(self, assumptions: Iterable[str]) -> None:
        """Print assumptions, one a line."""
        for assumption in assumptions:
            self.say(f"  - {assumption}")


def table(*heads: str, words: int = 1, wrap: int = 99, rows: Iterable[tuple[str | Text, ...]] = ()) -> Table:
    """A table with columns of words, then of numbers; the first `wrap` may be broken; heads may be empty."""
    shown = Table(box=None, pad_edge=False, header_style="bold", show_header=any(heads))
    for k, head in enumerate(heads):
        shown.add_column(Text(head), justify="left" if k < words else "right", no_wrap=k >= wrap)
    for row in rows:
        shown.add_row(*row)
    return shown


def alarming(text: str, bad: bool) -> Text:
    """A text, in red if it tells of something bad."""
    return Text(text, style=RED if bad else "")
