"""The scenario's rules for switching, and the schedule that claims to keep to them."""

from __future__ import annotations

from itertools import groupby
from typing import Any

from .document import Document
from .verdict import Rejected

Rules = dict[str, Any]


def switching_rules(scenario: Rules) -> Rules:
    """The rules as ``schedule.json`` repeats them; of the effort of the search, what the scenario gives."""
    spec = scenario.get("schedule", {})
    rules = {
        "strategy": spec.get("strategy", "greedy"),
        "min_dwell": spec.get("min_dwell_steps", 1),
        "max_switches": spec.get("max_switches"),
        "weights": [float(item.get("weight", 1.0)) for item in scenario["experimental"]],
    }
    return rules | {key: spec[key] for key in ("beam",) if key in spec}


def switches(modes: list[int]) -> int:
    """Number of changes of mode."""
    return sum(a != b for a, b in zip(modes[:-1], modes[1:], strict=True))


def check_switching(document: Document, scenario: Rules) -> str:
    """Whoever takes over keeps control for the dwell, or to T; there are no more switches than the cap.

    Raises
    ------
    Rejected
        Naming the claim ``schedule``.
    """
    rules = switching_rules(scenario)
    held = [len(list(group)) for _, group in groupby(document.modes)]
    for i, steps in enumerate(held[:-1]):
        if steps < rules["min_dwell"]:
            at = sum(held[:i])
            told = f"mode {document.modes[at]} is left {steps} steps after step {at}"
            raise Rejected("schedule", f"{told}; the scenario's dwell is {rules['min_dwell']} steps")
    count, cap = switches(document.modes), rules["max_switches"]
    if cap is not None and count > cap:
        raise Rejected("schedule", f"{count} switches, the scenario allows {cap}")
    return f"{count} switches, dwell and cap of the scenario kept"
