"""One protocol over all classes: the same members, the same signatures, the same mathematics."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from reach.numerics.errors import ReachError
from reach.sets.convex import ConvexSet
from reach.sets.ellipsoid import Ellipsoid
from reach.sets.interval import Interval
from reach.sets.lazy import AffineImage, MinkowskiSum
from reach.sets.polytope import HPolytope
from reach.sets.zonotope import Zonotope
from tests.reach.strategies import directions, numbers, polytopes, sets, size, some_points, vectors, zonotopes


def examples():
    square = HPolytope([[1, 0], [-1, 0], [0, 1], [0, -1]], [1, 1, 2, 2])
    return [
        Interval([-1, 0], [2, 3]),
        Zonotope([1, 2], [[1, 0.5, 0], [0, 1, 1]]),
        square,
        Ellipsoid([1, 0], [[2, 1], [0, 1]]),
        AffineImage([[1, 1], [0, 0]], square, [0, 1]),
        Ellipsoid.ball([0, 0], 1) + square,
    ]


@pytest.mark.parametrize("X", examples(), ids=lambda X: type(X).__name__)
def test_shapes_of_answers(X):
    assert isinstance(X, ConvexSet)
    assert X.center.shape == (2,) and X.extent.shape == (2,) and isinstance(X.terms, int)
    for lead in [(), (3,), (4, 3)]:
        D = np.ones((*lead, 2))
        assert X.support(D).shape == X.support_up(D).shape == X.support_down(D).shape == lead
        assert X.support_vector(D).shape == D.shape and X.contains(D).shape == lead
    assert X.center in X and np.all(X.support_down(np.eye(2)) <= X.support_up(np.eye(2)))


@settings(max_examples=25)
@given(sets())
def test_support_is_attained_and_bounds_every_point(X):
    D = directions(X.dim, 6)
    S, tol = X.support(D), 1e-8 * size(X)
    assert np.allclose((D * X.support_vector(D)).sum(axis=-1), S, atol=tol)
    assert np.all(some_points(X, 6) @ D.T <= S + tol)
    assert np.all(X.support_down(D) <= X.support_up(D)) and np.allclose(X.support_up(D), S, atol=tol)
    assert np.isclose(X.support(D[0]), S[0], atol=tol)


@settings(max_examples=25)
@given(sets())
def test_interval_hull_holds_the_set_and_touches_it(X):
    hull, eye = X.interval_hull(), np.eye(X.dim)
    assert np.all(hull.hi >= X.support_down(eye)) and np.all(-hull.lo >= X.support_down(-eye))
    assert np.allclose(hull.hi, X.support(eye), atol=1e-8 * size(X))
    assert np.allclose(-hull.lo, X.support(-eye), atol=1e-8 * size(X))


@settings(max_examples=25)
@given(sets())
def test_points_of_the_set_are_inside_and_points_beyond_are_not(X):
    D = directions(X.dim, 3)
    assert X.contains(some_points(X, 3)).all() or X.contains(some_points(X, 3), 1e-7).all()
    beyond = X.support_vector(D) + 0.05 * size(X) * D
    assert not X.contains(beyond).any()


@settings(max_examples=25)
@given(st.data(), st.integers(1, 3), st.integers(1, 3))
def test_operators_mean_what_they_mean_on_paper(data, n, m):
    X, Y = data.draw(sets(n)), data.draw(sets(n))
    M, v = data.draw(arrays(float, (m, n), elements=numbers)), data.draw(vectors(n))
    a = data.draw(numbers)
    D, E = directions(n, 3), directions(m, 3)
    tol = 1e-7 * size(X) * size(Y) * (1 + np.abs(M).max())
    assert np.allclose((M @ X).support(E), X.support(E @ M), atol=tol)
    assert np.allclose((X + Y).support(D), X.support(D) + Y.support(D), atol=tol)
    assert np.allclose((Y + X).support(D), X.support(D) + Y.support(D), atol=tol)
    assert np.allclose((X + v).support(D), X.support(D) + D @ v, atol=tol)
    assert np.allclose((v + X).support(D), (X + v).support(D))
    assert np.allclose((X - v).support(D), X.support(D) - D @ v, atol=tol)
    assert np.allclose((-X).support(D), X.support(-D), atol=tol)
    assert np.allclose((a * X).support(D), X.support(a * D), atol=tol * (1 + abs(a)))
    assert np.allclose((X * a).support(D), (a * X).support(D))


@settings(max_examples=25)
@given(st.data())
def test_projection_and_product(data):
    X, Y = data.draw(sets(3)), data.draw(sets(2))
    D, E = directions(2, 4), directions(5, 4)
    assert np.allclose(X.project([2, 0]).support(D), X.support(D @ np.eye(3)[[2, 0]]), atol=1e-7 * size(X))
    both = X.product(Y)
    assert both.dim == 5
    assert np.allclose(both.support(E), X.support(E[:, :3]) + Y.support(E[:, 3:]), atol=1e-7 * size(both))


@settings(max_examples=30)
@given(sets(), st.integers(0, 1000))
def test_enclosing_zonotope_holds_the_set(X, seed):
    frame = np.random.default_rng(seed).normal(size=(X.dim, X.dim))
    D = directions(X.dim)
    for Z in (X.enclosing_zonotope(), X.enclosing_zonotope(frame)):
        assert isinstance(Z, Zonotope) or Z is X
        assert np.all(Z.support_up(D) >= X.support_down(D))
    if abs(np.linalg.det(frame)) > 1e-3:
        rows = np.linalg.inv(frame)
        tight = X.enclosing_zonotope(frame).support(rows)
        assert np.allclose(tight, X.support(rows), atol=1e-6 * size(X) * (1 + np.abs(rows).max()))


@settings(max_examples=20)
@given(polytopes(2), zonotopes(2))
def test_lazy_results_stay_exact_under_further_operations(P, Z):
    X = P + Ellipsoid.ball([0, 0], 1)
    M, D = np.array([[1.0, 2.0], [0.0, 0.0], [3.0, -1.0]]), directions(3, 4)
    assert isinstance(X, MinkowskiSum) and isinstance(M @ P, AffineImage) and len((X + Z + X).parts) == 5
    truth = P.support(D @ M) + np.linalg.norm(D @ M, axis=-1)
    assert np.allclose((M @ X).support(D), truth, atol=1e-7 * size(P))
    image = 2 * (M @ P) + [1, 0, 0]
    assert np.allclose(image.support(D), 2 * P.support(D @ M) + D[:, 0], atol=1e-6 * size(P))
    assert np.allclose((np.eye(2) @ AffineImage(np.eye(2), P, [1.0, 2.0])).center, P.center + [1, 2])


@pytest.mark.parametrize(
    ("build", "says"),
    [
        (lambda X: np.eye(3) @ X, "act on dimension 2, got shape \\(3, 3\\)"),
        (lambda X: [[np.nan, 0]] @ X, "finite"),
        (lambda X: X + [1.0, 2.0, 3.0], "of 2 finite entries"),
        (lambda X: X + [np.inf, 0.0], "finite entries"),
        (lambda X: X + Interval([0], [1]), "dimensions"),
        (lambda X: X - X, "write X \\+ \\(-Y\\)"),
        (lambda X: np.inf * X, "one finite number"),
        (lambda X: [1.0] in X, "of 2 finite entries"),
        (lambda X: X.support([[1.0]]), "of 2 finite entries"),
        (lambda X: X.support([[np.nan, 1.0]]), "finite"),
        (lambda X: X.project([0, 2]), "dims must be different numbers from 0 to 1"),
        (lambda X: X.project([0, 0]), "dims"),
        (lambda X: X.enclosing_zonotope([[1, 1], [1, 1]]), "invertible"),
    ],
)
def test_every_class_refuses_nonsense_in_the_same_words(build, says):
    for X in examples():
        with pytest.raises(ReachError, match=says):
            build(X)
