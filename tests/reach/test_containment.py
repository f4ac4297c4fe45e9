"""Containment and disjointness: exact answers, witnesses, and what is left open."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reach.numerics.errors import ReachError
from reach.numerics.rounding import cross, integers
from reach.sets.ellipsoid import Ellipsoid
from reach.sets.interval import Interval
from reach.sets.lazy import AffineImage, MinkowskiSum
from reach.sets.norms import largest_norm
from reach.sets.polytope import HPolytope
from reach.sets.relations.pairs import contains, disjoint
from reach.sets.zonotope import Zonotope
from tests.reach.strategies import (
    directions,
    ellipsoids,
    intervals,
    polytopes,
    sets,
    size,
    vectors,
    zonotopes,
)

UNIT = Zonotope.box([0, 0], [1, 1])


def brute_force(outer, inner):
    """Exact for small zonotopes, by linear programs: every corner inside."""
    return bool(outer.contains(inner.corners(), 1e-7).all())


def check(answer, outer, inner):
    """A witness is in the inner set and not in the outer one."""
    if answer.holds is False:
        w = answer.witness
        assert inner.contains(w, 1e-7) and not outer.contains(w, 0) and answer.margin <= 0
        assert answer.direction @ w > outer.support(answer.direction) - 1e-9 * size(outer)


@settings(max_examples=60)
@given(st.integers(1, 3), st.data())
def test_zonotope_in_zonotope_agrees_with_its_corners(n, data):
    outer, inner = data.draw(zonotopes(n)), data.draw(zonotopes(n, 3))
    inner = data.draw(st.sampled_from([0.125, 0.5, 1.0])) * (inner - inner.c) + outer.c
    answer = contains(outer, inner, "exact")
    assert answer.holds is brute_force(outer, inner)
    check(answer, outer, inner)
    quick = contains(outer, inner, "sufficient")
    assert quick.holds in (answer.holds, None)
    check(quick, outer, inner)
    assert contains(outer, inner).holds is answer.holds
    if quick and np.all(outer.half_widths > 0):
        assert quick.margin <= answer.margin + 1e-9


@settings(max_examples=60)
@given(st.integers(1, 3), st.data())
def test_touching_sets_are_settled_exactly(n, data):
    z = data.draw(zonotopes(n))
    assert contains(z, z, "exact").holds is True
    assert contains(z, 0.5 * (z - z.c) + z.c, "exact").holds is True
    hull = z.interval_hull()
    assert contains(hull, z).holds is True and contains(hull.to_polytope(), z).holds is True
    assert z <= z.to_polytope()
    nudged = z + np.full(n, 2.0**-40)
    assert contains(z, nudged, "exact").holds is False and contains(hull, nudged).holds is False


@settings(max_examples=40)
@given(st.integers(1, 3), st.data())
def test_any_set_in_a_polytope_agrees_with_its_support(n, data):
    outer, inner = data.draw(st.one_of(polytopes(n), intervals(n))), data.draw(sets(n))
    answer = contains(outer, inner)
    rows = outer if isinstance(outer, HPolytope) else outer.to_polytope()
    room = ((rows.b - inner.support(rows.A)) / np.linalg.norm(rows.A, axis=1)).min()
    if abs(room) > 1e-7 * size(inner):
        assert answer.holds is bool(room > 0)
    if answer.holds:
        assert answer.margin <= room + 1e-9
    check(answer, outer, inner)


@settings(max_examples=40)
@given(st.integers(1, 3), st.data())
def test_any_set_in_an_ellipsoid_agrees_with_its_points(n, data):
    inner = data.draw(sets(n))
    L = np.eye(n) + data.draw(st.integers(0, 8)) / 16 * np.ones((n, n))
    outer = Ellipsoid(inner.center, data.draw(st.integers(1, 30)) * L)
    answer = contains(outer, inner)
    check(answer, outer, inner)
    if answer:
        assert outer.contains(inner.support_vector(directions(n, 40)), 1e-9).all()
    elif not isinstance(inner, HPolytope):
        assert answer.holds is False or abs(answer.margin) < 1e-6
    if isinstance(inner, Zonotope) and contains(outer, inner, "sufficient"):
        assert answer


@settings(max_examples=60)
@given(zonotopes(), st.data())
def test_largest_norm_of_a_zonotope_is_that_of_a_corner(z, data):
    norm, truth = largest_norm(z), np.linalg.norm(z.corners(), axis=1).max()
    assert norm.lower <= truth * (1 + 1e-12) and truth <= norm.upper * (1 + 1e-12)
    assert norm.upper - norm.lower <= 1e-8 * (1 + truth)
    assert np.isclose(np.linalg.norm(norm.point), norm.lower, atol=1e-9) and z.contains(norm.point, 1e-7)
    assert norm.upper <= z.norm_bound(np.eye(z.dim)) * (1 + 1e-9) + 1e-12


@given(ellipsoids())
def test_largest_norm_of_an_ellipsoid_brackets_its_surface(E):
    u = np.random.default_rng(0).normal(size=(3000, E.L.shape[1]))
    u /= np.maximum(np.linalg.norm(u, axis=1, keepdims=True), 1e-300)
    truth, norm = np.linalg.norm(E.c + u @ E.L.T, axis=1).max(), largest_norm(E)
    assert truth <= norm.upper and norm.upper - norm.lower <= 1e-6 * (1 + norm.upper)
    assert np.isclose(np.linalg.norm(norm.point), norm.lower, atol=1e-8) and E.contains(norm.point, 1e-6)


def test_branch_and_bound_that_is_cut_short_says_so():
    z = Zonotope(np.zeros(8), np.random.default_rng(0).normal(size=(8, 24)))
    wide = largest_norm(z, most=2)
    assert wide.lower <= largest_norm(z).lower * (1 + 1e-9) and wide.upper > wide.lower * 1.01
    middle = (wide.lower + wide.upper) / 2
    ball = Ellipsoid.ball(np.zeros(8), middle)
    assert contains(ball, z, most=1).holds is None
    with pytest.raises(ReachError, match="more than 1 branches"):
        contains(ball, z, "exact", most=1)


@settings(max_examples=60)
@given(st.integers(1, 3), st.data())
def test_disjoint_sets_are_separated_and_others_share_a_point(n, data):
    X, Y = data.draw(sets(n)), data.draw(sets(n))
    Y = Y + data.draw(vectors(n))
    answer = disjoint(X, Y)
    if answer:
        d = answer.direction / np.linalg.norm(answer.direction)
        assert X.support(d) + Y.support(-d) <= -answer.margin * (1 - 1e-6) + 1e-9 and answer.margin > 0
        assert disjoint(Y, X).holds
    elif answer.holds is False:
        for body in (X, Y):  # a point has no size to measure a slack with
            assert body.contains(answer.witness, 1e-6) or np.allclose(body.center, answer.witness, atol=1e-12)
    else:
        D = directions(n, 60)
        assert (X.support(D) + Y.support(-D)).min() > -1e-6 * (size(X) + size(Y))


def test_unbounded_polytopes():
    left, right = HPolytope([[1, 0.3]], [-5]), HPolytope([[-1, -0.3]], [-5])
    far = disjoint(left, Ellipsoid.ball([0, 0], 4.7))
    assert far and far.margin == pytest.approx(5 / np.hypot(1, 0.3) - 4.7, rel=1e-3)
    assert disjoint(left, right) and disjoint(left, HPolytope([[0, 1]], [0])).holds is False
    assert contains(left, HPolytope([[1, 0.3]], [-6])) and contains(left, left)
    X = HPolytope([[1.0], [-1.0]], [0.125, 0.125])
    assert disjoint(X, X + [0.375]).margin == pytest.approx(0.125, rel=1e-6)


def test_flat_sets():
    flat = Zonotope([0, 0, 0], [[1, 1], [0, 1], [0, 0]])
    assert contains(flat, 0.5 * flat, "exact").holds is True
    assert contains(flat, flat + [0, 0, 2.0**-40], "exact").holds is False
    assert contains(flat, 0.5 * flat, "sufficient").holds is None
    line = Zonotope([1, 1, 1], [[1], [2], [3]])
    assert contains(line, Zonotope([1, 1, 1], [[0.5], [1], [1.5]]), "exact").holds is True
    assert contains(line, Zonotope([1, 1, 1], [[0.5], [1], [1.25]]), "exact").holds is False


@given(st.integers(2, 4), st.data())
def test_generalised_cross_product_is_orthogonal_without_rounding(n, data):
    columns = np.array([data.draw(vectors(n)) for _ in range(n - 1)])
    (whole,) = integers(columns)
    normal = cross(whole[..., None])[:, 0]
    assert not np.any(whole @ normal)
    assert bool(np.any(normal != 0)) is bool(np.linalg.matrix_rank(columns) == n - 1)


@pytest.mark.parametrize(
    ("ask", "says"),
    [
        (lambda: contains(UNIT, UNIT, "best"), "method must be"),
        (lambda: contains(UNIT, Interval([0], [1])), "dimensions 2 and 1"),
        (lambda: contains(Interval([[0, 0]], [[1, 1]]), UNIT), "a single set"),
        (lambda: contains(UNIT + Ellipsoid.ball([0, 0], 1), UNIT), "MinkowskiSum is not supported"),
        (lambda: contains(Ellipsoid([0, 0], [[1, 0], [0, 0]]), UNIT), "flat ellipsoid"),
        (
            lambda: contains(Zonotope(np.zeros(6), np.ones((6, 30))), Zonotope.point([0] * 6), "exact"),
            "facets",
        ),
        (lambda: largest_norm(Interval([[0, 0]], [[1, 1]])), "a single set"),
    ],
)
def test_malformed_questions_are_one_clear_error(ask, says):
    with pytest.raises(ReachError, match=says):
        ask()


SQUARE = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
BOUNDED = {
    "zonotope": Zonotope([0.0, 0.0], [[1.0, 0.0, 0.3], [0.0, 1.0, 0.2]]),
    "flat": Zonotope([0.0, 0.0], [[1.0], [0.0]]),
    "interval": Interval([-1.0, -1.0], [1.0, 1.0]),
    "ellipsoid": Ellipsoid(np.zeros(2), np.eye(2)),
    "polytope": HPolytope(SQUARE, np.ones(4)),
}
UNBOUNDED = {
    "halfspace": HPolytope([[1.0, 0.0]], [0.5]),
    "strip": HPolytope(SQUARE[:2], [0.5, 0.5]),
    "everything": HPolytope(np.zeros((0, 2)), []),
}
EMPTY = {
    "nothing": HPolytope(SQUARE, [-1.0, -1.0, 1.0, 1.0]),
    "no strip": HPolytope(SQUARE[:2], [-1.0, -1.0]),
}
TURN = np.array([[1.0, 0.2], [0.0, 1.0]])


def made_of(sets):
    """Sets, what a map makes of them, and their sums with a ball."""
    examples = dict(sets)
    for name, one in sets.items():
        examples[f"image of {name}"] = AffineImage(TURN, one, np.ones(2))
        examples[f"sum with {name}"] = MinkowskiSum((one, Ellipsoid(np.zeros(2), 0.1 * np.eye(2))))
    return examples


@pytest.mark.parametrize("inner", made_of(UNBOUNDED))
@pytest.mark.parametrize("outer", BOUNDED)
def test_a_bounded_set_never_contains_an_unbounded_one(outer, inner):
    outer, inner = BOUNDED[outer], made_of(UNBOUNDED)[inner]
    answer = contains(outer, inner)
    assert answer.holds is False and not outer.contains(answer.witness)
    assert answer.direction @ answer.witness > outer.support(answer.direction)
    meets = disjoint(outer, inner)
    assert not meets.holds and (meets.holds is False or meets.reason)


@pytest.mark.parametrize("inner", made_of(EMPTY))
@pytest.mark.parametrize("outer", made_of(BOUNDED | UNBOUNDED | EMPTY))
def test_what_is_empty_lies_in_everything_and_meets_nothing(outer, inner):
    outer, inner = made_of(BOUNDED | UNBOUNDED | EMPTY)[outer], made_of(EMPTY)[inner]
    assert disjoint(outer, inner).holds and disjoint(inner, outer).holds
    if not isinstance(outer, MinkowskiSum):
        assert contains(outer, inner).holds


@pytest.mark.parametrize("inner", made_of(BOUNDED | UNBOUNDED))
@pytest.mark.parametrize("outer", [*EMPTY, *(f"image of {name}" for name in EMPTY)])
def test_an_empty_set_contains_nothing_else(outer, inner):
    answer = contains(made_of(EMPTY)[outer], made_of(BOUNDED | UNBOUNDED)[inner])
    if answer.holds is None:
        assert "proved bounds" in answer.reason and inner == "sum with strip"
    else:
        assert answer.holds is False and np.all(np.isfinite(answer.witness))
