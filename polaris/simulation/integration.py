"""Integration of closed loops over all runs at once: whole cells where nothing clips, else step by step."""

from collections.abc import Callable, Sequence
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from reach.numerics.linear import discretize

from ..model.system import Array, LinearSystem
from ..synthesis.black_box import BlackBox
from ..synthesis.controllers import AffineController, AnyThrust
from ..synthesis.neural import NeuralController
from ..synthesis.schedule import Schedule
from .firing import Firing
from .run_metrics import Runs


def runge_kutta(rate: Callable[[int, Array], Array], x: Array, dt: float | Array, first: Array) -> Array:
    """State a step of dt [s] later by the classical scheme of fourth order.

    `rate` is given how many half-steps have passed and the state there; `first` is its value at the start.
    """
    second = rate(1, x + dt / 2 * first)
    third = rate(1, x + dt / 2 * second)
    fourth = rate(2, x + dt * third)
    return np.asarray(x + dt / 6 * (first + 2 * second + 2 * third + fourth))


def columns(system: LinearSystem, told: int = 0) -> tuple[slice, slice, slice, slice]:
    """Columns of w, errors of estimates and thrusters where not exact, and shares of what networks hear."""
    first = system.p
    second = first + system.n * bool(np.any(system.navigation))
    third = second + system.m * (not system.thrusters.exact)
    return slice(first), slice(first, second), slice(second, third), slice(third, third + told)


class Integrator(Firing):
    """Time grid, references and transitions of one simulation.

    What a controller does that may do anything is `free` (steps, R, m); without it, as its `command` says.
    Errors of the estimates that controllers act on are `eta` (steps, R, n). What networks are told of bodies
    is off by `shares` (steps, R, ...) of what is not known; where `bodies` has true states of satellites at
    the nodes, by name (R, N+1, n), it is the truth. Pulses are flown exactly, in several steps by means.
    """

    def __init__(self, schedule: Schedule, modes: NDArray[np.int_], substeps: int) -> None:
        safety = schedule.safety
        self.free: Array | None = None
        self.eta: Array | None = None
        self.shares: Array | None = None
        self.bodies: dict[str, Array] = {}
        self.schedule, self.modes, self.substeps = schedule, modes, substeps
        self.system, self.tracking = safety.tracking.system, safety.tracking
        self.fired = np.array(self.system.timing.fired)
        self.thrusters = (self.system.prompt if len(self.fired) else self.system).thrusters
        self.q, self.sampled = self.tracking.feedback.nodes_per_cell, self.tracking.feedback.sampled
        self.dt = self.tracking.flow.h / substeps
        self.steps_per_cell = self.q * substeps
        self.safe = safety.reference.fine(2 * self.steps_per_cell)
        self.own = {}
        laws = [law for law in schedule.controllers if isinstance(law, NeuralController)]
        self.columns = columns(self.system, max((law.told[0].shape[-1] for law in laws), default=0))
        self._schemes: dict[int, tuple[list[Array], list[Array]]] = {}
        for number, controller in enumerate(schedule.controllers):
            if (
                isinstance(controller, (AffineController, NeuralController))
                and controller.own is not safety.reference
            ):
                self.own[number] = controller.own.fine(2 * self.steps_per_cell)

    @cached_property
    def held(self) -> tuple[Array, Array, Array]:
        """Transition over a step, and what an input and a disturbance held over it add."""
        Ad, Bd = discretize(self.system.A, self.system.B, self.dt)
        return Ad, Bd, discretize(self.system.A, self.system.D, self.dt)[1]

    @cached_property
    def known(self) -> Array:
        """Bounds on errors of estimates in every step, (steps, 1, n), whatever was commanded before."""
        cells = [self.known_to(self.system.at_step(k)) for k in range(len(self.modes))]
        return np.repeat(np.array(cells)[:, None], self.steps_per_cell, axis=0)

    def known_to(self, system: LinearSystem) -> Array:
        """The same in a step, shape (n,)."""
        return system.estimate_off(0 * system.u_max)

    @property
    def may_do_anything(self) -> bool:
        """Whether a controller flies of which nothing but the thrust limits is known."""
        flying = (self.schedule.controllers[i] for i in np.unique(self.modes).tolist())
        return any(isinstance(law, AnyThrust) for law in flying)

    @property
    def steps(self) -> int:
        """Number of integration steps."""
        return len(self.modes) * self.steps_per_cell

    def command(self, number: int, k: int, half: int, x: Array, later: int = 0) -> Array:
        """Command before clipping, shape (R, m), `later` half-steps after the half-step `half` of cell k."""
        controller, step = self.schedule.controllers[number], k * self.steps_per_cell + half // 2
        if number and self.failing is not None and np.any(by_s := self.failing.by_s(step)):
            failing, self.failing = self.failing, None
            others = self.command(number, k, half, x, later)
            self.failing = failing
            return np.where(by_s[:, None], self.command(0, k, half, x, later), others)
        if self.free is not None and isinstance(controller, AnyThrust):
            return np.asarray(self.free[step])
        x, xi = self.estimate(step, x), self.safe[k, half + later]
        own = self.own[number][k, half + later] if number in self.own else xi
        passed = (half + later) / 2 * self.dt
        if isinstance(controller, NeuralController):
            told = self._told(controller, k, passed, step, len(x))
            return controller.command(k, xi, own, x, passed, told)
        if isinstance(controller, BlackBox):
            return controller.command(k, xi, own, x, passed)
        return controller.command(k, xi, own, x)

    def _told(self, law: NeuralController, k: int, passed: float, step: int, runs: int) -> Array | None:
        """What a network is told of bodies some seconds after the start of cell k, (R, ...)."""
        if self.bodies:
            seen = {name: states[:, step // self.substeps] for name, states in self.bodies.items()}
            return law.senses.seen(k * law.reference.delta + passed, seen, runs)
        if self.shares is None:
            return None
        middle, half = (part[k, law.node(passed)] for part in law.told)
        return np.asarray(middle + half * self.shares[step][:, : len(half)])

    def estimate(self, step: int, x: Array) -> Array:
        """What controllers know of states in a step."""
        known = x if self.eta is None else x + self.eta[step]
        if self.eta is not None and self.left is not None:
            flown = self.system.displaced_at_nodes / np.maximum(self.known[step], 1e-300)  # not as errors
            known = x + self.eta[step] * (1 - flown)
        if self.failing is None:
            return np.asarray(known)
        lost = self.failing.on(step) & self.failing.lost
        return np.where(lost[:, None], x + self.failing.gap, known)

    def rate(self, number: int, k: int, half: int, later: int, x: Array, force: Array) -> Array:
        """``x'`` under one controller, `later` half-steps after the half-step `half` of cell k."""
        raw = self.command(number, k, half, x, later)
        u = self.applied(raw, k * self.steps_per_cell + half // 2)
        return np.asarray(x @ self.system.A.T + u @ self.system.B.T + force)

    def move(self, number: int, k: int, step: int, x: Array, u: Array, w: Array) -> Array:
        """States (R, n) a step later; u is what is held, or what a continuous law applies at first."""
        if self.sampled:
            Ad, Bd, Dd = self.held
            sub = step % self.substeps
            if len(self.fired) and self.substeps > 1:
                u = u + self.pulsed(sub / self.substeps, (sub + 1) / self.substeps)
            return np.asarray(x @ Ad.T + u @ Bd.T + w @ Dd.T + self.bow())
        force = w @ self.system.D.T
        rate = partial(self.rate, number, k, 2 * step, force=force)
        return runge_kutta(rate, x, self.dt, x @ self.system.A.T + u @ self.system.B.T + force)

    def period(
        self, number: int, k: int, place: int, x: Array, w: Sequence[Array] | Array
    ) -> tuple[Array, Array, Array, Array]:
        """Fly from one node of cell k to the next, under any law, clipped or not.

        Returned are the states there (R, n), the input applied at the beginning (R, m), the largest demand
        meanwhile (R,), and the sum over the steps of the 1-norm of the input (R,).
        """
        limit = self.system.u_max
        first = u = np.zeros(0)
        demanded, spent = np.zeros(len(x)), np.zeros(len(x))
        for sub in range(self.substeps):
            step = place * self.substeps + sub
            if sub == 0 or not self.sampled:
                raw = self.command(number, k, 2 * step, x)
                demanded = np.maximum(demanded, np.max(np.abs(raw) / limit, axis=1))
                u = self.applied(raw, k * self.steps_per_cell + step)
            first = np.clip(raw, -limit, limit) if sub == 0 else first
            x = self.move(number, k, step, x, u, w[sub])
            if self.failing is not None:
                at, (Ad, Bd, Dd) = k * self.steps_per_cell + step, self.held
                wrong = w[sub] @ Dd.T + (u - np.clip(raw, -limit, limit)) @ Bd.T
                eta = 0.0 if self.eta is None or at + 1 == self.steps else self.eta[at + 1]
                self.failing.predict(at, Ad, wrong, eta)
            size = np.abs(u)
            if self.system.timing.jitter > 0:  # moves thrust in time, and adds little of it
                size = np.minimum(size, self.system.spent(np.minimum(np.abs(raw), limit)))
            spent += size.sum(axis=1)
        return x, first, demanded, spent

    def run(self, x0: Array, w: Array) -> Runs:
        """Fly from initial states (R, n) under disturbances held over each step, (steps, R, p).

        Further columns, as `columns` has them, are the errors of the estimates and of the thrusters.
        """
        q, nodes = self.q, len(self.modes) * self.q
        w, *errors = (w[..., part] for part in self.columns)
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
            flown = self._unclipped(number, k, states[first], pushes)
            if flown is None:
                spent = np.zeros(len(x0))
                for place, node in enumerate(range(first, last)):
                    held = pushes[place * self.substeps :]
                    flown = self.period(number, k, place, states[node], held)
                    states[node + 1], inputs[node], demanded[node], more = flown
                    spent += more
            else:
                states[first + 1 : last + 1], inputs[first:last], demanded[first:last], spent = flown
            delta_v += spent * self.dt / self.system.mass
            for box in (box for box, end in boxes.items() if box != number and k < end):
                for place in range(q):  # asked all along, whoever flies
                    self.command(box, k, 2 * place * self.substeps, states[first + place])
        times = np.asarray(np.arange(nodes + 1) * self.tracking.flow.h, dtype=float)
        path, applied = states.swapaxes(0, 1), inputs.swapaxes(0, 1)
        return Runs(self.schedule, times, path, applied, demanded.T, delta_v, self.modes, self.bodies)

    def _boxes(self) -> dict[int, int]:
        """Numbers of the black boxes that fly, and the last cell of each."""
        flying = [i for i, law in enumerate(self.schedule.controllers) if isinstance(law, BlackBox)]
        return {i: int(np.flatnonzero(self.modes == i)[-1]) for i in flying if i in self.modes}

    def _unclipped(self, number: int, k: int, x: Array, w: Array) -> tuple[Array, Array, Array, Array] | None:
        """Fly a cell under a linear law that nothing clips in it: one product per step; else None.

        The scheme's stages are linear in the state, the references and the disturbance, so all of the
        cell's commands are worked out at once afterwards, and none may exceed the limits. Returned is what
        `period` returns for every node, stacked, and what is spent in the whole cell.
        """
        law, limit, count = self.schedule.controllers[number], self.system.u_max, self.steps_per_cell
        held = self.sampled and self.substeps > 1
        inexact = any(part is not None for part in (self.thrust, self.left, self.failing))
        if not isinstance(law, AffineController) or held or inexact or len(self.fired):
            return None
        own = self.own.get(number, self.safe)[k]  # of the law's reference, at whole and half steps
        eta = np.zeros(1) if self.eta is None else self.eta[k * count : (k + 1) * count]
        w = w if self.eta is None else np.concatenate([w, eta], axis=2)
        carried, forced, places = self._scheme(law, number, k, own, w)
        path = np.empty((len(w) + 1, *x.shape))
        path[0] = x
        for step in range(len(w)):
            path[step + 1] = path[step] @ carried[-1] + forced[-1][step]
        raw = law.own.nu[k] + (own[:-1:2, None] - path[:-1] - eta) @ law.gain.T
        size = np.abs(raw)
        if not np.all(size <= limit):
            return None
        for i, place in enumerate(places):  # the stages within the steps
            inner = path[:-1] @ carried[i] + forced[i]
            if not np.all(np.abs(law.own.nu[k] + (place[:, None] - inner - eta) @ law.gain.T) <= limit):
                return None
        per_node = (size / limit).max(axis=2).reshape(self.q, self.substeps, len(x)).max(axis=1)
        return path[self.substeps :: self.substeps], raw[:: self.substeps], per_node, size.sum(axis=(0, 2))

    def _scheme(
        self, law: AffineController, number: int, k: int, own: Array, w: Array
    ) -> tuple[list[Array], list[Array], list[Array]]:
        """How the state enters the stages within a step and its end, what is added there, and the references.

        The references are those of the stages within a step alone; inputs held over a step have none.
        """
        places = [own[:-1:2], own[1::2], own[1::2], own[2::2]]
        if self.sampled:
            Ad, Bd, Dd = self.held
            Dd = Dd if self.eta is None else np.hstack([Dd, -Bd @ law.gain])
            forced = ((law.own.nu[k] + places[0] @ law.gain.T) @ Bd.T)[:, None] + w @ Dd.T
            return [(Ad - Bd @ law.gain).T], [forced], []
        loop = self.system.A - self.system.B @ law.gain
        if number not in self._schemes:
            carried = [np.eye(self.system.n) + part for part in self._stages(loop, [loop.T] * 4)]
            D, noise = self.system.D, -self.system.B @ law.gain
            enters = D if self.eta is None else np.hstack([D, noise])
            self._schemes[number] = carried, self._stages(loop, [enters.T] * 4)
        carried, pushed = self._schemes[number]
        known = [(law.own.nu[k] + place @ law.gain.T) @ self.system.B.T for place in places]
        stages = zip(self._stages(loop, known), pushed, strict=True)
        added = [part[:, None] + w @ push for part, push in stages]
        return carried[1:], added[1:], places[1:]

    def _stages(self, loop: Array, rates: Sequence[Array]) -> list[Array]:
        """Stages of the scheme for ``x' = loop x + rate`` from rest, and the end; rates at the stages."""
        second = self.dt / 2 * rates[0]
        third = self.dt / 2 * (second @ loop.T + rates[1])
        fourth = self.dt * (third @ loop.T + rates[2])
        total = rates[0] + 2 * (second @ loop.T + rates[1]) + 2 * (third @ loop.T + rates[2])
        total = total + fourth @ loop.T + rates[3]
        return [np.zeros_like(second), second, third, fourth, self.dt / 6 * total]
