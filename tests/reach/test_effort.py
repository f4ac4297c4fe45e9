"""Costs of a tube, by counts, and the warnings of a wide one."""

import warnings

import numpy as np
import pytest
from scipy import sparse

import reach.sets.bases
import reach.sets.polytope
from reach import (
    Always,
    HPolytope,
    Interval,
    LinearSystem,
    Never,
    ReachWarning,
    Zonotope,
    support_tube,
    verify,
    zonotope_tube,
)
from reach.numerics.exponentials import Action, thin_expm
from reach.tubes.rows import ExponentialRows
from tests.reach import truth


def counted(monkeypatch):
    """Return a list that grows by one with every linear program solved."""
    solved, original = [], reach.sets.polytope.maximise

    def count(*arguments):
        solved.append(1)
        return original(*arguments)

    for module in (reach.sets.polytope, reach.sets.bases):
        monkeypatch.setattr(module, "maximise", count)
    return solved


@pytest.mark.parametrize("steps", [20, 200])
def test_a_polytope_as_input_or_initial_set_takes_a_few_programs(monkeypatch, steps):
    rng = np.random.default_rng(1)
    A, B = rng.normal(size=(4, 4)) - 2 * np.eye(4), rng.normal(size=(4, 2))
    U, X = Interval([-1.0, -0.5], [1.0, 0.5]), Interval(-np.ones(4), np.ones(4))
    want = support_tube(LinearSystem(A, B, U), X, 1.0, np.eye(4), step=1 / steps)
    solved = counted(monkeypatch)
    tube = support_tube(LinearSystem(A, B, U.to_polytope()), X.to_polytope(), 1.0, np.eye(4), step=1 / steps)
    assert len(solved) < 40
    assert np.all(tube.upper >= want.attained - 1e-9) and np.allclose(tube.upper, want.upper, rtol=1e-3)
    assert np.all(tube.attained <= want.upper + 1e-9)


@pytest.mark.parametrize("n, m", [(2, 9), (3, 12), (5, 14), (9, 24)])
def test_many_directions_agree_with_one_program_each(n, m):
    rng = np.random.default_rng(n)
    A = np.vstack([rng.normal(size=(m, n)), np.eye(n), -np.eye(n)])
    P = HPolytope(A, rng.uniform(0.5, 2, len(A)) + A @ rng.normal(size=n))
    D = np.vstack([rng.normal(size=(40, n)), A[:4], np.zeros((1, n))])
    one = np.array([P.support(d) for d in D])
    assert np.allclose(P.support(D), one, rtol=1e-8, atol=1e-8)
    assert np.all(P.support_up(D) >= P.support_down(D)) and np.all(P.contains(P.support_vector(D), 1e-9))
    degenerate = Zonotope(np.zeros(n), rng.normal(size=(n, n + 1))).to_polytope() if n < 5 else P
    assert np.allclose(degenerate.support(D), [degenerate.support(d) for d in D], rtol=1e-8, atol=1e-8)


def test_a_filled_matrix_in_a_sparse_container_is_handled_as_dense():
    rng = np.random.default_rng(0)
    filled = sparse.csr_matrix(rng.normal(size=(60, 60)) * (rng.random((60, 60)) < 0.5))
    assert not LinearSystem(filled).sparse and LinearSystem(sparse.identity(60)).sparse
    some = sparse.random(400, 400, 0.05, random_state=0).tocsr() - 2 * sparse.identity(400)
    assert LinearSystem(some).sparse and thin_expm(some, 1.0, Action(some)) is None


@pytest.mark.parametrize("rate", [1.0, 100.0])
@pytest.mark.parametrize("n", [2, 4, 8, 30])
def test_from_rest_the_default_tolerance_is_no_trouble(n, rate):
    """A chain from rest: the first state is nothing in the first steps, and little ever after."""
    A, B = rate * (np.diag(np.ones(n - 1), 1) - np.eye(n)), np.eye(n)[:, -1:]
    system, rest = LinearSystem(A, B, Interval([-1.0], [1.0])), Zonotope.point(np.zeros(n))
    tube = support_tube(system, rest, 10.0, np.eye(n))
    assert np.all(tube.most >= tube.reached) and np.all(
        tube.most < 1.1 * np.maximum(tube.reached, 1e-9 / rate)
    )
    assert zonotope_tube(system, rest, 10.0).nodes.half_widths.max() < 11.0
    row = np.eye(n)[:1]
    assert verify(system, rest, Always(HPolytope(row, [10.0])), 10.0)
    assert verify(system, rest, Never(HPolytope(np.vstack([row, -row]), [20.0, -15.0])), 10.0)


def test_long_steps_of_stiff_systems_are_cut_or_warned_of():
    for stiff in (1e3, 1e4):
        system = LinearSystem([[-stiff, stiff / 2], [0.0, -1.0]], [[0.0], [1.0]], Interval([-1.0], [1.0]))
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            tube = support_tube(system, Interval([-1.0, -1.0], [1.0, 1.0]), 1.0, np.eye(2), step=0.1)
        assert np.all(tube.most < 1.5)
    system = LinearSystem(np.diag([-1e8, -1.0]) + np.diag([5e7], 1), [[0.0], [1.0]], Interval([-1.0], [1.0]))
    with pytest.warns(ReachWarning, match="factor of up to"):
        support_tube(system, Interval([-1.0, -1.0], [1.0, 1.0]), 1.0, np.eye(2), step=0.1)


def test_short_steps_are_not_squared_up_from_nothing():
    """The exponential of a step is as exact after those of much shorter ones were asked for."""
    A = truth.matrix("random", 4, np.random.default_rng(3))
    fresh, used = ExponentialRows(LinearSystem(A)), ExponentialRows(LinearSystem(A))
    for i in range(40, 0, -1):
        used.map(0.1 * 2.0**-i)
    assert np.allclose(used.map(0.1), fresh.map(0.1), rtol=0, atol=4e-16)
