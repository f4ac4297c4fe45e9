"""Campaigns on a real Dask scheduler with two worker processes, one of which is killed."""

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from concurrent.futures import BrokenExecutor
from contextlib import nullcontext
from pathlib import Path

import pytest

from polaris.model.errors import PolarisError, ScenarioError
from polaris.runs.campaign import cluster
from tests.polaris.runs.campaign.scene import await_parts, fly, table

distributed = pytest.importorskip("distributed")
ROOT = Path(__file__).parents[4]


def start(*arguments):
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.Popen([sys.executable, "-m", *arguments], env=environment, **quiet)


@pytest.fixture
def nodes():
    """Address of a scheduler, and its process and those of two workers."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    options = ("--host", "127.0.0.1", "--no-dashboard")
    processes = [start("distributed.cli.dask_scheduler", "--port", str(port), *options)]
    # No nanny: what is killed here stays dead.
    worker = ("distributed.cli.dask_worker", address, "--nthreads", "1", "--no-nanny", *options)
    processes += [start(*worker), start(*worker)]
    try:
        with distributed.Client(address, timeout=120, set_as_default=False) as client:
            client.wait_for_workers(2, timeout=120)
        yield address, processes
    finally:
        for process in processes:
            process.kill()
            process.wait()


def test_a_cluster_without_workers_is_told_and_goes_on_with_some(flown, tmp_path, monkeypatch):
    monkeypatch.setattr("polaris.runs.campaign.workers.DESERTED", 1.5)
    monkeypatch.setattr("polaris.runs.campaign.workers.TICK", 0.2)
    options = {"processes": False, "protocol": "tcp", "host": "127.0.0.1", "dashboard_address": None}
    with distributed.LocalCluster(n_workers=0, **options) as dask:
        pattern = r"has had no worker for 1\.5 s; 0 runs are kept in .*the same command goes on"
        with cluster(dask.scheduler_address) as crew, pytest.raises(PolarisError, match=pattern):
            fly(tmp_path / "c", crew)
        assert table(tmp_path / "c") == {}
        dask.scale(1)
        with cluster(dask.scheduler_address) as crew:
            assert table(fly(tmp_path / "c", crew).path) == table(flown.path)


def test_a_scheduler_lost_at_any_time_breaks_the_executor_and_says_nothing_more(capfd):
    options = {"processes": False, "protocol": "tcp", "host": "127.0.0.1", "dashboard_address": None}
    with distributed.LocalCluster(n_workers=1, **options) as dask, cluster(dask.scheduler_address) as crew:
        executor = crew.make()
        pending = executor.submit(time.sleep, 1.0)
        executor.client.close()
        with pytest.raises(BrokenExecutor, match="scheduler is lost"):
            executor.submit(sum, (1, 2))
        pending.cancel()
        executor.shutdown(wait=False)
        assert crew.window() > 0 and "no longer answers" in crew.trouble()
        with pytest.raises(PolarisError, match="no longer answers"):
            crew.make()
    assert capfd.readouterr() == ("", "")


def test_addresses_where_no_scheduler_is_are_refused(monkeypatch):
    monkeypatch.setattr("polaris.runs.campaign.workers.PATIENCE", 0.2)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
        with pytest.raises(ScenarioError, match="no scheduler answers there"), cluster(address):
            pass
    for wrong in ("here", "127.0.0.1:8786", "tcp://127.0.0.1"):
        with pytest.raises(ScenarioError, match="address like"), cluster(wrong):
            pass


@pytest.mark.slow
@pytest.mark.parametrize("victim", ["worker", "scheduler"])
def test_what_is_killed_in_mid_run_loses_nothing_and_counts_nothing_twice(
    flown, nodes, tmp_path, victim, capfd
):
    address, (scheduler, _, worker) = nodes
    out, killed = tmp_path / "c", worker if victim == "worker" else scheduler

    def kill():
        await_parts(out, 1)
        killed.send_signal(signal.SIGKILL)

    killer = threading.Thread(target=kill)
    killer.start()
    pattern = r"(no longer answers|lost).* runs are kept in .*the same command goes on"
    expected = nullcontext() if victim == "worker" else pytest.raises(PolarisError, match=pattern)
    with expected, cluster(address) as crew:
        fly(out, crew)
    killer.join()
    assert killed.wait() == -signal.SIGKILL
    if victim == "scheduler":
        assert capfd.readouterr() == ("", "")  # no traceback of Dask's
        assert table(out).items() < table(flown.path).items()
        fly(out)
    assert table(out) == table(flown.path)
