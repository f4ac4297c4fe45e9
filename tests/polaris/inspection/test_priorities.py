"""Least violation where no input satisfies all conditions, against linear programs of another solver."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog, nnls

from polaris.inspection.constraints.families import Families
from polaris.inspection.filters.asif import ActiveSetFilter
from polaris.inspection.filters.explicit import make_filter
from polaris.inspection.inspection import Inspection
from polaris.rta import priorities, vertex
from polaris.rta.priorities import EXACT, GAP, MET, SPARE, SURE, least_violation
from polaris.rta.projection import FAILED, FILTERED, SHORT, project, solve
from polaris.rta.vertex import lowest

STATED = (SPARE + GAP) / SURE
"""Of the limit: what a shortage may be larger than need be if no row that counts more may lose anything."""


def random_program(rng):
    """Rows on the inputs of 1, 2 or 5 deputies: contradictions, bounds out of reach, rows of zeros."""
    v, M, limit = int(rng.choice([3, 6, 15])), int(rng.integers(2, 25)), 10 ** rng.uniform(-3, 2)
    G = rng.standard_normal((M, v))
    if rng.random() < 0.5:
        G *= np.repeat(np.eye(v // 3)[rng.integers(0, v // 3, M)], 3, axis=1)
    G /= np.linalg.norm(G, axis=1, keepdims=True)
    if rng.random() < 0.4:
        G[rng.integers(M)] = -G[rng.integers(M)]
    bound = rng.uniform(-1, 1.5, M) * limit
    if rng.random() < 0.3:
        bound[rng.integers(M)] = rng.choice([np.inf, 1e3 * limit, 1e9 * limit])
    if rng.random() < 0.1:
        G[rng.integers(M)] = 0.0
    rank = rng.integers(0, int(rng.choice([1, 3, 8])), M)
    return G, bound, rng.standard_normal(v) * limit, limit, rank


def odd_program(rng, least_angle=1e-6):
    """Nearly parallel rows, exact contradictions, any lengths, rows of zeros, ranks that no row has."""
    N, M, limit = int(rng.choice([1, 2, 3, 5, 8])), int(rng.integers(1, 31)), 10 ** rng.uniform(-6, 6)
    v = 3 * N
    G = rng.standard_normal((M, v))
    if (kind := rng.integers(3)) == 1:
        G = rng.integers(-1, 2, (M, v)).astype(float)
    elif kind == 2:  # on one deputy, or on a pair
        first, second = np.eye(N)[rng.integers(0, N, M)], np.eye(N)[rng.integers(0, N, M)]
        G = np.repeat(first - second * (rng.random(M) < 0.5)[:, None], 3, axis=1) * np.tile(G[:, :3], N)
    for _ in range(rng.integers(0, 1 + M // 2)):
        i, j = rng.integers(0, M, 2)
        angle = 10 ** rng.uniform(np.log10(least_angle), -1) * (rng.random() < 0.7)
        G[i] = rng.choice([-1.0, 1.0]) * G[j] + angle * rng.standard_normal(v)
    length = np.linalg.norm(G, axis=1)
    G[length > 0] /= length[length > 0, None]
    odd = rng.choice([-0.5, 0.0, 0.3, 2.0, 1e12, np.inf], M)
    tightening = [rng.uniform(-1, 1.5, M), np.round(rng.uniform(-4, 6, M)) / 4, odd][rng.integers(3)]
    scale = 10 ** rng.uniform(-6, 6, M)
    if rng.random() < 0.2:
        G[rng.integers(M)] = 0.0
    rank = rng.choice([-3, 0, 2, 5, 40], M) if rng.random() < 0.7 else np.zeros(M, dtype=int)
    return G * scale[:, None], tightening * scale * limit, rng.standard_normal(v) * limit, limit, rank


def of_length_1(G, tightening, rank):
    """Rows of length 1, and what they need of what full thrust gives."""
    nonzero = G.any(axis=1)
    length = np.linalg.norm(G[nonzero], axis=1)
    G = G[nonzero] / length[:, None]
    return G, np.minimum(tightening[nonzero] / length, np.abs(G).sum(axis=1) * (1 - SPARE)), rank[nonzero]


def witnessed(G, tightening, rank, short, m):
    """By how much the shortage of row m can be less without making any that counts more larger, if shown.

    Those of earlier ranks count more, and those of its own rank that are as large; smaller ones of its rank
    may grow until they are as large; later ranks do not count.
    """
    same_rank, earlier = rank == rank[m], rank < rank[m]
    allowed = np.where(earlier, short, np.where(same_rank, np.maximum(short, short[m]), np.inf))
    allowed[m] = np.inf
    finite = np.isfinite(allowed)
    rows, least = (
        (G[finite], (tightening - allowed)[finite]) if finite.any() else (np.zeros((1, G.shape[1])), [-1.0])
    )
    sharp = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}
    answer = linprog(-G[m], -rows, -np.asarray(least), bounds=[(-1, 1)] * G.shape[1], options=sharp)
    if answer.x is None or (least - rows @ np.clip(answer.x, -1, 1)).max() > EXACT:
        return None
    return short[m] - max(tightening[m] - G[m] @ np.clip(answer.x, -1, 1), 0.0)


def check_odd(programs):
    """Return the number of shortages that another solver looked at."""
    looked = 0
    for G, bound, desired, limit, rank in programs:
        u = least_violation(G, bound, desired, limit, rank)
        assert u is not None and np.abs(u).max() <= limit
        G, tightening, rank = of_length_1(G, bound / limit, rank)
        short = np.maximum(tightening - G @ u / limit, 0.0)
        for m in np.flatnonzero(short > 1e-6):
            less = witnessed(G, tightening, rank, short, m)
            looked += less is not None
            assert less is None or less < 1.01 * STATED, (less, m)
    return looked


@given(st.integers(0, 10**6))
@settings(max_examples=25, deadline=None)
def test_no_shortage_can_be_made_less_but_at_the_cost_of_what_counts_more(seed):
    program = random_program(np.random.default_rng(seed))
    check_odd([program])
    np.testing.assert_array_equal(least_violation(*program), least_violation(*program))


def test_odd_programs():
    rng = np.random.default_rng(2)
    assert check_odd(odd_program(rng) for _ in range(20)) > 100


def test_rows_parallel_to_rounding_get_an_answer_that_keeps_the_first_rank():
    rng = np.random.default_rng(4)
    for _ in range(25):
        G, bound, desired, limit, rank = odd_program(rng, 1e-15)
        u = least_violation(G, bound, desired, limit, rank)
        assert u is not None and np.abs(u).max() <= limit
        G, tightening, rank = of_length_1(G, bound / limit, rank)
        rows = rank == rank.min(initial=40)
        if not rows.any():
            continue
        alone = lowest(G[rows], tightening[rows], np.ones(rows.sum(), dtype=bool))
        short = (tightening[rows] - G[rows] @ u / limit).max()
        assert short <= alone[0][-1] + SPARE + MET


@pytest.mark.parametrize("M", [1, 3, 12])
def test_the_exact_program_agrees_with_another_solver(M):
    rng = np.random.default_rng(M)
    for v in (3, 9):
        G, tightening, free = rng.standard_normal((M, v)), rng.uniform(0, 2, M), rng.random(M) < 0.6
        free[0] = True
        G /= np.linalg.norm(G, axis=1, keepdims=True)
        tightening[~free] = 0.1
        cost, limits = np.append(np.zeros(v), 1.0), [(-1, 1)] * v + [(0, None)]
        answer = linprog(cost, -np.column_stack([G, free]), -tightening, bounds=limits)
        solution = lowest(G, tightening, free)
        assert (solution is None) == (answer.status == 2)
        if solution is not None:
            x, y = solution
            assert x[-1] == pytest.approx(answer.fun, abs=1e-9)
            assert (tightening - G @ x[:-1] - free * x[-1]).max() < 1e-15 * 10
            assert y @ tightening - np.abs(y @ G).sum() == pytest.approx(x[-1], abs=1e-12)


def test_where_the_solver_fails_no_rank_is_left_out(monkeypatch):
    """Its rows were dropped without a word, and later ranks served instead."""
    rng = np.random.default_rng(5)
    monkeypatch.setattr(priorities, "_by_active_set", lambda *_: None)
    assert check_odd(random_program(rng) for _ in range(6)) > 15
    monkeypatch.setattr(priorities, "_by_vertices", lambda *_: None)
    assert check_odd(random_program(rng) for _ in range(3)) > 5
    monkeypatch.setattr(priorities, "lowest", lambda *_: None)
    assert least_violation(np.eye(3), np.full(3, 2.0), np.zeros(3), 1.0, np.zeros(3, dtype=int)) is None


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("copies", [1, 3, 9])
def test_what_is_no_number_is_refused(value, copies):
    """A row of NaN was taken for one that is met. Only the program that holds it is refused."""
    bound, desired, rank = np.array([0.2, 0.3]), np.zeros(3), np.zeros((copies, 2), dtype=int)
    for at in ("row", "bound", "desired"):
        if at == "bound" and not np.isnan(value):
            continue  # infinite bounds have a meaning
        G, b, d = (np.array([a] * copies) for a in (np.eye(3)[:2], bound, desired))
        {"row": G, "bound": b, "desired": d}[at][0, 0] = value
        assert least_violation(G[0], b[0], d[0], 1.0, rank[0]) is None
        answer = project(G, b, d, 1.0, rank)
        assert answer.status[0] == FAILED and np.isnan(answer.u[0]).all()
        assert (answer.status[1:] == FILTERED).all() and np.isfinite(answer.u[1:]).all()
    for limit in (value, 0.0, -1.0):
        assert least_violation(np.eye(3), np.ones(3), desired, limit, rank[0, [0, 0, 0]]) is None


def test_no_rows_at_all():
    rank = np.zeros((9, 0), dtype=int)
    nothing = project(np.zeros((9, 0, 3)), np.zeros((9, 0)), np.full((9, 3), 2.0), 1.0, rank)
    np.testing.assert_allclose(nothing.u, 1.0)
    u = least_violation(np.zeros((2, 3)), np.ones(2), np.full(3, 0.5), 1.0, np.zeros(2, dtype=int))
    np.testing.assert_allclose(u, 0.5)


@given(st.integers(0, 10**6))
@settings(max_examples=40, deadline=None)
def test_whatever_later_ranks_ask_a_rank_that_can_be_met_is_met(seed):
    """Ranks from the first on, as long as they can be met together, are met to a billionth of the limit."""
    rng = np.random.default_rng(seed)
    G, bound, desired, limit, rank = random_program(rng)
    G, bound = G[G.any(axis=1)], bound[G.any(axis=1)]
    rank = rng.integers(0, 4, len(G))
    u = least_violation(G, bound, desired, limit, rank)
    for level in range(4):
        rows = rank <= level
        if not rows.any():
            continue
        if (bound[rows] == np.inf).any():
            break
        limits = [(-1, 1)] * G.shape[1]
        answer = linprog(np.zeros(G.shape[1]), -G[rows], -bound[rows] / limit - 1e-6, bounds=limits)
        if answer.status != 0:
            break
        assert (bound[rows] / limit - G[rows] @ u / limit).max() <= 2e-9
        # What is there for the first ranks alone is not changed by any later row.
        worse = np.where(rows, bound, bound + 10 * limit)
        u_worse = least_violation(G, worse, desired, limit, rank)
        assert (bound[rows] / limit - G[rows] @ u_worse / limit).max() <= 2e-9


def test_a_hopeless_row_frees_no_row_of_an_earlier_rank_and_none_of_its_own_that_can_be_met():
    """One shortage for all, as it was, let the separation miss by as much as the sun could not have."""
    eye = np.eye(3)
    G, bound = np.array([eye[0], -eye[0], eye[1], eye[2]]), np.array([0.3, 53.0, 0.4, 0.6])
    u, status = solve(G, bound, np.zeros(3), 1.0, np.array([0, 8, 8, 2]))
    assert status == SHORT
    np.testing.assert_allclose(u, [0.3, 0.4, 0.6], atol=1e-6)
    u, status = solve(G, bound, np.zeros(3), 1.0, np.array([8, 0, 8, 2]))
    np.testing.assert_allclose(u, [-1.0, 0.4, 0.6], atol=1e-6)
    u, status = solve(G, bound, np.zeros(3), 1.0)
    assert status == FAILED and np.isnan(u).all(), "without ranks there is no second program"


def test_what_can_be_met_goes_the_old_way(monkeypatch):
    """No second program is asked where the first has a solution: the feasible case costs what it did."""
    monkeypatch.setattr("polaris.rta.projection.least_violation", None)
    u, status = solve(np.eye(3), np.array([0.5, 0.2, -1.0]), np.zeros(3), 1.0, np.arange(3))
    assert status == FILTERED
    np.testing.assert_allclose(u, [0.5, 0.2, 0.0], atol=1e-9)


def test_fifty_deputies_anywhere_are_answered_without_exact_arithmetic(monkeypatch):
    """No thrust meets everything; what gives way is settled in floating point."""
    monkeypatch.setattr(vertex, "_exact", None)
    rng = np.random.default_rng(1)
    x = np.concatenate([rng.uniform(-600, 600, (3, 50, 3)), rng.uniform(-0.3, 0.3, (3, 50, 3))], axis=2)
    asif = ActiveSetFilter(make_filter(Families(Inspection(deputies=50)), "centralized"))
    decision = asif.filter(0.0, x[2], rng.uniform(-1, 1, (50, 3)))
    assert decision.status == "short" and decision.fallback is not None and len(decision.missed) > 20
    assert np.abs(decision.u).max() <= 1.0


CLOSE = 1e-8


def project_all(G, bound, desired, limit):
    """All rows in one rank."""
    return project(G, bound, desired, limit, np.zeros(bound.shape, dtype=int))


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


def random_problem(rng, M, v=3, K=1):
    G = rng.standard_normal((K, M, v)) * 10 ** rng.uniform(-3, 1, (K, M, 1))
    bound = rng.uniform(-1.5, 0.7, (K, M)) * np.linalg.norm(G, axis=2)
    return G, bound, rng.uniform(-2, 2, (K, v))


@given(st.integers(0, 10**6), st.integers(1, 30))
@settings(max_examples=30)
def test_optimality_conditions(seed, M):
    rng = np.random.default_rng(seed)
    G, bound, desired = random_problem(rng, M, K=20)
    for size in (20, 1):  # a batch, and one alone: two ways through the code
        batch = project_all(G[:size], bound[:size], desired[:size], 1.0)
        for k in np.flatnonzero(batch.status < SHORT):
            primal, stationarity = residuals(G[k], bound[k], desired[k], 1.0, batch.u[k])
            assert primal < CLOSE and stationarity < CLOSE
        for k in np.flatnonzero(batch.status >= SHORT):
            rows = G[k] / np.linalg.norm(G[k], axis=1, keepdims=True)
            tightening = bound[k] / np.linalg.norm(G[k], axis=1)
            matrix, limits = -np.c_[rows, np.ones(M)], [(-1, 1)] * 3 + [(None, None)]
            answer = linprog([0, 0, 0, 1], matrix, -tightening, bounds=limits)
            assert answer.fun > -1e-9, "called infeasible, but is not"
            # The worst violation is the least possible; what full thrust cannot give counts as full thrust.
            reach = np.minimum(tightening, np.abs(rows).sum(axis=1))
            least = linprog([0, 0, 0, 1], matrix, -reach, bounds=limits)
            short = (reach - rows @ batch.u[k]).max()
            assert short <= max(least.fun, 0.0) + 1e-6 and np.abs(batch.u[k]).max() <= 1.0


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
    answer = project_all(G, bound, desired, 1.0)
    assert (answer.u[exact] == desired[exact]).all()
    np.testing.assert_allclose(answer.u, desired, atol=1e-7)
    # One alone goes to the solver; the filters look first whether there is anything to do.
    one = project_all(G[:1], bound[:1], desired[:1], 1.0)
    np.testing.assert_allclose(one.u, desired[:1], atol=1e-7)


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
                answer = project_all(
                    np.stack([G] * copies), np.array([bound] * copies), np.full((copies, 3), 0.1), 1.0
                )
            assert (answer.status == SHORT).all(), bound
            assert np.isfinite(answer.u).all() and (np.abs(answer.u) <= 1).all()
