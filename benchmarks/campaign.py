"""Runs per second of campaigns: one process, two, and a Dask cluster of two on the same work.

Least of several repeats, synthesis and start of the workers left out: a first campaign warms them up.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from polaris.runs.campaign import CampaignPlan, Workers, cluster, local, make_cases, run_campaign
from polaris.runs.campaign.workers import InProcess

BATCH = 250


@contextmanager
def pool(processes: int) -> Iterator[Workers]:
    """One pool that outlives the campaigns, as a cluster does."""
    executor = local(processes).make() if processes > 1 else InProcess()
    with executor:
        yield Workers(lambda: executor, lambda: 4 * processes, renewed=False)


@contextmanager
def dask(processes: int) -> Iterator[Workers]:
    """Yield a scheduler and single-threaded workers on this machine."""
    import socket

    import distributed

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address, host_options = f"tcp://127.0.0.1:{port}", ("--host", "127.0.0.1", "--no-dashboard")
    commands = [("dask_scheduler", "--port", str(port), *host_options)]
    commands += [("dask_worker", address, "--nthreads", "1", "--no-nanny", *host_options)] * processes
    running = [
        subprocess.Popen([sys.executable, "-m", f"distributed.cli.{name}", *rest], stderr=subprocess.DEVNULL)
        for name, *rest in commands
    ]
    try:
        with distributed.Client(address, timeout=120, set_as_default=False) as client:
            client.wait_for_workers(processes, timeout=120)
        with cluster(address) as workers:
            yield workers
    finally:
        for process in running:
            process.kill()
            process.wait()


def seconds(name: str, workers: Workers, runs: int, repeats: int) -> float:
    """Least time of a campaign on warm workers."""
    cases, durations = make_cases([name]), []
    with tempfile.TemporaryDirectory() as folder:
        for repeat in range(repeats + 1):
            start = time.perf_counter()
            plan = CampaignPlan(cases, runs, repeat, BATCH)
            run_campaign(plan, Path(folder) / str(repeat), executor=workers)
            durations.append(time.perf_counter() - start)
    return min(durations[1:])


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=2000)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--scenarios", nargs="+", default=["static", "dynamic"])
    options = parser.parse_args()
    kinds = {"1 process": pool(1), "2 processes": pool(2), "Dask, 2 workers": dask(2)}
    print(f"{options.runs} runs in batches of {BATCH}, least of {options.repeats}; runs per second (ratio)")
    print(f"{'scenario':<12}" + "".join(f"{kind:>24}" for kind in kinds))
    with ExitStack() as stack:
        workers = {kind: stack.enter_context(context) for kind, context in kinds.items()}
        for name in options.scenarios:
            rates = {
                kind: options.runs / seconds(name, one, options.runs, options.repeats)
                for kind, one in workers.items()
            }
            first = next(iter(rates.values()))
            print(
                f"{name:<12}" + "".join(f"{rate:>16.0f} ({rate / first:.2f})" for rate in rates.values()),
                flush=True,
            )


if __name__ == "__main__":
    main()
