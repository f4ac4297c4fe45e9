"""What metrics are called, and in which unit and form they are shown."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...simulation.metrics import possible
from ...synthesis.recoverable import directed
from .html import Cell, number_cell
from .numbers import shown

TITLES = {
    "runs": "simulated runs",
    "min_distance_m": "least distance to an unsafe set",
    "violations": "violations",
    "min_distance_mean_m": "least distance, mean over runs",
    "mean_distance_m": "distance, mean over time and runs",
    "min_ttc_s": "least time to collision, straight on",
    "min_ttc_free_drift_s": "least time to collision, free drift",
    "drift_horizon_s": "free drift is looked at for",
    "experimental_share": "share of experimental control",
    "switches": "switches",
    "delta_v_m_s": "velocity change, mean",
    "delta_v_max_m_s": "velocity change, largest",
    "collided": "any run enters an unsafe set",
    "collided_runs": "runs that enter an unsafe set",
    "deviation": "input other than U's, mean",
    "max_thrust_ratio": "largest demand of thrust",
    "max_thrust_ratio_safety": "largest demand of thrust by S",
    "max_thrust_ratio_experimental": "largest demand of thrust by U",
    "decision_median_us": "time of a decision, median",
    "decision_p99_us": "time of a decision, 99th percentile",
    "synthesis_s": "time of synthesis",
}

SUFFIXES = (
    ("_m_s2", "m/s²"),
    ("_m_s", "m/s"),
    ("_us", "µs"),
    ("_ms", "ms"),
    ("_s", "s"),
    ("_m", "m"),
    ("_N", "N"),
)

BAD = ("collided", "collided_runs", "violations", "min_distance_m")
"""Metrics that tell of a collision: any that is true or above 0, and a distance that is negative."""


@dataclass(frozen=True)
class Measure:
    """One metric.

    Attributes
    ----------
    key, title, unit : str
    percent : bool
        Whether it is a share, shown in per cent.
    """

    key: str
    title: str
    unit: str
    percent: bool

    @classmethod
    def of(cls, key: str) -> Measure:
        """From its key, whose end names the unit; metrics nobody has heard of are shown too."""
        if key.endswith("_share") or "_ratio" in key:
            return cls(key, TITLES.get(key, key.replace("_", " ")), "%", True)
        for suffix, unit in SUFFIXES:
            if key.endswith(suffix):
                return cls(key, TITLES.get(key, key.removesuffix(suffix).replace("_", " ")), unit, False)
        return cls(key, TITLES.get(key, key.replace("_", " ")), "", False)

    @property
    def head(self) -> str:
        """Title with the unit."""
        return f"{self.title} ({self.unit})" if self.unit else self.title

    def text(self, value: Any, unit: bool = True, proven: bool = False) -> str:
        """A value as HTML; one that is proven to be left is rounded down."""
        plain = isinstance(value, (int, float)) and not isinstance(value, bool)
        if plain and proven and np.isfinite(value):
            text = directed(value, ".1%")[:-1] if self.percent else directed(value, ".4g")
            return f"{text} {self.unit}" if unit else text
        if self.percent and plain:
            return shown(100.0 * value, self.key, ".1f", "%" if unit else "")
        return shown(value, self.key, ".4g", self.unit if unit else "")

    def cell(self, value: Any, unit: bool = True, difference: bool = False) -> Cell:
        """A value, or a mean with its bounds, as a cell; marked if it tells of a collision.

        Parameters
        ----------
        value : any
            Of a file.
        unit : bool
            Whether to write the unit after it.
        difference : bool
            Whether it is a difference of two methods: it has other limits, and tells of no collision.
        """
        judged = not difference
        if isinstance(value, Mapping):
            return self._bounded(value, judged)
        return Cell(self.text(value, unit), number_cell(value).sort, judged and self._bad(value))

    def _bounded(self, value: Mapping[str, Any], judged: bool) -> Cell:
        mean, low, high, worst = (value.get(name) for name in ("mean", "low", "high", "worst"))
        least, most = possible(self.key, difference=not judged)  # folders of older versions know no limits
        low, high = (None if v is None else min(max(v, least), most) for v in (low, high))
        told = self.text(mean, unit=False)
        if low is not None or high is not None:
            told += f'<span class="range">{self.text(low, False)} to {self.text(high, False)}</span>'
        if worst is not None and self.key != "violations":  # a count over all runs: there is no worst one
            told += f'<span class="range">worst {self.text(worst, False)}</span>'
        return Cell(told, number_cell(mean).sort, judged and self._bad(worst if worst is not None else mean))

    def _bad(self, value: Any) -> bool:
        if self.key not in BAD or value is None:
            return False
        return bool(value < 0) if self.key.endswith("_m") else bool(value > 0)
