"""Vehicle platoon with loss of communication (PLAD01-BND42, PLAD01-BND30, PLAN01-UNB50).

Three vehicles follow a leader that brakes and accelerates as it likes, within [-9, 1] m/s^2; each has a
spacing error, its rate and an acceleration as states. Communication fails and returns: every five
seconds (PLAD01), or at any times whatever (PLAN01). No spacing error may fall below -d_min.

Ben Makhlouf and Kowalewski, "Networked cooperative platoon of vehicles for testing methods and
verification tools" (ARCH 2014); instances of the ARCH-COMP reports on linear continuous dynamics.

PLAN01 goes on for ever. Any switching is ``x' = A x + B u + D w`` with A the mean of the two matrices and
``w = s(t) C x``, |s| <= 1, for the two rows C in which they differ, halved. What u and w make of
``z = C x``, as bounds on absolute values, is ``z <= g + G z``; the spectral radius of G is below one, so
``z <= inv(I - G) g`` at all times, and that bounds the spacings (small gain).
"""

from __future__ import annotations

from collections.abc import Iterator
from time import perf_counter

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

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
    discretize,
    support_tube,
    verify_hybrid,
)

Array = NDArray[np.float64]

HORIZON, PERIOD = 20.0, 5.0  # s
LEADER = Interval([-9.0], [1.0])
CONNECTED = np.array(
    [
        [1.6050, 4.8680, -3.5754, -0.8198, 0.4270, -0.0450, -0.1942, 0.3626, -0.0946],
        [0.8718, 3.8140, -0.0754, 1.1936, 3.6258, -3.2396, -0.5950, 0.1294, -0.0796],
        [0.7132, 3.5730, -0.0964, 0.8472, 3.2568, -0.0876, 1.2726, 3.0720, -3.1356],
    ]
)
"""Accelerations as the controller sets them with communication, as published."""
DISCONNECTED = CONNECTED.copy()
DISCONNECTED[0, 3:] = 0.0
DISCONNECTED[1, :3] = DISCONNECTED[1, 6:] = 0.0
SPACING = -np.eye(9)[[0, 3, 6]]
LIMITS = {"PLAD01-BND42": 42.0, "PLAD01-BND30": 30.0, "PLAN01-UNB50": 50.0}
STEP = {"PLAD01-BND42": 0.1, "PLAD01-BND30": 0.05}
ORDER = {"PLAD01-BND42": 10, "PLAD01-BND30": 50}
FOR_EVER = 60.0
"""After this time the rest of an infinite integral is bounded by a geometric series."""


def dynamics(accelerations: Array) -> Array:
    """State matrix for (e, e', a) of every vehicle."""
    A = np.zeros((9, 9))
    for i in range(3):
        A[3 * i, 3 * i + 1] = 1.0
        A[3 * i + 1, 3 * i + 2] = -1.0
        A[3 * i + 2] = accelerations[i]
        if i:
            A[3 * i + 1, 3 * i - 1] = 1.0
    return A


B = np.eye(9)[:, [1]]
MATRICES = {"connected": dynamics(CONNECTED), "disconnected": dynamics(DISCONNECTED)}


def automaton() -> HybridAutomaton:
    """Communication fails and returns every five seconds."""
    modes = [Mode(name, LinearSystem(A, B, LEADER)) for name, A in MATRICES.items()]
    pairs = [("connected", "disconnected"), ("disconnected", "connected")]
    return HybridAutomaton(modes, [Transition(*p, dwell=(PERIOD, PERIOD), urgent=True) for p in pairs])


def rows() -> Iterator[Row]:
    """Verify all instances."""
    for name in STEP:
        yield switched(name)
    yield arbitrary()


def switched(name: str) -> Row:
    """PLAD01, for one of its limits."""
    specs = {mode: [Always(HPolytope(SPACING, [LIMITS[name]] * 3))] for mode in MATRICES}
    model, start = automaton(), Zonotope.point(np.zeros(9))
    start_time = perf_counter()
    verdict = verify_hybrid(
        model, start, specs, HORIZON, HybridOptions(step=STEP[name], order=ORDER[name]), dt=0.1, runs=0
    )
    seconds = perf_counter() - start_time
    assert verdict.tube is not None
    bound = float(np.max([verdict.tube.support(mode, SPACING) for mode in MATRICES]))
    status = "proven" if verdict else "unknown"
    reached = worst(["connected", "disconnected"] * 2)
    return Row(
        "platoon", name, status, "proven", bound, LIMITS[name], reached, seconds, "largest -spacing, m"
    )


def worst(modes: list[str], h: float = 0.02) -> float:
    """Largest -spacing that a leader can cause under a switching sequence, input held over h."""
    count = round(PERIOD / h)
    maps = {name: discretize(A, B, h) for name, A in MATRICES.items()}
    largest = 0.0
    for last in range(count // 4, count * len(modes) + 1, count // 4):
        r, value = SPACING, np.zeros(3)
        for k in reversed(range(last)):
            Ah, Bh = maps[modes[k // count]]
            effect = (r @ Bh)[:, 0]
            value += np.maximum(LEADER.lo[0] * effect, LEADER.hi[0] * effect)
            r = r @ Ah
        largest = max(largest, float(value.max()))
    return largest


def arbitrary() -> Row:
    """PLAN01: any switching, for all times."""
    start = perf_counter()
    middle = sum(MATRICES.values()) / 2
    half = (MATRICES["connected"] - MATRICES["disconnected"])[[2, 5]] / 2
    inputs = np.hstack([B, np.eye(9)[:, [2, 5]]])
    D = np.vstack([half, SPACING])
    leader, *others = (absolute_gain(middle, inputs[:, [j]], D) for j in range(3))
    G = np.stack([gain[:2] for gain in others], axis=1)
    g = leader[:2] * 9
    z = np.linalg.solve(np.eye(2) - G, g)
    # inv(I - G) >= 0 if some z > 0 has G z < z (then the spectral radius is below one).
    holds = bool(np.all(z > 0) and np.all(G @ z + g <= z * (1 + 1e-9)) and np.all(G @ z < z))
    shift = leader_gain(middle, SPACING)
    bound = float((shift + np.stack([gain[2:] for gain in others], axis=1) @ z).max() * (1 + 1e-9))
    seconds = perf_counter() - start
    status = "proven" if holds and bound <= LIMITS["PLAN01-UNB50"] else "unknown"
    reached = max(worst([a, b] * 2) for a in MATRICES for b in MATRICES)
    note = "largest -spacing, m; any switching, unbounded time"
    return Row("platoon", "PLAN01-UNB50", status, "proven", bound, 50.0, reached, seconds, note)


def absolute_gain(A: Array, b: Array, D: Array) -> Array:
    """Bounds on ``int_0^inf |D e^{A t} b| dt``, by a tube and a geometric series for its rest."""
    return _for_ever(A, b, D, Interval([-1.0], [1.0]))


def leader_gain(A: Array, D: Array) -> Array:
    """Bounds on ``D x(t)`` for all times from rest, by the leader alone."""
    return _for_ever(A, B, D, LEADER)


def _for_ever(A: Array, b: Array, D: Array, U: Interval) -> Array:
    everything = np.vstack([D, np.eye(len(A)), -np.eye(len(A))])
    tube = support_tube(
        LinearSystem(A, b, U), Zonotope.point(np.zeros(len(A))), FOR_EVER, everything, step=0.02
    )
    first, states = tube.most[: len(D)], tube.most[len(D) :].reshape(2, -1).max(axis=0)
    # |x| <= states after one stretch; what is left of it after the next ones is e^{A T} of that, and so on.
    decay = np.abs(expm(A * FOR_EVER)) * (1 + 1e-6)
    assert np.max(decay.sum(axis=1)) < 0.5
    series = np.linalg.solve(np.eye(len(A)) - decay, states) * (1 + 1e-9)
    return first + np.abs(D) @ (decay @ series)
