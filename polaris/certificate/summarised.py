"""``summary.json`` against what was verified: it may not claim more, nor contradict itself."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from .document import Document
from .file_keys import SUMMARY
from .files import contents
from .repeated import limit_names, same, share, switches
from .structure import conform, strict_json
from .verdict import Rejected

ROUNDING = 1e-9
"""Difference between sums that were added up in another order, relative to them."""


def check_summary(
    document: Document, scenario: dict[str, Any], claimed: dict[str, Any], path: Path
) -> dict[str, Any]:
    """Compare every claim of the summary with the certificate; returns the summary.

    Statistics of simulated runs cannot be confirmed. They must agree with the schedule, with what is proven
    (no run of S or of the schedule collides, S commands no more thrust than there is) and with one another.
    `claimed` is the guarantee as ``schedule.json`` repeats it.
    """
    found: dict[str, Any] = conform(strict_json(contents(path)), SUMMARY, "summary", "summary.json")
    synthesis, laws, K = found["synthesis"], document.laws, document.steps
    # Those flown: S alone, the first experimental controller alone, the schedule.
    flown = {"polaris": ("polaris", document.modes), "safety": (laws[0].name, [0] * K)}
    if len(laws) > 1:
        flown["experimental"] = (laws[1].name, [1] * K)
    expected: dict[str, Any] = {
        "scenario": document.scenario,
        "title": scenario["title"],
        "seed": scenario.get("simulation", {}).get("seed", 0),
        "guarantee": claimed,
        "synthesis": {
            "recoverable": document.recoverable,
            "experimental_share": share(document.modes),
            "switches": switches(document.modes),
        },
    }
    for key, (name, modes) in flown.items():
        runs = found["polaris"]["runs"]
        expected[key] = {"controller": name, "runs": runs, "switches": switches(modes)}
    same("summary", "summary.json", expected, found)
    if synthesis["start_limit"] not in limit_names(document):
        raise Rejected("summary", "what limits the initial set is no limit of the scene")
    # How the plan was found is no claim of safety; its velocity change is that of the reference.
    spent = math.fsum(abs(x) for u in document.inputs[:K] for x in u) * document.delta / document.mass
    _close("velocity change of the plan", spent, synthesis["planner"]["delta_v_m_s"])
    for key, (_, modes) in flown.items():
        _check_flown(document, key, modes, found[key])
    return found


def _close(what: str, derived: float, stored: float, size: float | None = None) -> None:
    """Equal up to rounding, relative to a size, or to the derived value itself."""
    off = abs(derived - stored)
    if not off <= ROUNDING * (abs(derived) + 1e-300 if size is None else size):
        raise Rejected("summary", f"{what}: {stored} in summary.json, derived {derived}", off)


def _check_flown(document: Document, key: str, modes: list[int], found: dict[str, Any]) -> None:
    """Statistics of runs under known modes."""
    T, up = document.steps * document.delta, 1 + ROUNDING
    horizon = T if document.mean_motion is None else 2 * math.pi / document.mean_motion
    _close(f"experimental share of {key}", share(modes), found["experimental_share"], 1.0)
    _close(f"horizon of free drift of {key}", horizon, found["drift_horizon_s"])
    hit, collided = found["collided_runs"], found["collided"]
    proved = document.guarantee == "proved" and key != "experimental"
    least, mean, all_times = (
        math.inf if found[name] is None else found[name]
        for name in ("min_distance_m", "min_distance_mean_m", "mean_distance_m")
    )
    drift = found["min_ttc_free_drift_s"]
    spent, most_spent = found["delta_v_m_s"], found["delta_v_max_m_s"]
    ratios = [found[f"max_thrust_ratio{who}"] for who in ("_safety", "_experimental")]
    flies = [any((mode > 0) == experimental for mode in modes) for experimental in (False, True)]
    needed = {
        "collided_runs": hit <= found["runs"] and (hit > 0) == collided,
        "collided, although it is proven not to": not (proved and collided),
        "distances in order": least <= _raised(mean) and mean <= _raised(all_times),
        "min_distance_m, of runs that did not collide": collided or least > 0,
        "min_ttc_free_drift_s": drift is None or drift <= horizon * up,
        "velocity changes in order": spent <= most_spent * up
        and most_spent <= math.fsum(document.u_max) * T / document.mass * up,
        "max_thrust_ratio of who flies": [ratio is not None for ratio in ratios] == flies,
        "max_thrust_ratio": found["max_thrust_ratio"]
        == max((r for r in ratios if r is not None), default=-1),
        "max_thrust_ratio_safety of at most 1": not proved or ratios[0] is None or ratios[0] <= up,
    }
    for what, holds in needed.items():
        if not holds:
            raise Rejected("summary", f"{key}: {what} does not hold in summary.json")


def _raised(x: float) -> float:
    """A number moved up by rounding, whatever its sign."""
    return x * (1 + math.copysign(ROUNDING, x))
