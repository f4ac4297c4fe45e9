"""Printed summaries of a comparison of run-time methods and of a trade-off."""

import shlex
from collections.abc import Mapping
from typing import Any

from rich.text import Text

from ...model.checks import counted
from ...report.tables import seldom_flown
from ...synthesis.safety.recoverable import directed
from . import RED, print_line, show_table, table

SAFETY = {  # metrics of the first table, and their heads
    "violations": "violations",
    "min_distance_m": "min.\ndist. m",
    "mean_distance_m": "mean\ndist. m",
    "min_ttc_s": "min.\nTTC s",
    "min_ttc_free_drift_s": "min. drift\nTTC s",
}
COST = {  # metrics of the second table, and their heads
    "experimental_share": "share\nof U",
    "switches": "switches",
    "delta_v_m_s": "delta-v\nm/s",
    "deviation": "deviation",
    "decision_median_us": "decision\nmedian\nµs",
    "decision_p99_us": "decision\np99\nµs",
    "synthesis_s": "offline\ns",
}
LEAST = ("min_distance_m", "min_ttc_s", "min_ttc_free_drift_s")


def show_comparison(summary: Mapping[str, Any], folder: str) -> None:
    """Print the comparison as two tables, and the path of its folder."""
    print_line(f"{summary['title']}: {counted(summary['protocol']['runs'], 'run')} per method", "bold")
    available = [method for method in summary["methods"] if method["available"]]
    for labels, columns in ((("method", "guarantee"), SAFETY), (("method",), COST)):
        grid = table(*labels, *columns.values(), words=len(labels), wrap=1)
        for method in available:
            words = (Text(str(method["name"])), Text(str(method["guarantee"])))[: len(labels)]
            grid.add_row(*words, *(_cell(key, method["metrics"].get(key)) for key in columns))
        show_table(grid)
        print_line("")
    print_line("Distance and time to collision (TTC): minimum of all runs. Other columns: means over runs.")
    print_line("Deviation: 2-norm of applied minus U's desired input, in N for a spacecraft.")
    print_line("Switches: between S and U, and to and from filtered inputs.")
    print_line("95 % intervals and paired differences: see comparison.json or the report.")
    for method in summary["methods"]:
        if warning := seldom_flown(method):
            print_line(f"warning: {method['name']}: {warning}", RED)
        if not method["available"]:
            print_line(f"not applicable: {method['key']} ({method['reach']})")
    print_line(f"Comparison folder: {folder}")
    print_line(f"Interactive report: polaris report {shlex.quote(folder)}")


def _cell(key: str, entry: Any) -> str:
    if not isinstance(entry, dict):
        return "-" if entry is None else _number(entry)
    value = entry["worst" if key in LEAST else "mean"]
    if key == "violations":
        return str(value)
    return ("none" if key in LEAST else "-") if value is None else _number(value)


def _number(value: float) -> str:
    """Three digits; thousands written out, less than a thousandth as 0."""
    if abs(value) < 1e-3:
        return "0"
    return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.3g}"


HEADS = ("", "share of U", "switches", "delta-v m/s", "largest", "bound", "goal by s", "safe until s")
"""Heads of the table; delta-v is the simulated mean, the simulated largest, and the proven bound."""


def show_tradeoff(summary: Mapping[str, Any], folder: str) -> None:
    """Print the points, with a mark on those that are not dominated, and the paths of their folders."""
    points = summary["points"]
    print_line(f"{summary['title']}: {counted(len(points), 'schedule')}", "bold")
    longest = max(len(point["folder"]) for point in points)
    show_table(table(*HEADS, wrap=0, rows=map(_row, points)), 80 + longest)
    if summary["needed"]:
        for one in summary["needed"]:
            print_line(answered(one))
    else:
        print_line(
            "* not dominated: no other is as good in share, mean delta-v, switches, goal and guarantee."
        )
    print_line(f"Trade-off: {folder}")
    print_line(f"Report of one schedule: polaris report {shlex.quote(folder + '/' + points[0]['folder'])}")


def _row(point: Mapping[str, Any]) -> tuple[str, ...]:
    if point["guarantee"] == "infeasible":
        return f"  {point['folder']}", "infeasible", *[""] * (len(HEADS) - 2)
    proved = point["guarantee"] == "proved"
    until = "for all time" if point["until_s"] is None else f"{point['until_s']:.6g}"
    return (
        f"{'*' if point['non_dominated'] else ' '} {point['folder']}",
        f"{point['share']:.1%}",
        str(point["switches"]),
        *(f"{point[key]:.4g}" for key in ("delta_v_m_s", "delta_v_max_m_s")),
        directed(point["delta_v_most_m_s"], ".4g", up=True) if proved else "statistical",
        f"{point['goal_by_s']:.6g}" if point["goal_reached"] is True else "not proven",
        until if proved else "statistical",
    )


def answered(needed: Mapping[str, Any]) -> str:
    """Describe the last value of a field that is proven with the required share of U, and the next one."""
    share, field = f"{100 * needed['share']:.4g} % of the time under U", needed["field"]
    if needed["last_proven"] is None:
        return f"{field}: no value tried is proven for {share}."
    last, attained = f"{needed['last_proven']:g}", f"{needed['share_there']:.1%}"
    text = f"{field}: {needed['bound']} {last} for {share} (proven at this value: {attained}"
    if needed["next"] is None:
        return f"{text}; no further value was tried)."
    if needed["interpolated"] is None:
        return f"{text}; infeasible at {needed['next']:g})."
    estimate, beyond = f"{needed['interpolated']:.4g}", f"{needed['share_next']:.1%} at {needed['next']:g}"
    return f"{text}; about {estimate} by interpolation to {beyond})."
