"""Electro-mechanical brake with a sampled controller (BRKDC01, BRKNC01, BRKNP01).

A PI controller that samples every 0.1 ms drives the calliper of a brake to x0 = 0.05, and x stays below
x0 for the 0.1 s shown. DC: an exact clock. NC: every period is off by -1e-8 to 1e-7 s. NP: in addition a
coefficient is only known to be 504 +- 3; it may vary in time here, which holds more than a constant.

Strathmann and Oehlerking, "Verifying properties of an electro-mechanical braking system" (ARCH 2014),
in the form of the ARCH-COMP reports on linear continuous dynamics. State: current I, position x,
sampled error xe, integrated error xc.

The unknown coefficient is an input |v| <= 3 |I|, with |I| replaced by a bound per stretch of time. The
tube keeps that bound, so no trajectory can be the first to exceed it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from time import perf_counter

import numpy as np

from benchmarks.arch.row import Row
from reach import (
    Always,
    HPolytope,
    HybridAutomaton,
    HybridOptions,
    Interval,
    LinearSystem,
    Mode,
    Transition,
    Zonotope,
    simulate_hybrid,
    verify_hybrid,
)

HORIZON, PERIOD = 0.1, 1e-4
TARGET = 0.05
INDUCTANCE, RESISTANCE, TORQUE, FRICTION, GEAR = 1e-3, 0.5, 0.02, 0.1, 113.1167
PROPORTIONAL, INTEGRAL = 10000.0, 1000.0
A = np.zeros((4, 4))
A[0] = [
    -(RESISTANCE + TORQUE**2 / FRICTION) / INDUCTANCE,
    0.0,
    PROPORTIONAL / INDUCTANCE,
    INTEGRAL / INDUCTANCE,
]
A[1, 0] = TORQUE / GEAR / FRICTION
SAMPLE = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, -1, 0, 0], [0, -PERIOD, 0, 1]])
OFFSET = np.array([0, 0, TARGET, PERIOD * TARGET])

JITTER = {"BRKDC01": (0.0, 0.0), "BRKNC01": (-1e-8, 1e-7), "BRKNP01": (-1e-8, 1e-7)}
VARIATION = {"BRKDC01": 0.0, "BRKNC01": 0.0, "BRKNP01": 3.0}
PHASES = 25
"""Stretches of time with a bound on the current of their own."""
JUMPS = 1020
CURRENT, POSITION = np.eye(4)[[0]], np.eye(4)[[1]]


def automaton(name: str) -> tuple[HybridAutomaton, list[float]]:
    """One mode per stretch of time, and the bound on the current in each that is to be kept."""
    low, high = (PERIOD + j for j in JITTER[name])
    count = PHASES if VARIATION[name] else 1
    end_times = [HORIZON * (k + 1) / count for k in range(count)]
    bounds = currents(end_times, VARIATION[name])
    modes, transitions = [], []
    for k, end in enumerate(end_times):
        push = VARIATION[name] * bounds[k]
        system = LinearSystem(A, np.eye(4)[:, [0]], Interval([-push], [push])) if push else LinearSystem(A)
        modes.append(Mode(f"phase {k}", system))
        begin, last = HORIZON * k / count, k + 1 == count
        for source in range(max(k - 1, 0), k + 1):
            transitions.append(
                Transition(
                    f"phase {source}",
                    f"phase {k}",
                    dwell=(low, high),
                    window=(begin, 2 * HORIZON if last else end),
                    R=SAMPLE,
                    r=OFFSET,
                    urgent=source < k or last,
                )
            )
    return HybridAutomaton(modes, transitions), bounds


def currents(end_times: list[float], variation: float) -> list[float]:
    """Guessed bounds on the current: what an exact clock and coefficient reach, and room to spare."""
    clock = HybridAutomaton(
        [Mode("brake", LinearSystem(A))],
        [Transition("brake", "brake", dwell=(PERIOD, PERIOD), R=SAMPLE, r=OFFSET, urgent=True)],
    )
    path = simulate_hybrid(clock, np.zeros(4), HORIZON, dt=PERIOD, jumps=JUMPS)
    t = np.concatenate([visit.times for visit in path.visits])
    current = np.abs(np.concatenate([visit.states[:, 0] for visit in path.visits]))
    bounds = []
    for begin, end in zip([0.0, *end_times[:-1]], end_times, strict=True):
        window = (t >= begin - 3 * PERIOD) & (t <= end + 3 * PERIOD)
        bounds.append(float(current[window].max()) * (1 + 0.06 * variation))
    return bounds


def rows(instances: Iterable[str] = tuple(JITTER)) -> Iterator[Row]:
    """Verify the instances one after the other."""
    for name in instances:
        yield run(name)


def run(name: str) -> Row:
    """Verify one instance."""
    model, bounds = automaton(name)
    sides = np.vstack([CURRENT, -CURRENT])
    specs = {mode.name: [Always(HPolytope(POSITION, [TARGET]))] for mode in model.modes}
    for mode, bound in zip(model.modes, bounds, strict=True):
        if VARIATION[name]:
            specs[mode.name].append(Always(HPolytope(sides, [bound, bound])))
    rest = Zonotope.point(np.zeros(4))
    start = perf_counter()
    verdict = verify_hybrid(
        model,
        rest,
        specs,
        HORIZON,
        HybridOptions(step=2 * PERIOD, order=6, clusters=1, reduction="girard", jumps=JUMPS),
        dt=PERIOD,
        runs=0,
    )
    seconds = perf_counter() - start
    assert verdict.tube is not None
    top = max(float(segment.support(POSITION)[0]) for segment in verdict.tube.segments)
    path = simulate_hybrid(model, rest.c, HORIZON, dt=PERIOD, jumps=JUMPS)
    reached = max(float(visit.states[:, 1].max()) for visit in path.visits)
    status = "proven" if verdict else "unknown"
    note = f"largest position; shown up to {HORIZON:g} s" if verdict else verdict.reason
    return Row("brake", name, status, "proven", top, TARGET, reached, seconds, note)
