"""Printed summaries of a flight or a campaign of the inspection problem."""

from collections.abc import Mapping
from typing import Any

from rich.text import Text

from ...model.checks import counted
from ...runs.inspections.inspection import MEANING
from . import RED, alarming, say, show_claim, show_table, table


def show_flight(summary: Mapping[str, Any], folder: str) -> None:
    """Print the least value of every constraint, the answers of the filter, and what is claimed."""
    say(str(summary["title"]), "bold")
    crew = counted(summary["deputies"], "deputy", "deputies")
    found = table(f"{crew}, {summary['duration_s']:g} s", "least", "at", "deputies")
    for row in summary["constraints"]:
        found.add_row(
            f"{row['constraint']:6} {MEANING[row['constraint']][0]}",
            alarming(f"{row['least']:.4g} {row['unit']}", row["least"] < 0),
            f"{row['time_s']:g} s",
            ", ".join(map(str, row["deputies"])),
        )
    show_table(found)
    safe, steps, seconds = summary["safe"], summary["steps"], summary["filter_seconds"]
    say("No constraint is violated." if safe else "CONSTRAINTS ARE VIOLATED.", "" if safe else RED)
    total = sum(steps.values())
    told = ", ".join(f"{name} {count / total:.1%}" for name, count in steps.items() if count)
    say(f"Filter ({summary['filter']['kind']}): {told} of {total} answers.")
    say(f"Time of an answer: {1e3 * seconds['median']:.3g} ms, p99 {1e3 * seconds['p99']:.3g} ms.")
    spent = ", ".join(f"{value:.4g}" for value in summary["delta_v_m_s"])
    say(f"Velocity change per deputy: {spent} m/s.")
    tank, most = summary["delta_v_max_m_s"], max(summary["delta_v_m_s"])
    if most > tank:
        say(f"THE FUEL LIMIT IS EXCEEDED: {most:.4g} m/s of {tank:g} m/s, which no barrier keeps.", RED)
    smooth = summary.get("smoothness")
    if smooth:
        applied, wanted = (
            f"{one['switches']:.2g} and {one['variation']:.2g} N"
            for one in (smooth["applied"], smooth["wanted"])
        )
        say(f"Changes of sign and of thrust per axis and minute: {applied}; wanted {wanted}.")
    show_claim(summary["guarantee"])
    say(f"Run folder: {folder}")


def show_fuel(summary: Mapping[str, Any], folder: str) -> None:
    """Print what was spent, when the backup took over, and what is claimed."""
    say(str(summary["title"]), "bold")
    latched, last, least = summary["latched_at_s"], summary["last_thrust_s"], summary["distance_least_m"]
    rows = [
        ("velocity change", f"{summary['delta_v_m_s']:.4g} of {summary['delta_v_max_m_s']:g} m/s"),
        ("backup takes over", "never" if latched is None else f"at {latched:g} s"),
    ]
    if latched is not None:
        rows.append(("spent by then", f"{summary['delta_v_at_latch_m_s']:.4g} m/s"))
    rows += [
        ("last thrust", "none" if last is None else f"at {last:g} s"),
        ("least distance from the chief", f"{least:.4g} m at {summary['distance_least_time_s']:g} s"),
        ("semi-minor axis at the end", f"{summary['parking_orbit']['semi_minor_m']:.4g} m"),
    ]
    show_table(table("", "", rows=rows))
    if latched is not None:
        say(f"Why: {summary['latch_reason']}.")
    safe = summary["safe"]
    say("The fuel limit is kept." if safe else "THE FUEL LIMIT IS EXCEEDED.", "" if safe else RED)
    show_claim(summary["guarantee"])
    say(f"Run folder: {folder}")


def show_campaign(summary: Mapping[str, Any], folder: str) -> None:
    """Print the success of every study and what its failures were."""
    say(str(summary["title"]), "bold")
    kinds = sorted({kind for study in summary["studies"] for kind in study["failures"]})
    head = f"{counted(summary['runs'], 'run')} of {summary['duration_s']:g} s"
    found = table(head, "success", "at least, 95%", *kinds, wrap=0)
    for study in summary["studies"]:
        failures = [study["failures"].get(kind, 0) for kind in kinds]
        found.add_row(
            study["name"],
            f"{study['success_share']:.2%}",
            f"{study['success_share_lower_95']:.2%}",
            *(Text(str(count), style="red" if count else "") for count in failures),
        )
    show_table(found, 60 + 8 * len(kinds))
    show_claim(summary["guarantee"])
    say(f"Run folder: {folder}")
