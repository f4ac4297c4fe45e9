"""Flying one run of a campaign again: the same numbers, with its whole trajectory."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...model.errors import (PolarisError, ScenarioError)
from ...simulation.run_metrics import PART
from ...model.distances import signed_distances
from ..atomic import (check_file, replacing_file)
from ..tables import (columns, write_csv)
from ...simulation.run_metrics import (Runs)
from ...model.system import (Array, LinearSystem)
from ...model.satellite import true_states
from .batch import (Task, fly_mode, schedule_of)
from .folder import CampaignFolder


@dataclass(frozen=True, eq=False)
class Replayed:
    """One run of a campaign, flown again.

    Attributes
    ----------
    row : dict
        What the campaign's table says of it.
    system : LinearSystem
    times : ndarray, shape (N+1,)
        [s]
    states : ndarray, shape (N+1, n)
    inputs : ndarray, shape (N, m)
        Applied after every node.
    modes : ndarray of int, shape (N,)
        Mode over the period after every node.
    distances : ndarray, shape (O, N+1)
        Signed distance to every true unsafe set [m].
    names : tuple of str
        Of the unsafe sets.
    """

    row: dict[str, Any]
    system: LinearSystem
    times: Array
    states: Array
    inputs: Array
    modes: NDArray[np.int_]
    distances: Array
    names: tuple[str, ...]

    def write(self, path: str | Path) -> Path:
        """Write the trajectory as CSV or, if the name ends so, as ``.npz``; whole, or not at all.

        Raises
        ------
        ScenarioError
            If the name ends otherwise, or the file cannot be written.
        """
        target = check_trajectory(path)
        with replacing_file(target) as beside:
            self._write_csv(beside) if target.suffix == ".csv" else self._write_npz(beside)
        return target

    def _write_csv(self, path: Path) -> None:
        states, inputs = columns(self.system)
        header = ("t_s", *states, *inputs, "mode", *(f"distance_{name}_m" for name in self.names))
        held: list[Any] = [*self.inputs.tolist(), [None] * self.system.m]
        modes = [*self.modes.tolist(), None]
        rows = [
            [t, *x, *u, mode, *distance]
            for t, x, u, mode, distance in zip(
                self.times.tolist(), self.states.tolist(), held, modes, self.distances.T.tolist(), strict=True
            )
        ]
        write_csv(path, header, rows)

    def _write_npz(self, path: Path) -> None:
        np.savez(
            path,
            times_s=self.times,
            states=self.states,
            inputs=self.inputs,
            modes=self.modes,
            distances_m=self.distances,
            names=np.array(self.names, dtype=str),
        )


def check_trajectory(path: str | Path) -> Path:
    """Whether a trajectory may be written there.

    Raises
    ------
    ScenarioError
        If the name does not end with ``.csv`` or ``.npz``, or the file cannot be written.
    """
    return check_file(path, endings=(".csv", ".npz"))


def find_worst(
    folder: CampaignFolder, rank: int, mode: str = "polaris", case: int | None = None
) -> tuple[int, int, int]:
    """Case, batch and run that came closest to an unsafe set, or the `rank`-th closest (1 is the closest).

    Raises
    ------
    ScenarioError
        If there are fewer runs, or not all of the parts yet.
    """
    failed = folder.failures()
    cases = [case] if case is not None else [c for c in range(len(folder.plan.cases)) if c not in failed]
    found = []
    for number in cases:
        _check(folder, folder.plan.task(number, 0), mode)
        try:
            table = folder.parts.read(number, ["batch", "run", "mode", "min_distance_m"])
        except OSError as error:
            raise ScenarioError(
                "campaign", str(folder.path), "is not finished; run it again first"
            ) from error
        chosen = {
            name: table[name].to_numpy()[table["mode"].to_numpy() == mode] for name in table.column_names
        }
        order = np.lexsort((chosen["run"], chosen["batch"], chosen["min_distance_m"]))[:rank]
        found += [
            (float(chosen["min_distance_m"][i]), number, int(chosen["batch"][i]), int(chosen["run"][i]))
            for i in order
        ]
    if not 1 <= rank <= len(found):
        raise ScenarioError("--worst", rank, f"must be from 1 to the number of runs, {len(found)}")
    return sorted(found)[rank - 1][1:]


def replay_run(folder: CampaignFolder, case: int, batch: int, run: int, mode: str = "polaris") -> Replayed:
    """Fly one run again, bit for bit: its batch is flown as it was, and this run taken out of it.

    Parameters
    ----------
    folder : CampaignFolder
    case, batch, run : int
        As in the table.
    mode : {"polaris", "safety", "experimental"}

    Raises
    ------
    ScenarioError
        If there is no such run, or its part is missing or damaged.
    PolarisError
        If the case gives another schedule here, or the run other numbers than the table has.
    """
    task = folder.plan.task(case, batch)
    _check(folder, task, mode)
    if not 0 <= run < task.runs:
        raise ScenarioError("--run", run, f"must be from 0 to {task.runs - 1}")
    known = folder.parts.check(task)
    if known is None:
        rule = f"the part {folder.parts.path(task).name} is missing or damaged; run the campaign again"
        raise ScenarioError("campaign", str(folder.path), rule)
    made = schedule_of(task.text)
    if made.schedule is None or made.digest != known:
        raise PolarisError("this case gives another schedule here than it gave then (other versions?)")
    runs, measured = fly_mode(task, made.schedule, mode)
    row = folder.parts.row(task, mode, run)
    for name, values in measured.items():
        if not _same(values[run].item(), row[name]):
            given = f"{name} is {values[run].item()!r} here and {row[name]!r} in the table"
            raise PolarisError(f"the run comes out differently on this machine: {given}")
    obstacles = tuple(made.schedule.safety.problem.unsafe)
    system = made.schedule.safety.problem.system
    truth = {name: states[run % PART] for name, states in _truth(task, runs, run).items()}
    return Replayed(
        row,
        system,
        runs.times,
        runs.states[run],
        runs.inputs[run],
        runs.mode_per_period,
        signed_distances(obstacles, runs.times, runs.positions[run], system, truth),
        tuple(obstacle.name for obstacle in obstacles),
    )


def _truth(task: Task, runs: Runs, run: int) -> dict[str, Array]:
    """True states of other satellites, drawn as `evaluate` draws them: part by part from one seed."""
    problem = runs.schedule.safety.problem
    rng = np.random.default_rng(task.seeds[1])
    found: dict[str, Array] = {}
    for first in range(0, run + 1, PART):
        count = min(PART, task.runs - first)
        found = true_states(tuple(problem.unsafe), problem.system, runs.times, count, rng)
    return found


def _check(folder: CampaignFolder, task: Task, mode: str) -> None:
    if mode not in task.modes:
        raise ScenarioError("--mode", mode, f"was not flown; must be one of {', '.join(task.modes)}")
    failure = folder.failures().get(task.case)
    if failure is not None:
        raise ScenarioError("--case", task.case, f"has no schedule: {failure['message']}")


def _same(here: Any, there: Any) -> bool:
    return bool(here == there or (here != here and there != there))
