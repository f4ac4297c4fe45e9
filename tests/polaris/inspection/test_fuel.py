"""The fuel limit: the condition's soundness, the last rule, Fig. 9."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings

from polaris.inspection.backup.decay import Decay
from polaris.inspection.backup.tracker import BackupTracker, fly_backup
from polaris.inspection.enmt import Ellipses, semi_axes, velocity_error
from polaris.inspection.filters.fuel import FuelLimit, clearance
from polaris.inspection.flights.fuel_run import fly_fuel_limit
from polaris.inspection.flights.primary import LQR, Phases
from polaris.inspection.inspection import Inspection
from polaris.model.errors import ScenarioError
from polaris.model.hill import elliptical_nmt
from tests.polaris.inspection.garbage import answers, calls, malformed, odd_times

ONE, TWO = Inspection(deputies=1), Inspection(deputies=2)
ELLIPSE = elliptical_nmt(ONE.mean_motion, 100.0, 1.0)[None]
START = [300.0, -200.0, 100.0, 0.0, 0.0, 0.0]


def wasteful(q):
    """Aggressive LQR that uses as much fuel as it can: outwards to 400 m and back, without end."""
    inner, outer = LQR(q, 100.0), LQR(q, 400.0)
    return Phases(np.arange(0.0, 20_000.0, 400.0).tolist(), [inner, outer] * 25)


@pytest.mark.slow
def test_fig_9_fuel_stays_below_the_limit_and_thrust_goes_to_zero():
    r = fly_fuel_limit(FuelLimit(BackupTracker(ONE)), wasteful(ONE), START, predict_at=(10.0, 25.0))
    assert r.t[-1] == 7000 and 20 < r.latched_at < 200 and "fuel" in r.reason
    assert (np.diff(r.delta_v) >= 0).all()
    assert 19.0 < r.delta_v[-1] <= 20.0 and not r.exhausted  # and does not waste what it may use
    late = r.t[:-1] > r.latched_at + 2500
    assert np.abs(r.u[late]).max() < 1e-6 and np.ptp(r.delta_v[1:][late]) < 1e-6
    assert np.abs(velocity_error(r.x[-1], ONE.mean_motion)).max() < 1e-6
    assert np.linalg.norm(r.x[:, :3], axis=1).min() > ONE.separation
    # Eq. 25, recomputed: an exact sum, as the thrust is held.
    np.testing.assert_allclose(r.delta_v[1:], np.cumsum(np.abs(r.u).sum(axis=1) / ONE.mass), rtol=1e-12)
    # Before the switch the input is the desired one, clipped; after it, never.
    k = int(r.latched_at)
    np.testing.assert_array_equal(r.u[:k], np.clip(r.desired[:k], -1, 1))
    # Predictions start on the run, and the last is what was flown.
    assert len(r.predictions) == 3
    last = r.predictions[-1]
    assert last.t[0] == r.latched_at
    np.testing.assert_allclose(last.x, r.x[k : k + len(last.x)], atol=1e-7)
    np.testing.assert_allclose(last.delta_v, r.delta_v[k : k + len(last.x)], atol=1e-9)


def test_the_printed_condition_breaks_the_limit_and_ours_does_not():
    """Eq. 39 looks at the backup flight from now; the coming period is nobody's."""
    period, law = 20.0, BackupTracker(ONE, period=20.0, response=60.0)
    Phi, Gamma = law.motion

    def bound(x):
        return fly_backup(law, x, 500).delta_v(ONE.mass, period)[0]

    def printed(limit):
        x, delta_v = np.array([[200.0, -100.0, 0, 0, 0, 0]]), 0.0
        while delta_v + bound(x) <= limit:
            x, delta_v = x @ Phi.T + np.ones((1, 3)) @ Gamma.T, delta_v + 3 * period / ONE.mass
        return delta_v + bound(x)

    totals = []
    for limit in np.linspace(15.0, 25.0, 11):
        totals.append(printed(limit) - limit)
        q = Inspection(deputies=1, delta_v_max=float(limit))
        f = FuelLimit(BackupTracker(q, period=period, response=60.0))
        ours = fly_fuel_limit(f, lambda t, x: np.ones((1, 1, 3)), [200.0, -100, 0, 0, 0, 0], 2000.0)
        assert ours.delta_v[-1] <= limit and not ours.exhausted
    assert max(totals) > 1.0


@pytest.mark.parametrize("seed", range(2))
def test_the_limit_is_kept_by_the_condition_alone(seed):
    """From random states and by random inputs; the last rule never has to act."""
    rng = np.random.default_rng(seed)
    law = BackupTracker(TWO)
    Phi, Gamma = law.motion
    x = np.hstack([rng.uniform(-300, 300, (2, 3)), rng.uniform(-0.3, 0.3, (2, 3))])
    x[:, 1] += 150 * np.sign(x[:, 1])
    f = FuelLimit(law, spent=rng.uniform(5, 15, 2))
    push = rng.uniform(-2, 2, (2, 3))
    delta_v = f.spent.copy()
    for k in range(700):
        if k % 20 == 0:
            push = rng.uniform(-2, 2, (2, 3))
        d = f.filter(float(k), x, push)
        assert k or min(d.margins["reserve[0]"], d.margins["reserve[1]"]) > 0, "the start is as it must be"
        delta_v += np.abs(d.u).sum(axis=1) / TWO.mass
        np.testing.assert_allclose(delta_v, f.spent, rtol=1e-12)
        assert not any(name.startswith("phi12") for name in d.active)
        assert (delta_v <= TWO.delta_v_max).all()
        assert (np.linalg.norm(x[:, :3], axis=1) > TWO.separation).all()
        x = x @ Phi.T + d.u @ Gamma.T
    assert f.latched.all() and np.abs(d.u).max() < 1e-3
    assert {entry.deputy for entry in f.log} == {0, 1}


def test_a_chief_in_the_way_is_left_clear_of():
    """The deputy is sent straight at the chief, with fuel enough."""
    x0 = [0.0, -400.0, 0.0, 0.0, 0.0, 0.0]
    free, avoiding = (
        fly_fuel_limit(FuelLimit(BackupTracker(ONE), keep_clear=clear), LQR(ONE), x0, 700.0)
        for clear in (False, True)
    )
    assert np.linalg.norm(free.x[:, :3], axis=1).min() < ONE.separation
    assert np.linalg.norm(avoiding.x[:, :3], axis=1).min() >= ONE.separation and "chief" in avoiding.reason


def test_clearance_is_below_what_dense_samples_show():
    law = BackupTracker(ONE, period=4.0)
    rng = np.random.default_rng(2)
    x = np.hstack([rng.uniform(-60, 60, (30, 3)), rng.uniform(-1, 1, (30, 3))])
    u = rng.uniform(-1, 1, (30, 3))
    Phi, Gamma = law.motion
    after = x @ Phi.T + u @ Gamma.T
    flight = fly_backup(law, after, 500)
    bound = clearance(flight, x, law)
    states, inputs = [x, *flight.x], [u, *flight.u]
    least = np.full(30, np.inf)
    for tau in np.linspace(0, 4, 21):
        P, G = ONE.discretize(float(tau))
        for a, b in zip(states[:-1], inputs, strict=True):
            least = np.minimum(least, np.linalg.norm((a @ P.T + b @ G.T)[:, :3], axis=1))
    over = least - ONE.separation - bound
    assert (over >= 0).all() and np.median(over) < 30.0  # on an ellipse no more than its semi-minor axis


def test_fuel_nearly_used_up_at_the_start():
    """Backup at once; thrust is cut where the fuel ends; the limit holds."""
    f = FuelLimit(BackupTracker(ONE), spent=19.99)
    r = fly_fuel_limit(f, wasteful(ONE), [100.0, 50.0, 0.0, 0.5, 0.0, 0.0], 300.0)
    assert r.latched_at == 0.0 and r.exhausted
    assert r.delta_v[-1] <= ONE.delta_v_max and not r.u[50:].any()


@pytest.mark.parametrize("spent", [20.0, 25.0])
def test_no_fuel_at_all_is_no_thrust_at_all(spent):
    f = FuelLimit(BackupTracker(ONE), spent=spent)
    d = f.filter(0.0, np.array([START]), np.ones((1, 3)))
    assert not d.u.any() and d.status == "coast" and "exhausted" in d.fallback
    assert f.spent[0] == spent


def test_at_the_centre_of_the_chief_the_backup_leads_away():
    r = fly_fuel_limit(FuelLimit(BackupTracker(ONE)), LQR(ONE), np.zeros(6), 3000.0)
    assert r.latched_at == 0.0 and "chief" in r.reason
    assert np.linalg.norm(r.x[-1, :3]) > ONE.separation and np.abs(r.u[-1]).max() < 1e-6


def test_a_horizon_too_short_is_not_taken_for_safe():
    f = FuelLimit(BackupTracker(ONE), horizon=5.0)
    f.filter(0.0, np.array([[100.0, 0, 0, 2.0, 0, 0]]), np.ones((1, 3)))
    assert f.latched[0] and "horizon" in f.log[0].reason


def test_missing_input_is_backup_for_that_period_only():
    x = ELLIPSE + [0, 0, 0, 0.05, 0, 0]
    law = BackupTracker(ONE)
    for desired in (None, [[np.nan, 0, 0]], [[np.inf, 0, 0]]):
        f = FuelLimit(BackupTracker(ONE))
        d = f.filter(0.0, x, desired)
        np.testing.assert_allclose(d.u, law.thrust(x, law.start(x))[0], atol=1e-12)
        assert d.status == "backup" and "desired input" in d.fallback and not f.latched[0]
        assert f.filter(1.0, x, np.full((1, 3), 0.1)).status == "desired"


def test_late_calls_are_counted_and_recorded():
    f = FuelLimit(BackupTracker(ONE))
    f.filter(0.0, ELLIPSE, np.full((1, 3), 0.4))
    np.testing.assert_allclose(f.spent, 0.1)
    d = f.filter(3.0, ELLIPSE, np.zeros((1, 3)))
    np.testing.assert_allclose(f.spent, 0.3)
    assert "called after 3 s: the last answer was for 1 s" in d.fallback


def test_lost_state_coasts_and_comes_back():
    f = FuelLimit(BackupTracker(ONE))
    assert f.filter(0.0, ELLIPSE, np.full((1, 3), 0.4)).status == "desired"
    d = f.filter(1.0, np.full((1, 6), np.nan), np.full((1, 3), 0.4))
    assert d.status == "coast" and not d.u.any()
    assert f.filter(2.0, ELLIPSE, np.full((1, 3), 0.4)).status == "desired"


@given(calls(2))
@settings(max_examples=25, deadline=None, suppress_health_check=list(HealthCheck))
def test_garbage(sequence):
    f = FuelLimit(LAW_2, horizon=200.0)
    answers(f, sequence)
    assert np.isfinite(f.spent).all()


LAW_2 = BackupTracker(TWO)


@pytest.mark.parametrize("horizon", [0.0, 0.5, 1e9, np.nan, -1.0])
def test_horizons_out_of_range(horizon):
    with pytest.raises(ScenarioError, match="horizon"):
        FuelLimit(BackupTracker(ONE), horizon=horizon)


def test_arguments():
    for delta_v in (-1.0, np.nan, [1.0, 2.0, 3.0]):
        with pytest.raises(ScenarioError, match="spent"):
            FuelLimit(BackupTracker(TWO), spent=delta_v)
    with pytest.raises(ScenarioError, match="deputies"):
        fly_fuel_limit(FuelLimit(BackupTracker(TWO)), wasteful(TWO), START)
    with pytest.raises(ScenarioError, match="period"):
        fly_fuel_limit(FuelLimit(BackupTracker(ONE, period=3.0)), wasteful(ONE), START, 10.0)


def test_malformed_values_and_odd_times_are_answered_and_told():
    malformed(FuelLimit(LAW_2))
    odd_times(FuelLimit(BackupTracker(ONE)), ELLIPSE, np.zeros((1, 3)))


N = ONE.mean_motion
LIMITS = Ellipses(N, 15.0, 200.0, 120.0)


def states(count, seed=0, position=600.0, speed=2.0):
    rng = np.random.default_rng(seed)
    return np.hstack([rng.uniform(-position, position, (count, 3)), rng.uniform(-speed, speed, (count, 3))])


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


@pytest.mark.parametrize(
    ("least", "largest", "cross"),
    [(0, 100, 1), (10, 12, 1), (10, 100, -1), (np.nan, 100, 1), (10, np.nan, 1)],
)
def test_limits_without_room_are_refused(least, largest, cross):
    with pytest.raises(ScenarioError):
        Ellipses(N, least, largest, cross)


def test_limits_for_a_problem_keep_in_and_slow():
    e = Ellipses.for_inspection(ONE)
    assert e.least > ONE.separation and 2 * N * e.largest <= ONE.speed_max
    assert 4 * e.largest**2 + e.cross_track**2 <= ONE.distance_max**2 * (1 + 1e-12)


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
        assert peak.max() <= limit and decay.never_above(s, limit * 1.001)
        assert not decay.never_above(s, limit * 0.999)


def test_unstable_and_creeping_loops_are_refused():
    for radius in (1.0, 1.2, 1 - 1e-7):
        with pytest.raises(ScenarioError):
            Decay(radius * np.eye(2), np.eye(2), np.ones(2))
    with pytest.raises(ScenarioError, match="period"):
        BackupTracker(ONE, period=200.0)
    with pytest.raises(ScenarioError, match="ellipses"):
        BackupTracker(ONE, Ellipses(0.0011, 15.0))  # of another orbit


@pytest.mark.parametrize("law", [BackupTracker(ONE), BackupTracker(ONE, period=5.0)], ids=["1 s", "5 s"])
def test_flights_settle_thrust_goes_to_zero_and_the_outlook_holds(law):
    x = np.vstack([states(60), states(40, 5, 12.0, 0.3), np.zeros((1, 6)), 0 * np.ones((1, 6))])
    x[-1, :3] = 1e-9
    flight = fly_backup(law, x, 3000)
    assert (np.abs(flight.u) <= ONE.thrust_max).all()
    look = flight.outlook
    assert look.settled.all()
    (Phi, Gamma), memory, xs, us = law.motion, flight.memory, [flight.x[-1]], []
    for _ in range(int(5000 / law.period)):  # whether settled or not
        u, memory = law.thrust(xs[-1], memory)
        xs.append(xs[-1] @ Phi.T + u @ Gamma.T)
        us.append(u)
    xs, us = np.stack(xs), np.stack(us)
    assert np.abs(us[-1]).max() < 1e-7 and np.abs(us[-1]).max() < 1e-6 * np.abs(us[0]).max() + 1e-12
    # Nothing is clipped, the bounds hold and are of the right size.
    assert np.abs(us).max() < ONE.thrust_max
    delta_v = np.abs(us).sum(axis=(0, 2)) * law.period / ONE.mass
    assert (delta_v <= look.delta_v * (1 + 1e-9)).all()
    assert (look.delta_v <= 1.05 * delta_v + 1e-3).all()
    distance = np.linalg.norm(xs[..., :3], axis=-1)
    assert (distance.min(axis=0) >= look.distance).all()
    # It ends clear of the chief.
    assert (semi_axes(xs[-1], N)[0] >= 1.2 * ONE.separation).all()
    assert np.abs(velocity_error(xs[-1], N)).max() < 1e-7


def test_anti_windup_holds_the_integral_of_clipped_axes():
    law = BackupTracker(ONE)
    x = np.array([[400.0, 100.0, 0.0, 3.0, 0.0, 0.0]])
    memory = law.start(x)
    x[0, 0] += 300  # far from the reference: clipped at once
    Phi, Gamma = law.motion
    largest = naive = 0.0
    for _ in range(150):
        error = x - memory[:, :6]
        u, after = law.thrust(x, memory)
        if abs(u[0, 0]) == ONE.thrust_max and error[0, 0] * u[0, 0] < 0:
            assert after[0, 6] == memory[0, 6]
        naive += error[0, 0]
        largest = max(largest, abs(after[0, 6]))
        x, memory = x @ Phi.T + u @ Gamma.T, after
    assert largest < 0.7 * abs(naive)
