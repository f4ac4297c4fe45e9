"""What the command line shows of a campaign: a table of cases, and one run flown again."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

COLUMNS = (
    "mode",
    "runs",
    "violations",
    "probability, 95 %",
    "least distance",
    "its mean, 95 %",
    "share of U",
    "velocity change, 95 %",
)


def show_campaign(summary: Mapping[str, Any], folder: str, console: Console | None = None) -> None:
    """Print violations, distances, use of U and velocity change of every case and mode."""
    console = console or Console(highlight=False)
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("case", no_wrap=True)
    for name in COLUMNS:
        table.add_column(name, justify="right", no_wrap=True)
    for case in summary["cases"]:
        label = f"{case['case']}: {case['label']}"
        for mode, told in case.get("modes", {}).items():
            table.add_row(label, *_row(mode, told))
            label = ""
    widest = max(len(str(case["label"])) for case in summary["cases"])
    # Wide tables are not squeezed: numbers that are cut off say nothing.
    Console(file=console.file, highlight=False, width=max(console.width, widest + 145)).print(table)
    for case in summary["cases"]:
        if "failure" in case:
            text = f"{case['case']}: {case['label']}: no schedule. {case['failure']}"
            console.print(Text(text, style="bold red"), soft_wrap=True)
    for assumption in summary["assumptions"]:
        console.print(Text(f"  - {assumption}"), soft_wrap=True)
    console.print(Text(f"Campaign: {folder}"), soft_wrap=True)


def show_run(row: Mapping[str, Any], console: Console | None = None) -> None:
    """Print what the table says of one run."""
    console = console or Console(highlight=False)
    table = Table(box=None, pad_edge=False, show_header=False)
    for name, value in row.items():
        table.add_row(name, "-" if value is None else str(value))
    console.print(table)


def _row(mode: str, told: Mapping[str, Any]) -> list[Text]:
    chance, mean, worst = told["violation_probability"], told["mean"], told["worst"]
    style = "bold red" if told["violations"] else ""
    return [
        Text(mode),
        Text(f"{told['runs']:,}"),
        Text(f"{told['violations']:,}", style=style),
        Text(f"{chance['low']:.2g} to {chance['high']:.2g}", style=style),
        Text(_one(worst["min_distance_m"], "m")),
        Text(_interval(mean["min_distance_m"], "m")),
        Text(f"{mean['experimental_share']['mean']:.1%}"),
        Text(_interval(mean["delta_v_m_s"], "m/s")),
    ]


def _one(value: float | None, unit: str) -> str:
    return "-" if value is None else f"{value:.4g} {unit}"


def _interval(told: Mapping[str, float | None], unit: str) -> str:
    mean, high = told["mean"], told["high"]
    if mean is None:
        return "-"
    return f"{mean:.4g} {unit}" if high is None else f"{mean:.4g} +- {high - mean:.1g} {unit}"
