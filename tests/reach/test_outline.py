"""Planar vertices and pictures, facets and volumes of zonotopes."""

import matplotlib
import numpy as np
import pytest
from hypothesis import given, settings

from reach.numerics.errors import ReachError
from reach.sets.ellipsoid import Ellipsoid
from reach.sets.interval import Interval
from reach.sets.outlines import outline, vertices_2d
from reach.sets.polytope import HPolytope
from reach.sets.zonotope import Zonotope, facet_normals
from tests.reach.strategies import directions, polytopes, sets, size, zonotopes

matplotlib.use("Agg")


def area(polygon):
    x, y = polygon.T
    return (x * np.roll(y, -1) - np.roll(x, -1) * y).sum() / 2


@settings(max_examples=40)
@given(sets(2))
def test_an_outline_has_the_support_of_the_set_or_a_little_more(X):
    polygon, D = outline(X), directions(2)
    excess = (polygon @ D.T).max(axis=0) - X.support(D)
    assert excess.min() >= -1e-7 * size(X)
    assert excess.max() <= (1e-2 if isinstance(X, Ellipsoid) else 1e-7) * size(X)
    assert area(polygon) >= -1e-9 * size(X) ** 2


@settings(max_examples=20)
@given(polytopes(2))
def test_vertices_of_a_polytope_are_those_of_qhull(P):
    mine, theirs = P.vertices_2d(), P.vertices()
    assert np.isclose(area(mine), P.volume(), rtol=1e-6)
    for one, other in ((mine, theirs), (theirs, mine)):
        near = np.abs(one[:, None] - other[None]).sum(axis=-1).min(axis=1)
        assert near.max() <= 1e-5 * size(P)


@given(zonotopes(2))
def test_area_of_a_zonotope_is_that_of_its_polygon(z):
    assert np.isclose(z.volume(), area(z.vertices_2d()), atol=1e-8 * size(z) ** 2)


@settings(max_examples=15)
@given(zonotopes(3, 5))
def test_facets_describe_the_zonotope_and_its_volume(z):
    P, D = z.to_polytope(), directions(3, 6)
    assert np.allclose(P.support(D), z.support(D), atol=1e-7 * size(z)) and z <= P
    if z.volume() > 1e-2 * size(z) ** 3:
        assert np.isclose(P.volume(), z.volume(), rtol=1e-6)


def test_stacks_of_planar_sets_give_stacks_of_polygons():
    rng = np.random.default_rng(0)
    z = Zonotope(rng.normal(size=(4, 2)), rng.normal(size=(4, 2, 5)))
    assert np.allclose(z.vertices_2d()[2], z[2].vertices_2d()) and z.volume().shape == (4,)
    assert Interval(np.zeros((4, 2)), np.ones((4, 2))).vertices_2d().shape == (4, 4, 2)
    assert vertices_2d(Zonotope.point([1.0, 2.0])).tolist() == [[1, 2]]


def test_every_set_draws_itself():
    from matplotlib.figure import Figure

    box = Interval([-1, -2, -3], [1, 2, 3])
    for X in (
        box,
        box.to_zonotope(),
        box.to_polytope(),
        Ellipsoid.ball([0, 0, 0], 1),
        box + Ellipsoid.ball([0] * 3, 1),
    ):
        ax = Figure().add_subplot()
        assert X.plot(ax, dims=(2, 0), color="red") is ax
        corners = ax.patches[0].get_xy()
        assert np.allclose(corners.max(axis=0), X.support(np.eye(3)[[2, 0]]), rtol=1e-2)


@pytest.mark.parametrize(
    ("ask", "says"),
    [
        (lambda: Ellipsoid.ball([0, 0], 1).vertices_2d(), "no vertices"),
        (lambda: Zonotope.point([0.0]).vertices_2d(), "planar set, got dimension 1"),
        (lambda: outline(Ellipsoid.ball([0], 1)), "planar set, got dimension 1"),
        (lambda: HPolytope([[1, 0]], [1]).vertices_2d(), "unbounded"),
        (lambda: facet_normals(np.ones((6, 40)), 1000), "more than 1000"),
        (lambda: Zonotope(np.zeros(6), np.ones((6, 40))).volume(1000), "more than 1000"),
        (lambda: Zonotope(np.zeros((2, 2)), np.ones((2, 2, 2))).to_polytope(), "a single set"),
    ],
)
def test_malformed_questions_are_one_clear_error(ask, says):
    with pytest.raises(ReachError, match=says):
        ask()
