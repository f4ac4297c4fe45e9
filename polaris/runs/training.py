"""Environments of gymnasium for policies that thrust, and the shield that keeps them safe while they learn.

Import this module to have them registered, or let gymnasium do it::

    gymnasium.make("polaris.runs.training:polaris/Switching-v0", scenario="robot")

Needs the extra ``gym``.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from ..inspection.backup.brake import Brake
from ..inspection.constraints.allowable_set import allowable
from ..inspection.flights.sampling import InitialConditions
from ..inspection.flights.simulation import Errors
from ..model.checks import of_kind
from ..model.system import Array
from ..rta.decision_grid import DecisionGrid
from ..rta.methods.monitor import REENTRY
from ..rta.one_call import RunTimeFilter
from ..rta.training import TrainingFlights
from ..scenario.filter_tables import AssuredFilter, ImplicitFilter
from ..scenario.inspection import FlightScenario
from ..scenario.scenario import Scenario, load_scenario
from ..scenario.schedule import ScheduleScenario
from ..synthesis.synthesize import synthesize

Numbers = NDArray[np.float32]
Info = dict[str, Any]

FAR = 1e6  # beyond it observations, scaled to about 1, are cut off

RESET = "an episode begins with reset: at first, after a shield was put on, and when the last one is over"


def _flights(scenario: Any, runs: int, given: dict[str, Any]) -> TrainingFlights:
    """Flights of a scenario, or of its name, its file, its schedule or its grid."""
    scene = load_scenario(scenario) if isinstance(scenario, str | Path) else scenario
    if isinstance(scene, Scenario):
        of_kind("scenario", scene, ScheduleScenario, "polaris.load_scenario of a switching scene")
        scene = synthesize(scene)
    if not isinstance(scene, DecisionGrid):
        scene = DecisionGrid.of(scene, given.pop("period_s", None), 0.0, given.pop("half_widths", None))
    return TrainingFlights(scene, runs, **given)


def _spaces(reads: int, commands: int) -> tuple[Any, Any]:
    return Box(-FAR, FAR, (reads,), np.float32), Box(-1.0, 1.0, (commands,), np.float32)


def _shown(numbers: Array) -> Numbers:
    return np.clip(numbers, -FAR, FAR).astype(np.float32)


class SwitchingVectorEnv(VectorEnv[Numbers, Numbers, NDArray[Any]]):
    """A scene of a switching scenario, flown by a policy in many episodes at once.

    An action is a share of the thrust limits, each in [-1, 1], held for a decision period. Observations,
    rewards and what `info` holds are those of `polaris.rta.training.TrainingFlights`. An episode terminates
    in a collision and is truncated at the end of the plan; it begins anew with the next step, whose action
    counts for nothing. One seed fixes all episodes.

    Parameters
    ----------
    scenario : str, Path, ScheduleScenario, Schedule or DecisionGrid
        What is given as a scenario is synthesised first.
    num_envs : int
    **given
        Unless a grid is given, `period_s` (between decisions) and `half_widths` (largest errors of the state
        estimate that policy and monitor are given) as `DecisionGrid.of` has them; `inputs`, `input_scale`,
        `length` and `effort` of `TrainingFlights`.
    """

    def __init__(self, scenario: Any, num_envs: int = 1, **given: Any) -> None:
        self.num_envs, self.flights = num_envs, _flights(scenario, num_envs, given)
        self.metadata = {"autoreset_mode": AutoresetMode.NEXT_STEP}
        spaces = _spaces(self.flights.scale.size, self.flights.grid.system.m)
        self.single_observation_space, self.single_action_space = spaces
        self.observation_space, self.action_space = (batch_space(space, num_envs) for space in spaces)
        self.over = np.ones(num_envs, dtype=bool)

    def put_shield(self, reentry: float = REENTRY) -> None:
        """Let the online monitor decide; all episodes begin anew."""
        self.flights.shield(reentry)
        self.over[:] = True

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: Info | None = None
    ) -> tuple[Numbers, Info]:
        """Begin all episodes anew; of several seeds the first one counts."""
        seed = seed[0] if isinstance(seed, list) else seed
        super().reset(seed=seed, options=options)
        self.flights.restart(np.ones(self.num_envs, dtype=bool), self.np_random, fresh=seed is not None)
        self.over[:] = False
        return _shown(self.flights.observe()), {}

    def step(self, actions: Numbers) -> tuple[Numbers, Array, Any, Any, Info]:
        """Fly one decision period of those episodes that are not over."""
        moving, u = ~self.over, np.asarray(actions, dtype=float)
        u = np.where(np.isfinite(u), np.clip(u, -1.0, 1.0), np.nan) * self.flights.grid.system.u_max
        self.flights.restart(self.over, self.np_random)
        told = self.flights.advance(u, moving)
        reward, collided, ended = told.pop("reward"), told["collided"], told.pop("ended")
        self.over = collided | ended
        info = told | {f"_{name}": moving for name in told}
        return _shown(self.flights.observe()), reward, collided, ended & ~collided, info


class SwitchingEnv(gym.Env[Numbers, Numbers]):
    """The same with one episode at a time; parameters are those of `SwitchingVectorEnv`."""

    def __init__(self, scenario: Any, **given: Any) -> None:
        self.many = SwitchingVectorEnv(scenario, 1, **given)
        self.observation_space = self.many.single_observation_space
        self.action_space = self.many.single_action_space

    def put_shield(self, reentry: float = REENTRY) -> None:
        """Let the online monitor decide, from the next episode on."""
        self.many.put_shield(reentry)

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[Numbers, Info]:
        """Draw the start, the disturbance and the errors of the estimates of an episode."""
        super().reset(seed=seed)
        return self.many.reset(seed=seed)[0][0], {}

    def step(self, action: Numbers) -> tuple[Numbers, float, bool, bool, Info]:
        """Fly one decision period."""
        if self.many.over[0]:
            raise ResetNeeded(RESET)
        seen, reward, collided, ended, info = self.many.step(np.asarray(action)[None])
        told = {name: values[0].item() for name, values in info.items() if not name.startswith("_")}
        return seen[0], float(reward[0]), bool(collided[0]), bool(ended[0]), told


class InspectionEnv(gym.Env[Numbers, Numbers]):
    """The inspection problem of a scenario of one flight: one policy for the thrust of all deputies.

    An action has three shares of the thrust limit per deputy, each in [-1, 1], held for a control period.
    Observed are, per deputy, its position as a share of r_max and its velocity as one of v_max, then the
    direction of the sun (cosine and sine of its angle), and the share of the flight that is over.
    A period is worth ``period / duration * (mean over deputies of 1 / (1 + |distance - wanted| / wanted) -
    effort * mean(|u| / u_max))``, and one less if a constraint phi1 to phi6 or phi9 to phi11 is violated in
    its middle or at its end: the episode terminates then. It is truncated at the end of the flight.

    Parameters
    ----------
    scenario : str, Path or FlightScenario
    wanted_m : float
        Distance from the chief that is wanted [m].
    effort : float
        Price of full thrust.
    """

    def __init__(self, scenario: Any, *, wanted_m: float = 100.0, effort: float = 0.05) -> None:
        found: Any = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
        of_kind("scenario", found, FlightScenario, "polaris.load_scenario of one inspection flight")
        self.scenario, self.wanted, self.effort = found, wanted_m, effort
        self.inspection, flight = found.inspection(), found.model.flight
        self.period, self.count = flight.period_s, round(flight.duration_s / flight.period_s)
        self.shield: RunTimeFilter | None = None
        self._make: Callable[[float], RunTimeFilter] | None = None
        self._flying = False
        N = self.inspection.deputies
        self._half, self._whole = (self.inspection.held(self.period * part) for part in (0.5, 1.0))
        self.observation_space, self.action_space = _spaces(6 * N + 3, 3 * N)

    def put_shield(self) -> None:
        """Let an assured filter decide, from the next episode on: the scenario's own, else ``implicit``."""
        spec = self.scenario.model.filter
        chosen = spec if isinstance(spec, AssuredFilter) else ImplicitFilter(kind="implicit")
        brake = Brake(self.inspection, self.period, self.scenario.uncertainty())
        self._make = lambda sun: chosen.start(brake, self.scenario.strengthening(), sun)
        self._flying = False

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[Numbers, Info]:
        """Begin at the scenario's initial states; where they are drawn, at others with every episode."""
        super().reset(seed=seed)
        number, unknown = int(self.np_random.integers(2**31)), self.scenario.uncertainty()
        self.k, (self.x, self.sun) = 0, self._start(number)
        self.errors = None if unknown.exact else Errors(unknown, self.inspection, number)
        self.shield = self._make(self.sun) if self._make else None
        self._see()
        self._flying = True
        return self._observed(), {}

    def _start(self, number: int) -> tuple[Array, float]:
        if self.scenario.model.initial.kind == "states":
            x, sun = self.scenario.initial()
            return np.array(x), float(sun)
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
        if not self._flying:
            raise ResetNeeded(RESET)
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
        self._flying = not (violated or over)
        spent = float(np.abs(u).sum()) * self.period / q.mass
        info |= {"violated": violated, "least": least, "delta_v_m_s": spent}
        return self._observed(), near / self.count - violated, violated, over and not violated, info


class Shield(gym.Wrapper[Numbers, Numbers, Numbers, Numbers]):
    """Run-time assurance between policy and spacecraft, whatever else wraps the environment.

    The online monitor for switching scenes: S flies wherever not everything that the thrusters could do
    until the next decision is recoverable. An assured filter for inspection: as much is applied of what is
    wanted as a proven plan allows. ``info["intervened"]`` is the share of thrust that was not the policy's.

    Parameters
    ----------
    env : SwitchingEnv or InspectionEnv, wrapped or not
    penalty : float
        Taken off the reward of a period, times the share of intervention.
    **options
        ``reentry`` of `polaris.rta.methods.monitor.Monitor` for switching scenes.

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
        held = info.get("intervened", 0.0)  # none where a wrapper has only begun anew
        return seen, float(reward) - self.penalty * held, terminated, truncated, info


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


HERE = "polaris.runs.training:"
gym.register("polaris/Switching-v0", f"{HERE}SwitchingEnv", vector_entry_point=f"{HERE}SwitchingVectorEnv")
gym.register("polaris/Inspection-v0", f"{HERE}InspectionEnv")
