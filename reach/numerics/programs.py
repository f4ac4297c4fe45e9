"""Linear programs, solved by HiGHS on equilibrated data."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .checks import Array
from .errors import ReachError

TOLERANCE = 1e-10
"""Feasibility asked of the solver, on equilibrated data. Whatever is proved is re-checked without it."""

SWEEPS = 6  # passes over rows and columns while a program is equilibrated


@dataclass(frozen=True)
class Maximum:
    """Answer to a linear program; point and multipliers are nan unless the value is finite."""

    value: float  # largest value; inf if unbounded, -inf if nothing is feasible
    point: Array  # where it is attained, (n,)
    multipliers: Array  # >= 0, with A.T @ multipliers close to the objective, (m,)


def equilibrated(A: Array) -> tuple[Array, Array]:
    """Powers of two r, c: ``A c / r`` has entries up to about 1 in every row and column (Ruiz 2001)."""
    size, rows, columns = np.abs(A), np.ones(A.shape[0]), np.ones(A.shape[1])
    if not size.size:
        return rows, columns
    for _ in range(SWEEPS):
        for axis, scale in ((1, rows), (0, columns)):
            largest = size.max(axis=axis)
            step = np.exp2(np.round(np.log2(np.where(largest > 0, largest, 1.0)) / (1 if axis else 2)))
            size = size / np.expand_dims(step, axis)
            scale *= step
    return rows, 1 / columns


def maximise(objective: Array, A: Array, b: Array) -> Maximum:
    """Solve ``max objective . x`` subject to ``A x <= b``."""
    from scipy.optimize import linprog

    m, n = A.shape
    rows, columns = equilibrated(A)
    level = float(np.max(np.abs(b) / rows, initial=0.0)) or 1.0
    size = float(np.abs(objective * columns).max(initial=0.0)) or 1.0
    solved = linprog(
        -objective * columns / size,
        A * columns / rows[:, None],
        b / rows / level,
        bounds=(None, None),
        method="highs",
        options={"primal_feasibility_tolerance": TOLERANCE, "dual_feasibility_tolerance": TOLERANCE},
    )
    if solved.status == 2:
        return Maximum(-np.inf, np.full(n, np.nan), np.full(m, np.nan))
    if solved.status == 3:
        return Maximum(np.inf, np.full(n, np.nan), np.full(m, np.nan))
    if solved.status != 0:
        raise ReachError(f"the linear program was not solved: {solved.message}")
    point = solved.x * columns * level
    multipliers = np.maximum(-solved.ineqlin.marginals, 0.0) * size / rows
    return Maximum(float(objective @ point), point, multipliers)
