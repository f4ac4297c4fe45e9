"""The search: worst cases, worst cases about what was flown, mutations of the best, and chance."""

from __future__ import annotations

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
from .attacks import Attack, Attacker
from .claims import Claims
from .measure import EXACT_INPUT, EXACT_M, Attained, attained

BATCH = 100_000
"""States of all runs flown at a time: few enough that they stay near the processor."""

ELITES = 12
"""Attacks kept per limit."""

TAIL_EVERY = 8
"""Every so many batches S flies on after T, and in the last one if it has not before."""

SMALLEST = 50
"""Fewest runs in a batch, but for the last."""

KINDS = ("unsafe set", "saturation", "margin")
"""Kinds of violation, the gravest first."""

ROUND = ("worst", "again", "again", "mutate", "mutate", "random")
"""One round of the search, a batch each."""


@dataclass(frozen=True)
class Failure:
    """One violation.

    Attributes
    ----------
    kind : {"unsafe set", "saturation", "margin"}
        A timed polytope was entered; S asked for more thrust than there is; a run came closer than proven.
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
        }[self.kind]
        return f"{what} at t = {self.time_s:.6g} s (margin {self.margin:.4g}, {claimed})"


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
    schedule: Schedule,
    runs: int = 10_000,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
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
        self.substeps = 1
        proven_after = schedule.safety.end.proven and schedule.guarantee == "proved"
        self.arenas = [self._arena(tail, rng) for tail in ((False, True) if proven_after else (False,))]
        limits = len(self.arenas[0][0].names)
        self.least, self.at = np.full(limits, np.inf), np.full(limits, np.nan)
        claimed = self.arenas[-1][0].floor  # with the tail, if there is one
        self.proven = np.where(np.isneginf(claimed), np.inf, claimed).min(axis=(0, 1))

    def _arena(self, tail: bool, rng: np.random.Generator) -> tuple[Claims, Integrator, Attacker]:
        claims = Claims(self.schedule, tail)
        flight = Integrator(self.schedule, claims.modes, self.substeps)
        return claims, flight, Attacker(claims, flight, rng)

    def run(self, progress: Callable[[int, int], None] | None) -> Falsification:
        begun = time.perf_counter()
        batch, failed, beyond = 0, None, len(self.arenas) == 1
        elites: dict[int, Attack] = {}
        worth: dict[int, Array] = {}
        last: tuple[Runs, Attained] | None = None
        while self.flown < self.wanted and failed is None:
            left = self.wanted - self.flown
            # Short flights fit into few batches: then those are made smaller, and one is kept for the tail.
            count = max(min(BATCH // self.arenas[0][1].steps, -(-self.wanted // TAIL_EVERY)), SMALLEST)
            due = batch % TAIL_EVERY == TAIL_EVERY - 1 or (not beyond and 0 < left <= count and batch > 0)
            which = 1 if len(self.arenas) > 1 and due else 0
            claims, flight, attacker = self.arenas[which]
            beyond = beyond or which == 1
            count = min(max(min(count, BATCH // flight.steps), SMALLEST), left)
            kind = "worst" if which else ROUND[batch % len(ROUND)]
            if kind == "again" and last is not None:
                attack = attacker.again(*last, count)
            elif kind == "mutate":
                attack = attacker.mutate(Attack.join(list(elites.values())), count)
            else:
                attack = attacker.random(count) if kind == "random" else attacker.worst(count)
            flown = attack.fly(flight)
            measured = attained(claims, flown)
            self.flown += count
            batch += 1
            failed = self._record(claims, attack, measured)
            if which == 0:
                last = flown, measured
                self._keep(elites, worth, attack, measured)
            if progress:
                progress(self.flown, self.wanted)
        failure, case = (None, None) if failed is None else failed
        return Falsification(
            self.schedule,
            self.arenas[0][0].names,
            self.least,
            self.proven,
            self.at,
            self.flown,
            time.perf_counter() - begun,
            failure,
            case,
        )

    def _record(
        self, claims: Claims, attack: Attack, measured: Attained
    ) -> tuple[Failure, tuple[Attack, bool, int]] | None:
        """Note the least margins; the worst violation, flown again with finer steps to be sure of it."""
        best = np.argmin(measured.margin, axis=0)
        for limit, run in enumerate(best):
            if measured.margin[run, limit] < self.least[limit]:
                self.least[limit] = measured.margin[run, limit]
                self.at[limit] = measured.when[run, limit]
        suspects = np.flatnonzero(np.any([mask.any(axis=1) for mask in broken(claims, measured)], axis=0))
        for run in suspects[np.argsort(measured.margin[suspects].min(axis=1))]:
            confirmed = confirm(claims, attack.pick(np.array([run])), self.substeps)
            if confirmed is not None:
                failure, finer, substeps = confirmed
                return failure, (finer, claims.tail, substeps)
        return None

    def _keep(
        self, elites: dict[int, Attack], worth: dict[int, Array], attack: Attack, measured: Attained
    ) -> None:
        """Keep the best attacks on every limit."""
        for limit in range(measured.margin.shape[1]):
            score = measured.margin[:, limit]
            chosen = np.argsort(score)[:ELITES]
            if not np.isfinite(score[chosen[0]]):
                continue
            pool, value = attack.pick(chosen), score[chosen]
            if limit in elites:
                pool = Attack.join([elites[limit], pool])
                value = np.concatenate([worth[limit], value])
            best = np.argsort(value, kind="stable")[:ELITES]
            elites[limit], worth[limit] = pool.pick(best), value[best]


def broken(claims: Claims, measured: Attained) -> tuple[Any, Any, Any]:
    """Which limits each run violates: by entering, by asking for too much, by coming closer than proven."""
    obstacles = len(claims.unsafe)
    exact = np.full(len(claims.names), EXACT_M)
    exact[obstacles:] = EXACT_INPUT * claims.schedule.safety.problem.system.u_max
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
            floor = claims.floor.reshape(-1, len(claims.names))[claims.period_at(np.array(when)), limit]
            return Failure(kind, claims.names[limit], when, margin, float(floor))
    return None


def confirm(claims: Claims, attack: Attack, substeps: int) -> tuple[Failure, Attack, int] | None:
    """Fly one attack again with four times as many integration steps, its disturbance the same.

    Returns
    -------
    failure, attack, substeps
        The violation, the attack on the finer steps, and their number; None if it was none.
    """
    factor = 1 if claims.schedule.safety.tracking.feedback.sampled else 4
    finer = Attack(
        attack.x0,
        np.repeat(attack.w, factor, axis=0),
        None if attack.free is None else np.repeat(attack.free, factor, axis=0),
    )
    flight = Integrator(claims.schedule, claims.modes, substeps * factor)
    failure = violation(claims, attained(claims, finer.fly(flight)))
    return None if failure is None else (failure, finer, substeps * factor)
