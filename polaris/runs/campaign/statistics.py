"""What the runs of a campaign amount to, per case and mode: violations, means with intervals, worst runs."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from ...model.system import Array

if TYPE_CHECKING:
    from .folder import CampaignFolder

CONFIDENCE = 0.95

MEANS = ("min_distance_m", "mean_distance_m", "experimental_share", "delta_v_m_s")
"""Columns whose mean is told with an interval."""

WORST: dict[str, Callable[[Array], Any]] = {
    "min_distance_m": np.min,
    "min_ttc_s": np.min,
    "min_ttc_free_drift_s": np.min,
    "experimental_share": np.min,
    "switches": np.max,
    "delta_v_m_s": np.max,
    "max_thrust_ratio": np.max,
    "max_thrust_ratio_safety": np.max,
}
"""Columns whose worst value over runs is told, and which one that is."""

POSSIBLE = {"experimental_share": (0.0, 1.0)} | dict.fromkeys(
    ("min_ttc_s", "min_ttc_free_drift_s", "switches", "delta_v_m_s", "deviation", "violations"), (0.0, np.inf)
)
"""Least and largest value of metrics that cannot have any; no confidence bound lies outside."""

DEFINITIONS = {
    "violations": "runs that entered a true unsafe set",
    "violation_probability": "of a run drawn as here: share of the runs, and the two-sided 95 % interval of"
    " Clopper and Pearson",
    "mean": "over runs, with the two-sided 95 % interval of Student's t, cut to what is possible; null if a"
    " run has no finite value",
    "worst": "largest over runs for switches, delta_v_m_s and max_thrust_ratio, least for the others",
    "worst_runs": "those that came closest to an unsafe set, nearest first",
}

ASSUMPTIONS = {
    "mixed": "half of the runs of each batch start at corners under worst-case disturbances, the others are"
    " random; probabilities and means are those of this mixture, not of flights in nature",
    "drawn": "probabilities and means are those of initial states and disturbances drawn as here, not of"
    " flights in nature",
    "independent": "runs count as independent; that halves of the mixture are fixed can only make the"
    " intervals wider than needed",
    "normal": "the mean of so many runs is taken to be normally distributed",
}


def violation_interval(violations: int, runs: int, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Clopper and Pearson's two-sided interval on a probability.

    Parameters
    ----------
    violations, runs : int
        How many of how many.
    confidence : float
        In (0, 1).
    """
    from ..monte_carlo import lower_bound

    side = (1 + confidence) / 2
    return lower_bound(violations, runs, side), 1.0 - lower_bound(runs - violations, runs, side)


def possible(metric: str, difference: bool = False) -> tuple[float, float]:
    """Least and largest value that a metric, or a difference of two, can have."""
    low, high = POSSIBLE.get(metric, (-np.inf, np.inf))
    return (low - high, high - low) if difference else (low, high)


def mean_interval(
    values: Array, confidence: float = CONFIDENCE, within: tuple[float, float] = (-np.inf, np.inf)
) -> tuple[float, float | None, float | None]:
    """Mean of some runs and Student's t interval about it; no interval for a single run.

    Parameters
    ----------
    values : ndarray, shape (R,)
        Finite.
    confidence : float
        In (0, 1).
    within : (float, float)
        Values that are possible at all (`possible`): the interval is cut to them.
    """
    from scipy.stats import t

    mean = float(values.mean())
    if len(values) < 2:
        return mean, None, None
    half = float(t.ppf((1 + confidence) / 2, len(values) - 1) * values.std(ddof=1) / np.sqrt(len(values)))
    return mean, max(mean - half, within[0]), min(mean + half, within[1])


def summarise(folder: CampaignFolder, worst: int = 5) -> dict[str, Any]:
    """Contents of ``summary.json``.

    Parameters
    ----------
    folder : CampaignFolder
        With all its parts.
    worst : int
        Worst runs to tell per case and mode.
    """
    plan, failures = folder.plan, folder.failures()
    cases = []
    for number, case in enumerate(plan.cases):
        told: dict[str, Any] = {
            "case": number,
            "scenario": case.scenario,
            "parameters": dict(case.parameters),
            "label": case.label,
        }
        if number in failures:
            told["failure"] = failures[number]["message"]
            told["exit_code"] = failures[number]["exit_code"]
        else:
            told["modes"] = _modes(folder, number, worst)
        cases.append(told)
    kind = "mixed" if "mixed" in (plan.initial, plan.disturbance) else "drawn"
    return {
        "schema_version": 1,
        "kind": "campaign",
        "runs": plan.runs,
        "seed": plan.seed,
        "batch": plan.batch,
        "initial": plan.initial,
        "disturbance": plan.disturbance,
        "confidence": CONFIDENCE,
        "flown": plan.runs * len(plan.modes) * (len(cases) - len(failures)),
        "cases": cases,
        "assumptions": [ASSUMPTIONS[name] for name in (kind, "independent", "normal")],
        "definitions": DEFINITIONS,
    }


def _modes(folder: CampaignFolder, case: int, worst: int) -> dict[str, Any]:
    names = sorted({*MEANS, *WORST, "batch", "run", "mode", "controller", "collided"})
    table = folder.parts.read(case, names)
    columns = {name: table[name].to_numpy() for name in names}
    return {
        mode: _told({name: values[columns["mode"] == mode] for name, values in columns.items()}, worst)
        for mode in folder.plan.modes
    }


def _told(columns: dict[str, Array], worst: int) -> dict[str, Any]:
    runs, violations = len(columns["run"]), int(columns["collided"].sum())
    low, high = violation_interval(violations, runs)
    means = {}
    for name in MEANS:
        values = np.asarray(columns[name], dtype=float)
        if np.isfinite(values).all():
            means[name] = dict(
                zip(("mean", "low", "high"), mean_interval(values, within=possible(name)), strict=True)
            )
        else:
            means[name] = dict.fromkeys(("mean", "low", "high"))
    order = np.lexsort((columns["run"], columns["batch"], columns["min_distance_m"]))[:worst]
    return {
        "controller": str(columns["controller"][0]),
        "runs": runs,
        "violations": violations,
        "violation_probability": {"share": violations / runs, "low": low, "high": high},
        "mean": means,
        "worst": {name: least(columns[name]) for name, least in WORST.items()},
        "worst_runs": [
            {name: columns[name][i] for name in ("batch", "run", "min_distance_m")} for i in order
        ],
    }
