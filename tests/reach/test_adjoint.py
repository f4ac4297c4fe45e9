"""Rows carried backwards: scales, carriers, remainders and the rounding that is booked for them."""

from unittest import mock

import numpy as np
import pytest
from hypothesis import HealthCheck, given, reject, settings
from hypothesis import strategies as st
from scipy import sparse
from scipy.linalg import expm

from reach import Interval, LinearSystem, Unresolved, Zonotope, support_tube
from reach.numerics.exponentials import exponential
from reach.tubes.adjoint import Adjoint
from reach.tubes.rows import ExponentialRows, balance
from tests.reach import truth

Exact = np.longdouble
UNEVEN = [[-1.0, 1e-9, 1e9], [1e9, -1.0, 0.0], [0.0, 0.0, 0.0]]


def carefully(A, t):
    """``e^{A t}`` in extended precision."""
    s = balance(A).astype(Exact)
    A = np.asarray(A, dtype=Exact) * s / s[:, None] * Exact(t)
    halvings = max(int(np.ceil(np.log2(max(float(np.abs(A).sum(axis=1).max()), 1e-30)))) + 3, 0)
    A = A / Exact(2) ** halvings
    term = total = np.eye(len(A), dtype=Exact)
    for k in range(1, 30):
        term = term @ A / k
        total = total + term
    for _ in range(halvings):
        total = total @ total
    return total * s[:, None] / s


@st.composite
def hidden_growth(draw):
    """A stable mode that a row sees alone but for rounding, beside one that grows."""
    n, rate = draw(st.integers(2, 4)), draw(st.floats(0.5, 30))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    V = rng.normal(size=(n, n)) + 2 * np.eye(n)
    values = np.r_[-1.0, rate, rng.normal(size=n - 2)]
    return np.linalg.inv(V) @ np.diag(values) @ V, V[0], rng


@pytest.fixture(params=["as it comes", "as if large"])
def size_of_sparse(request):
    """Sparse systems as small ones are treated, and by the ways of large ones: action and thin maps."""
    with mock.patch("reach.tubes.rows.DENSE", 0 if request.param == "as if large" else 300):
        yield


@pytest.mark.skipif(np.finfo(Exact).eps > 1e-18, reason="no extended precision here")
@given(hidden_growth(), st.integers(1, 400), st.booleans())
@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_rounding_is_booked_where_it_grows(size_of_sparse, case, steps, keep_sparse):
    A, d, rng = case
    x = rng.normal(size=len(A))
    system = LinearSystem(sparse.csr_matrix(A) if keep_sparse else A)
    try:
        tube = support_tube(system, Zonotope.point(x), 1.0, d, step=1 / steps)
    except Unresolved:
        reject()  # the step is too long for this one
    value = d.astype(Exact) @ carefully(A, 1.0) @ x.astype(Exact)
    assert tube.attained[-1, 0] <= value <= tube.upper[-1, 0]


@pytest.mark.skipif(np.finfo(Exact).eps > 1e-18, reason="no extended precision here")
@given(truth.cases(), st.integers(1, 300), st.booleans())
@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_rounding_is_booked_for_systems_of_every_kind(size_of_sparse, case, steps, keep_sparse):
    system, X, rng = case
    x, A = X.support_vector(rng.normal(size=system.dim)), system.A
    D = np.vstack([np.eye(len(A)), rng.normal(size=(2, len(A)))])
    free = LinearSystem(sparse.csr_matrix(A) if keep_sparse else A)
    tube = support_tube(free, Zonotope.point(x), 1.0, D, step=1 / steps)
    value = D.astype(Exact) @ carefully(A, 1.0) @ x.astype(Exact)
    assert np.all(tube.attained[-1] <= value) and np.all(value <= tube.upper[-1])
    # ... and not so much that nothing is left.
    assert np.all(tube.upper[-1] - tube.attained[-1] <= 1e-7 * truth.size(system, X, D))


@given(truth.cases(), st.floats(-3, 2))
@settings(max_examples=60)
def test_exponentials_are_those_of_scipy(case, length):
    A, t = case[0].A, 10.0**length / max(np.abs(case[0].A).sum(axis=1).max(), 1e-3)
    expected = expm(A * t)
    size = np.abs(expected).max()
    for matrix in (A, sparse.csr_matrix(A)):
        slack = 1e-11 * size * max(1, t * np.abs(A).max())
        assert np.allclose(exponential(matrix, t), expected, rtol=0, atol=slack)
    slack = 1e-10 * size * max(1, 10**length)
    assert np.allclose(exponential(np.stack([A, -A]), t)[0], expected, rtol=0, atol=slack)


@pytest.mark.skipif(np.finfo(Exact).eps > 1e-18, reason="no extended precision here")
@pytest.mark.parametrize("rate", [1.0, 62.0, 185.0])
def test_rows_that_decay_are_exact_relative_to_themselves(rate):
    A = np.array([[-0.2, 0.3, -0.2], [0.0, -8.0, -1.0], [0.0, 0.0, -rate]])
    expected = np.exp(-Exact(rate))
    for matrix in (A, sparse.csr_matrix(A)):
        assert abs(exponential(matrix, 1.0)[2, 2] / expected - 1) < 1e-15 * (8 + 4 * rate)


@pytest.mark.parametrize("kind", ["waves", "full", "growing"])
def test_large_sparse_systems_are_followed_as_dense_ones(kind):
    rng, m = np.random.default_rng(1), 160
    chain = sparse.diags([np.ones(m - 1), -2 * np.ones(m), np.ones(m - 1)], [-1, 0, 1])
    if kind == "full":
        A = sparse.random(2 * m, 2 * m, 0.02, random_state=1).tocsr() - 2 * sparse.identity(2 * m)
    else:
        damping = 0.5 if kind == "growing" else -0.1
        A = sparse.bmat([[None, sparse.identity(m)], [30 * chain, damping * sparse.identity(m)]])
    B = sparse.csr_matrix(rng.normal(size=(2 * m, 2)))
    U, X = Interval([-1, -1], [1, 2]), Interval(-np.ones(2 * m), np.ones(2 * m))
    D = np.vstack([np.eye(2 * m)[3], rng.normal(size=2 * m)])
    thin = support_tube(LinearSystem(A.tocsr(), B, U), X, 3.0, D, step=1 / 50)
    dense = support_tube(LinearSystem(A.toarray(), B.toarray(), U), X, 3.0, D, step=1 / 50)
    assert ExponentialRows(LinearSystem(A.tocsr())).action is not None
    for name in ("upper", "attained", "interval"):
        a, b = getattr(thin, name), getattr(dense, name)
        assert np.all(np.abs(a - b) <= 1e-7 * np.abs(b).max(axis=0))  # as rounding is booked
    assert np.all(thin.attained <= dense.upper) and np.all(dense.attained <= thin.upper)


@given(truth.cases(), st.floats(0.01, 1))
@settings(max_examples=40)
def test_closing_bounds_the_exponential_within_a_step(case, h):
    A = case[0].A
    for matrix in (A, sparse.csr_matrix(A)):
        rows = ExponentialRows(LinearSystem(matrix))
        v = np.abs(case[2].normal(size=(len(A), 2)))
        bound = rows.closing(h, v)
        balanced = A * rows.scale / rows.scale[:, None]
        for s in np.linspace(0, h, 7):
            propagated = np.abs(expm(balanced * s)) @ v
            assert np.all(propagated <= bound * (1 + 1e-9) + 1e-12 * np.abs(propagated).max())


@pytest.mark.parametrize(
    "A", [np.zeros((3, 3)), np.diag([1.0, 2.0], 1), [[0, 1e9], [0, 0]], [[-1, 1e6], [0, -2]], [[5.0]], UNEVEN]
)
def test_balancing_is_finite_and_never_makes_a_norm_much_larger(A):
    A = np.asarray(A, dtype=float)
    for matrix in (A, sparse.csr_matrix(A)):
        s = balance(matrix)
        assert np.all(np.isfinite(s)) and np.all(s > 0)
        assert np.all(np.log2(s) == np.round(np.log2(s)))
        before, after = np.abs(A).sum(axis=1).max(), np.abs(A * s / s[:, None]).sum(axis=1).max()
        assert after <= 1.5 * before


def test_flushed_rows_lose_less_than_is_booked():
    x = Interval([0.0, 1e12], [0.0, 1e12])
    tube = support_tube(LinearSystem(np.diag([0.0, -140.0])), x, 1.0, [[1.0, 1.0]], step=0.1)
    assert tube.upper[-1, 0] >= 1e12 * np.exp(-140.0)


@given(truth.cases(), st.integers(1, 30))
@settings(max_examples=40)
def test_parts_of_a_block_bound_what_they_say(case, steps):
    system, X, rng = case
    adjoint, h = Adjoint(system, X), 1 / steps
    D = rng.normal(size=(2, system.dim))
    block = adjoint.block(D * adjoint.rows.scale, h, steps)
    slack = 1e-11 * truth.size(system, X, D)
    for k in {0, steps // 2, steps - 1}:
        for share in (0.25, 0.5, 0.75):
            row = D @ expm(system.A * (k + share) * h)
            line = (1 - share) * block.first[k] + share * block.first[k + 1]
            assert np.all(X.support(row) <= line + 4 * share * (1 - share) * block.intersample[k] + slack)
        if adjoint.input_pieces:
            fine = h / 200
            rows = np.array([D @ expm(system.A * (k * h + (j + 0.5) * fine)) for j in range(200)])
            scaled = (adjoint.row_products(row * adjoint.rows.scale)[0] for row in rows)
            rate = np.array([adjoint.supports(0, row) for row in scaled])
            total, spread = rate.sum(axis=0) * fine, np.abs(np.diff(rate, axis=0)).sum(axis=0) * fine / 50
            assert np.all(total <= block.upper[k, 0] + spread + slack)
            assert np.all(block.lower[k, 0] <= total + spread + slack)
            half = rate[:100].sum(axis=0) * fine
            assert np.all(half <= total / 2 + block.bend[k, 0] + spread + slack)


def test_what_inputs_add_is_bounded_where_their_rate_changes_most_in_the_middle_of_a_step():
    """Half a turn of an oscillator in one step: at both ends the rate is even, in between it is steepest."""
    system = LinearSystem([[0.0, 1.0], [-4.0, 0.0]], [[1.0], [0.0]], Interval([-1.0], [1.0]))
    adjoint, h = Adjoint(system, Interval([0.0, 0.0], [0.0, 0.0])), np.pi / 2
    block = adjoint.block(np.array([[1.0, 0.0]]) * adjoint.rows.scale, h, 1)
    assert block.upper[0, 0, 0] >= 1.0  # the integral of |cos 2 t|
    quarter = np.sin(2 * h / 4) / 2  # by a quarter of the step, where the line between the nodes says 1 / 4
    assert quarter <= 1 / 4 + block.bend[0, 0, 0] * 3 / 4
