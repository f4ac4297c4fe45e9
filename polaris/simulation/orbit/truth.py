"""A schedule flown in the nonlinear motion: two bodies, J2, drag, and a target that feels them too."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...model.system import Array
from ...synthesis.schedule import Schedule
from ..integration import Integrator, runge_kutta
from ..run_metrics import Runs
from ..simulate import Initial, initial_states
from .environment import Environment
from .frame import frame_rates, near_circular, relative_rate


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
) -> TrueFlights:
    """Fly a schedule in the nonlinear motion, many times at once.

    Each run has its own target: a near-circular orbit with an argument of latitude and an inclination
    drawn from what is declared, an own difference of the ballistic coefficients, and a constant acceleration
    of the size declared for everything else.

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
    """
    rng = np.random.default_rng(seed)
    safety = schedule.safety
    cells = safety.reference.cells if tail else safety.problem.K
    modes = np.zeros(cells, dtype=int)
    modes[: safety.problem.K] = schedule.modes
    grid = Integrator(schedule, modes, substeps)
    x = initial_states(schedule, n, rng, initial)
    # J2 itself moves the inclination by a few hundredths of a degree.
    steepest = max(env.inclination_max - (1e-3 if env.j2 else 0.0), 0.0)
    inclination = np.where(rng.random(n) < 0.5, steepest, rng.uniform(0, 1, n) * steepest)
    target = near_circular(env, rng.uniform(0, 2 * np.pi, n), inclination)
    ballistic = np.maximum(env.ballistic + rng.choice([-1.0, 1.0], n) * env.ballistic_difference, 0.0)
    push = rng.normal(size=(n, 3))
    push *= env.other / np.linalg.norm(push, axis=1, keepdims=True)
    return _march(grid, env, np.concatenate([x, target], axis=1), ballistic, push)


def _march(grid: Integrator, env: Environment, y: Array, ballistic: Array, push: Array) -> TrueFlights:
    system, dt, limit = grid.system, grid.dt, grid.system.u_max
    nodes, count = len(grid.modes) * grid.q, len(y)
    path = np.empty((nodes + 1, count, 12))
    inputs, demanded = np.empty((nodes, count, system.m)), np.zeros((nodes, count))
    residual, spent = np.zeros((nodes, count)), np.zeros(count)
    path[0] = y
    for step in range(grid.steps):
        k, within = divmod(step, grid.steps_per_cell)
        node, sub = divmod(step, grid.substeps)
        number = int(grid.modes[k])
        controller = grid.schedule.controllers[number]

        def asked(later: int, state: Array) -> Array:
            return grid.command(controller, number, k, 2 * within, state[:, :6], later)  # noqa: B023

        def moved(u: Array, state: Array) -> tuple[Array, Array]:
            x_rate, target_rate, left_out = relative_rate(env, state[:, 6:], state[:, :6], ballistic)
            x_rate = x_rate + u @ system.B.T
            x_rate[:, 3:] += push
            return np.concatenate([x_rate, target_rate], axis=1), left_out + push

        if sub == 0 or not grid.sampled:
            raw = asked(0, y)
            demanded[node] = np.maximum(demanded[node], np.max(np.abs(raw) / limit, axis=1))
            u = np.clip(raw, -limit, limit)
        if sub == 0:
            inputs[node] = u

        def rate(later: int, state: Array) -> Array:
            return moved(u if grid.sampled else np.clip(asked(later, state), -limit, limit), state)[0]  # noqa: B023

        first, left_out = moved(u, y)
        y = runge_kutta(rate, y, dt, first)
        residual[node] = np.maximum(residual[node], np.linalg.norm(left_out, axis=1))
        spent += np.abs(u).sum(axis=1) * dt / system.mass
        path[node + 1] = y
    times = np.asarray(np.arange(nodes + 1) * grid.tracking.flow.h, dtype=float)
    states = path.swapaxes(0, 1)
    runs = Runs(grid.schedule, times, states[..., :6], inputs.swapaxes(0, 1), demanded.T, spent, grid.modes)
    return TrueFlights(runs, residual.T, states[..., 6:], ballistic, declared(env, states[..., 6:]))


def declared(env: Environment, target: Array) -> NDArray[np.bool_]:
    """Whether orbits (R, N, 6) of the target stay within what an environment declares, shape (R,)."""
    R, V = target[..., 0], target[..., 1]
    turn = frame_rates(env, target)[0][..., 2]
    tilt = np.hypot(target[..., 3], target[..., 4])
    kept = (np.abs(R - env.radius) <= env.radius_deviation) & (np.abs(V) <= env.radial_rate)
    kept &= np.abs(turn / env.mean_motion - 1) <= env.rate_deviation
    return np.asarray(np.all(kept & (tilt <= np.sin(env.inclination_max)), axis=-1))


def drift_true(env: Environment, target: Array, x: Array, ballistic: Array, h: float, nodes: int) -> Array:
    """Free nonlinear motion of another craft, shape (R, nodes + 1, 6), at nodes h apart [s].

    Parameters
    ----------
    target, x : ndarray, shape (R, 6)
        The target's orbit and the craft's relative state at the start.
    ballistic : ndarray, shape (R,)
    """

    def rate(later: int, state: Array) -> Array:
        x_rate, target_rate, _ = relative_rate(env, state[:, 6:], state[:, :6], ballistic)
        return np.concatenate([x_rate, target_rate], axis=1)

    path = [np.concatenate([x, target], axis=1)]
    for _ in range(nodes):
        path.append(runge_kutta(rate, path[-1], h, rate(0, path[-1])))
    return np.stack(path, axis=1)[..., :6]
