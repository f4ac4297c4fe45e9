"""Tubes of systems that vary in time: sampled truth, and relative motion on an eccentric orbit."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

import reach
from reach import Interval, LinearSystem, LTVSystem, ReachError, Varying, support_tube, zonotope_tube
from tests.reach import truth

BOX = Interval([-1.0, -1.0], [1.0, 1.0])


def relative_motion(e):
    """Tschauner-Hempel equations of the scaled relative position, in true anomaly f; k = 1 + e cos f."""
    # |(1/k)'| <= e / (1-e)^2 and (1/k)'' = (2 k'^2 - k k'') / k^3 <= (2 e^2 + e (1+e)) / (1-e)^3.
    A = np.zeros((6, 6))
    A[:3, 3:] = np.eye(3)
    A[3, 5], A[4, 1], A[5, 3] = 2.0, -1.0, -2.0
    moves = np.zeros((6, 6))
    moves[5, 2] = 1.0
    slope, bend = 3 * e / (1 - e) ** 2, 3 * (2 * e**2 + e * (1 + e)) / (1 - e) ** 3
    matrix = Varying(lambda f: A + moves * 3 / (1 + e * np.cos(f)), slope * moves, bend * moves)
    # Thrust in the scaled coordinates: acceleration over k^3 up to a constant.
    shape = np.vstack([np.zeros((3, 3)), np.eye(3)])
    slope, bend = 3 * e / (1 - e) ** 4, (12 * e**2 + 3 * e * (1 + e)) / (1 - e) ** 5
    force = Varying(lambda f: shape / (1 + e * np.cos(f)) ** 3, slope * shape, bend * shape)
    return LTVSystem(matrix, force, Interval([-1e-3] * 3, [1e-3] * 3))


def value_at(M, t):
    return np.asarray(M.value(t) if isinstance(M, Varying) else M)


def trajectories(system, X, times, rng, count, worst=None):
    """Trajectories by a solver under inputs that are constant over pieces, (m+1, count, n)."""
    out = np.empty((len(times), count, system.dim))
    for i in range(count):
        x = X.support_vector(rng.normal(size=system.dim))
        pieces = np.linspace(times[0], times[-1], int(rng.integers(2, 12)))
        for a, b in zip(pieces[:-1], pieces[1:], strict=True):
            u = system.U.support_vector(rng.normal(size=system.inputs)) if system.inputs else np.zeros(0)

            def rate(t, y, u=u):
                return value_at(system.A, t) @ y + value_at(system.B, t) @ u + value_at(system.c, t)

            run = solve_ivp(rate, (a, b), x, rtol=1e-12, atol=1e-14, method="DOP853", dense_output=True)
            inside = (times >= a) & (times <= b)
            out[inside, i] = run.sol(times[inside]).T if np.any(inside) else 0.0
            x = run.y[:, -1]
    return out


def holds(system, X, horizon, step, begin, rng, count=6):
    n, system = system.dim, replace(system, begin=begin)
    D = np.vstack([np.eye(n), -np.eye(n), rng.normal(size=(3, n))])
    support = support_tube(system, X, horizon, D, step=step)
    zonotopes = zonotope_tube(system, X, horizon, step=step)
    t = np.unique(np.r_[support.times, np.linspace(begin, begin + horizon, 4 * len(support.times))])
    values = (trajectories(system, X, t, rng, count) @ D.T).max(axis=1)
    slack = 1e-9 * (1 + np.abs(values).max())
    assert np.all(values <= support.at(t) + slack)
    assert np.all(values <= zonotopes.at(t).support(D) + slack)
    k = np.clip(np.searchsorted(support.times, t, side="right") - 1, 0, len(support.times) - 2)
    assert np.all(values <= support.interval[k] + slack)
    assert np.all(values <= zonotopes.support(D)[k] + slack)
    assert np.all(support.attained <= support.upper)
    return support


@st.composite
def systems(draw):
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n, m, order = draw(st.integers(1, 3)), draw(st.integers(0, 2)), draw(st.sampled_from([1, 2]))
    w = draw(st.floats(0.1, 6))

    def swinging(shape):
        constant, swing, phase = rng.normal(size=shape), rng.normal(size=shape), rng.uniform(0, 6, shape)
        bounds = {"slope": w * np.abs(swing)} if order == 1 else {"bend": w**2 * np.abs(swing)}
        return Varying(lambda t: constant + swing * np.sin(w * t + phase), **bounds)

    U = truth.body(draw(st.sampled_from(truth.BODIES)), m, rng) if m else None
    system = LTVSystem(swinging((n, n)), swinging((n, m)) if m else None, U, swinging((n,)))
    return system, truth.body(draw(st.sampled_from(truth.BODIES)), n, rng), rng


@given(systems(), st.integers(1, 30), st.floats(-3, 3))
@settings(max_examples=25)
def test_sampled_trajectories_stay_inside(case, steps, begin):
    system, X, rng = case
    holds(system, X, 1.0, 1 / steps, begin, rng)


@pytest.mark.parametrize("e", [0.0, 0.1, 0.4])
def test_relative_motion_on_an_eccentric_orbit(e):
    start = Interval([-1.0] * 3 + [-0.1] * 3, [1.0] * 3 + [0.1] * 3)
    holds(relative_motion(e), start, 2 * np.pi, np.pi / 80, 0.3, np.random.default_rng(1), 4)


def exact_support(system, X, horizon, d, count=4000):
    """Support at the end by the closed form, the adjoint equation solved to 1e-12."""

    def rate(s, r):
        return value_at(system.A, horizon - s).T @ r

    run = solve_ivp(rate, (0, horizon), d, rtol=1e-12, atol=1e-14, method="DOP853", dense_output=True)
    s = (np.arange(count) + 0.5) * horizon / count
    rows = run.sol(s).T
    along = np.array([r @ value_at(system.B, horizon - a) for r, a in zip(rows, s, strict=True)])
    return X.support(run.y[:, -1]) + system.U.support(along).sum() * horizon / count


@pytest.mark.parametrize(("steps", "ratio"), [(40, 1.003), (160, 1.0002)])
def test_relative_motion_is_tight(steps, ratio):
    system, horizon = relative_motion(0.2), np.pi
    start = Interval([-1.0] * 3 + [-0.1] * 3, [1.0] * 3 + [0.1] * 3)
    tube = support_tube(system, start, horizon, np.eye(6)[:3], step=horizon / steps)
    for d, upper, attained in zip(np.eye(6)[:3], tube.upper[-1], tube.attained[-1], strict=True):
        exact = exact_support(system, start, horizon, d)
        assert attained <= exact * (1 + 1e-6) and exact * (1 - 1e-6) <= upper <= ratio * exact
        assert attained >= exact * (2 - ratio)
    assert np.all(tube.interval.max(axis=0) <= ratio * np.maximum(tube.upper.max(axis=0), 0) * 1.01)


def test_constant_matrices_give_the_tube_of_a_constant_system():
    A, B, c = np.array([[0.0, 1.0], [-4.0, -0.2]]), np.array([[0.0], [1.0]]), np.array([0.3, 0.0])
    U, D = Interval([-1.0], [2.0]), np.array([[1.0, 0.0], [0.3, -1.0]])
    for more, share in (((), 1e-10), ((None, None, c), 1e-4), ((B, U, c), 1e-3)):
        plain, same = (
            support_tube(kind(A, *more), BOX, 3.0, D, step=0.01) for kind in (LinearSystem, LTVSystem)
        )
        assert np.allclose(same.upper, plain.upper, rtol=share)
    assert np.allclose(same.interval, plain.interval, rtol=2e-3)
    plain, same = (zonotope_tube(kind(A, B, U, c), BOX, 3.0, step=0.01) for kind in (LinearSystem, LTVSystem))
    assert np.allclose(same.nodes.half_widths, plain.nodes.half_widths, rtol=2e-3)


SINE = Varying(lambda t: np.sin(t) * np.eye(2), bend=np.eye(2))
GOOD = {"system": LTVSystem(SINE), "initial": BOX, "horizon": 1.0, "directions": np.eye(2), "step": 0.1}


def varying(value, **bounds):
    return {"system": LTVSystem(Varying(value, **bounds))}


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"step": np.nan}, "step must be"),
        ({"step": 1e-9}, "at most"),
        ({"horizon": -1.0}, "horizon must be"),
        ({"step": None, "tolerance": 0.1}, "needs a step"),
        ({"directions": [[1.0]]}, "directions"),
        ({"initial": Interval([0.0], [1.0])}, "initial set"),
        ({"initial": reach.HPolytope([[1.0, 0.0]], [1.0])}, "initial set must be bounded"),
        (varying(lambda t: t * np.eye(2), slope=np.eye(2) / 2), "slope of A is too small"),
        (varying(lambda t: t**2 * np.eye(2), bend=np.eye(2)), "bend of A is too small"),
        (varying(lambda t: np.eye(2 + (t > 0.5)), bend=np.eye(2)), r"A\(0\.6\) must be"),
        (varying(lambda t: np.eye(2) / (t < 0.5), bend=np.eye(2)), "2 x 2 finite"),
        ({"system": LTVSystem(SINE, c=[1.0])}, "c must be"),
        ({"system": LTVSystem(SINE, np.eye(3), BOX)}, "B must be"),
        (varying(lambda t: np.eye(2), bend=-np.eye(2)), "bend of A must be >= 0"),
    ],
)
@pytest.mark.filterwarnings("ignore:divide by zero", "ignore:invalid value")
def test_bad_arguments_get_one_clear_error(changed, message):
    with pytest.raises(ReachError, match=message):
        support_tube(**(GOOD | changed))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Varying(lambda t: np.eye(2)), "needs a bound"),
        (lambda: LTVSystem(np.ones((2, 3))), "A must be square"),
        (lambda: LTVSystem(SINE, begin=np.inf), "begin must be one finite number"),
        (lambda: LTVSystem(np.eye(2), np.eye(2)), "without U"),
        (lambda: LTVSystem(np.eye(2), np.eye(2), 3.0), "convex set"),
        (lambda: zonotope_tube(LTVSystem(SINE), BOX, 1.0, step=0.1, frame=np.ones((2, 2))), "frame"),
    ],
)
def test_bad_descriptions_get_one_clear_error(make, message):
    with pytest.raises(ReachError, match=message):
        make()
