"""Errors of the paper about tracking (Lemma 1) and recoverable sets (Lemma 2): the printed forms fail."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.linalg import expm

from polaris.model.hill import clohessy_wiltshire
from polaris.model.scene.obstacles import BoxObstacle
from polaris.model.system import LinearSystem
from polaris.planning.reference import Reference
from polaris.synthesis.safety.carried_rows import error_tube
from polaris.synthesis.safety.get_safety import get_recover, get_safety
from polaris.synthesis.tracker.error_bounds import get_err_bounds
from polaris.synthesis.tracker.feedback import Feedback, choose_feedback
from polaris.synthesis.tracker.lqr import lqr_gain
from polaris.synthesis.tracker.tracking import Tracking
from reach.numerics.linear import discretize, powers
from reach.sets.zonotope import Zonotope
from tests.paper.printed_ball import PrintedBall
from tests.polaris.conftest import small_safety

SYSTEM = clohessy_wiltshire(0.0012, 10.0, 1.0, 1e-5)
GAIN = lqr_gain(SYSTEM, [1, 1, 1, 1e3, 1e3, 1e3], [1e4] * 3)
A_C = SYSTEM.A - SYSTEM.B @ GAIN


@cache
def tracking():
    return Tracking(SYSTEM, GAIN, choose_feedback(SYSTEM, [GAIN], 50.0, None), 50.0)


def moved(track, t):
    """Return the map of an error over t [s] under S, its input held from node to node."""
    lag, rest = divmod(t, track.flow.h)
    Ad, Bd = discretize(track.system.A, track.system.B, rest)
    return (Ad - Bd @ track.gain) @ np.linalg.matrix_power(track.flow.phi, int(lag))


def test_item_1_decay_rate_needs_the_absolute_value():
    slowest = np.linalg.eigvals(A_C).real.max()
    assert slowest < 0, "as printed, 0 < beta < lambda_max has no solution for a stable loop"
    bounds = get_err_bounds(tracking())
    assert 0 < bounds.beta < abs(slowest)
    for t in np.linspace(0, 400, 81):
        reached = np.linalg.norm(bounds.W @ moved(tracking(), t) @ np.linalg.inv(bounds.W), 2)
        assert reached <= bounds.gamma * np.exp(-bounds.beta * t) * (1 + 1e-9)


def test_item_2_gamma_in_raw_units_is_many_times_the_weighted_one():
    raw, weighted = get_err_bounds(tracking(), weight="identity"), get_err_bounds(tracking())
    assert raw.gamma > 15 and weighted.gamma < 1.5
    # Position is bounded on its own: from 1 cm/s of initial error, in metres.
    e0 = np.array([0, 0, 0, 0.01, 0, 0])
    reached = max(np.linalg.norm((moved(tracking(), t) @ e0)[:3]) for t in np.linspace(0, 400, 401))
    assert reached <= weighted.gamma_position * np.linalg.norm(weighted.W @ e0)


def test_item_3_printed_disturbance_gain_is_valid_but_loose():
    bounds = get_err_bounds(tracking(), weight="identity")
    printed = bounds.gamma / bounds.beta * np.linalg.norm(SYSTEM.D, 2) * SYSTEM.w_max
    tight = tracking().disturbance(SYSTEM.position)[-1].max()
    flow, parts = tracking().flow, 4
    effects = [expm(SYSTEM.A * (j + 0.5) * flow.h / parts) @ SYSTEM.D for j in range(parts)]
    rows = SYSTEM.position[0] @ powers(flow.phi, int(1500 / flow.h))
    exact = sum(np.linalg.norm(rows @ each, axis=1).sum() for each in effects) * flow.h / parts * SYSTEM.w_max
    assert exact <= tight * 1.001 <= printed and printed > 1.3 * tight and tight < 1.25 * exact


def spinning():
    """A loop whose transient peaks between the samples of half its rotation."""
    A = np.array([[-0.02, 1.0], [-0.01, -0.02]])  # rotates at 0.1 rad/s, axes 10 to 1
    system = LinearSystem(A, np.eye(2), np.eye(2), [1.0, 1.0], 0.0, C=[[1.0, 0.0]])
    h = np.pi / 0.1
    return A, h, Tracking(system, np.zeros((2, 2)), Feedback(1), h)


def test_item_4_gamma_from_samples_misses_what_happens_between_them():
    A, h, track = spinning()
    beta = 0.005
    naive = max(np.exp(beta * i * h) * np.linalg.norm(expm(A * i * h), 2) for i in range(30))
    peak = max(np.exp(beta * t) * np.linalg.norm(expm(A * t), 2) for t in np.linspace(0, h, 400))
    assert naive < 0.3 * peak, "the printed recipe on this grid is no bound"
    for method in ("envelope", "lyapunov"):
        bounds = get_err_bounds(track, method, "identity")
        for t in np.linspace(0, 30 * h, 2000):
            reached = np.linalg.norm(expm(A * t), 2)
            assert reached <= bounds.gamma * np.exp(-bounds.beta * t) * (1 + 1e-9)


@pytest.mark.parametrize("method", ["envelope", "lyapunov"])
def test_item_4_bounds_hold_beyond_the_last_sample(method):
    bounds = get_err_bounds(tracking(), method, "identity")
    for t in np.linspace(500, 5000, 200):
        assert np.linalg.norm(moved(tracking(), t), 2) <= bounds.gamma * np.exp(-bounds.beta * t) * (1 + 1e-9)


def test_item_5_printed_ball_is_constant_and_ours_is_no_smaller():
    beta, t = 0.02, 100.0
    tau = np.linspace(t, 1000, 50)
    assert np.max(np.exp(-beta * (tau - t))) == 1.0, "the maximum in eq. 12 is always 1"
    safety = small_safety()
    sets = get_recover("ball", safety.clearance, safety.bounds)
    constant = sets.allowed.min()  # what eq. 12 makes of the same rooms
    varying = np.array([sets.radius(node) for node in range(len(sets.allowed))])
    assert varying.min() == pytest.approx(constant, rel=1e-12), "its least value is the constant radius"
    assert np.all(varying >= constant * (1 - 1e-12)) and varying.max() > 1.05 * constant


def test_item_5_polytopes_are_no_smaller_than_the_balls_anywhere():
    safety = small_safety()
    polytopes, balls = (get_recover(kind, safety.clearance, safety.bounds) for kind in ("polytope", "ball"))
    for node in range(0, safety.problem.K * safety.clearance.q, 5):
        assert polytopes.radius(node) >= balls.radius(node) * (1 - 1e-9)


def test_item_6_a_distance_in_the_state_norm_depends_on_the_units():
    """The printed r_min mixes m and m/s; what ours needs along a facet does not care about units."""
    in_mm_per_s = np.diag([1, 1, 1, 1e3, 1e3, 1e3])  # velocities in mm/s
    e = np.array([3.0, 0, 0, 0.05, 0, 0])
    assert np.linalg.norm(in_mm_per_s @ e) > 10 * np.linalg.norm(e), "the printed norm changes with the unit"
    inverse = np.linalg.inv(in_mm_per_s)
    T = in_mm_per_s
    matrices = T @ SYSTEM.A @ inverse, T @ SYSTEM.B, T @ SYSTEM.D
    limits = SYSTEM.u_max, SYSTEM.w_max
    scaled = LinearSystem(*matrices, *limits, C=SYSTEM.position @ inverse, mass=10.0)
    plain, other = tracking(), Tracking(scaled, GAIN @ inverse, tracking().feedback, 50.0)
    theta = Zonotope.box(np.zeros(6), [3, 3, 3, 0.01, 0.01, 0.01])
    tightening = error_tube(plain, theta, SYSTEM.position).tightening
    same = error_tube(other, in_mm_per_s @ theta, scaled.position).tightening
    count = min(len(tightening), len(same)) - 1
    assert np.allclose(tightening[:count], same[:count], rtol=1e-3)


def test_item_7_the_printed_ball_admits_states_from_which_the_thrusters_saturate():
    safety = small_safety()
    printed = PrintedBall(safety.clearance, safety.bounds)
    sound = get_recover("ball", safety.clearance, safety.bounds)
    system, gain = safety.problem.system, safety.tracking.gain
    # along the direction of the gain, out to the edge of the printed ball
    direction = gain[0] / np.linalg.norm(printed.bounds.W @ gain[0])
    edge = direction * printed.radius(0) * 0.999
    assert printed.contains(0, edge[None])[0]
    assert abs(gain[0] @ edge) > system.u_max[0], "S would have to exceed the thrust limit"
    assert not sound.contains(0, edge[None])[0]


def test_item_7_reference_inputs_leave_room_for_the_tracker():
    safety = small_safety()
    system, q, corners, worst = safety.problem.system, safety.clearance.q, safety.start.corners(), 0.0
    for lag in range(q * 4):
        carried = corners @ (safety.tracking.gain @ np.linalg.matrix_power(safety.tracking.flow.phi, lag)).T
        used = np.abs(safety.plan.nu[lag // q]) + np.abs(carried).max(axis=0)
        worst = max(worst, float(used.max()))
    assert worst <= system.u_max.max() and np.all(np.abs(safety.plan.nu) < system.u_max)


def test_item_12_a_reference_safe_until_T_may_be_unsafe_right_after_it():
    """As printed the plan ends at T, and nothing keeps clear later; ours says so (Proposition 12)."""
    base = small_safety()
    after = base.reference.chi[base.problem.K + 20, :3]  # where the first plan coasts 600 s after T
    block = BoxObstacle("block", after, [8.0, 8.0, 8.0])
    problem = replace(base.problem, unsafe=(*base.problem.unsafe, block))
    printed = Reference.propagate(problem.system, problem.delta, base.reference.chi[0], base.plan.nu)
    during = block.signed_distance(0.0, printed.chi[:, :3]).min()
    later = block.signed_distance(0.0, printed.extend(40).chi[:, :3]).min()
    assert during > 0 > later, "the printed plan is safe until T and collides after it"
    ours = get_safety(problem)
    if ours.end.proven:
        assert block.signed_distance(0.0, ours.reference.chi[:, :3]).min() > 0
    else:
        assert "not proven" in ours.end.reason
