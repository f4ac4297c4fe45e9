"""Continuations beside the recoverable sets: the same limits, no larger needs, the same witnesses."""

import numpy as np
import pytest

from polaris.synthesis.safety.continuation import Continuation, Limits
from polaris.synthesis.safety.row_table import RowTable
from polaris.synthesis.sources.disturbance import Disturbance
from polaris.synthesis.tracker.loop import Loop
from polaris.synthesis.tracker.tightening import Tightening
from reach.sets.zonotope import Zonotope

from ..kept import printed


def continuation(safety):
    """S of a schedule without errors, along its reference, with the limits of its recoverable sets."""
    sets, tracking = safety.recoverable, safety.tracking
    system, clearance = tracking.system, safety.clearance
    loop = Disturbance(system.D, system.w_max).extend(Loop.of(system.A, system.B, tracking.flow.h))
    closed = loop.under(tracking.gain)
    tightening = Tightening(closed, system.u_max, np.abs(safety.start.extent) + 1e-6)
    table = RowTable(tightening, clearance.obstacle_rows[0], np.vstack([closed.K, -closed.K]))
    taken = np.broadcast_to(sets._taken, sets.room.shape)
    limits = Limits(sets.index, sets.room, taken, tuple(sets.names), np.zeros(sets.room.shape[2], dtype=bool))
    return Continuation(table, limits, tracking.flow.h, clearance.planned)


@pytest.fixture(scope="module", params=["static", "keep_out"])
def both(request):
    _, schedule = printed(request.param)
    return schedule.safety.recoverable, continuation(schedule.safety)


def test_margins_are_those_of_the_recoverable_sets_or_better(both):
    sets, found = both
    rng, seen = np.random.default_rng(0), set()
    for _ in range(60):
        cell = int(rng.integers(0, sets.clearance.planned))
        size = 10.0 ** rng.uniform(-1.5, 2.0)
        scale = np.array([1.0, 1.0, 1.0, 0.02, 0.02, 0.02]) * size
        one = Zonotope(scale * rng.uniform(-1, 1, 6), scale[:, None] * rng.uniform(-1, 1, (6, 9)) / 3)
        old = sets.margin_at(cell, one)
        new = found.margin(cell * sets.clearance.q, Zonotope(one.c[None], one.G[None]))
        # Above 0.95 both are bounds by a norm of their own.
        assert new.value >= min(old.value - 1e-9, 0.95)
        assert new.value <= old.value + 0.02 * (1 + abs(old.value))
        assert new.inside == found.holds(cell * sets.clearance.q, Zonotope(one.c[None], one.G[None]))
        seen.add(new.inside)
    assert seen == {True, False}


def test_a_set_is_as_tight_as_its_worst_point(both):
    sets, found = both
    rng, node = np.random.default_rng(1), 3 * sets.clearance.q
    one = Zonotope(np.zeros(6), np.diag([2.0, 2.0, 2.0, 0.03, 0.03, 0.03]))
    whole = found.margin(node, Zonotope(one.c[None], one.G[None])).value
    corners = np.array([one.G @ rng.choice([-1.0, 1.0], 6) for _ in range(20)])
    each = [found.margin(node, Zonotope(c[None], np.zeros((1, 6, 0)))).value for c in corners]
    assert min(each) >= whole - 1e-9


def test_every_set_of_a_tube_counts(both):
    sets, found = both
    node = 2 * sets.clearance.q
    small, large = np.diag([0.1] * 3 + [0.001] * 3), np.diag([3.0] * 3 + [0.05] * 3)
    zeros = np.zeros((2, 6))
    apart = found.margin(node, Zonotope(zeros, np.stack([small, large]))).value
    alone = found.margin(node + 1, Zonotope(zeros[:1], large[None])).value
    assert apart <= alone + 1e-9
    bent = found.margin(node, Zonotope(zeros, np.stack([small, small])), np.full((1, 6), 50.0)).value
    assert bent < found.margin(node, Zonotope(zeros, np.stack([small, small]))).value


def test_loop_states_from_which_limits_are_kept(both):
    sets, found = both
    near, far = np.zeros(6), np.array([0.0, 1e4, 0.0, 0.0, 0.0, 0.0])
    assert found.contains(5, np.array([near, far])).tolist() == [True, False]
