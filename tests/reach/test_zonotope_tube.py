"""Zonotope tubes against sampled truth, and how tight they are."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse

from reach import (
    Ellipsoid,
    HPolytope,
    Interval,
    LinearSystem,
    ReachError,
    Zonotope,
    support_tube,
    zonotope_tube,
)
from tests.reach import truth

BOX = Interval([-1.0, -1.0], [1.0, 1.0])
OSCILLATOR = LinearSystem([[0.0, 1.0], [-4.0, -0.2]], [[0.0], [1.0]], Interval([-1.0], [2.0]))


def holds(tube, system, X, rng, parts=4, horizon=1.0):
    """Nodes, intervals and `at` hold sampled trajectories, judged along many directions."""
    n, steps = system.dim, len(tube.times) - 1
    D = np.vstack([np.eye(n), -np.eye(n), rng.normal(size=(6, n))])
    share = np.arange(parts) / parts
    times = np.r_[(tube.times[:-1, None] + np.diff(tube.times)[:, None] * share).ravel(), tube.times[-1]]
    values = (truth.trajectories(system, X, times, rng) @ D.T).max(axis=1)
    slack = 1e-9 * truth.size(system, X, D, horizon)
    assert np.all(values[::parts] <= tube.nodes.support(D) + slack)
    assert np.all(values <= tube.at(times).support(D) + slack)
    for bounds in (tube.intervals.support(D), tube.support(D)):
        for k in range(parts + 1):
            inside = values[k : k + steps * parts : parts]
            assert np.all(inside <= bounds[: len(inside)] + slack)


def frames(n, rng):
    return [None, np.linalg.qr(rng.normal(size=(n, n)))[0], rng.normal(size=(n, n)) + 3 * np.eye(n)]


@given(truth.cases(), st.integers(1, 40), st.integers(0, 2))
@settings(max_examples=40)
def test_sampled_trajectories_stay_inside(case, steps, frame):
    system, X, rng = case
    F = frames(system.dim, rng)[frame]
    holds(zonotope_tube(system, X, 1.0, step=1 / steps, frame=F), system, X, rng)


@given(truth.cases(pieces=3))
@settings(max_examples=25)
def test_input_sets_that_change_hold_sampled_trajectories(case):
    system, X, rng = case
    holds(zonotope_tube(system, X, 1.0, step=1 / 24), system, X, rng)


@given(truth.cases(), st.floats(-3, 0))
@settings(max_examples=25)
def test_sampled_trajectories_stay_inside_a_tube_by_tolerance(case, exponent):
    system, X, rng = case
    tolerance = 10**exponent * truth.size(system, X, np.eye(system.dim)) + 1e-6
    tube = zonotope_tube(system, X, 1.0, tolerance=tolerance)
    holds(tube, system, X, rng)
    assert np.all(tube.intersample <= tolerance / 2 * (1 + 1e-9))


@given(truth.cases(kinds=("random", "oscillating", "units", "nilpotent")))
@settings(max_examples=25)
def test_box_around_the_nodes_is_that_of_support_functions(case):
    system, X, _ = case
    n = system.dim
    box = X if isinstance(X, Zonotope) else X.interval_hull()
    tube = zonotope_tube(system, box, 1.0, step=1 / 32)
    exact = support_tube(system, box, 1.0, np.vstack([np.eye(n), -np.eye(n)]), step=1 / 32)
    hull = tube.nodes.interval_hull()
    size = truth.size(system, X, np.eye(n))
    assert np.all(np.abs(hull.hi - exact.upper[:, :n]) <= 1e-2 * size)
    assert np.all(np.abs(hull.lo + exact.upper[:, n:]) <= 1e-2 * size)


def test_drift_that_cancels_the_centre_of_the_input():
    # What is left is an input about 0: the drift must not be counted again.
    system = LinearSystem([[-1.0]], [[1.0]], Interval([-2.0], [0.0]), [1.0])
    hull = zonotope_tube(system, Interval([0.0], [0.0]), 1.0, step=0.1).nodes[-1].interval_hull()
    reach = 1 - np.exp(-1)
    assert -1.01 * reach < hull.lo[0] <= -reach
    assert reach <= hull.hi[0] < 1.01 * reach


@pytest.mark.parametrize(("steps", "ratio"), [(20, 1.07), (100, 1.003), (1000, 1.0001)])
def test_nodes_and_intervals_of_an_oscillator_are_tight(steps, ratio):
    d = np.eye(2)
    tube = zonotope_tube(OSCILLATOR, BOX, 5.0, step=5.0 / steps)
    fine = support_tube(OSCILLATOR, BOX, 5.0, np.vstack([d, -d]), step=0.001)
    for k in range(0, steps, max(steps // 10, 1)):
        t = tube.times[k : k + 2]
        inside = (fine.times >= t[0] - 1e-12) & (fine.times <= t[1] + 1e-12)
        reached = fine.attained[inside].max(axis=0)
        bound = tube.support(np.vstack([d, -d]))[k]
        assert np.all(bound[:2] + bound[2:] <= ratio * (reached[:2] + reached[2:]))
        hull = tube.intervals[k].interval_hull()
        assert np.all(np.r_[hull.hi, -hull.lo] >= reached)


def test_generators_of_the_initial_set_come_first_and_are_exact():
    start = Zonotope([1.0, 0.0], [[0.1, 0.0, 0.2], [0.0, 0.3, 0.1]])
    tube = zonotope_tube(LinearSystem([[0.0, 1.0], [-1.0, 0.0]]), start, np.pi / 2, step=0.1)
    turn = np.array([[0.0, 1.0], [-1.0, 0.0]])
    assert np.allclose(tube.nodes.G[-1, :, :3], turn @ start.G, atol=1e-12)
    assert np.allclose(tube.nodes.c[-1], turn @ start.c, atol=1e-12)
    assert np.all(np.abs(tube.nodes.G[-1, :, 3:]) < 1e-11)


def test_a_frame_in_mixed_units_costs_nothing():
    s = np.array([1e-6, 1e6])
    A = OSCILLATOR.A * s[:, None] / s
    scaled = LinearSystem(A, OSCILLATOR.B * s[:, None], OSCILLATOR.U)
    box = Interval(BOX.lo * s, BOX.hi * s)
    plain = zonotope_tube(OSCILLATOR, BOX, 2.0, step=0.01).nodes[-1].half_widths
    for F in (None, np.diag(s)):
        widths = zonotope_tube(scaled, box, 2.0, step=0.01, frame=F).nodes[-1].half_widths
        assert np.allclose(widths / s, plain, rtol=1e-9)


def test_every_carrier_gives_the_same_zonotopes():
    rng = np.random.default_rng(1)
    A = rng.normal(size=(4, 4)) - np.eye(4)
    start, U = Zonotope(np.ones(4), rng.normal(size=(4, 2))), Ellipsoid([0.5, 0.0], np.eye(2))
    B, c = rng.normal(size=(4, 2)), rng.normal(size=4)
    dense = zonotope_tube(LinearSystem(A, B, U, c), start, 1.0, step=0.02)
    thin = zonotope_tube(LinearSystem(sparse.csr_matrix(A), B, U, c), start, 1.0, step=0.02)
    assert np.allclose(dense.nodes.c, thin.nodes.c, rtol=1e-10, atol=1e-10)
    assert np.allclose(dense.nodes.G, thin.nodes.G, rtol=1e-9, atol=1e-9)
    assert np.allclose(dense.intersample, thin.intersample, rtol=1e-9, atol=1e-12)


def test_a_discrete_system_follows_its_recursion():
    system = LinearSystem([[0.5, 0.2], [0.0, 0.9]], np.eye(2), BOX, [0.3, 0.0], discrete=True)
    tube = zonotope_tube(system, Interval([1.0, 1.0], [2.0, 1.0]), 12)
    lo, hi = np.array([1.0, 1.0]), np.array([2.0, 1.0])
    for k in range(13):
        hull = tube.nodes[k].interval_hull()
        assert np.all(hull.lo <= lo) and np.all(hi <= hull.hi)
        assert np.allclose(hull.lo, lo, atol=1e-9) and np.allclose(hull.hi, hi, atol=1e-9)
        # A >= 0: the corners go to corners.
        lo, hi = system.A @ lo + system.c - 1, system.A @ hi + system.c + 1


def test_a_zonotope_is_not_wrapped_over_many_turns():
    turning = LinearSystem([[0.0, 1.0], [-1.0, 0.0]], np.eye(2), Interval([-1e-3] * 2, [1e-3] * 2))
    tube = zonotope_tube(turning, BOX, 200.0, step=0.1)
    exact = support_tube(turning, BOX, 200.0, np.eye(2), step=0.1)
    assert np.allclose(tube.nodes[-1].half_widths, exact.upper[-1], rtol=1e-9)
    assert tube.nodes[-1].half_widths.max() < 1.5 + 200 * 1.3e-3


BAD = {
    "singular frame": ({"frame": np.ones((2, 2))}, "frame"),
    "frame of another size": ({"frame": np.eye(3)}, "frame"),
    "frame with nan": ({"frame": [[1.0, np.nan], [0.0, 1.0]]}, "frame"),
    "zero step": ({"step": 0.0}, "step"),
    "nan horizon": ({"horizon": np.nan}, "horizon"),
    "step and tolerance": ({"step": 0.1, "tolerance": 1.0}, "not both"),
    "negative tolerance": ({"tolerance": -1.0}, "tolerance"),
    "initial set of another dimension": ({"initial": Interval([0.0], [1.0])}, "initial set"),
    "initial set is no set": ({"initial": [1.0, 2.0]}, "initial set"),
    "initial set is a stack": ({"initial": Interval(np.zeros((3, 2)), np.ones((3, 2)))}, "initial set"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_arguments_get_one_clear_error(name):
    changed, message = BAD[name]
    arguments = {"system": OSCILLATOR, "initial": BOX, "horizon": 1.0} | changed
    with pytest.raises(ReachError, match=message):
        zonotope_tube(**arguments)


def test_a_tolerance_per_axis_with_inputs_that_are_not_symmetric():
    triangle = HPolytope([[-1.0, 0.0], [0.0, -1.0], [1.0, 1.0]], [0.0, 0.0, 1.0])
    system = LinearSystem([[0.0, 1.0], [-1.0, -0.1]], np.eye(2), triangle)
    tolerance = np.array([0.01, 0.2])
    tube = zonotope_tube(system, Interval([0.0, 0.0], [0.1, 0.1]), 1.0, tolerance=tolerance)
    rows = np.vstack([np.eye(2), -np.eye(2)])
    exact = support_tube(system, Interval([0.0, 0.0], [0.1, 0.1]), 1.0, rows, tolerance=1e-3)
    excess = tube.nodes[-1].support(rows) - exact.upper[-1]
    assert np.all(excess >= -1e-3) and np.all(excess <= np.tile(tolerance, 2) + 1e-3)
    with pytest.raises(ReachError, match="tolerance"):
        zonotope_tube(system, Interval([0.0, 0.0], [0.1, 0.1]), 1.0, tolerance=[0.1, 0.1, 0.1])
