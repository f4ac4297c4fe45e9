"""Closed-loop flights of one method, all runs at once, under conditions that every method shares."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..model.checks import whole
from ..model.system import Array
from ..simulation.disturbances import disturbances
from ..simulation.fault_times import FaultTimes, in_every_second
from ..simulation.integration import Integrator
from ..simulation.simulate import initial_states
from ..synthesis.controllers.black_box import BlackBox
from .decision_grid import DecisionGrid
from .method import FILTERED, Method, Observation


@dataclass(frozen=True, eq=False)
class Conditions:
    """Conditions of R runs, common to all methods.

    Initial states x0 (R, n); what disturbs, held from node to node, w (N, R, p), errors of thrusters and of
    the estimates that laws act on in `columns` of their own; errors (D, R, n) of the estimate that decisions
    are made on; the seed of it all, true states of other satellites included; and what fails in every second
    run, where faults are isolated late.
    """

    x0: Array
    w: Array
    errors: Array
    seed: int
    faults: FaultTimes | None = None

    @classmethod
    def draw(cls, grid: DecisionGrid, runs: int, seed: int) -> "Conditions":
        """Half of the runs under random disturbances, half under worst cases.

        The worst cases are those of the flights of S alone, of U alone and of the schedule, in equal
        shares, for a facet or thruster and an instant drawn at random, from the corner of Theta that
        goes with them. The other runs start in corners and inside of Theta, half and half.
        """
        whole("runs", runs, 1)
        rng = np.random.default_rng(whole("seed", seed, 0))
        schedule, planned = grid.fine_schedule, grid.clearance.planned
        alone = [np.full(planned, mode) for mode in range(min(len(grid.controllers), 2))]
        plans = [schedule.modes, *alone]
        x0 = initial_states(schedule, runs, rng, "mixed")
        flights = [Integrator(schedule, modes, 1) for modes in plans]
        theta = grid.schedule.safety.problem.initial_set
        share, parts, first = runs // 2, [], 0
        for number, flight in enumerate(flights):
            count = (share + number) // len(plans)
            if count:
                w, adjoint = disturbances(flight, count, rng, "worst")
                parts.append(w)
                if len(adjoint):
                    x0[first : first + count] = theta.support_vector(adjoint)
                first += count
        parts.append(disturbances(flights[0], runs - first, rng, "random")[0])
        error_bound = grid.half_widths - grid.system.state_offset_at_nodes * bool(
            grid.system.timing.carried_impulse
        )
        errors = rng.uniform(-1, 1, (grid.decisions, runs, grid.system.n)) * error_bound
        rows = np.vstack([grid.clearance.obstacle_rows[0], grid.tracking.gain, -grid.tracking.gain])
        faults = in_every_second(grid.schedule, 1, rows, grid.decisions * grid.nodes, runs, rng)
        return cls(x0, np.concatenate(parts, axis=1), errors, seed, faults)

    @classmethod
    def undisturbed(cls, grid: DecisionGrid) -> "Conditions":
        """One run from the middle of the initial set, exactly known."""
        x0, last = grid.schedule.safety.problem.initial_set.c[None], grid.decisions * grid.nodes
        none = np.zeros((grid.decisions, 1, grid.system.n))
        return cls(x0, np.zeros((last, 1, Engine(grid).constant.stop)), none, 0)

    def only(self, run: int) -> "Conditions":
        """Return the conditions of one run."""
        one = slice(run, run + 1)
        faults = None if self.faults is None else self.faults.pick(np.array([run]))
        return Conditions(self.x0[one], self.w[:, one], self.errors[:, one], self.seed, faults)


@dataclass(frozen=True, eq=False)
class Flight:
    """All runs of one method."""

    times: Array  # the nodes [s], (N+1,)
    states: Array  # (R, N+1, n)
    inputs: Array  # applied right after every node [N], (R, N, m)
    demanded: Array  # largest ratio of commanded to available thrust, (R, N)
    delta_v: Array  # [m/s], (R,)
    modes: NDArray[np.int_]  # what flew after every node, (R, N)
    margins: Array  # of every decision, see `Choice`, (R, D)
    why: NDArray[np.int_]  # likewise
    deviation: Array  # mean over time of the 2-norm of applied minus desired input [N], (R,)
    seconds: Array  # wall time of each decision, for all runs together, (D,)


def fly(
    grid: DecisionGrid,
    method: Method,
    conditions: Conditions,
    progress: Callable[[int, int], None] | None = None,
) -> Flight:
    """Fly one method from the first decision to T.

    Commands of feedback laws are renewed at the nodes and held, inputs of a filter for a decision period.
    """
    engine, system = Engine(grid), grid.system
    R, D, c = len(conditions.x0), grid.decisions, grid.nodes
    N, delay = D * c, grid.delay if method.delayed else 0
    states, inputs = np.empty((N + 1, R, system.n)), np.empty((N, R, system.m))
    demanded, modes = np.zeros((N, R)), np.zeros((N, R), dtype=int)
    margins, reasons = np.full((D, R), np.nan), np.zeros((D, R), dtype=int)
    seconds, delta_v, deviation = np.zeros(D), np.zeros(R), np.zeros(R)
    flying, u = np.zeros(R, dtype=int), np.zeros((R, system.m))
    preferred = min(1, len(grid.controllers) - 1)
    faults = conditions.faults
    engine.faults = faults and replace(faults.pick(np.arange(R)), latched=False)
    method.start(R)
    engine.code = method.code
    engine.begin(R)
    states[0] = x = conditions.x0
    for k in range(D):
        if progress and k % 50 == 0:
            progress(k, D)
        request = engine.desired(preferred, k * c, x, conditions.w[k * c])
        observed = Observation(k, x + conditions.errors[k], request, flying)
        start = time.perf_counter()
        choice = method.decide(observed)
        seconds[k] = time.perf_counter() - start
        margins[k], reasons[k] = choice.margin, choice.why
        for i in range(c + 1):
            if i == delay:
                flying, u = choice.mode, u if choice.u is None else choice.u
                if faults is not None and method.delayed:
                    flying = np.where(faults.relieved(k * c, k * c + delay), 0, flying)
            if i == c:
                break
            node = k * c + i
            if faults is not None and not method.delayed and method.proven:  # to the end
                flying = np.where(faults.by_s(node), 0, flying)
            desired = engine.desired(preferred, node, x, conditions.w[node]) if i else request
            x, inputs[node], demanded[node], thrust_norm = engine.step(node, flying, u, x, conditions.w[node])
            states[node + 1], modes[node] = x, flying if engine.code is None else engine.code.modes
            delta_v += thrust_norm * engine.dt / system.mass
            deviation += np.linalg.norm(inputs[node] - desired, axis=1)
    return Flight(
        np.asarray(np.arange(N + 1) * grid.h, dtype=float),
        states.swapaxes(0, 1),
        inputs.swapaxes(0, 1),
        demanded.T,
        delta_v,
        modes.T,
        margins.T,
        reasons.T,
        deviation / N,
        seconds,
    )


class Engine(Integrator):
    """Integration from node to node, every run under its own mode; inputs that stand for jitter are held."""

    jitter, edges = 0.0, np.zeros(1)

    def __init__(self, grid: DecisionGrid) -> None:
        self.grid = grid
        super().__init__(grid.fine_schedule, np.zeros(grid.clearance.planned, dtype=int), 1)
        self.thrusters = self.system.on_time if len(self.fired) else self.system.thrusters
        self._desired: dict[int, Array] = {}

    def desired(self, mode: int, node: int, x: Array, w: Array) -> Array:
        """Clipped command of a law that sees states with their drawn errors.

        To be called once for every node, before `step`: black boxes are asked here, for all runs.
        """
        eta = w[:, self.columns[1]]
        self.eta = np.broadcast_to(eta, (self.steps, *eta.shape)) if eta.size else None
        estimate = self.estimate(node, x)
        boxes = (i for i, law in enumerate(self.grid.controllers) if isinstance(law, BlackBox))
        self._desired = {i: self.grid.command(i, node, estimate) for i in boxes}
        command = self._desired[mode] if mode in self._desired else self.grid.command(mode, node, estimate)
        return np.asarray(np.clip(command, -self.system.u_max, self.system.u_max))

    def command(self, number: int, k: int, at: int, x: Array) -> Array:
        """As `Integrator.command`; black boxes have answered in `desired`."""
        if number in self._desired:
            return self._desired[number][self.rows]
        return super().command(number, k, at, x)

    def step(
        self, node: int, flying: NDArray[np.int_], u: Array, x: Array, w: Array
    ) -> tuple[Array, Array, Array, Array]:
        """States at the next node, inputs right after this one, demand, and 1-norm of the inputs."""
        present = np.unique(flying)
        if len(present) == 1:
            return self._under(int(present[0]), node, u, x, w)
        out = [np.empty_like(x), np.empty_like(u), np.empty(len(x)), np.empty(len(x))]
        for mode in present.tolist():
            self.rows = chosen = flying == mode
            remainder, self.rest = self.rest, None if self.rest is None else self.rest[chosen]
            if (faults := self.faults) is not None:
                self.faults = replace(faults.pick(chosen), gap=faults.gap[chosen])
            parts = self._under(mode, node, u[chosen], x[chosen], w[chosen])
            for target, part in zip(out, parts, strict=True):
                target[chosen] = part
            if remainder is not None:
                remainder[chosen], self.rest = self.rest, remainder
            if faults is not None and self.faults is not None:
                faults.gap[chosen], self.faults = self.faults.gap, faults
        self.rows = slice(None)
        return out[0], out[1], out[2], out[3]

    def _under(self, mode: int, node: int, u: Array, x: Array, w: Array) -> tuple[Array, Array, Array, Array]:
        w, *errors = self.split(w, w)
        series = (np.broadcast_to(part, (self.steps, *part.shape)) if part.size else None for part in errors)
        self.eta, self.thrust, self.shares = series
        if mode != FILTERED:
            k, place = divmod(node, self.q)
            return self.period(mode, k, place, x, [w])
        (Ad, Bd, Dd), limit = self.grid.discrete, self.system.u_max
        applied, disturbance = self.applied(u, node), w @ Dd.T
        demand, thrust_norm = (np.abs(u) / limit).max(axis=1), np.abs(applied).sum(axis=1)
        self.start(node)
        after = x @ Ad.T + applied @ Bd.T + disturbance + self.intersample(0)
        if self.faults is not None:
            eta = 0.0 if self.eta is None else self.eta[0]
            self.faults.predict(node, Ad, disturbance + (applied - np.clip(u, -limit, limit)) @ Bd.T, eta)
        return after, np.clip(u, -limit, limit), demand, thrust_norm
