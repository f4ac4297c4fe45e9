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
    made = expm(big)
    return made[:n, :n], made[:n, n:]


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
        self.K, known = safety.problem.K, safety.reference.cells
        self.cells = known + (known - self.K if safety.end.horizon == "infinite" else 0)
        self.N, self.dt = self.cells * self.per, safety.problem.delta / self.per
        self.modes = np.r_[schedule.modes, np.zeros(self.cells - self.K, dtype=int)]
        steps = map(self.system.at_step, range(self.cells))
        self.known = np.array([system.estimate_bound(0 * system.u_max) for system in steps])
        self.gain = safety.tracking.gain
        rest = np.zeros((self.cells - known, self.system.m))
        self.nu = np.vstack([safety.reference.nu, rest])
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
        known = self.system.observer is not None
        boxed = timing.missed or self.system.transients or (phases and timing.delay and not known)
        return not boxed and (known or timing.delay > 0)

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
        off = self.system.timing.delay / (self.dt * self.parts)
        between = abs(off - round(off)) > 1e-9
        away = self.system.state_offset if between else self.system.state_offset_at_nodes
        return away - self.system.carry_offset if self.remembers else away  # what is carried is flown

    def fire(self, told: Array, rest: Array, off: Array) -> tuple[Array, Array]:
        """Return the inputs that commands (R, m) make in a period, and the impulses that are left (R, m)."""
        h, bit, errors = self.dt * self.parts, self.system.timing.carried_impulse, self.system.thrusters
        asked = told * h + rest
        made = np.minimum(np.floor(np.abs(asked) / bit) * bit, self.system.u_max * h) * np.sign(asked)
        wrong = errors.part(made / h) + errors.bit - self.system.on_time.bit
        return made / h + off * wrong, asked - made

    def _path(self, chi: Array, nu: Array) -> Array:
        """States at every step of every cell, (cells, per + 1, n); coasting beyond what is known."""
        carried, pushed = held(self.system.A, self.system.B, self.dt)
        starts = [*chi[: len(nu)]]
        whole = held(self.system.A, self.system.B, self.dt * self.per)[0]
        while len(starts) < len(nu):
            starts.append(whole @ starts[-1])
        out = np.empty((len(nu), self.per + 1, self.system.n))
        out[:, 0] = starts
        for i in range(self.per):
            out[:, i + 1] = out[:, i] @ carried.T + nu @ pushed.T
        return out

    def command(self, number: int, k: int, step: int, x: Array) -> Array:
        """Command of a law before clipping."""
        if number == 0:
            return self.nu[k] + (self.xi[k, step] - x) @ self.gain.T
        gain, nu, own = self.laws[number]
        return nu[k] + (own[k, step] - x) @ gain.T

    def fly(self, attack: Attack, who: Who) -> Flown:
        """Fly runs; `who` is asked at every step."""
        A, B, D = self.system.A, self.system.B, self.system.D
        R, n, m = len(attack.x0), self.system.n, self.system.m
        states, clipped = np.empty((self.N + 1, R, n)), np.zeros((self.N, R, m), dtype=bool)
        modes = np.zeros((self.N, R), dtype=np.int8)
        states[0] = x = attack.x0
        Ad, Bd = held(A, B, self.dt)
        Dd = held(A, D, self.dt)[1]
        limit, eta = self.system.u_max, np.broadcast_to(attack.eta, (self.N, R, n))
        off, errors = np.broadcast_to(attack.off, (self.N, R, m)), self.system.thrusters
        sees, tightening = (
            Computer(self, states, eta, attack.w) if self.remembers else None,
            np.zeros((self.N, R, n)),
        )
        rest, carries = np.zeros((R, m)), bool(self.remembers and self.system.timing.carried_impulse)
        for i in range(self.N):
            k, j = divmod(i, self.per)
            modes[i] = flying = who(i, x)
            masks = [(number, flying == number) for number in range(len(self.schedule.controllers))]
            parts = [(number, slice(None) if mine.all() else mine) for number, mine in masks if mine.any()]
            raw, wrong = np.empty((R, m)), eta[i]
            if sees is not None:
                if j % self.parts == 0:
                    sees.look(i)
                wrong, tightening[i] = sees.wrong, sees.wrong - sees.noise
            for number, mine in parts:
                free = number and number not in self.laws
                seen = x[mine] + wrong[mine]
                raw[mine] = attack.free[i, mine] if free else self.command(number, k, j, seen)
            limited = np.clip(raw, -limit, limit)
            fresh = limited + off[i] * errors.error(limited)
            if j % self.parts == 0:
                if carries:
                    fresh, rest = self.fire(limited, rest, off[i])
                u, last, command = fresh, np.abs(raw) > limit, limited
            for number, mine in parts:
                if number not in self.laws:
                    u[mine] = fresh[mine]
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
        w, free, kept = np.zeros((self.N, R, p)), np.zeros((self.N, R, m)), np.zeros((self.N, R, n))
        lam, spent, eta = np.zeros((R, n)), np.zeros((R, m)), np.zeros((self.N, R, n))
        off, total = np.zeros((self.N, R, m)), np.zeros((R, p))
        bits, (back, push, kick) = 2 ** np.arange(m), self._adjoint
        for i in range(self.N - 1, -1, -1):
            k, j = divmod(i, self.per)
            begins = targets == i + 1
            lam[begins], spent[begins] = rows[begins], 0.0
            case = modes[i] * 2**m + (0 if clipped is None else clipped[i] @ bits)
            for both in np.unique(case):
                run = np.flatnonzero(case == both)
                number, which = divmod(int(both), 2**m)
                way = lam[run] @ push
                total[run] += way
                size = np.linalg.norm(way, axis=1, keepdims=True)
                w[i, run] = self.system.w_max * way / np.where(size > 0, size, 1)
                thrust = lam[run] @ kick
                lam[run] = lam[run] @ back
                off[i, run] = np.where(thrust + (spent[run] if number in self.laws else 0) < 0, -1, 1)
                if number in self.laws:
                    # Held inputs count in all of their period: the estimate at its first step is what errs.
                    counts = (spent[run] + thrust) * (1.0 - ((which >> np.arange(m)) & 1))
                    far = np.where(counts @ self.laws[number][0] > 0, -1, 1) * self.known[k]
                    eta[i, run] = far
                if number not in self.laws:
                    free[i, run] = np.where(thrust < 0, -1, 1) * self.system.u_max
                else:
                    spent[run] += thrust
                    if j % self.parts == 0:
                        answers = 1.0 - ((which >> np.arange(m)) & 1)
                        lam[run] -= (spent[run] * answers) @ self.laws[number][0]
                        spent[run] = 0.0
            kept[i] = lam
        w += np.sign(total) * self.system.bias  # constant in a flight
        theta = self.schedule.safety.problem.initial_set
        return Attack(theta.c + np.where(lam @ theta.G < 0, -1.0, 1.0) @ theta.G.T, w, free, kept, eta, off)

    def judge(self, flown: Flown, over: NDArray[np.int_], printed: Array) -> Outcome:
        """Least margins of runs, and the least share of the room left once S has taken over for good."""
        states = flown.states
        R, o, m, system = states.shape[1], len(self.unsafe), self.system.m, self.system
        left = np.full((R, o), np.inf)
        thrust, share = np.full((R, m), np.inf), np.full(R, np.inf)
        known = self.schedule.safety.clearance.facets
        for k in range(self.cells):
            at = slice(k * self.per, (k + 1) * self.per + 1)
            x, xi = states[at], self.xi[k][:, None]
            time = np.arange(k * self.per, (k + 1) * self.per + 1)[:, None]
            taken = (time >= over) & (over < (k + 1) * self.per)  # a cell's limits end with it
            s = np.linspace(0, 1, self.per + 1)[:, None, None]
            for u, unsafe in enumerate(self.unsafe):
                cell = min(k, unsafe.cells - 1)
                b = unsafe.offsets[cell, 0] * (1 - s) + unsafe.offsets[cell, 1] * s
                rows = unsafe.rows(system)
                out = x @ rows.T - b
                left[:, u] = np.minimum(left[:, u], out.max(axis=2).min(axis=0))
                if k >= len(known):  # on an orbit flown again its own facets count, at their own instants
                    continue
                f = known[k, u]
                clearance = xi @ rows[f] - b[..., f]
                share = np.minimum(share, _least(1 - _share(clearance - out[..., f], clearance), taken))
            e = (x - xi)[: self.per : self.parts] + flown.wrong[at][: self.per : self.parts]
            tightening = e @ self.gain.T
            mode = flown.modes[k * self.per : (k + 1) * self.per]
            safe = (mode == 0)[:: self.parts]
            raw = np.abs(self.nu[k] - tightening)
            limit = system.u_max - self.noise(k)
            thrust = np.minimum(thrust, np.where(safe[..., None], limit - raw, np.inf).min(axis=0))
            for sign in (1, -1):
                clearance = limit + sign * self.nu[k]
                free = 1 - _share(sign * tightening, np.broadcast_to(clearance, tightening.shape)).max(axis=2)
                share = np.minimum(share, _least(free, taken[: self.per : self.parts]))
        return Outcome(left, thrust / system.u_max, share, printed)


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

    def note(self, i: int, told: Array, made: Array) -> None:
        """Remember what was commanded, and made, over a step."""
        self.told[i], self.made[i] = told, made

    def look(self, i: int) -> None:
        """Work out what the state is taken to be at a step."""
        x, seen, now = self.states[i], self.loop.system.observer, i * self.loop.dt
        at = now - self.delay
        self.noise = np.zeros_like(x)
        sign = np.where(self.eta[i] < 0, -1.0, 1.0)
        moved = self.loop.moved()
        if seen is None and at < -1e-9:
            self.wrong = self.eta[i]
            return
        y = self._state(max(at, 0.0))
        if seen is None:
            timing = self.loop.system.timing
            error = sign * (np.array(timing.measured_error) + moved)
            carried = self._predict(y, at, now)
            self.noise = error @ held(self.A, self.B, self.delay)[0].T
            self.wrong = carried + self.noise - x
            return
        same = 0 * seen.noise if seen.constant is None else seen.constant  # in the whole flight
        whole = np.where(np.sign(self.eta).sum(axis=0) @ seen.gain < 0, -1.0, 1.0)
        each = np.where(sign @ seen.gain < 0, -1.0, 1.0)
        noise = (seen.noise - same + np.abs(seen.measures) @ moved) * each + same * whole
        if self.estimate is None or at < -1e-9:
            self._begin(min(at, 0.0), sign, noise)
            at = 0.0
        else:
            before = self._predict(self.estimate, self.last, at)
            self.estimate = before + (y @ seen.measures.T + noise - before @ seen.measures.T) @ seen.gain.T
        self.last = at
        self.wrong = self._predict(self.estimate, at, now) - x

    def _begin(self, at: float, sign: Array, noise: Array) -> None:
        """Make the first estimate, off by any error within its bound, or another one before the start."""
        seen, system = self.loop.system.observer, self.loop.system
        if self.estimate is None:
            known = [seen.initial, seen.settled, np.array(system.timing.measured_error)]
            first = next((each for each in known if each is not None and len(each)), system.navigation)
            self.off = sign * first
        else:
            before = self.off @ held(self.A, self.B, self.loop.dt * self.loop.parts)[0].T
            self.off = before + (noise - before @ seen.measures.T) @ seen.gain.T
        self.estimate = self.states[0] + self.off @ held(self.A, self.B, -at)[0].T  # as of the start

    def _state(self, t: float) -> Array:
        """True states at an instant [s]."""
        i = int(t / self.loop.dt + 1e-6)
        left = t - i * self.loop.dt
        if left < 1e-9 * self.loop.dt:
            return self.states[i]
        (Ad, Bd), Dd = held(self.A, self.B, left), held(self.A, self.D, left)[1]
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


def _least(share: Array, taken: NDArray[np.bool_]) -> Array:
    least: Array = np.where(taken, share, np.inf).min(axis=0)
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
        who, clipped = loop.scheduled(over), None
        modes = np.array([who(i, rows) for i in range(loop.N)])
        for number in range(rounds + 1):
            made = loop.worst(rows, targets, modes, clipped)
            if number == rounds:
                made = by_chance(loop, made, rng)
            flown = loop.fly(made, who)
            clipped = flown.clipped
            _note(result, loop.judge(flown, over, printed))
    return result


def _note(result: Attacked, seen: Outcome) -> None:
    result.runs += len(seen.share)
    result.left = np.minimum(result.left, seen.left.min(axis=0, initial=np.inf))
    result.thrust = min(result.thrust, float(seen.thrust.min()))
    known = np.isfinite(seen.printed) & (seen.printed >= 0) & np.isfinite(seen.share)
    if np.any(known):
        result.over = max(result.over, float(np.max(seen.printed[known] - seen.share[known])))
        tightening = (1 - seen.share[known]) / np.maximum(1 - seen.printed[known], 1e-12)
        result.tight = max(
            result.tight, float(np.max(np.where(seen.printed[known] < 1 - 1e-5, tightening, 0)))
        )


def _aims(loop: Loop, count: int, rng: np.random.Generator) -> tuple[Any, ...]:
    """Instants of hand-over with the margins printed for them, and rows and instants to aim at."""
    flown = np.flatnonzero(loop.schedule.modes > 0)
    over, step = np.full(count, loop.N), np.full(count, loop.K)
    who = rng.random(count)
    alone = who < (0.1 if len(flown) else 0.6)
    over[alone], step[alone] = 0, -1
    if len(flown):
        some = who > 0.25
        step[some] = rng.choice(flown, int(some.sum()))
        place = rng.integers(0, loop.per + 1, int(some.sum())) // loop.parts * loop.parts
        over[some] = step[some] * loop.per + place
    first = np.where(over == loop.N, 0, over)
    ahead = np.exp(rng.uniform(0, np.log(np.maximum(loop.N - first, 2)))).astype(int)
    targets = np.where(rng.random(count) < 0.6, first + ahead, rng.integers(first, loop.N + 1))
    when = np.r_[[s.margin.time for s in loop.schedule.steps], np.nan][np.minimum(step, loop.K)]
    when = np.where(step < 0, loop.schedule.safety.start_margin.time, when)
    near = np.isfinite(when) & (rng.random(count) < 0.3)
    bites = np.where(near, when, 0) / loop.dt + rng.integers(0, loop.per + 1, count)
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
    still = (length > 0) & ~np.any(rows[:, speed == 0], axis=1)
    weight = np.where(still, np.minimum(problem.K * problem.delta / 4 / np.where(still, length, 1), 1), 1)
    rows, sides = rows * weight[:, None], sides * weight
    drifts = [[2, 0, 0, 0, 1 / eta, 0]] if claim.drift is not None and eta else np.zeros((0, loop.system.n))
    aims = np.vstack([rows, drifts, -np.array(drifts), np.zeros((1, loop.system.n))])
    who, clipped, peak = (loop.scheduled(np.full(len(aims), loop.N)), None, {"distance": 0.0, "delta_v": 0.0})
    modes = np.array([who(i, aims) for i in range(loop.N)])
    for _ in range(rounds):
        flown = loop.fly(loop.worst(aims, np.full(len(aims), at), modes, clipped), who)
        clipped, x = flown.clipped, flown.states[at]
        over, first = x @ rows.T - sides, len(rows) - sum(len(N) for N, _ in goal.one_of)
        parts = [over[:, :first].max(axis=1, initial=0.0)]
        for N, _ in goal.one_of:
            parts.append(over[:, first : first + len(N)].min(axis=1))
            first += len(N)
        error = 1e-8 * float(np.abs(x @ problem.system.position.T).max())  # of the integration [m]
        shares = {"distance": float(np.max(parts)) / (claim.distance + error)}
        shares["delta_v"] = _spent(loop, flown, at) / claim.delta_v
        if len(drifts):
            assert claim.drift is not None
            far = 6 * np.pi * float(np.abs(x @ np.transpose(drifts)).max())
            shares["drift"] = far / (claim.drift + 60 * error)
        peak = {key: max(value, peak.get(key, 0.0)) for key, value in shares.items()}
    return peak


def _spent(loop: Loop, flown: Flown, end: int) -> float:
    """Largest velocity change until a step [m/s]."""
    total = np.zeros(flown.states.shape[1])
    for i in range(end):
        k, j = divmod(i, loop.per)
        number, u_max = int(flown.modes[i, 0]), loop.system.u_max
        if number and number not in loop.laws:
            total += u_max.sum() * loop.dt
            continue
        since = j % loop.parts
        raw = loop.command(number, k, j - since, flown.states[i - since])
        total += np.abs(np.clip(raw, -u_max, u_max)).sum(axis=1) * loop.dt
    return float(total.max()) / loop.system.mass


class Watched:
    """Who flies under an online monitor that is told the state with the worst error it declares."""

    def __init__(self, loop: Loop, monitor: Any, way: Array) -> None:
        self.loop, self.monitor, self.grid, self.way = loop, monitor, monitor.grid, way
        self.flying = self.next = np.zeros(way.shape[1], dtype=int)

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
    result, under = Attacked(0, np.full(len(loop.unsafe), np.inf), np.inf, -np.inf, 0.0), []
    runs = min(runs, max(8, NUMBERS // (loop.N * (2 * loop.system.n + loop.system.p + 2 * loop.system.m))))
    _, printed, rows, targets = _aims(loop, runs, rng)
    until = targets - (loop.N * rng.random(runs) ** 3).astype(int)  # U before, S after, to begin with
    modes = (np.arange(loop.N)[:, None] < np.minimum(until, loop.K * loop.per)).astype(np.int8)
    never, clipped = np.full(runs, loop.N), None
    for number in range(rounds + 1):
        made = loop.worst(rows, targets, modes, clipped)
        if number == rounds:
            made = by_chance(loop, made, rng)
        flown = loop.fly(made, Watched(loop, monitor, made.way))
        modes, clipped = flown.modes, flown.clipped
        _note(result, loop.judge(flown, never, np.full(runs, np.nan)))
        under.append(float(np.mean(modes[: loop.K * loop.per] > 0)))
    return result, float(np.mean(under))


def by_chance(loop: Loop, worst: Attack, rng: np.random.Generator) -> Attack:
    """Disturbances and inputs that jump at random, mostly at their bounds; starts from random corners."""
    R, p = worst.w.shape[1:]
    hold = int(rng.integers(1, 3 * loop.per))
    pieces = -(-loop.N // hold)
    w = rng.normal(size=(pieces, R, p))
    w *= loop.system.w_max / np.linalg.norm(w, axis=2, keepdims=True)
    free = np.sign(rng.uniform(-1, 1, (pieces, R, loop.system.m))) * loop.system.u_max
    eta = rng.uniform(-1, 1, (pieces, R, loop.system.n))
    off = rng.uniform(-1, 1, (pieces, R, loop.system.m))
    theta = loop.schedule.safety.problem.initial_set
    b = np.sign(rng.uniform(-1, 1, (R, theta.G.shape[1])))
    inside = rng.random(R) < 0.3
    b[inside] *= rng.random((int(inside.sum()), 1))
    spread = [np.repeat(x, hold, axis=0)[: loop.N] for x in (w, free, eta, off)]
    spread[2] *= np.repeat(loop.known, loop.per, axis=0)[:, None]
    return Attack(theta.c + b @ theta.G.T, spread[0], spread[1], worst.way, *spread[2:])
