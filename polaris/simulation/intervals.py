"""Confidence intervals on probabilities and means, and what values are possible at all."""

from __future__ import annotations

import numpy as np

from ..model.system import Array

CONFIDENCE = 0.95
"""Of every interval and bound."""


POSSIBLE = {"experimental_share": (0.0, 1.0)} | dict.fromkeys(
    ("min_ttc_s", "min_ttc_free_drift_s", "switches", "delta_v_m_s", "deviation", "violations"), (0.0, np.inf)
)
"""Least and largest value of metrics that cannot have any; no confidence bound lies outside."""


def violation_interval(violations: int, runs: int) -> tuple[float, float]:
    """Clopper and Pearson's two-sided interval on a probability, from so many violations in so many runs."""
    from scipy.stats import binomtest

    found = binomtest(violations, runs).proportion_ci(CONFIDENCE)
    return float(found.low), float(found.high)


def possible(metric: str, difference: bool = False) -> tuple[float, float]:
    """Least and largest value that a metric, or a difference of two, can have."""
    low, high = POSSIBLE.get(metric, (-np.inf, np.inf))
    return (low - high, high - low) if difference else (low, high)


def mean_interval(
    values: Array, within: tuple[float, float] = (-np.inf, np.inf)
) -> tuple[float, float | None, float | None]:
    """Mean of finite values of some runs and Student's t interval about it; no interval for a single run.

    The interval is cut to the values that are possible at all (`possible`).
    """
    from scipy.stats import t

    mean = float(values.mean())
    if len(values) < 2:
        return mean, None, None
    half = float(t.ppf((1 + CONFIDENCE) / 2, len(values) - 1) * values.std(ddof=1) / np.sqrt(len(values)))
    return mean, max(mean - half, within[0]), min(mean + half, within[1])


def lower_bound(successes: int, runs: int) -> float:
    """Clopper and Pearson's lower bound on a probability of success, one-sided."""
    from scipy.stats import binomtest

    return float(binomtest(successes, runs, alternative="greater").proportion_ci(CONFIDENCE).low)
