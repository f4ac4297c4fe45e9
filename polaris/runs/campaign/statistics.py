"""What the runs of schedules amount to, per case and mode: violations, means with intervals, worst runs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ...model.system import Array
from ...simulation.metrics import CONFIDENCE, mean_interval, possible, violation_interval
from .batch import Results

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

COLUMNS = sorted({*MEANS, *WORST, "batch", "run", "mode", "controller", "collided"})

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


def summarise(results: Results, options: dict[str, Any], worst: int) -> dict[str, Any]:
    """Contents of ``summary.json``.

    Parameters
    ----------
    results : Results
    options : dict
        Who flew, from where, under which disturbances.
    worst : int
        Worst runs to tell per case and mode.
    """
    cases = []
    for number, case in enumerate(results.cases):
        told: dict[str, Any] = {
            "case": number,
            "scenario": case.scenario,
            "parameters": dict(case.parameters),
            "label": case.label,
        }
        failure = results.failures.get(number)
        if failure is None:
            columns = results.read(number, COLUMNS)
            told["modes"] = {
                mode: _told(
                    {name: values[columns["mode"] == mode] for name, values in columns.items()}, worst
                )
                for mode in options["modes"]
            }
        else:
            told |= {"failure": failure["message"], "exit_code": failure["exit_code"]}
        cases.append(told)
    kind = "mixed" if "mixed" in (options["initial"], options["disturbance"]) else "drawn"
    return {
        "schema_version": 1,
        "kind": "campaign",
        "runs": results.runs,
        "seed": results.seed,
        "batch": results.batch,
        "initial": options["initial"],
        "disturbance": options["disturbance"],
        "confidence": CONFIDENCE,
        "flown": results.runs * len(options["modes"]) * (len(cases) - len(results.failures)),
        "cases": cases,
        "assumptions": [ASSUMPTIONS[name] for name in (kind, "independent", "normal")],
        "definitions": DEFINITIONS,
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
