"""Set operations against sampled truth, and tight cases that show the enclosures are not vacuous."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from reach.numerics.errors import ReachError
from reach.sets.ellipsoid import ball_generators
from reach.sets.zonotope import Zonotope

# Eighths: exact in binary, and never so small beside the centre that the points themselves are rounded.
numbers = st.integers(-800, 800).map(lambda v: v / 8)


@st.composite
def zonotopes(draw, n=None, g=None):
    n = n or draw(st.integers(1, 4))
    g = draw(st.integers(0, 7)) if g is None else g
    return Zonotope(draw(arrays(float, n, elements=numbers)), draw(arrays(float, (n, g), elements=numbers)))


@st.composite
def pairs(draw):
    n = draw(st.integers(1, 4))
    return draw(zonotopes(n=n)), draw(zonotopes(n=n))


def points(z, count=60, seed=0):
    return z.sample(np.random.default_rng(seed), count)


def supports(z, directions):
    return z.support(directions)


def directions(n, seed=1):
    d = np.random.default_rng(seed).normal(size=(24, n))
    return np.vstack([d, np.eye(n), -np.eye(n)])


def below(values, bound):
    return np.all(values <= bound + 1e-9 * (1 + np.abs(bound)))


@given(zonotopes())
def test_support_bounds_every_point_and_is_attained(z):
    D = directions(z.dim)
    assert below((points(z) @ D.T).max(axis=0), z.support(D))
    for d in D[:4]:
        assert np.isclose(d @ z.support_vector(d), z.support(d[None])[0], rtol=1e-9, atol=1e-9)


@given(pairs())
def test_minkowski_sum_is_exact_in_every_direction(pair):
    a, b = pair
    D = directions(a.dim)
    assert np.allclose((a + b).support(D), a.support(D) + b.support(D), rtol=1e-9, atol=1e-7)


@given(zonotopes(n=3), arrays(float, (2, 3), elements=numbers))
def test_linear_image_holds_the_images_of_points(z, M):
    D = directions(2)
    assert below((points(z) @ M.T @ D.T).max(axis=0), (M @ z).support(D))
    assert np.allclose((M @ z).support(D), z.support(D @ M), rtol=1e-9, atol=1e-6)


@given(zonotopes(n=3, g=5), zonotopes(n=3, g=5), st.floats(0, 1))
def test_hull_holds_every_mixture_of_corresponding_points(a, b, s):
    rng = np.random.default_rng(0)
    beta = rng.uniform(-1, 1, (40, 5))
    mix = (1 - s) * (a.c + beta @ a.G.T) + s * (b.c + beta @ b.G.T)
    D = directions(3)
    assert below((mix @ D.T).max(axis=0), a.hull(b).support(D))


def test_hull_of_a_set_with_itself_is_that_set():
    z = Zonotope([1.0, 2.0], [[1.0, 0.5], [0.0, 2.0]])
    D = directions(2)
    assert np.allclose(z.hull(z).support(D), z.support(D))


@given(zonotopes(), st.sampled_from(["pca", "girard"]), st.floats(1, 3))
def test_reduction_encloses_and_keeps_its_budget(z, method, order):
    small = z.reduce(order, method)
    assert small.order_count <= max(
        int(order * z.dim), z.order_count if z.order_count <= order * z.dim else 0
    )
    assert below(z.support(directions(z.dim)), small.support(directions(z.dim)))


def test_reduction_to_the_same_budget_changes_nothing():
    z = Zonotope([0.0, 0.0], [[1.0, 0.5], [0.0, 2.0]])
    assert z.reduce(1.0) is z


def test_reduction_of_aligned_generators_is_exact():
    z = Zonotope([0.0, 0.0], [[1.0, 0.5, 0.0, 0.25], [0.0, 0.0, 2.0, 0.0]])
    assert np.allclose(z.reduce(1.0, "girard").half_widths, z.half_widths)


@given(zonotopes(n=3), arrays(float, (3, 3), elements=numbers))
def test_norm_bound_holds_and_is_exact_for_a_point(z, W):
    norms = np.linalg.norm(points(z) @ W.T, axis=1)
    assert below(norms.max(), z.norm_bound(W))
    assert np.isclose(Zonotope.point(z.c).norm_bound(W), np.linalg.norm(W @ z.c), rtol=1e-9, atol=1e-9)


@settings(max_examples=25)
@given(zonotopes(n=2, g=4))
def test_contains_agrees_with_construction_and_with_support(z):
    inside = points(z, 10)
    assert z.contains(inside).all()
    d = directions(2)[0]
    outside = z.support_vector(d) + 0.01 * (1 + np.abs(z.half_widths).max()) * d / np.linalg.norm(d)
    assert not z.contains(outside[None])[0]


@pytest.mark.parametrize(("p", "ratio"), [(1, 1.0), (2, 1.03), (3, 1.10), (4, 2.0)])
def test_ball_enclosure_holds_the_ball_and_is_tight(p, ratio):
    G = ball_generators(p, 2.0)
    D = np.random.default_rng(0).normal(size=(4000, p))
    D /= np.linalg.norm(D, axis=1, keepdims=True)
    support = np.abs(D @ G).sum(axis=1)
    assert support.min() >= 2.0 * (1 - 1e-12)
    assert support.max() <= 2.0 * ratio * (1 + 1e-9)


def test_batches_behave_like_their_members():
    rng = np.random.default_rng(0)
    members = [Zonotope(rng.normal(size=3), rng.normal(size=(3, 4))) for _ in range(5)]
    stack, M = Zonotope.stack(members), rng.normal(size=(3, 3))
    assert len(stack) == 5
    for i, member in enumerate(members):
        assert np.allclose((M @ stack)[i].G, (M @ member).G)
        assert np.allclose(stack.norm_bound(M)[i], member.norm_bound(M))
        assert np.allclose(stack.support(directions(3))[i], member.support(directions(3)))


@pytest.mark.parametrize(
    ("build", "says"),
    [
        (lambda: Zonotope([0.0, 0.0], [[1.0]]), "generators must have shape"),
        (lambda: Zonotope([np.nan], [[1.0]]), "finite"),
        (lambda: Zonotope([0.0], [[np.inf]]), "finite"),
        (lambda: Zonotope.box([0.0], [-1.0]), "half-widths"),
        (lambda: np.eye(3) @ Zonotope([0.0, 0.0], np.eye(2)), "dimension 2"),
        (lambda: Zonotope([0.0], [[1.0]]) + Zonotope([0.0, 0.0], np.eye(2)), "dimensions 1 and 2"),
        (lambda: Zonotope([0.0, 0.0], np.eye(2)).reduce(0.5), "at least 1"),
        (lambda: Zonotope([0.0, 0.0], np.eye(2)).reduce(1, "best"), "method"),
        (lambda: Zonotope([0.0] * 2, np.ones((2, 20))).corners(), "more than"),
        (lambda: Zonotope([0.0], [[1.0]])[0], "cannot be indexed"),
        (lambda: ball_generators(0, 1.0), "dimension"),
        (lambda: ball_generators(2, -1.0), "radius"),
        (lambda: ball_generators(2, np.nan), "radius"),
    ],
)
def test_malformed_input_is_one_clear_error(build, says):
    with pytest.raises(ReachError, match=says):
        build()
