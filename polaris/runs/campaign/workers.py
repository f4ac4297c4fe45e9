"""Workers: this process, a pool of processes, or a Dask cluster, as `concurrent.futures` executors."""

import logging
import multiprocessing
import os
import re
import signal
import threading
import time
from collections.abc import Callable, Iterator
from concurrent import futures
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import islice
from typing import Any, TypeVar

from reach.numerics.packages import unusable

from ...model.errors import PolarisError, ScenarioError, failed

TICK = 2.0  # seconds without a result after which the workers are asked whether there are any
PATIENCE = 5.0  # seconds a scheduler may take to answer
DESERTED = 60.0  # seconds a cluster may be without any worker before the campaign ends
LOGGERS = ("distributed", "tornado", "asyncio")  # roots of the loggers of Dask's client
AHEAD = 4  # tasks handed out per worker: enough to keep it busy, few enough to bound the memory

Task = TypeVar("Task")
Result = TypeVar("Result")


class Interrupted(PolarisError):
    """The user stopped the work; finished parts are kept."""

    exit_code = 130


@contextmanager
def going_on(describe: Callable[[], str]) -> Iterator[None]:
    """Add to any error that ends the work which runs are kept, and that the same command goes on."""
    try:
        yield
    except KeyboardInterrupt:
        raise Interrupted(f"interrupted; {describe()}, and the same command goes on from there") from None
    except PolarisError as error:
        text = f"{error}; {describe()}, and the same command goes on from there"
        raise failed(text, error.exit_code) from error


@dataclass(frozen=True)
class Workers:
    """An executor that can be made again, and how losses of workers show."""

    make: Callable[[], Executor]  # a new executor
    window: Callable[[], int]  # most tasks to hand out at a time, now
    losses: tuple[type[BaseException], ...] = (BrokenExecutor, CancelledError)  # its task is to be done again
    renewed: bool = True  # whether a broken executor is to be replaced by a new one
    trouble: Callable[[], str] = lambda: ""  # why nothing can come back any more, if so


class InProcess(Executor):
    """Does every task at once, in this process."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Call, and return a future that is done; interrupts of the program go through."""
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:  # whatever it is, the one who asks for the result is told
            future.set_exception(error)
        return future


def cores() -> int:
    """Processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def local(workers: int | None = None) -> Workers:
    """Processes of this machine, by default one per processor; 1 is the process itself."""
    count = cores() if workers is None else workers
    if count == 1:
        return Workers(InProcess, lambda: 1)

    def pool() -> Executor:
        # Matrices here are small: threads of the linear algebra library cost more than they give, and
        # one thread adds up in the same order everywhere. The new processes read this as they start.
        for library in ("OPENBLAS", "OMP", "MKL"):
            os.environ.setdefault(f"{library}_NUM_THREADS", "1")
        context = multiprocessing.get_context("spawn")
        return futures.ProcessPoolExecutor(count, mp_context=context, initializer=_prepare)

    return Workers(pool, lambda: AHEAD * count)


def workers_of(executor: Executor | Workers | None) -> Workers:
    """Return the workers of a user's executor, which is neither closed nor replaced; None is this process."""
    if isinstance(executor, Workers):
        return executor
    return Workers(lambda: executor, lambda: AHEAD * cores(), renewed=False) if executor else local(1)


def work_through(
    workers: Workers,
    work: Callable[[Task], Result],
    tasks: Iterator[Task],
    store: Callable[[Task, Result], None],
) -> list[Task]:
    """Hand tasks to workers, and results to `store`, until all are done or some lost: these are returned."""
    executor = workers.make()
    pending: dict[Future[Result], Task] = {}
    lost: list[Task] = []
    try:
        while True:
            free_slots = 0 if lost else max(workers.window() - len(pending), 0)
            for task in islice(tasks, free_slots):
                try:
                    pending[executor.submit(work, task)] = task
                except workers.losses:
                    lost.append(task)
            if not pending:
                return lost
            ready, _ = futures.wait(pending, TICK, futures.FIRST_COMPLETED)
            trouble = "" if ready else workers.trouble()
            if trouble:
                raise PolarisError(trouble)
            for future in ready:
                task = pending.pop(future)
                try:
                    result = future.result()
                except workers.losses:
                    lost.append(task)
                else:
                    store(task, result)
    finally:
        for future in pending:
            future.cancel()
        if workers.renewed:
            executor.shutdown(wait=False)


@contextmanager
def cluster(address: str) -> Iterator[Workers]:
    """Workers of a Dask cluster.

    Parameters
    ----------
    address : str
        Of its scheduler, ``tcp://host:port``.

    Raises
    ------
    ScenarioError
        If ``distributed`` is not installed, in a tested version, or no scheduler answers in a few seconds.
    """
    if reason := unusable("distributed"):
        raise ScenarioError("--scheduler", address, reason)
    import distributed

    if not re.fullmatch(r"\w+://[^\s/]+:\d+", address):
        raise ScenarioError("--scheduler", address, "must be an address like tcp://host:8786")
    with _unlogged():
        try:
            make: Any = distributed.Client
            client = make(address, timeout=PATIENCE, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            detail = " ".join(str(error).split())
            rule = f"no scheduler answers there within {PATIENCE:g} s ({detail})"
            raise ScenarioError("--scheduler", address, rule) from error
        crew = _Crew(client, address)
        loss_types = (BrokenExecutor, CancelledError, distributed.KilledWorker)
        try:
            yield Workers(crew.executor, crew.window, losses=loss_types, trouble=crew.trouble)
        finally:
            client.close(timeout=PATIENCE)


@contextmanager
def _unlogged() -> Iterator[None]:
    """Keep Dask's log of lost connections, tracebacks included, off the terminal: `Driver` tells."""
    loggers = [*logging.root.manager.loggerDict, *LOGGERS]
    names = dict.fromkeys(name for name in loggers if name.partition(".")[0] in LOGGERS)
    levels = {name: logging.getLogger(name).level for name in names}
    for name in names:
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for name, level in levels.items():
            logging.getLogger(name).setLevel(level)


@contextmanager
def _lost_scheduler(client: Any) -> Iterator[None]:
    """Raise `BrokenExecutor` instead of the errors of a client that has lost its scheduler, of any type."""
    try:
        yield
    except Exception as error:
        if client.status == "running" and not isinstance(error, OSError):
            raise
        raise BrokenExecutor("the scheduler is lost") from error


class _ClusterExecutor(Executor):
    """Dask's executor; it breaks when the scheduler is lost."""

    def __init__(self, client: Any) -> None:
        self.client, self.executor = client, client.get_executor(pure=False)

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Hand a call to the cluster."""
        with _lost_scheduler(self.client):
            future: Future[Any] = self.executor.submit(fn, *args, **kwargs)
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Cancel calls that have not ended; those of a lost scheduler are cancelled already."""
        with suppress(BrokenExecutor), _lost_scheduler(self.client):
            self.executor.shutdown(wait=wait)


class _Crew:
    """The workers of a cluster: how many threads they have, and since when there are none."""

    def __init__(self, client: Any, address: str) -> None:
        self.client, self.address, self.last_seen = client, address, time.monotonic()
        self.silence = f"the scheduler at {address} no longer answers"

    def executor(self) -> Any:
        """Return the cluster's executor, if its scheduler still answers."""
        if self.client.status != "running":
            raise PolarisError(self.silence)
        return _ClusterExecutor(self.client)

    def window(self) -> int:
        """Return how many tasks to hand out at a time, at most."""
        return AHEAD * max(self.threads(), 4)

    def threads(self) -> int:
        """Threads of all workers."""
        count = 0
        with suppress(BrokenExecutor), _lost_scheduler(self.client):  # the loss shows in the futures
            count = int(sum(self.client.nthreads().values()))
        if count:
            self.last_seen = time.monotonic()
        return count

    def trouble(self) -> str:
        """Describe a lost scheduler, or a cluster without workers for too long; empty if there are some."""
        if self.client.status == "closed":  # some futures never end then
            return self.silence
        if self.threads() or time.monotonic() - self.last_seen < DESERTED:
            return ""
        return f"the cluster at {self.address} has had no worker for {DESERTED:g} s"


def _prepare() -> None:
    """Prepare a new process: it ends quietly with ctrl-C, and never outlives the campaign."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    parent = multiprocessing.parent_process()
    assert parent is not None

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
