"""Flying a campaign: hands tasks to an executor, keeps what comes back, and survives lost workers."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from dataclasses import dataclass, field
from pathlib import Path

from ...model.errors import PolarisError
from .batch import Batch, Task, fly_batch
from .folder import CampaignFolder, open_campaign
from .plan import CampaignPlan
from .workers import Workers, going_on, work_through, workers_of

RECOVERIES = 3
"""Times in a row that lost workers are replaced without a batch being finished."""

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
            self._tell()
            losses = 0
            while missing:
                before = self.done
                lost = work_through(self.workers, fly_batch, self._left(missing), self._keep)
                missing.extendleft(sorted(lost, key=lambda task: (task.case, task.batch), reverse=True))
                losses = losses + 1 if self.done == before else 1
                if lost and (not self.workers.again or losses > RECOVERIES):
                    rule = f"workers were lost {losses} times without finishing a batch"
                    raise PolarisError(f"{rule} (out of memory, or killed?)")

    def _left(self, missing: deque[Task]) -> Iterator[Task]:
        """Tasks of cases that can be flown, taken out of those that are missing."""
        while missing:
            task = missing.popleft()
            if task.case not in self.failed:
                yield task

    def _kept(self, task: Task) -> bool:
        """Whether a task needs no work: its part is there, or its case cannot be flown."""
        if task.case in self.failed:
            return True
        schedule = self.folder.check(task)
        if schedule is None:
            return False
        self._same_schedule(task, schedule)
        self.done += task.runs
        return True

    def _keep(self, task: Task, batch: Batch) -> None:
        if not batch.failure:
            self._same_schedule(task, batch.schedule)
            self.folder.write(task, batch)
            self.done += task.runs
        elif task.case not in self.failed:
            self.failed.add(task.case)
            self.folder.fail(task.case, batch)
        self._tell()

    def _same_schedule(self, task: Task, schedule: str) -> None:
        """All runs of a case are of one schedule, whoever made it."""
        if self.schedules.setdefault(task.case, schedule) != schedule:
            label = self.folder.plan.cases[task.case].label
            raise PolarisError(
                f"{label}: workers (or an earlier part of this campaign) found different schedules: other"
                " processors, or other versions of the solver"
            )

    def _tell(self) -> None:
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
        What to fly.
    out : path
        Folder of the campaign. If it holds the same one, only what is missing is flown.
    executor : concurrent.futures.Executor or Workers, optional
        Who flies: any executor (it is not closed), or what `local` and `cluster` give, which also
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
