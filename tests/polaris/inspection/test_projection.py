"""The quadratic program against its optimality conditions and an enumeration of active sets."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog, minimize, nnls

from polaris.rta.projection import DESIRED, FAILED, FILTERED, SHORT, project_coupled, solve
from polaris.rta.projection import project as project_ranked

CLOSE = 1e-8


def project(G, bound, desired, limit):
    """All rows in one rank."""
    return project_ranked(G, bound, desired, limit, np.zeros(bound.shape, dtype=int))


def residuals(G, bound, desired, limit, u):
    """Primal residual, and stationarity with the best multipliers >= 0 on what holds with equality.

    Rows are taken with length 1, the limits count as rows.
    """
    size = len(desired)
    length = np.linalg.norm(G, axis=1)
    G, bound = G[length > 0] / length[length > 0, None], bound[length > 0] / length[length > 0]
    rows = np.vstack([G, np.eye(size), -np.eye(size)])
    least = np.concatenate([bound, np.full(2 * size, -limit)])
    slack = rows @ u - least
    active = slack < CLOSE
    stationarity = nnls(rows[active].T, u - desired)[1] if active.any() else np.linalg.norm(u - desired)
    return max(-slack.min(), 0.0), stationarity


def enumerated(G, bound, desired, limit):
    """Exact solution by trying every set of up to `size` rows with equality; None if infeasible."""
    size = len(desired)
    rows = np.vstack([G, np.eye(size), -np.eye(size)])
    least = np.concatenate([bound, np.full(2 * size, -limit)])
    best = None
    for count in range(size + 1):
        for chosen in combinations(range(len(rows)), count):
            C, d = rows[list(chosen)], least[list(chosen)]
            if count and np.linalg.matrix_rank(C) < count:
                continue
            u = desired + np.linalg.pinv(C) @ (d - C @ desired) if count else desired
            if (rows @ u >= least - 1e-9).all() and (
                best is None or np.linalg.norm(u - desired) < np.linalg.norm(best - desired)
            ):
                best = u
    return best


def random_problem(rng, M, v=3, K=1):
    G = rng.standard_normal((K, M, v)) * 10 ** rng.uniform(-3, 1, (K, M, 1))
    bound = rng.uniform(-1.5, 0.7, (K, M)) * np.linalg.norm(G, axis=2)
    return G, bound, rng.uniform(-2, 2, (K, v))


@pytest.mark.parametrize("M", [1, 2, pytest.param(4, marks=pytest.mark.slow)])
def test_the_projection_is_the_enumerated_one(M):
    rng = np.random.default_rng(M)
    G, bound, desired = random_problem(rng, M, K=60)
    answer = project(G, bound, desired, 1.0)
    for k in range(60):
        expected = enumerated(G[k], bound[k], desired[k], 1.0)
        if expected is None:
            assert answer.status[k] == SHORT
        else:
            assert answer.status[k] in (DESIRED, FILTERED)
            np.testing.assert_allclose(answer.u[k], expected, atol=CLOSE)


@given(st.integers(0, 10**6), st.integers(1, 30))
@settings(max_examples=30)
def test_optimality_conditions(seed, M):
    rng = np.random.default_rng(seed)
    G, bound, desired = random_problem(rng, M, K=20)
    for size in (20, 1):  # a batch, and one alone: two ways through the code
        batch = project(G[:size], bound[:size], desired[:size], 1.0)
        for k in np.flatnonzero(batch.status < SHORT):
            primal, stationarity = residuals(G[k], bound[k], desired[k], 1.0, batch.u[k])
            assert primal < CLOSE and stationarity < CLOSE
        for k in np.flatnonzero(batch.status >= SHORT):
            rows = G[k] / np.linalg.norm(G[k], axis=1, keepdims=True)
            tightening = bound[k] / np.linalg.norm(G[k], axis=1)
            answer = linprog(
                np.r_[0, 0, 0, 1],
                -np.c_[rows, np.ones(M)],
                -tightening,
                bounds=[(-1, 1)] * 3 + [(None, None)],
            )
            assert answer.fun > -1e-9, "called infeasible, but is not"
            # The worst violation is the least possible; what full thrust cannot give counts as full thrust.
            reach = np.minimum(tightening, np.abs(rows).sum(axis=1))
            least = linprog(
                np.r_[0, 0, 0, 1], -np.c_[rows, np.ones(M)], -reach, bounds=[(-1, 1)] * 3 + [(None, None)]
            )
            short = (reach - rows @ batch.u[k]).max()
            assert short <= max(least.fun, 0.0) + 1e-6
            assert np.abs(batch.u[k]).max() <= 1.0


def test_agrees_with_a_general_solver():
    rng = np.random.default_rng(10)
    G, bound, desired = random_problem(rng, 6, K=25)
    batch = project(G, bound, desired, 1.0)
    chosen = np.flatnonzero(batch.status == FILTERED)
    assert len(chosen) >= 5
    for k in chosen:
        rows = G[k] / np.linalg.norm(G[k], axis=1, keepdims=True)
        tightening = bound[k] / np.linalg.norm(G[k], axis=1)
        answer = minimize(
            lambda u, k=k: np.sum((u - desired[k]) ** 2),
            np.clip(desired[k], -1, 1),
            jac=lambda u, k=k: 2 * (u - desired[k]),
            bounds=[(-1, 1)] * 3,
            constraints={
                "type": "ineq",
                "fun": lambda u, r=rows, b=tightening: r @ u - b,
                "jac": lambda u, r=rows: r,
            },
            method="SLSQP",
            options={"ftol": 1e-14, "maxiter": 200},
        )
        if answer.success and (rows @ answer.x - tightening).min() > -1e-9:
            np.testing.assert_allclose(batch.u[k], answer.x, atol=1e-5)


@given(st.integers(0, 10**6))
@settings(max_examples=60)
def test_what_satisfies_everything_is_left_alone(seed):
    rng = np.random.default_rng(seed)
    G, _, desired = random_problem(rng, 8, K=30)
    desired = np.clip(desired, -1, 1)
    bound = np.einsum("kmv,kv->km", G, desired) - rng.choice([0.0, 1e-9, 1.0], (30, 8)) * np.abs(
        rng.standard_normal((30, 8))
    )
    exact = (np.einsum("kmv,kv->km", G, desired) >= bound + 1e-9).all(axis=1)
    answer = project(G, bound, desired, 1.0)
    assert (answer.u[exact] == desired[exact]).all()
    np.testing.assert_allclose(answer.u, desired, atol=1e-7)
    # One alone goes to the solver; the filters look first whether there is anything to do.
    one = project(G[:1], bound[:1], desired[:1], 1.0)
    np.testing.assert_allclose(one.u, desired[:1], atol=1e-7)


@pytest.mark.parametrize("N", [2, 3, 5])
@pytest.mark.parametrize("K", [1, 12])
def test_coupled_inputs(N, K):
    """Rows on differences of inputs, some of them on one input alone."""
    rng = np.random.default_rng(N)
    pairs = list(combinations(range(N), 2))
    first = np.array([i for i, _ in pairs] + list(range(N)) * 2)
    second = np.array([j for _, j in pairs] + [-1] * 2 * N)
    M = len(first)
    seen = 0
    for _ in range(12):
        G = rng.standard_normal((K, M, 3))
        bound = rng.uniform(-2.5, 0.3, (K, M))
        desired = rng.uniform(-1.5, 1.5, (K, N, 3))
        batch = project_coupled(G, bound, desired, 1.0, first, second, np.zeros(bound.shape, dtype=int))
        for k in range(K):
            wide = np.zeros((M, N, 3))
            for m in range(M):
                wide[m, first[m]] += G[k, m]
                if second[m] >= 0:
                    wide[m, second[m]] -= G[k, m]
            wide = wide.reshape(M, -1)
            assert np.isfinite(batch.u[k]).all() and np.abs(batch.u[k]).max() <= 1
            if batch.status[k] < SHORT:
                primal, stationarity = residuals(wide, bound[k], desired[k].ravel(), 1.0, batch.u[k].ravel())
                assert primal < CLOSE and stationarity < CLOSE
                seen += 1
    assert seen > 5


def test_hopeless_programs_get_a_finite_input():
    """Contradictions, rows of zeros, bounds out of all reach, infinite bounds."""
    eye = np.eye(3)
    cases = [
        (np.array([eye[0], -eye[0]]), [0.5, 0.5]),
        (np.array([eye[0], 0 * eye[0]]), [0.2, 1.0]),
        (np.array([eye[0], 1e-14 * eye[1]]), [0.2, 1.0]),
        (np.array([eye[0], eye[1]]), [1e15, 0.3]),
        (np.array([eye[0], eye[1]]), [np.inf, 0.3]),
        (np.array([0 * eye[0]]), [np.inf]),
        (np.array([0 * eye[0], 0 * eye[0]]), [1e-9, 5.0]),
    ]
    for G, bound in cases:
        for copies in (1, 9):
            with np.errstate(all="raise", under="ignore"):
                answer = project(
                    np.stack([G] * copies), np.array([bound] * copies), np.full((copies, 3), 0.1), 1.0
                )
            assert (answer.status == SHORT).all(), bound
            assert np.isfinite(answer.u).all() and (np.abs(answer.u) <= 1).all()


def test_the_least_violation_serves_the_other_rows():
    """A row that cannot be met does not keep the others from being met."""
    G, bound = np.eye(3)[:2], np.array([2.0, 0.5])
    u, status = solve(G, bound, np.zeros(3), 1.0, np.zeros(2, dtype=int))
    assert status == SHORT and u[0] == pytest.approx(1.0)
    assert u[1] == pytest.approx(0.5)
    nothing, status = solve(G, bound, np.zeros(3), 1.0)
    assert status == FAILED and np.isnan(nothing).all(), "without ranks there is no second program"
