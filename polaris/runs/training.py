"""Environments of gymnasium for policies that thrust, and the shield that keeps them safe while they learn.

Import this module to have them registered, or let gymnasium do it::

    gymnasium.make("polaris.runs.training:polaris/Switching-v0", scenario="robot")

Needs the extra ``gym``.
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from ..inspection.backup.brake import Brake
from ..inspection.constraints.allowable_set import allowable
from ..inspection.flights.sampling import InitialConditions
from ..inspection.flights.simulation import Errors
from ..model.errors import ScenarioError
from ..model.system import Array
from ..rta.decision_grid import DecisionGrid
from ..rta.methods.monitor import Monitor
from ..rta.one_call import RunTimeFilter
from ..rta.training import Step, TrainingFlights
from ..scenario.filter_tables import AssuredFilter, ImplicitFilter
from ..scenario.inspection import FlightScenario
from ..scenario.scenario import Scenario, load_scenario
from ..scenario.schedule import ScheduleScenario
from ..synthesis.schedule import Schedule
from ..synthesis.synthesize import synthesize

Numbers = NDArray[np.float32]
Info = dict[str, Any]

FAR = 1e6
"""Beyond it observations, scaled to about 1, are cut off."""


def _flights(scenario: Any, runs: int, period_s: float | None, half_widths: Any, task: Any) -> TrainingFlights:
    """Flights of a scenario, or of its name, its file, its schedule or its grid."""
    scene = load_scenario(scenario) if not isinstance(scenario, Scenario | Schedule | DecisionGrid) else scenario
    if isinstance(scene, Scenario):
        if not isinstance(scene, ScheduleScenario):
            raise ScenarioError("kind", type(scene).__name__, "must be a scenario of a switching schedule")
        scene = synthesize(scene)
    if isinstance(scene, Schedule):
        scene = DecisionGrid.of(scene, period_s, 0.0, half_widths)
    return TrainingFlights(scene, runs, **task)


def _spaces(reads: int, commands: int) -> tuple[Box, Box]:
    return Box(-FAR, FAR, (reads,), np.float32), Box(-1.0, 1.0, (commands,), np.float32)


def _shown(numbers: Array) -> Numbers:
    return np.clip(numbers, -FAR, FAR).astype(np.float32)


def _told(step: Step) -> Info:
    margin = {} if np.isnan(step.margin).all() else {"margin": step.margin}
    return margin | {
        "intervened": step.intervened,
        "collided": step.collided,
        "distance_m": step.distance,
        "delta_v_m_s": step.delta_v,
    }


class SwitchingEnv(gym.Env[Numbers, Numbers]):
    """A scene of a switching scenario, flown by a policy.

    An action is a share of the thrust limits, each in [-1, 1], held for a decision period. Observations and
    rewards are those of `polaris.rta.training.TrainingFlights`; `info` has the least distance to an unsafe set
    [m], the velocity change of the period [m/s], whether S flew instead of the policy, and the monitor's
    margin. An episode terminates in a collision and is truncated at the end of the plan.

    Parameters
    ----------
    scenario : str, Path, ScheduleScenario, Schedule or DecisionGrid
        What is given as a scenario is synthesised first.
    period_s : float, optional
        Time between decisions [s]; see `DecisionGrid.of`.
    half_widths : array_like
        Largest errors of the state estimate that policy and monitor are given, per state.
    **task
        `inputs`, `input_scale`, `length` and `effort` of `TrainingFlights`.
    """

    def __init__(
        self, scenario: Any, *, period_s: float | None = None, half_widths: ArrayLike = 0.0, **task: Any
    ) -> None:
        self.flights = _flights(scenario, 1, period_s, half_widths, task)
        spaces = _spaces(self.flights.observe().shape[1], self.flights.grid.system.m)
        self.observation_space, self.action_space = spaces

    def put_shield(self, **options: Any) -> None:
        """Let the online monitor decide from now on; with its options."""
        self.flights.monitor = Monitor(self.flights.grid, **options)

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[Numbers, Info]:
        """Draw the start, the disturbance and the errors of the estimates of an episode."""
        super().reset(seed=seed)
        self.flights.restart(np.ones(1, dtype=bool), self.np_random, fresh=seed is not None)
        return _shown(self.flights.observe()[0]), {}

    def step(self, action: Numbers) -> tuple[Numbers, float, bool, bool, Info]:
        """Fly one decision period."""
        u = np.asarray(action, dtype=float)[None] * self.flights.grid.system.u_max
        step = self.flights.advance(np.clip(u, -self.flights.grid.system.u_max, self.flights.grid.system.u_max))
        info = {name: values[0].item() for name, values in _told(step).items()}
        seen, collided = _shown(self.flights.observe()[0]), bool(step.collided[0])
        return seen, float(step.reward[0]), collided, bool(step.ended[0] and not collided), info


class SwitchingVectorEnv(VectorEnv[Numbers, Numbers, NDArray[Any]]):
    """The same, of many episodes at once, all of them stepped and judged together.

    One seed fixes all episodes. An episode that is over begins anew with the next step, whose action counts
    for nothing. Parameters are those of `SwitchingEnv`.
    """

    def __init__(
        self,
        scenario: Any,
        num_envs: int = 1,
        *,
        period_s: float | None = None,
        half_widths: ArrayLike = 0.0,
        **task: Any,
    ) -> None:
        self.num_envs, self.flights = num_envs, _flights(scenario, num_envs, period_s, half_widths, task)
        self.metadata = {"autoreset_mode": AutoresetMode.NEXT_STEP}
        spaces = _spaces(self.flights.observe().shape[1], self.flights.grid.system.m)
        self.single_observation_space, self.single_action_space = spaces
        self.observation_space, self.action_space = (batch_space(space, num_envs) for space in spaces)
        self._over = np.ones(num_envs, dtype=bool)

    def put_shield(self, **options: Any) -> None:
        """Let the online monitor decide from now on; with its options."""
        self.flights.monitor = Monitor(self.flights.grid, **options)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: Info | None = None
    ) -> tuple[Numbers, Info]:
        """Begin all episodes anew; of several seeds the first one counts."""
        seed = seed[0] if isinstance(seed, list) else seed
        super().reset(seed=seed, options=options)
        self.flights.restart(np.ones(self.num_envs, dtype=bool), self.np_random, fresh=seed is not None)
        self._over[:] = False
        return _shown(self.flights.observe()), {}

    def step(
        self, actions: Numbers
    ) -> tuple[Numbers, NDArray[Any], NDArray[np.bool_], NDArray[np.bool_], Info]:
        """Fly one decision period of those episodes that are not over."""
        moving, limit = ~self._over, self.flights.grid.system.u_max
        self.flights.restart(self._over, self.np_random)
        step = self.flights.advance(np.clip(np.asarray(actions, dtype=float) * limit, -limit, limit), moving)
        truncated = step.ended & ~step.collided
        self._over = step.collided | truncated
        info = _told(step) | {f"_{name}": moving for name in _told(step)}
        return _shown(self.flights.observe()), step.reward, step.collided, truncated, info


class InspectionEnv(gym.Env[Numbers, Numbers]):
    """The inspection problem of a scenario of one flight: one policy for the thrust of all deputies.

    An action has three shares of the thrust limit per deputy, each in [-1, 1], held for a control period.
    Observed are, per deputy, its position as a share of r_max and its velocity as one of v_max, then the
    direction of the sun (cosine and sine of its angle), and the share of the flight that is over.
    A period is worth ``period / duration * (mean over deputies of 1 / (1 + |distance - wanted| / wanted) -
    effort * mean(|u| / u_max))``, and one less if a constraint phi1 to phi6 or phi9 to phi11 is violated in its
    middle or at its end: the episode terminates then. It is truncated at the end of the flight.

    Parameters
    ----------
    scenario : str, Path or FlightScenario
    wanted_m : float
        Distance from the chief that is wanted [m].
    effort : float
        Price of full thrust.
    """

    def __init__(self, scenario: Any, *, wanted_m: float = 100.0, effort: float = 0.05) -> None:
        found = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
        if not isinstance(found, FlightScenario):
            raise ScenarioError("kind", type(found).__name__, "must be an inspection scenario of one flight")
        self.scenario, self.wanted, self.effort = found, wanted_m, effort
        self.inspection, flight = found.inspection(), found.model.flight
        self.period, self.count = flight.period_s, round(flight.duration_s / flight.period_s)
        self.shield: RunTimeFilter | None = None
        self._make: Any = None
        N = self.inspection.deputies
        self._half, self._whole = (self.inspection.held(self.period * part) for part in (0.5, 1.0))
        self.observation_space, self.action_space = _spaces(6 * N + 3, 3 * N)

    def put_shield(self, **options: Any) -> None:
        """Let an assured filter decide from now on: the scenario's own, else that of ``kind = "implicit"``."""
        spec = self.scenario.model.filter
        chosen = spec if isinstance(spec, AssuredFilter) else ImplicitFilter(kind="implicit", **options)
        brake = Brake(self.inspection, self.period, self.scenario.uncertainty())
        self._make = lambda sun: chosen.start(brake, self.scenario.strengthening(), sun)

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[Numbers, Info]:
        """Begin at the scenario's initial states; where they are drawn, at others with every episode."""
        super().reset(seed=seed)
        number, unknown = int(self.np_random.integers(2**31)), self.scenario.uncertainty()
        self.k, (self.x, self.sun) = 0, self._start(number)
        self.errors = None if unknown.exact else Errors(unknown, self.inspection, number)
        self.shield = self._make(self.sun) if self._make else None
        self._see()
        return self._observed(), {}

    def _start(self, number: int) -> tuple[Array, float]:
        if self.scenario.model.initial.kind == "states":
            return self.scenario.initial()
        x, sun = InitialConditions(self.scenario.families(), number, block=1024).first(1)
        return x[0], float(sun[0])

    def _see(self) -> None:
        self.seen = self.x if self.errors is None else self.errors.estimated(self.x)

    def _observed(self) -> Numbers:
        q = self.inspection
        scaled = self.seen / np.repeat([q.distance_max, q.speed_max], 3)
        sun = q.sun_angle(self.k * self.period, self.sun)
        return _shown(np.r_[scaled.ravel(), np.cos(sun), np.sin(sun), self.k / self.count])

    def step(self, action: Numbers) -> tuple[Numbers, float, bool, bool, Info]:
        """Fly one control period."""
        q, t = self.inspection, self.k * self.period
        u = np.asarray(action, dtype=float).reshape(-1, 3) * q.thrust_max
        info: Info = {"intervened": 0.0, "proven": False, "status": "desired"}
        if self.shield is not None:
            decision = self.shield.filter(t, self.seen, u)
            u, status = decision.u, decision.status
            share = float(decision.intervened.mean())
            info = {"intervened": share, "proven": not decision.unproven, "status": status}
        u = np.clip(np.where(np.isfinite(u), u, 0.0), -q.thrust_max, q.thrust_max)
        acting = u if self.errors is None else self.errors.acting(u)
        least = np.inf
        for part, (Phi, Gamma) in ((0.5, self._half), (1.0, self._whole)):
            x = self.x @ Phi.T + acting @ Gamma.T
            values = allowable(q, x, q.sun_angle(t + part * self.period, self.sun)).values()
            least = min(least, *(float(value.min(initial=np.inf)) for value in values))
        self.x, self.k = x, self.k + 1
        self._see()
        off = np.abs(np.linalg.norm(self.x[:, :3], axis=1) - self.wanted) / self.wanted
        near = float((1 / (1 + off)).mean()) - self.effort * float(np.abs(u).mean()) / q.thrust_max
        violated, over = least < 0, self.k == self.count
        spent = float(np.abs(u).sum()) * self.period / q.mass
        info |= {"violated": violated, "least": least, "delta_v_m_s": spent}
        return self._observed(), near / self.count - violated, violated, over and not violated, info


class Shield(gym.Wrapper[Numbers, Numbers, Numbers, Numbers]):
    """Run-time assurance between policy and spacecraft, whatever else wraps the environment.

    The online monitor for switching scenes: S flies wherever not everything that the thrusters could do until
    the next decision is recoverable. An assured filter for inspection: as much is applied of what is wanted as
    a proven plan allows. ``info["intervened"]`` tells the share of the thrust that was not the policy's.

    Parameters
    ----------
    env : SwitchingEnv or InspectionEnv, wrapped or not
    penalty : float
        Taken off the reward of a period, times the share of intervention.
    **options
        Of `polaris.rta.methods.monitor.Monitor`, such as ``reentry``.

    Raises
    ------
    NotCertified
        If the initial set of a switching scene is not recoverable.
    """

    def __init__(self, env: gym.Env[Numbers, Numbers], penalty: float = 0.0, **options: Any) -> None:
        super().__init__(env)
        self.penalty = penalty
        env.unwrapped.put_shield(**options)  # type: ignore[attr-defined]

    def step(self, action: Numbers) -> tuple[Numbers, float, bool, bool, Info]:
        """Fly one period under the shield."""
        seen, reward, terminated, truncated, info = self.env.step(action)
        return seen, float(reward) - self.penalty * info["intervened"], terminated, truncated, info


class VectorShield(VectorWrapper):
    """The same of a `SwitchingVectorEnv`: one monitor decides for all its episodes at once."""

    def __init__(self, env: Any, penalty: float = 0.0, **options: Any) -> None:
        super().__init__(env)
        self.penalty = penalty
        env.unwrapped.put_shield(**options)

    def step(self, actions: Any) -> tuple[Any, Array, Array, Array, Info]:
        """Fly one period under the shield."""
        seen, reward, terminated, truncated, info = self.env.step(actions)
        return seen, reward - self.penalty * info["intervened"], terminated, truncated, info


gym.register("polaris/Switching-v0", SwitchingEnv, vector_entry_point=SwitchingVectorEnv)
gym.register("polaris/Inspection-v0", InspectionEnv)
