"""Tubes of support functions and of zonotopes against sampled and exact truth, and how tight they are."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse

import reach
from reach import (
    HPolytope,
    Interval,
    LinearSystem,
    ReachError,
    Signal,
    SupportTube,
    Zonotope,
    support_tube,
    zonotope_tube,
)
from tests.reach import truth

BOX = Interval([-1.0, -1.0], [1.0, 1.0])
OSCILLATOR = LinearSystem([[0.0, 1.0], [-4.0, -0.2]], [[0.0], [1.0]], Interval([-1.0], [2.0]))


def rows(n, rng, count=3):
    return np.vstack([np.eye(n), rng.normal(size=(count, n))])


def holds(tube, system, X, rng, parts=4, horizon=1.0):
    """Nodes, intervals and `at` of a tube hold sampled trajectories."""
    n, steps, step = system.dim, len(tube.times) - 1, np.diff(tube.times)
    times = np.r_[(tube.times[:-1, None] + step[:, None] * np.arange(parts) / parts).ravel(), tube.times[-1]]
    if isinstance(tube, SupportTube):
        D, nodes, at, intervals = tube.directions, tube.upper, tube.at(times), [tube.interval]
    else:
        D = np.vstack([np.eye(n), -np.eye(n), rng.normal(size=(6, n))])
        nodes, at = tube.nodes.support(D), tube.at(times).support(D)
        intervals = [tube.intervals.support(D), tube.support(D)]
    values = (truth.trajectories(system, X, times, rng) @ D.T).max(axis=1)
    slack = 1e-9 * truth.size(system, X, D, horizon)
    assert np.all(values[::parts] <= nodes + slack) and np.all(values <= at + slack)
    for bounds, k in product(intervals, range(parts + 1)):
        inside = values[k : k + steps * parts : parts]
        assert np.all(inside <= bounds[: len(inside)] + slack)
    assert not isinstance(tube, SupportTube) or np.all(values.max(axis=0) <= tube.most + slack)


@given(truth.cases(), st.integers(1, 40), st.integers(0, 2))
@settings(max_examples=40, deadline=None)
def test_sampled_trajectories_stay_inside(case, steps, frame):
    system, X, rng = case
    n = system.dim
    F = [None, np.linalg.qr(rng.normal(size=(n, n)))[0], rng.normal(size=(n, n)) + 3 * np.eye(n)][frame]
    holds(support_tube(system, X, 1.0, rows(n, rng), step=1 / steps), system, X, rng)
    holds(zonotope_tube(system, X, 1.0, step=1 / steps, frame=F), system, X, rng)


@given(truth.cases(), st.floats(-3, 0))
@settings(max_examples=30, deadline=None)
def test_sampled_trajectories_stay_inside_a_tube_by_tolerance(case, exponent):
    system, X, rng = case
    D = rows(system.dim, rng)
    tolerance = 10**exponent * truth.size(system, X, D) + 1e-6
    tube = support_tube(system, X, 1.0, D, tolerance=tolerance)
    holds(tube, system, X, rng)
    assert np.all(tube.upper - tube.attained <= tolerance)
    assert np.all(tube.interval - np.maximum(tube.upper[1:], tube.upper[:-1]) <= tolerance / 2 * (1 + 1e-9))
    tube = zonotope_tube(system, X, 1.0, tolerance=tolerance[: system.dim])
    holds(tube, system, X, rng)
    assert np.all(tube.intersample <= tolerance[: system.dim] / 2 * (1 + 1e-9))


def test_a_tolerance_is_met_where_input_sets_change():
    sets, rng = [Interval([low], [low + 0.5]) for low in (-1.0, 0.5, 0.0)], np.random.default_rng(0)
    system = LinearSystem(OSCILLATOR.A, OSCILLATOR.B, sets, breaks=[1 / np.pi, 1 / np.e])
    tube = support_tube(system, Interval([0.0, 0.0], [0.1, 0.2]), 1.0, rows(2, rng), tolerance=0.02)
    holds(tube, system, Interval([0.0, 0.0], [0.1, 0.2]), rng)
    assert np.all(tube.upper - tube.attained <= 0.02)


@given(truth.cases(pieces=3))
@settings(max_examples=30, deadline=None)
def test_input_sets_that_change_hold_sampled_trajectories(case):
    system, X, rng = case
    holds(support_tube(system, X, 1.0, rows(system.dim, rng), step=1 / 24), system, X, rng)
    holds(zonotope_tube(system, X, 1.0, step=1 / 24), system, X, rng)


@given(truth.cases(pieces=2), st.sampled_from([0.25, 0.5, 1.0]))
@settings(max_examples=30, deadline=None)
def test_exact_support_lies_between_the_two_bounds(case, t):
    system, X, rng = case
    D = rows(system.dim, rng)
    tube = support_tube(system, X, 1.0, D, step=1 / 64)
    k = int(np.argmin(np.abs(tube.times - t)))
    value, error = truth.exact(system, X, t, D)
    assert np.all(tube.attained[k] <= value + error) and np.all(value <= tube.upper[k] + error)
    assert np.all(tube.reached <= tube.most)


def test_halving_the_step_quarters_the_excess():
    D = np.array([[1.0, 0.0], [0.3, -1.0]])
    value, error = truth.exact(OSCILLATOR, BOX, 2.0, D, 2**13)
    tubes = [support_tube(OSCILLATOR, BOX, 2.0, D, step=2.0 / steps) for steps in (64, 128, 256)]
    excess, above = (
        [(tube.upper[-1] - value).max() for tube in tubes],
        [tube.intersample.max() for tube in tubes],
    )
    assert np.all(error < 1e-2 * excess[-1])
    for a, b, c in (excess, above):
        assert 3.5 < a / b < 4.6 and 3.5 < b / c < 4.6


@given(truth.cases(kinds=("random", "oscillating", "unstable", "triangular")))
@settings(max_examples=25, deadline=None)
def test_every_carrier_gives_the_same_bounds(case):
    system, X, rng = case
    n = system.dim
    D = rows(n, rng)
    dense = support_tube(system, X, 1.0, D, step=1 / 40)
    acting = LinearSystem(sparse.csr_matrix(system.A), system.B, system.U, system.c)
    thin = support_tube(acting, X, 1.0, D, step=1 / 40)
    # Two parts that do not act on each other, without a centre of the input, which would join them.
    widths = [U.interval_hull().half_widths for U in system.U]
    U, B = (Interval(-widths[0], widths[0]), system.B) if widths else (None, None)
    stacked = None if U is None else np.vstack([B] * 2)
    pair = LinearSystem(sparse.block_diag([system.A] * 2), stacked, U)
    box = X.interval_hull()
    both = Interval(np.tile(box.lo, 2), np.tile(box.hi, 2))
    alone = support_tube(LinearSystem(system.A, B, U), box, 1.0, D, step=1 / 40)
    parts = support_tube(pair, both, 1.0, np.hstack([D, 0 * D]), step=1 / 40)
    slack = 1e-9 * truth.size(system, X, D)  # rounding is booked in each by what is known of its growth
    for name in ("upper", "attained", "interval", "intersample"):
        assert np.all(np.abs(getattr(thin, name) - getattr(dense, name)) <= slack)
        assert np.all(np.abs(getattr(parts, name) - getattr(alone, name)) <= slack)


@given(truth.cases(pieces=2))
@settings(max_examples=25, deadline=None)
def test_a_discrete_system_is_exact(case):
    system, X, rng = case
    A, D = system.A / max(1.0, np.abs(system.A).sum()), rows(system.dim, rng)
    steps = LinearSystem(
        A, system.B if system.U else None, system.U or None, system.c, [3.0] if system.U else (), True
    )
    for variant in (
        steps,
        LinearSystem(sparse.csr_matrix(A), steps.B, steps.U or None, steps.c, steps.breaks, True),
    ):
        tube = support_tube(variant, X, 9, D)
        value = X.support(D @ np.linalg.matrix_power(A, 9))
        for j in range(9):
            row = D @ np.linalg.matrix_power(A, 8 - j)
            value = value + row @ steps.c
            if steps.U:
                value = value + steps.U[int(j >= 3)].support(row @ steps.B)
        assert np.allclose(tube.upper[-1], value, rtol=1e-11, atol=1e-11 * truth.size(steps, X, D, 9.0).max())
        assert np.all(tube.attained[-1] <= tube.upper[-1])
        assert not np.any(tube.intersample)


def test_a_limit_saves_steps_and_is_kept():
    free = LinearSystem(OSCILLATOR.A)
    loose = support_tube(free, BOX, 20.0, [[1.0, 0.0]], tolerance=1e-4, limit=1.3)
    assert len(loose.times) < len(support_tube(free, BOX, 20.0, [[1.0, 0.0]], tolerance=1e-4).times)
    assert loose.most[0] <= 1.3
    holds(loose, free, BOX, np.random.default_rng(0), 2, 20.0)


def test_default_steps_follow_the_size_of_what_is_bounded():
    tube = support_tube(OSCILLATOR, BOX, 4.0, [[1.0, 0.0], [1e-6, 0.0]])
    assert np.all(tube.upper - tube.attained <= 0.011 * np.abs(tube.upper).max(axis=0))
    stiff = LinearSystem(np.diag([-1e7, -1.0]), np.eye(2), Interval([-1.0, 0.0], [1.0, 0.0]))
    tube = support_tube(stiff, Interval([0.0, 1.0], [0.0, 1.0]), 1.0, np.eye(2))
    assert tube.most[0] == pytest.approx(1e-7, rel=0.1)
    assert tube.most[1] == pytest.approx(1.0, rel=0.02)
    falling = LinearSystem([[-1.0]], [[1.0]], Interval([-1.0], [0.0]))
    tube = support_tube(falling, Interval([0.0], [0.0]), 1.0, [[1.0]])
    assert 0 <= tube.most[0] < 0.01


def test_a_held_input_of_a_discrete_system_stays():
    steps = LinearSystem([[0.5]], [[1.0]], Interval([0.0], [1.0]), discrete=True)
    tube = support_tube(steps.holding_inputs(), Interval([0.0, 0.0], [0.0, 1.0]), 30, [[1.0, 0.0]])
    assert tube.upper[-1, 0] == pytest.approx(2.0, abs=1e-8)


@pytest.mark.parametrize("keep_sparse", [False, True])
@pytest.mark.parametrize("rate", [150.0, 300.0, 600.0])
def test_a_part_that_grows_by_hundreds_of_decades_leaves_the_others_alone(rate, keep_sparse):
    A = np.diag([rate, -0.1])
    system = LinearSystem(sparse.csr_matrix(A) if keep_sparse else A)
    tube = support_tube(system, Interval([0.0, 1.0], [0.0, 1.0]), 1.0, [[0.0, 1.0]], step=1 / 8)
    assert tube.upper[-1, 0] >= np.exp(-0.1) * (1 - 1e-14)


def test_a_break_between_the_nodes_is_booked():
    # The step is carried in parts: the break is a node of those, not of the tube.
    A = np.array([[0.0, 30.0], [-0.1, 0.0]])
    point = Interval([0.0, 0.0], [0.0, 0.0])
    system = LinearSystem(A, np.eye(2), (point, Interval([1.0, 0.0], [1.0, 0.0])), breaks=[0.25])
    exact = support_tube(system, point, 1.0, np.eye(2), step=0.25)
    holds(exact, system, point, np.random.default_rng(0), 16)
    for step in (0.5, 0.1, 0.01):
        tube = support_tube(system, point, 1.0, np.eye(2), step=step)
        holds(tube, system, point, np.random.default_rng(0), 16)
        assert np.all(tube.attained[-1] <= exact.upper[-1]) and np.all(exact.attained[-1] <= tube.upper[-1])
        # The rate of the rows is at most 18: 30 ** 0.5 of the turning system, and 3 times that with both.
        assert np.all(tube.upper[-1] - exact.upper[-1] <= 40 * step)


def test_input_sets_that_share_no_grid_are_enclosed():
    sets = [Interval([-1.0], [1.0]), Interval([0.0], [3.0]), Interval([-2.0], [-1.0])]
    breaks = [0.1, np.sqrt(0.5)]
    system = LinearSystem([[0.0]], [[1.0]], sets, breaks=breaks)
    tube = support_tube(system, Interval([0.0], [0.0]), 1.0, [[1.0], [-1.0]], step=1 / 64)
    high = 0.1 + 3 * (breaks[1] - 0.1) - (1 - breaks[1])
    assert high <= tube.upper[-1, 0] <= high + 0.15 and tube.attained[-1, 0] <= high
    least = -(0.1 + 2 * (1 - breaks[1]))
    assert -least <= tube.upper[-1, 1] <= -least + 0.15
    path = reach.worst_case(system, Interval([0.0], [0.0]), 1.0, [1.0])
    assert path.states[-1, 0] == pytest.approx(high, abs=1e-12)
    for t, u in zip((path.times[:-1] + path.times[1:]) / 2, path.inputs, strict=True):
        assert u in sets[int(np.searchsorted(breaks, t))]


BAD = [
    ({"horizon": -1.0}, "horizon"),
    ({"step": 0.0}, "step"),
    ({"step": 0.1, "tolerance": 0.1}, "not both"),
    ({"tolerance": [1.0, 1.0, 1.0]}, "tolerance"),
    ({"initial": Interval([0.0], [1.0])}, "initial set"),
    ({"initial": Interval(np.zeros((3, 2)), np.ones((3, 2)))}, "initial set"),
    ({"initial": HPolytope([[1.0, 0], [-1, 0], [0, 1], [0, -1]], [-1.0, -1, 1, 1])}, "empty"),
    ({"initial": HPolytope([[1.0, 0.0]], [1.0])}, "bounded"),
]
GROWING = {
    "system": LinearSystem([[700.0]]),
    "initial": Interval([1.0], [1.0]),
    "horizon": 2.0,
    "directions": [[1.0]],
}
OF_ONE = [
    (support_tube, {"directions": [[1.0]]}, "directions"),
    (support_tube, {"directions": [["a", "b"]]}, "directions"),
    (support_tube, {"step": 1e-9}, "steps"),
    (support_tube, {"tolerance": 1e-18}, "tolerance"),
    (support_tube, {"tolerance": 1.0, "limit": [1.0, 1.0, 1.0]}, "limit"),
    (support_tube, {"system": LinearSystem([[0.0, 1e11], [-1e11, 0.0]]), "step": 0.5}, "too long"),
    (support_tube, GROWING | {"step": 0.01}, "beyond floating point"),
    (support_tube, GROWING | {"tolerance": 1.0}, "below the rounding"),
    (support_tube, {"system": LinearSystem(np.eye(2), discrete=True), "horizon": 2.5}, "whole number"),
    (support_tube, {"system": LinearSystem(np.eye(2), discrete=True), "step": 0.5}, "whole number"),
    (zonotope_tube, {"frame": np.ones((2, 2))}, "frame"),
    (zonotope_tube, {"frame": np.eye(3)}, "frame"),
]


@pytest.mark.parametrize(
    ("tube", "changed", "message"),
    [*((tube, *case) for tube in (support_tube, zonotope_tube) for case in BAD), *OF_ONE],
)
def test_bad_arguments_get_one_clear_error(tube, changed, message):
    arguments = {"system": OSCILLATOR, "initial": BOX, "horizon": 1.0}
    if tube is support_tube:
        arguments["directions"] = np.eye(2)
    with pytest.raises(ReachError, match=message):
        tube(**arguments | changed)


def test_times_outside_are_refused():
    tube = support_tube(OSCILLATOR, BOX, 1.0, np.eye(2), step=0.1)
    for t in (-0.1, 1.1, np.nan):
        with pytest.raises(ReachError, match="times"):
            tube.at(t)


@pytest.mark.parametrize("count", [4, 16])
def test_between_nodes_an_input_that_has_ended_counts_as_one_that_acts(count):
    """A push at an oscillator that stops at a quarter of a turn: what is left swings over its chord."""
    stop = np.pi / 2
    sets = (Interval([-1.0], [1.0]), Interval([0.0], [0.0]))
    system = LinearSystem([[0.0, 1.0], [-1.0, 0.0]], [[0.0], [1.0]], sets, breaks=[stop])
    rest = Interval([0.0, 0.0], [0.0, 0.0])
    tube = support_tube(system, rest, 2 * stop, [[1.0, 0.0]], step=stop / count)
    t = stop + stop / count * np.linspace(0, 1, 9)
    exact = np.cos(t - stop) - np.cos(t)  # the integral of the sine over the lags at which it was pushed
    assert np.all(exact <= tube.at(t)[:, 0])


def test_drift_that_cancels_the_centre_of_the_input():
    # What is left is an input about 0: the drift must not be counted again.
    system = LinearSystem([[-1.0]], [[1.0]], Interval([-2.0], [0.0]), [1.0])
    hull = zonotope_tube(system, Interval([0.0], [0.0]), 1.0, step=0.1).nodes[-1].interval_hull()
    reach = 1 - np.exp(-1)
    assert -1.01 * reach < hull.lo[0] <= -reach and reach <= hull.hi[0] < 1.01 * reach


def test_nodes_and_intervals_of_an_oscillator_are_tight():
    D, steps = np.vstack([np.eye(2), -np.eye(2)]), 100
    tube = zonotope_tube(OSCILLATOR, BOX, 5.0, step=5.0 / steps)
    fine = support_tube(OSCILLATOR, BOX, 5.0, D, step=0.001)
    for k in range(0, steps, 10):
        inside = (fine.times >= tube.times[k] - 1e-12) & (fine.times <= tube.times[k + 1] + 1e-12)
        reached, bound = fine.attained[inside].max(axis=0), tube.support(D)[k]
        assert np.all(bound >= reached)
        assert np.all(bound[:2] + bound[2:] <= 1.003 * (reached[:2] + reached[2:]))


def test_generators_of_the_initial_set_come_first_and_are_exact():
    start = reach.Zonotope([1.0, 0.0], [[0.1, 0.0, 0.2], [0.0, 0.3, 0.1]])
    tube = zonotope_tube(LinearSystem([[0.0, 1.0], [-1.0, 0.0]]), start, np.pi / 2, step=0.1)
    turn = np.array([[0.0, 1.0], [-1.0, 0.0]])
    assert np.allclose(tube.nodes.G[-1, :, :3], turn @ start.G, atol=1e-12)
    assert np.allclose(tube.nodes.c[-1], turn @ start.c, atol=1e-12)
    assert np.all(np.abs(tube.nodes.G[-1, :, 3:]) < 1e-11)


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


def test_a_tolerance_per_axis_with_inputs_that_are_not_symmetric():
    triangle = HPolytope([[-1.0, 0.0], [0.0, -1.0], [1.0, 1.0]], [0.0, 0.0, 1.0])
    system = LinearSystem([[0.0, 1.0], [-1.0, -0.1]], np.eye(2), triangle)
    tolerance = np.array([0.01, 0.2])
    tube = zonotope_tube(system, Interval([0.0, 0.0], [0.1, 0.1]), 1.0, tolerance=tolerance)
    rows = np.vstack([np.eye(2), -np.eye(2)])
    exact = support_tube(system, Interval([0.0, 0.0], [0.1, 0.1]), 1.0, rows, tolerance=1e-3)
    excess = tube.nodes[-1].support(rows) - exact.upper[-1]
    assert np.all(excess >= -1e-3) and np.all(excess <= np.tile(tolerance, 2) + 1e-3)


A = np.array([[0.0, 1.0], [-1.0, 0.0]])
U = Interval([-1.0], [1.0])


def test_what_is_left_out_is_nothing():
    system = LinearSystem(A)
    assert (system.dim, system.inputs, system.U) == (2, 0, ())
    assert np.array_equal(system.c, [0.0, 0.0])
    assert LinearSystem(A, U=Interval([-1.0, 0.0], [1.0, 0.0])).inputs == 2
    assert LinearSystem(sparse.identity(9), U=Interval(np.zeros(9), np.ones(9))).sparse


@pytest.mark.parametrize("make", [np.asarray, sparse.csr_matrix])
@pytest.mark.parametrize("discrete", [False, True])
def test_holding_inputs_appends_them_as_states(make, discrete):
    push = Signal([0.0], [[1.0]])
    system = LinearSystem(make(A), [[0.0], [2.0]], U, [1.0, 0.0], discrete=discrete, nominal=push)
    full = system.holding_inputs()
    assert full.nominal is push and np.array_equal(sparse.csr_matrix(full.B).toarray(), [[0.0], [2.0], [0.0]])
    assert full.sparse == system.sparse
    matrix = full.A.toarray() if full.sparse else full.A
    last = [0.0, 0.0, float(discrete)]
    assert np.array_equal(matrix, [[0.0, 1.0, 0.0], [-1.0, 0.0, 2.0], last])
    assert np.array_equal(full.c, [1.0, 0.0, 0.0]) and full.U == ()


B = [[0.0], [1.0]]
DESCRIPTIONS = [
    ({"A": np.ones((2, 3))}, r"A must be square.*\(2, 3\)"),
    ({"A": np.zeros((0, 0))}, "A must be square"),
    ({"A": [1.0, 2.0]}, "A must be a matrix"),
    ({"A": [["a"]]}, "A must be numbers"),
    ({"A": sparse.csr_matrix([[np.inf]])}, "A has entries"),
    ({"A": A, "B": [[1.0]], "U": U}, "B must have 2 rows"),
    ({"A": A, "B": B}, "B is given without U"),
    ({"A": A, "B": B, "U": Interval([0.0] * 2, [1.0] * 2)}, "dimension 1"),
    ({"A": A, "B": B, "U": 3.0}, "U must be a convex set, got float"),
    ({"A": A, "B": B, "U": Zonotope(np.zeros((4, 1)), np.zeros((4, 1, 1)))}, "stack"),
    ({"A": A, "c": [1.0, np.nan]}, "c must be 2"),
    ({"A": A, "B": B, "U": (U, U)}, "need 1 breaks"),
    ({"A": A, "B": B, "U": (U, U, U), "breaks": [2.0, 1.0]}, "increasing"),
    ({"A": A, "B": B, "U": (U, U), "breaks": [0.0]}, "positive"),
]


@pytest.mark.parametrize(("arguments", "message"), DESCRIPTIONS)
def test_bad_systems_get_one_clear_error(arguments, message):
    with pytest.raises(ReachError, match=message):
        LinearSystem(**arguments)


def test_only_one_set_can_be_held():
    with pytest.raises(ReachError, match="got 2"):
        LinearSystem(A, [[0.0], [1.0]], (U, U), breaks=[1.0]).holding_inputs()
    with pytest.raises(ReachError, match="got 0"):
        LinearSystem(A).holding_inputs()


@pytest.mark.parametrize(
    ("body", "message"),
    [(HPolytope([[1.0], [-1.0]], [-1.0, -1.0]), "empty"), (HPolytope([[1.0]], [1.0]), "bounded")],
)
def test_input_sets_that_cannot_be_bounded_are_refused_by_tubes(body, message):
    system, start = LinearSystem(A, B, body), Interval([0.0, 0.0], [1.0, 1.0])
    with pytest.raises(ReachError, match=message):
        support_tube(system, start, 1.0, np.eye(2), step=0.1)
    with pytest.raises(ReachError, match=message):
        zonotope_tube(system, start, 1.0, step=0.1)
