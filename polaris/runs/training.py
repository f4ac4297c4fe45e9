"""Environments of gymnasium for policies that thrust, and the shield that keeps them safe while they learn.

Import this module to have them registered, or let gymnasium do it::

    gymnasium.make("polaris.runs.training:polaris/Switching-v0", scenario="robot")

Needs the extra ``gym``.
"""

from pathlib import Path
from typing import Any

import numpy as np

from reach.numerics.packages import unusable

if why := unusable("gymnasium"):
    raise ImportError(why)
import gymnasium as gym
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from ..model.checks import of_kind
from ..model.system import Array
from ..rta.decision_grid import DecisionGrid
from ..rta.training import TrainingFlights
from ..scenario.scenario import Scenario, load_scenario
from ..scenario.schedule import ScheduleScenario
from ..synthesis.schedule.synthesize import synthesize
from .case import load_target
from .inspections.inspection_training import InspectionFlights

Numbers = NDArray[np.float32]
Info = dict[str, Any]

FAR = 1e6  # beyond it observations, scaled to about 1, are cut off
RESET = "an episode begins with reset: at first, after a shield was put on, and when the last one is over"


def _flights(scenario: Any, runs: int, options: dict[str, Any]) -> TrainingFlights:
    """Return flights of a scenario, or of its name, its file, a run folder, its schedule or its grid."""
    scene = load_target(str(scenario)).schedule() if isinstance(scenario, str | Path) else scenario
    if isinstance(scene, Scenario):
        of_kind("scenario", scene, ScheduleScenario, "polaris.load_scenario of a switching scene")
        scene = synthesize(scene)
    if not isinstance(scene, DecisionGrid):
        period, half_widths = (options.pop(key, None) for key in ("period_s", "half_widths"))
        scene = DecisionGrid.from_schedule(scene, period, 0.0, half_widths)
    return TrainingFlights(scene, runs, **options)


def _clipped(numbers: Array) -> Numbers:
    return np.clip(numbers, -FAR, FAR).astype(np.float32)


class FlightsVectorEnv(VectorEnv[Numbers, Numbers, NDArray[Any]]):
    """Episodes of one scene, many at once.

    An action is a share of the thrust limits, each in [-1, 1], held for a period. An episode terminates where
    safety is lost and is truncated at its end; it begins anew with the next step, whose action counts for
    nothing. One seed fixes all episodes.
    """

    def __init__(self, flights: TrainingFlights | InspectionFlights) -> None:
        self.num_envs, self.flights = flights.runs, flights
        self.metadata = {"autoreset_mode": AutoresetMode.NEXT_STEP}
        self.single_observation_space = Box(-FAR, FAR, (flights.reads,), np.float32)
        self.single_action_space = Box(-1.0, 1.0, flights.limit.shape, np.float32)
        spaces = self.single_observation_space, self.single_action_space
        self.observation_space, self.action_space = (batch_space(space, self.num_envs) for space in spaces)
        self.over = np.ones(self.num_envs, dtype=bool)

    def put_shield(self, **options: Any) -> None:
        """Let run-time assurance decide; all episodes begin anew. Options are those of the flights."""
        self.flights.shield(**options)
        self.over[:] = True

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: Info | None = None
    ) -> tuple[Numbers, Info]:
        """Begin all episodes anew; of several seeds the first one counts."""
        seed = seed[0] if isinstance(seed, list) else seed
        super().reset(seed=seed, options=options)
        self.flights.restart(np.ones(self.num_envs, dtype=bool), self.np_random, fresh=seed is not None)
        self.over[:] = False
        return _clipped(self.flights.observe()), {}

    def step(self, actions: Numbers) -> tuple[Numbers, Array, Any, Any, Info]:
        """Fly one period of those episodes that are not over."""
        moving, u = ~self.over, np.asarray(actions, dtype=float)
        u = np.where(np.isfinite(u), np.clip(u, -1.0, 1.0), np.nan) * self.flights.limit
        self.flights.restart(self.over, self.np_random)
        data = self.flights.advance(u, moving)
        reward, failed, ended = data.pop("reward"), data[self.flights.failed], data.pop("ended")
        self.over = failed | ended
        info = data | {f"_{name}": moving for name in data}
        return _clipped(self.flights.observe()), reward, failed, ended & ~failed, info


class SwitchingVectorEnv(FlightsVectorEnv):
    """A scene of a switching scenario, flown by a policy in many episodes at once.

    Observations, rewards and what `info` holds are those of `polaris.rta.training.TrainingFlights`. The
    shield is the online monitor, with its `reentry`.

    Parameters
    ----------
    scenario : str, Path, ScheduleScenario, Schedule or DecisionGrid
        The schedule of a run folder is read; a scenario, its name or its file is synthesised first.
    num_envs : int
    **options
        Unless a grid is given, `period_s` (between decisions) and `half_widths` (largest errors of the state
        estimate that policy and monitor are given) as `DecisionGrid.from_schedule` has them; `inputs`,
        `input_scale`, `length` and `effort` of `TrainingFlights`.
    """

    def __init__(self, scenario: Any, num_envs: int = 1, **options: Any) -> None:
        super().__init__(_flights(scenario, num_envs, options))


class InspectionVectorEnv(FlightsVectorEnv):
    """The inspection problem of a scenario of one flight: one policy for the thrust of all deputies.

    Observations, rewards, the shields there are (`proven`) and what `info` holds are those of
    `polaris.runs.inspections.inspection_training.InspectionFlights`.

    Parameters
    ----------
    scenario : str, Path or FlightScenario
    num_envs : int
    **options
        `wanted_m` and `effort` of `InspectionFlights`.
    """

    def __init__(self, scenario: Any, num_envs: int = 1, **options: Any) -> None:
        loaded = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
        super().__init__(InspectionFlights(loaded, num_envs, **options))


class SwitchingEnv(gym.Env[Numbers, Numbers]):
    """Environment with one episode at a time; parameters are those of `SwitchingVectorEnv`."""

    MANY: type[SwitchingVectorEnv | InspectionVectorEnv] = SwitchingVectorEnv

    def __init__(self, scenario: Any, **options: Any) -> None:
        self.many = self.MANY(scenario, 1, **options)
        self.observation_space = self.many.single_observation_space
        self.action_space = self.many.single_action_space

    def put_shield(self, **options: Any) -> None:
        """Let run-time assurance decide, from the next episode on."""
        self.many.put_shield(**options)

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[Numbers, Info]:
        """Draw the start, the disturbance and the errors of the estimates of an episode."""
        super().reset(seed=seed)
        return self.many.reset(seed=seed)[0][0], {}

    def step(self, action: Numbers) -> tuple[Numbers, float, bool, bool, Info]:
        """Fly one period."""
        if self.many.over[0]:
            raise ResetNeeded(RESET)
        observation, reward, failed, ended, info = self.many.step(np.asarray(action)[None])
        data = {name: values[0].item() for name, values in info.items() if not name.startswith("_")}
        return observation[0], float(reward[0]), bool(failed[0]), bool(ended[0]), data


class InspectionEnv(SwitchingEnv):
    """One inspection flight at a time; parameters are those of `InspectionVectorEnv`."""

    MANY = InspectionVectorEnv


class _Shielding:
    """Part of both shields: lets run-time assurance decide, and charges the policy for its interventions."""

    env: Any
    penalty: float

    def put(self, penalty: float, options: Info) -> None:
        """Let run-time assurance decide, at a price."""
        self.penalty = penalty
        self.env.unwrapped.put_shield(**options)

    def step(self, action: Any) -> Any:
        """Fly one period under the shield."""
        observation, reward, *flags, info = self.env.step(action)
        share = info.get("intervened", 0.0)  # none where a wrapper has only begun anew
        return observation, reward - self.penalty * share, *flags, info


class Shield(_Shielding, gym.Wrapper[Numbers, Numbers, Numbers, Numbers]):
    """Run-time assurance between policy and spacecraft, under any other wrapper of the environment.

    The online monitor for switching scenes: S flies wherever not everything that the thrusters could do
    until the next decision is recoverable. An assured filter for inspection: as much is applied of what is
    wanted as a proven plan allows; unless ``proven=False`` asks for the barrier filter, which decides for all
    episodes at once. ``info["intervened"]`` is the share of thrust that was not the policy's.

    Parameters
    ----------
    env : SwitchingEnv or InspectionEnv, wrapped or not
    penalty : float
        Taken off the reward of a period, times the share of intervention.
    **options
        ``reentry`` of `polaris.rta.methods.monitor.Monitor` for switching scenes, ``proven`` of
        `polaris.runs.inspections.inspection_training.InspectionFlights` for inspection.

    Raises
    ------
    NotCertified
        If the initial set of a switching scene is not recoverable.
    """

    def __init__(self, env: gym.Env[Numbers, Numbers], penalty: float = 0.0, **options: Any) -> None:
        super().__init__(env)
        self.put(penalty, options)


class VectorShield(_Shielding, VectorWrapper):
    """Shield of a `SwitchingVectorEnv` or `InspectionVectorEnv`, for all its episodes."""

    def __init__(self, env: gym.vector.VectorEnv, penalty: float = 0.0, **options: Any) -> None:
        super().__init__(env)
        self.put(penalty, options)


HERE = "polaris.runs.training:"
gym.register("polaris/Switching-v0", f"{HERE}SwitchingEnv", vector_entry_point=f"{HERE}SwitchingVectorEnv")
gym.register("polaris/Inspection-v0", f"{HERE}InspectionEnv", vector_entry_point=f"{HERE}InspectionVectorEnv")
