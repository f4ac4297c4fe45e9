"""What the command line shows of a campaign: a table of cases, and one run flown again."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.text import Text

from .printing import RED, Printout, alarming, plain, table

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
    out, found = Printout(console), table("case", *COLUMNS, wrap=False)
    for case in summary["cases"]:
        label = f"{case['case']}: {case['label']}"
        for mode, told in case.get("modes", {}).items():
            found.add_row(label, *_row(mode, told))
            label = ""
    out.table(found, max(len(str(case["label"])) for case in summary["cases"]) + 145)
    for case in summary["cases"]:
        if "failure" in case:
            out.say(f"{case['case']}: {case['label']}: no schedule. {case['failure']}", RED)
    out.assume(summary["assumptions"])
    out.say(f"Campaign: {folder}")


def show_run(row: Mapping[str, Any], console: Console | None = None) -> None:
    """Print what the table says of one run."""
    Printout(console).table(
        plain((name, "-" if value is None else str(value)) for name, value in row.items())
    )


def _row(mode: str, told: Mapping[str, Any]) -> list[Text]:
    chance, mean, worst = told["violation_probability"], told["mean"], told["worst"]
    bad = told["violations"] > 0
    return [
        Text(mode),
        Text(f"{told['runs']:,}"),
        alarming(f"{told['violations']:,}", bad),
        alarming(f"{chance['low']:.2g} to {chance['high']:.2g}", bad),
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
