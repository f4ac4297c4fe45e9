"""The gain of the tracking controller: the algebraic Riccati equation of section III-A."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_continuous_are

from ...model.errors import ScenarioError
from ...model.system import Array, LinearSystem, as_finite


def solve_are(A: Array, B: Array, Q: Array, R: Array) -> tuple[Array, Array]:
    """Solve the algebraic Riccati equation (eq. 7); return P and the gain ``R^-1 B' P``.

    Q is positive semidefinite, R positive definite.

    Raises
    ------
    ScenarioError
        If there is no stabilising solution: (A, B) is not stabilisable, or Q leaves a mode on or
        right of the imaginary axis unobserved.
    """
    try:
        P = solve_continuous_are(A, B, Q, R)
        gain = np.linalg.solve(R, B.T @ P)
        worst = float(np.max(np.linalg.eigvals(A - B @ gain).real))
    except (ValueError, np.linalg.LinAlgError) as error:
        rule = f"the Riccati equation has no stabilising solution ({error})"
        raise ScenarioError("tracking.Q", np.diag(Q).tolist(), rule) from error
    if not worst < 0:
        rule = f"the closed loop must be stable; its slowest eigenvalue has real part {worst:.3g}"
        raise ScenarioError("tracking.Q", np.diag(Q).tolist(), rule)
    return np.asarray(P, dtype=float), gain


def lqr_gain(system: LinearSystem, Q: ArrayLike, R: ArrayLike) -> Array:
    """LQR gain, shape (m, n), for weights given as matrices or as diagonals (Proposition 1)."""
    weights = []
    for name, value, size in (("tracking.Q", Q, system.n), ("tracking.R", R, system.m)):
        matrix = as_finite(name, value, 1 if np.ndim(value) == 1 else 2)
        matrix = as_finite(name, np.diag(matrix) if matrix.ndim == 1 else matrix, 2)
        if matrix.shape != (size, size):
            raise ScenarioError(name, matrix.shape, f"must be {size} numbers or a {size} x {size} matrix")
        weights.append((matrix + matrix.T) / 2)
    return solve_are(system.A, system.B, *weights)[1]
