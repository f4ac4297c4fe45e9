"""Rows carried backwards: scales, carriers, remainders and the rounding that is booked for them."""

from unittest import mock

import numpy as np
import pytest
from hypothesis import HealthCheck, given, reject, settings
from hypothesis import strategies as st
from scipy import sparse
from scipy.linalg import expm

from reach import Interval, LinearSystem, Unresolved, Zonotope, support_tube
from reach.numerics.exponentials import Action, exponential, flushed, thin_expm
from reach.tubes.adjoint import Adjoint
from reach.tubes.rows import ExponentialRows, balance
from tests.reach import truth

Exact = np.longdouble


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
    assert np.all(tube.attained[-1] <= value)
    assert np.all(value <= tube.upper[-1])
    # ... and not so much that nothing is left.
    assert np.all(tube.upper[-1] - tube.attained[-1] <= 1e-7 * truth.size(system, X, D))


@pytest.mark.parametrize("make", [np.asarray, sparse.csr_matrix])
@pytest.mark.parametrize("steps", [1, 7, 64, 200])
def test_every_carrier_carries_rows_exactly(make, steps):
    rng = np.random.default_rng(3)
    A = rng.normal(size=(6, 6)) * 3
    rows = ExponentialRows(LinearSystem(make(A)))
    D = rng.normal(size=(2, 6))
    out = rows.carry(D * rows.scale, 1 / steps, steps) / rows.scale
    assert np.allclose(out[-1], D @ expm(A), rtol=1e-11, atol=1e-9)
    assert np.allclose(out[steps // 2], D @ expm(A * (steps // 2) / steps), rtol=1e-11, atol=1e-9)


@given(truth.cases(), st.floats(-3, 2))
@settings(max_examples=60)
def test_exponentials_are_those_of_scipy(case, length):
    A, t = case[0].A, 10.0**length / max(np.abs(case[0].A).sum(axis=1).max(), 1e-3)
    want = expm(A * t)
    size = np.abs(want).max()
    for kept in (A, sparse.csr_matrix(A)):
        assert np.allclose(
            exponential(kept, t), want, rtol=0, atol=1e-11 * size * max(1, t * np.abs(A).max())
        )
    assert np.allclose(
        exponential(np.stack([A, -A]), t)[0], want, rtol=0, atol=1e-10 * size * max(1, 10**length)
    )


@pytest.mark.skipif(np.finfo(Exact).eps > 1e-18, reason="no extended precision here")
@pytest.mark.parametrize("rate", [1.0, 62.0, 185.0])
def test_rows_that_decay_are_exact_relative_to_themselves(rate):
    A = np.array([[-0.2, 0.3, -0.2], [0.0, -8.0, -1.0], [0.0, 0.0, -rate]])
    want = np.exp(-Exact(rate))
    for kept in (A, sparse.csr_matrix(A)):
        assert abs(exponential(kept, 1.0)[2, 2] / want - 1) < 1e-15 * (8 + 4 * rate)


@given(st.integers(0, 10_000), st.floats(-6, 6), st.integers(1, 90), st.floats(-3, 2))
@settings(max_examples=40)
def test_the_action_of_an_exponential_is_that_of_the_dense_one(seed, spread, count, length):
    rng = np.random.default_rng(seed)
    A = sparse.random(12, 12, 0.2, random_state=seed).tocsr() * 4 - sparse.diags(rng.uniform(0, 20, 12))
    # Rows of any size beside one another: none is as inexact as the largest.
    v = rng.normal(size=(3, 12)) * 10.0 ** (spread * np.arange(3))[:, None]
    t = 10.0**length / 50
    out = Action(A.T)(v, t / count, count)[-1]
    assert np.allclose(out, v @ expm(A.toarray() * t), rtol=0, atol=1e-12 * np.abs(v).max(axis=1)[:, None])


@pytest.mark.parametrize("length", [0.01, 0.3, 2.0, 20.0])
def test_thin_expms_are_those_of_scipy(length):
    chain = sparse.diags([np.ones(199), -2 * np.ones(200), np.ones(199)], [-1, 0, 1])
    A = sparse.bmat([[None, sparse.identity(200)], [chain, 0.1 * chain]], format="csr")
    want = expm(A.toarray() * length)
    half = thin_expm(A, length / 2, Action(A))
    exps = [thin_expm(A, length, Action(A)), None if half is None else thin_expm(A, length, Action(A), half)]
    assert length > 0.3 or exps[0] is not None
    for one in exps:
        if one is not None:
            assert sparse.issparse(one) and one.nnz < A.shape[0] ** 2 * (0.2 if length < 1 else 0.6)
            assert np.abs(one.toarray() - want).max() < 1e-13 * (1 + 4 * length)


def test_an_exponential_that_is_full_is_left_to_its_action():
    rng = np.random.default_rng(0)
    A = sparse.random(700, 700, 0.01, random_state=0).tocsr() - sparse.diags(rng.uniform(1, 2, 700))
    assert thin_expm(A, 1.0, Action(A)) is None
    assert thin_expm(A, 1e9, Action(A)) is None


@pytest.mark.parametrize("kind", ["waves", "full", "growing"])
def test_large_sparse_systems_are_followed_as_dense_ones(kind):
    rng, m = np.random.default_rng(1), 160
    chain = sparse.diags([np.ones(m - 1), -2 * np.ones(m), np.ones(m - 1)], [-1, 0, 1])
    if kind == "full":
        A = sparse.random(2 * m, 2 * m, 0.02, random_state=1).tocsr() - 2 * sparse.identity(2 * m)
    else:
        A = sparse.bmat(
            [
                [None, sparse.identity(m)],
                [30 * chain, (0.5 if kind == "growing" else -0.1) * sparse.identity(m)],
            ]
        )
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
    for kept in (A, sparse.csr_matrix(A)):
        rows = ExponentialRows(LinearSystem(kept))
        v = np.abs(case[2].normal(size=(len(A), 2)))
        bound = rows.closing(h, v)
        balanced = A * rows.scale / rows.scale[:, None]
        for s in np.linspace(0, h, 7):
            grown = np.abs(expm(balanced * s)) @ v
            assert np.all(grown <= bound * (1 + 1e-9) + 1e-12 * np.abs(grown).max())


def test_closing_that_overflows_is_infinite_not_nan():
    rows = ExponentialRows(LinearSystem([[0.0, 1e6], [-1e6, 0.0]]))
    assert np.all(np.isinf(rows.closing(1.0, np.ones((2, 1)))))


@pytest.mark.parametrize(
    "A",
    [
        np.zeros((3, 3)),
        np.diag([1.0, 2.0], 1),
        np.array([[0.0, 1e9], [0.0, 0.0]]),
        np.array([[-1.0, 1e6], [0.0, -2.0]]),
        np.array([[-1.0, 1e-9, 1e9], [1e9, -1.0, 0.0], [0.0, 0.0, 0.0]]),
        np.array([[5.0]]),
    ],
)
def test_balancing_is_finite_and_never_makes_a_norm_much_larger(A):
    for kept in (A, sparse.csr_matrix(A)):
        s = balance(kept)
        assert np.all(np.isfinite(s)) and np.all(s > 0)
        assert np.all(np.log2(s) == np.round(np.log2(s)))
        before, after = np.abs(A).sum(axis=1).max(), np.abs(A * s / s[:, None]).sum(axis=1).max()
        assert after <= 1.5 * before


def test_a_constant_of_any_size_leaves_the_norm_alone():
    A = np.array([[0.0, 1.0, 1e6], [-1.0, -0.1, 1e8], [0.0, 0.0, 0.0]])
    assert ExponentialRows(LinearSystem(A)).norm < 4


def test_flushing_compares_entries_with_their_own_row():
    values = np.array([[1e80, 1e10], [1.0, 1e-70]])
    assert np.array_equal(flushed(values.copy()), [[1e80, 0.0], [1.0, 0.0]])
    thin = flushed(sparse.csr_matrix(values))
    assert np.array_equal(thin.toarray(), [[1e80, 0.0], [1.0, 0.0]])


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
            rate = np.array(
                [adjoint.supports(0, adjoint.row_products(row * adjoint.rows.scale)[0]) for row in rows]
            )
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
