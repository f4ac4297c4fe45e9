"""Printed summaries of a run of a schedule and of a campaign of such runs."""

from collections.abc import Mapping
from typing import Any

from rich.text import Text

from ...model.checks import counted
from ...report.tables import BRIEF, metrics
from ...runs.files.tables import besides
from ...synthesis.safety.recoverable import directed
from . import RED, alarming, assume, say, show_cells, show_table, table


def show_summary(summary: Mapping[str, Any], folder: str) -> None:
    """Print the metrics, the guarantee with its assumptions, and where the folder lies."""
    say(str(summary["title"]), "bold")
    show_cells(metrics(summary, f"{counted(summary['polaris']['runs'], 'simulated run')} each", BRIEF))
    synthesis, claim = summary["synthesis"], summary["guarantee"]
    seconds, plan = dict(synthesis["seconds"]), synthesis["planner"]
    total, _ = seconds.pop("total"), seconds.pop("plan_parts")
    stages = ", ".join(f"{name} {spent:.2f}" for name, spent in seconds.items() if spent >= 0.005)
    clearance = directed(plan["margin_m"], ".4g")
    reached = f"{plan['delta_v_m_s']:.4g} m/s, clearance {clearance} m beyond the tube"
    say(f"Plan: {_planned(plan)}, {reached}.")
    start, limit = synthesis["start_margin"], synthesis["start_limit"]
    if start is not None:
        say(f"Start: {directed(start, '.1%')} of the room is left, least at {limit}.")
    say(f"U flies {_share(synthesis)}.")
    if "proven_share" in synthesis:
        told = "proven for anything within the thrust limits instead of black boxes"
        say(f"{synthesis['proven_share']:.1%} of the time is {told}.")
        say(_worst(synthesis["worst_found"]))
    say(f"Time: {total:.2f} s ({stages}).")
    proved = claim["kind"] != "none"
    say(f"Guarantee: {_claim(claim)}", "bold" if claim["kind"] == "proved" else RED)
    assume(claim["assumptions"] if proved else ())
    if proved:
        say(f"Goal: {_goal(claim['goal'])}")
    for head, sentence in besides(claim) if proved else ():
        say(f"{head}: {sentence}")
    say(f"Run folder: {folder}")


def _share(synthesis: Mapping[str, Any]) -> str:
    """Share of the time under U, and what is proven of any schedule."""
    flies, most = f"{synthesis['experimental_share']:.1%} of the time", synthesis["share_at_most"]
    return f"{flies}; no schedule can exceed {directed(most - 1e-12, '.1%', up=True)}" if most < 1 else flies


def _planned(plan: Mapping[str, Any]) -> str:
    """Describe the planner's outcome and its solver."""
    gap = "" if plan["gap"] is None else f" with a gap of {plan['gap']:.2g}"
    ended = {
        "optimal": "optimal",
        "in_view": "with U in view",
        "effort_limit": f"stopped at the limit of its effort{gap}",
        "time_limit": f"stopped by the clock{gap}",
    }[plan["status"]]
    return f"{ended} ({plan['solver_name']})"


def _worst(found: Mapping[str, Any] | None) -> str:
    """Describe the worst flights found with black boxes."""
    if found is None:
        return "Black boxes fly no step: nothing could be said of them with the probability asked for."
    hit = "one enters an unsafe set" if found["violated"] else "none enters an unsafe set"
    near = "" if found["least_m"] is None else f", least distance {found['least_m']:.4g} m"
    leave = f"{found['leave_sets']:.1%} of flights at their worst leave the bands of black boxes"
    told = f"Of {counted(found['runs'], 'flight')} searched for the worst {hit}{near}; {leave}."
    why = " Asked again, or about few flights alone, they answer otherwise: a condition is not met."
    return told + ("" if found["repeats"] else why)


def _claim(claim: Mapping[str, Any]) -> str:
    reach = {
        "infinite": "for all time",
        "one_period": f"until {claim['until_s'] or 0:.6g} s",
        "none": "up to the end of the schedule only",
    }[claim["horizon"]]
    if "statement" in claim:
        said = claim["statement"]
        most = directed(said["probability"], ".2g", up=True)
        reach += f" but for {most} of all flights, said with a confidence of {said['confidence']:g}"
    return f"{claim['kind']}, safe {reach} ({claim['reason']}), assuming that"


def _goal(claim: Mapping[str, Any]) -> str:
    """Say whether the goal is reached, how nearly, what keeps flights there, and the cost."""
    near, drift = directed(claim["distance_m"], ".4g", up=True), claim["drift_m_per_orbit"]
    counts, off = claim["velocity_time_s"], f"within {near} m"
    off += "" if counts is None else f" (velocities count as the length they make in {counts:.4g} s)"
    alone = "" if drift is None else f": alone it drifts up to {directed(drift, '.3g', up=True)} m per orbit"
    spent = f"Velocity change until then at most {directed(claim['delta_v_max_m_s'], '.4g', up=True)} m/s."
    if claim["reached"] is True:
        return f"reached at {claim['by_s']:.6g} s, {off}. To stay there S must fly on{alone}. {spent}"
    missed = "not proven to be reached" if claim["reached"] == "not_proven" else "not reached"
    return f"{missed}: {off} at best, {claim['tolerance_m']:.4g} m count as reached. {spent}"


COLUMNS: tuple[str, ...] = ("mode", "guarantee", "runs", "violations", "probability, 95 %", "least distance")
COLUMNS += ("its mean, 95 %", "share of U", "velocity change, 95 %")


def show_campaign(summary: Mapping[str, Any], folder: str) -> None:
    """Print violations, distances, use of U and velocity change of every case and mode."""
    found = table("case", *COLUMNS, wrap=0)
    for case in summary["cases"]:
        label = f"{case['case']}: {case['label']}"
        for mode, told in case.get("modes", {}).items():
            found.add_row(label, *_row(mode, told))
            label = ""
    show_table(found, max(len(str(case["label"])) for case in summary["cases"]) + 157)
    for case in summary["cases"]:
        if "failure" in case:
            say(f"{case['case']}: {case['label']}: no schedule. {case['failure']}", RED)
    assume(summary["assumptions"])
    say(f"Campaign: {folder}")


def show_run(row: Mapping[str, Any]) -> None:
    """Print what the table says of one run."""
    rows = ((name, "-" if value is None else str(value)) for name, value in row.items())
    show_table(table("", "", rows=rows))


def _row(mode: str, told: Mapping[str, Any]) -> list[Text]:
    chance, mean, worst = told["violation_probability"], told["mean"], told["worst"]
    bad = told["violations"] > 0
    return [
        Text(mode),
        Text(told["guarantee"]),
        Text(f"{told['runs']:,}"),
        alarming(f"{told['violations']:,}", bad),
        alarming(f"{chance['low']:.2g} to {chance['high']:.2g}", bad),
        Text("-" if worst["min_distance_m"] is None else f"{worst['min_distance_m']:.4g} m"),
        Text(_interval(mean["min_distance_m"], "m")),
        Text(f"{mean['experimental_share']['mean']:.1%}"),
        Text(_interval(mean["delta_v_m_s"], "m/s")),
    ]


def _interval(told: Mapping[str, float | None], unit: str) -> str:
    mean, high = told["mean"], told["high"]
    if mean is None:
        return "-"
    return f"{mean:.4g} {unit}" if high is None else f"{mean:.4g} +- {high - mean:.1g} {unit}"
