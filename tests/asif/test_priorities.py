"""What gives way where no input satisfies all conditions, against linear programs of another solver."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from polaris.rta.priorities import SPARE, least_violation
from polaris.rta.projection import FILTERED, SHORT, solve

CLOSE = 5e-3
"""Of the limit: what a spare of 1e-7 on rows that cannot be met may grow to between near-parallel rows."""


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


def shortages(G, bound, limit, u):
    """In parts of the limit, and the bounds they are measured from."""
    need = np.minimum(bound / limit, np.abs(G).sum(axis=1) * (1 - SPARE))
    return np.maximum(need - G @ u / limit, 0.0), need


def could_be_less(G, need, rank, short, m):
    """By how much the shortage of row m could be less without making any that counts more larger.

    Those of earlier ranks count more, and those of its own rank that are as large; smaller ones of its rank
    may grow until they are as large; later ranks do not count.
    """
    own, earlier = rank == rank[m], rank < rank[m]
    allowed = np.where(earlier, short, np.where(own, np.maximum(short, short[m]), np.inf))
    allowed[m] = np.inf
    kept = np.isfinite(allowed)
    rows = -G[kept] if kept.any() else None
    most = (allowed + 1e-7 - need)[kept] if kept.any() else None
    answer = linprog(-G[m], rows, most, bounds=[(-1, 1)] * G.shape[1])
    assert answer.status == 0
    return short[m] - max(need[m] + answer.fun, 0.0)


@given(st.integers(0, 10**6))
@settings(max_examples=25, deadline=None)
def test_no_shortage_can_be_made_less_but_at_the_cost_of_what_counts_more(seed):
    G, bound, desired, limit, rank = random_program(np.random.default_rng(seed))
    u = least_violation(G, bound, desired, limit, rank)
    assert u is not None and np.abs(u).max() <= limit
    some = G.any(axis=1)
    short, need = shortages(G[some], bound[some], limit, u)
    for m in np.flatnonzero(short > 1e-6):
        assert could_be_less(G[some], need, rank[some], short, m) < CLOSE
    np.testing.assert_array_equal(u, least_violation(G, bound, desired, limit, rank))


@pytest.mark.slow
def test_many_random_programs():
    rng = np.random.default_rng(1)
    for _ in range(1500):
        G, bound, desired, limit, rank = random_program(rng)
        u = least_violation(G, bound, desired, limit, rank)
        some = G.any(axis=1)
        short, need = shortages(G[some], bound[some], limit, u)
        for m in np.flatnonzero(short > 1e-6):
            assert could_be_less(G[some], need, rank[some], short, m) < CLOSE


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
        answer = linprog(
            np.zeros(G.shape[1]), -G[rows], -bound[rows] / limit - 1e-6, bounds=[(-1, 1)] * G.shape[1]
        )
        if answer.status != 0:
            break
        assert (bound[rows] / limit - G[rows] @ u / limit).max() <= 2e-9
        # What is there for the first ranks alone is not changed by any later row.
        worse = np.where(rows, bound, bound + 10 * limit)
        again = least_violation(G, worse, desired, limit, rank)
        assert (bound[rows] / limit - G[rows] @ again / limit).max() <= 2e-9


def test_a_hopeless_row_frees_no_row_of_an_earlier_rank_and_none_of_its_own_that_can_be_met():
    """One shortage for all, as it was, let the separation miss by as much as the sun could not have."""
    eye = np.eye(3)
    G, bound = np.array([eye[0], -eye[0], eye[1], eye[2]]), np.array([0.3, 53.0, 0.4, 0.6])
    u, status = solve(G, bound, np.zeros(3), 1.0, np.array([0, 8, 8, 2]))
    assert status == SHORT
    np.testing.assert_allclose(u, [0.3, 0.4, 0.6], atol=1e-6)
    u, status = solve(G, bound, np.zeros(3), 1.0, np.array([8, 0, 8, 2]))
    np.testing.assert_allclose(u, [-1.0, 0.4, 0.6], atol=1e-6)


def test_what_can_be_met_goes_the_old_way(monkeypatch):
    """No second program is asked where the first has a solution: the feasible case costs what it did."""
    monkeypatch.setattr("polaris.rta.projection.least_violation", None)
    u, status = solve(np.eye(3), np.array([0.5, 0.2, -1.0]), np.zeros(3), 1.0, np.arange(3))
    assert status == FILTERED
    np.testing.assert_allclose(u, [0.5, 0.2, 0.0], atol=1e-9)
