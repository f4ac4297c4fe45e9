"""The search: worst cases, worst cases about what was flown, mutations of the best, and chance."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...model.checks import of_kind, whole
from ...model.system import Array
from ...synthesis.recoverable import directed
from ...synthesis.schedule import Schedule
from ..integration import Integrator
from ..run_metrics import Runs
from .aborting import Aborted
from .attacks import Attack, Attacker
from .claims import EXACT_INPUT, EXACT_M, Attained, Claims, attained
from .drifting import least_distances

BATCH = 100_000
"""States of all runs flown at a time: few enough that they stay near the processor."""

ELITES = 12
"""Attacks kept per limit."""

FAILING_EVERY = 3
"""Every so many batches something fails in every flight, where faults are isolated late."""

ABORT_EVERY = 4
"""Every so many batches the flight is aborted, at the start of one of the steps from which that is proven."""

TAIL_EVERY = 8
"""Every so many batches S flies on after T, and in the last one if it has not before."""

SMALLEST = 50
"""Fewest runs in a batch, but for the last."""

KINDS = ("unsafe set", "saturation", "margin")
"""Kinds of violation while it is flown, the gravest first; besides, those of the drift and of an abort."""

ROUND = ("worst", "again", "again", "mutate", "mutate", "random")
"""One round of the search, a batch each."""


@dataclass(frozen=True)
class Failure:
    """One violation.

    Attributes
    ----------
    kind : {"unsafe set", "saturation", "margin", "drift", "abort"}
        A timed polytope was entered; S asked for more thrust than there is; a run came closer than proven; so
        did the drift of one in which all thrust stopped; an aborted one missed its orbit, or spent more.
    limit : str
        Which unsafe set or input.
    time_s : float
        When [s].
    margin : float
        Margin there [m or N]; below zero for the first two kinds.
    proven : float
        What was proven for that period (-inf: nothing).
    """

    kind: str
    limit: str
    time_s: float
    margin: float
    proven: float

    def __str__(self) -> str:
        claimed = (
            f"{directed(self.proven, '.4g')} is proven" if np.isfinite(self.proven) else "nothing is proven"
        )
        what = {
            "unsafe set": f"{self.limit} is entered",
            "saturation": f"S asks for more {self.limit} than there is",
            "margin": f"the margin to {self.limit} is below the proven one",
            "abort": f"an aborted flight exceeds its {self.limit}",
            "drift": f"the drift after all thrust stops comes closer to {self.limit} than proven",
        }[self.kind]
        return f"{what} at t = {self.time_s:.6g} s (margin {self.margin:.4g}, {claimed})"


Found = tuple[Failure, tuple[Attack, bool, int]]
"""A violation and its case."""


@dataclass(frozen=True, eq=False)
class Falsification:
    """Result of a search.

    Attributes
    ----------
    schedule : Schedule
    names : tuple of str
        Limits.
    least : ndarray, shape (limits,)
        Least margin attained [m, N].
    proven : ndarray, shape (limits,)
        Least proven margin over the same periods [m, N].
    at_s : ndarray, shape (limits,)
        When the least was attained [s].
    runs : int
        Trajectories flown.
    seconds : float
    failure : Failure or None
        The worst violation.
    case : tuple or None
        The attack behind it (one run), whether the tail was flown, and the integration steps per node.
    abort : int or None
        The step at whose start that flight was aborted with thrust, if it was.
    """

    schedule: Schedule
    names: tuple[str, ...]
    least: Array
    proven: Array
    at_s: Array
    runs: int
    seconds: float
    failure: Failure | None
    case: tuple[Attack, bool, int] | None
    abort: int | None = None

    @property
    def ratio(self) -> Array:
        """Proven over attained margin: at most 1 while the bound holds, and the nearer to 1 the less idle."""
        with np.errstate(divide="ignore", invalid="ignore"):
            share = self.proven / self.least
        return np.where(np.isfinite(share) & (self.least > 0), share, np.nan)

    def summary(self) -> dict[str, Any]:
        """The numbers of a report; strict JSON."""
        return {
            "runs": self.runs,
            "runs_per_s": self.runs / self.seconds if self.seconds > 0 else None,
            "guarantee": self.schedule.guarantee,
            "violated": self.failure is not None,
            "failure": None if self.failure is None else vars(self.failure),
            "limits": [
                {"limit": name, "least": least, "proven": proven, "proven_share": share, "time_s": at}
                for name, least, proven, share, at in zip(
                    self.names, self.least, self.proven, self.ratio, self.at_s, strict=True
                )
            ],
        }


def falsify(
    schedule: Schedule, runs: int = 10_000, seed: int = 0, progress: Callable[[int, int], None] | None = None
) -> Falsification:
    """Search for a run that breaks what a schedule claims.

    Parameters
    ----------
    schedule : Schedule
    runs : int
        Trajectories to fly.
    seed : int
        Same seed, same search.
    progress : callable, optional
        Called with (trajectories flown, trajectories in all).

    Returns
    -------
    Falsification
        It stops at the first violation.
    """
    of_kind("schedule", schedule, Schedule, "polaris.synthesize")
    whole("falsify.runs", runs, 1)
    whole("falsify.seed", seed, 0)
    return _Search(schedule, runs, np.random.default_rng(seed)).run(progress)


class _Search:
    def __init__(self, schedule: Schedule, runs: int, rng: np.random.Generator) -> None:
        self.schedule, self.wanted, self.flown = schedule, runs, 0
        self.main = Attacker.of(schedule, False, rng)
        proven_after = schedule.safety.end.proven and schedule.guarantee == "proved"
        self.tail = Attacker.of(schedule, True, rng) if proven_after else None
        transients = schedule.safety.problem.system.transients
        self.failing = Attacker.of(schedule, proven_after, rng, True) if transients else None
        limits = len(self.main.claims.names)
        self.least, self.at = np.full(limits, np.inf), np.full(limits, np.nan)
        claimed = (self.tail or self.main).claims.floor
        self.proven = np.where(np.isneginf(claimed), np.inf, claimed).min(axis=0)
        self.elites: dict[int, tuple[Attack, Array]] = {}
        self.last: tuple[Runs, Attained] | None = None
        ways = () if schedule.powered is None else schedule.powered.ways
        self.aborts = [k for k, way in enumerate(ways) if way.branch is not None]
        self.abort: int | None = None

    def run(self, progress: Callable[[int, int], None] | None) -> Falsification:
        begun = time.perf_counter()
        # Short flights fit into few batches: then those are made smaller, and one is kept for the tail.
        usual = max(min(BATCH // self.main.flight.steps, -(-self.wanted // TAIL_EVERY)), SMALLEST)
        batch, found, beyond = 0, None, self.tail is None
        while self.flown < self.wanted and found is None:
            left = self.wanted - self.flown
            due = batch % TAIL_EVERY == TAIL_EVERY - 1 or (not beyond and left <= usual and batch > 0)
            attacker = self.tail if self.tail is not None and due else self.main
            attacker = self.failing if self.failing is not None and batch % FAILING_EVERY == 1 else attacker
            beyond = beyond or attacker is self.tail
            count = min(max(min(usual, BATCH // attacker.flight.steps), SMALLEST), left)
            if self.aborts and batch % ABORT_EVERY == ABORT_EVERY - 2:
                found, self.flown, batch = self._aborted(count), self.flown + count, batch + 1
                continue
            attack = self._attack(attacker, ROUND[batch % len(ROUND)], count)
            flown = attack.fly(attacker.flight)
            measured = attained(attacker.claims, flown, attack.failing)
            self.flown, batch = self.flown + count, batch + 1
            found = self._record(attacker.claims, attack, measured)
            found = found if found or attacker is self.failing else self._stopped(attack, flown)
            if attacker is self.main:
                self.last = flown, measured
                self._keep(attack, measured)
            if progress:
                progress(self.flown, self.wanted)
        failure, case = found or (None, None)
        names, spent = self.main.claims.names, time.perf_counter() - begun
        limits = names, self.least, self.proven, self.at
        return Falsification(self.schedule, *limits, self.flown, spent, failure, case, self.abort)

    def _attack(self, attacker: Attacker, kind: str, count: int) -> Attack:
        if attacker is self.main:
            if kind == "again" and self.last is not None:
                return attacker.again(*self.last, count)
            if kind == "mutate":
                return attacker.mutate(Attack.join([pool for pool, _ in self.elites.values()]), count)
            if kind == "random":
                return attacker.random(count)
        return attacker.failed(count) if attacker is self.failing else attacker.worst(count)

    def _record(self, claims: Claims, attack: Attack, measured: Attained) -> Found | None:
        """Note the least margins; the worst violation."""
        every, best = np.arange(len(self.least)), np.argmin(measured.margin, axis=0)
        least, when = measured.margin[best, every], measured.when[best, every]
        less = (least < self.least) & (not claims.failing)
        self.least[less], self.at[less] = least[less], when[less]
        return self._confirmed(claims, attack, measured)

    def _confirmed(self, claims: Claims, attack: Attack, measured: Attained) -> Found | None:
        """The worst violation, flown again with finer steps to be sure of it."""
        suspects = np.flatnonzero(np.any([mask.any(axis=1) for mask in broken(claims, measured)], axis=0))
        for run in suspects[np.argsort(measured.margin[suspects].min(axis=1))]:
            confirmed = confirm(claims, attack.pick(np.array([run])))
            if confirmed is not None:
                failure, finer, substeps = confirmed
                return failure, (finer, claims.tail, substeps)
        return None

    def _aborted(self, count: int) -> Found | None:
        """The worst violation of what is claimed of a flight that is aborted in a step drawn at random."""
        tried = Aborted(self.schedule, int(self.main.rng.choice(self.aborts)), count, self.main.rng)
        claims = tried.attacker.claims
        found = self._confirmed(claims, tried.attack, attained(claims, tried.runs))
        limit, when, margin, attack = tried.exceeded()
        if found is None and margin < -EXACT_M:
            found = Failure("abort", limit, when, margin, 0.0), (attack, True, 1)
        self.abort = tried.step if found else None
        return found

    def _stopped(self, attack: Attack, flown: Runs) -> Found | None:
        """The worst violation of what is claimed of the drift after all thrust stops."""
        passive = self.schedule.passive
        if passive is None or passive.least is None:
            return None
        nodes = self.schedule.safety.clearance.q
        margin, run, when = least_distances(passive, flown, nodes, self.main.rng)
        stop, o = np.unravel_index(int(margin.argmin()), margin.shape)
        least = float(margin[stop, o])
        if not least < passive.least - EXACT_M:
            return None
        failure = Failure("drift", passive.flight.sets[o].name, float(when[stop]), least, passive.least)
        return failure, (attack.pick(run[[stop]]), False, 1)

    def _keep(self, attack: Attack, measured: Attained) -> None:
        """Keep the best attacks on every limit."""
        for limit, score in enumerate(measured.margin.T):
            chosen = np.argsort(score)[:ELITES]
            if not np.isfinite(score[chosen[0]]):
                continue
            pool, value = attack.pick(chosen), score[chosen]
            if limit in self.elites:
                older, worth = self.elites[limit]
                pool, value = Attack.join([older, pool]), np.concatenate([worth, value])
            best = np.argsort(value, kind="stable")[:ELITES]
            self.elites[limit] = pool.pick(best), value[best]


def broken(claims: Claims, measured: Attained) -> tuple[Any, Any, Any]:
    """Which limits each run violates: by entering, by asking for too much, by coming closer than proven."""
    obstacles = len(claims.unsafe)
    exact = np.full(len(claims.names), EXACT_M)
    exact[obstacles:] = EXACT_INPUT * claims.system.u_max
    entered, beyond = measured.margin < 0, measured.margin < -exact
    entered[:, obstacles:] = beyond[:, :obstacles] = False
    return entered, beyond, measured.below > exact


def violation(claims: Claims, measured: Attained, run: int = 0) -> Failure | None:
    """What one run violates, the gravest first; None if nothing."""
    sizes = measured.margin[run], measured.margin[run], -measured.below[run]
    for kind, mask, size in zip(KINDS, broken(claims, measured), sizes, strict=True):
        which = np.flatnonzero(mask[run])
        if len(which):
            limit = int(which[np.argmin(size[which])])
            when, margin = float(measured.when[run, limit]), float(measured.margin[run, limit])
            floor = float(claims.floor[claims.period_at(when), limit])
            return Failure(kind, claims.names[limit], when, margin, floor)
    return None


def confirm(claims: Claims, attack: Attack) -> tuple[Failure, Attack, int] | None:
    """Fly one attack again with four times as many integration steps, its disturbance the same.

    Returned are the violation, the attack on the finer steps, and their number per node; None if it was none.
    """
    substeps = 1 if claims.schedule.safety.tracking.feedback.sampled else 4
    free = None if attack.free is None else np.repeat(attack.free, substeps, axis=0)
    finer = Attack(attack.x0, np.repeat(attack.w, substeps, axis=0), free, attack.failing)
    flight = Integrator(claims.schedule, claims.modes, substeps)
    failure = violation(claims, attained(claims, finer.fly(flight), attack.failing))
    return None if failure is None else (failure, finer, substeps)
