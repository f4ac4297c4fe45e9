"""Campaigns of schedules: a case is synthesised once per process, its runs are simulated and measured."""

from __future__ import annotations

import hashlib
import threading
import tomllib
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from ...model.distances import signed_distances
from ...model.errors import ClockWarning, OutOfTime, PolarisError, ScenarioError
from ...model.satellite import true_states
from ...model.system import Array
from ...simulation.disturbances import Disturbance
from ...simulation.run_metrics import PART, Runs, evaluate
from ...simulation.simulate import DISTURBANCES, INITIALS, Initial, simulate
from ..tables import columns
from .batch import Batch, Results, Task, Trajectory
from .statistics import summarise

if TYPE_CHECKING:
    from ...synthesis.schedule import Schedule

MODES: dict[str, int | None] = {"polaris": None, "safety": 0, "experimental": 1}
"""Who flies: the schedule, S alone, or the preferred U alone."""

KEPT = 4
"""Schedules a process keeps; cases come one after the other, so few are in use at a time."""

_lock = threading.Lock()


@dataclass(frozen=True)
class ScheduleRuns:
    """Runs of switching schedules, as `polaris.simulate` flies and `polaris.evaluate` measures them.

    Attributes
    ----------
    modes : tuple of str
        ``polaris``, ``safety``, ``experimental``.
    initial, disturbance : str
        As in `polaris.simulate`.

    Raises
    ------
    ScenarioError
        If a value is not allowed.
    """

    modes: tuple[str, ...] = ("polaris",)
    initial: Initial = "mixed"
    disturbance: Disturbance = "mixed"

    name: ClassVar[str] = "schedules"
    formats: ClassVar[tuple[str, ...]] = ("parquet",)
    ranking: ClassVar[str] = "min_distance_m"

    def __post_init__(self) -> None:
        for option, given, allowed in (
            *(("--mode", mode, tuple(MODES)) for mode in self.modes),
            ("--initial", self.initial, INITIALS),
            ("--disturbance", self.disturbance, DISTURBANCES),
        ):
            if given not in allowed:
                raise ScenarioError(option, given, f"must be one of {', '.join(allowed)}")
        if not self.modes or len(set(self.modes)) < len(self.modes):
            raise ScenarioError("--mode", list(self.modes), "must name at least one mode, each once")

    def data(self) -> dict[str, Any]:
        """As `Kind.data`."""
        return {"modes": list(self.modes), "initial": self.initial, "disturbance": self.disturbance}

    @classmethod
    def from_data(cls, data: Mapping[str, Any]) -> ScheduleRuns:
        """As `Kind.from_data`."""
        return cls(tuple(map(str, data["modes"])), data["initial"], data["disturbance"])

    def fly_batch(self, task: Task) -> Batch:
        """As `Kind.fly_batch`."""
        made = schedule_of(task.text)
        if made.schedule is None:
            return Batch("", {}, made.failure, made.code)
        parts = [self.fly_mode(task, made.schedule, mode)[1] for mode in self.modes]
        return Batch(made.digest, {name: np.concatenate([part[name] for part in parts]) for name in parts[0]})

    def fly_mode(self, task: Task, schedule: Schedule, mode: str) -> tuple[Runs, dict[str, Array]]:
        """The runs of one mode of a batch, and their columns of the table, shapes (runs,)."""
        number = MODES[mode]
        name = mode if number is None else schedule.controllers[number].name
        seed, seed_truth = batch_seeds(task)
        runs = simulate(
            schedule, task.runs, seed, mode=number, initial=self.initial, disturbance=self.disturbance
        )
        who: dict[str, Any] = {
            "seed": np.full(task.runs, seed, dtype=np.int64),
            "seed_truth": np.full(task.runs, seed_truth, dtype=np.int64),
            "run": np.arange(task.runs, dtype=np.int64),
            "mode": np.repeat(mode, task.runs),
            "controller": np.repeat(name, task.runs),
        }
        return runs, who | evaluate(runs, seed_truth, name).columns()

    def fly_again(self, task: Task, mode: str, run: int) -> tuple[Batch, Trajectory | None]:
        """As `Kind.fly_again`."""
        made = schedule_of(task.text)
        if made.schedule is None:
            return Batch("", {}, made.failure, made.code), None
        runs, measured = self.fly_mode(task, made.schedule, mode)
        return Batch(made.digest, measured), _trajectory(task, runs, run)

    def summarise(self, results: Results, worst: int) -> dict[str, Any]:
        """As `Kind.summarise`."""
        return summarise(results, self.data(), worst)


def batch_seeds(task: Task) -> tuple[int, int]:
    """Seeds of the flights and of the other satellites' true states, below 2^63.

    They hang on the campaign's seed, the case's text and the batch's number alone.
    """
    case = int.from_bytes(hashlib.sha256(task.text.encode()).digest()[:16], "big")
    drawn = np.random.SeedSequence([task.seed, case, task.batch]).generate_state(2, np.uint64) >> np.uint64(1)
    return int(drawn[0]), int(drawn[1])


def _trajectory(task: Task, runs: Runs, run: int) -> Trajectory:
    """One run, with its distance to every true unsafe set."""
    problem = runs.schedule.safety.problem
    obstacles, system = tuple(problem.unsafe), problem.system
    # Other satellites are drawn as `evaluate` draws them: part by part from one seed.
    rng, truth = np.random.default_rng(batch_seeds(task)[1]), {}
    for first in range(0, run + 1, PART):
        truth = true_states(obstacles, system, runs.times, min(PART, task.runs - first), rng)
    truth = {name: states[run % PART] for name, states in truth.items()}
    distances = signed_distances(obstacles, runs.times, runs.positions[run], system, truth)
    names = tuple(obstacle.name for obstacle in obstacles)
    arrays = {
        "times_s": runs.times,
        "states": runs.states[run],
        "inputs": runs.inputs[run],
        "modes": runs.mode_per_period,
        "distances_m": distances,
        "names": np.array(names, dtype=str),
    }
    of_states, of_inputs = columns(system)
    table = {
        "t_s": runs.times,
        **dict(zip(of_states, runs.states[run].T, strict=True)),
        **dict(zip(of_inputs, runs.inputs[run].T, strict=True)),
        "mode": runs.mode_per_period,
        **{f"distance_{name}_m": values for name, values in zip(names, distances, strict=True)},
    }
    return Trajectory(arrays, table)


# -- schedules, one synthesis per process ---------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Made:
    """A synthesis, or why there is none."""

    schedule: Schedule | None
    digest: str = ""
    failure: str = ""
    code: int = 0


def schedule_of(text: str) -> Made:
    """Schedule of a scenario's text; made once per process, whatever its threads ask for."""
    with _lock:
        return _made(text)


@lru_cache(KEPT)
def _made(text: str) -> Made:
    from ...scenario.scenario import ScheduleScenario
    from ...synthesis.synthesize import synthesize
    from ..schedule import digest

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ClockWarning)  # told below
            schedule = synthesize(ScheduleScenario.from_dict(tomllib.loads(text)))
    except PolarisError as error:
        return Made(None, failure=str(error), code=error.exit_code)
    except np.linalg.LinAlgError as error:
        return Made(None, failure=f"the numbers of this case defeat the linear algebra: {error}", code=3)
    if schedule.safety.cut_by_clock:
        cut = ", ".join(schedule.safety.cut_by_clock)
        rule = f"the wall clock ended the planner's search early ({cut}), and a campaign must be repeatable"
        return Made(None, failure=f"{rule}: raise planner.time_limit_s", code=OutOfTime.exit_code)
    return Made(schedule, digest(schedule))
