"""What the runs of a campaign amount to, per case and mode: violations, means with intervals, worst runs."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from ...model.system import Array
from ...simulation.intervals import CONFIDENCE, mean_interval, possible, violation_interval

if TYPE_CHECKING:
    from .folder import CampaignFolder


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
