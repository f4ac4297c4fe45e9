"""The paper's Monte Carlo: what is compared (studies), flights of a block of runs, what comes of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...model.system import Array
from ...rta.projection import SHORT
from ..closest import ClosestApproach
from ..constraints.allowable_set import allowable
from ..constraints.families import Families
from ..constraints.motion import SampledData
from ..constraints.strengthening import Strengthening
from ..filters.explicit import CENTRALIZED, make_filter
from ..inspection import Inspection
from .primary import NoInput, Primary
from .simulation import BatchFilter, Kept, Step, fly

BETWEEN = 1
"""Instants inside each period at which the constraints are looked at too."""

NEAR = 60.0
"""Closest approaches in free flight [m] up to which they are told exactly; beyond, a lower bound is told."""

PAIRWISE = ("phi2", "phi5", "phi8")

PHI = {
    "chief_separation": ("phi1",),
    "deputy_separation": ("phi2",),
    "speed": ("phi3",),
    "sun": ("phi4",),
    "deputy_sun": ("phi5",),
    "keep_in": ("phi6",),
    "passive": ("phi7",),
    "deputy_passive": ("phi8",),
    "velocity": ("phi9", "phi10", "phi11"),
}
"""What is judged, by family."""

JUDGED = tuple(name for names in PHI.values() for name in names)
"""All that is judged, in order."""


@dataclass(frozen=True)
class Study:
    """One way to filter.

    Parameters
    ----------
    name : str
    sharing : str
        ``centralized``, or how a decentralized filter shares (see `Decentralized`).
    without : tuple of str
        Families left out of the filter and of the judgement.
    strengthening : str or mapping
        See `Families`.
    sampled : SampledData, optional
        See `Families`.
    """

    name: str
    sharing: str = CENTRALIZED
    without: tuple[str, ...] = ()
    strengthening: str | Mapping[str, Strengthening] = "polaris"
    sampled: SampledData | None = None

    def families(self, inspection: Inspection) -> Families:
        """The constraints it enforces."""
        return Families(inspection, self.strengthening, self.without, self.sampled)

    def filtering(self, inspection: Inspection) -> BatchFilter:
        """The filter itself."""
        return make_filter(self.families(inspection), self.sharing)

    @property
    def judged(self) -> tuple[str, ...]:
        """What its runs are judged by: all constraints but those left out."""
        left_out = {name for family in self.without for name in PHI[family]}
        return tuple(name for name in JUDGED if name not in left_out)


@dataclass(frozen=True, eq=False)
class Outcome:
    """Results of one study, one entry per run.

    Attributes
    ----------
    study : Study
    least : dict of str to ndarray, shape (R,)
        Least value of each constraint phi1 to phi11 over the run, samples and between them.
    where : dict of str to ndarray of str, shape (R,)
        Deputies at that value, as in ``0 3``.
    when : dict of str to ndarray, shape (R,)
        Its time [s].
    short : ndarray, shape (R,)
        First time [s] at which a program had no solution; nan if all had.
    short_deputies : ndarray of str, shape (R,)
        Whose program that was.
    interventions : ndarray, shape (R,)
        Share of inputs (deputies and periods) that were changed.
    delta_v : ndarray, shape (R, N)
        Spent velocity change [m/s].
    """

    study: Study
    least: dict[str, Array]
    where: dict[str, NDArray[np.str_]]
    when: dict[str, Array]
    short: Array
    short_deputies: NDArray[np.str_]
    interventions: Array
    delta_v: Array

    @property
    def violated(self) -> NDArray[np.bool_]:
        """Runs in which a constraint became negative, shape (R,)."""
        return np.asarray(np.any([values < 0 for values in self.least.values()], axis=0))

    @property
    def success(self) -> NDArray[np.bool_]:
        """Runs in which no constraint became negative and every program had a solution, shape (R,)."""
        return ~self.violated & np.isnan(self.short)

    def failures(self) -> list[dict[str, Any]]:
        """Every failure: run, what, deputies, time [s], value (nan for a program without solution)."""
        rows: list[dict[str, Any]] = []
        for run in np.flatnonzero(~self.success).tolist():
            found = [("no solution", self.short_deputies[run], self.short[run], np.nan)]
            found = [] if np.isnan(self.short[run]) else found
            found += [
                (name, self.where[name][run], self.when[name][run], values[run])
                for name, values in self.least.items()
                if values[run] < 0
            ]
            for what, who, time, value in found:
                deputies = tuple(map(int, who.split()))
                rows.append(
                    {
                        "run": run,
                        "what": what,
                        "deputies": deputies,
                        "time": float(time),
                        "value": float(value),
                    }
                )
        return rows

    def columns(self) -> dict[str, Array]:
        """Everything as columns of a table, shapes (R,); what is not judged is nan or empty."""
        runs = len(self.short)
        nothing, nobody = np.full(runs, np.nan), np.zeros(runs, dtype="U1")
        found: dict[str, Any] = {
            "success": self.success,
            "short_s": self.short,
            "short_deputies": self.short_deputies,
            "interventions_share": self.interventions,
        }
        found |= {f"delta_v_{i}_m_s": spent for i, spent in enumerate(self.delta_v.T)}
        for name in JUDGED:
            found[f"least_{name}"] = self.least.get(name, nothing)
            found[f"time_{name}_s"] = self.when.get(name, nothing)
            found[f"deputies_{name}"] = self.where.get(name, nobody)
        return found

    @classmethod
    def from_columns(cls, study: Study, columns: Mapping[str, Any]) -> Outcome:
        """What `columns` made the columns of."""
        judged = [name for name in study.judged if not np.isnan(columns[f"least_{name}"]).all()]
        spent = [columns[name] for name in columns if name.startswith("delta_v_")]
        return cls(
            study,
            {name: columns[f"least_{name}"] for name in judged},
            {name: columns[f"deputies_{name}"] for name in judged},
            {name: columns[f"time_{name}_s"] for name in judged},
            columns["short_s"],
            columns["short_deputies"],
            columns["interventions_share"],
            np.stack(spent, axis=1),
        )


@dataclass(eq=False)
class Recorder:
    """Observer of `fly` that keeps the least values and the first failures of a block."""

    study: Study
    families: Families
    runs: int
    least: dict[str, Array] = field(default_factory=dict)
    where: dict[str, NDArray[np.intp]] = field(default_factory=dict)
    when: dict[str, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        q = self.families.inspection
        self.alone = np.stack([np.arange(q.deputies), np.full(q.deputies, -1)], axis=1)
        self.short = np.full(self.runs, np.nan)
        self.short_deputies = [""] * self.runs
        self.changed = np.zeros(self.runs)
        self.delta_v = np.zeros((self.runs, q.deputies))
        self.steps = 0
        self.approach = ClosestApproach(q.mean_motion, q.passive_time)
        self.judged = self.study.judged

    def __call__(self, step: Step, period: float) -> None:
        """Take in one control period."""
        q = self.families.inspection
        for b, x in enumerate((step.x, *step.between)):
            t = step.t + period * b / (len(step.between) + 1)
            sun = step.sun - q.mean_motion * (t - step.t)
            self.judge(x, sun, t)
        status = step.filtered.status
        for run in np.flatnonzero((status >= SHORT).any(axis=1) & np.isnan(self.short)):
            self.short[run] = step.t
            self.short_deputies[run] = " ".join(map(str, np.flatnonzero(status[run] >= SHORT)))
        self.changed += (status > 0).mean(axis=1)
        self.delta_v += np.abs(step.filtered.u).sum(axis=2) * (period / q.mass)
        self.steps += 1

    def judge(self, x: Array, sun: Array, t: float) -> None:
        """Look at all constraints, phi7 and phi8 included, at one instant."""
        q = self.families.inspection
        values = allowable(q, x, sun)
        if "phi7" in self.judged or "phi8" in self.judged:
            distance = self.approach(self.families.stack(x), NEAR).distance
            values["phi7"] = distance[:, : q.deputies] - q.separation
            values["phi8"] = distance[:, q.deputies :] - 2 * q.deputy_radius
        for name in self.judged:
            self._note(name, values[name], t)

    def _note(self, name: str, values: Array, t: float) -> None:
        if not values.shape[1]:
            return
        values = np.where(np.isnan(values), -np.inf, values)  # what cannot be told is not safe
        places = self.families.inspection.pairs if name in PAIRWISE else self.alone
        least = values.min(axis=1)
        if name not in self.least:
            self.least[name] = np.full(self.runs, np.inf)
            self.where[name] = np.zeros((self.runs, 2), dtype=np.intp)
            self.when[name] = np.zeros(self.runs)
        better = np.flatnonzero(least < self.least[name])
        if len(better):
            self.least[name][better] = least[better]
            self.where[name][better] = places[values[better].argmin(axis=1)]
            self.when[name][better] = t

    def outcome(self, final: Array, sun: Array, duration: float) -> Outcome:
        """The results, once the states at the end have been looked at too."""
        self.judge(final, self.families.inspection.sun_angle(duration, sun), duration)
        where = {
            name: np.array([" ".join(str(i) for i in pair if i >= 0) for pair in pairs.tolist()])
            for name, pairs in self.where.items()
        }
        return Outcome(
            self.study,
            self.least,
            where,
            self.when,
            self.short,
            np.array(self.short_deputies),
            self.changed / self.steps,
            self.delta_v,
        )


def fly_block(
    inspection: Inspection,
    study: Study,
    x: Array,
    sun: Array,
    duration: float = 500.0,
    period: float = 1.0,
    primary: Primary | None = None,
    kept: Kept | None = None,
) -> Outcome:
    """Fly some initial conditions under one study's filter.

    Parameters
    ----------
    inspection : Inspection
    study : Study
    x : ndarray, shape (R, N, 6)
        Initial states, as from `initial_conditions`.
    sun : ndarray, shape (R,)
        Sun angles at the start [rad].
    duration, period : float
        [s]
    primary : Primary, optional
        By default nobody wants any thrust.
    kept : Kept, optional
        Keeps one of the runs in full.
    """
    recorder = Recorder(study, study.families(inspection), len(x))

    def observe(step: Step) -> None:
        recorder(step, period)
        if kept is not None:
            kept(step)

    final = fly(
        inspection,
        study.filtering(inspection),
        primary or NoInput(),
        x,
        sun,
        duration,
        period,
        BETWEEN,
        observe,
    )
    return recorder.outcome(final, sun, duration)
