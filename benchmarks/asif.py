"""Time per decision of the inspection filters, with compiled loops and without, and growth with deputies.

    python -m benchmarks.asif                     time per decision
    python -m benchmarks.asif --before PATH       beside another tree of this repository, as it was before
    python -m benchmarks.asif --monte-carlo 2000  the paper's Monte Carlo as well, on two processes

States are drawn inside the safe set; 50 deputies fly in a plane across the sun, where all constraints can
hold. Desired inputs are at random within the limits: nearly all calls solve programs. Times are processor
time from the call to the answer, margins by name included, the least of three for each: what else the
machine does hardly counts. Every tree and every way is timed in processes of its own, in turn, thrice.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from polaris.inspection.constraints.families import Families
from polaris.inspection.constraints.motion import SampledData
from polaris.inspection.filters.asif import ActiveSetFilter
from polaris.inspection.filters.explicit import make_filter
from polaris.inspection.flights.sampling import InitialConditions
from polaris.inspection.inspection import Inspection
from polaris.runs.campaign import local
from polaris.runs.monte_carlo import run_monte_carlo
from polaris.scenario.scenario import load_scenario

ROOT = Path(__file__).parents[1]


def time_filter(deputies: int, sharing: str, sampled: bool, calls: int = 1000) -> tuple[float, float, float]:
    """Median and 99th percentile [ms], share of calls that changed an input."""
    inspection = Inspection(deputies=deputies)
    x, sun = _states(inspection, 40)
    rng = np.random.default_rng(0)
    families = Families(inspection, sampled=SampledData(1.0) if sampled else None)
    asif = ActiveSetFilter(make_filter(families, sharing))
    spent, changed = [], 0
    for k in range(-5, calls):
        which = k % len(x)
        asif.sun_start = sun[which]
        desired, least = rng.uniform(-1, 1, (deputies, 3)), np.inf
        for _ in range(3):
            asif.reset()
            begun = time.thread_time()
            decision = asif.filter(0.0, x[which], desired)
            least = min(least, time.thread_time() - begun)
        if k >= 0:
            spent.append(least)
            changed += bool(decision.intervened.any())
    median, p99 = np.percentile(spent, [50, 99])
    return float(median * 1e3), float(p99 * 1e3), changed / calls


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


def _timed(tree: Path, compiled: bool, row: tuple[int, str, bool], calls: int) -> list[float]:
    """`time_filter` in a process of its own, with the package of a tree."""
    single = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    there = {**os.environ, **single, "PYTHONPATH": str(tree), "POLARIS_COMPILED": str(int(compiled))}
    command = [sys.executable, __file__, "--row", json.dumps([*row, calls])]
    answer = subprocess.run(command, env=there, check=True, capture_output=True, text=True)
    return list(json.loads(answer.stdout))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--monte-carlo", type=int, default=0, metavar="RUNS")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--before", type=Path, metavar="PATH")
    parser.add_argument("--row", type=json.loads, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.row:
        print(json.dumps(time_filter(*arguments.row)))
        return
    ways = {"NumPy": (ROOT, False), "compiled": (ROOT, True)}
    if arguments.before:
        ways = {"before": (arguments.before.resolve(), False), **ways}
    first = next(iter(ways))
    head = "".join(f"{f'{way} ms':>12} {'p99/median':>10}" for way in ways)
    ratios = "".join(f"{f'{way}/{first}':>17}" for way in ways if way != first)
    print(f"{'filter':28} {'N':>3}{head} {'changed':>8}{ratios}")
    rows = [(1, "centralized", False), *((5, s, False) for s in ("coasting", "half", "consensus"))]
    rows += [(5, "centralized", False), (5, "centralized", True)]
    rows += [(50, s, False) for s in ("coasting", "centralized")]
    for row in rows:
        calls = 300 if row[0] <= 5 else 20
        # The machine's clock changes: all ways in turn, three times, and the quickest of each.
        turns = [[_timed(*way, row, calls) for way in ways.values()] for _ in range(3)]
        found = [min(of_way) for of_way in zip(*turns, strict=True)]
        name = row[1] + (", sampled-data" if row[2] else "")
        times = "".join(f"{median:12.4f} {p99 / median:10.1f}" for median, p99, _ in found)
        ratios = "".join(f"{one[0] / found[0][0]:17.3f}" for one in found[1:])
        print(f"{name:28} {row[0]:3d}{times} {found[-1][2]:8.0%}{ratios}", flush=True)
    if arguments.monte_carlo:
        _monte_carlo(arguments.monte_carlo, arguments.workers)


def _monte_carlo(runs: int, workers: int) -> None:
    scenario = load_scenario("inspection-monte-carlo").with_assignments([f"campaign.runs={runs}"])
    begun = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        summary = run_monte_carlo(Path(folder) / "c", scenario, executor=local(workers)).summary
    spent = time.perf_counter() - begun
    print(f"{len(summary['studies'])} studies of {runs} runs in {spent:.1f} s on {workers} processes")
    for study in summary["studies"]:
        print(f"{study['name']:34} success {study['success_share']:.2%}")


if __name__ == "__main__":
    main()
