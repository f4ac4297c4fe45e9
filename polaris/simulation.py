"""Closed-loop simulation, vectorised over runs, with random and worst-case disturbances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from reach.linear import discretize

from .checks import whole
from .controllers import AffineController, Controller
from .errors import ScenarioError
from .schedule import Schedule
from .system import Array

Disturbance = Literal["none", "random", "worst", "mixed"]
Initial = Literal["center", "random", "corners", "mixed"]
DISTURBANCES = ("none", "random", "worst", "mixed")
INITIALS = ("center", "random", "corners", "mixed")


@dataclass(frozen=True, eq=False)
class Runs:
    """Simulated closed loops.

    Attributes
    ----------
    schedule : Schedule
        What was flown, whole or one of its controllers.
    times : ndarray, shape (N+1,)
        Instants of the states [s]: the nodes of the time grid.
    states : ndarray, shape (R, N+1, n)
        Absolute states.
    inputs : ndarray, shape (R, N, m)
        Input applied right after every node [N], after the thrusters' clipping.
    demanded : ndarray, shape (R, N)
        Largest ratio of commanded to available thrust within each period; above 1 the thrusters
        clipped.
    delta_v : ndarray, shape (R,)
        Velocity change [m/s]: the integral of the 1-norm of the input over the mass.
    modes : ndarray of int, shape (cells,)
        Mode of every step.
    """

    schedule: Schedule
    times: Array
    states: Array
    inputs: Array
    demanded: Array
    delta_v: Array
    modes: NDArray[np.int_]

    @property
    def positions(self) -> Array:
        """Positions [m], shape (R, N+1, d)."""
        return np.asarray(self.states @ self.schedule.safety.tracking.system.position.T)

    @property
    def mode_per_period(self) -> NDArray[np.int_]:
        """Mode over the period after every node, shape (N,)."""
        return np.repeat(self.modes, (len(self.times) - 1) // len(self.modes))

    def metrics(self) -> Any:
        """Distances, times to collision, usage and velocity change; see `polaris.metrics`."""
        from .evaluation import evaluate

        return evaluate(self)


def simulate(
    schedule: Schedule,
    n: int = 100,
    seed: int = 0,
    *,
    mode: int | None = None,
    initial: Initial = "mixed",
    disturbance: Disturbance = "mixed",
    tail: bool = False,
    substeps: int | None = None,
) -> Runs:
    """Fly the schedule, or one controller alone, many times at once.

    Parameters
    ----------
    schedule : Schedule
        Result of `synthesize`.
    n : int
        Number of runs.
    seed : int
        Same seed, same runs.
    mode : int, optional
        Fly this controller alone (0 is S) instead of the schedule.
    initial : {"mixed", "center", "random", "corners"}
        States drawn from Theta; ``mixed`` takes corners for half of the runs.
    disturbance : {"mixed", "none", "random", "worst"}
        ``worst`` is the closed-form worst case of a randomly chosen facet and instant, along the
        controllers as they fly; ``random`` is piecewise constant, half of it on the bound.
    tail : bool
        Fly S on along the coasting tail after T.
    substeps : int, optional
        Integration steps per node: 4 for continuous feedback, 1 for sampled (which is exact) by default.

    Returns
    -------
    Runs

    Notes
    -----
    Feedback is integrated by a fourth-order Runge-Kutta scheme on the exact reference (continuous
    feedback) or by exact zero-order hold (sampled feedback). Thrusters clip every command.
    """
    whole("simulation.runs", n, 1)
    whole("simulation.seed", seed, 0)
    for name, given, allowed in (("initial", initial, INITIALS), ("disturbance", disturbance, DISTURBANCES)):
        if given not in allowed:
            raise ScenarioError(f"simulation.{name}", given, f"must be one of {', '.join(allowed)}")
    if mode is not None and whole("simulation.mode", mode, 0) >= len(schedule.controllers):
        raise ScenarioError("simulation.mode", mode, f"must be below {len(schedule.controllers)}")
    if substeps is not None:
        whole("simulation.substeps", substeps, 1)
    rng = np.random.default_rng(seed)
    safety = schedule.safety
    cells = safety.reference.cells if tail else safety.problem.K
    modes = np.zeros(cells, dtype=int)
    modes[: safety.problem.K] = schedule.modes if mode is None else mode
    if substeps is None:
        substeps = 1 if safety.tracking.feedback.sampled else 4
    flight = _Integrator(schedule, modes, substeps)
    x0 = _initial_states(schedule, n, rng, initial)
    w, adjoint = _disturbances(flight, n, rng, disturbance)
    if initial in ("corners", "mixed") and len(adjoint):
        # The worst disturbance strikes hardest from the corner that lies furthest in its direction.
        theta = safety.problem.initial_set
        x0[: len(adjoint)] = theta.c + np.where(adjoint @ theta.G < 0, -1.0, 1.0) @ theta.G.T
    return flight.run(x0, w)


def _initial_states(schedule: Schedule, n: int, rng: np.random.Generator, initial: Initial) -> Array:
    theta = schedule.safety.problem.initial_set
    if initial == "center":
        return np.repeat(theta.c[None], n, axis=0)
    b = rng.uniform(-1, 1, (n, theta.order_count))
    if initial in ("corners", "mixed"):
        count = n if initial == "corners" else n - n // 2
        b[:count] = np.where(b[:count] < 0, -1.0, 1.0)
    return np.asarray(theta.c + b @ theta.G.T)


class _Integrator:
    """Time grid, references and transitions of one simulation."""

    def __init__(self, schedule: Schedule, modes: NDArray[np.int_], substeps: int) -> None:
        safety = schedule.safety
        self.schedule, self.modes, self.substeps = schedule, modes, substeps
        self.system, self.tracking = safety.tracking.system, safety.tracking
        self.q, self.sampled = self.tracking.feedback.nodes_per_cell, self.tracking.feedback.sampled
        self.dt = self.tracking.flow.h / substeps
        self.steps_per_cell = self.q * substeps
        self.safe = safety.reference.fine(2 * self.steps_per_cell)
        self.own = {}
        self._schemes: dict[int, tuple[Array, list[Array], list[Array]]] = {}
        for number, controller in enumerate(schedule.controllers):
            if isinstance(controller, AffineController) and controller.own is not safety.reference:
                self.own[number] = controller.own.fine(2 * self.steps_per_cell)

    @property
    def steps(self) -> int:
        return len(self.modes) * self.steps_per_cell

    def command(self, controller: Controller, number: int, k: int, half: int, x: Array) -> Array:
        """Command before clipping at a half-step of cell k, shape (R, m)."""
        xi = self.safe[k, half]
        own = self.own[number][k, half] if number in self.own else xi
        return controller.command(k, xi, own, x)

    def rate(self, number: int, k: int, half: int, later: int, x: Array, force: Array) -> Array:
        """``x'`` under one controller, `later` half-steps after the half-step `half` of cell k."""
        limit = self.system.u_max
        raw = self.command(self.schedule.controllers[number], number, k, half + later, x)
        return np.asarray(x @ self.system.A.T + np.clip(raw, -limit, limit) @ self.system.B.T + force)

    def run(self, x0: Array, w: Array) -> Runs:
        R, system, q = len(x0), self.system, self.q
        nodes = len(self.modes) * q
        # Time comes first while writing: every instant's block is then one piece of memory.
        states = np.empty((nodes + 1, R, system.n))
        inputs = np.empty((nodes, R, system.m))
        demanded, delta_v = np.zeros((nodes, R)), np.zeros(R)
        states[0] = x0
        for k, number in enumerate(self.modes.tolist()):
            first, last = k * q, (k + 1) * q
            pushes = w[k * self.steps_per_cell : (k + 1) * self.steps_per_cell]
            flown = None if self.sampled else self._unclipped(number, k, states[first], pushes)
            if flown is None:
                flown = self._stepped(number, k, states[first], pushes)
            states[first + 1 : last + 1], inputs[first:last], demanded[first:last], spent = flown
            delta_v += spent * self.dt / system.mass
        times = np.asarray(np.arange(nodes + 1) * self.tracking.flow.h, dtype=float)
        runs_first = (states.swapaxes(0, 1), inputs.swapaxes(0, 1), demanded.T)
        return Runs(self.schedule, times, *runs_first, delta_v, self.modes)

    def _stepped(self, number: int, k: int, x: Array, w: Array) -> tuple[Array, Array, Array, Array]:
        """Fly one cell step by step: under any law, clipped or not.

        Returns
        -------
        states : ndarray, shape (q, R, n)
            At the end of every period.
        inputs : ndarray, shape (q, R, m)
            Applied at the start of every period.
        demanded : ndarray, shape (q, R)
        spent : ndarray, shape (R,)
            Sum over the steps of the 1-norm of the input.
        """
        R, system, limit = len(x), self.system, self.system.u_max
        states, inputs = np.empty((self.q, R, system.n)), np.empty((self.q, R, system.m))
        demanded, spent = np.zeros((self.q, R)), np.zeros(R)
        Ad, Bd = discretize(system.A, system.B, self.dt)
        _, Dd = discretize(system.A, system.D, self.dt)
        u = np.zeros((R, system.m))
        controller = self.schedule.controllers[number]
        for step in range(self.steps_per_cell):
            node, sub = divmod(step, self.substeps)
            force = w[step] @ system.D.T
            if not self.sampled or sub == 0:
                raw = self.command(controller, number, k, 2 * step, x)
                demanded[node] = np.maximum(demanded[node], np.max(np.abs(raw) / limit, axis=1))
                u = np.clip(raw, -limit, limit)
            if sub == 0:
                inputs[node] = u
            if self.sampled:
                x = x @ Ad.T + u @ Bd.T + w[step] @ Dd.T
            else:
                place = number, k, 2 * step
                first = x @ system.A.T + u @ system.B.T + force
                second = self.rate(*place, 1, x + self.dt / 2 * first, force)
                third = self.rate(*place, 1, x + self.dt / 2 * second, force)
                fourth = self.rate(*place, 2, x + self.dt * third, force)
                x = x + self.dt / 6 * (first + 2 * second + 2 * third + fourth)
            spent += np.abs(u).sum(axis=1)
            states[node] = x
        return states, inputs, demanded, spent

    def _unclipped(self, number: int, k: int, x: Array, w: Array) -> tuple[Array, Array, Array, Array] | None:
        """The same for a linear law that nothing clips in this cell: one product per step; else None.

        The scheme's stages are linear in the state, the references and the disturbance, so all of the
        cell's commands are worked out at once afterwards, and none may exceed the limits.
        """
        law, limit = self.schedule.controllers[number], self.system.u_max
        if not isinstance(law, AffineController):
            return None
        loop, carried, pushed = self._scheme(number)
        own = self.own.get(number, self.safe)[k]
        places = [own[:-1:2], own[1::2], own[1::2], own[2::2]]  # of the law's reference, at the four stages
        known = [(law.own.nu[k] + place @ law.gain.T) @ self.system.B.T for place in places]
        forced = [
            part[:, None] + w @ push for part, push in zip(self._stages(loop, known), pushed, strict=True)
        ]
        path = np.empty((len(w) + 1, *x.shape))
        path[0] = x
        for step in range(len(w)):
            path[step + 1] = path[step] @ carried[-1] + forced[-1][step]
        raw = law.own.nu[k] + (own[:-1:2, None] - path[:-1]) @ law.gain.T
        if not np.all(np.abs(raw) <= limit):
            return None
        for i in (1, 2, 3):
            inner = path[:-1] @ carried[i] + forced[i]
            if not np.all(np.abs(law.own.nu[k] + (places[i][:, None] - inner) @ law.gain.T) <= limit):
                return None
        per_node = (np.abs(raw) / limit).max(axis=2).reshape(self.q, self.substeps, len(x))
        spent = np.abs(raw).sum(axis=(0, 2))
        return path[self.substeps :: self.substeps], raw[:: self.substeps], per_node.max(axis=1), spent

    def _scheme(self, number: int) -> tuple[Array, list[Array], list[Array]]:
        """Closed loop of a law, and how a state and a disturbance held over a step enter its stages."""
        if number not in self._schemes:
            law, system = self.schedule.controllers[number], self.system
            assert isinstance(law, AffineController)
            loop = system.A - system.B @ law.gain
            carried = [np.eye(system.n) + part for part in self._stages(loop, [loop.T] * 4)]
            self._schemes[number] = loop, carried, self._stages(loop, [system.D.T] * 4)
        return self._schemes[number]

    def _stages(self, loop: Array, rates: Sequence[Array]) -> list[Array]:
        """Stages of the scheme for ``x' = loop x + rate`` from rest, and the end; rates at the stages."""
        second = self.dt / 2 * rates[0]
        third = self.dt / 2 * (second @ loop.T + rates[1])
        fourth = self.dt * (third @ loop.T + rates[2])
        total = rates[0] + 2 * (second @ loop.T + rates[1]) + 2 * (third @ loop.T + rates[2])
        total = total + fourth @ loop.T + rates[3]
        return [np.zeros_like(second), second, third, fourth, self.dt / 6 * total]


def _disturbances(
    flight: _Integrator, n: int, rng: np.random.Generator, kind: Disturbance
) -> tuple[Array, Array]:
    """Disturbances constant over each integration step, shape (steps, n, p), norm at most w_max.

    Also the direction, at time 0, in which the initial error of each worst-case run counts, (worst, n).
    """
    system, steps = flight.system, flight.steps
    w = np.zeros((steps, n, system.p))
    adjoint = np.zeros((0, system.n))
    if kind == "none" or system.w_max == 0:
        return w, adjoint
    worst = n if kind == "worst" else (n // 2 if kind == "mixed" else 0)
    if worst:
        w[:, :worst], adjoint = _worst_case(flight, worst, rng)
    count = n - worst
    if count:
        holds = rng.integers(1, max(2, flight.steps_per_cell * 4), count)
        for run in range(count):
            pieces = -(-steps // holds[run])
            raw = rng.normal(size=(pieces, system.p))
            raw /= np.maximum(np.linalg.norm(raw, axis=1, keepdims=True), 1e-300)
            raw *= np.where(rng.random((pieces, 1)) < 0.5, 1.0, rng.random((pieces, 1)))
            w[:, worst + run] = np.repeat(raw, holds[run], axis=0)[:steps] * system.w_max
    return w, adjoint


def _worst_case(flight: _Integrator, n: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """``w(s) = w_max D' lambda(s) / norm``: the adjoint of one facet (or input) and instant per run.

    For an unsaturated linear loop this is the disturbance that takes the error furthest in that
    direction at that instant; under sampled feedback the continuous adjoint is used.
    """
    clearance, system = flight.schedule.safety.clearance, flight.system
    rows = [-u.normals @ system.position for u in clearance.unsafe] + [
        flight.tracking.gain,
        -flight.tracking.gain,
    ]
    flat = np.vstack(rows)
    targets = rng.integers(1, flight.steps + 1, n)
    adjoint = np.zeros((n, system.n))
    chosen = flat[rng.integers(0, len(flat), n)]
    back = {}
    for number in set(flight.modes.tolist()):
        controller = flight.schedule.controllers[number]
        gain = controller.gain if isinstance(controller, AffineController) else np.zeros((system.m, system.n))
        back[number] = expm((system.A - system.B @ gain) * flight.dt)
    w = np.zeros((flight.steps, n, system.p))
    for step in range(flight.steps - 1, -1, -1):
        starting = targets == step + 1
        adjoint[starting] = chosen[starting]
        direction = adjoint @ system.D
        size = np.sqrt(np.einsum("ij,ij->i", direction, direction))[:, None]
        w[step] = direction * (system.w_max / np.maximum(size, 1e-300))
        adjoint = adjoint @ back[int(flight.modes[step // flight.steps_per_cell])]
    return w, adjoint


__all__ = ["Runs", "simulate"]
