"""Ellipsoids: the three ways to give them, flat ones, enclosing zonotopes, volume."""

import numpy as np
import pytest
from hypothesis import given, settings

from reach.numerics.errors import ReachError
from reach.sets.ellipsoid import Ellipsoid
from tests.reach.strategies import directions, ellipsoids


def surface(E, count=200):
    u = np.random.default_rng(0).normal(size=(count, E.L.shape[1]))
    return E.c + u / np.linalg.norm(u, axis=1, keepdims=True) @ E.L.T


@given(ellipsoids())
def test_shape_matrix_and_root_describe_the_same_set(E):
    D = directions(E.dim)
    same = Ellipsoid.from_shape(E.c, E.shape)
    assert np.allclose(same.support(D), E.support(D), atol=1e-5)
    assert np.allclose(E.support(D), D @ E.c + np.sqrt(np.maximum(((D @ E.shape) * D).sum(axis=1), 0)))


def test_sublevel_sets():
    P = np.array([[2.0, 0.5], [0.5, 1.0]])
    x = surface(Ellipsoid.sublevel([1, 2], P, 3.0)) - [1, 2]
    assert np.allclose(((x @ P) * x).sum(axis=1), 3)


@settings(max_examples=50)
@given(ellipsoids())
def test_enclosing_zonotope_holds_the_surface_and_is_tight_in_the_plane(E):
    Z, D = E.enclosing_zonotope(), directions(E.dim, 50)
    assert np.all(Z.support_up(D) >= E.support_down(D))
    if E.dim <= 2:
        assert np.all(Z.support(D) - D @ E.c <= 1.03 * (E.support(D) - D @ E.c) + 1e-6)


def test_flat_ellipsoids_hold_their_points_only():
    disc = Ellipsoid([0, 0, 1], [[1, 0], [0, 1], [0, 0]])
    assert disc.contains([[0.5, 0.5, 1], [0.5, 0.5, 1.01], [1, 1, 1]]).tolist() == [True, False, False]
    assert disc.volume() == 0 and Ellipsoid([1.0], np.zeros((1, 0))).contains([1.0])
    assert Ellipsoid([0, 0], np.zeros((2, 2))).enclosing_zonotope().order_count == 0


def test_volume():
    assert np.isclose(Ellipsoid.ball([0, 0], 2).volume(), 4 * np.pi)
    assert np.isclose(Ellipsoid.ball([0, 0, 0], 2).volume(), 32 / 3 * np.pi)
    assert np.isclose((np.diag([1.0, 3.0]) @ Ellipsoid.ball([0, 0], 1)).volume(), 3 * np.pi)


@pytest.mark.parametrize(
    ("build", "says"),
    [
        (lambda: Ellipsoid([0, 0], [1, 1]), "shape"),
        (lambda: Ellipsoid([0, 0], np.eye(3)), "shape"),
        (lambda: Ellipsoid([np.nan], [[1]]), "finite"),
        (lambda: Ellipsoid.ball([0, 0], -1), "radius must be >= 0, got -1"),
        (lambda: Ellipsoid.ball([0, 0], np.nan), "radius"),
        (lambda: Ellipsoid.from_shape([0, 0], np.ones((2, 3))), "Q must be square, got shape \\(2, 3\\)"),
        (lambda: Ellipsoid.from_shape([0, 0], [[1, 1], [0, 1]]), "Q must be symmetric"),
        (lambda: Ellipsoid.from_shape([0, 0], [[1, 2], [2, 1]]), "Q must be positive semidefinite"),
        (lambda: Ellipsoid.from_shape([0, 0], [[1, np.inf], [np.inf, 1]]), "Q must have finite"),
        (lambda: Ellipsoid.sublevel([0, 0], [[1, 0], [0, 0]]), "P must be positive definite"),
        (lambda: Ellipsoid.sublevel([0, 0], np.eye(2), -1), "level must be >= 0, got -1"),
    ],
)
def test_malformed_input_is_one_clear_error(build, says):
    with pytest.raises(ReachError, match=says):
        build()
