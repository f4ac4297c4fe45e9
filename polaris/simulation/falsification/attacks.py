"""Attacks: an initial state and the disturbance (and the inputs of a black box) over every step, per run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...model.system import Array
from ...synthesis.schedule.schedule import Schedule
from ..delayed import flies
from ..disturbances import adjoint_worst_case, disturbances, limit_rows
from ..fault_times import FaultTimes, drawn
from ..integration import Integrator
from ..run_metrics import Runs
from ..simulate import initial_states
from .claims import Attained, Claims


@dataclass(frozen=True, eq=False)
class Attack:
    """Attack on a schedule in R runs.

    Initial states (R, n), disturbances held over each step (steps, R, p), and the inputs (steps, R, m) of
    controllers that may do anything; what fails in each, if that is isolated late.
    """

    x0: Array
    w: Array
    free: Array | None
    faults: FaultTimes | None = None

    def pick(self, chosen: NDArray[np.intp]) -> Attack:
        """Return the attacks of some of the runs."""
        free = None if self.free is None else self.free[:, chosen]
        faults = None if self.faults is None else self.faults.pick(chosen)
        return Attack(self.x0[chosen], self.w[:, chosen], free, faults)

    @classmethod
    def join(cls, parts: list[Attack]) -> Attack:
        """Return one attack with the runs of several."""
        x0, w, free = ([getattr(part, name) for part in parts] for name in ("x0", "w", "free"))
        thrust = None if free[0] is None else np.concatenate(free, axis=1)
        return cls(np.concatenate(x0), np.concatenate(w, axis=1), thrust)

    def fly(self, flight: Integrator) -> Runs:
        """Simulate."""
        flight.free, flight.faults = self.free, self.faults
        return flight.run(self.x0, self.w)


class Attacker:
    """Makes attacks on one schedule, flown on the cells that its claims are about."""

    def __init__(self, claims: Claims, flight: Integrator, rng: np.random.Generator) -> None:
        self.claims, self.flight, self.rng = claims, flight, rng
        self.rows = limit_rows(flight.schedule)
        self.first = np.cumsum([0, *(len(u.normals) for u in claims.unsafe)])
        # Where the proof leaves least: the facet that certifies a period, ranked by what is left there.
        shape = len(claims.unsafe), claims.cells * claims.q
        self._facets = np.array([part.argmax(axis=1) for part in claims.facets], dtype=int).reshape(shape)
        self._slack = np.array([part.max(axis=1) for part in claims.facets]).reshape(shape)

    @classmethod
    def from_schedule(
        cls,
        schedule: Schedule,
        tail: bool,
        rng: np.random.Generator,
        faults: bool = False,
        asks: int | None = None,
    ) -> Attacker:
        """Build an attacker of flights with S's tail after T or without, one integration step per node."""
        claims = Claims(schedule, tail, faults, asks)
        return cls(claims, flies(claims.system)(schedule, claims.modes, 1), rng)

    def random(self, count: int) -> Attack:
        """Random disturbances from random states and corners; inputs at random, most of them bang-bang."""
        w, _ = disturbances(self.flight, count, self.rng, "random")
        x0 = initial_states(self.flight.schedule, count, self.rng, "mixed")
        return Attack(x0, w, self._thrust(count))

    def worst(self, count: int) -> Attack:
        """Return the closed-form worst case of facets and instants: half are where the proof leaves least."""
        return self._towards(*self._aims(count))

    def failed(self, count: int) -> Attack:
        """Return attacks with a fault in every flight, the worst case along S once it flies because of it."""
        rows, targets = self._aims(count)
        flight, schedule = self.flight, self.flight.schedule
        faults = drawn(schedule, 1, rows, targets, self.rng)
        takeover = np.minimum(np.where(faults.outage, faults.begins, faults.ends), targets)
        after = adjoint_worst_case(Integrator(schedule, 0 * flight.modes, 1), rows, targets)[0]
        carried = schedule.safety.tracking.transitions
        first, at_end = (
            np.einsum("rn,rnm->rm", rows, carried[np.clip(targets - instant, 0, len(carried) - 1)])
            for instant in (takeover, faults.ends)
        )
        before = self._towards(first, takeover)
        w = np.where((np.arange(flight.steps)[:, None] >= takeover)[..., None], after, before.w)
        self._set_outage(w, at_end, faults)
        return Attack(before.x0, w, before.free, faults)

    def _set_outage(self, w: Array, rows: Array, faults: FaultTimes) -> None:
        """Set the disturbance while navigation is lost, unanswered: its worst case along rows at the end."""
        (Ad, _, Dd), p = self.flight.discrete, self.flight.system.p
        for back in range(1, int((faults.ends - faults.begins).max()) + 1):
            at = np.flatnonzero(faults.missing(faults.ends - back))
            along = rows[at] @ Dd
            size = np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-300)
            w[faults.ends[at] - back, at, :p] = along * (self.flight.system.w_max / size)
            rows[at] = rows[at] @ Ad

    def _aims(self, count: int) -> tuple[Array, NDArray[np.int_]]:
        """Rows, and instants at which the state is to be far along them."""
        rows = self.rows[self.rng.integers(0, len(self.rows), count)].copy()
        targets = self.rng.integers(1, self.flight.steps + 1, count)
        near = count // 2 if len(self._slack) else 0
        if near:
            scale = max(float(np.median(self._slack)) / 20, 1e-9)
            weight = np.exp(-(self._slack - self._slack.min()) / scale).ravel()
            chosen = self.rng.choice(weight.size, near, p=weight / weight.sum())
            which, period = np.divmod(chosen, self._slack.shape[1])
            rows[:near] = self.rows[self.first[which] + self._facets[which, period]]
            offset = self.rng.integers(0, self.flight.substeps + 1, near)
            targets[:near] = np.clip(period * self.flight.substeps + offset, 1, self.flight.steps)
        return rows, targets

    def again(self, runs: Runs, found: Attained, count: int) -> Attack:
        """Return the worst case about runs just flown, their clipped inputs as they were.

        Half aim at the limit that came out tightest, half at another one, when it was tightest.
        """
        R, limits = found.margin.shape
        # What one unit of margin is worth: metres as they are, inputs by their limits.
        scale = np.concatenate([np.ones(len(self.claims.unsafe)), self.flight.system.u_max / 10])
        which = np.argmin(found.margin / scale, axis=1)
        other = np.flatnonzero(self.rng.random(R) < 0.5)
        which[other] = self.rng.integers(0, limits, len(other))
        step = np.clip(np.rint(found.when[np.arange(R), which] / self.flight.dt).astype(int), 1, None)
        step = np.minimum(step, self.flight.steps)
        node = np.minimum(step // self.flight.substeps, runs.states.shape[1] - 1)
        at = zip(which.tolist(), runs.states[np.arange(R), node], node.tolist(), strict=True)
        rows = np.array([self._row(*aim) for aim in at])
        return self._towards(rows[:count], step[:count], runs.some(slice(count)))

    def spending(self, count: int, rounds: int = 6, until: int | None = None) -> Attack:
        """Ascend to flights of large velocity change, until a step or the end: each at its best round.

        Disturbances are the worst, to first order, for given signs of thrust: at first signs of waves of all
        lengths or of flights by chance, then those of the flight before, in the second half of the rounds
        at each instant those of a flight that spends much about it.
        """
        flight, (steps, m) = self.flight, (self.flight.steps, self.flight.system.m)
        best, totals, last = self.random(count), np.zeros(count), steps if until is None else until
        runs = best.fly(flight)
        half = np.exp(self.rng.uniform(0, np.log(max(steps / 4, 2)), count)).astype(int)[None, :, None]
        waves = (np.arange(steps)[:, None, None] + self.rng.integers(0, 2 * half, (1, count, m))) // half % 2
        at = np.arange(count) % 2 == 0
        for number in range(rounds):
            thrust = runs.inputs.swapaxes(0, 1) if 2 * number < rounds else self._composed(runs, last)
            signs = np.repeat(np.sign(thrust), flight.substeps, axis=0)
            signs = np.where(at[:, None], 2.0 * waves - 1, signs) if number == 0 else signs
            signs[last:] = 0
            attack = self._towards(np.zeros_like(runs.states[:, 0]), np.full(count, steps), runs, signs)
            runs = attack.fly(flight)
            current = np.einsum(
                "rkm,m->r", np.abs(runs.inputs[:, : last // flight.substeps]), flight.system.weights
            )
            improved = current > totals
            best = Attack.join([best.pick(np.flatnonzero(~improved)), attack.pick(np.flatnonzero(improved))])
            totals = np.concatenate([totals[~improved], current[improved]])
        return best

    def _composed(self, runs: Runs, last: int) -> Array:
        """Compose thrust (K, R, m) of flights: at each instant of the one of half of them that spends most.

        What is spent is averaged over a window of random length; the flight that spends most stays.
        """
        u, weights = runs.inputs, self.flight.system.weights
        totals = np.cumsum(np.abs(u) @ weights, axis=1)
        R, K = totals.shape
        composed = np.empty((K, R, u.shape[2]))
        for i in range(R):
            among = self.rng.permutation(R)[: R // 2 + 1]
            width = int(np.exp(self.rng.uniform(np.log(10), np.log(max(last / 2, 11)))))
            ends, begins = (np.clip(np.arange(K) + x, 0, K - 1) for x in (width, -width))
            chosen = among[np.argmax(totals[among][:, ends] - totals[among][:, begins], axis=0)]
            composed[:, i] = u[chosen, np.arange(K)]
        first = int(np.argmax(totals[:, min(last, K) - 1]))
        composed[:, first] = u[first]
        return composed

    def mutate(self, elites: Attack, count: int) -> Attack:
        """Elites changed a little: a stretch of their disturbance from elsewhere, a corner flipped."""
        parents = elites.pick(self.rng.integers(0, len(elites.x0), count))
        w, x0 = parents.w.copy(), parents.x0.copy()
        free = None if parents.free is None else parents.free.copy()
        steps = len(w)
        donor = self.worst(count)
        start = self.rng.integers(0, steps, count)
        length = np.maximum((steps * self.rng.random(count) ** 2).astype(int), 1)
        at = np.arange(steps)[:, None]
        stretch = (at >= start) & (at < start + length)
        w[stretch] = donor.w[stretch]
        if free is not None and donor.free is not None:
            free[stretch] = donor.free[stretch]
        swapped = self.rng.random(count) < 0.3
        x0[swapped] = donor.x0[swapped]
        return Attack(x0, w, free)

    def _towards(
        self, rows: Array, targets: NDArray[np.int_], about: Runs | None = None, spends: Array | None = None
    ) -> Attack:
        w, free, adjoint = adjoint_worst_case(self.flight, rows, targets, about, spends)
        return Attack(self.flight.schedule.safety.problem.initial_set.support_vector(adjoint), w, free)

    def _row(self, limit: int, x: Array, node: int) -> Array:
        """Return the row of a limit that counts at a state: its nearest facet, or the input's sign."""
        claims, m = self.claims, self.flight.system.m
        if limit < len(claims.unsafe):
            period = min(node, claims.cells * claims.q - 1)
            offsets = claims.offsets[limit][int(node > period)][period]
            distance = claims.unsafe[limit].rows(self.flight.system) @ x - offsets
            return np.asarray(self.rows[self.first[limit] + int(np.argmax(distance))])
        axis = limit - len(claims.unsafe)
        return np.asarray(self.rows[self.first[-1] + axis + m * int(self.rng.integers(0, 2))])

    def _thrust(self, count: int) -> Array | None:
        """Random inputs of a controller that may do anything."""
        if not self.flight.may_do_anything:
            return None
        steps, m = self.flight.steps, self.flight.system.m
        hold = int(self.rng.integers(1, 4 * self.flight.steps_per_cell))
        raw = self.rng.uniform(-1, 1, (-(-steps // hold), count, m))
        bang = self.rng.random(count) < 0.7
        raw[:, bang] = np.sign(raw[:, bang])
        return np.repeat(raw, hold, axis=0)[:steps] * self.flight.system.u_max
