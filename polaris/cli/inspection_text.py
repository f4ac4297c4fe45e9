"""What the command line shows of the inspection problem: tables of what a flight or a campaign came to."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from ..model.checks import counted
from ..runs.inspection_summary import MEANING


def show_flight(summary: Mapping[str, Any], folder: str, console: Console | None = None) -> None:
    """Print the least value of every constraint, the answers of the filter, and what is claimed."""
    console = console or Console(highlight=False)
    console.print(Text(str(summary["title"]), style="bold"))
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column(f"{counted(summary['deputies'], 'deputy', 'deputies')}, {summary['duration_s']:g} s")
    for name in ("least", "at", "deputies"):
        table.add_column(name, justify="right")
    for row in summary["constraints"]:
        bad = row["least"] < 0
        table.add_row(
            f"{row['constraint']:6} {MEANING[row['constraint']][0]}",
            Text(f"{row['least']:.4g} {row['unit']}", style="bold red" if bad else ""),
            f"{row['time_s']:g} s",
            ", ".join(map(str, row["deputies"])),
        )
    console.print(table)
    verdict = "No constraint is violated." if summary["safe"] else "CONSTRAINTS ARE VIOLATED."
    console.print(Text(verdict, style="" if summary["safe"] else "bold red"))
    steps, seconds = summary["steps"], summary["filter_seconds"]
    total = sum(steps.values())
    told = ", ".join(f"{name} {count / total:.1%}" for name, count in steps.items() if count)
    console.print(Text(f"Filter ({summary['filter']['kind']}): {told} of {total} answers."))
    console.print(
        Text(f"Time of an answer: {1e3 * seconds['median']:.3g} ms, p99 {1e3 * seconds['p99']:.3g} ms.")
    )
    spent = ", ".join(f"{value:.4g}" for value in summary["delta_v_m_s"])
    console.print(Text(f"Velocity change per deputy: {spent} m/s."))
    show_claim(summary["guarantee"], console)
    console.print(Text(f"Run folder: {folder}"), soft_wrap=True)


def show_fuel(summary: Mapping[str, Any], folder: str, console: Console | None = None) -> None:
    """Print what was spent, when the backup took over, and what is claimed."""
    console = console or Console(highlight=False)
    console.print(Text(str(summary["title"]), style="bold"))
    latched, orbit = summary["latched_at_s"], summary["parking_orbit"]
    rows = [
        ("velocity change", f"{summary['delta_v_m_s']:.4g} of {summary['delta_v_max_m_s']:g} m/s"),
        ("backup takes over", "never" if latched is None else f"at {latched:g} s"),
    ]
    if latched is not None:
        rows.append(("spent by then", f"{summary['delta_v_at_latch_m_s']:.4g} m/s"))
    last = summary["last_thrust_s"]
    rows += [
        ("last thrust", "none" if last is None else f"at {last:g} s"),
        (
            "least distance from the chief",
            f"{summary['distance_least_m']:.4g} m at {summary['distance_least_time_s']:g} s",
        ),
        ("semi-minor axis at the end", f"{orbit['semi_minor_m']:.4g} m"),
    ]
    table = Table(box=None, pad_edge=False, show_header=False)
    table.add_column()
    table.add_column(justify="right")
    for row in rows:
        table.add_row(*row)
    console.print(table)
    if latched is not None:
        console.print(Text(f"Why: {summary['latch_reason']}."), soft_wrap=True)
    verdict = "The fuel limit is kept." if summary["safe"] else "THE FUEL LIMIT IS EXCEEDED."
    console.print(Text(verdict, style="" if summary["safe"] else "bold red"))
    show_claim(summary["guarantee"], console)
    console.print(Text(f"Run folder: {folder}"), soft_wrap=True)


def show_claim(claim: Mapping[str, Any], console: Console) -> None:
    """Print what is claimed, and on what assumptions."""
    kind = str(claim["kind"]).replace("_", " ")
    console.print(Text(f"Guarantee: {kind}; {claim['reason']}.", style="bold"), soft_wrap=True)
    if claim.get("periods") and claim["kind"] == "per_period":
        covered = f"{claim['periods_covered']} of {claim['periods']} periods"
        console.print(Text(f"That is {covered} of this flight, assuming that"), soft_wrap=True)
    for assumption in claim["assumptions"]:
        console.print(Text(f"  - {assumption}"), soft_wrap=True)


def show_campaign(summary: Mapping[str, Any], folder: str, console: Console | None = None) -> None:
    """Print the success of every study and what its failures were."""
    console = console or Console(highlight=False)
    console.print(Text(str(summary["title"]), style="bold"))
    kinds = sorted({kind for study in summary["studies"] for kind in study["failures"]})
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column(f"{counted(summary['runs'], 'run')} of {summary['duration_s']:g} s", no_wrap=True)
    for name in ("success", "at least, 95%", *kinds):
        table.add_column(name, justify="right", no_wrap=True)
    for study in summary["studies"]:
        failures = [study["failures"].get(kind, 0) for kind in kinds]
        table.add_row(
            study["name"],
            f"{study['success_share']:.2%}",
            f"{study['success_share_lower_95']:.2%}",
            *(Text(str(count), style="red" if count else "") for count in failures),
        )
    # Wide tables are not squeezed: numbers that are cut off say nothing.
    wide = Console(file=console.file, highlight=False, width=max(console.width, 60 + 8 * len(kinds)))
    wide.print(table)
    show_claim(summary["guarantee"], console)
    console.print(Text(f"Run folder: {folder}"), soft_wrap=True)
