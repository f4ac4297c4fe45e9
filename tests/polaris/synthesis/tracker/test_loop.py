"""Theorem 3 against flight software coded by itself: exact at nodes, never below a flight."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.linalg import expm, solve_continuous_are, solve_discrete_are

from polaris import ScenarioError
from polaris.model.thrusters import Thrusters
from polaris.model.timing import Observer
from polaris.synthesis.sources.delay import Delay
from polaris.synthesis.sources.disturbance import Disturbance
from polaris.synthesis.sources.estimate import Estimate
from polaris.synthesis.sources.impulse_bit import CarriedImpulse
from polaris.synthesis.sources.observer import Filter
from polaris.synthesis.sources.thrusters import ThrusterErrors
from polaris.synthesis.tracker.loop import Loop
from polaris.synthesis.tracker.tightening import Tightening
from reach import powers
from tests.polaris.flight_software import CELLS, Software


def hill():
    n, A = 0.005, np.zeros((6, 6))
    A[:3, 3:] = np.eye(3)
    A[3, 0], A[3, 4], A[4, 3], A[5, 2] = 3 * n**2, 2 * n, -2 * n, -(n**2)
    push = np.vstack([np.zeros((3, 3)), np.eye(3)])
    return A, push / 10, push, 2.0, [1.0] * 3 + [50.0] * 3, 4e3


def chain():
    return np.eye(2, k=1), np.array([[0], [0.5]]), np.array([[0], [1.0]]), 1.0, [0.002, 0.06], 10.0


def lagging():
    """Actuator that follows its command within 1.5 s."""
    A = np.eye(3, k=1)
    A[2, 2] = -1 / 1.5
    return A, np.array([[0], [0], [1 / 1.5]]), np.array([[0], [1.0], [0]]), 1.0, [2e-4, 0.01, 0.0], 5.0


PLANTS = {"hill": hill, "chain": chain, "lagging": lagging}
W, BIT = 1e-3, 5e-3  # disturbance, impulse bit
SOURCES = [  # navigation, delay in periods, impulses carried
    ("", 0, False),
    ("estimate", 0, False),
    *(("estimate", d, False) for d in (1, 3, 0.5, 1.4)),
    *(("observer", d, False) for d in (0, 1, 0.5, 1.4)),
    ("", 0, True),
    ("estimate", 1.4, True),
    ("observer", 1.4, True),
]


def sizes(nav, n):
    """Bounds on the errors of estimates, or of measured positions."""
    count = {"": 0, "estimate": n, "observer": max(n // 2, 1)}[nav]
    return np.where(np.arange(n) < (n + 1) // 2, 0.05, 0.004)[:count]


@cache
def software(plant, nav="", delay=0, carried=False):
    A, B, D, h, Q, r = PLANTS[plant]()
    n, gain = len(A), B.T @ solve_continuous_are(A, B, np.diag(Q), r * np.eye(B.shape[1])) / r
    soft = Software(A, B, D, h, gain, delay * h, bit=BIT if carried else 0.0)
    if nav != "observer":
        return soft
    M, R = np.eye(n)[: max(n // 2, 1)], np.diag(sizes(nav, n) ** 2)
    S = solve_discrete_are(expm(A * h).T, M.T, D @ D.T * 1e-4 + 1e-8 * np.eye(n), R)
    return replace(soft, measures=M, correction=S @ M.T @ np.linalg.inv(M @ S @ M.T + R))


def bounds(soft, nav, w=W, errors=None):
    """Tightening of the loop of a flight software."""
    n, m = soft.B.shape
    noise = sizes(nav, n)
    loop = Loop.from_plant(soft.A, soft.B, soft.h)
    if soft.delay:
        loop = Delay(soft.delay).extend(loop)
    if soft.bit:
        loop = CarriedImpulse(soft.bit, 0.0).extend(loop)
    if nav == "estimate":
        loop = Estimate(noise).extend(loop)
    if nav == "observer":
        loop = Filter(Observer(soft.measures, noise, soft.correction), np.zeros(n)).extend(loop)
    loop = Disturbance(soft.D, w).extend(loop)
    if errors is not None:
        loop = ThrusterErrors(errors).extend(loop)
    return Tightening(loop.close(soft.gain), np.full(m, soft.u_max), np.ones(loop.N))


def rows_of(limits):
    """Rows of all states of the plant, and of the commands."""
    n, N = limits.closed.loop.n, limits.closed.loop.N
    return np.vstack([np.eye(n, N), limits.closed.K])


def unit_flights(soft, nav, periods):
    """Fly a unit of every input of period 0; states and commands at nodes, (periods + 1, inputs, rows)."""
    (n, m), k = soft.B.shape, soft.D.shape[1]
    q = len(sizes(nav, n))
    inputs, first = CELLS * k + q + (m if soft.bit else 0), int(nav == "observer")
    kicks, noise, rest = np.zeros((CELLS, inputs, n)), np.zeros((inputs, q)), np.zeros((inputs, m))
    for j in range(CELLS):
        kicks[j, j * k : (j + 1) * k] = soft.D.T
    noise[CELLS * k : CELLS * k + q] = np.eye(q)
    rest[CELLS * k + q :] = np.eye(m) if soft.bit else 0
    nodes, feedback = soft.fly(periods + 1, inputs, kicks, noise, rest, first)
    return np.concatenate([nodes[:-1], feedback], axis=2), CELLS * k, q


@pytest.mark.parametrize("plant", ["hill", "chain", "lagging"])
@pytest.mark.parametrize(("nav", "delay", "carried"), SOURCES)
def test_bounds_from_rest_are_the_sum_of_absolute_responses(plant, nav, delay, carried):
    soft = software(plant, nav, delay, carried)
    lags, (n, m) = [1, 2, 10, 100], soft.B.shape
    responses, pushes, q = unit_flights(soft, nav, 100)
    vectors = responses[1:, :pushes].reshape(100, CELLS, -1, n + m)
    forced = W * soft.h / CELLS * np.linalg.norm(vectors, axis=2).sum(axis=1)
    other = np.abs(responses[1:, pushes:])
    sampled = np.tensordot(other[:, :q], sizes(nav, n), (1, 0)) if q else 0.0
    sampled = sampled + BIT * other[:, q:].sum(axis=1)
    limits, undisturbed = bounds(soft, nav), bounds(soft, nav, w=0.0)
    answer, calm = limits.from_rest(rows_of(limits)), undisturbed.from_rest(rows_of(undisturbed))
    for L in lags:
        np.testing.assert_allclose(calm[L], np.broadcast_to(sampled, (100, n + m))[:L].sum(axis=0), rtol=1e-8)
        exact = (forced + sampled)[:L].sum(axis=0)
        assert np.all(answer[L] >= exact * (1 - 1e-6))
        assert np.all(answer[L] <= exact * 1.004), (answer[L] / exact).max()


def test_intersample_bounds_count_the_rate_at_a_node_and_what_pushes_within_the_period():
    """Both terms of Proposition 9 (d), of a plant whose pushes fade within a period."""
    A, B, D = np.array([[-1, 0.3], [0, -0.5]]), np.array([[0.0], [1]]), np.array([[1.0, 0.2], [0, 0.5]])
    loop = Disturbance(D, W).extend(Loop.from_plant(A, B, 0.4))
    limits = Tightening(loop.close(np.array([[0.1, 0.2]])), np.ones(1), np.ones(2))
    push_rate, rows = W * np.linalg.norm(D, axis=1), np.eye(2)
    rate = limits.from_rest(limits.closed.rates).max(axis=0)
    curvature = 0.4**2 / 8 * np.abs(A)
    assert np.all(limits.between(rows)[0] >= curvature @ (rate + push_rate))
    box = replace(loop.channels[0], ball=False, size=np.full(2, W))
    boxed = replace(limits, closed=replace(loop, channels=(box,)).close(limits.closed.gain))
    assert np.all(boxed.response(box, rows, rows).between @ box.size >= boxed.between(rows)[0] * (1 - 1e-3))
    assert np.all(boxed.between(rows)[0] >= limits.between(rows)[0])


def test_an_offset_of_the_state_counts_as_an_error_of_what_is_measured():
    """A remainder and its errors displace the state by up to alpha |B| I (Lemma 6 (c))."""
    A, B, *_ = hill()
    M = np.array([[1.0, 0, 0, -2, 0, 0], [0, 1, 0, 0, 0, 1]])
    loop = CarriedImpulse(BIT, 0.5).extend(Loop.from_plant(A, B, 2.0))
    offset = 0.5 * BIT * np.abs(B).sum(axis=1)
    source = Estimate(sizes("estimate", 6)).extend(loop).channels[-1]
    np.testing.assert_allclose(source.size, sizes("estimate", 6) + offset)
    source = Observer(M, np.array([0.05, 0.04]), 0.1 * M.T)
    measured = Filter(source, np.zeros(6)).extend(loop).channels[-1]
    np.testing.assert_allclose(measured.size, np.array([0.05, 0.04]) + np.abs(M) @ offset)


def test_the_remainder_bounds_every_state_that_is_left_at_any_later_node():
    """A row may be near zero at the horizon and larger again later, where what hardly damps turns."""
    A, B = np.array([[0, 1], [-1, -0.02]]), np.array([[0.0], [1]])
    limits = Tightening(
        Loop.from_plant(A, B, 0.5).close(np.array([[0, 0.02]])), np.ones(1), np.array([1.0, 0.02])
    )
    rows, N = np.array([[1.0, 0], [0, 1], [1, 1], [1, -1]]), limits.horizon
    responses = np.abs(rows @ powers(limits.closed.F, 3 * N)[N:]) @ limits.v
    bound = limits.remainder(rows)
    assert np.all(responses.max(axis=0) <= bound) and np.all(bound <= 40 * responses.max(axis=0))


def test_a_loop_that_hardly_settles_is_bounded_for_ever_or_refused():
    def settling(rate):
        loop = Disturbance(np.ones((1, 1)), W).extend(Loop.from_plant(np.zeros((1, 1)), np.ones((1, 1)), 1.0))
        return Tightening(loop.close(np.array([[rate]])), np.ones(1), np.ones(1)).from_rest(np.eye(1))[-1]

    assert W / 2e-3 <= settling(2e-3) <= W / 2e-3 * 1.01
    for rate, words in ((2e-4, "let errors decay within"), (-2e-3, "give a stable loop$")):
        with pytest.raises(ScenarioError, match=rf"^feedback.period_s: got 1.0; must {words}"):
            settling(rate)


def test_errors_that_feed_on_themselves_leave_no_thrust():
    soft = replace(software("chain"), u_max=0.02)
    assert bounds(soft, "", errors=Thrusters(0.2)).settled_bound() < soft.u_max
    assert bounds(soft, "", errors=Thrusters(5.0)).settled_bound() > soft.u_max


def test_sources_are_refused_in_an_order_that_would_lose_errors():
    soft = software("chain")
    loop = Estimate(np.zeros(2)).extend(Loop.from_plant(soft.A, soft.B, 1.0))
    with pytest.raises(ValueError, match="before navigation"):
        Delay(1.0).extend(loop)
    with pytest.raises(ValueError, match="after the sources"):
        CarriedImpulse(BIT, 0.1).extend(loop).close(soft.gain)
