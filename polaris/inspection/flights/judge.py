"""Judge flights: least values of all constraints, when and for whom, also between the samples."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from ...model.system import Array
from ..constraints.allowable_set import allowable
from ..constraints.catalogue import CONSTRAINTS, FAMILIES, PAIRWISE, PASSIVE
from ..constraints.families import Families
from ..constraints.table import Index
from ..filters.explicit import Filtered
from .simulation import BatchFilter, InspectionRun

CHUNK = 256
"""States judged at a time."""


@dataclass(frozen=True)
class Least:
    """Where a constraint came nearest to being violated.

    Attributes
    ----------
    value : float
        Its least value, at the starts of the periods and at the instants between; negative if violated.
    time : float
        [s]
    deputies : tuple of int
        The deputy, or the pair.
    at_samples : float
        Its least value at the starts of the periods alone.
    violated_share : float
        Share of the instants at which it was negative for anyone.
    """

    value: float
    time: float
    deputies: tuple[int, ...]
    at_samples: float
    violated_share: float


@dataclass(frozen=True, eq=False)
class JudgedRun:
    """A flight and what it came to.

    Attributes
    ----------
    run : InspectionRun
    constraints, barriers : dict of str to Least
        By `CONSTRAINTS`, and by family.
    seconds : ndarray, shape (K,)
        Wall time of the filter in each period [s].
    """

    run: InspectionRun
    constraints: dict[str, Least]
    barriers: dict[str, Least]
    seconds: Array


class Stopwatch:
    """A filter that notes how long each answer takes.

    Parameters
    ----------
    inner : BatchFilter
    told : callable, optional
        Called after each answer with their number.
    """

    def __init__(self, inner: BatchFilter, told: Callable[[int], None] = lambda done: None) -> None:
        self.inner, self.told = inner, told
        self.seconds: list[float] = []

    def batch(self, x: Array, sun: Array, desired: Array) -> Filtered:
        """Answer of the inner filter."""
        begun = time.perf_counter()
        found = self.inner.batch(x, sun, desired)
        self.seconds.append(time.perf_counter() - begun)
        self.told(len(self.seconds))
        return found


class Keeper:
    """Keeps the least value of one constraint over each of R runs.

    Parameters
    ----------
    places : ndarray of int, shape (K, 2)
        The deputies that its values are about; the second is -1 where there is one only.
    runs : int

    Attributes
    ----------
    value, time, at_samples : ndarray, shape (R,)
        See `Least`.
    deputies : ndarray of int, shape (R, 2)
    violated : ndarray of int, shape (R,)
        Instants at which it was negative for anyone, of the `seen`.
    """

    def __init__(self, places: Index, runs: int = 1) -> None:
        self.places, self.seen = places, 0
        self.value, self.at_samples = np.full(runs, np.inf), np.full(runs, np.inf)
        self.time, self.violated = np.zeros(runs), np.zeros(runs, dtype=np.intp)
        self.deputies = np.tile(places[0], (runs, 1))

    def see(self, t: Array, values: Array, sampled: bool) -> None:
        """Take note of values (R, T, K) at the instants t (T,), and whether periods start there."""
        values = np.where(np.isnan(values), -np.inf, values)  # what cannot be told is not safe
        flat = values.reshape(len(values), -1)
        least, place = flat.min(axis=1), flat.argmin(axis=1)
        if sampled:
            self.at_samples = np.minimum(self.at_samples, least)
        k, who = np.divmod(place, values.shape[2])
        better = least < self.value
        self.value, self.time = np.where(better, least, self.value), np.where(better, t[k], self.time)
        self.deputies = np.where(better[:, None], self.places[who], self.deputies)
        self.violated += (values < 0).any(axis=2).sum(axis=1)
        self.seen += len(t)

    def least(self, run: int = 0) -> Least:
        """What was found of one run."""
        deputies = tuple(i for i in self.deputies[run].tolist() if i >= 0)
        value, time_, at_samples = (float(part[run]) for part in (self.value, self.time, self.at_samples))
        return Least(value, time_, deputies, at_samples, float(self.violated[run]) / self.seen)


def judge(run: InspectionRun, families: Families, between: int) -> tuple[dict[str, Least], dict[str, Least]]:
    """Least values of all constraints and of all barriers over a flight.

    Parameters
    ----------
    run : InspectionRun
    families : Families
        All constraints, nothing tightened and none left out.
    between : int
        Instants inside each period that are judged, too.
    """
    who = np.stack([families.first, families.second], axis=1)
    rows = {name: np.flatnonzero(families.among(name)) for name in FAMILIES}
    rows = {name: chosen for name, chosen in rows.items() if len(chosen)}
    alone = np.stack([np.arange(run.inspection.deputies), np.full(run.inspection.deputies, -1)], axis=1)
    keepers = {name: Keeper(who[chosen]) for name, chosen in rows.items()}
    for name in CONSTRAINTS:
        places = run.inspection.pairs if name in PAIRWISE else alone
        if len(places) and (name not in PASSIVE or PASSIVE[name] in rows):
            keepers[name] = Keeper(places)
    for t, x, sun, sampled in _instants(run, between):
        h = families(x, sun).h
        found = {name: h[:, chosen] for name, chosen in rows.items()} | allowable(run.inspection, x, sun)
        found |= {name: found[family] for name, family in PASSIVE.items() if family in found}
        for name, keeper in keepers.items():
            keeper.see(t, found[name][None], sampled)
    constraints, barriers = (
        {name: keepers[name].least() for name in names if name in keepers}
        for names in (CONSTRAINTS, FAMILIES)
    )
    return constraints, barriers


def _instants(run: InspectionRun, between: int) -> Iterator[tuple[Array, Array, Array, bool]]:
    """Times, states and sun angles of a flight in pieces, and whether they are starts of periods."""
    period = float(run.t[1] - run.t[0])
    for part in range(between + 1):
        share = part / (between + 1)
        if part:
            Phi, Gamma = run.inspection.held(period * share)
            x, t = run.x[:-1] @ Phi.T + run.u @ Gamma.T, run.t[:-1] + period * share
        else:
            x, t = run.x, run.t
        sun = run.inspection.sun_angle(t - run.t[0], run.sun[0])
        for k in range(0, len(t), CHUNK):
            cut = slice(k, k + CHUNK)
            yield t[cut], x[cut], sun[cut], part == 0
