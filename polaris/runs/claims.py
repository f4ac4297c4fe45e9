"""What a run claims beside safety and the goal, in words: upkeep, passive safety, and what faults cost."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

from ..model.checks import counted
from ..synthesis.recoverable import directed
from ..synthesis.synthesize import in_words


def besides(claim: Mapping[str, Any]) -> list[tuple[str, str]]:
    """A heading and a sentence for everything that a guarantee claims besides."""
    found = [("Upkeep", _upkeep(claim["upkeep"]))] if claim.get("upkeep") else []
    found += [("Passive safety", drift_told(claim["abort"]))] if "abort" in claim else []
    return found + [("Isolated late", _withheld(fault)) for fault in claim.get("withheld", [])]


def _withheld(claim: Mapping[str, Any]) -> str:
    """Which steps S flies because of a fault, and which bound is short by how much."""
    fault, steps = f"{claim['fault']} ({claim['lasts_s']:.6g} s)", claim["steps"]
    if not steps:
        return f"{fault} can be survived from every step; S flies none because of it."
    worst = max(steps, key=lambda step: step["short"] / max(abs(step["room"]), 1e-300))
    short, numbers = directed(worst["short"], ".4g", up=True), [step["step"] for step in steps]
    return (
        f"because of {fault} S flies {counted(len(steps), 'step')} ({spans(numbers)}); of most in step"
        f" {worst['step']}: with {worst['controller']} {worst['limit']} would be {short} short in step"
        f" {worst['limit_step']} (t = {worst['limit_time_s']:.6g} s)."
    )


def spans(numbers: Sequence[int]) -> str:
    """Whole numbers in order, neighbours together: 3-5, 9."""
    cuts = [i for i, (a, b) in enumerate(pairwise(numbers), 1) if b > a + 1]
    runs = [numbers[i:j] for i, j in pairwise([0, *cuts, len(numbers)])]
    return ", ".join(f"{run[0]}" if len(run) == 1 else f"{run[0]}-{run[-1]}" for run in runs)


def _upkeep(claim: Mapping[str, Any]) -> str:
    """What holding on after T costs, and how long the tank lasts."""
    orbit, tank, lasts = claim["per_orbit_m_s"], claim["tank_m_s"], claim["lasts_s"]
    rate = f"{directed(claim['rate_m_s2'], '.4g', up=True)} m/s per second" if orbit is None else ""
    cost = rate or f"{directed(orbit, '.4g', up=True)} m/s per orbit"
    told = f"S spends at most {cost} from {claim['settled_s']:.6g} s on"
    if tank is None:
        return f"{told}."
    if lasts is None:
        return f"{told}: the tank of {tank:g} m/s lasts for ever."
    return f"{told}; the tank of {tank:g} m/s lasts until {directed(lasts, '.6g')} s."


def drift_told(claim: Mapping[str, Any]) -> str:
    """From when to when all thrust may stop, and where the drift is not shown to stay clear."""
    spans = ", ".join(f"{a:.6g} to {b:.6g} s" for a, b in claim["clear_s"])
    most = "" if claim["least_m"] is None else f", by at least {directed(claim['least_m'], '.4g')} m"
    told = f"if all thrust stops, the drift of {claim['drift_s']:.6g} s stays clear"
    found = f"{told} from {spans}{most}" if spans else f"{told} from no step"
    if claim["witness"] is None:
        return f"{found}, all of the flight."
    return f"{found}. Witness: {in_words(claim['witness'])}."
