"""Linear flows: the nodes are exact, the bounds between them hold, the worst case comes close."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from polaris.model.hill import clohessy_wiltshire
from polaris.synthesis.tracker.lqr import lqr_gain
from reach.numerics.errors import ReachError
from reach.numerics.linear import discretize, growth, powers
from reach.numerics.relaxation import clip_relaxation
from reach.sets.ellipsoid import Ellipsoid
from reach.sets.zonotope import Zonotope
from reach.tubes.flow import LinearFlow
from reach.tubes.systems import LinearSystem
from tests.reach import truth

SYSTEM = clohessy_wiltshire(0.0012, 10.0, 1.0, 1e-4)
GAIN = lqr_gain(SYSTEM, [1, 1, 1, 1e3, 1e3, 1e3], [1e4] * 3)
A_C = SYSTEM.A - SYSTEM.B @ GAIN


def flow(kind, h=10.0, w_max=1e-4):
    if kind == "continuous":
        return LinearFlow.continuous(A_C, SYSTEM.D, w_max, h)
    return LinearFlow.sampled(SYSTEM.A, SYSTEM.B, GAIN, SYSTEM.D, w_max, h)


@pytest.mark.parametrize("kind", ["continuous", "sampled"])
def test_disturbance_support_is_reached_by_the_closed_form_worst_case(kind):
    f = flow(kind, 5.0)
    rows = np.vstack([np.eye(6), GAIN])
    count, fine = 60, 64
    bound = f.disturbance_support(rows, count)[-1]
    A_x = A_C if kind == "continuous" else SYSTEM.A
    transition = powers(f.phi, count)
    kernel = np.array([expm(A_x * (j + 0.5) * 5.0 / fine) @ SYSTEM.D for j in range(fine)])
    for row, limit in zip(rows, bound, strict=True):
        # the exact support: integral of norm(row phi^l e^{A_x s} D) by a fine midpoint rule
        exact = np.linalg.norm(np.einsum("i,lij,sjk->lsk", row, transition[:count], kernel), axis=-1).sum()
        exact *= 5.0 / fine * 1e-4
        assert exact <= limit * (1 + 1e-6)
        assert limit <= exact * 1.03, "the directional gain is within 3 % of the worst case"


@pytest.mark.parametrize("kind", ["continuous", "sampled"])
@pytest.mark.parametrize(
    ("sizes", "same"),
    [
        ([1] * 6, 1e-7),
        ([1e3] * 3 + [1e-6] * 3, 1e-7),
        ([1e-6] * 3 + [1e3] * 3, 1e-7),
        ([1e3, 1, 1e-6, 1e-6, 1e3, 1], 1e-2),  # axes that hardly influence each other, in units of their own
    ],
)
def test_lyapunov_norm_contracts_and_does_not_depend_on_the_units(kind, sizes, same):
    plain, T = flow(kind), np.diag(sizes)
    back = np.linalg.inv(T)
    if kind == "continuous":
        other = LinearFlow.continuous(T @ A_C @ back, T @ SYSTEM.D, 1e-4, 10.0)
    else:
        other = LinearFlow.sampled(T @ SYSTEM.A @ back, T @ SYSTEM.B, GAIN @ back, T @ SYSTEM.D, 1e-4, 10.0)
    assert other.lyapunov[1] == pytest.approx(plain.lyapunov[1], rel=same)
    if same < 1e-6:
        np.testing.assert_allclose(other.norms(30), plain.norms(30), rtol=1e-5)
    W, factor = other.lyapunov
    e = np.random.default_rng(0).normal(size=(200, 6)) * [50, 50, 50, 1, 1, 1] @ T
    before, after = np.linalg.norm(e @ W.T, axis=1), np.linalg.norm(e @ other.phi.T @ W.T, axis=1)
    norms = plain.norms(30)
    assert np.all(after <= factor * before * (1 + 1e-12))
    assert np.all(np.diff(norms) <= 1e-12) and norms[0] == pytest.approx(1.0)


@pytest.mark.parametrize("kind", ["continuous", "sampled"])
def test_input_zonotope_holds_inputs_that_vary_within_the_period(kind):
    f, rng = flow(kind, 5.0), np.random.default_rng(0)
    sizes, parts = np.array([0.3, 0.1, 0.2]), 40
    enclosure = f.input_zonotope(SYSTEM.B, np.diag(sizes), np.abs(SYSTEM.B) @ sizes)
    D = np.vstack([np.eye(6), -np.eye(6), rng.normal(size=(20, 6))])
    step, push = discretize(f.A_x, SYSTEM.B, 5.0 / parts)
    kernel = np.array([D @ np.linalg.matrix_power(step, j) @ push for j in range(parts)])
    worst = np.abs(kernel).sum(axis=0) @ sizes  # bang-bang, a switch at any of the parts
    limit = enclosure.support(D)
    assert np.all(worst <= limit * (1 + 1e-12))
    constant = np.abs(kernel.sum(axis=0)) @ sizes
    assert np.all(constant <= worst * (1 + 1e-12))
    assert np.all(limit[3:6] <= 1.3 * worst[3:6]), "and it is not idle"


def test_unstable_loop_is_refused():
    with pytest.raises(ReachError, match="not stable"):
        LinearFlow.sampled(SYSTEM.A, SYSTEM.B, GAIN, SYSTEM.D, 0.0, 60.0).lyapunov  # noqa: B018


@given(st.integers(0, 1000), st.floats(0.01, 30))
@settings(max_examples=30)
def test_growth_bounds_the_exponential_over_the_whole_step(seed, h):
    A = np.random.default_rng(seed).normal(size=(4, 4)) / 10
    bound = growth(A, h)
    for s in np.linspace(0, h, 7):
        assert np.all(np.abs(expm(A * s)) <= bound * (1 + 1e-9))


@given(st.floats(-10, 10), st.floats(0, 10), st.floats(0, 5), st.sampled_from([None, 1, 8]), st.integers(0))
def test_clip_relaxation_holds_the_clip(lo, width, limit, slopes, seed):
    hi = lo + width
    slope, offset, radius = clip_relaxation(lo, hi, limit, slopes)
    inner = np.random.default_rng(seed).uniform(lo, hi, 50)
    y = np.concatenate([inner, [lo, hi], np.clip([-limit, limit], lo, hi)])
    errors = np.abs(np.clip(y, -limit, limit) - (slope * y + offset))
    assert np.all(errors <= radius + 1e-12 * (1 + abs(lo) + width))


@pytest.mark.parametrize(("lo", "hi", "limit"), [(1, 0, 1), (0, 1, -1), (np.nan, 1, 1), (0, np.inf, 1)])
def test_clip_relaxation_refuses_nonsense(lo, hi, limit):
    with pytest.raises(ReachError):
        clip_relaxation(lo, hi, limit)


RANDOM = [(kind, seed) for kind in truth.KINDS if kind != "zero" for seed in range(12)]


@pytest.mark.parametrize(("kind", "seed"), RANDOM)
def test_of_84_random_systems_nothing_that_is_reached_is_missed(kind, seed):
    """Stiff, unstable, lagging ones: closed form and worst inputs of the adjoint against all bounds."""
    rng, sampled = np.random.default_rng([seed, len(kind)]), seed % 2 == 0
    n, p, count, h, w_max = *rng.integers(1, 4, 2), 3, 0.25, 10.0 ** rng.uniform(-2, 1)
    A, D, B = truth.matrix(kind, n, rng), rng.normal(size=(n, p)), rng.normal(size=(n, 2))
    size = 1.0
    if kind == "units":
        size = np.abs(A).max(axis=1)
        D, B = D * size[:, None], B * size[:, None]
    K = rng.normal(size=(2, n)) * (rng.random() < 0.7) / size
    f = LinearFlow.sampled(A, B, K, D, w_max, h) if sampled else LinearFlow.continuous(A, D, w_max, h)
    rows = np.vstack([np.eye(n), -np.eye(n), rng.normal(size=(2, n)) / size])
    bound, within = f.disturbance_support(rows, count), f.period_zonotope
    stacks = f.disturbance_nodes(count), f.disturbance_nodes(count, together=2)
    ball, rest = Ellipsoid.ball(np.zeros(p), w_max), Zonotope.point(np.zeros(n))
    reached, attained = np.zeros(len(rows)), np.zeros(len(rows))
    times = np.linspace(0, h, 9)
    for k, images in enumerate(rows @ powers(f.phi, count - 1)):
        system = LinearSystem(A, D, ball)
        exact, error = truth.exact(system, rest, h, images, count=128)
        worst = np.array([truth.worst(system, rest, times, d) for d in images])
        grain = 1e-9 * np.abs(images) @ (f.growth @ np.abs(D).sum(axis=1)) * w_max
        assert np.all(exact - error <= within.support(images) + grain)
        assert np.all(worst <= within.support(images) + grain)
        reached, attained = reached + exact - error, attained + worst
        grain = grain + 1e-9 * np.abs(bound[k + 1])
        assert np.all(np.maximum(reached, attained) <= bound[k + 1] + grain)
        assert all(np.all(np.maximum(reached, attained) <= X[k + 1].support(rows) + grain) for X in stacks)
    assert np.all(np.abs(f.input_map(D) @ rng.uniform(-1, 1, p) * w_max / p) <= f.period_box * (1 + 1e-9))
    start = truth.body("zonotope", n, rng)
    intersample = f.intersample(start)
    for e in truth.vertices(start, 6, rng):
        for share in np.linspace(0, 1, 9):
            As, Bs = discretize(A, B, share * h)
            path, chord = (As - Bs @ K if sampled else As) @ e, (1 - share) * e + share * (f.phi @ e)
            assert np.all(np.abs(path - chord) <= intersample * (1 + 1e-9) + 1e-9 * np.abs(f.phi) @ np.abs(e))


def test_an_input_that_changes_sign_within_a_period_is_enclosed():
    """Along ``p - h v / 2`` a push early counts against, one late for: most is ``int |s - h / 2| ds``."""
    h, B = 0.5, np.array([[0.0], [1.0]])
    flow = LinearFlow.continuous(np.array([[0.0, 1.0], [0.0, 0.0]]), B, 0.0, h)
    reached = flow.input_zonotope(B, np.eye(1), np.abs(B) @ np.ones(1))
    assert reached.support(np.array([[1.0, -h / 2]]))[0] >= h**2 / 4
