"""A schedule flown in the nonlinear motion: two bodies, J2, drag, and a target that feels them too."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...model.system import Array
from ...synthesis.schedule import Schedule
from ..delayed import Predicting
from ..disturbances import disturbances
from ..integration import Integrator, runge_kutta
from ..run_metrics import Runs
from ..simulate import Initial, flown_modes, initial_states
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
    of the size declared for everything else. Under sampled feedback, delays and missed periods are flown as
    they are, with predictions on board; else as errors within the bounds of predictions.

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
    modes = flown_modes(schedule, tail)
    x = initial_states(schedule, n, rng, initial)
    # J2 itself moves the inclination by a few hundredths of a degree.
    steepest = max(env.inclination_max - (1e-3 if env.j2 else 0.0), 0.0)
    inclination = np.where(rng.random(n) < 0.5, steepest, rng.uniform(0, 1, n) * steepest)
    target = near_circular(env, rng.uniform(0, 2 * np.pi, n), inclination)
    ballistic = np.maximum(env.ballistic + rng.choice([-1.0, 1.0], n) * env.ballistic_difference, 0.0)
    push = rng.normal(size=(n, 3))
    push *= env.other / np.linalg.norm(push, axis=1, keepdims=True)
    at_once = schedule.safety.problem.system.timing.instant or not schedule.safety.tracking.feedback.sampled
    flight = (_TrueMotion if at_once else _Predicting)(schedule, modes, substeps)
    if isinstance(flight, _Predicting):
        flight.prepare(n, rng)
    flight.env, flight.ballistic = env, ballistic
    flight.residual = np.zeros((len(modes) * flight.q, n))
    pushed, errors = np.broadcast_to(push, (flight.steps, n, 3)), disturbances(flight, n, rng, "random")[0]
    pushed = np.concatenate([pushed, errors[..., flight.system.p :]], axis=2)
    runs = flight.run(np.concatenate([x, target], axis=1), pushed)
    target = runs.states[..., 6:]
    runs = replace(runs, states=runs.states[..., :6])
    return TrueFlights(runs, flight.residual.T, target, ballistic, declared(env, target))


class _TrueMotion(Integrator):
    """Its states are those of craft and target, (R, 12); what disturbs is an acceleration (R, 3)."""

    env: Environment
    ballistic: Array
    residual: Array  # largest within each period, (nodes, R)

    def command(self, number: int, k: int, half: int, x: Array, later: int = 0) -> Array:
        return super().command(number, k, half, x[:, :6], later)

    def _unclipped(self, *cell: Any) -> None:
        """Nothing is linear here."""

    def move(self, number: int, k: int, step: int, x: Array, u: Array, w: Array) -> Array:
        def rates(u: Array, state: Array) -> tuple[Array, Array]:
            own, target, left_out = relative_rate(self.env, state[:, 6:], state[:, :6], self.ballistic)
            own = own + u @ self.system.B.T
            own[:, 3:] += w
            return np.concatenate([own, target], axis=1), left_out + w

        def rate(later: int, state: Array) -> Array:
            if self.sampled:
                return rates(u, state)[0]
            asked = self.command(number, k, 2 * step, state, later)
            return rates(self.applied(asked, k * self.steps_per_cell + step), state)[0]

        first, left_out = rates(u, x)
        node = k * self.q + step // self.substeps
        self.residual[node] = np.maximum(self.residual[node], np.linalg.norm(left_out, axis=1))
        return runge_kutta(rate, x, self.dt, first)


class _Predicting(Predicting, _TrueMotion):
    """The same, what controllers act on being predicted on board."""


def declared(env: Environment, target: Array) -> NDArray[np.bool_]:
    """Whether orbits (R, N, 6) of the target stay within what an environment declares, shape (R,)."""
    R, V = target[..., 0], target[..., 1]
    turn = frame_rates(env, target)[0][..., 2]
    tilt = np.hypot(target[..., 3], target[..., 4])
    kept = (np.abs(R - env.radius) <= env.radius_deviation) & (np.abs(V) <= env.radial_rate)
    kept &= np.abs(turn / env.mean_motion - 1) <= env.rate_deviation
    return np.asarray(np.all(kept & (tilt <= np.sin(env.inclination_max)), axis=-1))
