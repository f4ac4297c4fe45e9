"""Spacecraft rendezvous with abort (SRNA01, SRA01 to SRA08, SRU01, SRU02).

A chaser approaches a target at the origin in the orbital plane: a slow approach to 100 m, a rendezvous
attempt from there, and an abort without thrust, at a given time or any time of a window. Minutes and
metres. Chan and Mitra, "Verifying safety of an autonomous spacecraft rendezvous mission" (ARCH 2017),
linear variant of the ARCH-COMP reports on linear continuous dynamics (Althoff et al., 2018 to 2024).

In the attempt the chaser stays in the line-of-sight cone and below 0.055 m/s (an octagon in the
velocities); after an abort it keeps out of the box of +-0.2 m around the target.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from time import perf_counter

import numpy as np

from benchmarks.arch.row import Row, Verdict
from reach import (
    Always,
    HPolytope,
    HybridAutomaton,
    HybridOptions,
    HybridTrajectory,
    LinearSystem,
    Mode,
    Never,
    Transition,
    Zonotope,
    simulate_hybrid,
    verify_hybrid,
)
from reach.hybrid.segments import HybridTube

HORIZON = 300.0  # min

ABORTS: dict[str, tuple[tuple[float, float] | None, Verdict]] = {
    "SRNA01": (None, "proven"),
    "SRA01": ((120, 120), "proven"),
    "SRA02": ((120, 125), "proven"),
    "SRA03": ((120, 145), "proven"),
    "SRA04": ((240, 240), "proven"),
    "SRA05": ((235, 240), "proven"),
    "SRA06": ((230, 240), "proven"),
    "SRA07": ((50, 150), "proven"),
    "SRA08": ((0, 240), "proven"),
    "SRU01": ((260, 260), "violated"),
    "SRU02": ((0, 260), "violated"),
}
"""Window of the abort in minutes, and the expected verdict."""

# Accelerations of the two closed loops (orbital motion and linear-quadratic feedback) and without thrust,
# as published.
APPROACH = [
    [-0.057599765881773, 0.000200959896519766, -2.89995083970656, 0.00877200894463775],
    [-0.000174031357370456, -0.0665123984901026, -0.00875351105536225, -2.90300269286856],
]
ATTEMPT = [
    [-0.575999943070835, 0.000262486079431672, -19.2299795908647, 0.00876275931760007],
    [-0.000262486080737868, -0.575999940191886, -0.00876276068239993, -19.2299765959399],
]
FREE = [[0.0000575894721132, 0.0, 0.0, 0.00876276], [0.0, 0.0, -0.00876276, 0.0]]

OCTAGON = np.array([[-1, 0], [1, 0], [0, -1], [0, 1], [-1, -1], [1, 1], [1, -1], [-1, 1]], dtype=float)
NEAR = HPolytope(np.hstack([OCTAGON, np.zeros((8, 2))]), [100.0] * 4 + [141.1] * 4)
SPEED = 0.055 * 60 * np.cos(np.pi / 8), 0.055 * 60 * np.sin(np.pi / 8)  # m/min, a corner of the octagon
SLOW = HPolytope(np.hstack([np.zeros((8, 2)), OCTAGON]), [SPEED[0]] * 4 + [sum(SPEED)] * 4)
CONE = HPolytope(
    [[-1, 0, 0, 0], [np.tan(np.pi / 6), -1, 0, 0], [np.tan(np.pi / 6), 1, 0, 0]], [100.0, 0.0, 0.0]
)
SIDE = 0.2
AXES = np.vstack([np.eye(4)[:2], -np.eye(4)[:2]])
SPECS = {"attempt": [Always(SLOW), Always(CONE)], "abort": [Never(HPolytope(AXES, [SIDE] * 4))]}
INITIAL = Zonotope.box([-900, -400, 0, 0], [25, 25, 0, 0])

STEPS = {"approach": 1.0, "attempt": 2.0, "abort": 4.0}
TOLERANCE = {"approach": [1, 1, 0.2, 0.2], "attempt": [0.02, 0.02, 0.01, 0.01]}
CLUSTERS = {"attempt": 3}


def system(accelerations: list[list[float]]) -> LinearSystem:
    """State (x, y, vx, vy)."""
    return LinearSystem(np.vstack([np.eye(4)[2:], accelerations]))


def automaton(abort: tuple[float, float] | None) -> HybridAutomaton:
    """Return the modes; the attempt begins where the approach must end, at x = -100 m."""
    modes = [
        Mode("approach", system(APPROACH), HPolytope([[1.0, 0, 0, 0]], [-100.0])),
        Mode("attempt", system(ATTEMPT), NEAR),
    ]
    transitions = [Transition("approach", "attempt", guard=NEAR)]
    if abort is not None:
        modes.append(Mode("abort", system(FREE)))
        for name in ("approach", "attempt"):
            transitions.append(Transition(name, "abort", window=abort, urgent=True))
    return HybridAutomaton(modes, transitions)


def rows(instances: Iterable[str] = tuple(ABORTS)) -> Iterator[Row]:
    """Verify the instances one after the other."""
    for name in instances:
        yield run(name)


def run(name: str) -> Row:
    """Verify one instance."""
    abort, expected = ABORTS[name]
    model = automaton(abort)
    start = perf_counter()
    specs = {mode.name: SPECS[mode.name] for mode in model.modes if mode.name in SPECS}
    verdict = verify_hybrid(
        model,
        INITIAL,
        specs,
        HORIZON,
        HybridOptions(step=STEPS, tolerance=TOLERANCE, clusters=CLUSTERS),
        dt=0.2,
    )
    seconds = perf_counter() - start
    if verdict.trajectory is not None:
        reached = distance(verdict.trajectory)
        return Row("rendezvous", name, "violated", expected, None, SIDE, reached, seconds, verdict.reason)
    assert verdict.tube is not None
    status: Verdict = "proven" if verdict else "unknown"
    if abort is None:
        top = float(verdict.tube.support("attempt", SLOW.A[:4]).max())
        paths = trials(model)
        speed = max(
            float((v.states @ SLOW.A[:4].T).max()) for p in paths for v in p.visits if v.mode == "attempt"
        )
        return Row("rendezvous", name, status, expected, top, SPEED[0], speed, seconds, "velocity, m/min")
    bound, reached = clearance(verdict.tube), min(distance(path) for path in trials(model))
    return Row("rendezvous", name, status, expected, bound, SIDE, reached, seconds, "distance after abort, m")


def trials(model: HybridAutomaton) -> list[HybridTrajectory]:
    """Simulate from the corners, with the earliest and the latest abort."""
    return [
        simulate_hybrid(model, x, HORIZON, dt=0.5, policy="first" if early else "last")
        for x in INITIAL.corners()
        for early in (False, True)
    ]


def clearance(tube: HybridTube) -> float:
    """Proved lower bound on the distance from the target after the abort (maximum norm)."""
    low = []
    for segment in tube.in_mode("abort"):
        distances = -segment.flowpipes.support(-AXES)
        low.append(distances.max(axis=-1)[segment.alive].min())
    return float(min(low))


def distance(path: HybridTrajectory) -> float:
    """Smallest distance after the abort (maximum norm)."""
    free = [np.abs(visit.states[:, :2]).max(axis=1).min() for visit in path.visits if visit.mode == "abort"]
    return float(min(free, default=np.inf))
