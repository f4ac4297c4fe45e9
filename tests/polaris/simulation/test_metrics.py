"""Metrics against hand-computed values and brute force; the defects of RTAEval must not occur."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from polaris.model.errors import ScenarioError
from polaris.model.hill import clohessy_wiltshire, free_flight
from polaris.model.scene.distances import (
    UNKNOWN,
    closest,
    count_switches,
    mode_shares,
    ray_ttc,
    signed_distances,
)
from polaris.model.scene.free_drift import drift_ttc
from polaris.model.scene.keep_in import KeepInCone, KeepInPolytope
from polaris.model.scene.obstacles import BallObstacle, BoxObstacle, PolytopeObstacle
from polaris.model.scene.satellite import SatelliteObstacle
from polaris.model.system import LinearSystem
from polaris.simulation.simulate import simulate
from tests.polaris.tiny import synthesised

ETA = 0.0012
CW = clohessy_wiltshire(ETA, 10.0, 0.1)
PLANE = LinearSystem(
    np.kron([[0, 1], [0, 0]], np.eye(2)),
    np.kron([[0], [1]], np.eye(2)),
    np.kron([[0], [1]], np.eye(2)),
    [1, 1],
)
BALL, BOX = BallObstacle("ball", [0, 0], 1.0), BoxObstacle("box", [10, 0], [1, 2])


def test_distances_and_the_closest_approach_of_every_run():
    t = np.array([0.0, 1, 2])
    p = np.array([[[3, 0], [5, 0], [8, 0]], [[0, 3], [0, 0.5], [0, 9]]], dtype=float)
    distances = signed_distances([BALL, BOX], t, p)
    np.testing.assert_allclose(distances[0], [[2, 4, 7], [2, -0.5, 8]])
    np.testing.assert_allclose(distances[1], [[6, 4, 1], [np.hypot(9, 1), 9, np.hypot(9, 7)]])
    best = closest(distances, t)
    np.testing.assert_allclose(best.distance, [1, -0.5])
    np.testing.assert_allclose(best.time, [2, 1])
    np.testing.assert_array_equal(best.obstacle, [1, 0])
    none, zeros = closest(signed_distances([], [0.0], p[:, :1]), [0.0]), np.zeros((4, 1, 2))
    assert np.all(none.distance == np.inf) and np.all(none.obstacle == -1) and np.all(np.isnan(none.time))
    assert ray_ttc([], [0.0], zeros, zeros).shape == (0, 4, 1)
    assert drift_ttc([], PLANE, 0.0, np.zeros((4, 4)), 10.0).shape == (0, 4)


def test_what_rtaeval_gets_wrong():
    """Every coordinate counts, times have a sign, polytopes have times of their own, penetration is kept."""
    ball, box = BallObstacle("b", [0, 0, 0], 2.0), BoxObstacle("b", [0, 0, 0], [2, 2, 2])
    assert [signed_distances([one], 0.0, [10.0, 0, 0])[0] for one in (ball, box)] == pytest.approx([8, 8])
    v = [[1.0, 0], [0, 5], [0, 0]]
    assert np.all(ray_ttc([BallObstacle("b", [-10, 0], 1.0)], 0.0, np.zeros((3, 2)), v) == np.inf)
    wall = PolytopeObstacle("w", [[-1.0, 0]], [-20], unbounded=True)
    np.testing.assert_allclose(ray_ttc([BALL, wall], 0.0, [-5, 0], [1, 0]), [4, 25])
    space = LinearSystem(np.kron([[0, 1], [0, 0]], np.eye(3)), CW.B, CW.D, CW.u_max)
    agent = SatelliteObstacle("agent", [0, 0, 12, 0, 0, -1], np.zeros(6), 2.0)
    assert signed_distances([agent], 0.0, [0.0, 0, 0], space)[0] == pytest.approx(10)
    assert ray_ttc([agent], 0.0, [0, 0, 0], [0, 0, 1], space)[0] == pytest.approx(5)
    assert mode_shares([0.0, 1, 2], [UNKNOWN, UNKNOWN]) == {UNKNOWN: 1.0}
    assert signed_distances([BALL], 0.0, [0.25, 0])[0] == pytest.approx(-0.75)


def test_drift_in_straight_lines_equals_the_ray():
    rng = np.random.default_rng(0)
    sat = SatelliteObstacle("sat", [3, -4, 0.2, 0.1], np.zeros(4), 0.7)
    moving = BallObstacle("moving", [-3, 1], 0.5, velocity=[0.3, 0.2])
    poly = PolytopeObstacle("poly", [[1, 1], [-1, 2], [0, -1]], [1, 1, 1])
    keep_in = KeepInPolytope("keep", [[1, 0], [0, 1]], [6, 6])
    cone = KeepInCone("cone", [-20, 0], [1, 0], 0.5)
    obstacles = [BALL, BOX, moving, sat, poly, keep_in, cone]
    x = np.concatenate([rng.normal(size=(2, 40, 2)) * 5, rng.normal(size=(2, 40, 2))], axis=-1)
    t = np.linspace(0, 3, 40)
    ray = ray_ttc(obstacles, t, x[..., :2], x[..., 2:], PLANE)
    drift = drift_ttc(obstacles, PLANE, t, x, 20.0)
    assert np.isfinite(ray[ray < 20]).sum() > 40
    np.testing.assert_allclose(drift, np.where(ray <= 20, ray, np.inf), rtol=1e-6, atol=1e-6)
    true = {"sat": np.array([[11.0, 0, -1, 0], [11, 0, 1, 0], [0.5, 0, 0, 0]])}  # where it really is
    times = drift_ttc([sat], PLANE, 0.0, np.zeros((3, 4)), 50.0, states=true)[0]
    np.testing.assert_allclose(times, [10.3, np.inf, 0])


def test_a_set_counts_for_times_to_collision_only_while_it_holds():
    """A box that begins later is no collision at once, one that has ended is none at all."""
    rows, x = [[1.0, 0], [-1, 0]], np.array([-8.0, 0, 1, 0])
    box = {"late": (10.0, np.inf), "between": (10.0, 12.0), "early": (-np.inf, 5.0), "missed": (12.0, 13.0)}
    sets = [KeepInPolytope(name, rows, [5, 5], *span) for name, span in box.items()]
    t = np.array([0.0, 4.0, 11.0])  # x(t + s) = s - 8 leaves the box of 5 m until s = 3, and again from 13 on
    expected = [[13.0, 13, 0], [np.inf, np.inf, 0], [0, 0, np.inf], [np.inf, np.inf, 1]]
    np.testing.assert_allclose(ray_ttc(sets, t, x[:2], x[2:], PLANE), expected, atol=1e-9)
    np.testing.assert_allclose(drift_ttc(sets, PLANE, t, x, 40.0), expected, atol=1e-6)
    assert np.all(drift_ttc(sets[:1], PLANE, 0.0, x, 12.9) == np.inf), "beyond the horizon"
    np.testing.assert_array_equal(signed_distances(sets, t, x[:2], PLANE)[0], [np.inf, np.inf, -3])


@pytest.mark.parametrize("begins", [0.0, 700.0, 1500.0, 5000.0])
def test_drift_into_a_later_box_against_dense_propagation(begins):
    late = KeepInPolytope("late", np.vstack([np.eye(3), -np.eye(3)]), [150.0] * 6, begins, begins + 600)
    rng, s, t = np.random.default_rng(0), np.linspace(0, 5000, 5001), 100.0
    x = np.hstack([rng.normal(size=(30, 3)) * 100, rng.normal(size=(30, 3)) * 0.1])
    times = drift_ttc([late], CW, t, x, 5000.0)[0]
    p = np.einsum("sij,rj->rsi", free_flight(ETA, s), x)[..., :3]
    outside = late.signed_distance(t + s, p) <= 0
    first = np.where(outside.any(axis=1), s[outside.argmax(axis=1)], np.inf)
    np.testing.assert_array_equal(np.isfinite(times), np.isfinite(first))
    np.testing.assert_allclose(times, first, atol=1.0)
    assert np.isfinite(first).any() and (times >= max(begins - t, 0.0) - 1e-9).all()


def test_metrics_of_runs_ask_when_a_set_holds():
    """One keep-in box from half of the run on: it counts from there on, and distances are over its time."""
    _, schedule = synthesised()
    runs, problem = simulate(schedule, 3, 0), schedule.safety.problem
    half, system = float(runs.times[-1]) / 2, problem.system
    sides = np.vstack([np.eye(system.d), -np.eye(system.d)])
    later = runs.positions[:, runs.times >= half].reshape(-1, system.d)
    offsets = np.hstack([later.max(axis=0), -later.min(axis=0)]) + 0.5
    late = KeepInPolytope("late", sides, offsets, begins=half)
    assert np.all(late.polytope.signed_distance(runs.positions[:, 0]) > 0), "not yet inside at the start"
    safety = replace(schedule.safety, problem=replace(problem, unsafe=(late,)))
    metrics = replace(runs, schedule=replace(schedule, safety=safety)).metrics()
    assert not metrics.collided.any() and np.all(metrics.closest_time >= half)
    assert np.all((metrics.min_distance > 0) & (metrics.mean_distance > metrics.min_distance))
    assert np.all(np.isfinite(metrics.mean_distance))
    assert np.all((metrics.min_ttc > 0) & (metrics.min_ttc_free_drift > 0))


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_drift_ttc_against_dense_propagation(seed):
    rng = np.random.default_rng(seed)
    obstacles = [
        BoxObstacle("box", [0, 0, 0], [20, 30, 20]),
        BallObstacle("ball", [50, 100, 0], 25, velocity=[0, -0.05, 0]),
        SatelliteObstacle("sat", [40, 0, 0, 0, -2 * ETA * 40, 0], np.zeros(6), 15),
        KeepInCone("cone", [0, -400, 0], [0, 1, 0], 0.6),
    ]
    horizon, t0 = 5000.0, 100.0
    x = np.r_[rng.normal(size=3) * 100, rng.normal(size=3) * 0.15]
    times = drift_ttc(obstacles, CW, t0, x, horizon)
    s = np.linspace(0, horizon, 10001)
    p = (free_flight(ETA, s) @ x)[:, :3]
    distances = signed_distances(obstacles, t0 + s, p, CW)
    for o in range(len(obstacles)):
        hits = np.flatnonzero(distances[o] <= 0)
        if len(hits) and distances[o].min() < -2e-3:
            depth = np.flatnonzero(distances[o] <= -2e-3)[0]
            assert s[max(hits[0] - 1, 0)] - 1 <= times[o] <= s[depth] + 1e-6
            if times[o] > 0:  # on the surface when it says so
                at = (free_flight(ETA, times[o]) @ x)[:3]
                assert abs(obstacles[o].signed_distance(t0 + times[o], at, CW)) < 2e-3
        elif distances[o].min() > 2e-3:
            assert times[o] == np.inf


def test_drift_ttc_sees_a_pass_far_shorter_than_its_grid():
    """1 m wide at 50 m/s: 0.02 s inside, in a horizon of an hour."""
    ball = BallObstacle("b", [0, 0, 0], 0.5)
    x = np.array([[100_000.0, 0.45, 0, -50, 0, 0], [100_000.0, 0.55, 0, -50, 0, 0]])
    flat = LinearSystem(np.kron([[0, 1], [0, 0]], np.eye(3)), CW.B, CW.D, CW.u_max)
    times = drift_ttc([ball], flat, 0.0, x, 3600.0)[0]
    assert times[0] == pytest.approx((100_000 - np.sqrt(0.25 - 0.45**2)) / 50, abs=1e-6)
    assert times[1] == np.inf


@pytest.mark.parametrize(
    ("call", "field"),
    [
        (lambda: mode_shares([0.0, 2, 1], [0, 1, 0]), "t"),
        (lambda: mode_shares([0.0, np.nan, 1], [0, 1, 0]), "t"),
        (lambda: mode_shares([0.0, 1], [0, 1, 0]), "t"),
        (lambda: mode_shares([0.0, 1], [0.5, 1]), "modes"),
        (lambda: mode_shares([], []), "modes"),
        (lambda: count_switches(1), "modes"),
        (lambda: drift_ttc([BALL], PLANE, 0.0, np.zeros(3), 1.0), "x"),
        (lambda: drift_ttc([BALL], PLANE, 0.0, np.full(4, np.nan), 1.0), "x"),
        (lambda: drift_ttc([BALL], PLANE, 0.0, np.zeros(4), -1.0), "horizon"),
        (lambda: ray_ttc([BALL], 0.0, [0.0, 0], [np.inf, 0]), "v"),
        (lambda: closest([1.0, 2.0], [0.0, 1]), "distances"),
    ],
)
def test_bad_input_is_refused(call, field):
    with pytest.raises(ScenarioError) as caught:
        call()
    assert caught.value.field == field


def test_shares_are_weighted_by_time_and_switches_counted_inside_the_run_only():
    assert mode_shares([0.0, 1, 4, 10], [0, 1, 0]) == pytest.approx({0: 0.7, 1: 0.3})
    runs = mode_shares([0.0, 1, 4], [[0, 1, 1], [2, UNKNOWN, 0]])  # the last sample holds for no time
    assert set(runs) == {UNKNOWN, 0, 1, 2}
    np.testing.assert_allclose(runs[1], [0.75, 0])
    np.testing.assert_allclose(runs[UNKNOWN], [0, 0.75])
    assert mode_shares([0.0], [1])[1] == 1.0
    np.testing.assert_array_equal(count_switches([[0, 0, 0], [0, 1, 1], [1, 0, 1], [2, 1, 0]]), [0, 1, 2, 2])
    u = UNKNOWN
    modes = [[u, u, u, u], [u, 1, u, 1], [1, u, 0, u], [u, u, 0, 1]]
    np.testing.assert_array_equal(count_switches(modes), [0, 0, 1, 1])
    assert count_switches([1, 0, 0], [0.0, 0, 1]) == 0, "of two rows stamped t = 0 the first held for no time"
    assert count_switches([1, 0, 0]) == 1 and count_switches([0]) == 0
