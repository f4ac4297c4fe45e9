"""Time per call of the inspection filters, and growth with the number of deputies.

    python -m benchmarks.asif                     time per call
    python -m benchmarks.asif --monte-carlo 2000  the paper's Monte Carlo as well, on two processes

States are drawn inside the safe set; with more than six deputies anywhere, hardly one of them safe, so that
many programs have no solution. Desired inputs are at random within the limits: nearly all calls solve
programs. Times are from the call to the answer, margins by name included.
"""

from __future__ import annotations

import argparse
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


def time_filter(deputies: int, sharing: str, sampled: bool, calls: int = 2000) -> tuple[float, float, float]:
    """Median and 99th percentile [ms], share of calls that changed an input."""
    inspection = Inspection(deputies=deputies)
    many = 40 if deputies <= 6 else 4
    x, sun = _states(inspection, many)
    rng = np.random.default_rng(0)
    families = Families(inspection, sampled=SampledData(1.0) if sampled else None)
    asif = ActiveSetFilter(make_filter(families, sharing))
    spent, changed = [], 0
    for k in range(calls):
        which = k % many
        asif.reset()
        asif.sun_start = sun[which]
        desired = rng.uniform(-1, 1, (deputies, 3))
        begun = time.perf_counter()
        decision = asif.filter(0.0, x[which], desired)
        spent.append(time.perf_counter() - begun)
        changed += bool(decision.intervened.any())
    median, p99 = np.percentile(spent, [50, 99])
    return median * 1e3, p99 * 1e3, changed / calls


def _states(inspection: Inspection, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Safe states; for many deputies, where samples are never accepted, slow ones anywhere."""
    if inspection.deputies <= 6:
        x, sun = InitialConditions(Families(inspection), seed=1).first(count)
        return x, sun
    rng = np.random.default_rng(1)
    x = np.zeros((count, inspection.deputies, 6))
    x[..., :3] = rng.uniform(-500, 500, x[..., :3].shape)
    x[..., 3:] = rng.uniform(-0.05, 0.05, x[..., :3].shape)
    return x, rng.uniform(0, 2 * np.pi, count)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--monte-carlo", type=int, default=0, metavar="RUNS")
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args()
    print(f"{'filter':34} {'N':>3} {'median ms':>10} {'p99 ms':>8} {'changed':>8}")
    rows = [(1, "centralized", False), *((5, s, False) for s in ("coasting", "half", "consensus"))]
    rows += [(5, "centralized", False), (5, "centralized", True)]
    rows += [(n, s, False) for n in (2, 10, 15, 20) for s in ("coasting", "centralized")]
    for deputies, sharing, sampled in rows:
        median, p99, changed = time_filter(deputies, sharing, sampled, 2000 if deputies <= 5 else 500)
        name = sharing + (", sampled-data" if sampled else "")
        name = name if sharing == "centralized" else f"decentralized, {name}"
        print(f"{name:34} {deputies:3d} {median:10.3f} {p99:8.3f} {changed:8.0%}")
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
