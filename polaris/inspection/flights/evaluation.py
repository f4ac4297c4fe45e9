"""Judge flights: least values of all constraints, when and for whom, also between the samples."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ...model.system import Array
from ..constraints.allowable_set import allowable
from ..constraints.constraint import KINDS, PASSIVE
from ..constraints.families import Families
from ..constraints.strengthening import FAMILIES
from ..constraints.table import Index
from .simulation import InspectionRun

CHUNK = 256  # states judged at a time


@dataclass(frozen=True)
class Least:
    """Least value of a constraint over a run, when and for whom."""

    value: float  # at the starts of the periods and at the instants between; negative if violated
    time: float  # [s]
    deputies: tuple[int, ...]  # the deputy, or the pair
    at_samples: float  # the least value at the starts of the periods alone
    violated_share: float  # share of the instants at which it was negative for anyone


@dataclass(frozen=True, eq=False)
class EvaluatedRun:
    """A flight and its outcome: the least values by name, and of the barriers by family."""

    run: InspectionRun
    constraints: dict[str, Least]
    barriers: dict[str, Least]


class LeastRecorder:
    """Keeps the least value of one constraint over each of R runs, when [s] and for whom.

    `places` (K, 2) are the deputies that its values are about; the second is -1 where there is one only. The
    arrays are as `Least` has them, of shape (R,); `violated` counts instants, of all in `count`.
    """

    def __init__(self, places: Index, runs: int = 1) -> None:
        self.places, self.count = places, 0
        self.value, self.at_samples = np.full(runs, np.inf), np.full(runs, np.inf)
        self.time, self.violated = np.zeros(runs), np.zeros(runs, dtype=np.intp)
        self.deputies = np.tile(places[0], (runs, 1))

    def see(self, t: Array, values: Array, sampled: bool = True) -> None:
        """Take note of values (R, T, K) at the instants t (T,), and whether periods start there."""
        values = np.where(np.isnan(values), -np.inf, values)  # what cannot be told is not safe
        flat = values.reshape(len(values), -1)
        least, place = flat.min(axis=1), flat.argmin(axis=1)
        if sampled:
            self.at_samples = np.minimum(self.at_samples, least)
        k, column = np.divmod(place, values.shape[2])
        improved = least < self.value
        self.value, self.time = np.where(improved, least, self.value), np.where(improved, t[k], self.time)
        self.deputies = np.where(improved[:, None], self.places[column], self.deputies)
        self.violated += (values < 0).any(axis=2).sum(axis=1)
        self.count += len(t)

    def who(self, run: int) -> tuple[int, ...]:
        """The deputy, or the pair, of one run."""
        return tuple(i for i in self.deputies[run].tolist() if i >= 0)

    def least(self, run: int = 0) -> Least:
        """Return the least value of one run."""
        value, time, at_samples = (float(part[run]) for part in (self.value, self.time, self.at_samples))
        return Least(value, time, self.who(run), at_samples, float(self.violated[run]) / self.count)


def keepers(families: Families, runs: int = 1) -> dict[str, LeastRecorder]:
    """Return a keeper for each constraint that the families keep, by name."""
    deputies, pairs = np.split(families.everyone, [families.inspection.deputies])
    custom = families.inspection.constraints
    constraints = [(name, kind.family, kind.pair) for name, kind in KINDS.items()]
    constraints += [(one.label, one.family or one.label, one.pair) for one in custom]
    judged = [(name, pair) for name, family, pair in constraints if family in families.family]
    return {name: LeastRecorder(pairs if pair else deputies, runs) for name, pair in judged}


def least_values(run: InspectionRun, families: Families, between: int) -> EvaluatedRun:
    """Least values of all constraints and of all barriers over a flight.

    The families are all constraints, nothing tightened and none left out; `between` is the number of instants
    inside each period that are judged, too.
    """
    order = (name for name in dict.fromkeys((*FAMILIES, *families.family)) if name in families.family)
    rows = {name: np.flatnonzero(families.among(name)) for name in order}
    barriers = {
        name: LeastRecorder(families.everyone[families.place[chosen]]) for name, chosen in rows.items()
    }
    constraints = keepers(families)
    for t, x, sun, sampled in _instants(run, between):
        values = allowable(run.inspection, x, sun)
        h = families(x, sun).h
        by_family = {name: h[:, chosen] for name, chosen in rows.items()}
        values |= {name: by_family[family] for name, family in PASSIVE.items() if family in by_family}
        for name, keeper in barriers.items():
            keeper.see(t, by_family[name][None], sampled)
        for name, keeper in constraints.items():
            keeper.see(t, values[name][None], sampled)
    least, least_h = ({name: one.least() for name, one in all_.items()} for all_ in (constraints, barriers))
    return EvaluatedRun(run, least, least_h)


def _instants(run: InspectionRun, between: int) -> Iterator[tuple[Array, Array, Array, bool]]:
    """Times, states and sun angles of a flight in pieces, and whether they are starts of periods."""
    period = float(run.t[1] - run.t[0])
    for part in range(between + 1):
        x, t = run.x, run.t
        if part:
            Phi, Gamma = run.inspection.discretize(later := period * (part / (between + 1)))
            x, t = x[:-1] @ Phi.T + run.u @ Gamma.T, t[:-1] + later
        sun = run.inspection.sun_angle(t - run.t[0], run.sun[0])
        for k in range(0, len(t), CHUNK):
            cut = slice(k, k + CHUNK)
            yield t[cut], x[cut], sun[cut], part == 0
