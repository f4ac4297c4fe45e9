"""A schedule flown in the nonlinear motion: two bodies, J2, drag, and a target that feels them too."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reach.short_repr import short_repr

from ...model.system import Array
from ...model.thrusters import Thrusters
from ...synthesis.schedule.schedule import Schedule
from ..delayed import Predicting
from ..disturbances import disturbances, limit_rows
from ..fault_times import drawn
from ..integration import Integrator
from ..on_board import FlightCode
from ..run_metrics import Runs
from ..simulate import Initial, flown_modes, initial_states
from .environment import MU, Environment
from .frame import ellipse_place, frame_rates, near_circular, near_ellipse, on_ellipse, relative_rate


@short_repr
@dataclass(frozen=True, eq=False)
class TrueFlights:
    """Closed loops in the nonlinear motion.

    Attributes
    ----------
    runs : Runs
        States in the target's frame, inputs, demands: as simulated runs of the linear model.
    residual : ndarray, shape (R, N)
        What the linear equations left out, the largest within each period [m/s^2].
    target : ndarray, shape (R, N+1, 6)
        The target's orbit (see `polaris.simulation.orbit.frame`).
    ballistic : ndarray, shape (R,)
        The chaser's drag coefficient times area over mass [m^2/kg].
    within : ndarray of bool, shape (R,)
        Whether the target's orbit stayed within what the environment declares.
    """

    runs: Runs
    residual: Array
    target: Array
    ballistic: Array
    within: NDArray[np.bool_]


def fly_true(
    schedule: Schedule,
    env: Environment,
    n: int = 100,
    seed: int = 0,
    *,
    initial: Initial = "mixed",
    tail: bool = False,
    substeps: int = 4,
    code: FlightCode | None = None,
) -> TrueFlights:
    """Fly a schedule in the nonlinear motion, many times at once.

    Each run has its own target: a near-circular orbit, or one near an ellipse, with an argument of
    latitude, an inclination, an eccentricity and an anomaly drawn from what is declared, an own
    difference of the ballistic coefficients, and a constant acceleration of the size declared for
    everything else. With errors of navigation or thrusters, half of the runs have them, that acceleration
    and the start at the worst for a limit and an instant, by the adjoint of the linear loop. In the
    others estimates err at random, and thrusters are as built: each has its own strength, all are turned
    about an axis, and impulses are rounded to the bit. Delays and missed periods are flown as they are,
    with predictions on board. Where faults are isolated late every run has one of them.

    Parameters
    ----------
    schedule : Schedule
    env : Environment
    n, seed : int
    initial : {"mixed", "center", "random", "corners"}
        As in `simulate`.
    tail : bool
        Fly S on along the coasting tail after T.
    substeps : int
        Steps of the fourth-order Runge-Kutta scheme per node.
    code : FlightCode, optional
        Compiled flight code that decides and commands in place of the schedule.
    """
    rng = np.random.default_rng(seed)
    modes = flown_modes(schedule, tail)
    x = initial_states(schedule, n, rng, initial)
    target = _targets(env, n, rng)
    ballistic = np.maximum(env.ballistic + rng.choice([-1.0, 1.0], n) * env.ballistic_difference, 0.0)
    push = rng.normal(size=(n, 3))
    push *= env.other / np.linalg.norm(push, axis=1, keepdims=True)
    system = schedule.safety.problem.system
    prompt = system.timing.instant and system.observer is None
    blind = any(not len(fault.thrust) for fault in system.transients)
    flight = (_TrueMotion if prompt and not blind else _Predicting)(schedule, modes, substeps)
    flight.code = code and code.require_schedule(schedule)
    if isinstance(flight, _Predicting):
        flight.prepare(n, rng)
    if system.transients:
        rows = limit_rows(schedule)[rng.integers(0, len(limit_rows(schedule)), n)]
        flight.faults = drawn(schedule, substeps, rows, rng.integers(1, flight.steps, n), rng)
    flight.env, flight.ballistic = env, ballistic
    flight.residual = np.zeros((len(modes) * flight.q, n))
    pushes, adjoint = flight.at_their_worst(push, rng)
    if len(adjoint) and initial in ("corners", "mixed"):
        x[: len(adjoint)] = schedule.safety.problem.initial_set.support_vector(adjoint)
    runs = flight.run(np.concatenate([x, target], axis=1), pushes)
    target = runs.states[..., 6:]
    runs = replace(runs, states=runs.states[..., :6])
    return TrueFlights(runs, flight.residual.T, target, ballistic, declared(env, target))


def _targets(env: Environment, n: int, rng: np.random.Generator) -> Array:
    """Draw the states of the targets at the start, half of them on the steepest orbits."""
    # J2 itself moves the inclination by a few hundredths of a degree.
    steepest = max(env.inclination_max - (1e-3 if env.j2 else 0.0), 0.0)
    inclination = np.where(rng.random(n) < 0.5, steepest, rng.uniform(0, 1, n) * steepest)
    latitude = rng.uniform(0, 2 * np.pi, n)
    if not env.eccentricity:
        return near_circular(env, latitude, inclination)
    # J2 makes an ellipse of a circle in turn, of about this eccentricity.
    largest = max(env.eccentricity - env.k_j2 / (MU * env.radius**2), 0.0)
    e = np.where(rng.random(n) < 0.5, 1.0, rng.random(n)) * largest
    return near_ellipse(env, latitude, inclination, e, rng.uniform(0, 2 * np.pi, n))


def runge_kutta(rate: Callable[[Array], Array], x: Array, dt: float | Array, first: Array) -> Array:
    """State a step of dt [s] later by the classical scheme of fourth order; `first` is the rate at x."""
    second = rate(x + dt / 2 * first)
    third = rate(x + dt / 2 * second)
    fourth = rate(x + dt * third)
    return np.asarray(x + dt / 6 * (first + 2 * second + 2 * third + fourth))


class _TrueMotion(Integrator):
    """True motion: states of craft and target, (R, 12), under an acceleration (R, 3) that disturbs."""

    env: Environment
    ballistic: Array
    residual: Array  # largest within each period, (nodes, R)
    axis: Array  # about which the last runs' thrusters are turned, (r, 3)
    strength: Array  # of each of them, as a share of the error, (r, N)
    errors = Thrusters()  # of thrusters alone, jitter left out

    def command(self, number: int, k: int, at: int, x: Array) -> Array:
        return super().command(number, k, at, x[:, :6])

    def at_their_worst(self, push: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Return all that disturbs, (steps, R, 3 and columns of errors), and directions of first starts."""
        system, p, n = self.system, self.system.p, len(push)
        pushes = np.broadcast_to(push, (self.steps, n, 3))
        if system.ideal:
            return pushes, np.zeros((0, 6))
        self.errors = system.on_time
        w, adjoint = disturbances(self, n, rng, "mixed")
        worst = np.arange(n) < len(adjoint)
        force = (w[..., :p] @ system.D.T)[..., 3:] * (self.env.other / max(system.w_max, 1e-300))
        axis = rng.normal(size=(n - len(adjoint), 3))
        self.axis = axis / np.linalg.norm(axis, axis=1, keepdims=True)
        self.strength = rng.choice([-1.0, 1.0], (len(axis), len(self.ways)))
        return np.concatenate([np.where(worst[:, None], force, pushes), w[..., p:]], axis=2), adjoint

    def applied(self, raw: Array, step: int) -> Array:
        u, errors = super().applied(raw, step), self.errors
        if errors.exact:
            return u
        built, layout = slice(len(u) - len(self.axis), None), self.system.nozzles
        thrusts, bit = self.forces[built], errors.rounding(self.system.m)
        if layout is not None:
            bit = layout.bit / (self.dt * self.substeps)
        if bit > 0 and self.rest is None:
            near = np.round(thrusts / bit) * bit
            thrusts = np.where(np.abs(thrusts) >= bit, thrusts, near) if self.system.timing.fine else near
        if len(self.fired):  # no pulse is longer than a period
            self.forces = self.forces.copy()
            limits = self.fired if layout is not None else np.minimum(self.fired, self.system.u_max)
            self.forces[built] = thrusts = np.clip(thrusts, -limits, limits)
        shares = errors if layout is None else layout
        inputs = (thrusts * (1 + shares.along * self.strength)) @ self.ways
        inputs += shares.across * np.cross(self.axis, thrusts @ self.ways)
        if layout is not None:
            inputs = inputs / (1 + layout.mass * self.strength[:, :1])
        self.inputs = u.copy()
        self.inputs[built] = inputs
        if self.faults is not None:
            inputs = inputs + self.faults.added(self.forces @ self.ways, step)[built]
        u[built] = inputs
        return u

    def _unclipped(self, *cell: Any) -> None:
        """Return None: nothing is linear here."""

    def move(self, k: int, step: int, x: Array, u: Array, w: Array) -> Array:
        def rates(u: Array, state: Array) -> tuple[Array, Array]:
            rate, target, left_out = relative_rate(self.env, state[:, 6:], state[:, :6], self.ballistic)
            rate = rate + u @ self.system.B.T
            rate[:, 3:] += w
            return np.concatenate([rate, target], axis=1), left_out + w

        def under(u: Array) -> Callable[[Array], Array]:
            return lambda state: rates(u, state)[0]

        first, left_out = rates(u, x)
        node = k * self.q + step // self.substeps
        self.residual[node] = np.maximum(self.residual[node], np.linalg.norm(left_out, axis=1))
        if not self.parts:
            return runge_kutta(under(u), x, self.dt, first)
        for begin, end in pairwise(self._switches(step % self.substeps)):
            if np.any(begin < end):
                inputs, dt = u + self.excess(begin, end), (end - begin) * self.dt * self.substeps
                x = runge_kutta(under(inputs), x, dt, rates(inputs, x)[0])
        return x

    def _switches(self, sub: int) -> Array:
        """Shares of a period, over one of its steps, between which nothing switches, (., R, 1)."""
        start, end = (np.arange(2) + sub) / self.substeps
        ends = np.broadcast_to([start, end], (len(self.forces), 2))
        parts = (each + edge for _, _, *part in self.parts for each in part for edge in self.edges)
        switches = np.hstack([ends, *parts])
        return np.sort(np.clip(switches, start, end), axis=1).T[:, :, None]


class _Predicting(Predicting, _TrueMotion):
    """True motion under controllers that act on states predicted on board."""


def declared(env: Environment, target: Array) -> NDArray[np.bool_]:
    """Return True for orbits (R, N, 6) of the target within an environment's declared ranges, shape (R,)."""
    R, V = target[..., 0], target[..., 1]
    turn = frame_rates(env, target)[0][..., 2]
    tilt = np.hypot(target[..., 3], target[..., 4])
    near, climb, rate = on_ellipse(env, *ellipse_place(env, R, V, env.eccentricity))
    inside = (np.abs(R - near) <= env.radius_deviation) & (np.abs(V - climb) <= env.radial_rate)
    inside &= np.abs(turn - rate) <= env.rate_deviation * env.mean_motion
    return np.asarray(np.all(inside & (tilt <= np.sin(env.inclination_max)), axis=-1))
