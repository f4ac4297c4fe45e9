"""Gains that a scenario gives by weights: the stabilising solution of the Riccati equation, and no other."""

from typing import Any

from flint import arb, arb_mat

from ..files.document import Document
from ..files.entries import Law
from ..kernel.balls import diagonal, identity, largest, magnitude, matrix, require, root
from ..kernel.verdict import Rejected, Undecided

GAIN_SLACK = 1e-6
"""Largest residual of the Riccati equation's gain, as a share of what the weights make of each entry."""

WEIGHT_SLACK = 2e-12
"""By how much a weight may fail to be semidefinite, relative to its largest entry: the scenario's rule."""


def check_gain(document: Document, law: Law, spec: dict[str, Any]) -> None:
    """Check that K is the LQR gain of (Q, R): ``K = R^-1 B' P``, P the cost of flying K, and stabilises.

    The Riccati equation has other solutions; flying one of them would not end anywhere, and "the cost of
    flying K" would be no cost. With A - B K Hurwitz and Q, R (semi)definite, P is
    ``int e^{A_c' t} (Q + K' R K) e^{A_c t} dt >= 0``, and the stabilising solution is unique.
    """
    A, B = matrix(document.A), matrix(document.B)
    assert law.gain is not None  # any_thrust, the only kind without one, is not asked
    K, Q, R = matrix(law.gain), weight(spec["Q"]), weight(spec["R"])
    if (Q.nrows(), R.nrows()) != (A.nrows(), B.ncols()):
        raise Rejected("controllers", f"the weights of {law.name} are not of the system's size")
    check_definite(R, 0.0, f"the input weight R of {law.name}")
    check_definite(Q, WEIGHT_SLACK, f"the state weight Q of {law.name}")
    closed, cost = A - B * K, Q + K.transpose() * R * K
    check_hurwitz(closed, f"the loop of {law.name}")
    residuals = (R * K - B.transpose() * lyapunov(closed, cost)).tolist()
    # |(R K)_ij| <= sqrt(R_ii (Q + K' R K)_jj), in any units: entries are measured by that.
    for i, row in enumerate(residuals):
        for j, residual in enumerate(row):
            slack = root(R[i, i] * cost[j, j]) * GAIN_SLACK
            if not residual.is_zero():
                text = f"the gain of {law.name} is not that of its weights Q and R, entry {i}, {j}"
                require("controllers", slack - abs(residual), text)


def weight(values: Any) -> arb_mat:
    """Return a weight from its diagonal or from itself, made symmetric."""
    if not isinstance(values[0], list):
        return diagonal(values)
    M = matrix(values)
    return (M + M.transpose()) * arb(0.5)


def lyapunov(A: arb_mat, Q: arb_mat) -> arb_mat:
    """Solve ``A' P + P A + Q = 0`` as a system of linear equations."""
    n = A.nrows()
    rows = []
    for i in range(n):
        for j in range(n):
            row = [arb(0)] * (n * n)
            for k in range(n):
                row[k * n + j] += A[k, i]
                row[i * n + k] += A[k, j]
            rows.append(row)
    solution = matrix(rows).solve(arb_mat(n * n, 1, [-x for x in Q.entries()]))
    return arb_mat(n, n, solution.entries())


def check_hurwitz(A: arb_mat, name: str) -> None:
    """Check that A is Hurwitz: ``A' X + X A = -S`` with S and X positive definite.

    Any such X will do. Here it is the midpoint of the solution for the identity, an exact matrix.
    """
    try:
        X = lyapunov(A, identity(A.nrows()))
    except ZeroDivisionError as error:  # two eigenvalues add up to zero, or nearly
        raise Undecided("controllers", f"{name}: not shown to be stable") from error
    X = ((X + X.transpose()) * arb(0.5)).mid()
    decreasing = positive_definite(-(A.transpose() * X + X * A)) or None
    _settle(decreasing and positive_definite(X), name, "stable (no Lyapunov function)")


def check_definite(M: arb_mat, slack: float, name: str) -> None:
    """Check that a symmetric matrix is positive definite, or with a slack semidefinite up to rounding."""
    if slack and all(x.is_zero() for x in M.entries()):
        return
    verdict = positive_definite(M + identity(M.nrows()) * (largest(magnitude(M).entries()) * slack))
    _settle(verdict, name, f"positive {'semidefinite' if slack else 'definite'}")


def _settle(verdict: bool | None, name: str, adjective: str) -> None:
    if verdict is None:
        raise Undecided("controllers", f"{name}: not shown to be {adjective} at this precision")
    if not verdict:
        raise Rejected("controllers", f"{name} is not {adjective}")


def positive_definite(M: arb_mat) -> bool | None:
    """Return True if every symmetric matrix within the balls is positive definite; None if that is open.

    Cholesky's factorisation, rounded outwards: a pivot that is certainly positive (negative) in exact
    arithmetic decides.
    """
    rows, n = M.tolist(), M.nrows()
    for k in range(n):
        pivot = rows[k][k]
        if not pivot > 0:
            return False if pivot <= 0 else None
        for i in range(k + 1, n):
            share = rows[i][k] / pivot
            for j in range(k + 1, n):
                rows[i][j] -= share * rows[k][j]
    return True
