"""Powertrain with backlash and rotating masses (DTN, theta = 1, 2, 22).

A motor drives a load through a gearbox with backlash and a chain of theta rotating masses; a PID
controller makes it accelerate. The shaft hangs on one side of the gap at first, swings through the
dead zone and hits the other side. What is asked for is a tight enclosure, and that after the switching
every trajectory is in contact.

Althoff and Krogh, "Avoiding geometric intersection operations in reachability analysis of hybrid
systems" (HSCC 2012), in the form of the ARCH-COMP reports on linear continuous dynamics (moments of
inertia of the masses as in its SpaceEx model; like there, no way back from contact to the dead zone).
State: twist x1 [rad], motor torque x2, x3 and x4 requested angle and speed, x5 and x6 load, x7 motor
speed, then angle and speed of every mass.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from benchmarks.arch.row import Row
from reach import (
    HPolytope,
    HybridAutomaton,
    HybridOptions,
    LinearSystem,
    Mode,
    Never,
    Transition,
    Zonotope,
    simulate_hybrid,
    verify_hybrid,
)

Array = NDArray[np.float64]

HORIZON, TURN = 2.0, 0.2  # s; the requested torque changes its sign at the second
GAP = 0.03  # half of the backlash, rad
ENGINE, RATIO, TORQUE = 0.1, 12.0, 5.0  # time constant, gear ratio, requested acceleration
LOAD, MOTOR, MASS = 140.0, 0.3, 100.0  # moments of inertia, kg m^2
FRICTION_LOAD, FRICTION_MOTOR, FRICTION_MASS = 5.6, 0.0, 1.0
STIFF, SHAFT = 1e5, 1e4  # of the chain and of the shaft, N m/rad
PROPORTIONAL, INTEGRAL, DERIVATIVE = 0.5, 0.5, 0.5


def system(theta: int, shaft: float, gap: float, torque: float) -> LinearSystem:
    """Motion with a shaft of some stiffness, in contact at one side of the gap."""
    n = 2 * theta + 7
    A, c = np.zeros((n, n)), np.zeros(n)
    twist, engine, angle, speed, load, load_speed, motor, first = range(8)
    A[twist, motor], A[twist, first + 1] = 1 / RATIO, -1.0
    A[engine, twist] = -INTEGRAL * RATIO + DERIVATIVE * shaft / (RATIO * MOTOR)
    A[engine, engine] = -DERIVATIVE / MOTOR - 1
    A[engine, angle], A[engine, speed] = INTEGRAL * RATIO, PROPORTIONAL * RATIO
    A[engine, motor] = -PROPORTIONAL + DERIVATIVE * FRICTION_MOTOR / MOTOR
    A[engine, first] = -INTEGRAL * RATIO
    c[engine] = DERIVATIVE * (RATIO * torque - shaft * gap / (MOTOR * RATIO))
    A[engine] /= ENGINE
    c[engine] /= ENGINE
    A[angle, speed], c[speed] = 1.0, torque
    A[motor, [twist, engine, motor]] = -shaft / (MOTOR * RATIO), 1 / MOTOR, -FRICTION_MOTOR / MOTOR
    c[motor] = shaft * gap / (MOTOR * RATIO)
    A[load, load_speed] = 1.0
    A[load_speed, [load, n - 2]] = np.array([-STIFF, STIFF]) / LOAD
    A[load_speed, load_speed] = -FRICTION_LOAD / LOAD
    chain = [*range(first, n, 2), load]  # angles from the gear to the load
    for node, next_node in zip(chain[:-1], chain[1:], strict=True):
        A[node, node + 1] = 1.0
        A[node + 1, node] -= STIFF / MASS
        A[node + 1, next_node] += STIFF / MASS
        A[node + 1, node + 1] = -FRICTION_MASS / MASS
    for last_node, node in zip(chain[:-2], chain[1:-1], strict=True):
        A[node + 1, node] -= STIFF / MASS
        A[node + 1, last_node] += STIFF / MASS
    A[first + 1, twist] = shaft / MASS
    c[first + 1] = -shaft * gap / MASS
    return LinearSystem(A, c=c)


def automaton(theta: int) -> HybridAutomaton:
    """Contact at the negative side (two torques), the dead zone, contact at the positive side."""
    n = 2 * theta + 7
    low, high = -np.eye(n)[[0]], np.eye(n)[[0]]
    modes = [
        Mode("turning", system(theta, SHAFT, -GAP, -TORQUE)),
        Mode("negative", system(theta, SHAFT, -GAP, TORQUE), HPolytope(high, [-GAP])),
        Mode("dead zone", system(theta, 0.0, -GAP, TORQUE), HPolytope(np.vstack([low, high]), [GAP, GAP])),
        Mode("positive", system(theta, SHAFT, GAP, TORQUE), HPolytope(low, [-GAP])),
    ]
    transitions = [
        Transition("turning", "negative", window=(TURN, TURN), urgent=True),
        Transition("negative", "dead zone", guard=HPolytope(low, [GAP])),
        Transition("dead zone", "positive", guard=HPolytope(low, [-GAP])),
    ]
    return HybridAutomaton(modes, transitions)


def initial(theta: int) -> Zonotope:
    """Return a line segment of states."""
    c = [-0.0432, -11.0, 0.0, 30.0, 0.0, 30.0, 360.0] + [-0.0013, 30.0] * theta
    g = [0.0056, 4.67, 0.0, 10.0, 0.0, 10.0, 120.0] + [0.0006, 10.0] * theta
    return Zonotope(c, np.array(g)[:, None])


CASES = {"DTN-theta1": 1, "DTN-theta2": 2, "DTN-theta22": 22}
STEP, ORDER = 1e-3, 4


def rows(instances: Iterable[str] = tuple(CASES)) -> Iterator[Row]:
    """Verify the instances one after the other."""
    for name in instances:
        yield run(name)


def run(name: str) -> Row:
    """Verify one instance."""
    theta = CASES[name]
    model, start = automaton(theta), initial(theta)
    n = start.dim
    # At the end nothing is left of the other modes, wherever it be (all of x1 <= 1 and of x1 >= 1).
    ended = (HORIZON, HORIZON)
    never = [Never(HPolytope(side * np.eye(n)[[0]], [side]), during=ended) for side in (1, -1)]
    specs = {mode.name: never for mode in model.modes if mode.name != "positive"}
    start_time = perf_counter()
    verdict = verify_hybrid(
        model, start, specs, HORIZON, HybridOptions(step=STEP, order=ORDER), dt=1e-3, runs=0
    )
    seconds = perf_counter() - start_time
    assert verdict.tube is not None
    axes = np.vstack([np.eye(n)[0], -np.eye(n)[0]])
    bound = np.max([sets.support(axes).max(axis=0) for _, sets in verdict.tube.at(HORIZON)], axis=0).sum()
    paths = [
        simulate_hybrid(model, x, HORIZON, dt=1e-3)
        for x in start.c + np.linspace(-1, 1, 9)[:, None] * start.G.T
    ]
    reached = np.ptp([path.visits[-1].states[-1, 0] for path in paths])
    status = "proven" if verdict else "unknown"
    note = "width of the twist x1 at the end, rad; all in contact then"
    return Row("powertrain", name, status, "proven", float(bound), None, float(reached), seconds, note)
