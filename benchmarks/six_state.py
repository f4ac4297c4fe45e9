"""Tube of the six-state case: a spacecraft's tracking error under a disturbance.

    python -m benchmarks.six_state [--json]

The error of an LQR tracker in Clohessy-Wiltshire coordinates starts within 5 m and 0.05 m/s per axis
and is disturbed by up to 1e-4 m/s^2 per axis for 3000 s. `ratio` is the worst half-width of the
enclosure of the interval that starts at 60, 150, 300 and 600 s over the exact half-width at that
time (a quadrature of the closed form, rounded down), `before` the same for the interval that ends
there; `between` compares every interval with what is exactly reached within it. `seconds` is the best of
several runs after one to warm up.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm, solve_continuous_are

import reach

Array = NDArray[np.float64]

MEAN_MOTION, MASS = 0.0012, 10.0  # rad/s, kg
HORIZON, INSTANTS = 3000.0, np.array([60.0, 150.0, 300.0, 600.0])  # s
RADII = np.array([5.0, 5.0, 5.0, 0.05, 0.05, 0.05])  # m, m/s
DISTURBANCE = 1e-4  # m/s^2 per axis
FINE, COARSE = 2.0, 30.0  # s
SAMPLES = 40_000


def closed_loop() -> tuple[Array, Array]:
    """Closed-loop matrix and disturbance map."""
    n = MEAN_MOTION
    A = np.zeros((6, 6))
    A[:3, 3:] = np.eye(3)
    A[3, 0], A[3, 4], A[4, 3], A[5, 2] = 3 * n**2, 2 * n, -2 * n, -(n**2)
    D = np.vstack([np.zeros((3, 3)), np.eye(3)])
    Q, R = np.diag([1.0, 1, 1, 1e3, 1e3, 1e3]), 1e4 * np.eye(3)
    B = D / MASS
    P = solve_continuous_are(A, B, Q, R)
    return A - B @ np.linalg.solve(R, B.T @ P), D


def exact(A: Array, D: Array, t: float) -> Array:
    """Half-widths of the exact reachable set at one time, from below: the midpoint rule per lag."""
    h = t / SAMPLES
    rows, filled, step = np.empty((SAMPLES, 6, 6)), 1, expm(A * h)
    rows[0] = expm(A * h / 2)
    while filled < SAMPLES:
        count = min(filled, SAMPLES - filled)
        rows[filled : filled + count] = rows[:count] @ step
        step, filled = step @ step, 2 * filled
    spread = np.abs(rows @ D).sum(axis=(0, 2)) * DISTURBANCE * h
    return np.abs(expm(A * t)) @ RADII + spread * (1 - 1e-6)


def measure(run: Callable[[], Any], repeats: int) -> tuple[Any, float]:
    """Result and best time of several runs."""
    result, best = run(), np.inf
    for _ in range(repeats):
        start = perf_counter()
        result = run()
        best = min(best, perf_counter() - start)
    return result, best


def main() -> None:
    """Print the figures, as a table or as JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="print JSON and nothing else")
    parser.add_argument("--repeats", type=int, default=20)
    options = parser.parse_args()
    A, D = closed_loop()
    w = np.full(3, DISTURBANCE)
    system = reach.LinearSystem(A, D, reach.Interval(-w, w))
    initial = reach.Interval(-RADII, RADII)
    truth = np.array([exact(A, D, t) for t in INSTANTS])
    makers: dict[str, Callable[[float], Any]] = {
        "support": lambda h: reach.support_tube(system, initial, HORIZON, np.eye(6), step=h),
        "zonotope": lambda h: reach.zonotope_tube(system, initial, HORIZON, step=h),
    }
    report: dict[str, Any] = {}
    for kind, make in makers.items():
        for name, h in (("", FINE), ("coarse_", COARSE)):
            tube, seconds = measure(lambda make=make, h=h: make(h), options.repeats)  # type: ignore[misc]
            width = tube.interval if kind == "support" else tube.intervals.half_widths
            k = np.searchsorted(tube.times, INSTANTS * (1 + 1e-12), side="right") - 1
            report.setdefault(kind, {}).update(
                {
                    f"{name}step_s": h,
                    f"{name}ratio": float((width[k] / truth).max()),
                    f"{name}before": float((width[k - 1] / truth).max()),
                    f"{name}seconds": seconds,
                }
            )
    report = {**report["support"], **{f"zonotope_{key}": value for key, value in report["zonotope"].items()}}
    if options.json:
        print(json.dumps(report, indent=2))
        return
    print(f"{'tube':10}{'step [s]':>10}{'ratio':>10}{'before':>10}{'ms':>10}")
    for kind in ("", "zonotope_"):
        for name in ("", "coarse_"):
            row = [report[f"{kind}{name}{key}"] for key in ("step_s", "ratio", "before", "seconds")]
            label = kind.rstrip("_") or "support"
            print(f"{label:10}{row[0]:10.0f}{row[1]:10.4f}{row[2]:10.3f}{1e3 * row[3]:10.2f}")


if __name__ == "__main__":
    main()
