"""What a Monte Carlo compares (studies), and what comes out of it (outcomes)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...model.system import Array
from ..constraints.families import Families
from ..constraints.motion import SampledData
from ..constraints.strengthening import Strengthening
from ..filters.explicit import CENTRALIZED, make_filter
from ..inspection import Inspection
from .simulation import BatchFilter


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


def join(outcomes: Sequence[Outcome]) -> Outcome:
    """Results of all blocks of one study, in order."""
    first = outcomes[0]

    def joined(name: str) -> dict[str, Any]:
        return {key: np.concatenate([getattr(o, name)[key] for o in outcomes]) for key in first.least}

    return Outcome(
        first.study,
        joined("least"),
        joined("where"),
        joined("when"),
        np.concatenate([o.short for o in outcomes]),
        tuple(who for o in outcomes for who in o.short_deputies),
        np.concatenate([o.interventions for o in outcomes]),
        np.concatenate([o.delta_v for o in outcomes]),
    )
