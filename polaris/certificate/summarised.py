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

    Parameters
    ----------
    claimed : dict
        The guarantee as ``schedule.json`` repeats it.

    Raises
    ------
    Rejected
        Naming ``summary``.
    """
    found: dict[str, Any] = strict_json(contents(path))
    conform(found, SUMMARY, "summary", "summary.json")
    same("summary", "name of the scenario", document.scenario, found["scenario"])
    same("summary", "title", scenario["title"], found["title"])
    same("summary", "seed", scenario.get("simulation", {}).get("seed", 0), found["seed"])
    same("summary", "guarantee", claimed, found["guarantee"])
    synthesis = found["synthesis"]
    same("summary", "kind of recoverable set", document.recoverable, synthesis["recoverable"])
    same("summary", "experimental share", share(document.modes), synthesis["experimental_share"])
    same("summary", "switches", switches(document.modes), synthesis["switches"])
    if synthesis["start_limit"] not in limit_names(document):
        raise Rejected("summary", "what limits the initial set is no limit of the scene")
    _check_plan(document, synthesis["planner"])
    # Those flown: S alone, the first experimental controller alone, the schedule.
    flown = {
        "polaris": ("polaris", document.modes),
        "safety": (document.laws[0].name, [0] * document.steps),
    }
    if len(document.laws) > 1:
        flown["experimental"] = (document.laws[1].name, [1] * document.steps)
    for key, (name, modes) in flown.items():
        if key not in found:
            raise Rejected("summary", f"{key} is missing")
        same("summary", f"controller of {key}", name, found[key]["controller"])
        same("summary", f"runs of {key}", found["polaris"]["runs"], found[key]["runs"])
        _check_flown(document, key, modes, found[key])
    return found


def _check_plan(document: Document, plan: dict[str, Any]) -> None:
    """The planned velocity change is that of the reference; how it was found is no claim of safety."""
    spent = math.fsum(abs(x) for u in document.inputs[: document.steps] for x in u)
    _close("velocity change of the plan", spent * document.delta / document.mass, plan["delta_v_m_s"])


def _close(what: str, derived: float, stored: float, size: float | None = None) -> None:
    """Equal up to rounding, relative to a size, or to the derived value itself."""
    off = abs(derived - stored)
    if not off <= ROUNDING * (abs(derived) + 1e-300 if size is None else size):
        raise Rejected("summary", f"{what}: {stored} in summary.json, derived {derived}", off)


def _check_flown(document: Document, key: str, modes: list[int], found: dict[str, Any]) -> None:
    """Statistics of runs under known modes."""
    _close(f"experimental share of {key}", share(modes), found["experimental_share"], 1.0)
    same("summary", f"switches of {key}", switches(modes), found["switches"])
    T = document.steps * document.delta
    horizon = T if document.mean_motion is None else 2 * math.pi / document.mean_motion
    _close(f"horizon of free drift of {key}", horizon, found["drift_horizon_s"])
    runs, hit = found["runs"], found["collided_runs"]
    _need(key, "collided_runs", hit <= runs and (hit > 0) == found["collided"])
    proved = document.guarantee == "proved" and key != "experimental"
    _need(key, "collided, although it is proven not to", not (proved and found["collided"]))
    least, mean, all_times = (
        math.inf if found[name] is None else found[name]
        for name in ("min_distance_m", "min_distance_mean_m", "mean_distance_m")
    )
    _need(key, "distances in order", least <= mean * _up(mean) and mean <= all_times * _up(all_times))
    _need(key, "min_distance_m, of runs that did not collide", found["collided"] or least > 0)
    drift = found["min_ttc_free_drift_s"]
    _need(key, "min_ttc_free_drift_s", drift is None or drift <= horizon * (1 + ROUNDING))
    most = math.fsum(document.u_max) * T / document.mass * (1 + ROUNDING)
    spent = found["delta_v_m_s"], found["delta_v_max_m_s"]
    _need(key, "velocity changes in order", spent[0] <= spent[1] * (1 + ROUNDING) and spent[1] <= most)
    ratios = [found[f"max_thrust_ratio{who}"] for who in ("_safety", "_experimental")]
    for mode, ratio in enumerate(ratios):
        flies = any((m > 0) == (mode > 0) for m in modes)
        _need(key, "max_thrust_ratio of who flies", (ratio is not None) == flies)
    _need(key, "max_thrust_ratio", found["max_thrust_ratio"] == max(r for r in ratios if r is not None))
    if proved and ratios[0] is not None:
        _need(key, "max_thrust_ratio_safety of at most 1", ratios[0] <= 1 + ROUNDING)


def _up(x: float) -> float:
    """Factor that moves a number up by rounding, whatever its sign."""
    return 1 + math.copysign(ROUNDING, x)


def _need(key: str, what: str, holds: bool) -> None:
    if not holds:
        raise Rejected("summary", f"{key}: {what} does not hold in summary.json")
