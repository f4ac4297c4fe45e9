"""Linear programs, solved by HiGHS on equilibrated data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .checks import Array
from .errors import ReachError

TOLERANCE = 1e-10
"""Feasibility asked of the solver, on equilibrated data. Whatever is proved is re-checked without it."""

SWEEPS = 6  # passes over rows and columns while a program is equilibrated


@dataclass(frozen=True)
class Optimum:
    """Answer to a linear program; point and multipliers are nan unless the value is finite."""

    value: float  # inf or -inf if unbounded or nothing is feasible, nan if the solver gave up
    point: Array  # where it is attained, (n,)
    multipliers: Array  # what the value gains by a unit more of each row's side, (m,)


def equilibrated(A: Array) -> tuple[Array, Array]:
    """Powers of two r, c: ``A c / r`` has entries up to about 1 in every row and column (Ruiz 2001)."""
    size, rows, columns = np.abs(A), np.ones(A.shape[0]), np.ones(A.shape[1])
    if not size.size:
        return rows, columns
    for _ in range(SWEEPS):
        for axis, scale in ((1, rows), (0, columns)):
            most = size.max(axis=axis)
            step = np.exp2(np.round(np.log2(np.where(most > 0, most, 1.0)) / (1 if axis else 2)))
            size = size / np.expand_dims(step, axis)
            scale *= step
    return rows, 1 / columns


def minimise(
    cost: Array,
    A: Any,
    lower: ArrayLike,
    upper: ArrayLike,
    low: ArrayLike = -np.inf,
    high: ArrayLike = np.inf,
    tolerance: float = 1e-7,
) -> Optimum:
    """Solve ``min cost . x``, ``lower <= A x <= upper``, ``low <= x <= high``; A may be sparse."""
    import highspy
    from scipy.sparse import csr_array

    make: Any = highspy.Highs  # its constructor carries no types
    rows, program, solver = csr_array(A), highspy.HighsLp(), make()
    m, n = program.num_row_, program.num_col_ = rows.shape
    program.col_cost_ = np.asarray(cost, dtype=float)
    program.row_lower_, program.row_upper_ = (
        np.broadcast_to(side, m).astype(float) for side in (lower, upper)
    )
    program.col_lower_, program.col_upper_ = (np.broadcast_to(side, n).astype(float) for side in (low, high))
    matrix = program.a_matrix_
    matrix.format_, matrix.start_ = highspy.MatrixFormat.kRowwise, rows.indptr.astype(np.int32)
    matrix.index_, matrix.value_ = rows.indices.astype(np.int32), rows.data.astype(float)
    options = {"output_flag": False, "threads": 1, "primal_feasibility_tolerance": tolerance}
    for name, value in (options | {"dual_feasibility_tolerance": tolerance}).items():
        solver.setOptionValue(name, value)
    solver.passModel(program)
    solver.run()
    kind = highspy.HighsModelStatus
    if solver.getModelStatus() == kind.kUnboundedOrInfeasible:  # what comes before the simplex cannot tell
        solver.setOptionValue("presolve", "off")
        solver.run()
    status, found = solver.getModelStatus(), solver.getSolution()
    if status in (kind.kOptimal, kind.kModelEmpty):
        value = float(solver.getInfo().objective_function_value)
        return Optimum(value, np.array(found.col_value), np.array(found.row_dual))
    value = {kind.kInfeasible: np.inf, kind.kUnbounded: -np.inf}.get(status, np.nan)
    return Optimum(value, np.full(n, np.nan), np.full(m, np.nan))


def maximise(objective: Array, A: Array, b: Array) -> Optimum:
    """Solve ``max objective . x`` subject to ``A x <= b``; the multipliers are not negative."""
    rows, columns = equilibrated(A)
    level = float(np.max(np.abs(b) / rows, initial=0.0)) or 1.0
    size = float(np.abs(objective * columns).max(initial=0.0)) or 1.0
    scaled = -objective * columns / size, A * columns / rows[:, None]
    found = minimise(*scaled, -np.inf, b / rows / level, tolerance=TOLERANCE)
    if np.isnan(found.value):
        raise ReachError("the linear program was not solved")
    if np.isinf(found.value):
        return Optimum(-found.value, found.point, found.multipliers)
    point = found.point * columns * level
    multipliers = np.maximum(-found.multipliers, 0.0) * size / rows
    return Optimum(float(objective @ point), point, multipliers)
