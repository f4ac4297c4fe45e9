"""Campaigns of schedules: a case is synthesised once per process, its runs are simulated and measured."""

import hashlib
import re
import threading
import warnings
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np

from ...model.checks import one_of
from ...model.errors import ClockWarning, OutOfTime, PolarisError, ScenarioError, SynthesisInfeasible
from ...model.scene.distances import signed_distances
from ...model.scene.satellite import true_states
from ...model.system import Array
from ...scenario.reading import parse_toml
from ...scenario.scenario import ScheduleScenario
from ...simulation.baselines import alone_key
from ...simulation.disturbances import Disturbance
from ...simulation.metrics import CONFIDENCE, mean_interval, possible, violation_interval
from ...simulation.run_metrics import PART, Runs, evaluate
from ...simulation.sampled import with_boxes
from ...simulation.simulate import DISTURBANCES, INITIALS, Initial, simulate
from ...synthesis.controllers.black_box import Ask
from ...synthesis.schedule.schedule import Schedule
from ...synthesis.schedule.synthesize import synthesize
from ..files.tables import columns
from ..schedule import digest
from .batch import Batch, CampaignRuns, Columns, Replayed, Task, of_mode

MODES: dict[str, int | None] = {"polaris": None, "safety": 0, "experimental": 1}
"""Modes: the schedule, S alone, the preferred U alone; further U are ``experimental_2`` and so on."""

KEPT = 4  # schedules a process keeps; cases come one after the other, so few are in use at a time

_lock = threading.Lock()

MEANS = ("min_distance_m", "mean_distance_m", "experimental_share", "delta_v_m_s")  # told with intervals

WORST: dict[str, Callable[[Array], Any]] = {
    "min_distance_m": np.min,
    "min_ttc_s": np.min,
    "min_ttc_free_drift_s": np.min,
    "experimental_share": np.min,
    "switches": np.max,
    "delta_v_m_s": np.max,
    "max_thrust_ratio": np.max,
    "max_thrust_ratio_safety": np.max,
}
"""Columns whose worst value over runs is told, and which one that is."""

COLUMNS = sorted({*MEANS, *WORST, "batch", "run", "mode", "controller", "guarantee", "collided"})

DEFINITIONS = {
    "violations": "runs that entered a true keep-out zone",
    "violation_probability": "share of violating runs, and the two-sided 95 % interval of Clopper and Pearson"
    " for runs drawn as here",
    "mean": "mean over runs, with the two-sided 95 % interval of Student's t, cut to possible values; null"
    " if a run has no finite value",
    "worst": "maximum over runs for switches, delta_v_m_s and max_thrust_ratio, minimum for the others",
    "worst_runs": "runs with the smallest distance to a keep-out zone, nearest first",
}

ASSUMPTIONS = {
    "mixed": "half of the runs of each batch start at corners under worst-case disturbances, the others are"
    " random, and every second run has a fault if faults are isolated late; probabilities and means apply"
    " to this mixture, not to real flights",
    "drawn": "probabilities and means apply to initial states and disturbances drawn as here, not to real"
    " flights",
    "independent": "runs are independent; the fixed halves of the mixture can only widen the intervals",
    "normal": "the mean over the runs is normally distributed",
}


@dataclass(frozen=True, eq=False)
class Boxes:
    """Functions that ask black boxes, by their names; None before they are given."""

    asks: Mapping[str, Ask | None]
    busy: threading.Lock = field(default_factory=threading.Lock)

    def __reduce__(self) -> Any:
        raise ScenarioError("executor", "other processes", "must be left out: this process asks black boxes")


@lru_cache(KEPT)
def _synthesize(text: str, boxes: Boxes | None) -> tuple[Schedule, str] | PolarisError:
    """Return a schedule and its digest, or why there is none."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ClockWarning)  # told below
            scenario = ScheduleScenario.from_dict(parse_toml(text, "campaign"))
            schedule = with_boxes(scenario, boxes.asks).schedule if boxes else synthesize(scenario)
    except PolarisError as error:
        return error
    except np.linalg.LinAlgError as error:
        return SynthesisInfeasible(f"the numbers of this case defeat the linear algebra: {error}")
    if schedule.safety.cut_by_clock:
        cut = ", ".join(schedule.safety.cut_by_clock)
        rule = f"planner.time_limit_s ended the search early ({cut}), but a campaign must be repeatable"
        return OutOfTime(f"{rule}: raise planner.time_limit_s")
    return replace(schedule, library=()), digest(schedule)  # other references fly nowhere here


def schedule_of(text: str, boxes: Boxes | None = None) -> tuple[Schedule, str]:
    """Schedule of a scenario's text, and its digest; made once per process for all of its threads."""
    with _lock:
        outcome = _synthesize(text, boxes)
    if isinstance(outcome, PolarisError):
        raise outcome.with_traceback(None)
    return outcome


@dataclass(frozen=True)
class ScheduleRuns(CampaignRuns):
    """Runs of switching schedules, as `polaris.simulate` flies and `polaris.evaluate` measures them.

    The modes are among ``polaris``, ``safety``, ``experimental`` (the preferred one), ``experimental_2`` and
    so on; `initial` and `disturbance` are those of `polaris.simulate`. Black boxes are asked by this process
    alone, and manifests know their names only.
    `ScenarioError` if a value is not allowed.
    """

    modes: tuple[str, ...] = ("polaris",)
    initial: Initial = "mixed"
    disturbance: Disturbance = "failing"
    boxes: Boxes | None = field(default=None, compare=False)

    name: ClassVar[str] = "schedules"
    ranking: ClassVar[str] = "min_distance_m"

    def __post_init__(self) -> None:
        for mode in self.modes:
            if mode not in MODES and _number(mode) is None:
                raise ScenarioError("--mode", mode, f"must be one of {', '.join(MODES)}, experimental_2, ...")
        one_of("--initial", self.initial, INITIALS)
        one_of("--disturbance", self.disturbance, DISTURBANCES)
        if not self.modes or len(set(self.modes)) < len(self.modes):
            raise ScenarioError("--mode", list(self.modes), "must name at least one mode, each once")

    def check_case(self, text: str, label: str) -> None:
        """Raise `ScenarioError` if a mode names an experimental controller that the case does not have."""
        for mode in self.modes:
            count = len(parse_toml(text, "campaign")["experimental"]) if mode not in MODES else 1
            if (_number(mode) or 0) > count:
                names = ", ".join((*MODES, *map(alone_key, range(2, count + 1))))
                raise ScenarioError("--mode", mode, f"must be one of {names} for {label}")

    def data(self) -> dict[str, Any]:
        """Return the kind as plain data (see `CampaignRuns.data`)."""
        return super().data() | {"boxes": sorted(self.boxes.asks) if self.boxes else None}

    @classmethod
    def from_data(cls, data: Mapping[str, Any]) -> "ScheduleRuns":
        """Build the kind (see `CampaignRuns.from_data`); functions of black boxes are given, not read."""
        names = data["boxes"]
        return super().from_data({**data, "boxes": Boxes(dict.fromkeys(names)) if names else None})

    def fly(self, task: Task, mode: str, run: int | None = None) -> Batch:
        """Fly a task, or one run of it (see `CampaignRuns.fly`)."""
        schedule, sha = schedule_of(task.text, self.boxes)
        number = _number(mode)
        name = mode if number is None else schedule.controllers[number].name
        claim = schedule.guarantee if number is None else "none" if number else "proved"
        seed, seed_truth = batch_seeds(task)
        busy: Any = self.boxes.busy if self.boxes else nullcontext()
        with busy:
            runs = simulate(
                schedule, task.runs, seed, mode=number, initial=self.initial, disturbance=self.disturbance
            )
        table: dict[str, Any] = {
            "seed": np.full(task.runs, seed, dtype=np.int64),
            "seed_truth": np.full(task.runs, seed_truth, dtype=np.int64),
            "run": np.arange(task.runs, dtype=np.int64),
            "mode": np.repeat(mode, task.runs),
            "controller": np.repeat(name, task.runs),
            "guarantee": np.repeat(claim, task.runs),
            **evaluate(runs, seed_truth, name).columns(),
            **({} if runs.faults is None else runs.faults.columns(runs.times)),
        }
        return Batch(sha, table, trajectory=None if run is None else _trajectory(task, runs, run))

    def summarise(self, folder: Any, worst: int) -> dict[str, Any]:
        """Summarise the runs of a campaign (see `CampaignRuns.summarise`)."""
        cases, plan, failures = [], folder.plan, folder.failures()
        for number, case in enumerate(plan.cases):
            row: dict[str, Any] = {
                "case": number,
                "scenario": case.scenario,
                "parameters": dict(case.parameters),
                "label": case.label,
            }
            failure = failures.get(number)
            if failure is None:
                rows = folder.read(number, COLUMNS)
                row["modes"] = {mode: _cell_summary(of_mode(rows, mode), worst) for mode in self.modes}
            else:
                row |= {"failure": failure["message"], "exit_code": failure["exit_code"]}
            cases.append(row)
        kind = "mixed" if {"mixed", "failing"} & {self.initial, self.disturbance} else "drawn"
        return {
            "schema_version": 1,
            "kind": "campaign",
            "runs": plan.runs,
            "seed": plan.seed,
            "batch": plan.batch,
            "initial": self.initial,
            "disturbance": self.disturbance,
            "confidence": CONFIDENCE,
            "flown": plan.runs * len(self.modes) * (len(cases) - len(failures)),
            "cases": cases,
            "assumptions": [ASSUMPTIONS[name] for name in (kind, "independent", "normal")],
            "definitions": DEFINITIONS,
        }


def _number(mode: str) -> int | None:
    """Return the number of the controller that a mode names; None for the schedule or an unknown mode."""
    match = re.fullmatch("experimental_([2-9]|[1-9][0-9]{1,3})", mode)
    return int(match[1]) if match else MODES.get(mode)


def batch_seeds(task: Task) -> tuple[int, int]:
    """Seeds of the flights and of true satellites, below 2^63, from seed, case text and batch alone."""
    case = int.from_bytes(hashlib.sha256(task.text.encode()).digest()[:16], "big")
    drawn = np.random.SeedSequence([task.seed, case, task.batch]).generate_state(2, np.uint64) >> np.uint64(1)
    return int(drawn[0]), int(drawn[1])


def _trajectory(task: Task, runs: Runs, run: int) -> Replayed:
    """One run, with its distance to every true unsafe set."""
    problem = runs.schedule.safety.problem
    obstacles, system = tuple(problem.unsafe), problem.system
    # Other satellites are drawn as `evaluate` draws them: part by part from one seed.
    rng, truth = np.random.default_rng(batch_seeds(task)[1]), {}
    for first in range(0, run + 1, PART):
        truth = true_states(obstacles, system, runs.times, min(PART, task.runs - first), rng)
    truth = {name: states[run % PART] for name, states in truth.items()}
    truth |= {name: states[run] for name, states in runs.bodies.items()}
    distances = signed_distances(obstacles, runs.times, runs.states[run], system, truth)
    names = tuple(obstacle.name for obstacle in obstacles)
    arrays = {
        "times_s": runs.times,
        "states": runs.states[run],
        "inputs": runs.inputs[run],
        "modes": runs.flown[run],
        "distances_m": distances,
        "names": np.array(names, dtype=str),
    }
    of_states, of_inputs = columns(system)
    table = {
        "t_s": runs.times,
        **dict(zip(of_states, runs.states[run].T, strict=True)),
        **dict(zip(of_inputs, runs.inputs[run].T, strict=True)),
        "mode": runs.flown[run],
        **{f"distance_{name}_m": values for name, values in zip(names, distances, strict=True)},
    }
    return Replayed(arrays, table)


def _cell_summary(columns: Columns, worst: int) -> dict[str, Any]:
    runs, violations = len(columns["run"]), int(columns["collided"].sum())
    low, high = violation_interval(violations, runs)
    means: dict[str, Any] = {}
    for name in MEANS:
        values = np.asarray(columns[name], dtype=float)
        mean = mean_interval(values, within=possible(name)) if np.isfinite(values).all() else [None] * 3
        means[name] = dict(zip(("mean", "low", "high"), mean, strict=True))
    order = np.lexsort((columns["run"], columns["batch"], columns["min_distance_m"]))[:worst]
    return {
        "controller": str(columns["controller"][0]),
        "guarantee": str(columns["guarantee"][0]),
        "runs": runs,
        "violations": violations,
        "violation_probability": {"share": violations / runs, "low": low, "high": high},
        "mean": means,
        "worst": {name: extreme(columns[name]) for name, extreme in WORST.items()},
        "worst_runs": [
            {name: columns[name][i] for name in ("batch", "run", "min_distance_m")} for i in order
        ],
    }
