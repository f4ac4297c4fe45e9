"""Boxes: exact operations, outward rounding, batches."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from reach.numerics.errors import ReachError
from reach.numerics.rounding import add_down, add_up, integers
from reach.sets.interval import Interval
from reach.sets.zonotope import Zonotope
from tests.reach.strategies import directions, intervals, numbers, vectors

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
    assert np.array_equal(P.b, np.r_[box.hi, -box.lo])
    assert box <= P and box <= Z and box >= Z


@given(anything, st.floats(0, 1e3))
def test_a_box_around_a_centre_and_its_zonotope_hold_every_corner(c, r):
    box = Interval.ball([c], r)
    Z = box.to_zonotope()
    lo, hi, center, radius, mid, half = (v[0] for v in integers(box.lo, box.hi, [c], [r], Z.c, Z.G[0]))
    assert lo <= center - radius and center + radius <= hi
    assert mid - half <= lo and hi <= mid + half


@given(intervals(n=2), vectors(2), numbers)
def test_halfspace_leaves_the_tight_box(box, normal, offset):
    grid = np.stack(np.meshgrid(*(np.linspace(lo, hi, 9) for lo, hi in zip(box.lo, box.hi, strict=True))))
    points = grid.reshape(2, -1).T
    left = points[points @ normal <= offset]
    if -box.support(-normal) > offset:
        with pytest.raises(ReachError, match="no point of the set"):
            box.meet_halfspace(normal, offset)
        return
    cut = box.meet_halfspace(normal, offset)
    assert cut.contains(left).all() and box.contains(cut.vertices_2d()).all()
    # Every face of the answer is reached by the true part.
    part = box.to_polytope().intersect_halfspace(normal, offset) if normal.any() else box.to_polytope()
    if not part.is_empty:
        assert np.allclose(part.interval_hull().hi, cut.hi, atol=1e-7)


def test_batches_behave_like_their_members():
    rng = np.random.default_rng(0)
    lo = rng.normal(size=(4, 3))
    stack = Interval(lo, lo + rng.random((4, 3)))
    D, M = directions(3), rng.normal(size=(2, 3))
    for i, member in enumerate(Interval(a, b) for a, b in zip(stack.lo, stack.hi, strict=True)):
        assert np.allclose(stack.support(D)[i], member.support(D))
        assert np.allclose(stack.support_vector(D)[i], member.support_vector(D))
        assert np.allclose((M @ stack)[i].G, (M @ member).G)
        assert np.allclose((stack + stack)[i].hi, (member + member).hi)
        assert np.allclose(stack.project([2, 0])[i].lo, member.lo[[2, 0]])
        assert np.isclose(stack.volume()[i], member.volume())
        offset = stack.center @ D[0]
        assert np.allclose(
            stack.meet_halfspace(D[0], offset)[i].hi, member.meet_halfspace(D[0], offset[i]).hi
        )
        assert np.array_equal(stack.project([0, 1]).vertices_2d()[i], member.project([0, 1]).vertices_2d())
    assert len(stack) == 4 and stack[1:3].batch == (2,) and stack.contains(stack.center).all()
    assert np.array_equal(Interval.stack([stack[0], stack[1]]).hi, stack.hi[:2])
    assert np.array_equal(Interval.around(stack.hi).hi, stack.hi.max(axis=0))
    assert isinstance(stack + Zonotope.point(np.zeros(3)), Zonotope)


def test_volume_and_corners():
    box = Interval([0, 1], [2, 4])
    assert box.volume() == 6
    assert box.vertices_2d().tolist() == [[2, 1], [2, 4], [0, 4], [0, 1]]


@pytest.mark.parametrize(
    ("build", "says"),
    [
        (lambda: Interval([0, 2], [1, 1]), r"lo\[1\] = 2 > 1"),
        (lambda: Interval([0], [1, 2]), "same shape"),
        (lambda: Interval(0, 1), "vectors"),
        (lambda: Interval([np.nan], [1]), "finite"),
        (lambda: Interval.ball([0], -1), "radius must be >= 0, got -1"),
        (lambda: Interval.around(np.zeros((0, 2))), "k >= 1"),
        (lambda: Interval([0], [1])[0], "cannot be indexed"),
        (lambda: len(Interval([0], [1])), "no length"),
        (lambda: Interval([[0, 0]], [[1, 1]])[0, 0], "batch axes"),
        (lambda: Interval([[0, 0]], [[1, 1]]).to_polytope(), "a single set, got a stack"),
        (lambda: Interval([0], [1]).vertices_2d(), "planar"),
    ],
)
def test_malformed_input_is_one_clear_error(build, says):
    with pytest.raises(ReachError, match=says):
        build()
