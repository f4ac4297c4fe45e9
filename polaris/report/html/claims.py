"""The guarantee in words: what is proven, how far it reaches, on what assumptions, and what is not proven."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from .tables import badge, escaped, items

NOT_PROVEN = (
    "That the schedule reaches the goal. The reference does; the flight need not, as long as U is used.",
    "Anything about U alone: its runs are here to compare with.",
    "Anything if an assumption fails: another motion, a larger disturbance, an unsafe set nobody has seen or "
    "that leaves its cover, a late or inexact command.",
    "Simulated runs and the diagrams illustrate the guarantee. They are no part of it.",
)


def reach(claim: Mapping[str, Any]) -> str:
    """How far a proved schedule's claim goes, in words."""
    until = claim.get("until_s")
    if claim.get("horizon") == "infinite":
        return "for all time"
    if claim.get("horizon") == "one_period" and until is not None:
        return f"until {until:.6g} s: the end of the schedule and one further period under S"
    return "up to the end of the schedule only"


def guarantee(claim: Mapping[str, Any], recoverable: str) -> str:
    """The section of an ordinary run folder, from ``summary.json``."""
    if claim["kind"] != "proved":
        return f"{loud(recoverable)}\n{_part('What is not proven', items(('Anything.', *NOT_PROVEN[:2])))}"
    what = (
        "From every state of the initial set, under every admissible disturbance, and whatever the "
        "experimental controllers do within their declared models, the spacecraft under the schedule enters "
        "no unsafe set, between time steps too, and the safety controller never asks for more thrust than "
        "there is."
    )
    after = "" if claim.get("horizon") == "infinite" else " Beyond that time nothing is claimed."
    far = f"Safe {escaped(reach(claim))}. The reason: {escaped(claim['reason'])}.{after}"
    parts = (
        ("What is proven", f"<p>{what}</p>"),
        ("How far it reaches", f"<p>{far}</p>"),
        ("Assumptions", items(claim["assumptions"])),
        ("What is not proven", items(NOT_PROVEN)),
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
