"""Enclosures of parts and of hulls: they hold the sampled truth, and are not idle."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reach.numerics.errors import ReachError
from reach.sets.clipping import enclosing_hull, meet_halfspace
from reach.sets.relations.pairs import contains
from reach.sets.zonotope import Zonotope
from tests.reach.strategies import directions, numbers, vectors, zonotopes


@settings(max_examples=80)
@given(zonotopes(3), vectors(3), numbers)
def test_what_a_halfspace_leaves_is_enclosed(z, normal, offset):
    points = z.sample(np.random.default_rng(0), 200)
    left = points[points @ normal <= offset]
    if -z.support(-normal) > offset:
        with pytest.raises(ReachError, match="no point of the set"):
            meet_halfspace(z, normal, offset)
        return
    part, D = meet_halfspace(z, normal, offset), directions(3)
    if len(left):
        assert np.all((left @ D.T).max(axis=0) <= part.support_up(D))
    if z.support(normal) <= offset:
        assert np.allclose(part.support(D), z.support(D))


def test_the_part_of_a_box_is_the_part_exactly_and_other_parts_are_smaller():
    box = Zonotope.box([1, 2], [1, 3])
    assert np.allclose(box.meet_halfspace([1, 0], 0.5).interval_hull().hi, [0.5, 5])
    assert np.allclose(box.meet_halfspace([-1, 0], -0.5).interval_hull().lo, [0.5, -1])
    z = Zonotope([0, 0], [[1, 1, 0.5], [1, -1, 0.5]])
    part = z.meet_halfspace([1, 0], 0)
    assert (part.half_widths / z.half_widths).sum() < 1.8


def test_stacks_are_cut_member_by_member():
    rng = np.random.default_rng(0)
    stack, D = Zonotope(rng.normal(size=(5, 3)), rng.normal(size=(5, 3, 6))), directions(3)
    offset = stack.c @ D[0]
    parts = stack.meet_halfspace(D[0], offset)
    for i in range(5):
        assert np.allclose(parts[i].support(D), stack[i].meet_halfspace(D[0], offset[i]).support(D))


@settings(max_examples=30)
@given(st.integers(1, 2), st.data())
def test_hulls_contain_both_sets_exactly(n, data):
    a, b = data.draw(zonotopes(n)), data.draw(zonotopes(n))
    for hull in (enclosing_hull(a, b), a.hull(b)):
        assert contains(hull, a, "exact").holds is True and contains(hull, b, "exact").holds is True


def test_hull_of_a_set_and_its_shuffled_translate_is_tight():
    z = Zonotope([0.0, 0.0], [[1, 0.5, 0], [0, 1, 2]])
    moved = Zonotope([3.0, 0.0], -z.G[:, [2, 0, 1]])
    hull = enclosing_hull(z, moved)
    D = directions(2)
    assert np.allclose(hull.support(D), np.maximum(z.support(D), moved.support(D)))
    assert z.hull(moved).half_widths.sum() > hull.half_widths.sum()
    both = enclosing_hull(Zonotope.stack([z, moved]), moved)
    assert both.batch == (2,) and np.allclose(both[0].support(D), hull.support(D))


@pytest.mark.parametrize(
    ("ask", "says"),
    [
        (lambda z: z.meet_halfspace([1, 0, 0], 0), "of 2 finite entries"),
        (lambda z: z.meet_halfspace([1, 0], np.nan), "offset must be finite"),
        (lambda z: enclosing_hull(z, Zonotope.point([0.0])), "dimensions 2 and 1"),
    ],
)
def test_malformed_questions_are_one_clear_error(ask, says):
    with pytest.raises(ReachError, match=says):
        ask(Zonotope([0.0, 0.0], np.eye(2)))
