"""Flying a campaign: hands tasks to an executor, keeps what comes back, and survives lost workers."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from dataclasses import dataclass, field
from pathlib import Path

from ...model.errors import PolarisError
from .batch import Batch, Task, fly_batch
from .folder import CampaignFolder, open_campaign
from .plan import CampaignPlan
from .workers import Workers, given, local

RECOVERIES = 3
"""Times in a row that lost workers are replaced without a batch being finished."""

TICK = 2.0
"""Seconds without a result after which the workers are asked whether there are any."""

Progress = Callable[[int, int], None]


class Interrupted(PolarisError):
    """The user stopped the campaign; what was finished is kept."""

    exit_code = 130


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
        try:
            self._fly()
        except (KeyboardInterrupt, PolarisError) as error:
            kept = f"{self.done} runs are kept in {self.folder.path}, and the same command goes on from there"
            if isinstance(error, KeyboardInterrupt):
                raise Interrupted(f"interrupted; {kept}") from None
            raise PolarisError(f"{error}; {kept}") from error

    def _fly(self) -> None:
        self.failed = set(self.folder.failures())
        missing = deque(task for task in self.folder.plan.tasks() if not self._kept(task))
        self._tell()
        losses = 0
        while missing:
            before = self.done
            lost = self._until_broken(missing)
            if not lost:
                break
            missing.extendleft(reversed(lost))
            losses = losses + 1 if self.done == before else 1
            if not self.workers.again or losses > RECOVERIES:
                rule = (
                    f"workers were lost {losses} times without finishing a batch (out of memory, or killed?)"
                )
                raise PolarisError(rule)

    def _until_broken(self, missing: deque[Task]) -> list[Task]:
        """Hand out tasks until all are done or workers are lost; returns the tasks lost."""
        executor = self.workers.make()
        flying: dict[Future[Batch], Task] = {}
        lost: list[Task] = []
        try:
            while (missing and not lost) or flying:
                while missing and not lost and len(flying) < self.workers.window():
                    task = missing.popleft()
                    if task.case in self.failed:
                        continue
                    try:
                        flying[executor.submit(fly_batch, task)] = task
                    except self.workers.lost:
                        lost.append(task)
                ready, _ = wait(flying, TICK, FIRST_COMPLETED)
                trouble = "" if ready else self.workers.trouble()
                if trouble:
                    raise PolarisError(trouble)
                for future in ready:
                    task = flying.pop(future)
                    try:
                        self._keep(task, future.result())
                    except self.workers.lost:
                        lost.append(task)
        finally:
            for future in flying:
                future.cancel()
            if self.workers.again:
                executor.shutdown(wait=False)
        return sorted(lost, key=lambda task: (task.case, task.batch))

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
    workers = executor if isinstance(executor, Workers) else given(executor) if executor else local(1)
    Driver(folder, workers, progress).fly()
    folder.write_summary(worst)
    return folder
