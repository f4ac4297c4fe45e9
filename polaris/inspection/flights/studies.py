"""The paper's Monte Carlo: many initial conditions, each flown under several filters.

Runs are cut into blocks of `BLOCK`; blocks are independent, so they go to any number of workers and give
the same results in any order.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ...model.errors import ScenarioError
from ...model.system import Array
from ...rta.projection import SHORT
from ..closest import ClosestApproach
from ..constraints.allowable_set import allowable
from ..constraints.families import Families
from ..inspection import Inspection
from .outcome import STUDIES, Outcome, Study, join
from .primary import NoInput, Primary
from .simulation import Step, fly

BLOCK = 100
"""Runs flown together: what fits into fast memory."""

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
        self.approach = ClosestApproach(q.mean_motion, q.passive_time)
        left_out = {name for family in self.study.without for name in PHI[family]}
        self.judged = [name for names in PHI.values() for name in names if name not in left_out]

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
            self.short_deputies[run] = tuple(int(i) for i in np.flatnonzero(status[run] >= SHORT))
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
    recorder.judge(final, inspection.sun_angle(duration, sun), duration)
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
        Initial states, as from `polaris.inspection.flights.sampling.initial_conditions`.
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
