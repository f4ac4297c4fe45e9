"""Polytopes by inequalities: proved supports, the unbounded and the empty, vertices and volume."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reach.numerics.errors import ReachError
from reach.sets.interval import Interval
from reach.sets.lazy import AffineImage
from reach.sets.polytope import HPolytope
from tests.reach.strategies import directions, polytopes, vectors

SQUARE = Interval([-1, -2], [1, 2]).to_polytope()
STRIP = HPolytope([[1, 0], [-1, 0]], [1, 1])
EMPTY = HPolytope([[1, 0], [-1, 0]], [-1, 0])


@settings(max_examples=25)
@given(polytopes(2))
def test_support_is_that_of_the_vertices_and_never_below(P):
    corners = P.vertices()
    D = directions(2, 5)
    brute = (corners @ D.T).max(axis=0)
    assert np.allclose(P.support(D), brute, atol=1e-7)
    assert np.all(P.support_down(D) <= brute + 1e-7) and np.all(P.support_up(D) >= P.support_down(D))
    assert P.contains(P.center + (1 - 1e-7) * (corners - P.center)).all()
    hull = P.interval_hull()
    assert np.allclose(hull.lo, corners.min(axis=0), atol=1e-7)
    assert P.contains(P.center) and P.is_bounded and not P.is_empty


def test_support_along_the_axes_of_a_box_is_exact_to_rounding_and_above():
    D = np.vstack([np.eye(2), -np.eye(2)])
    assert np.all(SQUARE.support(D) >= [1, 2, 1, 2]) and np.allclose(
        SQUARE.support(D), [1, 2, 1, 2], rtol=1e-14
    )


@settings(max_examples=15)
@given(polytopes(3), vectors(3), st.integers(1, 40))
def test_a_halfspace_cuts_exactly(P, normal, room):
    if not normal.any():
        return
    cut = P.intersect_halfspace(normal, normal @ P.center + room / 8)
    x = np.random.default_rng(0).uniform(P.interval_hull().lo, P.interval_hull().hi, (200, 3))
    inside = P.contains(x, 0) & (x @ normal <= normal @ P.center + room / 8)
    assert np.array_equal(cut.contains(x, 0), inside)


def test_unbounded_polytopes_say_so():
    assert not STRIP.is_bounded and np.all(np.isinf(STRIP.extent))
    assert STRIP.support([[1, 0], [0, 1]]).tolist() == [1, np.inf]
    assert np.allclose(STRIP.support_vector([1, 0])[0], 1)
    for ask in (
        STRIP.interval_hull,
        STRIP.vertices,
        STRIP.volume,
        STRIP.vertices_2d,
        STRIP.enclosing_zonotope,
    ):
        with pytest.raises(ReachError, match="unbounded"):
            ask()
    with pytest.raises(ReachError, match="unbounded in a requested direction"):
        STRIP.support_vector([0, 1])
    with pytest.raises(ReachError, match="balls of every size"):
        _ = HPolytope([[1, 0]], [1]).center
    assert HPolytope(np.zeros((0, 2)), []).contains([5, 5])


def test_empty_polytopes_say_so():
    assert EMPTY.is_empty and not SQUARE.is_empty and not STRIP.is_empty
    flat = SQUARE.intersect_halfspace([1, 0], -1)
    assert not flat.is_empty and np.allclose(flat.interval_hull().hi, [-1, 2])
    for ask in (
        lambda: EMPTY.support([1, 0]),
        lambda: EMPTY.support_vector([1, 0]),
        lambda: EMPTY.center,
        EMPTY.interval_hull,
        EMPTY.vertices,
    ):
        with pytest.raises(ReachError, match="empty"):
            ask()
    with pytest.raises(ReachError, match="flat"):
        flat.vertices()


@pytest.mark.parametrize("n", [1, 2, 3])
def test_volume_and_vertices_of_a_box_and_of_a_simplex(n):
    box = Interval(np.zeros(n), np.arange(1, n + 1)).to_polytope()
    assert len(box.vertices()) == 2**n
    assert np.isclose(box.volume(), np.prod(np.arange(1, n + 1)))
    simplex = HPolytope(np.vstack([-np.eye(n), np.ones((1, n))]), np.r_[np.zeros(n), 1])
    assert np.isclose(simplex.volume(), 1 / np.prod(np.arange(1, n + 1)))


def test_images():
    turned = np.array([[0.0, 2.0], [-1.0, 0.0]]) @ SQUARE
    assert isinstance(turned, HPolytope) and np.allclose(turned.interval_hull().hi, [4, 1])
    assert isinstance(np.array([[1.0, 1.0]]) @ SQUARE, AffineImage)
    assert isinstance(0 * SQUARE, AffineImage) and np.allclose((0 * SQUARE).interval_hull().hi, 0)
    assert np.allclose(SQUARE.project([1]).interval_hull().hi, [2])


def test_units_do_not_matter_to_the_solver():
    scale = np.array([1e-7, 1e5])
    P = HPolytope(SQUARE.A / scale, SQUARE.b)
    assert np.allclose(P.interval_hull().hi / scale, [1, 2], rtol=1e-9)
    assert np.allclose(P.vertices().max(axis=0) / scale, [1, 2])


@pytest.mark.parametrize(
    ("build", "says"),
    [
        (lambda: HPolytope([[1, 0]], [1, 2]), "shape"),
        (lambda: HPolytope([1, 0], [1]), "shape"),
        (lambda: HPolytope([[1, np.nan]], [1]), "finite"),
        (lambda: HPolytope([[1, 0]], [np.inf]), "finite"),
        (lambda: HPolytope([[1, 0], [0, 0]], [1, 1]), "row 1 of A is zero"),
        (lambda: SQUARE & HPolytope([[1.0]], [1]), "dimensions 2 and 1"),
    ],
)
def test_malformed_input_is_one_clear_error(build, says):
    with pytest.raises(ReachError, match=says):
        build()
