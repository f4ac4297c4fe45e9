"""The search: worst cases, worst cases about flown paths, mutations of the best, and chance."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from reach.short_repr import short_repr

from ...model.checks import of_kind, whole
from ...model.system import Array
from ...synthesis.schedule.schedule import Schedule
from ..on_board import FlightCode
from ..run_metrics import Runs
from .aborting import aborted, exceeded
from .attacks import Attack, Attacker
from .claims import Attained, Claims, attained
from .drifting import drifted, stopped
from .violations import Failure, Found, broken, confirm, overspent

BATCH = 100_000  # states of all runs flown at a time; more do not stay near the processor
ELITES = 12  # attacks kept per limit
FAULTS_EVERY = 3  # batches until something fails in every flight, where faults are isolated late
ABORT_EVERY = 4  # batches until the flight is aborted, at the start of a step from which that is proven
TAIL_EVERY = 8  # batches until S flies on after T; in the last one it does so if it has not before
SMALLEST = 50  # fewest runs in a batch, but for the last
ROUND = ("worst", "again", "again", "mutate", "mutate", "random", "spending")  # one batch each


@short_repr
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
        The attack behind it (one run), and whether the tail was flown.
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
    case: tuple[Attack, bool] | None
    abort: int | None = None
    spent: float = 0.0
    """Largest velocity change until T [m/s]; its proven bound is `Schedule.delta_v`."""

    @property
    def ratio(self) -> Array:
        """Proven over attained margin: at most 1 while the bound holds, and the nearer to 1 the less idle."""
        with np.errstate(divide="ignore", invalid="ignore"):
            share = self.proven / self.least
        return np.where(np.isfinite(share) & (self.least > 0), share, np.nan)

    def summary(self) -> dict[str, Any]:
        """Return the numbers of a report; strict JSON."""
        return {
            "runs": self.runs,
            "runs_per_s": self.runs / self.seconds if self.seconds > 0 else None,
            "guarantee": self.schedule.guarantee,
            "violated": self.failure is not None,
            "failure": None if self.failure is None else vars(self.failure),
            "delta_v_m_s": self.spent,
            "delta_v_proven_m_s": self.schedule.delta_v[1],
            "limits": [
                {"limit": name, "least": least, "proven": proven, "proven_share": share, "time_s": at}
                for name, least, proven, share, at in zip(
                    self.names, self.least, self.proven, self.ratio, self.at_s, strict=True
                )
            ],
        }


def falsify(
    schedule: Schedule,
    runs: int = 10_000,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
    code: FlightCode | None = None,
) -> Falsification:
    """Search for a run that breaks a schedule's claims.

    Parameters
    ----------
    schedule : Schedule
    runs : int
        Trajectories to fly.
    seed : int
        Same seed, same search.
    progress : callable, optional
        Called with (trajectories flown, trajectories in all).
    code : FlightCode, optional
        Compiled flight code that flies in place of the schedule; aborts are not part of it. With the online
        monitor U asks in every step, and only limits are claimed.

    Returns
    -------
    Falsification
        It stops at the first violation.
    """
    of_kind("schedule", schedule, Schedule, "polaris.synthesize")
    whole("falsify.runs", runs, 1)
    whole("falsify.seed", seed, 0)
    return _Search(schedule, runs, np.random.default_rng(seed), code).run(progress)


class _Search:
    def __init__(
        self, schedule: Schedule, runs: int, rng: np.random.Generator, code: FlightCode | None
    ) -> None:
        self.schedule, self.runs, self.count = schedule, runs, 0
        asks = None if code is None else code.asks
        self.main = Attacker.from_schedule(schedule, False, rng, asks=asks)
        proven_after = schedule.safety.end.proven and schedule.guarantee == "proved"
        self.tail = Attacker.from_schedule(schedule, True, rng, asks=asks) if proven_after else None
        transients = schedule.safety.problem.system.transients
        self.faults = Attacker.from_schedule(schedule, proven_after, rng, True) if transients else None
        self.code = code and code.require_schedule(schedule)
        for attacker in filter(None, (self.main, self.tail, self.faults)):
            attacker.flight.code = self.code
        limits = len(self.main.claims.names)
        self.least, self.at = np.full(limits, np.inf), np.full(limits, np.nan)
        claimed = (self.tail or self.main).claims.floor
        self.proven = np.where(np.isneginf(claimed), np.inf, claimed).min(axis=0)
        self.elites: dict[int, tuple[Attack, Array]] = {}
        self.last: tuple[Runs, Attained] | None = None
        ways = () if schedule.powered is None or code else schedule.powered.ways
        self.aborts = [k for k, way in enumerate(ways) if way.branch is not None]
        self.abort: int | None = None
        self.spent = 0.0

    def run(self, progress: Callable[[int, int], None] | None) -> Falsification:
        start = time.perf_counter()
        # Short flights fit into few batches: then those are made smaller, and one is kept for the tail.
        size = max(min(BATCH // self.main.flight.steps, -(-self.runs // TAIL_EVERY)), SMALLEST)
        batch, refuted, tail_done = 0, None, self.tail is None
        while self.count < self.runs and refuted is None:
            remaining = self.runs - self.count
            due = batch % TAIL_EVERY == TAIL_EVERY - 1 or (not tail_done and remaining <= size and batch > 0)
            attacker = self.tail if self.tail is not None and due else self.main
            attacker = self.faults if self.faults is not None and batch % FAULTS_EVERY == 1 else attacker
            tail_done = tail_done or attacker is self.tail
            count = min(max(min(size, BATCH // attacker.flight.steps), SMALLEST), remaining)
            if self.aborts and batch % ABORT_EVERY == ABORT_EVERY - 2:
                refuted, self.count, batch = self._aborted(count), self.count + count, batch + 1
                continue
            attack = self._attack(attacker, ROUND[batch % len(ROUND)], count)
            runs = attack.fly(attacker.flight)
            measured = attained(attacker.claims, runs, attack.faults)
            self.count, batch = self.count + count, batch + 1
            refuted = self._record(attacker.claims, attack, measured)
            bare = attacker is self.faults or attacker.claims.asks is not None
            refuted = refuted if refuted or bare else self._besides(attack, runs)
            if attacker is self.main:
                self.last = runs, measured
                self._keep(attack, measured)
            if progress:
                progress(self.count, self.runs)
        failure, case = refuted or (None, None)
        names, clock = self.main.claims.names, time.perf_counter() - start
        limits = names, self.least, self.proven, self.at
        return Falsification(self.schedule, *limits, self.count, clock, failure, case, self.abort, self.spent)

    def _attack(self, attacker: Attacker, kind: str, count: int) -> Attack:
        if attacker is self.main:
            if kind == "again" and self.last is not None:
                return attacker.again(*self.last, count)
            if kind == "mutate":
                return attacker.mutate(Attack.join([pool for pool, _ in self.elites.values()]), count)
            if kind in ("random", "spending"):
                return attacker.random(count) if kind == "random" else attacker.spending(count)
        return attacker.failed(count) if attacker is self.faults else attacker.worst(count)

    def _record(self, claims: Claims, attack: Attack, measured: Attained) -> Found | None:
        """Note the least margins; the worst violation."""
        limits, runs = np.arange(len(self.least)), np.argmin(measured.margin, axis=0)
        margins, times = measured.margin[runs, limits], measured.when[runs, limits]
        improved = (margins < self.least) & (not claims.faults)
        self.least[improved], self.at[improved] = margins[improved], times[improved]
        return self._confirmed(claims, attack, measured)

    def _confirmed(self, claims: Claims, attack: Attack, measured: Attained) -> Found | None:
        """Return the worst violation, flown again alone to be sure of it."""
        suspects = np.flatnonzero(np.any([mask.any(axis=1) for mask in broken(claims, measured)], axis=0))
        for run in suspects[np.argsort(measured.margin[suspects].min(axis=1))]:
            alone = attack.pick(np.array([run]))
            if (failure := confirm(claims, alone, self.code)) is not None:
                return failure, (alone, claims.tail)
        return None

    def _aborted(self, count: int) -> Found | None:
        """Return the worst violation of the claims of a flight that is aborted in a step drawn at random."""
        step = int(self.main.rng.choice(self.aborts))
        attacker, attack, runs = aborted(self.schedule, step, count, self.main.rng)
        refuted = self._confirmed(attacker.claims, attack, attained(attacker.claims, runs, attack.faults))
        failure, run = exceeded(self.schedule, step, runs)
        if refuted is None and failure.broken:
            refuted = failure, (attack.pick(np.array([run])), True)
        self.abort = step if refuted else None
        return refuted

    def _besides(self, attack: Attack, runs: Runs) -> Found | None:
        """Return the worst violation of claims of the drift after all thrust stops, or of the spending."""
        passive, failures = self.schedule.passive, []
        if passive is not None and passive.least is not None:
            failures.append(drifted(passive, runs, *stopped(passive, runs, self.main.rng)))
        if len(runs.modes) == self.main.claims.cells:
            self.spent = max(self.spent, float(runs.delta_v.max()))
            failures.append(overspent(runs))
        broken = ((each, (attack.pick(np.array([run])), False)) for each, run in failures if each.broken)
        return next(broken, None)

    def _keep(self, attack: Attack, measured: Attained) -> None:
        """Keep the best attacks on every limit."""
        for limit, score in enumerate(measured.margin.T):
            chosen = np.argsort(score)[:ELITES]
            if not np.isfinite(score[chosen[0]]):
                continue
            pool, value = attack.pick(chosen), score[chosen]
            if limit in self.elites:
                older, ranks = self.elites[limit]
                pool, value = Attack.join([older, pool]), np.concatenate([ranks, value])
            best = np.argsort(value, kind="stable")[:ELITES]
            self.elites[limit] = pool.pick(best), value[best]
