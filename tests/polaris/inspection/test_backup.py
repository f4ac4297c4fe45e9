"""eNMTs, backup controllers, and what is known of their flights for ever after."""

import numpy as np
import pytest

from polaris.inspection.backup.decay import Decay
from polaris.inspection.backup.tracker import BackupTracker, fly_backup
from polaris.inspection.enmt import Ellipses, semi_axes, stopping_point, velocity_error
from polaris.inspection.inspection import Inspection
from polaris.model.errors import ScenarioError
from polaris.model.hill import elliptical_nmt, free_flight

Q = Inspection(deputies=1)
N = Q.mean_motion
LIMITS = Ellipses(N, 15.0, 200.0, 120.0)


def states(count, seed=0, position=600.0, speed=2.0):
    rng = np.random.default_rng(seed)
    return np.hstack([rng.uniform(-position, position, (count, 3)), rng.uniform(-speed, speed, (count, 3))])


def on_long(law, x, memory, steps):
    """Fly on, whether settled or not; all states and thrusts."""
    Phi, Gamma = law.motion
    xs, us = [x], []
    for _ in range(steps):
        u, memory = law.thrust(x, memory)
        x = x @ Phi.T + u @ Gamma.T
        xs.append(x)
        us.append(u)
    return np.stack(xs), np.stack(us)


# ---- the ellipses


def distance_between(x, y):
    d = x - y
    return np.sqrt(d[..., 0] ** 2 + (d[..., 1] / 2) ** 2 + d[..., 2] ** 2 + (d[..., 5] / N) ** 2)


def test_nearest_ellipse_against_brute_force():
    a = np.linspace(15, 200, 75)
    psi = np.linspace(0, 2 * np.pi, 360, endpoint=False)
    plane = elliptical_nmt(N, a[:, None], np.tile(psi, (75, 1))).reshape(-1, 6)
    c = np.linspace(0, 120, 61)
    across = np.zeros((61, 360, 6))
    across[..., 2], across[..., 5] = np.outer(c, np.cos(psi)), np.outer(c, N * np.sin(psi))
    across = across.reshape(-1, 6)
    for x in np.vstack([states(40), states(40, 1, 20.0, 0.1), states(20, 2, 250.0, 0.2)]):
        nearest = LIMITS.nearest(x)
        assert (velocity_error(nearest, N) == 0).all()
        ours = distance_between(x, nearest)
        in_plane, cross = np.eye(6)[[0, 1, 3, 4]].sum(0), np.eye(6)[[2, 5]].sum(0)
        best_plane = distance_between(x * in_plane, plane).min()
        best_cross = distance_between(x * cross, across).min()
        brute = np.hypot(best_plane, best_cross)
        assert brute - 8.0 <= ours <= brute + 1e-9  # the grid is 2.5 m by up to 3.5 m


def test_nearest_is_equation_41_within_the_limits():
    x = np.array([60.0, -80.0, 30.0, 0.4, -0.3, 0.02])
    printed = np.array([60.0, -80.0, 30.0, N * -80 / 2, -2 * N * 60, 0.02])
    np.testing.assert_allclose(LIMITS.nearest(x), printed, rtol=1e-14)


def test_nearest_at_the_very_centre():
    np.testing.assert_allclose(LIMITS.nearest(np.zeros(6))[:3], [0, 30.0, 0])


def test_ellipses_keep_their_semi_minor_axis_and_stay_farther_away():
    x = LIMITS.nearest(states(50))
    a, c = semi_axes(x, N)
    flown = np.einsum("sij,nj->sni", free_flight(N, np.linspace(0, 7000, 500)), x)
    np.testing.assert_allclose(semi_axes(flown, N)[0], np.tile(a, (500, 1)), rtol=1e-9)
    np.testing.assert_allclose(semi_axes(flown, N)[1], np.tile(c, (500, 1)), rtol=1e-9)
    distance = np.linalg.norm(flown[..., :3], axis=-1)
    assert (distance >= a - 1e-9).all()
    assert (distance**2 <= 4 * a**2 + c**2 + 1e-6).all()


def test_limits_for_a_problem_keep_in_and_slow():
    e = Ellipses.for_inspection(Q)
    assert e.least > Q.separation
    assert 4 * e.largest**2 + e.cross_track**2 <= Q.distance_max**2 * (1 + 1e-12)
    assert 2 * N * e.largest <= Q.speed_max


@pytest.mark.parametrize(
    ("least", "largest", "cross"),
    [(0, 100, 1), (10, 12, 1), (10, 100, -1), (np.nan, 100, 1), (10, np.nan, 1)],
)
def test_limits_without_room_are_refused(least, largest, cross):
    with pytest.raises(ScenarioError):
        Ellipses(N, least, largest, cross)


def test_stopping_point_is_where_braking_ends():
    x = np.array([[100.0, 50.0, 0.0, 0.5, -0.8, 0.0]])
    at = stopping_point(x, N, 1 / 12)
    assert np.abs(velocity_error(at, N)).max() < 1e-15
    e = velocity_error(x, N)[0]
    np.testing.assert_allclose((at - x)[0, :2], e * np.abs(e) * 6, rtol=1e-12)


# ---- sums over a linear loop


def test_totals_and_peaks_bound_what_is_put_out_and_are_sharp():
    rng = np.random.default_rng(4)
    M = rng.normal(size=(4, 4))
    M *= 0.97 / np.abs(np.linalg.eigvals(M)).max()
    C = rng.normal(size=(2, 4))
    decay = Decay(M, C, np.array([1.0, 2.0, 0.5, 1.0]))
    for s in rng.normal(size=(20, 4)):
        out, at = [], s
        for _ in range(5000):
            out.append(np.abs(C @ at))
            at = M @ at
        total, peak = np.sum(out, axis=0), np.max(out, axis=0)
        assert (total <= decay.total(s) * (1 + 1e-12)).all()
        assert (decay.total(s) <= total * 1.02).all()
        assert (peak <= decay.peak(s) * (1 + 1e-12)).all()
        limit = np.sqrt(s @ decay.energy @ s)
        assert peak.max() <= limit
        assert decay.never_above(s, limit * 1.001)
        assert not decay.never_above(s, limit * 0.999)


def test_unstable_and_creeping_loops_are_refused():
    for radius in (1.0, 1.2, 1 - 1e-7):
        with pytest.raises(ScenarioError):
            Decay(radius * np.eye(2), np.eye(2), np.ones(2))
    with pytest.raises(ScenarioError, match="period"):
        BackupTracker(Q, period=200.0)


# ---- the controllers


@pytest.mark.parametrize("law", [BackupTracker(Q), BackupTracker(Q, period=5.0)], ids=["1 s", "5 s"])
def test_flights_settle_thrust_goes_to_zero_and_the_outlook_holds(law):
    x = np.vstack([states(60), states(40, 5, 12.0, 0.3), np.zeros((1, 6)), 0 * np.ones((1, 6))])
    x[-1, :3] = 1e-9
    flight = fly_backup(law, x, 3000)
    assert (np.abs(flight.u) <= Q.thrust_max).all()
    look = flight.outlook
    assert look.settled.all()
    xs, us = on_long(law, flight.x[-1], flight.memory, int(5000 / law.period))
    assert np.abs(us[-1]).max() < 1e-7
    assert np.abs(us[-1]).max() < 1e-6 * np.abs(us[0]).max() + 1e-12
    # Nothing is clipped, the bounds hold and are of the right size.
    assert np.abs(us).max() < Q.thrust_max
    spent = np.abs(us).sum(axis=(0, 2)) * law.period / Q.mass
    assert (spent <= look.delta_v * (1 + 1e-9)).all()
    assert (look.delta_v <= 1.05 * spent + 1e-3).all()
    distance = np.linalg.norm(xs[..., :3], axis=-1)
    assert (distance.min(axis=0) >= look.distance).all()
    # It ends clear of the chief.
    assert (semi_axes(xs[-1], N)[0] >= 1.2 * Q.separation).all()
    assert np.abs(velocity_error(xs[-1], N)).max() < 1e-7


def test_anti_windup_holds_the_integral_of_clipped_axes():
    law = BackupTracker(Q)
    x = np.array([[400.0, 100.0, 0.0, 3.0, 0.0, 0.0]])
    memory = law.start(x)
    x[0, 0] += 300  # far from the reference: clipped at once
    Phi, Gamma = law.motion
    largest = naive = 0.0
    for _ in range(150):
        error = x - memory[:, :6]
        u, after = law.thrust(x, memory)
        if abs(u[0, 0]) == Q.thrust_max and error[0, 0] * u[0, 0] < 0:
            assert after[0, 6] == memory[0, 6]
        naive += error[0, 0]
        largest = max(largest, abs(after[0, 6]))
        x, memory = x @ Phi.T + u @ Gamma.T, after
    assert largest < 0.7 * abs(naive)


def test_ellipses_of_another_orbit_are_refused():
    with pytest.raises(ScenarioError, match="ellipses"):
        BackupTracker(Q, Ellipses(0.0011, 15.0))
