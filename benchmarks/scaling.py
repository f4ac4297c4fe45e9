"""Time and memory of tubes against the number of states and of steps.

    python -m benchmarks.scaling [--quick] [--json]

Every case runs in a process of its own. Chains of damped masses between springs, the first and the
last fixed, each pushed by an unknown force; positions within 1 of rest at the start. `support` bounds
two rows (the first and the middle mass), `zonotope` encloses all states; `sparse` takes the sparse
matrix instead of the dense one. `seconds` is the tube alone, the first call (nothing warm but the
imports), on one thread; `MB` what the process took at its most beyond what it took before. `gap` is
the largest distance of bound and attained value at a node, relative to the bound. `polytope` gives
the set of the forces by inequalities; `filled` and `full` are the sparse and the dense container of
one random matrix, half of whose entries are not zero, over a twentieth of the time.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from time import perf_counter

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy import sparse

import reach

HORIZON = 20.0
STATES = (6, 20, 60, 200, 600, 1000)
STEPS = (100, 1_000, 10_000, 100_000)
FIXED_STEPS, FIXED_STATES = 1_000, 6


def chain(n: int, dense: bool) -> tuple[reach.LinearSystem, reach.Interval]:
    """Return a chain of n / 2 masses."""
    m = n // 2
    K = sparse.diags([np.ones(m - 1), -2 * np.ones(m), np.ones(m - 1)], [-1, 0, 1])
    A = sparse.bmat([[None, sparse.identity(m)], [K, 0.1 * K]], format="csr")
    B = sparse.vstack([sparse.csr_matrix((m, m)), sparse.identity(m)], format="csr")
    U = reach.Interval(np.full(m, -0.1), np.full(m, 0.1))
    start = reach.Interval(np.r_[-np.ones(m), np.zeros(m)], np.r_[np.ones(m), np.zeros(m)])
    system = reach.LinearSystem(A.toarray(), B.toarray(), U) if dense else reach.LinearSystem(A, B, U)
    return system, start


def filled(n: int, dense: bool) -> tuple[reach.LinearSystem, reach.Interval]:
    """Return a random matrix of norm about one, half of its entries not zero."""
    rng = np.random.default_rng(0)
    A = rng.normal(size=(n, n)) * (rng.random((n, n)) < 0.5) / np.sqrt(n / 2) - np.eye(n)
    U = reach.Interval(np.full(2, -1.0), np.full(2, 1.0))
    start = reach.Interval(-np.ones(n), np.ones(n))
    return reach.LinearSystem(A if dense else sparse.csr_matrix(A), np.eye(n)[:, :2], U), start


def settling() -> float:
    """Return the most memory that this process has had, in MB."""
    size = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return size / (2**20 if sys.platform == "darwin" else 2**10)


def case(kind: str, n: int, steps: int) -> dict[str, float | int | str]:
    """One tube, in this process."""
    system, start = filled(n, kind == "full") if kind in ("filled", "full") else chain(n, kind != "sparse")
    if kind == "polytope":
        system = reach.LinearSystem(system.A, system.B, system.U[0].to_polytope())
    horizon = HORIZON / 20 if kind in ("filled", "full") else HORIZON
    rows = np.zeros((2, n))
    rows[0, 0] = rows[1, n // 4] = 1.0
    reach.support_tube(*chain(2, dense=True), 1.0, [[1.0, 0.0]], step=0.5)  # imports
    before, start_time = settling(), perf_counter()
    gap = float("nan")
    if kind == "zonotope":
        reach.zonotope_tube(system, start, horizon, step=horizon / steps)
    else:
        tube = reach.support_tube(system, start, horizon, rows, step=horizon / steps)
        gap = float(np.max((tube.upper - tube.attained) / tube.upper))
    seconds = perf_counter() - start_time
    return {
        "tube": kind,
        "states": n,
        "steps": steps,
        "seconds": seconds,
        "MB": settling() - before,
        "gap": gap,
    }


def cases(quick: bool) -> list[tuple[str, int, int]]:
    """Kinds, states and steps; a zonotope tube keeps a matrix per step, so it has fewer."""
    jobs = [(kind, n, FIXED_STEPS) for n in STATES for kind in ("support", "sparse", "zonotope")]
    jobs += [(kind, FIXED_STATES, k) for k in STEPS for kind in ("support", "zonotope") if k != FIXED_STEPS]
    jobs = [(kind, n, 100 if kind == "zonotope" and n > 200 else k) for kind, n, k in jobs]
    jobs += [("polytope", FIXED_STATES, FIXED_STEPS), ("filled", 400, 100), ("full", 400, 100)]
    return [one for one in jobs if not quick or one[1] * one[2] <= 60_000]


def main() -> None:
    """Print the table, or a JSON object per line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="small cases only")
    parser.add_argument("--json", action="store_true", help="one JSON object per line")
    options = parser.parse_args()
    table = Table(title=f"Tubes of chains of masses over {HORIZON:g} s")
    for name in ("tube", "states", "steps", "seconds", "MB", "gap"):
        table.add_column(name, justify="left" if name == "tube" else "right")
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"  # for the processes started below
    for kind, n, steps in cases(options.quick):
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            figures = pool.submit(case, kind, n, steps).result()
        if options.json:
            print(json.dumps(figures), flush=True)
        gap = "" if kind == "zonotope" else f"{figures['gap']:.1e}"
        table.add_row(kind, f"{n}", f"{steps:,}", f"{figures['seconds']:.3f}", f"{figures['MB']:.0f}", gap)
    if not options.json:
        Console(width=90).print(table)


if __name__ == "__main__":
    main()
