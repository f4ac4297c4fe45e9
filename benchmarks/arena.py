"""Decision time of the online monitor against that of the filters, interleaved in one run.

    python -m benchmarks.arena [SCENARIO ...]

Every method decides on the states of one flight under the schedule, one run at a time, and the methods take
turns at each state, so that whatever else the machine does falls on all of them. The ratio is the median of
the other method over that of the monitor.
"""

import sys
import time

import numpy as np

from polaris.rta.decision_grid import DecisionGrid
from polaris.rta.flight import Conditions, fly
from polaris.rta.method import Observation
from polaris.rta.methods import METHODS
from polaris.rta.methods.fixed import PrecomputedSchedule
from polaris.scenario.scenario import load_scenario
from polaris.synthesis.schedule.synthesize import synthesize

TIMED = ("monitor", "monitor_declared", "simplex_explicit", "asif_explicit", "asif_implicit")
WARM = 20


def decisions(scene):
    """Yield the data of every decision of a flight under the schedule."""
    flight = fly(scene, PrecomputedSchedule(scene), Conditions.draw(scene, 1, 0))
    for k in range(scene.decisions):
        x = flight.states[:, k * scene.nodes]
        mode = flight.modes[:, max(k * scene.nodes - 1, 0)]
        yield Observation(k, x, scene.clipped(1, k * scene.nodes, x), mode)


def main(names):
    for name in names:
        scene = DecisionGrid.from_schedule(synthesize(load_scenario(name)))
        methods = {key: METHODS[key](scene) for key in TIMED}
        observations = list(decisions(scene))
        durations = {key: np.empty(len(observations)) for key in TIMED}
        for method in methods.values():
            method.start(1)
            for one in observations[:WARM]:
                method.decide(one)
        for i, one in enumerate(observations):
            for key, method in methods.items():
                start = time.perf_counter()
                method.decide(one)
                durations[key][i] = time.perf_counter() - start
        baseline = np.median(durations["monitor"])
        limits = len(methods["monitor"].recovery.matrix)
        print(f"{name}: {len(observations)} decisions every {scene.period:g} s, {limits} limits")
        print(f"  {'method':18} {'median us':>10} {'p99 us':>10} {'least us':>10} {'ratio':>7}")
        for key, times in durations.items():
            median, p99 = 1e6 * np.median(times), 1e6 * np.percentile(times, 99)
            ratio, least = np.median(times) / baseline, 1e6 * times.min()
            print(f"  {key:18} {median:10.1f} {p99:10.1f} {least:10.1f} {ratio:7.1f}")


if __name__ == "__main__":
    main(sys.argv[1:] or ["static", "dynamic", "robot"])
