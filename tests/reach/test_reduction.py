"""Order reduction: every method contains the original, exactly; the loss bound is a bound; none is idle."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reach.numerics.errors import ReachError
from reach.sets.reduction import METHODS, mean_width, reduce, reduction_loss
from reach.sets.relations.pairs import contains
from reach.sets.zonotope import Zonotope
from tests.reach.strategies import directions, zonotopes

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


@pytest.mark.parametrize("method", EVERY)
def test_random_sets_with_mixed_units_are_contained_exactly(method):
    rng = np.random.default_rng(3)
    for n, g in [(2, 9), (3, 8), (4, 8)]:
        z = Zonotope(rng.normal(size=n), rng.normal(size=(n, g)) * 10.0 ** rng.uniform(-6, 6, (n, 1)))
        assert contains(reduce(z, 1.5, method), z, "exact", most=10**5).holds is True


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


@pytest.mark.parametrize("method", EVERY)
def test_a_stack_is_reduced_member_by_member(method):
    rng = np.random.default_rng(0)
    stack = Zonotope(rng.normal(size=(2, 3, 3)), rng.normal(size=(2, 3, 3, 11)))
    small = reduce(stack, 2, method)
    assert small.batch == (2, 3) and small.order_count == 6
    for at in np.ndindex(2, 3):
        alone = reduce(stack[at], 2, method)
        assert np.allclose(alone.support(directions(3)), small[at].support(directions(3)))
    assert np.all(reduction_loss(stack, small) >= 0)


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


@pytest.mark.parametrize("method", ["girard", "combastel", "parallel", "pca"])
def test_aligned_generators_are_merged_without_loss(method):
    z = Zonotope([0.0, 0.0], [[1.0, 0.5, 0.0, 0.25], [0.0, 0.0, 2.0, 0.0]])
    small = reduce(z, 1, method)
    assert np.allclose(small.half_widths, z.half_widths, rtol=1e-12)
    assert np.all(reduction_loss(z, small) < 1e-9)


def test_parallel_loses_less_than_half_of_what_pca_does_where_generators_turn_slowly():
    """Sums of images of one box under powers of a matrix, as tubes have them."""
    rng, F, blocks = np.random.default_rng(2), np.eye(4), [np.diag([1.0, 0.1, 0.5, 0.2])]
    F[:2, 2:], F[2:, :2] = 0.05 * np.eye(2), -0.05 * np.eye(2)
    for _ in range(99):
        blocks.append(0.98 * F @ blocks[-1])
    z = Zonotope(np.zeros(4), np.hstack(blocks) * rng.uniform(0.9, 1, 400))
    lost = {name: mean_width(reduce(z, 15, name).G) / mean_width(z.G) - 1 for name in ("pca", "parallel")}
    assert 0 <= lost["parallel"] < lost["pca"] / 2


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


@pytest.mark.parametrize(
    ("ask", "says"),
    [
        (lambda z: reduce(z, 0.5), "at least 1, got 0.5"),
        (lambda z: reduce(z, np.nan), "order must be"),
        (lambda z: reduce(z, 1, "best"), "method must be 'auto' or one of"),
        (lambda z: reduction_loss(z, Zonotope.point([0.0])), "dimensions 2 and 1"),
    ],
)
def test_malformed_questions_are_one_clear_error(ask, says):
    with pytest.raises(ReachError, match=says):
        ask(Zonotope([0.0, 0.0], np.eye(2)))
