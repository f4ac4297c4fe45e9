"""One task of a campaign, done by a worker: synthesise a case once, fly and measure a batch of its runs.

A task is text and numbers, its result plain arrays: nothing else travels between processes.
"""

from __future__ import annotations

import hashlib
import threading
import tomllib
import warnings
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from ...model.errors import ClockWarning, OutOfTime, PolarisError
from ...model.system import Array
from ...model.version import version
from ...simulation.disturbances import Disturbance
from ...simulation.run_metrics import Runs, evaluate
from ...simulation.simulate import Initial, simulate

if TYPE_CHECKING:
    from ...synthesis.schedule import Schedule

MODES: dict[str, int | None] = {"polaris": None, "safety": 0, "experimental": 1}
"""Who flies: the schedule, S alone, or the preferred U alone."""

KEPT = 4
"""Schedules a process keeps; cases come one after the other, so few are in use at a time."""

_lock = threading.Lock()


@dataclass(frozen=True)
class Task:
    """One batch of runs of one case.

    Attributes
    ----------
    case, batch : int
        Numbers, counted from 0.
    text : str
        Scenario as TOML.
    runs : int
        Runs per mode.
    seed : int
        Of the campaign.
    modes : tuple of str
        Out of `MODES`.
    initial, disturbance : str
        As in `polaris.simulate`.
    version : str
        Of this package; a worker that has another refuses.
    """

    case: int
    batch: int
    text: str
    runs: int
    seed: int
    modes: tuple[str, ...]
    initial: Initial
    disturbance: Disturbance
    version: str

    @property
    def seeds(self) -> tuple[int, int]:
        """Of the flights and of the other satellites' true states, below 2^63."""
        return batch_seeds(self.seed, self.text, self.batch)


@dataclass(frozen=True, eq=False)
class Batch:
    """What became of a task.

    Attributes
    ----------
    schedule : str
        SHA-256 of what the schedule does; empty if there is none.
    columns : dict of str to ndarray, shapes (modes * runs,)
        One entry per run: one mode after the other.
    failure : str
        Why there is no schedule; else empty.
    code : int
        Exit code of that.
    """

    schedule: str
    columns: dict[str, Array]
    failure: str = ""
    code: int = 0


def batch_seeds(seed: int, text: str, batch: int) -> tuple[int, int]:
    """Seeds of a batch from the campaign's seed, the case's text and the batch's number."""
    case = int.from_bytes(hashlib.sha256(text.encode()).digest()[:16], "big")
    drawn = np.random.SeedSequence([seed, case, batch]).generate_state(2, np.uint64) >> np.uint64(1)
    return int(drawn[0]), int(drawn[1])


def fly_batch(task: Task) -> Batch:
    """Fly one batch, in whatever process.

    Raises
    ------
    PolarisError
        If this process has another version of the package than the campaign.
    """
    if task.version != version():
        rule = f"a worker has version {version()} of this package, the campaign {task.version}"
        raise PolarisError(f"{rule}; install the same everywhere")
    made = schedule_of(task.text)
    if made.schedule is None:
        return Batch("", {}, made.failure, made.code)
    parts = [fly_mode(task, made.schedule, mode)[1] for mode in task.modes]
    return Batch(made.digest, {name: np.concatenate([part[name] for part in parts]) for name in parts[0]})


def fly_mode(task: Task, schedule: Schedule, mode: str) -> tuple[Runs, dict[str, Array]]:
    """The runs of one mode of a batch, and their columns of the table, shapes (runs,)."""
    number = MODES[mode]
    name = mode if number is None else schedule.controllers[number].name
    runs = simulate(
        schedule,
        task.runs,
        task.seeds[0],
        mode=number,
        initial=task.initial,
        disturbance=task.disturbance,
    )
    who: dict[str, Any] = {
        "run": np.arange(task.runs, dtype=np.int64),
        "mode": np.repeat(mode, task.runs),
        "controller": np.repeat(name, task.runs),
    }
    return runs, who | evaluate(runs, task.seeds[1], name).columns()


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
    from ...scenario.scenario import Scenario
    from ...synthesis.synthesize import synthesize
    from ..case import digest

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ClockWarning)  # told below
            schedule = synthesize(Scenario.from_dict(tomllib.loads(text)))
    except PolarisError as error:
        return Made(None, failure=str(error), code=error.exit_code)
    except np.linalg.LinAlgError as error:
        return Made(None, failure=f"the numbers of this case defeat the linear algebra: {error}", code=3)
    if schedule.safety.cut_by_clock:
        cut = ", ".join(schedule.safety.cut_by_clock)
        rule = f"the wall clock ended the planner's search early ({cut}), and a campaign must be repeatable"
        return Made(None, failure=f"{rule}: raise planner.time_limit_s", code=OutOfTime.exit_code)
    return Made(schedule, digest(schedule))
