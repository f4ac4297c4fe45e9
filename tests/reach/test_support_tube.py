"""Support-function tubes against sampled and exact truth, and how tight they are."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse

from reach import HPolytope, Interval, LinearSystem, ReachError, Zonotope, support_tube, worst_case
from tests.reach import truth

BOX = Interval([-1.0, -1.0], [1.0, 1.0])
OSCILLATOR = LinearSystem([[0.0, 1.0], [-4.0, -0.2]], [[0.0], [1.0]], Interval([-1.0], [2.0]))
ROOM = LinearSystem([[-0.5, 2.0], [-1.0, -3.0]], np.eye(2), Zonotope([0.2, 0.0], [[0.3, 0.1], [0.0, 0.4]]))


def rows(n, rng, count=3):
    return np.vstack([np.eye(n), rng.normal(size=(count, n))])


def holds(tube, system, X, rng, parts=4, horizon=1.0):
    """Nodes, intervals and `at` hold sampled trajectories."""
    steps = len(tube.times) - 1
    step = np.diff(tube.times)
    share = np.arange(parts) / parts
    times = np.r_[(tube.times[:-1, None] + step[:, None] * share).ravel(), tube.times[-1]]
    x = truth.trajectories(system, X, times, rng)
    values = (x @ tube.directions.T).max(axis=1)
    slack = 1e-9 * truth.size(system, X, tube.directions, horizon)
    assert np.all(values[::parts] <= tube.upper + slack)
    assert np.all(values <= tube.at(times) + slack)
    for k in range(parts + 1):
        inside = values[k : k + steps * parts : parts]
        assert np.all(inside <= tube.interval[: len(inside)] + slack)
    assert np.all(values.max(axis=0) <= tube.most + slack)


@given(truth.cases(), st.integers(1, 40))
@settings(max_examples=30, deadline=None)
def test_sampled_trajectories_stay_inside(case, steps):
    system, X, rng = case
    holds(support_tube(system, X, 1.0, rows(system.dim, rng), step=1 / steps), system, X, rng)


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


@pytest.mark.parametrize("tolerance", [None, 0.02])
@pytest.mark.parametrize("breaks", [[0.3, 0.75], [1 / np.pi, 1 / np.e]])
def test_a_tolerance_is_met_where_input_sets_change(breaks, tolerance):
    sets = [Interval([low], [low + 0.5]) for low in (-1.0, 0.5, 0.0)]
    system, X = (
        LinearSystem(OSCILLATOR.A, OSCILLATOR.B, sets, breaks=breaks),
        Interval([0.0, 0.0], [0.1, 0.2]),
    )
    rng = np.random.default_rng(0)
    tube = support_tube(system, X, 1.0, rows(2, rng), tolerance=tolerance)
    holds(tube, system, X, rng)
    allowed = 0.01 * np.abs(tube.upper).max(axis=0) if tolerance is None else tolerance
    assert np.all(tube.upper - tube.attained <= allowed)
    assert np.all(tube.interval - tube.attained[1:] <= 0.5)


@given(truth.cases(pieces=3))
@settings(max_examples=30, deadline=None)
def test_input_sets_that_change_hold_sampled_trajectories(case):
    system, X, rng = case
    holds(support_tube(system, X, 1.0, rows(system.dim, rng), step=1 / 24), system, X, rng)


@given(truth.cases(pieces=2), st.sampled_from([0.25, 0.5, 1.0]))
@settings(max_examples=30, deadline=None)
def test_exact_support_lies_between_the_two_bounds(case, t):
    system, X, rng = case
    D = rows(system.dim, rng)
    tube = support_tube(system, X, 1.0, D, step=1 / 64)
    k = int(np.argmin(np.abs(tube.times - t)))
    value, error = truth.exact(system, X, t, D)
    assert np.all(tube.attained[k] <= value + error)
    assert np.all(value <= tube.upper[k] + error)
    assert np.all(tube.reached <= tube.most)


@given(truth.cases(pieces=2))
@settings(max_examples=20, deadline=None)
def test_the_input_of_the_maximum_principle_reaches_what_is_attained(case):
    system, X, rng = case
    d = rng.normal(size=system.dim)
    tube = support_tube(system, X, 1.0, d, step=1 / 64)
    reached = truth.worst(system, X, np.linspace(0, 1, 513), d)
    slack = 1e-9 * truth.size(system, X, d[None])
    assert reached <= tube.upper[-1] + slack
    assert reached >= tube.attained[-1] - (tube.upper[-1] - tube.attained[-1]) - slack


@pytest.mark.parametrize("system", [OSCILLATOR, ROOM], ids=["oscillator", "damped"])
def test_halving_the_step_quarters_the_excess(system):
    D = np.array([[1.0, 0.0], [0.3, -1.0]])
    value, error = truth.exact(system, BOX, 2.0, D, 2**14)
    excess, above = [], []
    for steps in (64, 128, 256):
        tube = support_tube(system, BOX, 2.0, D, step=2.0 / steps)
        excess.append((tube.upper[-1] - value).max())
        above.append(tube.intersample.max())
    assert np.all(error < 1e-3 * excess[-1])
    for sizes in (excess, above):
        assert 3.5 < sizes[0] / sizes[1] < 4.6
        assert 3.5 < sizes[1] / sizes[2] < 4.6


def test_bounds_of_an_oscillator_are_tight():
    d = np.array([[1.0, 0.0]])
    exact = max(truth.exact(OSCILLATOR, BOX, t, d)[0][0] for t in np.linspace(0.25, 5, 20))
    for steps, ratio in ((20, 1.03), (100, 1.002), (1000, 1.0001)):
        tube = support_tube(OSCILLATOR, BOX, 5.0, d, step=5.0 / steps)
        assert exact * (2 - ratio) <= tube.most[0] <= ratio * exact
        assert exact * (2 - ratio) <= tube.reached[0] <= tube.most[0]


@given(truth.cases(kinds=("random", "oscillating", "unstable", "triangular")))
@settings(max_examples=25, deadline=None)
def test_every_carrier_gives_the_same_bounds(case):
    system, X, rng = case
    n = system.dim
    D = rows(n, rng)
    dense = support_tube(system, X, 1.0, D, step=1 / 40)
    acting = LinearSystem(sparse.csr_matrix(system.A), system.B, system.U, system.c)
    thin = support_tube(acting, X, 1.0, D, step=1 / 40)
    # Without a centre of the input, which would be one more state that joins the two parts.
    widths = [U.interval_hull().half_widths for U in system.U]
    U = Interval(-widths[0], widths[0]) if widths else None
    pair = LinearSystem(
        sparse.block_diag([system.A] * 2), None if U is None else np.vstack([system.B] * 2), U
    )
    plain = LinearSystem(system.A, None if U is None else system.B, U)
    both = Interval(*(np.tile(end, 2) for end in (X.interval_hull().lo, X.interval_hull().hi)))
    alone = support_tube(plain, X.interval_hull(), 1.0, D, step=1 / 40)
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
    for kept in (
        steps,
        LinearSystem(sparse.csr_matrix(A), steps.B, steps.U or None, steps.c, steps.breaks, True),
    ):
        tube = support_tube(kept, X, 9, D)
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


def test_tighter_tolerances_close_in_on_the_truth():
    gaps = []
    for tolerance in (1e-1, 1e-2, 1e-3, 1e-4):
        tube = support_tube(OSCILLATOR, BOX, 4.0, [[1.0, 0.0]], tolerance=tolerance)
        gaps.append(float(tube.most[0] - tube.reached[0]))
        assert gaps[-1] <= 2 * tolerance
    assert gaps == sorted(gaps, reverse=True)


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


def test_an_input_that_is_held_reaches_less():
    D = np.array([[1.0, 0.0]])
    held = OSCILLATOR.holding_inputs()
    start = np.eye(3)[:, :2] @ BOX.to_zonotope() + np.eye(3)[:, 2:] @ OSCILLATOR.U[0].to_zonotope()
    tube = support_tube(held, start, 3.0, [[1.0, 0.0, 0.0]], step=0.01)
    free = support_tube(OSCILLATOR, BOX, 3.0, D, step=0.01)
    constant = []
    for u in (-1.0, 2.0):
        fixed = LinearSystem(OSCILLATOR.A, c=OSCILLATOR.B[:, 0] * u)
        constant.append(truth.exact(fixed, BOX, 3.0, D)[0][0])
    assert tube.attained[-1, 0] - 1e-9 <= max(constant) <= tube.upper[-1, 0] + 1e-9
    assert tube.most[0] < free.most[0]


def test_a_held_input_of_a_discrete_system_stays():
    steps = LinearSystem([[0.5]], [[1.0]], Interval([0.0], [1.0]), discrete=True)
    tube = support_tube(steps.holding_inputs(), Interval([0.0, 0.0], [0.0, 1.0]), 30, [[1.0, 0.0]])
    assert tube.upper[-1, 0] == pytest.approx(2.0, abs=1e-8)


def test_a_polytope_gives_what_the_same_box_gives():
    faces = HPolytope(np.vstack([np.eye(2), -np.eye(2)]), np.ones(4))
    force = HPolytope([[1.0], [-1.0]], [2.0, 1.0])
    kept = LinearSystem(OSCILLATOR.A, OSCILLATOR.B, force)
    D = [[1.0, 0.5]]
    a, b = support_tube(kept, faces, 1.0, D, step=0.2), support_tube(OSCILLATOR, BOX, 1.0, D, step=0.2)
    assert np.allclose(a.upper, b.upper, rtol=1e-7)
    assert np.allclose(a.interval, b.interval, rtol=1e-7)
    assert np.all(a.upper >= b.upper - 1e-12)
    assert np.all(a.attained <= b.upper)


def test_a_point_without_inputs_is_followed_exactly():
    system = LinearSystem([[0.0, 1.0], [-1.0, 0.0]])
    tube = support_tube(system, Zonotope.point([1.0, 0.0]), 6.0, [[1.0, 0.0], [-1.0, 0.0]], step=0.1)
    assert np.allclose(tube.upper[:, 0], np.cos(tube.times), atol=1e-12)
    assert np.allclose(tube.upper[:, 1], -np.cos(tube.times), atol=1e-12)
    assert np.all(tube.upper - tube.attained < 1e-11)


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
    sets, breaks = (
        [Interval([-1.0], [1.0]), Interval([0.0], [3.0]), Interval([-2.0], [-1.0])],
        [0.1, np.sqrt(0.5)],
    )
    system = LinearSystem([[0.0]], [[1.0]], sets, breaks=breaks)
    tube = support_tube(system, Interval([0.0], [0.0]), 1.0, [[1.0], [-1.0]], step=1 / 64)
    high = 0.1 + 3 * (breaks[1] - 0.1) - (1 - breaks[1])
    assert high <= tube.upper[-1, 0] <= high + 0.15 and tube.attained[-1, 0] <= high
    least = -(0.1 + 2 * (1 - breaks[1]))
    assert -least <= tube.upper[-1, 1] <= -least + 0.15
    path = worst_case(system, Interval([0.0], [0.0]), 1.0, [1.0])
    assert path.states[-1, 0] == pytest.approx(high, abs=1e-12)
    for t, u in zip((path.times[:-1] + path.times[1:]) / 2, path.inputs, strict=True):
        assert u in sets[int(np.searchsorted(breaks, t))]


@pytest.mark.slow
def test_a_hundred_thousand_steps_stay_tight():
    system = LinearSystem([[0.0, 1.0], [-1.0, -0.01]], [[0.0], [1.0]], Interval([-0.01], [0.01]))
    tube = support_tube(system, BOX, 1000.0, [[1.0, 0.0]], step=0.01)
    value, error = truth.exact(system, BOX, 1000.0, np.array([[1.0, 0.0]]), 2**17)
    assert tube.attained[-1, 0] <= value[0] + error[0]
    assert value[0] - error[0] <= tube.upper[-1, 0] <= value[0] * 1.0001


def test_names_of_modules_do_not_hide_functions():
    import reach
    import reach.verification.verify

    assert callable(reach.verify)


BAD = {
    "directions of another length": ({"directions": [[1.0]]}, "directions"),
    "directions with nan": ({"directions": [[np.nan, 0.0]]}, "directions"),
    "no directions": ({"directions": np.zeros((0, 2))}, "directions"),
    "directions that are words": ({"directions": [["a", "b"]]}, "directions"),
    "zero horizon": ({"horizon": 0.0}, "horizon"),
    "negative horizon": ({"horizon": -1.0}, "horizon"),
    "nan horizon": ({"horizon": np.nan}, "horizon"),
    "zero step": ({"step": 0.0}, "step"),
    "negative step": ({"step": -1.0}, "step"),
    "nan step": ({"step": np.nan}, "step"),
    "too many steps": ({"step": 1e-9}, "steps"),
    "step and tolerance": ({"step": 0.1, "tolerance": 0.1}, "not both"),
    "zero tolerance": ({"tolerance": 0.0}, "tolerance"),
    "negative tolerance": ({"tolerance": -1.0}, "tolerance"),
    "nan tolerance": ({"tolerance": np.nan}, "tolerance"),
    "infinite tolerance": ({"tolerance": np.inf}, "tolerance"),
    "tolerances of another length": ({"tolerance": [1.0, 1.0, 1.0]}, "tolerance"),
    "tolerance beyond reach": ({"tolerance": 1e-18}, "tolerance"),
    "limits of another length": ({"tolerance": 1.0, "limit": [1.0, 1.0, 1.0]}, "limit"),
    "nan limit": ({"tolerance": 1.0, "limit": np.nan}, "limit"),
    "initial set of another dimension": ({"initial": Interval([0.0], [1.0])}, "initial set"),
    "initial set is a stack": ({"initial": Interval(np.zeros((3, 2)), np.ones((3, 2)))}, "initial set"),
    "initial set is no set": ({"initial": [0.0, 1.0]}, "initial set"),
    "empty initial set": (
        {"initial": HPolytope([[1.0, 0], [-1, 0], [0, 1], [0, -1]], [-1.0, -1, 1, 1])},
        "empty",
    ),
    "unbounded initial set": ({"initial": HPolytope([[1.0, 0.0]], [1.0])}, "bounded"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_arguments_get_one_clear_error(name):
    changed, message = BAD[name]
    arguments = {"system": OSCILLATOR, "initial": BOX, "horizon": 1.0, "directions": np.eye(2)} | changed
    with pytest.raises(ReachError, match=message):
        support_tube(**arguments)


def test_times_outside_are_refused():
    tube = support_tube(OSCILLATOR, BOX, 1.0, np.eye(2), step=0.1)
    for t in (-0.1, 1.1, np.nan):
        with pytest.raises(ReachError, match="times"):
            tube.at(t)


def test_growth_beyond_numbers_is_said():
    with pytest.raises(ReachError, match="beyond floating point"):
        support_tube(LinearSystem([[700.0]]), Interval([1.0], [1.0]), 2.0, [[1.0]], step=0.01)
    with pytest.raises(ReachError, match="below the rounding"):
        support_tube(LinearSystem([[700.0]]), Interval([1.0], [1.0]), 2.0, [[1.0]], tolerance=1.0)
    with pytest.raises(ReachError, match="too long"):
        support_tube(LinearSystem([[0.0, 1e11], [-1e11, 0.0]]), BOX, 1.0, np.eye(2), step=0.5)


def test_discrete_steps_are_whole():
    system = LinearSystem(np.eye(2) / 2, discrete=True)
    with pytest.raises(ReachError, match="whole number"):
        support_tube(system, BOX, 2.5, np.eye(2))
    with pytest.raises(ReachError, match="whole number"):
        support_tube(system, BOX, 2, np.eye(2), step=0.5)


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
