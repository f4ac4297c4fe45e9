"""Time per decision of the inspection filters, with compiled loops and without, and growth with deputies.

    python -m benchmarks.asif                     time per decision
    python -m benchmarks.asif --before PATH       beside another tree of this repository, as it was before
    python -m benchmarks.asif --monte-carlo 2000  the paper's Monte Carlo as well, on two processes

States are drawn inside the safe set; 50 deputies fly in a plane across the sun, where all constraints can
hold, or anywhere, where they cannot and programs have no solution. Desired inputs are at random within the
limits: nearly all calls solve programs. The bundled scenes are flown, and asked again what they answered.
Times are processor time from the call to the answer, margins by name included, the least of three for each:
what else the machine does hardly counts. Every tree and every way is timed in processes of its own, in turn.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from polaris.inspection.constraints.families import Families
from polaris.inspection.constraints.motion import SampledData
from polaris.inspection.filters.asif import ActiveSetFilter
from polaris.inspection.filters.explicit import make_filter
from polaris.inspection.flights.sampling import InitialConditions
from polaris.inspection.flights.simulation import FlightBatch, fly_one
from polaris.inspection.inspection import Inspection
from polaris.runs.campaign import local
from polaris.runs.inspections.monte_carlo import run_monte_carlo
from polaris.scenario.scenario import load_scenario

ROOT = Path(__file__).parents[1]


Row = tuple[int, str, bool, str]
"""Deputies, who filters, whether for sampled data, and from where: ``inside`` the safe set, ``anywhere``, or
along the flight of a bundled scene, whose name it is."""

ROWS: tuple[Row, ...] = (
    (1, "centralized", False, "inside"),
    *((5, sharing, False, "inside") for sharing in ("coasting", "half", "consensus", "centralized")),
    (1, "centralized", True, "inside"),
    (5, "centralized", True, "inside"),
    (5, "centralized", True, "inspection"),
    (5, "consensus", True, "inspection-decentralized"),
    (50, "coasting", False, "inside"),
    (50, "centralized", False, "inside"),
    (50, "coasting", False, "anywhere"),
    (50, "centralized", False, "anywhere"),
)


def time_filter(row: Row, calls: int, times: int) -> tuple[float, float, float]:
    """Median and 99th percentile [ms], share of calls that changed an input."""
    durations, changed = [], 0
    for asif, t, x, desired in _calls(row, calls):
        least = np.inf
        if not durations:  # what is read or made at first counts for nothing
            asif.filter(t, x, desired)
        for _ in range(times):
            asif.reset()
            start = time.thread_time()
            decision = asif.filter(t, x, desired)
            least = min(least, time.thread_time() - start)
        durations.append(least)
        changed += bool(decision.intervened.any())
    median, p99 = np.percentile(durations, [50, 99])
    return float(median * 1e3), float(p99 * 1e3), changed / calls


def _calls(row: Row, calls: int) -> Iterator[tuple[ActiveSetFilter, float, np.ndarray, np.ndarray]]:
    """Yield the calls to be timed: the filter, the time, the states, the desired inputs."""
    deputies, sharing, sampled, place = row
    if place not in ("inside", "anywhere"):
        yield from _along(place, calls)
        return
    inspection, rng = Inspection(deputies=deputies), np.random.default_rng(0)
    families = Families(inspection, sampled=SampledData(1.0) if sampled else None)
    asif = ActiveSetFilter(make_filter(families, sharing))
    x, sun = _states(inspection, 40)
    if place == "anywhere":
        x, sun = rng.uniform(-1, 1, x.shape) * ([600.0] * 3 + [0.3] * 3), rng.uniform(0, 2 * np.pi, 40)
    for k in range(calls):
        asif.sun_start = sun[k % 40]
        desired = rng.uniform(-1, 1, (deputies, 3))
        yield asif, 0.0, x[k % 40], desired


def _along(name: str, calls: int) -> Iterator[tuple[ActiveSetFilter, float, np.ndarray, np.ndarray]]:
    """Yield calls as `_calls` does, from all over the flight of a scene."""
    scenario: Any = load_scenario(name)
    (x, sun), flight = scenario.initial(), scenario.model.flight
    filtering = scenario.filter(scenario.model.filter, flight.period_s)
    times = flight.duration_s, flight.period_s
    run = fly_one(
        FlightBatch(scenario.inspection(), x[None], np.array([sun]), *times, scenario.primary()), filtering
    )
    asif = ActiveSetFilter(filtering, sun_start=float(sun))
    for k in np.linspace(0, len(run.u) - 1, calls).astype(int).tolist():
        yield asif, float(run.t[k]), run.x[k], run.desired[k]


def _states(inspection: Inspection, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Safe states: drawn; for many deputies, whose samples are never accepted, in a plane across the sun."""
    N = inspection.deputies
    if N <= 6:
        return InitialConditions(Families(inspection), seed=1).first(count)
    rng = np.random.default_rng(1)
    sun = rng.uniform(0, 2 * np.pi, count)
    grid = np.argwhere(np.ones((15, 15))) - 7.0
    grid = 90.0 * grid[np.argsort((grid**2).sum(axis=1), kind="stable")][1 : N + 1]
    across = np.stack([-np.sin(sun), np.cos(sun), np.zeros(count)], axis=1)[:, None]
    places = grid[:, :1] * across + grid[:, 1:] * np.array([0.0, 0.0, 1.0])
    x = np.concatenate([places, np.zeros_like(places)], axis=2)
    return x + rng.uniform(-1, 1, x.shape) * ([10.0] * 3 + [0.02] * 3), sun


def _timed(tree: Path, compiled: bool, row: Row, calls: int, times: int) -> list[float]:
    """`time_filter` in a process of its own, with the package of a tree."""
    single = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    environment = {**os.environ, **single, "PYTHONPATH": str(tree), "POLARIS_COMPILED": str(int(compiled))}
    command = [sys.executable, __file__, "--row", json.dumps([row, calls, times])]
    process = subprocess.run(command, env=environment, check=True, capture_output=True, text=True)
    return list(json.loads(process.stdout))


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--monte-carlo", type=int, default=0, metavar="RUNS")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--before", type=Path, metavar="PATH")
    parser.add_argument("--only", type=int, nargs="*", default=range(len(ROWS)), help="numbers of rows")
    parser.add_argument("--calls", type=int, default=300, help="per row; with 50 deputies a fifteenth")
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--row", type=json.loads, help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.row:
        print(json.dumps(time_filter(*options.row)))
        return
    modes = {"before": (options.before.resolve(), False)} if options.before else {}
    modes["NumPy"] = (ROOT, False)
    if find_spec("numba"):
        modes["compiled"] = (ROOT, True)
    first = next(iter(modes))
    head = "".join(f"{f'{mode} ms':>12} {'p99/median':>10}" for mode in modes)
    ratios = "".join(f"{f'{mode}/{first}':>17}" for mode in modes if mode != first)
    print(f"{'filter':28} {'N':>3}{head} {'changed':>8}{ratios}")
    for row in (ROWS[k] for k in options.only):
        # The machine's clock changes: all ways in turn, and the quickest of each.
        calls, turns, times = options.calls, options.turns, 3
        if row[0] > 5:
            calls = -(-calls // 15)
        if row[3] == "anywhere":
            calls, turns, times = min(calls, 3), 1, 1
        measured = [[_timed(*mode, row, calls, times) for mode in modes.values()] for _ in range(turns)]
        fastest = [min(timings) for timings in zip(*measured, strict=True)]
        times_text = "".join(f"{median:12.4f} {p99 / median:10.1f}" for median, p99, _ in fastest)
        ratios = "".join(f"{one[0] / fastest[0][0]:17.3f}" for one in fastest[1:])
        print(f"{_name(row):28} {row[0]:3d}{times_text} {fastest[-1][2]:8.0%}{ratios}", flush=True)
    if options.monte_carlo:
        _monte_carlo(options.monte_carlo, options.workers)


def _name(row: Row) -> str:
    """Return the name of a row in the table."""
    _, sharing, sampled, place = row
    if place not in ("inside", "anywhere"):
        return place
    return sharing + (", sampled-data" if sampled else "") + (", anywhere" if place == "anywhere" else "")


def _monte_carlo(runs: int, workers: int) -> None:
    scenario = load_scenario("inspection-monte-carlo").with_assignments([f"campaign.runs={runs}"])
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        summary = run_monte_carlo(Path(folder) / "c", scenario, executor=local(workers)).summary
    elapsed = time.perf_counter() - start
    print(f"{len(summary['studies'])} studies of {runs} runs in {elapsed:.1f} s on {workers} processes")
    for study in summary["studies"]:
        print(f"{study['name']:34} success {study['success_share']:.2%}")


if __name__ == "__main__":
    main()
