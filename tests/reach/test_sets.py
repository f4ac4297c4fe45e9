"""Boxes, zonotopes, ellipsoids, polytopes: operations against sampled truth, exactly where they are exact."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from matplotlib.figure import Figure

from reach.numerics.errors import ReachError
from reach.numerics.rounding import add_down, add_up, integers
from reach.sets.clipping import enclosing_hull, meet_halfspace
from reach.sets.ellipsoid import Ellipsoid, ball_generators
from reach.sets.interval import Interval
from reach.sets.lazy import AffineImage
from reach.sets.outlines import outline
from reach.sets.polytope import HPolytope
from reach.sets.reduction import METHODS, mean_width, reduce, reduction_loss
from reach.sets.relations.pairs import contains
from reach.sets.zonotope import Zonotope, facet_normals
from tests.reach.strategies import (
    directions,
    ellipsoids,
    intervals,
    numbers,
    polytopes,
    sets,
    size,
    vectors,
    zonotopes,
)

anything = st.floats(-1e6, 1e6)


@given(st.lists(st.tuples(anything, anything), min_size=1, max_size=5))
def test_directed_sums_enclose_the_exact_sum_and_keep_exact_ones(pairs):
    a, b = np.array(pairs).T
    x, y, down, up = integers(a, b, add_down(a, b), add_up(a, b))
    assert np.all(down <= x + y) and np.all(x + y <= up)
    exact = x + y == integers(a, b, a + b)[2]
    assert np.all((add_down(a, b) == add_up(a, b)) >= exact)


@given(intervals(), intervals(), st.integers(0, 100))
def test_sum_scale_and_hull_of_boxes(a, b, seed):
    if a.dim != b.dim:
        with pytest.raises(ReachError, match="dimensions"):
            a + b
        return
    total = a + b
    assert np.array_equal(total.lo, a.lo + b.lo) and np.array_equal(total.hi, a.hi + b.hi)
    assert np.array_equal((-a).lo, -a.hi) and np.array_equal((2 * a).hi, 2 * a.hi)
    hull = a.hull(b)
    assert a <= hull and b <= hull and np.array_equal(hull.lo, np.minimum(a.lo, b.lo))
    if np.all(np.maximum(a.lo, b.lo) <= np.minimum(a.hi, b.hi)):
        assert (a & b) <= a and (a & b) <= b
    else:
        with pytest.raises(ReachError, match="intersection of the intervals is empty"):
            a & b


@given(intervals())
def test_other_descriptions_are_the_same_box(box):
    Z, P, D = box.to_zonotope(), box.to_polytope(), directions(box.dim)
    assert np.allclose(Z.support(D), box.support(D)) and np.array_equal(Z.interval_hull().hi, box.hi)
    assert np.array_equal(P.b, np.r_[box.hi, -box.lo]) and box <= P and box <= Z and box >= Z


@given(anything, st.floats(0, 1e3))
def test_a_box_around_a_centre_and_its_zonotope_hold_every_corner(c, r):
    box = Interval.ball([c], r)
    Z = box.to_zonotope()
    lo, hi, center, radius, mid, half = (v[0] for v in integers(box.lo, box.hi, [c], [r], Z.c, Z.G[0]))
    assert lo <= center - radius and center + radius <= hi and mid - half <= lo and hi <= mid + half


@given(intervals(n=2), vectors(2), numbers)
def test_halfspace_leaves_the_tight_box(box, normal, offset):
    grid = np.stack(np.meshgrid(*(np.linspace(lo, hi, 9) for lo, hi in zip(box.lo, box.hi, strict=True))))
    points = grid.reshape(2, -1).T
    inside = points[points @ normal <= offset]
    if -box.support(-normal) > offset:
        with pytest.raises(ReachError, match="no point of the set"):
            box.meet_halfspace(normal, offset)
        return
    cut = box.meet_halfspace(normal, offset)
    assert cut.contains(inside).all() and box.contains(cut.vertices_2d()).all()
    # Every face of the answer is reached by the true part.
    part = box.to_polytope().intersect_halfspace(normal, offset) if normal.any() else box.to_polytope()
    if not part.is_empty:
        assert np.allclose(part.interval_hull().hi, cut.hi, atol=1e-7)


def test_stacks_of_boxes_behave_like_their_members():
    rng = np.random.default_rng(0)
    lo = rng.normal(size=(4, 3))
    stack = Interval(lo, lo + rng.random((4, 3)))
    D, M, flat = directions(3), rng.normal(size=(2, 3)), stack.project([2, 0])
    offset = stack.center @ D[0]
    cut = stack.meet_halfspace(D[0], offset)
    for i, member in enumerate(Interval(a, b) for a, b in zip(stack.lo, stack.hi, strict=True)):
        assert np.allclose(stack.support(D)[i], member.support(D))
        assert np.allclose(stack.support_vector(D)[i], member.support_vector(D))
        assert np.allclose((M @ stack)[i].G, (M @ member).G)
        assert np.allclose((stack + stack)[i].hi, (member + member).hi)
        assert np.isclose(stack.volume()[i], np.prod(member.hi - member.lo))
        assert np.allclose(cut[i].hi, member.meet_halfspace(D[0], offset[i]).hi)
        assert np.array_equal(flat.vertices_2d()[i], member.project([2, 0]).vertices_2d())
    assert len(stack) == 4 and stack[1:3].batch == (2,) and stack.contains(stack.center).all()
    assert np.array_equal(Interval.stack([stack[0], stack[1]]).hi, stack.hi[:2])
    assert np.array_equal(Interval.around(stack.hi).hi, stack.hi.max(axis=0))
    assert Interval([0, 1], [2, 4]).vertices_2d().tolist() == [[2, 1], [2, 4], [0, 4], [0, 1]]


def below(values, bound):
    return np.all(values <= bound + 1e-9 * (1 + np.abs(bound)))


@given(zonotopes(n=3, g=5), zonotopes(n=3, g=5), st.floats(0, 1))
def test_hull_holds_every_mixture_of_corresponding_points(a, b, s):
    rng = np.random.default_rng(0)
    beta = rng.uniform(-1, 1, (40, 5))
    mix = (1 - s) * (a.c + beta @ a.G.T) + s * (b.c + beta @ b.G.T)
    D = directions(3)
    assert below((mix @ D.T).max(axis=0), a.hull(b).support(D))


@given(zonotopes(n=3), arrays(float, (3, 3), elements=numbers))
def test_norm_bound_holds_and_is_exact_for_a_point(z, W):
    norms = np.linalg.norm(z.sample(np.random.default_rng(0), 60) @ W.T, axis=1)
    assert below(norms.max(), z.norm_bound(W))
    assert np.isclose(Zonotope.point(z.c).norm_bound(W), np.linalg.norm(W @ z.c), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(("p", "ratio"), [(1, 1.0), (2, 1.03), (3, 1.10), (4, 2.0)])
def test_ball_enclosure_holds_the_ball_and_is_tight(p, ratio):
    G = ball_generators(p, 2.0)
    D = np.random.default_rng(0).normal(size=(4000, p))
    D /= np.linalg.norm(D, axis=1, keepdims=True)
    support = np.abs(D @ G).sum(axis=1)
    assert support.min() >= 2.0 * (1 - 1e-12) and support.max() <= 2.0 * ratio * (1 + 1e-9)


def test_stacks_of_zonotopes_behave_like_their_members():
    rng = np.random.default_rng(0)
    members = [Zonotope(rng.normal(size=3), rng.normal(size=(3, 4))) for _ in range(5)]
    stack, M = Zonotope.stack(members), rng.normal(size=(3, 3))
    assert len(stack) == 5
    for i, member in enumerate(members):
        assert np.allclose((M @ stack)[i].G, (M @ member).G)
        assert np.allclose(stack.norm_bound(M)[i], member.norm_bound(M))
        assert np.allclose(stack.support(directions(3))[i], member.support(directions(3)))


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


def test_volume_of_ellipsoids():
    assert np.isclose(Ellipsoid.ball([0, 0], 2).volume(), 4 * np.pi)
    assert np.isclose(Ellipsoid.ball([0, 0, 0], 2).volume(), 32 / 3 * np.pi)
    assert np.isclose((np.diag([1.0, 3.0]) @ Ellipsoid.ball([0, 0], 1)).volume(), 3 * np.pi)


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
    sizes = STRIP.interval_hull, STRIP.vertices, STRIP.volume, STRIP.vertices_2d, STRIP.enclosing_zonotope
    for ask in sizes:
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
    for ask in (lambda: EMPTY.support([1, 0]), lambda: EMPTY.center, EMPTY.interval_hull, EMPTY.vertices):
        with pytest.raises(ReachError, match="empty"):
            ask()
    with pytest.raises(ReachError, match="flat"):
        flat.vertices()


@pytest.mark.parametrize("n", [1, 2, 3])
def test_volume_and_vertices_of_a_box_and_of_a_simplex(n):
    box = Interval(np.zeros(n), np.arange(1, n + 1)).to_polytope()
    assert len(box.vertices()) == 2**n and np.isclose(box.volume(), np.prod(np.arange(1, n + 1)))
    simplex = HPolytope(np.vstack([-np.eye(n), np.ones((1, n))]), np.r_[np.zeros(n), 1])
    assert np.isclose(simplex.volume(), 1 / np.prod(np.arange(1, n + 1)))


def test_images():
    image = np.array([[0.0, 2.0], [-1.0, 0.0]]) @ SQUARE
    assert isinstance(image, HPolytope) and np.allclose(image.interval_hull().hi, [4, 1])
    assert isinstance(np.array([[1.0, 1.0]]) @ SQUARE, AffineImage)
    assert isinstance(0 * SQUARE, AffineImage) and np.allclose((0 * SQUARE).interval_hull().hi, 0)
    assert np.allclose(SQUARE.project([1]).interval_hull().hi, [2])


def test_units_do_not_matter_to_the_solver():
    scale = np.array([1e-7, 1e5])
    P = HPolytope(SQUARE.A / scale, SQUARE.b)
    assert np.allclose(P.interval_hull().hi / scale, [1, 2], rtol=1e-9)
    assert np.allclose(P.vertices().max(axis=0) / scale, [1, 2])


@settings(max_examples=80)
@given(zonotopes(3), vectors(3), numbers)
def test_what_a_halfspace_leaves_is_enclosed(z, normal, offset):
    points = z.sample(np.random.default_rng(0), 200)
    inside = points[points @ normal <= offset]
    if -z.support(-normal) > offset:
        with pytest.raises(ReachError, match="no point of the set"):
            meet_halfspace(z, normal, offset)
        return
    part, D = meet_halfspace(z, normal, offset), directions(3)
    if len(inside):
        assert np.all((inside @ D.T).max(axis=0) <= part.support_up(D))
    if z.support(normal) <= offset:
        assert np.allclose(part.support(D), z.support(D))


def test_the_part_of_a_box_is_the_part_exactly_and_other_parts_are_smaller():
    box = Zonotope.box([1, 2], [1, 3])
    assert np.allclose(box.meet_halfspace([1, 0], 0.5).interval_hull().hi, [0.5, 5])
    assert np.allclose(box.meet_halfspace([-1, 0], -0.5).interval_hull().lo, [0.5, -1])
    z = Zonotope([0, 0], [[1, 1, 0.5], [1, -1, 0.5]])
    part = z.meet_halfspace([1, 0], 0)
    assert (part.half_widths / z.half_widths).sum() < 1.8


@settings(max_examples=30)
@given(st.integers(1, 2), st.data())
def test_hulls_contain_both_sets_exactly(n, data):
    a, b = data.draw(zonotopes(n)), data.draw(zonotopes(n))
    for hull in (enclosing_hull(a, b), a.hull(b)):
        assert contains(hull, a, "exact").holds is True and contains(hull, b, "exact").holds is True


def test_hull_of_a_set_and_its_shuffled_translate_is_tight():
    z = Zonotope([0.0, 0.0], [[1, 0.5, 0], [0, 1, 2]])
    translate = Zonotope([3.0, 0.0], -z.G[:, [2, 0, 1]])
    hull = enclosing_hull(z, translate)
    D = directions(2)
    assert np.allclose(hull.support(D), np.maximum(z.support(D), translate.support(D)))
    assert z.hull(translate).half_widths.sum() > hull.half_widths.sum()
    both = enclosing_hull(Zonotope.stack([z, translate]), translate)
    assert both.batch == (2,) and np.allclose(both[0].support(D), hull.support(D))


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
    planar, by_qhull = P.vertices_2d(), P.vertices()
    assert np.isclose(area(planar), P.volume(), rtol=1e-6)
    for one, other in ((planar, by_qhull), (by_qhull, planar)):
        near = np.abs(one[:, None] - other[None]).sum(axis=-1).min(axis=1)
        assert near.max() <= 1e-5 * size(P)


@settings(max_examples=15)
@given(zonotopes(3, 5))
def test_facets_describe_the_zonotope_and_its_volume(z):
    P, D = z.to_polytope(), directions(3, 6)
    assert np.allclose(P.support(D), z.support(D), atol=1e-7 * size(z)) and z <= P
    if z.volume() > 1e-2 * size(z) ** 3:
        assert np.isclose(P.volume(), z.volume(), rtol=1e-6)


def test_every_set_draws_itself():
    box = Interval([-1, -2, -3], [1, 2, 3])
    round_ones = Ellipsoid.ball([0, 0, 0], 1), box + Ellipsoid.ball([0] * 3, 1)
    for X in (box, box.to_zonotope(), box.to_polytope(), *round_ones):
        ax = Figure().add_subplot()
        assert X.plot(ax, dims=(2, 0), color="red") is ax
        corners = ax.patches[0].get_xy()
        assert np.allclose(corners.max(axis=0), X.support(np.eye(3)[[2, 0]]), rtol=1e-2)


EVERY = [*METHODS, "auto"]


@settings(max_examples=40)
@given(zonotopes(), st.sampled_from(EVERY), st.sampled_from([1, 1.5, 2]))
def test_every_method_contains_the_original_without_rounding_in_the_way(z, method, order):
    small = reduce(z, order, method)
    assert small.order_count <= max(int(order * z.dim), 0) or small is z
    assert contains(small, z, "exact").holds is True
    loss = reduction_loss(z, small)
    D = directions(z.dim)
    assert np.all(small.support_down(D) <= z.support_up(D) + np.abs(D) @ loss)


def awkward(rng, n, g):
    """Return generators (n, g) that are flat, repeated, opposite, zero, or of very different sizes."""
    G = rng.normal(size=(n, g))
    yield rng.normal(size=(n, 1)) @ G[:1]
    yield np.where(np.arange(n)[:, None] == 0, 0.0, G)
    yield G[:, rng.integers(0, 2, g)] * rng.choice([1.0, -1.0, 1 + 2.0**-52], g)
    yield np.where(rng.random(g) < 0.6, 0.0, G)
    yield G * 10.0 ** rng.uniform(-16, 0, g)
    yield G * 1e-250


@pytest.mark.parametrize("method", EVERY)
@pytest.mark.parametrize("order", [1, 1.5])
def test_awkward_generators_are_contained_exactly(method, order):
    rng = np.random.default_rng(5)
    for n, g in [(1, 6), (2, 11), (3, 8)]:
        for G in awkward(rng, n, g):
            z = Zonotope(np.zeros(n), G)
            assert contains(reduce(z, order, method), z, "exact", most=10**5).holds is True


@pytest.mark.parametrize("method", ["girard", "combastel", "parallel"])  # principal axes of a cube are any
@pytest.mark.parametrize("order", [1.5, 2, 3])
def test_last_digits_decide_nothing(method, order):
    """Generators that are equally long but for rounding: another processor's rounding gives the same set."""
    rng = np.random.default_rng(4)
    for n in (2, 4):
        half = rng.normal(size=(n // 2, 5 * n))
        G = np.kron(np.eye(2), half)  # a planar plant that is the same along both axes
        a = Zonotope(np.zeros(n), G)
        b = Zonotope(np.zeros(n), G * (1 + rng.choice([-1, 0, 1], G.shape) * 2.0**-50))
        one, other = reduce(a, order, method), reduce(b, order, method)
        assert np.abs(one.G - other.G).max() < 1e-9


def test_parallel_loses_less_than_half_of_what_pca_does_where_generators_turn_slowly():
    """Sums of images of one box under powers of a matrix, as tubes have them."""
    rng, F, blocks = np.random.default_rng(2), np.eye(4), [np.diag([1.0, 0.1, 0.5, 0.2])]
    F[:2, 2:], F[2:, :2] = 0.05 * np.eye(2), -0.05 * np.eye(2)
    for _ in range(99):
        blocks.append(0.98 * F @ blocks[-1])
    z = Zonotope(np.zeros(4), np.hstack(blocks) * rng.uniform(0.9, 1, 400))
    growth = {name: mean_width(reduce(z, 15, name).G) / mean_width(z.G) - 1 for name in ("pca", "parallel")}
    assert 0 <= growth["parallel"] < growth["pca"] / 2


def test_auto_is_never_wider_than_a_single_method():
    rng = np.random.default_rng(1)
    stack = Zonotope(np.zeros((20, 4)), rng.normal(size=(20, 4, 24)))
    size = np.exp2(np.round(np.log2(stack.half_widths)))[..., None]
    widths = {name: mean_width(reduce(stack, 2, name).G / size) for name in EVERY}
    for name in METHODS:
        assert np.all(widths["auto"] <= widths[name] * (1 + 2.0**-23))  # nearer is a tie


def test_what_is_not_reduced_loses_nothing_and_a_bigger_set_loses_what_it_added():
    z = Zonotope([0.0, 0.0], [[1.0, 0.5], [0.0, 2.0]])
    assert reduce(z, 1.0) is z and np.all(reduction_loss(z, z) < 1e-14)
    assert np.allclose(reduction_loss(z, z.inflate([0.25, 0])), [0.25, 0])
    assert np.allclose(reduction_loss(z, z + [0.5, 0]), [0.5, 0])


PLANE = Zonotope([0.0, 0.0], np.eye(2))


@pytest.mark.parametrize(
    ("build", "says"),
    [
        (lambda: Interval([0, 2], [1, 1]), r"lo\[1\] = 2 > 1"),
        (lambda: Interval([np.nan], [1]), "finite"),
        (lambda: Interval.ball([0], -1), "radius must be >= 0, got -1"),
        (lambda: Interval.around(np.zeros((0, 2))), "k >= 1"),
        (lambda: Interval([0], [1])[0], "cannot be indexed"),
        (lambda: Interval([[0, 0]], [[1, 1]]).to_polytope(), "a single set, got a stack"),
        (lambda: Interval([[0, 0]], [[1, 1]])[0, 0], "batch axes"),
        (lambda: Interval([0], [1]).vertices_2d(), "planar"),
        (lambda: Zonotope([0.0, 0.0], [[1.0]]), "generators must have shape"),
        (lambda: Zonotope([np.nan], [[1.0]]), "finite"),
        (lambda: Zonotope.box([0.0], [-1.0]), "half-widths"),
        (lambda: Zonotope([0.0], [[1.0]]) + Zonotope([0.0, 0.0], np.eye(2)), "dimensions 1 and 2"),
        (lambda: Zonotope([0.0] * 2, np.ones((2, 20))).corners(), "more than"),
        (lambda: Zonotope([0.0], [[1.0]])[0], "cannot be indexed"),
        (lambda: ball_generators(2, -1.0), "radius"),
        (lambda: Ellipsoid([0, 0], [1, 1]), "shape"),
        (lambda: Ellipsoid([np.nan], [[1]]), "finite"),
        (lambda: Ellipsoid.ball([0, 0], -1), "radius must be >= 0, got -1"),
        (lambda: Ellipsoid.from_shape([0, 0], [[1, 1], [0, 1]]), "Q must be symmetric"),
        (lambda: Ellipsoid.from_shape([0, 0], [[1, 2], [2, 1]]), "Q must be positive semidefinite"),
        (lambda: Ellipsoid.sublevel([0, 0], [[1, 0], [0, 0]]), "P must be positive definite"),
        (lambda: Ellipsoid.sublevel([0, 0], np.eye(2), -1), "level must be >= 0, got -1"),
        (lambda: HPolytope([[1, 0]], [1, 2]), "shape"),
        (lambda: HPolytope([1, 0], [1]), "shape"),
        (lambda: HPolytope([[1, np.nan]], [1]), "finite"),
        (lambda: HPolytope([[1, 0]], [np.inf]), "finite"),
        (lambda: HPolytope([[1, 0], [0, 0]], [1, 1]), "row 1 of A is zero"),
        (lambda: SQUARE & HPolytope([[1.0]], [1]), "dimensions 2 and 1"),
        (lambda: PLANE.meet_halfspace([1, 0, 0], 0), "of 2 finite entries"),
        (lambda: PLANE.meet_halfspace([1, 0], np.nan), "offset must be finite"),
        (lambda: enclosing_hull(PLANE, Zonotope.point([0.0])), "dimensions 2 and 1"),
        (lambda: Ellipsoid.ball([0, 0], 1).vertices_2d(), "no vertices"),
        (lambda: outline(Ellipsoid.ball([0], 1)), "planar set, got dimension 1"),
        (lambda: HPolytope([[1, 0]], [1]).vertices_2d(), "unbounded"),
        (lambda: facet_normals(np.ones((6, 40)), 1000), "more than 1000"),
        (lambda: reduce(PLANE, 0.5), "at least 1, got 0.5"),
        (lambda: reduce(PLANE, np.nan), "order must be"),
        (lambda: reduce(PLANE, 1, "best"), "method must be 'auto' or one of"),
        (lambda: reduction_loss(PLANE, Zonotope.point([0.0])), "dimensions 2 and 1"),
    ],
)
def test_malformed_input_is_one_clear_error(build, says):
    with pytest.raises(ReachError, match=says):
        build()
