"""Targets of attacks, and counterexamples as files: all that flies one again, exact to the bit."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from ..model.errors import ScenarioError
from ..model.files import load_json
from ..model.system import Array
from ..scenario.reading import parse_toml
from ..scenario.scenario import ScheduleScenario, bundled_files, load_scenario
from ..simulation.delayed import flies
from ..simulation.falsification.aborting import exceeded
from ..simulation.falsification.attacks import Attack
from ..simulation.falsification.claims import Claims, attained
from ..simulation.falsification.drifting import drifted
from ..simulation.falsification.search import Falsification
from ..simulation.falsification.violations import Failure, overspent, violation
from ..simulation.fault_times import FaultTimes
from ..simulation.on_board import FlightCode
from ..simulation.sampled import with_boxes
from ..synthesis.controllers.black_box import Ask, BlackBox
from ..synthesis.schedule.schedule import Schedule
from ..synthesis.schedule.synthesize import synthesize
from .files.atomic import write_whole
from .files.folder import RunFolder
from .files.tables import json_text
from .read_schedule import read_schedule, schedule_folder
from .schedule import digest

FORMAT = "polaris case"
VERSION = 4


@dataclass(frozen=True, eq=False)
class CommandTarget:
    """Scenario that a command starts from, and the run folder that it came from, if any."""

    scenario: ScheduleScenario
    folder: RunFolder | None = None

    def schedule(self, boxes: Mapping[str, Ask] | None = None) -> Schedule:
        """Read the schedule of the folder, or synthesise that of the scenario."""
        if self.folder is None:
            return with_boxes(self.scenario, boxes).schedule if boxes else synthesize(self.scenario)
        schedule = read_schedule(self.folder, boxes)
        if any(isinstance(law, BlackBox) for law in schedule.controllers):
            self.scenario.check_black_boxes(boxes)  # they are about to fly
        return schedule


def load_target(target: str, overrides: Sequence[str] = (), table: str = "") -> CommandTarget:
    """Load a run folder of a schedule, or a scenario; a bundled name wins over a folder of that name.

    In a run folder overrides may change keys of the table `table` only, which its schedule does not rest on.
    """
    if target in bundled_files() or not Path(target).is_dir():
        return CommandTarget(load_scenario(target, overrides, only=ScheduleScenario))
    if not all(table and text.lstrip().startswith(f"{table}.") for text in overrides):
        rule = f"must change keys of [{table}] only" if table else "must be left out"
        raise ScenarioError("--set", list(overrides), f"{rule} for a run folder, whose schedule is fixed")
    folder = schedule_folder(target)
    return CommandTarget(folder.scenario.with_assignments(overrides), folder)


def write_case(
    path: str | Path, scenario: ScheduleScenario, found: Falsification, *, force: bool = False
) -> Path:
    """Save the counterexample of a search.

    Parameters
    ----------
    path : path
        A JSON file.
    scenario : ScheduleScenario
        What was synthesised, overrides included.
    found : Falsification
        With a failure.
    force : bool
        Whether a file that is there is replaced.

    Raises
    ------
    ScenarioError
        If there is no failure, or a file is there already, or it cannot be written.
    """
    if found.case is None or found.failure is None:
        raise ScenarioError("case", None, "must come from a search that found a violation")
    attack, tail = found.case
    data = {
        "format": FORMAT,
        "version": VERSION,
        "scenario": scenario.text_elsewhere(),
        "schedule": digest(found.schedule),
        "tail": tail,
        "violation": vars(found.failure),
        "x0": attack.x0[0],
        "w": _packed(attack.w[:, 0]),
        "inputs": None if attack.free is None else _packed(attack.free[:, 0]),
        "faults": None if attack.faults is None else attack.faults.table(),
        "abort": found.abort,
    }
    target = Path(path)
    write_whole(target, json_text(data), force=force)
    return target


def replay(path: str | Path, code: FlightCode | None = None) -> tuple[Failure | None, ScheduleScenario]:
    """Fly a saved case again, by flight code if given: synthesise its schedule, check it, simulate.

    Returns
    -------
    failure : Failure or None
        What it violates now.
    scenario : ScheduleScenario
        Of the case.

    Raises
    ------
    ScenarioError
        If the file is no case, or its scenario no longer gives the schedule it was found on.
    """
    data = _read(Path(path))
    scenario = ScheduleScenario.from_dict(parse_toml(data["scenario"], str(path)), Path(path).name)
    nominal = synthesize(scenario)
    if digest(nominal) != data["schedule"]:
        rule = "is of another schedule than its scenario gives here; is the solver's version the same?"
        raise ScenarioError("case", str(path), rule)
    schedule = nominal if data.get("abort") is None else nominal.aborted(int(data["abort"]))
    try:
        attack = Attack(
            _finite(data["x0"])[None],
            _unpacked(data["w"]),
            None if data["inputs"] is None else _unpacked(data["inputs"]),
            FaultTimes.from_table(data["faults"], len(data["x0"])) if data["faults"] else None,
        )
        monitored = None if code is None else code.asks
        claims = Claims(schedule, bool(data["tail"]), attack.faults is not None, monitored)
        flight = flies(schedule.safety.problem.system)(schedule, claims.modes, 1)
        if len(attack.w) != flight.steps or attack.x0.shape[1] != flight.system.n:
            raise ValueError("its arrays do not fit the schedule")
        flight.code = code and code.require_schedule(schedule)
        runs, recorded = attack.fly(flight), Failure(**data["violation"])
        failure = violation(claims, attained(claims, runs, attack.faults))
        if failure is None and recorded.kind == "velocity change":
            failure, _ = overspent(runs)
        elif failure is None and recorded.kind == "drift" and nominal.passive is not None:
            node = np.array([round(recorded.time_s / runs.times[1])])
            failure, _ = drifted(nominal.passive, runs, 0 * node, node)
        elif failure is None and recorded.kind == "abort":
            failure, _ = exceeded(nominal, int(data["abort"]), runs)
        return failure if failure and failure.broken else None, scenario
    except (ValueError, TypeError, LookupError, OverflowError) as error:
        raise ScenarioError("case", str(path), f"is damaged ({error})") from error


def _read(path: Path) -> dict[str, Any]:
    try:
        data: Any = load_json(path)
    except (OSError, ValueError) as error:
        raise ScenarioError("case", str(path), f"must be a case file ({error})") from error
    keys = {"scenario", "schedule", "tail", "x0", "w", "inputs", "faults", "violation"}
    is_case = isinstance(data, dict) and data.get("format") == FORMAT
    if is_case and data.get("version") != VERSION:  # before the keys, which differ by version
        raise ScenarioError("case", data.get("version"), f"must be of version {VERSION}")
    if not (is_case and keys <= set(data) and isinstance(data["scenario"], str)):
        raise ScenarioError("case", str(path), "must be a case file, as `polaris falsify` writes them")
    return dict(data)


def _packed(rows: Array) -> list[list[Any]]:
    """Rows, each with the number of times it follows itself; JSON keeps numbers exactly."""
    return [[len(copies), copies[0]] for copies in (list(group) for _, group in groupby(rows.tolist(), repr))]


def _unpacked(packed: list[list[Any]]) -> Array:
    rows = _finite([row for _, row in packed])
    return np.repeat(rows, [int(count) for count, _ in packed], axis=0)[:, None]


def _finite(values: Any) -> Array:
    array = np.array(values, dtype=float)
    if not np.isfinite(array).all():
        raise ValueError("numbers that are not finite")
    return array
