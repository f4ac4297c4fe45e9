"""The page of an ordinary run folder, and guarantees in words: what is proven, how far, on what grounds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ...model.checks import counted
from ...runs.folder import RunFolder
from ...runs.picture import Picture
from ...synthesis.recoverable import directed
from ..scene.geometry import stretches
from ..scene.palette import PILOTS, mode_colour
from .page import Page, reading
from .tables import Cell, Measure, badge, escaped, items, table
from .timelines import Flown, flight_data

MOST_TOLD = 3
"""Most stretches under S that are told one by one."""

NOTE = (
    "Drawn paths keep at most 400 samples of a run; the tables use all of them. Bands reach over all "
    "simulated runs, lines are the run shown. The distance of the run shown is taken from where other "
    "satellites are nominally, the band from where they truly were."
)
SLICE = (
    "The recoverable set (yellow) is cut through the state of the run shown, at the time written at it: "
    "then it is filled, and dashed until the next one."
)

NO_GOAL = "That the schedule reaches the goal. The reference does; the flight need not, as long as U is used."
NOT_PROVEN = (
    "Anything about U alone: its runs are here to compare with.",
    "Anything if an assumption fails: another motion, a larger disturbance, an unsafe set nobody has seen or "
    "that leaves its cover, a late or inexact command.",
    "Simulated runs and the diagrams illustrate the guarantee. They are no part of it.",
)


SAMPLED = (
    "What a proven schedule claims, of all flights but for the share that the assumption on black boxes "
    "names: their steps rest on samples"
)


def run_page(folder: RunFolder) -> Page:
    """The report of a run folder."""
    summary = folder.summary
    claim, recoverable = summary["guarantee"], str(summary["synthesis"]["recoverable"])
    proved = claim["kind"] == "proved"
    picture = folder.picture()
    flown = [
        Flown(key, name, {"colour": colour, "dash": dash, "on": key == "polaris"}, picture.flights[key])
        for key, (name, _, colour, dash) in PILOTS.items()
        if key in picture.flights
    ]
    return Page(
        str(summary["title"]),
        (loud(recoverable) if claim["kind"] == "none" else "") + answers(summary, picture),
        (
            ("numbers", "Metrics", metrics(summary)),
            ("guarantee", "The guarantee", guarantee(claim, recoverable)),
            ("synthesis", "Synthesis", synthesis(summary)),
            reading(summary, f"{NOTE} {SLICE}"),
        ),
        flight_data(picture, flown, proved, "mode"),
        summary,
    )


def answers(summary: Mapping[str, Any], picture: Picture) -> str:
    """The first screen: is it safe, does it arrive, what does it cost, and who flies when."""
    claim, flown, found = summary["guarantee"], summary["polaris"], summary["synthesis"]
    goal, proved = claim["goal"], claim["kind"] == "proved"
    within, most = _most(goal, "distance_m"), _most(goal, "delta_v_max_m_s")
    runs = counted(flown["runs"], "simulated run")
    arrives = ("nothing is claimed", "the proof that it would rest on is missing")
    cost = f"mean of {runs}"
    if proved:
        word = "not proven" if goal["reached"] == "not_proven" else "no"
        arrives = (word, f"at best within {within} m; {goal['tolerance_m']:.4g} m would do")
        if goal["reached"] is True:
            arrives = (f"by {_time(goal['by_s'])}", f"proven, within {within} m of the goal")
        then = "to the goal" if goal["reached"] is True else "until it is nearest"
        cost += f"; {then} at most {most} m/s, proven"
    if "safety" in summary:
        cost += f"; S alone {Measure.of('delta_v_m_s').text(summary['safety']['delta_v_m_s'])}"
    cards = (
        ("Is it safe?", badge(claim["kind"]), reach(claim) if claim["kind"] != "none" else "no claim"),
        ("Does it arrive?", *arrives),
        ("What does it cost?", Measure.of("delta_v_m_s").text(flown["delta_v_m_s"]), cost),
        (
            "Who flies when?",
            f"U {Measure.of('experimental_share').text(found['experimental_share'])}",
            f"{counted(found['switches'], 'switch', 'switches')}; {_when(picture)}{_bar(picture)}",
        ),
    )
    told = (
        f"<div><dt>{head}</dt><dd><strong>{text}</strong> {more}</dd></div>" for head, text, more in cards
    )
    return f'<dl class="answers">{"".join(told)}</dl>'


def _most(goal: Mapping[str, Any], key: str) -> str:
    """A bound of the goal's claim."""
    return directed(goal[key], ".4g", up=True)


def _time(t: float) -> str:
    return f"{t:.6g} s"


def _when(picture: Picture) -> str:
    """When S flies."""
    delta, found = picture.reference.delta, stretches(picture.modes == 0)
    if len(found) > MOST_TOLD:
        return f"S in {len(found)} stretches"
    return "S " + (", ".join(f"{a * delta:.6g} to {_time(b * delta)}" for a, b in found) or "never")


def _bar(picture: Picture) -> str:
    """A slim bar of the modes over time."""
    ends = [0, *(np.flatnonzero(np.diff(picture.modes)) + 1).tolist(), len(picture.modes)]
    parts = "".join(
        f'<i style="flex: {b - a}; background: {mode_colour(mode)}"></i>'
        for a, b, mode in zip(ends[:-1], ends[1:], picture.modes[ends[:-1]].tolist(), strict=True)
    )
    label = f"Who flies, from 0 to {_time(picture.duration)}"
    return f'<span class="modes" role="img" aria-label="{label}">{parts}</span>'


def metrics(summary: Mapping[str, Any]) -> str:
    """Metrics of S alone, U alone and the schedule."""
    who = [key for key in ("safety", "experimental", "polaris") if key in summary]
    rows = [
        [Cell(escaped(one.title)), *(one.cell(summary[name].get(one.key)) for name in who)]
        for one in Measure.known(*(summary[name] for name in who))
        if one.key != "controller"
    ]
    heads = ["", *(PILOTS[name][0] for name in who)]
    return table("From simulated runs, under random and worst-case disturbances", heads, rows)


def synthesis(summary: Mapping[str, Any]) -> str:
    """What the synthesis found, and how long it took."""
    found = summary["synthesis"]
    plan, start = found["planner"], Measure.of("start_share")
    room = start.text(found["start_margin"], proven=True)
    rows = {
        "recoverable sets": escaped(found["recoverable"]),
        "plan": escaped(f"{plan['status'].replace('_', ' ')} ({plan.get('solver_name', plan['solver'])})"),
        "clearance of the plan beyond the tube": Measure.of("margin_m").text(plan["margin_m"], proven=True),
        "velocity change of the plan": Measure.of("delta_v_m_s").text(plan["delta_v_m_s"]),
        "room left at the start": f"{room}, least at {escaped(found['start_limit'])}",
        "time of synthesis": Measure.of("total_s").text(found["seconds"]["total"]),
    }
    return table("Before the flight", ["", ""], [[Cell(name), Cell(text)] for name, text in rows.items()])


# -- guarantees -------------------------------------------------------------------------------------


def reach(claim: Mapping[str, Any]) -> str:
    """How far a schedule's claim goes, in words."""
    until = claim.get("until_s")
    if "statement" in claim:
        most = directed(claim["statement"]["probability"], ".2g", up=True)
        proven = {key: value for key, value in claim.items() if key != "statement"}
        return f"{reach(proven)}, but for at most {most} of all flights"
    if claim.get("horizon") == "infinite":
        return "for all time"
    if claim.get("horizon") == "one_period" and until is not None:
        return f"until {until:.6g} s: the end of the schedule and one further period under S"
    return "up to the end of the schedule only"


def guarantee(claim: Mapping[str, Any], recoverable: str) -> str:
    """The section of an ordinary run folder, from ``summary.json``."""
    if claim["kind"] == "statistical":
        return other_guarantee(claim | {"reason": SAMPLED}, (NO_GOAL, *NOT_PROVEN))
    if claim["kind"] != "proved":
        nothing = items(("Anything.", NO_GOAL, NOT_PROVEN[0]))
        return f"{loud(recoverable)}\n{_part('What is not proven', nothing)}"
    what = (
        "From every state of the initial set, under every admissible disturbance, and whatever the "
        "experimental controllers do within their declared models, the spacecraft under the schedule enters "
        "no unsafe set, between time steps too, and the safety controller never asks for more thrust than "
        "there is."
    )
    after = "" if claim.get("horizon") == "infinite" else " Beyond that time nothing is claimed."
    far = f"Safe {escaped(reach(claim))}. The reason: {escaped(claim['reason'])}.{after}"
    goal = claim["goal"]
    arrives = goal["reached"] is True
    if arrives:
        what += (
            f" It is within {_most(goal, 'distance_m')} m of the goal at {_time(goal['by_s'])}, for a "
            f"velocity change of at most {_most(goal, 'delta_v_max_m_s')} m/s until then."
        )
    parts = (
        ("What is proven", f"<p>{what}</p>"),
        ("How far it reaches", f"<p>{far}</p>"),
        ("Assumptions", items(claim["assumptions"])),
        ("What is not proven", items(NOT_PROVEN if arrives else (NO_GOAL, *NOT_PROVEN))),
    )
    return "\n".join([f"<p>{badge('proved')}</p>", *(_part(*part) for part in parts)])


def other_guarantee(claim: Mapping[str, Any], limits: tuple[str, ...]) -> str:
    """The section of a run that claims something else than a schedule does."""
    nothing = claim["kind"] == "none"
    head = "Why nothing is claimed" if nothing else "What is claimed"
    parts = [f"<p>{badge(claim['kind'])}</p>", *([loud("")] if nothing else [])]
    parts.append(_part(head, f"<p>{escaped(claim.get('reason', 'nothing'))}.</p>"))
    if claim.get("assumptions"):
        parts.append(_part("Assumptions", items(claim["assumptions"])))
    return "\n".join([*parts, _part("What is not proven", items(limits))])


def loud(recoverable: str) -> str:
    """What nobody must overlook."""
    why = f" (recoverable sets of the kind <code>{escaped(recoverable)}</code>)" if recoverable else ""
    return (
        f'<div class="loud" role="alert"><strong>NOTHING IS PROVEN</strong><br>This run claims nothing{why}, '
        "whatever its simulation shows. It is there to compare with.</div>"
    )


def _part(head: str, inner: str) -> str:
    return f"<h3>{head}</h3>{inner}"
