"""Time per decision of the online monitor in flight.

    python -m benchmarks.monitor                   bundled scenarios
    python -m benchmarks.monitor static --turns 50

One flight of U under random disturbances and errors is decided over and over: the bare condition, the whole
step with all checks of measurement, clock and history, and the step with its log line. Two numbers each:
median and 99th percentile over the decisions of a block, then the median over all blocks and, as the machine
may be busy with other things, the best block.
"""

from __future__ import annotations

import argparse
import io
import time
from collections.abc import Callable

import numpy as np

from polaris.rta.decision_grid import DecisionGrid
from polaris.rta.flight import Conditions, fly
from polaris.rta.methods.fixed import SafetyAlone
from polaris.rta.methods.monitor import Monitor
from polaris.rta.online.decision_log import DecisionLog
from polaris.rta.online.estimate import Measurement
from polaris.rta.online.runtime import OnlineMonitor
from polaris.scenario.scenario import load_scenario
from polaris.synthesis.schedule.synthesize import synthesize

BLOCK = 300
"""Decisions per block."""


def blocks(factory: Callable[[], Callable[[int], object]], turns: int) -> np.ndarray:
    """Median and 99th percentile of every block [us], shape (turns, 2)."""
    quantiles, durations = np.empty((turns, 2)), np.empty(BLOCK)
    for turn in range(turns):
        decide = factory()
        for k in range(BLOCK):
            start = time.perf_counter()
            decide(k)
            durations[k] = time.perf_counter() - start
        quantiles[turn] = np.percentile(durations, [50, 99]) * 1e6
    return quantiles


def ways(monitor: Monitor) -> dict[str, Callable[[], Callable[[int], object]]]:
    """Return the timed calls by name; each makes a new decider that is asked for k = 0, 1 ... in turn."""
    scene = monitor.grid
    conditions = Conditions.draw(scene, 2, 0).only(1)
    flight = fly(scene, SafetyAlone(scene), conditions)
    estimates = flight.states[0, :: scene.nodes][: len(conditions.errors)] + conditions.errors[:, 0]
    errors = estimates - scene.xi[: len(estimates) * scene.nodes : scene.nodes]
    calls = [(k * scene.period, Measurement(k * scene.period, x)) for k, x in enumerate(estimates)]
    inputs = [None, *flight.inputs[0, :: scene.nodes]]

    def bare() -> Callable[[int], object]:
        return lambda k: monitor.judge_one(k, errors[k], 1)

    def step(log: DecisionLog | None = None, with_input: bool = False) -> Callable[[int], object]:
        online = OnlineMonitor(monitor, log=log)
        return lambda k: online.step(*calls[k], inputs[k] if with_input else None)

    return {
        "judge_one": bare,
        "step": step,
        "step, input known": lambda: step(with_input=True),
        "step and log": lambda: step(DecisionLog(io.StringIO())),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("scenarios", nargs="*", default=["static", "robot"])
    parser.add_argument("--turns", type=int, default=30, help="blocks of 300 decisions each")
    arguments = parser.parse_args()
    print(f"{'[us]':10}{'':20}{'median':>10}{'p99':>10}{'best':>12}{'p99':>10}")
    for name in arguments.scenarios:
        monitor = Monitor(DecisionGrid.from_schedule(synthesize(load_scenario(name)), half_widths=0.005))
        for label, factory in ways(monitor).items():
            times = blocks(factory, arguments.turns)
            middle, best = np.median(times, axis=0), times.min(axis=0)
            print(f"{name:10}{label:20}{middle[0]:10.1f}{middle[1]:10.1f}{best[0]:12.1f}{best[1]:10.1f}")


if __name__ == "__main__":
    main()
