"""Linear benchmarks: building and space station (matrices from files), heat and beam (generated).

Sources: Tran, Nguyen, Johnson, "Large-scale linear systems from order-reduction" (ARCH 2016) for the
building and the space station; Bak, Tran, Johnson, "Numerical verification of affine systems with up
to a billion dimensions" (HSCC 2019) for the heat equation; Malakiyeh, Shojaee, Bathe, "The Bathe time
integration method revisited for prescribing desired numerical dissipation" (2019) for the clamped
beam; specifications from the ARCH-COMP reports on linear continuous dynamics (Althoff et al.).
"""

from __future__ import annotations

from collections.abc import Iterator
from math import ceil
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from benchmarks.arch.row import Row, Verdict
from reach import Always, HPolytope, Interval, LinearSystem, Never, support_tube, verify

Array = NDArray[np.float64]


def rows(data: Path | None) -> Iterator[Row]:
    """All linear instances; those that need matrices only if their folder is given."""
    if data is not None:
        yield from building(data)
        yield from space_station(data)
    for name in HEAT:
        yield heat(name)
    for nodes in BEAM:
        yield from beam(nodes)


# -- matrices from files -----------------------------------------------------------------------


def load(path: Path) -> tuple[Any, LinearSystem, Interval]:
    """File, system with arbitrary input, initial set."""
    file = np.load(path, allow_pickle=False)
    system = LinearSystem(file["A"], file["B"], Interval(file["u_low"], file["u_high"]))
    return file, system, Interval.ball(file["x0_center"], file["x0_radius"])


def held(system: LinearSystem, initial: Interval) -> tuple[LinearSystem, Interval]:
    """Return the system with an unknown constant input, and its initial set."""
    U = system.U[0].interval_hull()
    return system.holding_inputs(), Interval(np.r_[initial.lo, U.lo], np.r_[initial.hi, U.hi])


def building(data: Path) -> Iterator[Row]:
    """Displacement of the building's top, arbitrary (F) and constant (C) input."""
    file, system, initial = load(data / "building.npz")
    C = file["C"]
    for kind, (s, x) in {"BLDF01": (system, initial), "BLDC01": held(system, initial)}.items():
        rows = np.hstack([C, np.zeros((1, s.dim - C.shape[1]))])
        yield decide("building", f"{kind} BDS01", s, x, Always(HPolytope(rows, [5.1e-3])), 20.0, "proven")
        yield decide("building", f"{kind} BDU01", s, x, Always(HPolytope(rows, [4e-3])), 20.0, "violated")
        low = Never(HPolytope(rows, [-0.78e-3]), during=(20.0, 20.0))
        expected: Verdict = "violated" if kind == "BLDF01" else "proven"
        yield decide("building", f"{kind} BDU02", s, x, low, 20.0, expected)


def space_station(data: Path) -> Iterator[Row]:
    """Third output of the station's structure, arbitrary (F) and constant (C) input."""
    file, system, initial = load(data / "iss.npz")
    C = np.vstack([file["C"][2], -file["C"][2]])
    limits = {"ISSF01": (("ISS01", 7e-4), ("ISU01", 5e-4)), "ISSC01": (("ISS02", 5e-4), ("ISU02", 1.7e-4))}
    for kind, (s, x) in {"ISSF01": (system, initial), "ISSC01": held(system, initial)}.items():
        rows = np.hstack([C, np.zeros((2, s.dim - C.shape[1]))])
        for name, limit in limits[kind]:
            expected: Verdict = "proven" if name.startswith("ISS") else "violated"
            spec = Always(HPolytope(rows, [limit, limit]))
            yield decide("space station", f"{kind} {name}", s, x, spec, 20.0, expected)


def decide(
    benchmark: str,
    instance: str,
    system: LinearSystem,
    initial: Interval,
    spec: Always | Never,
    horizon: float,
    expected: Verdict,
) -> Row:
    """Call `reach.verify` and return a row; bound and reached value in units of the output."""
    start = perf_counter()
    verdict = verify(system, initial, spec, horizon)
    seconds = perf_counter() - start
    sign = 1.0 if isinstance(spec, Always) else -1.0
    reached = sign * float(np.max(verdict.reached))
    if verdict.trajectory is not None:
        reached = sign * float(np.max(sign * spec.region.A @ verdict.trajectory.states[-1]))
    bound, limit = sign * float(np.max(verdict.bounds)), float(spec.region.b[0])
    note = f"{verdict.steps} steps"
    return Row(benchmark, instance, verdict.status, expected, bound, limit, reached, seconds, note)


# -- generated ---------------------------------------------------------------------------------

HEAT = {"HEAT01": (5, 0.10369), "HEAT02": (10, 0.02966), "HEAT03": (20, 0.01716)}
"""Cells per side and the published maximum at the centre."""
BAND = 1e-4
"""A bound this far above the published maximum counts as tight."""


def heat_matrix(m: int) -> Any:
    """Diffusion (0.01) in a unit cube of m^3 cells, insulated but for the face x = 1 (exchange 0.5)."""
    size = 1 / (m + 1)
    line = sparse.diags([np.ones(m - 1), -2 * np.ones(m), np.ones(m - 1)], [-1, 0, 1]).tolil()
    line[0, 0] = line[-1, -1] = -1.0
    first = line.copy()
    first[-1, -1] -= 1 - 1 / (1 + 0.5 * size)
    one = sparse.identity(m)
    total = sparse.kron(sparse.kron(one, one), first)
    total = total + sparse.kron(sparse.kron(one, line), one) + sparse.kron(sparse.kron(line, one), one)
    return sparse.csr_matrix(total * 0.01 / size**2)


def heat_start(m: int) -> Interval:
    """Cells in [0, 0.4] x [0, 0.2] x [0, 0.1] at 1 +- 0.1, the others at 0."""
    hot = np.zeros((m, m, m), dtype=bool)
    z, y, x = (ceil(m * share / 10) + 1 for share in (1, 2, 4))
    hot[:z, :y, :x] = True
    center = hot.ravel().astype(float)
    return Interval.ball(center, 0.1 * center)


def heat(name: str) -> Row:
    """Temperature at the centre, for 40 s."""
    m, published = HEAT[name]
    system, initial = LinearSystem(heat_matrix(m)), heat_start(m)
    middle = np.zeros((1, m**3))
    middle[0, (m // 2) * (m * m + m + 1)] = 1.0
    start = perf_counter()
    tube = support_tube(system, initial, 40.0, middle, tolerance=BAND / 4)
    seconds = perf_counter() - start
    bound, reached = float(tube.most[0]), float(tube.reached[0])
    status: Verdict = "proven" if bound <= published + BAND else "unknown"
    note = f"n = {m**3}, {len(tube.times) - 1} steps, dense in time"
    return Row("heat", name, status, "proven", bound, published, reached, seconds, note)


BEAM = {100: 70, 500: 350, 1000: 700}
"""Elements and the node whose velocity is bounded."""


def beam_system(nodes: int, constant: bool) -> tuple[LinearSystem, Interval]:
    """Rod of steel, clamped at one end, loaded by 1e4 (0.99 to 1.01 of it) at the other; at rest."""
    modulus, density, length, area = 30e6, 7.3e-4, 200.0, 1.0
    h = length / nodes
    K = sparse.diags([-np.ones(nodes - 1), 2 * np.ones(nodes), -np.ones(nodes - 1)], [-1, 0, 1]).tolil()
    K[-1, -1] = 1.0
    K = sparse.csr_matrix(K * (modulus * area / h))
    mass = np.full(nodes, density * area * h)
    mass[-1] /= 2
    inverse = sparse.diags(1 / mass)
    damping = 1e-6 * K + sparse.diags(1e-6 * mass)
    A = sparse.bmat([[None, sparse.identity(nodes)], [-inverse @ K, -inverse @ damping]], format="csr")
    B = np.zeros((2 * nodes, 1))
    B[-1] = 1e4 / mass[-1]
    system, rest = LinearSystem(A, B, Interval([0.99], [1.01])), np.zeros(2 * nodes)
    start = Interval(rest, rest)
    return held(system, start) if constant else (system, start)


def beam(nodes: int) -> Iterator[Row]:
    """Velocity of one node for 0.01 s, tightest bound."""
    for kind, constant in (("CBC", True), ("CBF", False)):
        system, initial = beam_system(nodes, constant)
        row = np.zeros((1, system.dim))
        row[0, nodes + BEAM[nodes] - 1] = 1.0
        start = perf_counter()
        tube = support_tube(system, initial, 0.01, row, tolerance=0.5)
        seconds = perf_counter() - start
        bound, reached = float(tube.most[0]), float(tube.reached[0])
        note = f"n = {2 * nodes}, {len(tube.times) - 1} steps; no limit is specified"
        yield Row("beam", f"{kind}{nodes}", "unknown", "unknown", bound, None, reached, seconds, note)
