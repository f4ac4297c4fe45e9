"""Tables of results as plain data, which the command line and the page show alike."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..model.checks import counted
from ..runs.files.tables import controllers
from ..runs.inspections.inspection import MEANING
from ..simulation.metrics import possible

ABSENT = {  # meaning of null by key: see "null and empty cells" in ``docs/guarantees.md``
    "min_distance_m": ("none", "there is no keep-out zone"),
    "min_distance_mean_m": ("none", "there is no keep-out zone"),
    "min_ttc_s": ("∞", "no run was ever on a collision course"),
    "min_ttc_free_drift_s": ("∞", "no run was ever on a collision course with its thrusters off"),
    "max_thrust_ratio_safety": ("none", "this controller never flew"),
    "max_thrust_ratio_experimental": ("none", "this controller never flew"),
    "until_s": ("∞", "for all time"),
}

TITLES = {  # titles of metrics, in the order of tables
    "runs": "simulated runs",
    "min_distance_m": "minimum distance to keep-out zones",
    "violations": "violations",
    "min_distance_mean_m": "minimum distance, mean over runs",
    "mean_distance_m": "distance, mean over time and runs",
    "min_ttc_s": "minimum time to collision, straight",
    "min_ttc_free_drift_s": "minimum time to collision, drift",
    "drift_horizon_s": "horizon of the free drift",
    "experimental_share": "share of time under U",
    "switches": "switches",
    "delta_v_m_s": "delta-v, mean",
    "delta_v_max_m_s": "delta-v, largest",
    "collided": "any run enters a keep-out zone",
    "collided_runs": "runs that enter a keep-out zone",
    "deviation": "deviation from U's input, mean (N for a spacecraft)",
    "max_thrust_ratio": "peak thrust demand",
    "max_thrust_ratio_safety": "peak thrust demand of S",
    "max_thrust_ratio_experimental": "peak thrust demand of U",
    "decision_median_us": "decision time, median",
    "decision_p99_us": "decision time, 99th percentile",
    "synthesis_s": "synthesis time",
}

SUFFIXES = {"_m_s2": "m/s²", "_m_s": "m/s", "_us": "µs", "_ms": "ms", "_s": "s", "_m": "m", "_N": "N"}
BAD = ("collided", "collided_runs", "violations", "min_distance_m")
"""Metrics that tell of a collision: any that is true or above 0, and a distance that is negative."""

ROUND_OFF = 1e-12  # values below this are what rounding leaves of a zero, in any unit of a metric
MOST_WHOLE = 1e7  # numbers below this have no exponent


@dataclass(frozen=True)
class Cell:
    """One cell: a text, smaller lines under it, and why it has no number if it has none.

    What it is sorted by (None comes last), whether it tells of what must not happen, and whether it holds
    words. A `badge` is the kind of a guarantee, of which a page shows a sign.
    """

    text: str
    sort: float | str | None = None
    alarm: bool = False
    words: bool = False
    reason: str = ""
    lines: tuple[str, ...] = ()
    badge: str = ""


@dataclass(frozen=True)
class Table:
    """A caption, heads of columns, and rows, named by the first column; heads may `sort` it on a page."""

    caption: str
    heads: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    sort: bool = False


def words(text: Any) -> Cell:
    """Return a cell with a text from a file."""
    return Cell(str(text), str(text), words=True)


def value_cell(value: Any, key: str = "", unit: str = "") -> Cell:
    """Return a cell with a value of a file, numbers with a unit; `ABSENT` has the meaning of null by key."""
    suffix = f" {unit}".replace("^2", "²") if unit else ""
    if value is None:
        text, reason = ABSENT.get(key, ("none", "no value"))
        return Cell(text, reason=reason)
    if isinstance(value, (list, tuple, Mapping)):
        pairs = value.items() if isinstance(value, Mapping) else (("", each) for each in value)
        parts = [f"{str(name).replace('_', ' ')} {value_cell(each, key).text}" for name, each in pairs]
        return Cell(", ".join(map(str.strip, parts)) + (suffix if parts else ""))
    if isinstance(value, bool):
        return Cell("yes" if value else "no")
    if not isinstance(value, (int, float)):
        return Cell(str(value))
    if np.isnan(value):
        return Cell("none", reason="no value")
    if np.isinf(value):
        return Cell("∞" if value > 0 else "−∞", value, reason="infinite" if value > 0 else "minus infinite")
    return Cell(number(value) + suffix, value)


def number(value: float) -> str:
    """Return a number with four digits, whole ones with all; a rounding remainder of zero is 0."""
    if isinstance(value, int):
        return f"{value:d}"
    if abs(value) < ROUND_OFF:
        return "0"
    return f"{value:.0f}" if 1e4 <= abs(value) < MOST_WHOLE else f"{value:.4g}"


SELDOM = 0.01  # share of time under U, unchanged or filtered, below which a comparison warns
SETS = "smaller estimate errors, a shorter --period or a larger planner.extra_margin_m"
REMEDIES = {  # changes that may let U fly more, by the reason for which a method withholds it
    "no input is recoverable: S": SETS,
    "U is not recoverable": SETS,
    "U asks": SETS,
    "latched in S": SETS,
    "S keeps control: dwell or re-entry margin": "a smaller --tune {key}.reentry or {key}.dwell",
    "no input satisfies all conditions: S": "a larger --tune {key}.alpha",
    "the predicted flight enters an unsafe set": "a shorter --tune {key}.horizon",
    "U's reachable set touches an unsafe set": "a shorter --tune {key}.horizon",
}


def seldom_flown(method: Mapping[str, Any]) -> str:
    """Return a warning if a compared method hardly lets U fly, with its most frequent reason; else ''."""
    share = method["metrics"].get("experimental_share")
    pairs = (part.rpartition(": ") for part in str(method.get("note")).split("; "))
    counts = {reason: int(count) for reason, _, count in pairs if count.isdecimal()}
    total = sum(counts.values())
    if not isinstance(share, Mapping) or share["mean"] is None or not total or method["key"] == "safety":
        return ""
    share = share["mean"] + counts.get("filtered", 0) / total
    reason = max(counts, key=counts.__getitem__)
    text = f"U flies {100 * share:.2g} % of the time; most decisions ({counts[reason]} of {total}): {reason}"
    text += f"; try {REMEDIES[reason].format(key=method['key'])}" if reason in REMEDIES else ""
    return text if share < SELDOM else ""


@dataclass(frozen=True)
class Measure:
    """A metric: its key, title and unit, and whether it is a share, shown in per cent."""

    key: str
    title: str
    unit: str
    percent: bool

    @classmethod
    def from_key(cls, key: str) -> "Measure":
        """Return the metric of a key, whose end names the unit; unknown metrics are shown too."""
        share = key.endswith("_share") or "_ratio" in key
        suffix = "" if share else next((end for end in SUFFIXES if key.endswith(end)), "")
        title = TITLES.get(key, key.removesuffix(suffix).replace("_", " "))
        return cls(key, title, "%" if share else SUFFIXES.get(suffix, ""), share)

    @classmethod
    def in_tables(cls, *tables: Mapping[str, Any]) -> list["Measure"]:
        """Return all metrics of some tables, in the order of `TITLES`; unknown ones last."""
        keys = {key for table in tables for key in table}
        ordered = *(key for key in TITLES if key in keys), *sorted(keys - set(TITLES))
        return [cls.from_key(key) for key in ordered]

    @property
    def head(self) -> str:
        """Title with the unit."""
        return f"{self.title} ({self.unit})" if self.unit else self.title

    def text(self, value: Any, unit: bool = True) -> str:
        """Return a value in words."""
        return self._cell(value, unit).text

    def _cell(self, value: Any, unit: bool = True) -> Cell:
        if self.percent and isinstance(value, (int, float)) and np.isfinite(value):
            return Cell(f"{100 * value:.1f}" + " %" * unit, value)
        return value_cell(value, self.key, self.unit if unit else "")

    def cell(self, value: Any, unit: bool = True, difference: bool = False) -> Cell:
        """Return a value, or a mean with its bounds, as a cell, marked if it tells of a collision."""
        if not isinstance(value, Mapping):
            return replace(self._cell(value, unit), alarm=not difference and self._alarm(value))
        mean, low, high, worst = (value.get(name) for name in ("mean", "low", "high", "worst"))
        least, largest = possible(self.key, difference)  # folders of older versions know no limits
        low, high = (None if v is None else min(max(v, least), largest) for v in (low, high))
        lines = []
        if low is not None or high is not None:
            lines.append(f"{self.text(low, False)} to {self.text(high, False)}")
        if worst is not None and self.key != "violations":  # a count over all runs: there is no worst one
            lines.append(f"worst {self.text(worst, False)}")
        is_bad = not difference and self._alarm(mean if worst is None else worst)
        return replace(self._cell(mean, False), alarm=is_bad, lines=tuple(lines))

    def _alarm(self, value: Any) -> bool:
        if self.key not in BAD or value is None:
            return False
        return bool(value < 0) if self.key.endswith("_m") else bool(value > 0)


BRIEF = (  # metrics that the command line shows of a run
    *("min_distance_m", "min_ttc_s", "min_ttc_free_drift_s", "experimental_share", "switches", "delta_v_m_s"),
    *("max_thrust_ratio_safety", "max_thrust_ratio_experimental", "collided_runs"),
)


def metrics(summary: Mapping[str, Any], caption: str, keys: Sequence[str] | None = None) -> Table:
    """Return the metrics of S alone, U alone and the schedule: those of some keys, or all."""
    names = controllers(summary)
    chosen = Measure.in_tables(*(summary[name] for name in names)) if keys is None else None
    measures = [one for one in chosen or map(Measure.from_key, keys or ()) if one.key != "controller"]
    rows = [[Cell(one.title), *(one.cell(summary[name].get(one.key)) for name in names)] for one in measures]
    return Table(caption, ["", *names.values()], rows)


def constraints(summary: Mapping[str, Any]) -> Table:
    """Return the least value of every constraint of an inspection flight."""
    rows = [
        [
            Cell(str(row["constraint"])),
            words(MEANING.get(row["constraint"], (row["meaning"], ""))[0]),
            replace(value_cell(row["least"], unit=row["unit"]), alarm=(row["least"] or 0) < 0),
            value_cell(row["time_s"], unit="s"),
            words(", ".join(map(str, row["deputies"]))),
            replace(_share(row["violated_share"]), alarm=bool(row["violated_share"])),
        ]
        for row in summary["constraints"]
    ]
    heads = ["constraint", "meaning", "minimum", "at", "deputies", "share violated"]
    return Table("Minimum of every constraint over the flight; negative is a violation", heads, rows, True)


def studies(summary: Mapping[str, Any]) -> Table:
    """Return the success of every study of a campaign of inspections, and its failures."""
    kinds = sorted({kind for study in summary["studies"] for kind in study["failures"]})
    rows = []
    for study in summary["studies"]:
        counts = [int(study["failures"].get(kind, 0)) for kind in kinds]
        shares = (study[key] for key in ("success_share", "success_share_lower_95", "interventions_share"))
        delta_v = value_cell(study["delta_v_mean_m_s"], unit="m/s")
        row = [Cell(str(study["name"])), value_cell(study["successes"]), *map(_share, shares), delta_v]
        rows.append([*row, *(Cell(str(count), count, alarm=count > 0) for count in counts)])
    heads = ["study", "safe runs", "share", "at least, 95 %", "interventions", "delta-v", *kinds]
    return Table(f"{counted(summary['runs'], 'run')} of {summary['duration_s']:g} s", heads, rows, True)


def _share(value: float | None) -> Cell:
    return value_cell(value) if value is None else Cell(f"{100 * value:.2f} %", value)
