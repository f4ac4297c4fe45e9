"""Metrics of simulated runs, one entry per run, how a summary joins them, and confidence intervals."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reach.short_repr import short_repr

from ..model.system import Array

DEFINITIONS = {
    "runs": "closed-loop runs from random and extreme initial states, under random and worst disturbances",
    "min_distance_m": "minimum signed distance to a true keep-out zone, over runs and times; negative inside",
    "min_distance_mean_m": "mean over runs of the minimum distance of each run",
    "mean_distance_m": "mean over runs and times of the signed distance to the nearest zone that holds",
    "min_ttc_s": "minimum time, over runs and times, until a straight line at the present velocity "
    "is in a keep-out zone that holds by then; null if it never is",
    "min_ttc_free_drift_s": "minimum time to collision with thrusters off from the start of a step, within "
    "drift_horizon_s, with a keep-out zone that holds by then; null if none collides",
    "experimental_share": "share of time under experimental controllers, mean over runs",
    "switches": "changes of controller within a run, maximum over runs",
    "delta_v_m_s": "delta-v (integral of the 1-norm of the input over the mass), mean over runs",
    "delta_v_max_m_s": "delta-v, maximum over runs",
    "collided": "true if any run entered a true keep-out zone",
    "collided_runs": "number of runs that entered a true keep-out zone",
    "max_thrust_ratio": "peak ratio of commanded to available thrust, over runs, times and axes; "
    "thrust above 1 is clipped",
    "max_thrust_ratio_safety": "the ratio while S flies, at most 1 where proven; null if it never does",
    "max_thrust_ratio_experimental": "max_thrust_ratio while U flies; null if it never does",
}
"""Definition of each number of a summary."""

CONFIDENCE = 0.95  # of every interval and bound

POSSIBLE = {"experimental_share": (0.0, 1.0)} | dict.fromkeys(
    ("min_ttc_s", "min_ttc_free_drift_s", "switches", "delta_v_m_s", "deviation", "violations"), (0.0, np.inf)
)
"""Least and largest value of metrics that cannot have any; no confidence bound lies outside."""


@short_repr
@dataclass(frozen=True, eq=False)
class Metrics:
    """Metrics of every run of one controller.

    Attributes
    ----------
    controller : str
        Who flew: ``polaris`` (the schedule) or the name of one controller.
    names : tuple of str
        Unsafe sets.
    times : ndarray, shape (N+1,)
        [s]
    min_distance : ndarray, shape (R,)
        Least signed distance to a true unsafe set [m]; inf without any.
    mean_distance : ndarray, shape (R,)
        Mean of the distance to the nearest of them [m] over the instants at which one holds; inf without any.
    closest_time : ndarray, shape (R,)
        When it was least [s]; nan without unsafe sets.
    closest_set : ndarray of int, shape (R,)
        Which unsafe set; -1 without any.
    min_ttc, min_ttc_free_drift : ndarray, shape (R,)
        Least time to collision with a set that holds by then [s], straight and by free drift; inf if none.
    drift_horizon : float
        How far free drift looks ahead [s].
    experimental_share : ndarray, shape (R,)
        Share of time under experimental controllers.
    switches : ndarray of int, shape (R,)
        Changes of controller.
    delta_v : ndarray, shape (R,)
        [m/s]
    collided : ndarray of bool, shape (R,)
        Whether the run entered a true unsafe set.
    max_thrust_ratio : ndarray, shape (R,)
        Commanded over available thrust.
    max_thrust_ratio_safety, max_thrust_ratio_experimental : ndarray, shape (R,)
        The same while S flies, and while an experimental controller does; nan if none ever does.
    nearest : ndarray, shape (3, N+1)
        Distance to the nearest unsafe set at every instant [m]: least, mean and largest over runs.
    """

    controller: str
    names: tuple[str, ...]
    times: Array
    min_distance: Array
    mean_distance: Array
    closest_time: Array
    closest_set: NDArray[np.int64]
    min_ttc: Array
    min_ttc_free_drift: Array
    drift_horizon: float
    experimental_share: Array
    switches: NDArray[np.int64]
    delta_v: Array
    collided: NDArray[np.bool_]
    max_thrust_ratio: Array
    max_thrust_ratio_safety: Array
    max_thrust_ratio_experimental: Array
    nearest: Array

    @classmethod
    def join(cls, parts: Sequence["Metrics"]) -> "Metrics":
        """Metrics of several batches of runs of the same controller, together."""
        if len(parts) == 1:
            return parts[0]
        weights = np.array([len(part.min_distance) for part in parts], dtype=float)
        nearest = np.stack([part.nearest for part in parts])
        mean = np.tensordot(weights / weights.sum(), nearest[:, 1], axes=1)
        per_run: dict[str, Any] = {
            field.name: np.concatenate([getattr(part, field.name) for part in parts])
            for field in fields(cls)
            if field.name not in ("controller", "names", "times", "drift_horizon", "nearest")
        }
        together = np.stack([nearest[:, 0].min(axis=0), mean, nearest[:, 2].max(axis=0)])
        return replace(parts[0], nearest=together, **per_run)

    @property
    def worst(self) -> int:
        """Return the run that came closest to an unsafe set."""
        return int(np.argmin(self.min_distance))

    def summary(self) -> dict[str, Any]:
        """Return the numbers of a run folder's summary over all runs, see `DEFINITIONS`; strict JSON."""
        return {
            "controller": self.controller,
            "runs": len(self.min_distance),
            "min_distance_m": finite(self.min_distance.min()),
            "min_distance_mean_m": finite(self.min_distance.mean()),
            "mean_distance_m": finite(self.mean_distance.mean()),
            "min_ttc_s": finite(self.min_ttc.min()),
            "min_ttc_free_drift_s": finite(self.min_ttc_free_drift.min()),
            "drift_horizon_s": self.drift_horizon,
            "experimental_share": float(self.experimental_share.mean()),
            "switches": int(self.switches.max()),
            "delta_v_m_s": float(self.delta_v.mean()),
            "delta_v_max_m_s": float(self.delta_v.max()),
            "collided": bool(self.collided.any()),
            "collided_runs": int(self.collided.sum()),
            "max_thrust_ratio": float(self.max_thrust_ratio.max()),
            "max_thrust_ratio_safety": finite(self.max_thrust_ratio_safety.max()),
            "max_thrust_ratio_experimental": finite(self.max_thrust_ratio_experimental.max()),
        }

    def columns(self) -> dict[str, Array]:
        """One array per metric, one entry per run; units in the names."""
        return {
            "min_distance_m": self.min_distance,
            "mean_distance_m": self.mean_distance,
            "closest_time_s": self.closest_time,
            "closest_set": np.array([*self.names, ""])[self.closest_set],
            "min_ttc_s": self.min_ttc,
            "min_ttc_free_drift_s": self.min_ttc_free_drift,
            "experimental_share": self.experimental_share,
            "switches": self.switches,
            "delta_v_m_s": self.delta_v,
            "collided": self.collided,
            "max_thrust_ratio": self.max_thrust_ratio,
            "max_thrust_ratio_safety": self.max_thrust_ratio_safety,
            "max_thrust_ratio_experimental": self.max_thrust_ratio_experimental,
        }

    def to_pandas(self) -> Any:
        """`columns` as a ``pandas.DataFrame`` (pandas is not a dependency; install it first)."""
        import pandas  # type: ignore[import-untyped,import-not-found,unused-ignore]

        return pandas.DataFrame(self.columns())


def finite(value: Any) -> float | None:
    """Return a number for strict JSON; none where it is infinite or unknown."""
    return float(value) if np.isfinite(value) else None


def violation_interval(violations: int, runs: int) -> tuple[float, float]:
    """Clopper and Pearson's two-sided interval on a probability, from so many violations in so many runs."""
    from scipy.stats import binomtest

    interval = binomtest(violations, runs).proportion_ci(CONFIDENCE)
    return float(interval.low), float(interval.high)


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
