"""Integration of closed loops over all runs at once: whole cells where nothing clips, else step by step."""

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from reach.numerics.linear import discretize

from ..model.craft import Array, Craft
from ..synthesis.controllers.black_box import BlackBox
from ..synthesis.controllers.controllers import AffineController, AnyThrust
from ..synthesis.controllers.neural import NeuralController
from ..synthesis.schedule.schedule import Schedule
from .firing import Firing
from .on_board import FlightCode
from .run_metrics import Runs


def columns(system: Craft, readings: int = 0) -> tuple[slice, slice, slice, slice]:
    """Columns of w, errors of estimates and thrusters where not exact, and shares of the networks' inputs.

    Where shares of commands are constant in a flight their matrix follows the fixed errors of thrusters.
    """
    first = system.p
    second = first + system.n * bool(np.any(system.navigation))
    third = second + system.m * (not system.thrusters.exact) + system.m**2 * system.on_time.constant
    return slice(first), slice(first, second), slice(second, third), slice(third, third + readings)


class Integrator(Firing):
    """Time grid, references and transitions of one simulation.

    What a controller does that may do anything is `free` (steps, R, m); without it, as its `command` says.
    Errors of the estimates that controllers act on are `eta` (steps, R, n). What networks are told of bodies
    is off by `shares` (steps, R, ...) of what is not known; where `bodies` has true states of satellites at
    the nodes, by name (R, N+1, n), it is the truth. Pulses and jitter are flown exactly. Flight
    `code`, if any, decides and commands; `rows` are the flights of it that a call is about, and `sample` the
    measurements that its observer takes in, (R, o).
    """

    code: FlightCode | None = None
    sample: Array | None = None
    rows: slice | NDArray[np.bool_] = slice(None)

    def __init__(self, schedule: Schedule, modes: NDArray[np.int_], substeps: int) -> None:
        safety = schedule.safety
        self.free: Array | None = None
        self.eta: Array | None = None
        self.shares: Array | None = None
        self.bodies: dict[str, Array] = {}
        self.schedule, self.modes, self.substeps = schedule, modes, substeps
        self.system, self.tracking = safety.tracking.system, safety.tracking
        self.thrusters, self.parts = self.system.on_time, []
        self.q = self.tracking.feedback.nodes_per_cell
        self.dt = self.tracking.flow.h / substeps
        self.steps_per_cell = self.q * substeps
        self.safe = safety.reference.fine(self.steps_per_cell)
        self.paths = {}
        laws = [law for law in schedule.controllers if isinstance(law, NeuralController)]
        self.columns = columns(
            self.system, max((law.obstacle_motion[0].shape[-1] for law in laws), default=0)
        )
        last = self.columns[-1].stop
        self.constant = slice(last, last + self.system.p * bool(np.any(self.system.bias)))  # that adds to w
        for number, controller in enumerate(schedule.controllers):
            if (
                isinstance(controller, (AffineController, NeuralController))
                and controller.own is not safety.reference
            ):
                self.paths[number] = controller.own.fine(self.steps_per_cell)

    def split(self, w: Array, first: Array) -> list[Array]:
        """Split disturbances into their `columns`; the constant, of the `first` step, is added to w."""
        disturbance, *errors = (w[..., part] for part in self.columns)
        bias = first[..., self.constant]
        return [disturbance + bias if bias.shape[-1] else disturbance, *errors]

    @cached_property
    def discrete(self) -> tuple[Array, Array, Array]:
        """Transition over a step, and the effects of an input and a disturbance held over it."""
        Ad, Bd = discretize(self.system.A, self.system.B, self.dt)
        return Ad, Bd, discretize(self.system.A, self.system.D, self.dt)[1]

    @cached_property
    def estimate_bounds(self) -> Array:
        """Bounds on errors of estimates in every step, (steps, 1, n), under any earlier commands."""
        cells = [self.error_bounds(self.system.at_step(k)) for k in range(len(self.modes))]
        return np.repeat(np.array(cells)[:, None], self.steps_per_cell, axis=0)

    def error_bounds(self, system: Craft) -> Array:
        """Return bounds on errors of estimates in a step, shape (n,), by the craft as it is in it."""
        return system.estimate_bound(0 * system.u_max)

    @property
    def may_do_anything(self) -> bool:
        """Return True if a controller flies of which nothing but the thrust limits is known."""
        flying = (self.schedule.controllers[i] for i in np.unique(self.modes).tolist())
        return any(isinstance(law, AnyThrust) for law in flying)

    @property
    def steps(self) -> int:
        """Number of integration steps."""
        return len(self.modes) * self.steps_per_cell

    def begin(self, runs: int) -> None:
        """Begin flights: flight code knows of no flight before."""
        super().begin(runs)
        if self.code is not None:
            self.code.start(runs)

    def commanded(self, number: int, k: int, at: int, x: Array) -> Array:
        """Return the value of `command`, or the answer of flight code, which is handed U's command."""
        u, step = self.command(number, k, at, x), k * self.steps_per_cell + at
        if self.code is None:
            return u
        estimate = self.estimate(step, x[:, : self.system.n])
        relieved = np.zeros(len(x), dtype=bool) if self.faults is None else self.faults.by_s(step)
        active = np.where(relieved, 0, number)
        return self.code.step(step // self.substeps, estimate, active, u, self.rows, self.sample)

    def command(self, number: int, k: int, at: int, x: Array) -> Array:
        """Command before clipping, shape (R, m), at the start of step `at` of cell k."""
        controller, step = self.schedule.controllers[number], k * self.steps_per_cell + at
        if number and self.faults is not None and np.any(by_s := self.faults.by_s(step)):
            faults, self.faults = self.faults, None
            others = self.command(number, k, at, x)
            self.faults = faults
            return np.where(by_s[:, None], self.command(0, k, at, x), others)
        if self.free is not None and isinstance(controller, AnyThrust):
            return np.asarray(self.free[step])
        x, xi = self.estimate(step, x), self.safe[k, at]
        reference = self.paths[number][k, at] if number in self.paths else xi
        passed = at * self.dt
        if isinstance(controller, NeuralController):
            bodies = self._obstacle_motion(controller, k, passed, step, len(x))
            return controller.command(k, xi, reference, x, passed, bodies)
        if isinstance(controller, BlackBox):
            return controller.command(k, xi, reference, x, passed)
        return controller.command(k, xi, reference, x)

    def _obstacle_motion(
        self, law: NeuralController, k: int, passed: float, step: int, runs: int
    ) -> Array | None:
        """Return a network's readings of bodies some seconds after the start of cell k, (R, ...)."""
        if self.bodies:
            bodies = {name: states[:, step // self.substeps] for name, states in self.bodies.items()}
            return law.senses.body_motion(k * law.reference.delta + passed, bodies, runs)
        if self.shares is None:
            return None
        middle, half = (part[k, law.node(passed)] for part in law.obstacle_motion)
        return np.asarray(middle + half * self.shares[step][:, : len(half)])

    def sensed(self, step: int, x: Array, error: Array, bound: Array) -> Array:
        """Return errors (R, n) of measured states x in a step, those of range and bearing turned with it.

        Drawn errors, within a bound (n,), say which way: along the true line of sight, and across it.
        """
        if (sights := self.system.sights) is None:
            return error
        stretch, angle, *box = sights[min(step // self.steps_per_cell, len(sights) - 1)]
        scale = float(np.min(bound[:3] / np.maximum(box, 1e-300), initial=1.0))  # measured for another phase
        stretch, angle, box = scale * stretch, np.arcsin(scale * np.sin(angle)), scale * np.array(box)
        share, p = error[:, :3] / np.maximum(bound[:3], 1e-300), x[:, :3]
        norm = np.maximum(np.linalg.norm(p, axis=1, keepdims=True), 1e-300)
        along = np.sum(share * p / norm, axis=1, keepdims=True)
        across = share - along * p / norm
        size = np.linalg.norm(across, axis=1, keepdims=True)
        turn, aside = angle * np.minimum(2 * size, 1.0), across / np.maximum(size, 1e-300)
        view = (norm + stretch * np.clip(2 * along, -1, 1)) * (np.cos(turn) * p / norm + np.sin(turn) * aside)
        return np.hstack([error[:, :3] - share * box + view - p, error[:, 3:]])

    def estimate(self, step: int, x: Array) -> Array:
        """Return the estimates of states in a step, which controllers act on."""
        estimate = (
            x if self.eta is None else x + self.sensed(step, x, self.eta[step], self.estimate_bounds[step, 0])
        )
        if self.eta is not None and self.rest is not None:
            share = self.system.state_offset_at_nodes / np.maximum(
                self.estimate_bounds[step], 1e-300
            )  # not as errors
            estimate = x + (estimate - x) * (1 - share)
        if self.faults is None:
            return np.asarray(estimate)
        lost = self.faults.on(step) & self.faults.outage
        return np.where(lost[:, None], x + self.faults.gap, estimate)

    def move(self, k: int, step: int, x: Array, u: Array, w: Array) -> Array:
        """States (R, n) a step later, u being held."""
        (Ad, Bd, Dd), sub = self.discrete, step % self.substeps
        return np.asarray(x @ Ad.T + u @ Bd.T + w @ Dd.T + self.intersample(sub))

    def period(
        self, number: int, k: int, place: int, x: Array, w: Sequence[Array] | Array
    ) -> tuple[Array, Array, Array, Array]:
        """Fly from one node of cell k to the next, under any law, clipped or not.

        Returned are the states there (R, n), the input (R, m), its demand (R,), and the sum over the steps
        of what counts of velocity change (R,).
        """
        limit = self.system.u_max
        begin, thrust = place * self.substeps, np.zeros(len(x))
        raw = self.commanded(number, k, begin, x)
        demanded = np.max(np.abs(raw) / limit, axis=1)
        u, clipped = self.applied(raw, k * self.steps_per_cell + begin), np.clip(raw, -limit, limit)
        self.start(k * self.steps_per_cell + begin)
        for sub in range(self.substeps):
            step = begin + sub
            x = self.move(k, step, x, u, w[sub])
            if self.faults is not None:
                at, (Ad, Bd, Dd) = k * self.steps_per_cell + step, self.discrete
                wrong = w[sub] @ Dd.T + (u - clipped) @ Bd.T
                eta = 0.0 if self.eta is None or at + 1 == self.steps else self.eta[at + 1]
                self.faults.predict(at, Ad, wrong, eta)
            thrust += self.size(u)
        return x, clipped, demanded, thrust

    def run(self, x0: Array, w: Array) -> Runs:
        """Fly from initial states (R, n) under disturbances held over each step, (steps, R, p).

        Further columns, as `columns` has them, are the errors of the estimates and of the thrusters, and the
        last ones what is constant in a flight. Of constants those of the first step count.
        """
        q, nodes = self.q, len(self.modes) * self.q
        w, *errors = self.split(w, w[:1])
        self.eta, self.thrust, self.shares = (part if part.shape[2] else None for part in errors)
        self.begin(len(x0))
        # Time comes first while writing: every instant's block is then one piece of memory.
        states, inputs = np.empty((nodes + 1, *x0.shape)), np.empty((nodes, len(x0), self.system.m))
        demanded, delta_v = np.zeros((nodes, len(x0))), np.zeros(len(x0))
        states[0] = x0
        boxes = self._boxes()
        for k, number in enumerate(self.modes.tolist()):
            first, last = k * q, (k + 1) * q
            pushes = w[k * self.steps_per_cell : (k + 1) * self.steps_per_cell]
            segment = self._unclipped(number, k, states[first], pushes)
            if segment is None:
                thrust = np.zeros(len(x0))
                for place, node in enumerate(range(first, last)):
                    disturbance = pushes[place * self.substeps :]
                    segment = self.period(number, k, place, states[node], disturbance)
                    states[node + 1], inputs[node], demanded[node], increase = segment
                    thrust += increase
            else:
                states[first + 1 : last + 1], inputs[first:last], demanded[first:last], thrust = segment
            delta_v += thrust * self.dt / self.system.mass
            for box in (box for box, end in boxes.items() if box != number and k < end):
                for place in range(q):  # asked all along, whoever flies
                    self.command(box, k, place * self.substeps, states[first + place])
        times = np.asarray(np.arange(nodes + 1) * self.tracking.flow.h, dtype=float)
        path, applied = states.swapaxes(0, 1), inputs.swapaxes(0, 1)
        faults = self.faults and self.faults.at_nodes(self.substeps)
        return Runs(self.schedule, times, path, applied, demanded.T, delta_v, self.modes, self.bodies, faults)

    def _boxes(self) -> dict[int, int]:
        """Numbers of the black boxes that fly, and the last cell of each."""
        flying = [i for i, law in enumerate(self.schedule.controllers) if isinstance(law, BlackBox)]
        return {i: int(np.flatnonzero(self.modes == i)[-1]) for i in flying if i in self.modes}

    def _unclipped(self, number: int, k: int, x: Array, w: Array) -> tuple[Array, Array, Array, Array] | None:
        """Fly a cell under a linear law that nothing clips in it: one product per step; else None.

        All of the cell's commands are worked out at once afterwards, and none may exceed the limits. Returned
        is what `period` returns for every node, stacked, and what is spent in the whole cell.
        """
        law, limit, count = self.schedule.controllers[number], self.system.u_max, self.steps_per_cell
        parts = self.code, self.thrust, self.rest, self.faults, self.system.nozzles, self.system.sights
        inexact = any(part is not None for part in parts)
        if not isinstance(law, AffineController) or self.substeps > 1 or inexact or len(self.fired):
            return None
        reference = self.paths.get(number, self.safe)[k][:-1]  # of the law's reference, at every step's start
        eta = np.zeros(1) if self.eta is None else self.eta[k * count : (k + 1) * count]
        w = w if self.eta is None else np.concatenate([w, eta], axis=2)
        Ad, Bd, Dd = self.discrete
        Dd = Dd if self.eta is None else np.hstack([Dd, -Bd @ law.gain])
        forced = ((law.own.nu[k] + reference @ law.gain.T) @ Bd.T)[:, None] + w @ Dd.T
        carried = (Ad - Bd @ law.gain).T
        path = np.empty((len(w) + 1, *x.shape))
        path[0] = x
        for step in range(len(w)):
            path[step + 1] = path[step] @ carried + forced[step]
        raw = law.own.nu[k] + (reference[:, None] - path[:-1] - eta) @ law.gain.T
        size = np.abs(raw)
        if not np.all(size <= limit):
            return None
        return path[1:], raw, (size / limit).max(axis=2), size.sum(axis=(0, 2))
