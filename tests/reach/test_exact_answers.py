"""No answer is refuted by exact arithmetic: all kinds of sets, ill-conditioned maps, all units."""

from fractions import Fraction
from itertools import product

import numpy as np
import pytest

import reach
from reach import AffineImage, Ellipsoid, HPolytope, Intersection, Interval, Zonotope, contains, disjoint
from tests.reach.rational import exact, inside, refuted, rows, shared, solve
from tests.sizes import fewer

KINDS = (
    *["interval", "zonotope", "polytope", "ellipsoid", "ball", "image", "sum", "meet"],
    "round image",
    "round meet",
)
OUTER = tuple(kind for kind in KINDS if kind != "sum")
UNITS = (1e-12, 1e-6, 1.0, 1e6, 1e10, 1e12, 1e15)


def matrix(rng):
    """A map of the plane, as often as not close to one without an inverse."""
    M = rng.normal(size=(2, 2))
    if rng.random() < 0.6:
        M[1] = M[0] * rng.normal() + 10.0 ** rng.uniform(-8, -1) * rng.normal(size=2)
    return M


def body(kind, rng, unit=1.0, middle=None):
    """A random planar set of about one unit."""
    c = unit * (rng.normal(size=2) if middle is None else middle)
    if kind == "interval":
        half = unit * rng.uniform(0.1, 1, 2)
        return Interval(c - half, c + half)
    if kind == "zonotope":
        return Zonotope(c, unit * rng.normal(size=(2, int(rng.integers(2, 5)))))
    if kind == "polytope":
        angles = np.sort(rng.uniform(0, 2 * np.pi, 2)) + np.array([[0.0], [2.1], [4.2]])
        A = np.c_[np.cos(angles.ravel()), np.sin(angles.ravel())] * 10.0 ** rng.uniform(-2, 2, (6, 1))
        return HPolytope(A, A @ c + unit * np.linalg.norm(A, axis=1) * rng.uniform(0.3, 1, 6))
    if kind == "ellipsoid":
        return Ellipsoid(c, unit * rng.normal(size=(2, 2)))
    if kind == "ball":
        return Ellipsoid.ball(c, unit * rng.uniform(0.2, 1))
    if kind == "image":
        M = matrix(rng)
        return AffineImage(M, body(str(rng.choice(["polytope", "interval", "zonotope"])), rng, unit), c)
    if kind == "round image":
        return AffineImage(matrix(rng), body("ellipsoid", rng, unit), c)
    if kind == "sum":
        return reach.MinkowskiSum((body("polytope", rng, unit, middle), body("zonotope", rng, unit / 4)))
    if kind == "meet":
        parts = [body(str(rng.choice(["polytope", "zonotope"])), rng, unit, c / unit) for _ in range(2)]
        return Intersection(tuple(parts))
    return Intersection((body("ball", rng, unit, c / unit), body("polytope", rng, unit, c / unit)))


def shrunk(X, factor, about):
    """A scaled copy of a set about one of its points, lazily: nothing is rounded."""
    return AffineImage(factor * np.eye(2), X, about - factor * about)


def check_contains(outer, inner):
    answer = contains(outer, inner)
    if answer.holds:
        assert refuted(outer, inner) is None
    elif answer.holds is False and answer.witness is not None:
        # The witness is a point of the inner set to the rounding of its coordinates.
        assert inside(outer, exact(answer.witness)) is not True
    return answer.holds


def check_disjoint(X, Y):
    answer = disjoint(X, Y)
    if answer.holds:
        assert shared(X, Y) is None
    elif answer.holds is False:
        for one in (X, Y):
            near(one, answer.witness)
    return answer.holds


def near(X, witness, share=Fraction(1, 10**6)):
    """A witness is in the set but for a millionth of the size of each inequality, in exact arithmetic."""
    flat = rows(X)
    if flat is None:
        return
    p = exact(witness)
    half = exact(X.interval_hull().half_widths) if not isinstance(X, HPolytope) or X.is_bounded else None
    for a, b in zip(*flat, strict=True):
        size = abs(b) if half is None else sum(abs(x) * h for x, h in zip(a, half, strict=True))
        grain = sum(abs(x * y) for x, y in zip(a, p, strict=True)) / 10**13
        assert a @ p - b <= share * size + grain


def sweep(seed, count):
    """Random pairs of kinds; then inner sets that are copies of the outer one and hardly fit."""
    rng, answers = np.random.default_rng(seed), []
    for a, b in rng.choice(list(product(OUTER, KINDS)), count):
        outer = body(a, rng)
        answers.append(check_contains(outer, body(b, rng, 10.0 ** rng.uniform(-3, 0), outer.center)))
    for a in rng.choice(OUTER, count):
        X = body(a, rng)
        slack = rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-16, -1)
        answers.append(check_contains(X, shrunk(X, 1 - slack, X.center)))
    return answers


def sweep_apart(seed, count):
    rng, answers = np.random.default_rng(seed), []
    for a, b in rng.choice(list(product(KINDS, KINDS)), count):
        unit = float(rng.choice(UNITS))
        X, Y = body(a, rng, unit), body(b, rng, unit)
        Y = AffineImage(np.eye(2), Y, unit * rng.normal(size=2) * rng.choice([0.1, 3.0]))
        answers.append(check_disjoint(X, Y))
    return answers


@pytest.mark.parametrize("seed", [1])
def test_no_answer_is_refuted(seed):
    answers = sweep(seed, 10)
    assert answers.count(True) > 3 and answers.count(False) > 3
    answers = sweep_apart(seed, 10)
    assert answers.count(True) > 2 and answers.count(False) > 2 and answers.count(None) < 4


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2, 6))
def test_no_answer_is_refuted_in_many_more(seed):
    count = fewer(150, 15)
    sweep(seed, count)
    sweep_apart(seed, count)


@pytest.mark.parametrize("seed", range(3))
def test_images_of_polytopes_prove_nothing_about_other_sets(seed):
    """Along the facets of the exact image the bound is never below it, and what fits hardly is decided."""
    rng = np.random.default_rng(seed)
    for _ in range(5):
        M, P = matrix(rng), body("polytope", rng)
        image = M @ P
        back = [solve(exact(M), e) for e in exact(np.eye(2))]
        facets = exact(P.A) @ np.stack(back, axis=1)
        for a in facets:
            row = np.array([float(v) for v in a])
            largest = max(exact(row) @ exact(M) @ p for p in _corners(P))
            assert Fraction(float(image.support_up(row))) >= largest
        written = image.to_polytope()
        assert all(inside(written, exact(M) @ p) for p in _corners(P))


def _corners(P):
    from tests.reach.rational import vertices

    return vertices(exact(P.A), exact(P.b))


def test_random_unbounded_polytopes_against_fractions():
    """Rows that are mixtures of the inner ones by small whole numbers, in exact arithmetic."""
    rng, answers = np.random.default_rng(4), []
    for _ in range(20):
        A, b = rng.integers(-9, 10, (2, 3)) / 8.0, rng.integers(-9, 10, 2) / 8.0
        if not (A.any(axis=1).all() and np.linalg.matrix_rank(A) == 2):
            continue
        inner, weights = HPolytope(A, b), rng.integers(-1, 4, (2, 2)).astype(float)
        room = rng.choice([0.0, 0.5, -0.5], 2)
        if not (weights @ A).any(axis=1).all():
            continue
        outer = HPolytope(weights @ A, weights @ b + room)
        answer = contains(outer, inner)
        answers.append(answer.holds)
        assert answer.holds == bool(np.all(weights >= 0) and np.all(room >= 0))
    assert True in answers and False in answers


def test_intersections_of_every_two_kinds():
    rng = np.random.default_rng(7)
    D = rng.normal(size=(3, 2))
    pairs = [pair for pair in product(KINDS, KINDS) if pair[0] <= pair[1] and "image" not in str(pair)]
    for a, b in [("interval", "interval"), ("interval", "polytope"), *rng.choice(pairs, 2)]:
        middle = rng.normal(size=2)
        X, Y = body(a, rng, 1.0, middle), body(b, rng, 1.0, middle)
        both = X & Y
        if {a, b} <= {"interval", "polytope"}:
            assert isinstance(both, Interval if a == b == "interval" else HPolytope)
        upper, lower = both.support_up(D), both.support_down(D)
        assert np.all(upper <= np.minimum(X.support_up(D), Y.support_up(D)) + 1e-9)
        assert np.all(upper - lower <= 1e-3 * (1 + np.abs(upper)))
        some = both.support_vector(D)
        assert np.all(X.contains(some, 1e-6) & Y.contains(some, 1e-6))
        point = both.center
        assert disjoint(both, Zonotope.point(point)).holds is False
        assert "sum" in (a, b) or contains(both, Zonotope.point(point))
