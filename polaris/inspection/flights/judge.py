"""Judge a flight of the inspection problem, also between the samples."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...model.system import Array
from ..constraints.allowable_set import NAMES, allowable
from ..constraints.families import Families
from ..constraints.strengthening import FAMILIES, PRESETS
from ..filters.explicit import Filtered
from ..inspection import Inspection
from .primary import Primary
from .simulation import BatchFilter, InspectionRun, fly_one

CHUNK = 256
"""States judged at a time."""

PASSIVE = {"phi7": "passive", "phi8": "deputy_passive"}
"""The constraints that are their own barriers."""

CONSTRAINTS = (*NAMES[:6], *PASSIVE, *NAMES[6:])
"""phi1 to phi11."""


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


class Unfiltered:
    """No filter at all: what is desired, within the thrust limits. For comparison."""

    def __init__(self, families: Families) -> None:
        self.families = families

    def batch(self, x: Array, sun: Array, desired: Array) -> Filtered:
        """Clip the desired inputs."""
        limit = self.families.inspection.thrust_max
        u = np.clip(desired, -limit, limit)
        return Filtered(u, np.zeros(u.shape[:2], dtype=np.int8), self.families(x, sun))


def fly_unfiltered(
    inspection: Inspection, primary: Primary, x: Array, sun: float, duration: float, period: float = 1.0
) -> InspectionRun:
    """Fly the primary controller alone, as `polaris.inspection.flights.simulation.fly_one`."""
    light = Families(inspection, dict(PRESETS["afrl"]), without=("passive", "deputy_passive"))
    return fly_one(inspection, Unfiltered(light), primary, x, sun, duration, period)


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
    keepers: dict[str, _Keeper] = {}
    pairs: list[tuple[int, ...]] = [tuple(map(int, pair)) for pair in run.inspection.pairs]
    alone: list[tuple[int, ...]] = [(i,) for i in range(run.inspection.deputies)]
    who = list(zip(families.first.tolist(), families.second.tolist(), strict=True))
    columns = {name: [k for k, f in enumerate(families.family) if f == name] for name in FAMILIES}
    for t, x, sun, sampled in _instants(run, between):
        phi = allowable(run.inspection, x, sun)
        h = families(x, sun).h
        found = {name: h[:, chosen] for name, chosen in columns.items() if chosen}
        alike = {name: [who[k] for k in chosen] for name, chosen in columns.items()}
        for name, family in PASSIVE.items():
            if family in found:
                keepers.setdefault(name, _Keeper(alike[family])).see(t, found[family], sampled)
        for name, values in phi.items():
            everyone = pairs if name in ("phi2", "phi5") else alone
            if everyone:
                keepers.setdefault(name, _Keeper(everyone)).see(t, values, sampled)
        for name, values in found.items():
            keepers.setdefault(name, _Keeper(alike[name])).see(t, values, sampled)
    return (
        {name: keepers[name].least for name in CONSTRAINTS if name in keepers},
        {name: keepers[name].least for name in FAMILIES if name in keepers},
    )


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


class _Keeper:
    """Keeps the least value of one constraint."""

    def __init__(self, who: Sequence[tuple[int, ...]]) -> None:
        self.who = who
        self.value = self.at_samples = np.inf
        self.time, self.deputies = 0.0, who[0]
        self.bad = self.seen = 0

    def see(self, t: Array, values: NDArray[np.float64], sampled: bool) -> None:
        """Take note of values of shape (instants, deputies or pairs)."""
        values = np.where(np.isnan(values), -np.inf, values)
        k, place = np.unravel_index(int(values.argmin()), values.shape)
        worst = float(values[k, place])
        if sampled:
            self.at_samples = min(self.at_samples, worst)
        if worst < self.value:
            self.value, self.time, self.deputies = worst, float(t[k]), self.who[int(place)]
        self.bad += int((values < 0).any(axis=1).sum())
        self.seen += len(t)

    @property
    def least(self) -> Least:
        """What was found."""
        deputies = tuple(i for i in self.deputies if i >= 0)
        return Least(self.value, self.time, deputies, self.at_samples, self.bad / self.seen)
