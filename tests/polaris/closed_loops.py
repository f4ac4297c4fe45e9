"""Closed loops flown against a schedule's claim, by an integrator and worst cases of their own.

Nothing here uses the package's simulation, search or reachable sets: matrix exponentials from scipy, and the
adjoint of the loop as it was flown. What is claimed is read off the schedule: modes, references, gains, timed
polytopes, printed margins. In every run S may take over at a node of its own within the steps of an
experimental controller, and keeps control to the end of the tail, or twice as far where safety is claimed for
ever.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from polaris.synthesis.controllers.controllers import AnyThrust
from polaris.synthesis.schedule.schedule import Schedule

Array = NDArray[np.float64]

NUMBERS = 6_000_000
"""Numbers of state held at once."""


def held(A: Array, B: Array, t: float) -> tuple[Array, Array]:
    """``e^{A t}`` and what an input held over t adds."""
    n, m = B.shape
    big = np.zeros((n + m, n + m))
    big[:n, :n], big[:n, n:] = A * t, B * t
    power = expm(big)
    return power[:n, :n], power[:n, n:]


@dataclass(frozen=True, eq=False)
class Attack:
    """Attack on every run."""

    x0: Array  # (R, n)
    w: Array  # disturbance held over each step, (N, R, p)
    free: Array  # inputs of controllers that may do anything, (N, R, m)
    way: Array  # in which direction the state counts for what is aimed at; zero after that, (N, R, n)
    eta: Any = 0.0  # error of the estimates that the laws act on, (N, R, n)
    off: Any = 0.0  # errors of the thrusters, as shares of the largest that the command allows, (N, R, m)


Who = Callable[[int, Array], NDArray[np.int_]]
"""Who flies from a step (number, states of shape (R, n)) on; shape (R,)."""


class Loop:
    """One schedule on a fine grid of time."""

    def __init__(self, schedule: Schedule, parts: int = 0) -> None:
        self.schedule, safety = schedule, schedule.safety
        self.system, self.unsafe = safety.problem.system, safety.clearance.unsafe
        self.q, self.parts = safety.tracking.feedback.nodes_per_cell, parts or 2
        self.per = self.q * self.parts
        self.K, planned = safety.problem.K, safety.reference.cells
        self.cells = planned + (planned - self.K if safety.end.horizon == "infinite" else 0)
        self.N, self.dt = self.cells * self.per, safety.problem.delta / self.per
        self.modes = np.r_[schedule.modes, np.zeros(self.cells - self.K, dtype=int)]
        steps = map(self.system.at_step, range(self.cells))
        self.known = np.array([system.estimate_bound(0 * system.u_max) for system in steps])
        self.gain = safety.tracking.gain
        coasting = np.zeros((self.cells - planned, self.system.m))
        self.nu = np.vstack([safety.reference.nu, coasting])
        self.xi = self._path(safety.reference.chi, self.nu)
        self.laws = {
            i: (law.gain, law.own.nu, self._path(law.own.chi, law.own.nu[: self.K]))
            for i, law in enumerate(schedule.controllers)
            if not isinstance(law, AnyThrust)
        }

    @property
    def remembers(self) -> bool:
        """Return True if a `Computer` works out the state that laws act on, instead of a draw from a box."""
        timing, phases = self.system.timing, self.system.error_by_step is not None
        observed = self.system.observer is not None
        boxed = timing.missed or self.system.transients or (phases and timing.delay and not observed)
        return not boxed and (observed or timing.delay > 0)

    def noise(self, k: int) -> Array:
        """Return what estimates add to commands of their own period in a cell, at most, (m,)."""
        if not self.remembers:
            return self.known[k] @ np.abs(self.gain).T
        timing, n = self.system.timing, self.system.n
        if self.system.observer is not None:
            return np.zeros(self.system.m)
        measured = np.array(timing.measured_error) + self.moved()
        return np.abs(self.gain @ held(self.system.A, np.zeros((n, 1)), timing.delay)[0]) @ measured

    def moved(self) -> Array:
        """Return how far states may be displaced when they are measured."""
        delay = self.system.timing.delay / (self.dt * self.parts)
        between = abs(delay - round(delay)) > 1e-9
        offset = self.system.state_offset if between else self.system.state_offset_at_nodes
        return offset - self.system.carry_offset if self.remembers else offset  # what is carried is flown

    def fire(self, command: Array, carried: Array, error: Array) -> tuple[Array, Array]:
        """Return the inputs that commands (R, m) make in a period, and the impulses that are left (R, m)."""
        h, bit, thrusters = self.dt * self.parts, self.system.timing.carried_impulse, self.system.thrusters
        impulse = command * h + carried
        fired = np.minimum(np.floor(np.abs(impulse) / bit) * bit, self.system.u_max * h) * np.sign(impulse)
        wrong = thrusters.part(fired / h) + thrusters.bit - self.system.on_time.bit
        return fired / h + error * wrong, impulse - fired

    def _path(self, chi: Array, nu: Array) -> Array:
        """States at every step of every cell, (cells, per + 1, n); coasting beyond what is known."""
        phi, gamma = held(self.system.A, self.system.B, self.dt)
        starts = [*chi[: len(nu)]]
        phi_cell = held(self.system.A, self.system.B, self.dt * self.per)[0]
        while len(starts) < len(nu):
            starts.append(phi_cell @ starts[-1])
        out = np.empty((len(nu), self.per + 1, self.system.n))
        out[:, 0] = starts
        for i in range(self.per):
            out[:, i + 1] = out[:, i] @ phi.T + nu @ gamma.T
        return out

    def command(self, number: int, k: int, step: int, x: Array) -> Array:
        """Command of a law before clipping."""
        if number == 0:
            return self.nu[k] + (self.xi[k, step] - x) @ self.gain.T
        gain, nu, path = self.laws[number]
        return nu[k] + (path[k, step] - x) @ gain.T

    def fly(self, attack: Attack, rule: Who) -> Flown:
        """Fly runs; `rule` is asked at every step."""
        A, B, D = self.system.A, self.system.B, self.system.D
        R, n, m = len(attack.x0), self.system.n, self.system.m
        states, clipped = np.empty((self.N + 1, R, n)), np.zeros((self.N, R, m), dtype=bool)
        modes = np.zeros((self.N, R), dtype=np.int8)
        states[0] = x = attack.x0
        Ad, Bd = held(A, B, self.dt)
        Dd = held(A, D, self.dt)[1]
        limit, eta = self.system.u_max, np.broadcast_to(attack.eta, (self.N, R, n))
        error, thrusters = np.broadcast_to(attack.off, (self.N, R, m)), self.system.thrusters
        sees, tightening = (
            Computer(self, states, eta, attack.w) if self.remembers else None,
            np.zeros((self.N, R, n)),
        )
        carried, carries = np.zeros((R, m)), bool(self.remembers and self.system.timing.carried_impulse)
        for i in range(self.N):
            k, j = divmod(i, self.per)
            modes[i] = flying = rule(i, x)
            masks = [(number, flying == number) for number in range(len(self.schedule.controllers))]
            parts = [(number, slice(None) if mask.all() else mask) for number, mask in masks if mask.any()]
            raw, wrong = np.empty((R, m)), eta[i]
            if sees is not None:
                if j % self.parts == 0:
                    sees.look(i)
                wrong, tightening[i] = sees.wrong, sees.wrong - sees.noise
            for number, mask in parts:
                free = number and number not in self.laws
                measured = x[mask] + wrong[mask]
                raw[mask] = attack.free[i, mask] if free else self.command(number, k, j, measured)
            limited = np.clip(raw, -limit, limit)
            thrust = limited + error[i] * thrusters.error(limited)
            if j % self.parts == 0:
                if carries:
                    thrust, carried = self.fire(limited, carried, error[i])
                u, last, command = thrust, np.abs(raw) > limit, limited
            for number, mask in parts:
                if number not in self.laws:
                    u[mask] = thrust[mask]
            clipped[i] = last
            if sees is not None:
                sees.note(i, command, u)
            states[i + 1] = x = x @ Ad.T + u @ Bd.T + attack.w[i] @ Dd.T
        return Flown(states, clipped, modes, tightening)

    def scheduled(self, over: NDArray[np.int_]) -> Who:
        """The schedule, until S takes over at a step of each run's own."""
        return lambda i, _: np.where(i < over, self.modes[i // self.per], 0)

    @cached_property
    def _adjoint(self) -> tuple[Array, Array, Array]:
        """Transition over a step, and what w and u held over it add."""
        A, B, D = self.system.A, self.system.B, self.system.D
        return *held(A, D, self.dt), held(A, B, self.dt)[1]

    def worst(
        self, rows: Array, targets: NDArray[np.int_], modes: NDArray[Any], clipped: Array | None = None
    ) -> Attack:
        """Return what takes runs furthest along a row at an instant (step), with modes and clips as flown."""
        R, (n, m, p) = len(rows), (self.system.n, self.system.m, self.system.p)
        w, free, lams = np.zeros((self.N, R, p)), np.zeros((self.N, R, m)), np.zeros((self.N, R, n))
        lam, effect, eta = np.zeros((R, n)), np.zeros((R, m)), np.zeros((self.N, R, n))
        error, total = np.zeros((self.N, R, m)), np.zeros((R, p))
        bits, (back, push, kick) = 2 ** np.arange(m), self._adjoint
        for i in range(self.N - 1, -1, -1):
            k, j = divmod(i, self.per)
            begins = targets == i + 1
            lam[begins], effect[begins] = rows[begins], 0.0
            case = modes[i] * 2**m + (0 if clipped is None else clipped[i] @ bits)
            for both in np.unique(case):
                run = np.flatnonzero(case == both)
                number, which = divmod(int(both), 2**m)
                direction = lam[run] @ push
                total[run] += direction
                size = np.linalg.norm(direction, axis=1, keepdims=True)
                w[i, run] = self.system.w_max * direction / np.where(size > 0, size, 1)
                thrust = lam[run] @ kick
                lam[run] = lam[run] @ back
                error[i, run] = np.where(thrust + (effect[run] if number in self.laws else 0) < 0, -1, 1)
                if number in self.laws:
                    # Held inputs count in all of their period: the estimate at its first step is what errs.
                    counts = (effect[run] + thrust) * (1.0 - ((which >> np.arange(m)) & 1))
                    far = np.where(counts @ self.laws[number][0] > 0, -1, 1) * self.known[k]
                    eta[i, run] = far
                if number not in self.laws:
                    free[i, run] = np.where(thrust < 0, -1, 1) * self.system.u_max
                else:
                    effect[run] += thrust
                    if j % self.parts == 0:
                        answers = 1.0 - ((which >> np.arange(m)) & 1)
                        lam[run] -= (effect[run] * answers) @ self.laws[number][0]
                        effect[run] = 0.0
            lams[i] = lam
        w += np.sign(total) * self.system.bias  # constant in a flight
        theta = self.schedule.safety.problem.initial_set
        return Attack(theta.c + np.where(lam @ theta.G < 0, -1.0, 1.0) @ theta.G.T, w, free, lams, eta, error)

    def judge(self, flight: Flown, over: NDArray[np.int_], printed: Array) -> Outcome:
        """Least margins of runs, and the least share of the room left once S has taken over for good."""
        states = flight.states
        R, o, m, system = states.shape[1], len(self.unsafe), self.system.m, self.system
        gaps = np.full((R, o), np.inf)
        thrust, share = np.full((R, m), np.inf), np.full(R, np.inf)
        facets = self.schedule.safety.clearance.facets
        for k in range(self.cells):
            at = slice(k * self.per, (k + 1) * self.per + 1)
            x, xi = states[at], self.xi[k][:, None]
            time = np.arange(k * self.per, (k + 1) * self.per + 1)[:, None]
            s_flies = (time >= over) & (over < (k + 1) * self.per)  # a cell's limits end with it
            s = np.linspace(0, 1, self.per + 1)[:, None, None]
            for u, unsafe in enumerate(self.unsafe):
                cell = min(k, unsafe.cells - 1)
                b = unsafe.offsets[cell, 0] * (1 - s) + unsafe.offsets[cell, 1] * s
                rows = unsafe.rows(system)
                out = x @ rows.T - b
                gaps[:, u] = np.minimum(gaps[:, u], out.max(axis=2).min(axis=0))
                if k >= len(facets):  # on an orbit flown again its own facets count, at their own instants
                    continue
                f = facets[k, u]
                clearance = xi @ rows[f] - b[..., f]
                share = np.minimum(share, _least(1 - _share(clearance - out[..., f], clearance), s_flies))
            e = (x - xi)[: self.per : self.parts] + flight.wrong[at][: self.per : self.parts]
            tightening = e @ self.gain.T
            mode = flight.modes[k * self.per : (k + 1) * self.per]
            safe = (mode == 0)[:: self.parts]
            raw = np.abs(self.nu[k] - tightening)
            limit = system.u_max - self.noise(k)
            thrust = np.minimum(thrust, np.where(safe[..., None], limit - raw, np.inf).min(axis=0))
            for sign in (1, -1):
                clearance = limit + sign * self.nu[k]
                free = 1 - _share(sign * tightening, np.broadcast_to(clearance, tightening.shape)).max(axis=2)
                share = np.minimum(share, _least(free, s_flies[: self.per : self.parts]))
        return Outcome(gaps, thrust / system.u_max, share, printed)


class Computer:
    """Flight computer of many runs: measurements, observer, and predictions over a delay."""

    def __init__(self, loop: Loop, states: Array, eta: Array, w: Array) -> None:
        self.loop, self.states, self.eta, self.w = loop, states, eta, w
        system, R = loop.system, states.shape[1]
        self.A, self.B, self.D, self.delay = system.A, system.B, system.D, system.timing.delay
        self.told, self.made = np.zeros((2, loop.N, R, system.m))
        self.wrong, self.noise = np.zeros((2, R, system.n))
        self.estimate: Array | None = None
        self.last = 0.0

    def note(self, i: int, command: Array, thrust: Array) -> None:
        """Remember what was commanded, and made, over a step."""
        self.told[i], self.made[i] = command, thrust

    def look(self, i: int) -> None:
        """Work out what the state is taken to be at a step."""
        x, model, t = self.states[i], self.loop.system.observer, i * self.loop.dt
        at = t - self.delay
        self.noise = np.zeros_like(x)
        sign = np.where(self.eta[i] < 0, -1.0, 1.0)
        offset = self.loop.moved()
        if model is None and at < -1e-9:
            self.wrong = self.eta[i]
            return
        y = self._state(max(at, 0.0))
        if model is None:
            timing = self.loop.system.timing
            error = sign * (np.array(timing.measured_error) + offset)
            carried = self._predict(y, at, t)
            self.noise = error @ held(self.A, self.B, self.delay)[0].T
            self.wrong = carried + self.noise - x
            return
        same = 0 * model.noise if model.constant is None else model.constant  # in the whole flight
        whole = np.where(np.sign(self.eta).sum(axis=0) @ model.gain < 0, -1.0, 1.0)
        each = np.where(sign @ model.gain < 0, -1.0, 1.0)
        noise = (model.noise - same + np.abs(model.measures) @ offset) * each + same * whole
        if self.estimate is None or at < -1e-9:
            self._begin(min(at, 0.0), sign, noise)
            at = 0.0
        else:
            before = self._predict(self.estimate, self.last, at)
            self.estimate = before + (y @ model.measures.T + noise - before @ model.measures.T) @ model.gain.T
        self.last = at
        self.wrong = self._predict(self.estimate, at, t) - x

    def _begin(self, at: float, sign: Array, noise: Array) -> None:
        """Make the first estimate, off by any error within its bound, or another one before the start."""
        model, system = self.loop.system.observer, self.loop.system
        if self.estimate is None:
            bounds = [model.initial, model.settled, np.array(system.timing.measured_error)]
            first = next((each for each in bounds if each is not None and len(each)), system.navigation)
            self.off = sign * first
        else:
            before = self.off @ held(self.A, self.B, self.loop.dt * self.loop.parts)[0].T
            self.off = before + (noise - before @ model.measures.T) @ model.gain.T
        self.estimate = self.states[0] + self.off @ held(self.A, self.B, -at)[0].T  # as of the start

    def _state(self, t: float) -> Array:
        """True states at an instant [s]."""
        i = int(t / self.loop.dt + 1e-6)
        elapsed = t - i * self.loop.dt
        if elapsed < 1e-9 * self.loop.dt:
            return self.states[i]
        (Ad, Bd), Dd = held(self.A, self.B, elapsed), held(self.A, self.D, elapsed)[1]
        return self.states[i] @ Ad.T + self.made[i] @ Bd.T + self.w[i] @ Dd.T

    def _predict(self, x: Array, t: float, until: float) -> Array:
        """States at a later instant under what was commanded."""
        while until - t > 1e-9 * self.loop.dt:
            i = int(t / self.loop.dt + 1e-6)
            length = min((i + 1) * self.loop.dt, until) - t
            Ad, Bd = held(self.A, self.B, length)
            x, t = x @ Ad.T + self.told[i] @ Bd.T, t + length
        return x


@dataclass(frozen=True, eq=False)
class Flown:
    """Runs."""

    states: Array  # (N + 1, R, n)
    clipped: NDArray[np.bool_]  # whose command the thrusters clipped over each step, (N, R, m)
    modes: NDArray[np.int8]  # (N, R)
    wrong: Array  # what laws took the state to be off by, noise of the same period apart, (N, R, n)


@dataclass(frozen=True, eq=False)
class Outcome:
    """Margins of runs."""

    left: Array  # least distance to the nearest facet of every unsafe set [m], (R, o)
    thrust: Array  # least thrust left while S flies, as a share of the limit, (R, m)
    share: Array  # least share of the room left after S took over, (R,)
    printed: Array


def _share(tightening: Array, clearance: Array) -> Array:
    """Need over room; minus infinity where nothing is needed."""
    return np.where(tightening > 0, tightening / np.where(clearance > 0, clearance, 1e-300), -np.inf)


def _least(share: Array, mask: NDArray[np.bool_]) -> Array:
    least: Array = np.where(mask, share, np.inf).min(axis=0)
    return least


@dataclass(eq=False)
class Attacked:
    """Result of attacks on one schedule."""

    runs: int
    left: Array  # least distance to every unsafe set [m], (o,)
    thrust: float  # least thrust left while S flies, as a share of the limit
    over: float  # most by which a printed share exceeds the one flown
    tight: float  # largest need flown over need claimed, both as shares of the room


def attack(schedule: Schedule, runs: int, seed: int, rounds: int = 3, parts: int = 0) -> Attacked:
    """Fly `runs` worst cases `rounds` times, each about the clips of the last, and as many at random."""
    loop, rng = Loop(schedule, parts), np.random.default_rng(seed)
    result = Attacked(0, np.full(len(loop.unsafe), np.inf), np.inf, -np.inf, 0.0)
    batch = max(8, NUMBERS // (loop.N * (2 * loop.system.n + loop.system.p + 2 * loop.system.m)))
    while runs > 0:
        count, runs = min(runs, batch), runs - batch
        over, printed, rows, targets = _aims(loop, count, rng)
        rule, clipped = loop.scheduled(over), None
        modes = np.array([rule(i, rows) for i in range(loop.N)])
        for number in range(rounds + 1):
            worst_case = loop.worst(rows, targets, modes, clipped)
            if number == rounds:
                worst_case = by_chance(loop, worst_case, rng)
            flight = loop.fly(worst_case, rule)
            clipped = flight.clipped
            _note(result, loop.judge(flight, over, printed))
    return result


def _note(result: Attacked, outcome: Outcome) -> None:
    result.runs += len(outcome.share)
    result.left = np.minimum(result.left, outcome.left.min(axis=0, initial=np.inf))
    result.thrust = min(result.thrust, float(outcome.thrust.min()))
    valid = np.isfinite(outcome.printed) & (outcome.printed >= 0) & np.isfinite(outcome.share)
    if np.any(valid):
        result.over = max(result.over, float(np.max(outcome.printed[valid] - outcome.share[valid])))
        tightening = (1 - outcome.share[valid]) / np.maximum(1 - outcome.printed[valid], 1e-12)
        result.tight = max(
            result.tight, float(np.max(np.where(outcome.printed[valid] < 1 - 1e-5, tightening, 0)))
        )


def _aims(loop: Loop, count: int, rng: np.random.Generator) -> tuple[Any, ...]:
    """Instants of hand-over with the margins printed for them, and rows and instants to aim at."""
    u_steps = np.flatnonzero(loop.schedule.modes > 0)
    over, step = np.full(count, loop.N), np.full(count, loop.K)
    draw = rng.random(count)
    alone = draw < (0.1 if len(u_steps) else 0.6)
    over[alone], step[alone] = 0, -1
    if len(u_steps):
        chosen = draw > 0.25
        step[chosen] = rng.choice(u_steps, int(chosen.sum()))
        place = rng.integers(0, loop.per + 1, int(chosen.sum())) // loop.parts * loop.parts
        over[chosen] = step[chosen] * loop.per + place
    first = np.where(over == loop.N, 0, over)
    lead = np.exp(rng.uniform(0, np.log(np.maximum(loop.N - first, 2)))).astype(int)
    targets = np.where(rng.random(count) < 0.6, first + lead, rng.integers(first, loop.N + 1))
    least_time = np.r_[[s.margin.time for s in loop.schedule.steps], np.nan][np.minimum(step, loop.K)]
    least_time = np.where(step < 0, loop.schedule.safety.start_margin.time, least_time)
    near = np.isfinite(least_time) & (rng.random(count) < 0.3)
    bites = np.where(near, least_time, 0) / loop.dt + rng.integers(0, loop.per + 1, count)
    targets = np.where(near, bites.astype(int), targets)
    targets = np.clip(targets, np.maximum(first, 1), loop.N)
    o = len(loop.unsafe)
    facets = loop.schedule.safety.clearance.facets
    rows = np.empty((count, loop.system.n))
    limit = rng.integers(0, o + 1 + (o == 0), count) if o else np.full(count, 0)
    for r in range(count):
        if limit[r] < o:
            unsafe, cell = loop.unsafe[limit[r]], min(targets[r] // loop.per, len(facets) - 1)
            f = facets[cell, limit[r]] if rng.random() < 0.85 else rng.integers(len(unsafe.normals))
            rows[r] = -unsafe.rows(loop.system)[f]
        else:
            rows[r] = rng.choice([-1, 1]) * loop.gain[rng.integers(len(loop.gain))]
    margins = np.r_[loop.schedule.margins, np.nan]
    printed = np.where(step < 0, loop.schedule.safety.start_margin.value, margins[step])
    return over, printed, rows, targets


def arrivals(schedule: Schedule, rounds: int = 3) -> dict[str, float]:
    """Largest shares of what is claimed of the arrival (distance, drift, velocity change) in worst cases."""
    loop, claim, problem = Loop(schedule, 8), schedule.arrival, schedule.safety.problem
    if claim.by is None:
        return {}
    goal, at, eta = problem.goal.conditions, round(claim.by / loop.dt), problem.system.mean_motion
    rows = np.vstack([goal.E, -goal.E, goal.G, *(-N for N, _ in goal.one_of)])
    sides = np.concatenate([goal.e, -goal.e, goal.g, *(-c for _, c in goal.one_of)])
    A, C = problem.system.A, problem.system.position
    speed = np.where(np.any(C != 0, axis=0), 0, np.linalg.norm(C @ A, axis=0))
    length = np.linalg.norm(rows / np.where(speed > 0, speed, np.inf), axis=1)
    rates = (length > 0) & ~np.any(rows[:, speed == 0], axis=1)
    weight = np.where(rates, np.minimum(problem.K * problem.delta / 4 / np.where(rates, length, 1), 1), 1)
    rows, sides = rows * weight[:, None], sides * weight
    drifts = [[2, 0, 0, 0, 1 / eta, 0]] if claim.drift is not None and eta else np.zeros((0, loop.system.n))
    aims = np.vstack([rows, drifts, -np.array(drifts), np.zeros((1, loop.system.n))])
    rule, clips, peak = (loop.scheduled(np.full(len(aims), loop.N)), None, {"distance": 0.0, "delta_v": 0.0})
    modes = np.array([rule(i, aims) for i in range(loop.N)])
    for _ in range(rounds):
        flight = loop.fly(loop.worst(aims, np.full(len(aims), at), modes, clips), rule)
        clips, x = flight.clipped, flight.states[at]
        over, first = x @ rows.T - sides, len(rows) - sum(len(N) for N, _ in goal.one_of)
        parts = [over[:, :first].max(axis=1, initial=0.0)]
        for N, _ in goal.one_of:
            parts.append(over[:, first : first + len(N)].min(axis=1))
            first += len(N)
        error = 1e-8 * float(np.abs(x @ problem.system.position.T).max())  # of the integration [m]
        shares = {"distance": float(np.max(parts)) / (claim.distance + error)}
        shares["delta_v"] = _spent(loop, flight, at) / claim.delta_v
        if len(drifts):
            assert claim.drift is not None
            far = 6 * np.pi * float(np.abs(x @ np.transpose(drifts)).max())
            shares["drift"] = far / (claim.drift + 60 * error)
        peak = {key: max(value, peak.get(key, 0.0)) for key, value in shares.items()}
    return peak


def _spent(loop: Loop, flight: Flown, end: int) -> float:
    """Largest velocity change until a step [m/s]."""
    total = np.zeros(flight.states.shape[1])
    for i in range(end):
        k, j = divmod(i, loop.per)
        number, u_max = int(flight.modes[i, 0]), loop.system.u_max
        if number and number not in loop.laws:
            total += u_max.sum() * loop.dt
            continue
        since = j % loop.parts
        raw = loop.command(number, k, j - since, flight.states[i - since])
        total += np.abs(np.clip(raw, -u_max, u_max)).sum(axis=1) * loop.dt
    return float(total.max()) / loop.system.mass


class Watched:
    """Who flies under an online monitor that is told the state with the worst error it declares."""

    def __init__(self, loop: Loop, monitor: Any, direction: Array) -> None:
        self.loop, self.monitor, self.grid, self.way = loop, monitor, monitor.grid, direction
        self.flying = self.next = np.zeros(direction.shape[1], dtype=int)

    def __call__(self, i: int, x: Array) -> NDArray[np.int_]:
        """Modes from a step on."""
        scene, delay = self.grid, self.grid.delay * self.loop.parts
        each = scene.nodes * self.loop.parts
        k, j = divmod(i, each)
        if delay == each and j == 0:
            self.flying = self.next
        if j == 0 and k >= scene.decisions:
            self.flying = self.next = np.zeros_like(self.flying)
        elif j == 0:
            estimate = x - np.where(self.way[i] < 0, -1, 1) * scene.half_widths
            self.next = self.monitor.judge(k, estimate - scene.xi[k * scene.nodes], self.flying)[0]
        if delay == j:
            self.flying = self.next
        return self.flying


def attack_monitor(monitor: Any, runs: int, seed: int, rounds: int = 3) -> tuple[Attacked, float]:
    """Attack under an online monitor: no hand-overs but its own. Return the share of time under U, too."""
    schedule = monitor.grid.fine_schedule
    loop, rng = Loop(schedule), np.random.default_rng(seed)
    if monitor.trust == "thrust_limits":
        loop.laws = {0: loop.laws[0]}
    result, shares = Attacked(0, np.full(len(loop.unsafe), np.inf), np.inf, -np.inf, 0.0), []
    runs = min(runs, max(8, NUMBERS // (loop.N * (2 * loop.system.n + loop.system.p + 2 * loop.system.m))))
    _, printed, rows, targets = _aims(loop, runs, rng)
    until = targets - (loop.N * rng.random(runs) ** 3).astype(int)  # U before, S after, to begin with
    modes = (np.arange(loop.N)[:, None] < np.minimum(until, loop.K * loop.per)).astype(np.int8)
    never, clipped = np.full(runs, loop.N), None
    for number in range(rounds + 1):
        worst_case = loop.worst(rows, targets, modes, clipped)
        if number == rounds:
            worst_case = by_chance(loop, worst_case, rng)
        flight = loop.fly(worst_case, Watched(loop, monitor, worst_case.way))
        modes, clipped = flight.modes, flight.clipped
        _note(result, loop.judge(flight, never, np.full(runs, np.nan)))
        shares.append(float(np.mean(modes[: loop.K * loop.per] > 0)))
    return result, float(np.mean(shares))


def by_chance(loop: Loop, worst: Attack, rng: np.random.Generator) -> Attack:
    """Disturbances and inputs that jump at random, mostly at their bounds; starts from random corners."""
    R, p = worst.w.shape[1:]
    hold = int(rng.integers(1, 3 * loop.per))
    pieces = -(-loop.N // hold)
    w = rng.normal(size=(pieces, R, p))
    w *= loop.system.w_max / np.linalg.norm(w, axis=2, keepdims=True)
    free = np.sign(rng.uniform(-1, 1, (pieces, R, loop.system.m))) * loop.system.u_max
    eta = rng.uniform(-1, 1, (pieces, R, loop.system.n))
    error = rng.uniform(-1, 1, (pieces, R, loop.system.m))
    theta = loop.schedule.safety.problem.initial_set
    b = np.sign(rng.uniform(-1, 1, (R, theta.G.shape[1])))
    inside = rng.random(R) < 0.3
    b[inside] *= rng.random((int(inside.sum()), 1))
    spread = [np.repeat(x, hold, axis=0)[: loop.N] for x in (w, free, eta, error)]
    spread[2] *= np.repeat(loop.known, loop.per, axis=0)[:, None]
    return Attack(theta.c + b @ theta.G.T, spread[0], spread[1], worst.way, *spread[2:])
