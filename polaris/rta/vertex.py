"""Linear programs to the last digit: from HiGHS's vertex on, by dual simplex steps in whole numbers.

For programs whose rows are so nearly dependent that a solver's tolerances decide the answer.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..model.system import Array
from ..planning.lp import GrowingLP

BITS = 60  # coefficients are taken as multiples of 2^-60: 1e-18, a thousandth of the rounding of one near 1
STEPS = 20  # most steps in floating point, which only look for a vertex to begin with, per variable or row
SCALE = 1e3
"""Factor by which programs are enlarged for HiGHS, which knows no tolerance below 1e-10."""

EXACT_STEPS = 2000  # most exact steps
BLAND = 300  # after so many the steps follow Bland's rule, which cannot cycle
LEAST = 1e-12  # what counts as zero of the multipliers of a vertex found in floating point


def lowest(
    G: Array, tightening: Array, free: NDArray[np.bool_], exact: bool = True
) -> tuple[Array, Array] | None:
    """Solve ``min s`` subject to ``G u + s free >= need``, ``s >= 0``, ``|u_i| <= 1``.

    Rows of G (M, v) have length 1, at least one is free. Returned are ``(u, s)`` and what a unit more of each
    row's need adds to s, (M,); None if no u meets the rows that are not free, or not within `STEPS`,
    `EXACT_STEPS`. What floating point finds is carried on in exact arithmetic if that is asked for.
    """
    M, v = G.shape
    A = np.zeros((M + 1 + 2 * v, v + 1))
    A[:M, :v], A[:M, v], A[M, v] = G, free, 1.0
    A[M + 1 :, :v] = np.concatenate([np.eye(v), -np.eye(v)])
    b = np.concatenate([tightening, [0.0], np.full(2 * v, -1.0)])
    # The optimum of one row alone has multipliers >= 0: the corner of the box that serves it best.
    alone = int(np.where(free, tightening - np.abs(G).sum(axis=1), -np.inf).argmax())
    first = [*(M + 1 + np.where(G[alone] >= 0, v, 0) + np.arange(v)).tolist(), alone]
    near = _near(A, b, M)
    multipliers = np.zeros(len(b))
    if not exact:
        if near is None:
            return None
        try:
            multipliers[near] = np.linalg.solve(A[near].T, np.eye(v + 1)[-1])
            return np.linalg.solve(A[near], b[near]), multipliers[:M]
        except np.linalg.LinAlgError:
            return None
    import flint  # few programs come this far

    integers = np.rint(np.ldexp(np.column_stack([A, b]), BITS)).astype(object)
    table = flint.fmpz_mat([[int(value) for value in row] for row in integers])
    for basis in (near, first):
        solution = None if basis is None else _exact(table, basis)
        if solution is not None:
            x, at, y = solution
            multipliers[at] = y
            return x, multipliers[:M]
    return None


def _near(A: Array, b: Array, rows: int) -> list[int] | None:
    """The rows that hold with equality at the optimum, as far as floating point tells."""
    size, limit = A.shape[1], np.full(A.shape[1] - 1, SCALE)
    program = GrowingLP(np.eye(size)[-1], np.append(-limit, 0.0), np.append(limit, np.inf))
    program.add(A[:rows], SCALE * b[:rows], np.inf)
    for name in ("primal_feasibility_tolerance", "dual_feasibility_tolerance"):
        program.highs.setOptionValue(name, 1e-10)
    program.highs.setOptionValue("simplex_iteration_limit", STEPS * len(b))
    program.highs.run()
    status = program.highs.getBasis()
    columns = [state.name for state in status.col_status]
    at = [state.name == "kLower" for state in status.row_status]
    at += [name == "kLower" for name in (columns[-1], *columns[:-1])]
    basis = np.flatnonzero([*at, *(name == "kUpper" for name in columns[:-1])]).tolist()
    return basis if len(basis) == size else None


def _exact(table: Any, basis: list[int]) -> tuple[Array, list[int], Array] | None:
    """Dual simplex from a basis with multipliers >= 0: the row missed by most, later by Bland's rule."""
    import flint

    rows = table.tolist()
    n = table.ncols() - 1
    unit = flint.fmpz_mat([[0]] * (n - 1) + [[1 << BITS]])
    basis = list(basis)
    for step in range(EXACT_STEPS):
        B: Any = flint.fmpz_mat([rows[i][:n] for i in basis])
        try:
            x, x_unit = B.solve(flint.fmpz_mat([[rows[i][n]] for i in basis])).numer_denom()
        except ZeroDivisionError:
            return None
        T: Any = B.transpose()
        y, y_unit = T.solve(unit).numer_denom()
        multipliers = _numbers(y, y_unit)
        if multipliers.min() < -LEAST:
            return None
        slack = (table * flint.fmpz_mat([*x.tolist(), [-x_unit]])).entries()
        missed = [i for i, value in enumerate(slack) if value < 0]
        if not missed:
            return _numbers(x, x_unit), basis, multipliers.clip(0.0)
        enters = missed[0] if step >= BLAND else min(missed, key=lambda i: slack[i])
        w, _ = T.solve(flint.fmpz_mat([[value] for value in rows[enters][:n]])).numer_denom()
        positive = [(flint.fmpq(max(y[k, 0], 0), w[k, 0]), basis[k], k) for k in range(n) if w[k, 0] > 0]
        if not positive:
            return None
        basis[min(positive)[2]] = enters
    return None


def _numbers(values: Any, unit: Any) -> Array:
    return np.array([int(value) / int(unit) for value in values.entries()])
