"""Gearbox meshing of a motor-transmission drive (GRBX01, GRBX02).

A sleeve is pushed towards a gear and bounces between the flanks of two teeth until it meshes. Both
impacts and meshing add to an accumulated impulse, which stays below 20; the sleeve meshes by 0.2 s.

Chen, Mitra and Tian, "Motor-transmission drive system: a benchmark example for safety verification"
(ARCH 2014), in the form of the ARCH-COMP reports on linear continuous dynamics. State: velocities
vx, vy [m/s], positions px, py [m], impulse I [N m].
"""

from __future__ import annotations

from collections.abc import Iterator
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from benchmarks.arch.row import Row
from reach import (
    Always,
    HPolytope,
    HybridAutomaton,
    HybridOptions,
    Interval,
    LinearSystem,
    Mode,
    Never,
    Transition,
    simulate_hybrid,
    verify_hybrid,
)

Array = NDArray[np.float64]

HORIZON = 0.21
MESHED_BY, IMPULSE = 0.2, 20.0
FORCE, MOMENT = 70.0, 1.0  # shifting force on the sleeve [N], resisting moment on the gear [N m]
SLEEVE, GEAR = 3.2, 18.1  # masses [kg]
INERTIA, RADIUS = 0.7, 0.08
RESTITUTION = 0.9
ANGLE = np.pi / 5  # of a flank
CONTACT = -0.003  # px at which the sleeve meshes [m]

INITIAL = {
    "GRBX01": Interval([0, 0, -0.0168, 0.0029, 0], [0, 0, -0.0166, 0.0031, 0]),
    "GRBX02": Interval([0, 0, -0.01675, 0.00285, 0], [0, 0, -0.01665, 0.00315, 0]),
}


def impact(side: float) -> Array:
    """Reset at the upper (side 1) or lower (side -1) flank: an impact with restitution."""
    s, c, z = np.sin(ANGLE), np.cos(ANGLE), RESTITUTION
    mass = SLEEVE * c**2 + GEAR * s**2
    R = np.eye(5)
    R[0, :2] = SLEEVE * c**2 - GEAR * z * s**2, -side * (z + 1) * GEAR * s * c
    R[1, :2] = -side * (z + 1) * SLEEVE * s * c, GEAR * s**2 - SLEEVE * z * c**2
    R[4, :2] = (z + 1) * SLEEVE * GEAR * s, side * (z + 1) * SLEEVE * GEAR * c
    R[[0, 1, 4], :2] /= mass
    return R


def automaton() -> HybridAutomaton:
    """Free flight between the flanks; an impact must happen where it leads outwards."""
    A = np.zeros((5, 5))
    A[2, 0] = A[3, 1] = 1.0
    drift = [FORCE / SLEEVE, -RADIUS * MOMENT / INERTIA, 0, 0, 0]
    slope, s, c = np.tan(ANGLE), np.sin(ANGLE), np.cos(ANGLE)
    inside = HPolytope([[0, 0, 1, 0, 0], [0, 0, slope, 1, 0], [0, 0, slope, -1, 0]], [CONTACT, 0, 0])
    mesh = np.diag([0, 0, 1.0, 1.0, 1.0])
    mesh[4, :2] = SLEEVE
    transitions = [
        Transition(
            "free",
            "free",
            guard=HPolytope([[0, 0, -slope, -side, 0], [-s, -side * c, 0, 0, 0]], [0, 0]),
            R=impact(side),
        )
        for side in (1.0, -1.0)
    ]
    transitions.append(Transition("free", "meshed", guard=HPolytope([[0, 0, -1, 0, 0]], [-CONTACT]), R=mesh))
    modes = [Mode("free", LinearSystem(A, c=drift), inside), Mode("meshed", LinearSystem(np.zeros((5, 5))))]
    return HybridAutomaton(modes, transitions)


GAINED = np.eye(5)[[4]]
SMALL = Always(HPolytope(GAINED, [IMPULSE]))
SPECS = {
    # No motion is free any more from the deadline on, wherever it be (all of px <= 0).
    "free": [SMALL, Never(HPolytope([[0, 0, 1, 0, 0]], [0]), during=(MESHED_BY, HORIZON))],
    "meshed": [SMALL],
}
STEPS = {"free": 3e-4, "meshed": HORIZON}


def rows() -> Iterator[Row]:
    """Verify both instances."""
    for name in INITIAL:
        yield run(name)


def run(name: str) -> Row:
    """Verify one instance."""
    model, initial = automaton(), INITIAL[name]
    start = perf_counter()
    verdict = verify_hybrid(model, initial, SPECS, HORIZON, HybridOptions(step=STEPS), dt=1e-4, runs=0)
    seconds = perf_counter() - start
    assert verdict.tube is not None
    bound = float(max(verdict.tube.support(mode, GAINED)[0] for mode in SPECS))
    last = max(segment.span(*segment.steps)[:, 1].max() for segment in verdict.tube.in_mode("free"))
    rng = np.random.default_rng(0)
    corners = initial.support_vector(rng.normal(size=(20, 5)))
    paths = [simulate_hybrid(model, x, HORIZON, dt=1e-4) for x in corners]
    reached = max(float(path.visits[-1].states[-1, 4]) for path in paths)
    note = f"impulse, N m; meshed by {last:.4f} s, at most {MESHED_BY:g}"
    status = "proven" if verdict else "unknown"
    return Row("gearbox", name, status, "proven", bound, IMPULSE, reached, seconds, note)
