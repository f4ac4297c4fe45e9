"""Printed summaries of a flight or a campaign of the inspection problem."""

from collections.abc import Mapping
from typing import Any

from ...model.checks import counted
from ...report.tables import constraints, studies
from . import RED, print_line, show_cells, show_claim, show_table, table


def show_flight(summary: Mapping[str, Any], folder: str) -> None:
    """Print the minimum of every constraint, the decisions of the filter, and the guarantee."""
    print_line(str(summary["title"]), "bold")
    print_line(f"{counted(summary['deputies'], 'deputy', 'deputies')}, {summary['duration_s']:g} s")
    show_cells(constraints(summary), 96)
    safe, steps, seconds = summary["safe"], summary["steps"], summary["filter_seconds"]
    print_line("No constraint is violated." if safe else "CONSTRAINTS ARE VIOLATED.", "" if safe else RED)
    total = sum(steps.values())
    answers = ", ".join(f"{name} {count / total:.1%}" for name, count in steps.items() if count)
    print_line(f"Filter ({summary['filter']['kind']}), {total} decisions: {answers}.")
    slow = f"99th percentile {1e3 * seconds['p99']:.3g} ms"
    print_line(f"Decision time: median {1e3 * seconds['median']:.3g} ms, {slow}.")
    delta_v = ", ".join(f"{value:.4g}" for value in summary["delta_v_m_s"])
    print_line(f"Delta-v per deputy: {delta_v} m/s.")
    tank, largest = summary["delta_v_max_m_s"], max(summary["delta_v_m_s"])
    if largest > tank:
        text = f"delta-v {largest:.4g} m/s of {tank:g} m/s; no barrier of this filter limits fuel"
        print_line(f"THE FUEL LIMIT IS EXCEEDED: {text}.", RED)
    smooth = summary.get("smoothness")
    if smooth:
        applied, desired = smooth["applied"], smooth["wanted"]
        text = f"{applied['switches']:.2g} sign changes and {applied['variation']:.2g} N of thrust variation"
        primary = f"{desired['switches']:.2g} and {desired['variation']:.2g} N"
        print_line(f"Chatter: {text} per axis and minute; primary controller: {primary}.")
    show_claim(summary["guarantee"])
    print_line(f"Run folder: {folder}")


def show_fuel(summary: Mapping[str, Any], folder: str) -> None:
    """Print the delta-v, the time at which the backup took over, and the guarantee."""
    print_line(str(summary["title"]), "bold")
    latched, last, least = summary["latched_at_s"], summary["last_thrust_s"], summary["distance_least_m"]
    rows = [
        ("delta-v", f"{summary['delta_v_m_s']:.4g} of {summary['delta_v_max_m_s']:g} m/s"),
        ("backup takes over", "never" if latched is None else f"at {latched:g} s"),
    ]
    if latched is not None:
        rows.append(("delta-v by then", f"{summary['delta_v_at_latch_m_s']:.4g} m/s"))
    rows += [
        ("last thrust", "none" if last is None else f"at {last:g} s"),
        ("minimum distance from the chief", f"{least:.4g} m at {summary['distance_least_time_s']:g} s"),
        ("semi-minor axis at the end", f"{summary['parking_orbit']['semi_minor_m']:.4g} m"),
    ]
    show_table(table("", "", rows=rows))
    if latched is not None:
        print_line(f"Reason of the takeover: {summary['latch_reason']}.")
    safe = summary["safe"]
    print_line("The fuel limit is kept." if safe else "THE FUEL LIMIT IS EXCEEDED.", "" if safe else RED)
    show_claim(summary["guarantee"])
    print_line(f"Run folder: {folder}")


def show_campaign(summary: Mapping[str, Any], folder: str) -> None:
    """Print the success rate of every study and the kinds of its failures."""
    print_line(str(summary["title"]), "bold")
    cells = studies(summary)
    print_line(cells.caption)
    show_cells(cells, 20 + 16 * len(cells.heads))
    show_claim(summary["guarantee"])
    print_line(f"Run folder: {folder}")
