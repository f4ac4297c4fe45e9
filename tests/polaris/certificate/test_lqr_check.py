"""Gains given by weights: the stabilising solution of the Riccati equation passes, every other does not."""

from itertools import combinations
from types import SimpleNamespace

import flint
import numpy as np
import pytest

from polaris.certificate.kernel.balls import PRECISION, matrix
from polaris.certificate.kernel.verdict import Rejected, Undecided
from polaris.certificate.model.lqr import check_gain, check_hurwitz
from polaris.model.system import LinearSystem
from polaris.synthesis.tracker.lqr import lqr_gain


@pytest.fixture(autouse=True)
def precision():
    with flint.ctx.workprec(PRECISION):
        yield


def judged(A, B, Q, R, K):
    """Outcome of the check; Q and R may be diagonals."""
    document = SimpleNamespace(A=A.tolist(), B=B.tolist())
    law = SimpleNamespace(name="law", gain=np.asarray(K, dtype=float).tolist())
    try:
        check_gain(document, law, {"Q": np.asarray(Q).tolist(), "R": np.asarray(R).tolist()})
    except (Rejected, Undecided) as error:
        assert error.claim == "controllers"
        return type(error).__name__
    return "holds"


def gain(A, B, Q, R):
    """The package's own gain."""
    n = len(A)
    return lqr_gain(LinearSystem(A, B, np.eye(n), np.ones(B.shape[1]), C=np.eye(n)[:1]), Q, R)


def random_plant(rng):
    """(A, B, Q, R) in units of all sizes; Q as a diagonal or as a matrix, semidefinite at times."""
    n, m = int(rng.integers(1, 7)), int(rng.integers(1, 4))
    A, B = rng.normal(size=(n, n)), rng.normal(size=(n, m))
    root = rng.normal(size=(n, n))
    Q = root @ root.T if rng.random() < 0.5 else np.diag(rng.uniform(0.1, 10.0, n))
    R = np.diag(rng.uniform(0.1, 10.0, m))
    x, u, t = 10.0 ** rng.uniform(-3, 3, n), 10.0 ** rng.uniform(-3, 3, m), 10.0 ** rng.uniform(-3, 3)
    A, B = A * x[:, None] / x / t, B * x[:, None] / u / t
    return A, B, (Q + Q.T) / 2 / np.outer(x, x), R / np.outer(u, u)


def all_solutions(A, B, Q, R):
    """Gains of every real solution of the Riccati equation, from the Hamiltonian's invariant subspaces."""
    S = B @ np.linalg.solve(R, B.T)
    values, vectors = np.linalg.eig(np.block([[A, -S], [-Q, -A.T]]))
    for picked in combinations(range(2 * len(A)), len(A)):
        V = vectors[:, picked]
        if np.linalg.cond(V[: len(A)]) > 1e6:
            continue
        P = V[len(A) :] @ np.linalg.inv(V[: len(A)])
        if np.abs(P.imag).max() < 1e-9 * np.abs(P).max():
            yield np.linalg.solve(R, B.T @ P.real), bool(values[list(picked)].real.max() < 0)


@pytest.mark.parametrize(
    "seed", [*range(12), *(pytest.param(s, marks=pytest.mark.slow) for s in range(12, 60))]
)
def test_the_package_s_gains_pass_in_any_units_and_others_do_not(seed):
    rng = np.random.default_rng(seed)
    A, B, Q, R = random_plant(rng)
    K = gain(A, B, Q, R)
    assert judged(A, B, Q, R, K) == "holds"
    i, j = rng.integers(len(R)), rng.integers(len(A))
    size = np.sqrt((Q + K.T @ R @ K)[j, j] / R[i, i])
    for sign in (-1, 1):
        other = K.copy()
        other[i, j] += sign * 1e-3 * size  # a small entry in its own units, next to large ones
        assert judged(A, B, Q, R, other) != "holds"
    assert judged(A, B, Q, R, 2 * K) != "holds"
    assert judged(A, B, Q, R, -K) != "holds"


@pytest.mark.parametrize("seed", range(8))
def test_no_other_solution_of_the_riccati_equation_passes(seed):
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(1, 5)), int(rng.integers(1, 3))
    A, B, Q, R = rng.normal(size=(n, n)), rng.normal(size=(n, m)), np.eye(n), np.eye(m)
    solutions = list(all_solutions(A, B, Q, R))
    assert sum(stable for _, stable in solutions) == 1 and len(solutions) >= 2
    for K, stable in solutions:
        assert (judged(A, B, Q, R, K) == "holds") == stable


def test_a_stable_plant_may_be_left_alone():
    A, B = -np.eye(2), np.eye(2)
    assert judged(A, B, np.zeros(2), np.ones(2), np.zeros((2, 2))) == "holds"
    K = gain(A, B, np.diag([0.0, 1.0]), np.eye(2))
    assert judged(A, B, np.array([0.0, 1.0]), np.ones(2), K) == "holds"


@pytest.mark.parametrize(
    ("Q", "R"),
    [
        *(([1.0, -0.5], [1.0]), ([1.0, 1.0], [-1.0]), ([1.0, 1.0], [0.0])),
        *(([[1.0, 2.0], [2.0, 1.0]], [1.0]), ([1.0], [1.0])),
    ],
)
def test_weights_that_weigh_nothing_are_refused(Q, R):
    A, B = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]])
    assert judged(A, B, Q, R, gain(A, B, np.eye(2), np.eye(1))) == "Rejected"


@pytest.mark.parametrize(
    "A", [[[0.0]], [[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0], [0.0, -1.0]], [[0.0, 1.0], [0.0, 0.0]]]
)
def test_what_neither_decays_nor_grows_is_not_called_stable(A):
    with pytest.raises((Rejected, Undecided)):
        check_hurwitz(matrix(A), "it")
