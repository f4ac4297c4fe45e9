"""Results of a schedule in sentences, which the command line prints and the page shows."""

from collections.abc import Mapping
from typing import Any

from ..model.checks import counted
from ..synthesis.safety.recoverable import directed


def synthesis(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return heads and sentences about the plan, the start, the share of U, and the time of a run."""
    details = summary["synthesis"]
    seconds, plan = dict(details["seconds"]), details["planner"]
    total, _ = seconds.pop("total"), seconds.pop("plan_parts")
    stages = ", ".join(f"{name} {spent:.2f}" for name, spent in seconds.items() if spent >= 0.005)
    text = f"{_planned(plan)}, {plan['delta_v_m_s']:.4g} m/s"
    if plan["margin_m"] is not None:
        text += f", clearance {directed(plan['margin_m'], '.4g')} m beyond the tube"
    rows = [("Plan", text)]
    start, limit = details["start_margin"], details["start_limit"]
    if start is not None:
        rows.append(("Start", f"{directed(start, '.1%')} of the room is left, least at {limit}"))
    rows.append(("Recoverable sets", str(details["recoverable"])))
    rows.append(("U flies", share(details)))
    if "proven_share" in details:
        text = "of the time is proven for anything within the thrust limits instead of black boxes"
        rows.append(("Without samples", f"{details['proven_share']:.1%} {text}"))
        rows.append(("Worst found", _worst(details["worst_found"])))
    if (left_out := summary.get("model_error")) is not None:
        bound = directed(left_out["bound_m_s2"], ".3g", up=True)
        within = "within" if left_out["covered"] else "MORE THAN"
        text = f"the linear model leaves out at most {bound} m/s^2 where the schedule flies, {within} the"
        text += f" {left_out['declared_m_s2']:g} that the proof allows; the checker does not derive it"
        rows.append(("Model error", text))
    return [*rows, ("Time", f"{total:.2f} s ({stages})")]


def share(details: Mapping[str, Any]) -> str:
    """Return the share of the time under U, and what is proven of any schedule, in words."""
    flies, top = f"{details['experimental_share']:.1%} of the time", details["share_at_most"]
    return f"{flies}; no schedule can exceed {directed(top - 1e-12, '.1%', up=True)}" if top < 1 else flies


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


def _worst(worst: Mapping[str, Any] | None) -> str:
    """Describe the worst flights found with black boxes."""
    if worst is None:
        return "black boxes fly no step: nothing could be said of them with the probability asked for"
    hit = "one enters an unsafe set" if worst["violated"] else "none enters an unsafe set"
    near = "" if worst["least_m"] is None else f", least distance {worst['least_m']:.4g} m"
    leave = f"{worst['leave_sets']:.1%} of flights at their worst leave the bands of black boxes"
    text = f"of {counted(worst['runs'], 'flight')} searched for the worst {hit}{near}; {leave}"
    why = ". Asked again, or about few flights alone, they answer otherwise: a condition is not met"
    return text + ("" if worst["repeats"] else why)


def reach(claim: Mapping[str, Any]) -> str:
    """Describe until when a schedule's claim holds, and of how many flights."""
    text = {
        "infinite": "for all time",
        "one_period": f"until {claim['until_s'] or 0:.6g} s: the end of the schedule and a period under S",
        "none": "up to the end of the schedule only",
    }[claim["horizon"]]
    if "statement" in claim:
        said = claim["statement"]
        chance = directed(said["probability"], ".2g", up=True)
        text += f" but for {chance} of all flights, said with a confidence of {said['confidence']:g}"
    return text


def goal(claim: Mapping[str, Any]) -> str:
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
