"""Results of a schedule in sentences, which the command line prints and the page shows."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..certificate.assumptions import claim_time
from ..model.checks import counted
from ..model.scene.timed_polytope import TimedPolytope
from ..model.system import HILL_AXES, LinearSystem
from ..synthesis.safety.recoverable import directed


def limit_words(name: str, of: str = "") -> str:
    """Return the name of a limit in words; a side of a keep-in set has its number, counted from 1."""
    return re.sub(r"\[(\d+)\]$", lambda side: f", side {int(side[1]) + 1}{of}", name)


def set_of_limit(name: str) -> str:
    """Return the name of a limit without the number of a keep-in set's side."""
    return limit_words(name).partition(", side ")[0]


def side_words(unsafe: Sequence[TimedPolytope], system: LinearSystem) -> dict[str, str]:
    """Return limits in words by name: a side has its number and, if it has one, its outward axis."""
    counts = Counter(set_of_limit(one.name) for one in unsafe)
    axes = HILL_AXES if system.mean_motion is not None and system.d == 3 else tuple("xyz")
    words = {}
    for one in unsafe:
        along = np.flatnonzero(one.normals[0])
        known = one.keep_in and not one.of_state and len(along) == 1
        axis = f" ({'-' if one.normals[0, along[0]] > 0 else '+'}{axes[along[0]]})" if known else ""
        words[one.name] = limit_words(one.name, f" of {counts[set_of_limit(one.name)]}{axis}")
    return words


def synthesis(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return heads and sentences about the plan, the start, the share of U, and the time of a run."""
    details = summary["synthesis"]
    seconds, plan = dict(details["seconds"]), details["planner"]
    total, _ = seconds.pop("total"), seconds.pop("plan_parts")
    stages = ", ".join(f"{name} {duration:.2f}" for name, duration in seconds.items() if duration >= 0.005)
    text = f"{_planned(plan)}; delta-v {plan['delta_v_m_s']:.4g} m/s"
    if plan["margin_m"] is not None:
        text += f", clearance {directed(plan['margin_m'], '.4g')} m beyond the tracking error"
    rows = [("Reference", text)]
    start, limit = details["start_margin"], details["start_limit"]
    if start is not None:
        text = f"{directed(start, '.1%')} of the clearance (limiting: {limit_words(limit)})"
        rows.append(("Start margin", text))
    rows.append(("Recoverable sets", str(details["recoverable"])))
    rows.append(("U flies", share(details)))
    if "proven_share" in details:
        text = "of the time, proven for any thrust within the limits in place of the black boxes"
        rows.append(("U without samples", f"{details['proven_share']:.1%} {text}"))
        rows.append(("Attacks on black boxes", _worst(details["worst_flight"])))
    if (left_out := summary.get("model_error")) is not None:
        bound = directed(left_out["bound_m_s2"], ".3g", up=True)
        within = "within" if left_out["covered"] else "MORE THAN"
        text = f"the linear model neglects at most {bound} m/s^2 along the schedule, {within} the disturbance"
        text += f" bound of {left_out['declared_m_s2']:g} m/s^2; the checker does not verify this bound"
        rows.append(("Model error", text))
    return [*rows, ("Computation time", f"{total:.2f} s ({stages})")]


def share(details: Mapping[str, Any]) -> str:
    """Return the share of the time under U, and the proven bound on any schedule's, in words."""
    flies, top = f"{details['experimental_share']:.1%} of the time", details["share_at_most"]
    bound = directed(top - 1e-12, ".1%", up=True)
    return f"{flies}; upper bound for any schedule: {bound}" if top < 1 else flies


def _planned(plan: Mapping[str, Any]) -> str:
    """Describe the planner's outcome and its solver."""
    gap = "" if plan["gap"] is None else f", optimality gap {plan['gap']:.2g}"
    ended = {
        "optimal": "optimal plan",
        "replan": "planned along U's path",
        "effort_limit": f"plan cut off at the planner's effort limit{gap}",
        "time_limit": f"plan cut off by planner.time_limit_s{gap}",
    }[plan["status"]]
    return f"{ended} ({plan['solver_name']})"


def _worst(worst: Mapping[str, Any] | None) -> str:
    """Describe the worst flights found with black boxes."""
    if worst is None:
        return "black boxes fly no step: the samples do not support the requested probability"
    hit = "at least one" if worst["violated"] else "none"
    near = "" if worst["least_m"] is None else f", minimum distance {worst['least_m']:.4g} m"
    leave = f"{worst['leave_sets']:.1%} of the attacked flights leave the command bands"
    text = f"{hit} of {counted(worst['runs'], 'flight')} enters a keep-out zone{near}; {leave}"
    warning = ". WARNING: boxes answer the same questions differently, which violates an assumption"
    return text + ("" if worst["repeats"] else warning)


def reach(claim: Mapping[str, Any]) -> str:
    """Describe until when a schedule's claim holds, and of how many flights."""
    text = claim_time(claim["horizon"], claim["until_s"])
    if "sampled_bound" in claim:
        sampled = claim["sampled_bound"]
        chance = directed(sampled["probability"], ".2g", up=True)
        text += f" except with probability {chance} per flight, at confidence {sampled['confidence']:g}"
    return text


def no_time_after_end(guarantee: Mapping[str, Any]) -> str:
    """Return the limit that ends the claim at T, before S can settle, in words; empty for other claims."""
    if guarantee["horizon"] != "none" or guarantee["goal"]["reached"] is True:
        return ""
    limit, T = guarantee["reason"].partition(": ")[2].partition(": needs ")[0], guarantee["until_s"] or 0
    return f"the claim ends at T = {T:.6g} s because of {limit}, and S needs time after T to settle"


def goal(guarantee: Mapping[str, Any]) -> str:
    """Say if the goal is reached, how nearly, what keeps flights there or from it, and the cost."""
    claim, cause = guarantee["goal"], no_time_after_end(guarantee)
    near, drift = directed(claim["distance_m"], ".4g", up=True), claim["drift_m_per_orbit"]
    counts, miss = claim["velocity_time_s"], f"within {near} m (the tolerance is {claim['tolerance_m']:.4g} m"
    miss += ")" if counts is None else f"; velocity errors count as the distance covered in {counts:.4g} s)"
    drifting = "" if drift is None else f": free drift is up to {directed(drift, '.3g', up=True)} m per orbit"
    cost = f"Delta-v until then: at most {directed(claim['delta_v_max_m_s'], '.4g', up=True)} m/s."
    if claim["reached"] is True:
        return f"reached at {claim['by_s']:.6g} s, {miss}. S must fly on to stay there{drifting}. {cost}"
    failure = "not proven to be reached" if claim["reached"] == "not_proven" else "not reached"
    return f"{failure}: at best {miss}{f'; {cause}' * bool(cause)}. {cost}"
