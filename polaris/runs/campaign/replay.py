"""Flying one run of a campaign again: the same numbers, with its whole trajectory."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from ...model.errors import PolarisError, ScenarioError
from ..atomic import check_file, replacing_file
from ..tables import write_csv
from .batch import Task, Trajectory
from .folder import CampaignFolder


@dataclass(frozen=True, eq=False)
class Replayed(Trajectory):
    """One run of a campaign, flown again.

    Attributes
    ----------
    row : dict
        What the campaign's table says of it.
    """

    row: dict[str, Any]

    def write(self, path: str | Path) -> Path:
        """Write the trajectory as CSV or, if the name ends so, as ``.npz``; whole, or not at all.

        Raises
        ------
        ScenarioError
            If the name ends otherwise, or the file cannot be written.
        """
        target = check_trajectory(path)
        with replacing_file(target) as beside:
            if target.suffix == ".npz":
                np.savez(beside, **self.arrays)
            else:
                rows = zip_longest(*(values.tolist() for values in self.table.values()))
                write_csv(beside, [dict(zip(self.table, row, strict=True)) for row in rows])
        return target


def check_trajectory(path: str | Path) -> Path:
    """Whether a trajectory may be written there, as CSV or ``.npz``."""
    return check_file(path, endings=(".csv", ".npz"))


def find_worst(
    folder: CampaignFolder, rank: int, mode: str | None = None, case: int | None = None
) -> tuple[int, int, int]:
    """Case, batch and run that came closest to an unsafe set, or the `rank`-th closest (1 is the closest).

    Raises
    ------
    ScenarioError
        If there are fewer runs, not all of the parts yet, or runs of this kind are not ranked.
    """
    ranking = folder.plan.kind.ranking
    if not ranking:
        raise ScenarioError("--worst", rank, "runs of this kind are not ranked; give --case, --batch, --run")
    mode = mode or folder.plan.kind.modes[0]
    failed = folder.failures()
    cases = [case] if case is not None else [c for c in range(len(folder.plan.cases)) if c not in failed]
    found = []
    for number in cases:
        _check(folder, folder.plan.task(number, 0), mode)
        try:
            table = folder.read(number, ["batch", "run", "mode", ranking])
        except OSError as error:
            raise ScenarioError(
                "campaign", str(folder.path), "is not finished; run it again first"
            ) from error
        flown = table["mode"] == mode
        least, batches, runs = (table[name][flown] for name in (ranking, "batch", "run"))
        order = np.lexsort((runs, batches, least))[:rank]
        found += [(float(least[i]), number, int(batches[i]), int(runs[i])) for i in order]
    if not 1 <= rank <= len(found):
        raise ScenarioError("--worst", rank, f"must be from 1 to the number of runs, {len(found)}")
    return sorted(found)[rank - 1][1:]


def replay_run(folder: CampaignFolder, case: int, batch: int, run: int, mode: str | None = None) -> Replayed:
    """Fly one run again, bit for bit: its batch is flown as it was, and this run taken out of it.

    Parameters
    ----------
    folder : CampaignFolder
    case, batch, run : int
        As in the table.
    mode : str, optional
        Who flies; by default the first that flew.

    Raises
    ------
    ScenarioError
        If there is no such run, or its part is missing or damaged.
    PolarisError
        If what flies here is another schedule, or the run gives other numbers than the table has.
    """
    task = folder.plan.task(case, batch)
    mode = mode or folder.plan.kind.modes[0]
    _check(folder, task, mode)
    if not 0 <= run < task.runs:
        raise ScenarioError("--run", run, f"must be from 0 to {task.runs - 1}")
    known = folder.check(task)
    if known is None:
        rule = f"the part {folder.part(task).name} is missing or damaged; run the campaign again"
        raise ScenarioError("campaign", str(folder.path), rule)
    flown = folder.plan.kind.fly(task, mode, run)
    if flown.schedule != known:
        raise PolarisError("this case gives another schedule here than it gave then (other versions?)")
    row = folder.row(task, mode, run)
    for name, values in flown.columns.items():
        here, there = values[run].item(), row[name]
        if here != there and (here == here or there == there):  # the same, or both nan
            given = f"{name} is {here!r} here and {there!r} in the table"
            raise PolarisError(f"the run comes out differently on this machine: {given}")
    assert flown.trajectory is not None
    return Replayed(**vars(flown.trajectory), row=row)


def _check(folder: CampaignFolder, task: Task, mode: str) -> None:
    if mode not in folder.plan.kind.modes:
        rule = f"was not flown; must be one of {', '.join(folder.plan.kind.modes)}"
        raise ScenarioError("--mode", mode, rule)
    failure = folder.failures().get(task.case)
    if failure is not None:
        raise ScenarioError("--case", task.case, f"cannot be flown: {failure['message']}")
