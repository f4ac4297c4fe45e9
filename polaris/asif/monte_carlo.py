"""The paper's Monte Carlo: many initial conditions, each flown under several filters.

Runs are cut into blocks of `BLOCK`; blocks are independent, so they go to any number of workers and give
the same results in any order.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..errors import ScenarioError
from ..system import Array
from .allowable import allowable
from .families import Families
from .filters import Centralized, Decentralized, Sharing
from .inspection import Inspection
from .primary import NoInput, Primary
from .projection import SHORT
from .sampled import SampledData
from .simulation import BatchFilter, Step, fly
from .strengthening import Strengthening

BLOCK = 100
"""Runs flown together: what fits into fast memory."""

PAIRWISE = ("phi2", "phi5", "phi8")


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
    sharing: Sharing | str = "centralized"
    without: tuple[str, ...] = ()
    strengthening: str | Mapping[str, Strengthening] = "afrl"
    sampled: SampledData | None = None

    def families(self, inspection: Inspection) -> Families:
        """The constraints it enforces."""
        return Families(inspection, self.strengthening, self.without, self.sampled)

    def filtering(self, inspection: Inspection) -> BatchFilter:
        """The filter itself."""
        families = self.families(inspection)
        if self.sharing == "centralized":
            return Centralized(families)
        return Decentralized(families, self.sharing)  # type: ignore[arg-type]


PAPER = (
    Study("centralized"),
    Study("decentralized", "coasting"),
    Study("decentralized without h5", "coasting", ("deputy_sun",)),
)
"""The paper's three."""

STUDIES = (*PAPER, Study("decentralized, shared", "consensus"))
"""The paper's three, and ours."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """Results of one study, one entry per run.

    Attributes
    ----------
    study : Study
    least : dict of str to ndarray, shape (R,)
        Least value of each constraint phi1 to phi11 over the run, samples and between them.
    where : dict of str to ndarray, shape (R, 2)
        Deputies at that value; the second is -1 where there is one only.
    when : dict of str to ndarray, shape (R,)
        Its time [s].
    short : ndarray, shape (R,)
        First time [s] at which a program had no solution; nan if all had.
    short_deputies : tuple of R tuples of int
        Whose program that was.
    interventions : ndarray, shape (R,)
        Share of inputs (deputies and periods) that were changed.
    delta_v : ndarray, shape (R, N)
        Spent velocity change [m/s].
    """

    study: Study
    least: dict[str, Array]
    where: dict[str, NDArray[np.intp]]
    when: dict[str, Array]
    short: Array
    short_deputies: tuple[tuple[int, ...], ...]
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

    def failures(self) -> list[dict[str, object]]:
        """Every failure: run, what, deputies, time [s], value (nan for a program without solution)."""
        rows: list[dict[str, object]] = []
        for run in np.flatnonzero(~self.success).tolist():
            if not np.isnan(self.short[run]):
                who = self.short_deputies[run]
                rows.append(_failure(run, "no solution", who, self.short[run], np.nan))
            for name, values in self.least.items():
                if values[run] < 0:
                    who = tuple(i for i in self.where[name][run].tolist() if i >= 0)
                    rows.append(_failure(run, name, who, self.when[name][run], values[run]))
        return rows


def _failure(run: int, what: str, who: Sequence[int], time: float, value: float) -> dict[str, object]:
    return {"run": int(run), "what": what, "deputies": tuple(who), "time": float(time), "value": float(value)}


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
        self.short_deputies: list[tuple[int, ...]] = [()] * self.runs
        self.changed = np.zeros(self.runs)
        self.delta_v = np.zeros((self.runs, q.deputies))
        self.steps = 0
        # Exact closest approaches come with the rows already, unless the rows are tightened ones.
        self.passive = {}
        if self.study.sampled is None:
            for name, kind in (("phi7", "passive"), ("phi8", "deputy_passive")):
                rows = np.flatnonzero(np.array(self.families.family) == kind)
                if len(rows):
                    self.passive[name] = rows

    def __call__(self, step: Step, period: float) -> None:
        """Take in one control period."""
        q = self.families.inspection
        without = self.study.without
        for b, x in enumerate((step.x, *step.between)):
            t = step.t + period * b / (len(step.between) + 1)
            sun = step.sun - q.mean_motion * (t - step.t)
            for name, values in allowable(q, x, sun).items():
                if not (name == "phi5" and "deputy_sun" in without):
                    self._note(name, values, t)
        for name, rows in self.passive.items():
            self._note(name, step.filtered.rows.h[:, rows], step.t)
        status = step.filtered.status
        for run in np.flatnonzero((status >= SHORT).any(axis=1) & np.isnan(self.short)):
            self.short[run] = step.t
            self.short_deputies[run] = tuple(int(i) for i in np.flatnonzero(status[run] >= SHORT))
        self.changed += (status > 0).mean(axis=1)
        self.delta_v += np.abs(step.filtered.u).sum(axis=2) * (period / q.mass)
        self.steps += 1

    def _note(self, name: str, values: Array, t: float) -> None:
        if not values.shape[1]:
            return
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


def fly_block(
    inspection: Inspection,
    study: Study,
    x: Array,
    sun: Array,
    duration: float = 500.0,
    period: float = 1.0,
    between: int = 1,
    primary: Primary | None = None,
) -> Outcome:
    """Fly some initial conditions, shapes (R, N, 6) and (R,), under one study's filter."""
    filtering = study.filtering(inspection)
    recorder = Recorder(study, study.families(inspection), len(x))
    final = fly(
        inspection,
        filtering,
        primary or NoInput(),
        x,
        sun,
        duration,
        period,
        between,
        lambda step: recorder(step, period),
    )
    for name, values in allowable(inspection, final, inspection.sun_angle(duration, sun)).items():
        if name in recorder.least:
            recorder._note(name, values, duration)
    return Outcome(
        study,
        recorder.least,
        recorder.where,
        recorder.when,
        recorder.short,
        tuple(recorder.short_deputies),
        recorder.changed / recorder.steps,
        recorder.delta_v,
    )


def join(outcomes: Sequence[Outcome]) -> Outcome:
    """Results of all blocks of one study, in order."""
    first = outcomes[0]

    def joined(name: str) -> dict[str, Array]:
        return {key: np.concatenate([getattr(o, name)[key] for o in outcomes]) for key in first.least}

    return Outcome(
        first.study,
        joined("least"),
        joined("where"),  # type: ignore[arg-type]
        joined("when"),
        np.concatenate([o.short for o in outcomes]),
        tuple(who for o in outcomes for who in o.short_deputies),
        np.concatenate([o.interventions for o in outcomes]),
        np.concatenate([o.delta_v for o in outcomes]),
    )


def monte_carlo(
    inspection: Inspection,
    x: Array,
    sun: Array,
    studies: Sequence[Study] = STUDIES,
    duration: float = 500.0,
    period: float = 1.0,
    between: int = 1,
    executor: Executor | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, Outcome]:
    """Fly the same initial conditions under each study's filter.

    Parameters
    ----------
    inspection : Inspection
    x : ndarray, shape (R, N, 6)
        Initial states, as from `polaris.asif.sampling.initial_conditions`.
    sun : ndarray, shape (R,)
        Sun angles at the start [rad].
    studies : sequence of Study
        With different names.
    duration, period : float
        [s]
    between : int
        Instants inside each period at which the constraints are looked at too.
    executor : concurrent.futures.Executor, optional
        Takes the blocks; without it they are flown here.
    progress : callable
        Told the blocks done and all of them.

    Returns
    -------
    dict of str to Outcome
        By the studies' names.
    """
    if len({study.name for study in studies}) != len(studies):
        raise ScenarioError("studies", [study.name for study in studies], "must have different names")
    blocks = [slice(k, k + BLOCK) for k in range(0, len(x), BLOCK)]
    tasks = [
        (inspection, study, x[block], sun[block], duration, period, between)
        for study in studies
        for block in blocks
    ]
    found: list[Outcome] = []
    if executor is None:
        results = (fly_block(*task) for task in tasks)
    else:
        futures = [executor.submit(fly_block, *task) for task in tasks]
        results = (future.result() for future in futures)
    for outcome in results:
        found.append(outcome)
        progress(len(found), len(tasks))
    return {
        study.name: join(found[k * len(blocks) : (k + 1) * len(blocks)]) for k, study in enumerate(studies)
    }
