"""Printed summaries of a run of a schedule and of a campaign of such runs."""

from collections.abc import Mapping
from typing import Any

from rich.text import Text

from ...model.checks import counted
from ...report.sentences import goal, reach, synthesis
from ...report.tables import BRIEF, metrics
from ...runs.files.tables import besides
from . import RED, assume, print_line, show_cells, show_table, table, warning_text


def show_summary(summary: Mapping[str, Any], folder: str) -> None:
    """Print the metrics, the guarantee with its assumptions, and where the folder lies."""
    print_line(str(summary["title"]), "bold")
    show_cells(metrics(summary, f"{counted(summary['polaris']['runs'], 'simulated run')} each", BRIEF))
    claim = summary["guarantee"]
    for head, sentence in synthesis(summary):
        print_line(f"{head}: {sentence}.")
    proved = claim["kind"] != "none"
    verdict = f"Guarantee: {claim['kind']}, safe {reach(claim)} ({claim['reason']})."
    print_line(f"{verdict} Assumptions:" if proved else verdict, "bold" if claim["kind"] == "proved" else RED)
    assume(claim["assumptions"] if proved else ())
    if proved:
        print_line(f"Goal: {goal(claim)}")
    for head, sentence in besides(claim) if proved else ():
        print_line(f"{head}: {sentence}")
    print_line(f"Run folder: {folder}")


COLUMNS: tuple[str, ...] = ("mode", "guarantee", "runs", "violations", "probability, 95 %", "min. distance")
COLUMNS += ("mean min. distance, 95 %", "share of U", "delta-v, 95 %")


def show_campaign(summary: Mapping[str, Any], folder: str) -> None:
    """Print violations, distances, use of U and delta-v of every case and mode."""
    grid = table("case", *COLUMNS, wrap=0)
    for case in summary["cases"]:
        label = f"{case['case']}: {case['label']}"
        for mode, entry in case.get("modes", {}).items():
            grid.add_row(label, *_row(mode, entry))
            label = ""
    show_table(grid, max(len(str(case["label"])) for case in summary["cases"]) + 158)
    for case in summary["cases"]:
        if "failure" in case:
            print_line(f"{case['case']}: {case['label']}: no schedule. {case['failure']}", RED)
    assume(summary["assumptions"])
    print_line(f"Campaign: {folder}")


def show_run(row: Mapping[str, Any]) -> None:
    """Print the row of one run, a value per line."""
    rows = ((name, "-" if value is None else str(value)) for name, value in row.items())
    show_table(table("", "", rows=rows))


def _row(mode: str, entry: Mapping[str, Any]) -> list[Text]:
    chance, mean, worst = entry["violation_probability"], entry["mean"], entry["worst"]
    bad = entry["violations"] > 0
    return [
        Text(mode),
        Text(entry["guarantee"]),
        Text(f"{entry['runs']:,}"),
        warning_text(f"{entry['violations']:,}", bad),
        warning_text(f"{chance['low']:.2g} to {chance['high']:.2g}", bad),
        Text("-" if worst["min_distance_m"] is None else f"{worst['min_distance_m']:.4g} m"),
        Text(_interval(mean["min_distance_m"], "m")),
        Text(f"{mean['experimental_share']['mean']:.1%}"),
        Text(_interval(mean["delta_v_m_s"], "m/s")),
    ]


def _interval(entry: Mapping[str, float | None], unit: str) -> str:
    mean, high = entry["mean"], entry["high"]
    if mean is None:
        return "-"
    return f"{mean:.4g} {unit}" if high is None else f"{mean:.4g} +- {high - mean:.1g} {unit}"
