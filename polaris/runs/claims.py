"""What a run claims beside safety and the goal, in words: what S spends after T, and passive safety."""

from collections.abc import Mapping
from typing import Any

from ..synthesis.recoverable import directed
from ..synthesis.synthesize import in_words


def besides(claim: Mapping[str, Any]) -> list[tuple[str, str]]:
    """A heading and a sentence for everything that a guarantee claims besides."""
    found = [("Upkeep", _upkeep(claim["upkeep"]))] if claim.get("upkeep") else []
    found += [("Passive safety", drift_told(claim["abort"]))] if "abort" in claim else []
    powered = claim.get("powered_abort")
    return found + ([("Powered abort", abort_told(powered))] if powered else [])


def abort_told(claim: Mapping[str, Any]) -> str:
    """From which steps S reaches the orbit of an abort, and why not from the first of the others."""
    steps = claim["steps"]
    found, lost = ([each for each in steps if (each["why"] is None) == way] for way in (True, False))
    told = f"from {len(found)} of {len(steps)} steps S is proven to reach the orbit, whenever it is aborted"
    if found:
        told += f", for at most {directed(max(each['delta_v_m_s'] for each in found), '.4g', up=True)} m/s"
    return f"{told}. In step {lost[0]['step']}: {lost[0]['why']}." if lost else f"{told}."


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
