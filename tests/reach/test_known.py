"""Nominal input signals: tubes around the motion they cause."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from reach import Interval, LinearSystem, ReachError, Signal, Zonotope, support_tube, zonotope_tube
from reach.tubes.trajectory import worst_case
from tests.reach import truth

BOX = Interval([-0.1, -0.1], [0.1, 0.1])
A, B = np.array([[0.0, 1.0], [-4.0, -0.2]]), np.array([[0.0], [1.0]])
RAMPS = Signal([0.0, 0.5, 1.3, 1.3, 2.0], [[0.0], [1.0], [1.5], [-2.0], [0.5]])


def motion(system, signal, t, x0=None):
    """The state at given times, by a solver that is stopped at every knot."""
    x = np.zeros(system.dim) if x0 is None else x0
    borders = np.unique(np.r_[0.0, signal.times[(signal.times > 0) & (signal.times < t[-1])], t[-1]])
    out = np.empty((len(t), system.dim))
    dense = system.A.toarray() if system.sparse else system.A
    for a, b in zip(borders[:-1], borders[1:], strict=True):
        u, slope = signal([(a + b) / 2])[0], signal.slope([(a + b) / 2])[0]
        middle = (a + b) / 2

        def rate(s, y, u=u, slope=slope, middle=middle):
            return dense @ y + system.B @ (u + slope * (s - middle)) + system.c

        run = solve_ivp(rate, (a, b), x, rtol=1e-12, atol=1e-13, dense_output=True, method="DOP853")
        inside = (t >= a) & (t <= b)
        out[inside] = run.sol(t[inside]).T if np.any(inside) else 0.0
        x = run.y[:, -1]
    return out


@st.composite
def signals(draw, m):
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    count = draw(st.integers(1, 6))
    t = np.sort(np.round(rng.uniform(-0.2, 1.2, count), 2))
    if draw(st.booleans()) and count > 2:
        t[1] = t[2]
    return Signal(t, rng.normal(size=(count, m)))


@given(truth.cases(kinds=("random", "oscillating", "triangular", "zero")), st.integers(3, 40), st.data())
@settings(max_examples=40)
def test_a_point_with_a_nominal_input_is_followed_exactly(case, steps, data):
    plain, X, rng = case
    m = max(plain.inputs, 1)
    signal = data.draw(signals(m))
    system = LinearSystem(plain.A, rng.normal(size=(plain.dim, m)), c=plain.c, nominal=signal)
    x0 = rng.normal(size=system.dim)
    D = np.vstack([np.eye(system.dim), -np.eye(system.dim)])
    tube = support_tube(system, Zonotope.point(x0), 1.0, D, step=1 / steps)
    zonotopes = zonotope_tube(system, Zonotope.point(x0), 1.0, step=1 / steps)
    t = np.unique(np.r_[tube.times, np.linspace(0, 1, 301)])
    values = motion(system, signal, t, x0) @ D.T
    slack = 1e-9 * (1 + np.abs(values).max())
    assert np.all(values <= tube.at(t) + slack)
    assert np.all(values <= zonotopes.at(t).support(D) + slack)
    k = np.searchsorted(tube.times, t[:-1], side="right") - 1
    assert np.all(values[:-1] <= tube.interval[k] + slack)
    node = np.isin(t, tube.times)
    assert np.allclose(tube.upper, values[node], atol=slack)
    assert np.all(tube.attained <= values[node] + slack)


@pytest.mark.parametrize("arguments", [{"step": 0.1}, {"step": 0.5}, {"tolerance": 1e-3}, {}])
def test_sampled_trajectories_stay_inside(arguments):
    rng = np.random.default_rng(2)
    system = LinearSystem(A, B, Interval([-0.1], [0.3]), [0.2, 0.0], nominal=RAMPS)
    unknown = LinearSystem(A, B, Interval([-0.1], [0.3]), [0.2, 0.0])
    D = np.vstack([np.eye(2), -np.eye(2), [[1.0, 2.0]]])
    tube = support_tube(system, BOX, 3.0, D, **arguments)
    t = np.unique(np.r_[tube.times, np.linspace(0, 3, 241)])
    center = motion(LinearSystem(A, B, nominal=RAMPS), RAMPS, t)
    x = center[:, None] + truth.trajectories(unknown, BOX, t, rng, 30)
    values = (x @ D.T).max(axis=1)
    assert np.all(values <= tube.at(t) + 1e-9)
    zonotopes = zonotope_tube(system, BOX, 3.0, **{k: v for k, v in arguments.items() if k == "step"})
    assert np.all(values <= zonotopes.at(t).support(D) + 1e-9)
    reached = [truth.worst(unknown, BOX, np.linspace(0, 3, 400), d) for d in D]
    assert np.all(center[-1] @ D.T + reached <= tube.upper[-1] + 1e-9)
    loose = {"step": 0.3}.get(next(iter(arguments), ""), 0.02)
    assert np.all(center[-1] @ D.T + reached >= tube.upper[-1] - loose)
    if "tolerance" in arguments:
        assert np.all(tube.intersample <= 0.5e-3 * 1.05)


def test_a_known_motion_that_is_back_at_the_nodes_is_bounded_between_them():
    """One step over a whole turn: at both ends the state is as good as at rest."""
    turning = LinearSystem([[0.0, 1.0], [-1.0, 0.0]], [[0.0], [1.0]], nominal=Signal([0.0], [[1.0]]))
    tube = support_tube(turning, Zonotope.point([0.0, 0.0]), 2 * np.pi, [[1.0, 0.0]], step=2 * np.pi)
    assert tube.interval[0, 0] >= 2.0 and abs(tube.upper[-1, 0]) < 1e-6


def test_a_discrete_system_takes_the_signal_at_its_steps():
    system = LinearSystem(
        [[0.5]], [[1.0]], Interval([0.0], [0.1]), discrete=True, nominal=Signal([0, 4], [[0], [4]])
    )
    tube = support_tube(system, Interval([1.0], [1.0]), 6, [[1.0], [-1.0]])
    low = high = 1.0
    for k in range(6):
        low, high = 0.5 * low + min(k, 4), 0.5 * high + min(k, 4) + 0.1
    assert tube.upper[-1] == pytest.approx([high, -low], rel=1e-12)
    hull = zonotope_tube(system, Interval([1.0], [1.0]), 6).nodes[-1].interval_hull()
    assert (hull.lo[0], hull.hi[0]) == pytest.approx((low, high), rel=1e-12)


def test_a_worst_case_adds_the_nominal_input():
    system = LinearSystem(A, B, Interval([-0.1], [0.3]), [0.2, 0.0], nominal=RAMPS)
    for d in ([1.0, 0.0], [-1.0, 0.3]):
        tube = support_tube(system, BOX, 3.0, d, step=0.01)
        path = worst_case(system, BOX, 3.0, d, tolerance=1e-4)
        assert tube.attained[-1, 0] - 2e-4 <= path.states[-1] @ d <= tube.upper[-1, 0]
    free = LinearSystem(A, B, nominal=RAMPS)
    path = worst_case(free, Zonotope.point([0.0, 0.0]), 3.0, [1.0, 0.0])
    assert np.allclose(path.states[-1], motion(free, RAMPS, np.array([0.0, 3.0]))[-1], atol=1e-10)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Signal([0.0, 1.0], [[1.0]]), "times"),
        (lambda: Signal([], np.zeros((0, 1))), "times"),
        (lambda: Signal([1.0, 0.0], [[1.0], [2.0]]), "must not decrease, got 1 before 0"),
        (lambda: Signal([0.0, np.nan], [[1.0], [2.0]]), "finite"),
        (lambda: Signal([0.0], [["a"]]), "numbers"),
        (lambda: LinearSystem(A, B, nominal=Signal([0.0], [[1.0, 2.0]])), "nominal must have dimension 1"),
    ],
)
def test_bad_signals_get_one_clear_error(make, message):
    with pytest.raises(ReachError, match=message):
        make()
