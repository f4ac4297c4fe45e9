"""Flying a campaign: tasks to an executor, survival of lost workers; and flying one run again."""

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ...model.errors import PolarisError, ScenarioError
from .batch import Batch, Replayed, Task, fly_batch
from .folder import CampaignFolder, open_campaign
from .plan import CampaignPlan
from .workers import Workers, going_on, work_through, workers_of

RECOVERIES = 3  # times in a row that lost workers are replaced without a batch being finished

Progress = Callable[[int, int], None]


@dataclass
class Driver:
    """Hands out the tasks of a campaign until all are done; tells `progress` how many runs of how many."""

    folder: CampaignFolder
    workers: Workers
    progress: Progress
    schedules: dict[int, str] = field(default_factory=dict)
    failed: set[int] = field(default_factory=set)
    done: int = 0

    def fly(self) -> None:
        """Do every task whose result is not there yet."""
        self.failed = set(self.folder.failures())
        with going_on(lambda: f"{self.done} runs are kept in {self.folder.path}"):
            missing = deque(task for task in self.folder.plan.tasks() if not self._kept(task))
            self._report()
            losses = 0
            while missing:
                before = self.done
                lost = work_through(self.workers, fly_batch, self._left(missing), self._keep)
                missing.extendleft(sorted(lost, key=lambda task: (task.case, task.batch), reverse=True))
                losses = losses + 1 if self.done == before else 1
                if lost and (not self.workers.renewed or losses > RECOVERIES):
                    rule = f"workers were lost {losses} times without finishing a batch"
                    raise PolarisError(f"{rule} (out of memory, or killed?)")

    def _left(self, missing: deque[Task]) -> Iterator[Task]:
        """Tasks of cases that can be flown, taken out of those that are missing."""
        while missing:
            task = missing.popleft()
            if task.case not in self.failed:
                yield task

    def _kept(self, task: Task) -> bool:
        """Return True if a task needs no work: its part is there, or its case cannot be flown."""
        if task.case in self.failed:
            return True
        schedule = self.folder.check(task)
        if schedule is None:
            return False
        self._check_schedule(task, schedule)
        self.done += task.runs
        return True

    def _keep(self, task: Task, batch: Batch) -> None:
        if not batch.failure:
            self._check_schedule(task, batch.schedule)
            self.folder.write(task, batch)
            self.done += task.runs
        elif task.case not in self.failed:
            self.failed.add(task.case)
            self.folder.fail(task.case, batch)
        self._report()

    def _check_schedule(self, task: Task, schedule: str) -> None:
        """Refuse a schedule other than that of the case's earlier runs; `PolarisError`."""
        if self.schedules.setdefault(task.case, schedule) != schedule:
            label = self.folder.plan.cases[task.case].label
            raise PolarisError(
                f"{label}: workers (or an earlier part of this campaign) found different schedules: other"
                " processors, other versions of the solver, or another black box"
            )

    def _report(self) -> None:
        plan = self.folder.plan
        self.progress(self.done, plan.runs * (len(plan.cases) - len(self.failed)))


def run_campaign(
    plan: CampaignPlan,
    out: str | Path,
    *,
    executor: Executor | Workers | None = None,
    fresh: bool = False,
    worst: int = 5,
    progress: Progress = lambda done, total: None,
) -> CampaignFolder:
    """Fly many runs of every case, and write them to a folder as they come.

    Parameters
    ----------
    plan : CampaignPlan
        Cases, runs and seed to fly.
    out : path
        Folder of the campaign. If it holds the same one, only what is missing is flown.
    executor : concurrent.futures.Executor or Workers, optional
        Workers that fly: any executor (it is not closed), or what `local` and `cluster` give, which also
        replace lost workers; by default this process.
    fresh : bool
        Replace another campaign.
    worst : int
        Worst runs told per case and mode in the summary.
    progress : callable
        Told the runs done and all of them, per mode.

    Returns
    -------
    CampaignFolder
        With its summary written.

    Raises
    ------
    ScenarioError
        If the folder holds something else, or its tables need a package that is not there.
    PolarisError
        If workers are lost again and again, stay away or disagree; what was finished is kept.
    """
    folder = open_campaign(out, plan, fresh)
    Driver(folder, workers_of(executor), progress).fly()
    folder.write_summary(worst)
    return folder


def find_worst(
    folder: CampaignFolder, rank: int, mode: str | None = None, case: int | None = None
) -> tuple[int, int, int]:
    """Case, batch and run that came `rank`-th closest to an unsafe set; `ScenarioError` if there is none."""
    ranking = folder.plan.kind.ranking
    if not ranking:
        raise ScenarioError("--worst", rank, "must be left out: these runs are not ranked")
    mode = mode or folder.plan.kind.modes[0]
    failed = folder.failures()
    cases = [case] if case is not None else [c for c in range(len(folder.plan.cases)) if c not in failed]
    ranked = []
    for number in cases:
        _check(folder, folder.plan.task(number, 0), mode)
        try:
            table = folder.read(number, ["batch", "run", "mode", ranking])
        except OSError as error:
            rule = "must be finished; run the same command again first"
            raise ScenarioError("campaign", str(folder.path), rule) from error
        in_mode = table["mode"] == mode
        values, batches, runs = (table[name][in_mode] for name in (ranking, "batch", "run"))
        order = np.lexsort((runs, batches, values))[:rank]
        ranked += [(float(values[i]), number, int(batches[i]), int(runs[i])) for i in order]
    if not 1 <= rank <= len(ranked):
        raise ScenarioError("--worst", rank, f"must be from 1 to the number of runs, {len(ranked)}")
    return sorted(ranked)[rank - 1][1:]


def replay_run(folder: CampaignFolder, case: int, batch: int, run: int, mode: str | None = None) -> Replayed:
    """Fly one run again, bit for bit: its batch is flown as it was, and this run taken out of it.

    Parameters
    ----------
    folder : CampaignFolder
    case, batch, run : int
        As in the table.
    mode : str, optional
        Mode that flies; by default the first that flew.

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
    digest = folder.check(task)
    if digest is None:
        rule = f"its part {folder.part(task).name} is missing or damaged; run the campaign again"
        raise ScenarioError("campaign", str(folder.path), rule)
    replayed = folder.plan.kind.fly(task, mode, run)
    if replayed.schedule != digest:
        raise PolarisError("this case gives another schedule than in the campaign; are versions the same?")
    row = folder.row(task, mode, run)
    for name, values in replayed.columns.items():
        value, recorded = values[run].item(), row[name]
        if value != recorded and (value == value or recorded == recorded):  # the same, or both nan
            difference = f"{name} is {value!r} here and {recorded!r} in the table"
            raise PolarisError(f"the repeated run differs on this machine: {difference}")
    assert replayed.trajectory is not None
    return replace(replayed.trajectory, row=row)


def _check(folder: CampaignFolder, task: Task, mode: str) -> None:
    if mode not in folder.plan.kind.modes:
        rule = f"must be a mode that was flown, one of {', '.join(folder.plan.kind.modes)}"
        raise ScenarioError("--mode", mode, rule)
    failure = folder.failures().get(task.case)
    if failure is not None:
        raise ScenarioError("--case", task.case, f"cannot be flown: {failure['message']}")
