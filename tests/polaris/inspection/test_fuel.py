"""The fuel limit: the condition's soundness, the last rule, Fig. 9."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings

from polaris.inspection.backup.tracker import BackupTracker, fly_backup
from polaris.inspection.enmt import velocity_error
from polaris.inspection.filters.fuel import FuelLimit, clearance
from polaris.inspection.flights.fuel_run import fly_fuel_limit
from polaris.inspection.flights.primary import LQR, Phases
from polaris.inspection.inspection import Inspection
from polaris.model.errors import ScenarioError
from polaris.model.hill import elliptical_nmt
from tests.polaris.inspection.garbage import answers, calls, malformed, odd_times

ONE, TWO = Inspection(deputies=1), Inspection(deputies=2)
START = [300.0, -200.0, 100.0, 0.0, 0.0, 0.0]


def wasteful(q):
    """Aggressive LQR that uses as much fuel as it can: outwards to 400 m and back, without end."""
    inner, outer = LQR(q, 100.0), LQR(q, 400.0)
    return Phases(np.arange(0.0, 20_000.0, 400.0).tolist(), [inner, outer] * 25)


def run(law=None, **options):
    return fly_fuel_limit(FuelLimit(law or BackupTracker(ONE)), wasteful(ONE), START, **options)


@pytest.mark.slow
def test_fig_9_fuel_stays_below_the_limit_and_thrust_goes_to_zero():
    r = run(predict_at=(10.0, 25.0))
    assert r.t[-1] == 7000
    assert 20 < r.latched_at < 200
    assert "fuel" in r.reason
    assert (np.diff(r.delta_v) >= 0).all()
    assert r.delta_v[-1] <= 20.0
    assert r.delta_v[-1] > 19.0  # and does not waste what it may use
    assert not r.exhausted
    late = r.t[:-1] > r.latched_at + 2500
    assert np.abs(r.u[late]).max() < 1e-6
    assert np.ptp(r.delta_v[1:][late]) < 1e-6
    assert np.abs(velocity_error(r.x[-1], ONE.mean_motion)).max() < 1e-6
    assert np.linalg.norm(r.x[:, :3], axis=1).min() > ONE.separation
    # Eq. 25, recomputed: an exact sum, as the thrust is held.
    spent = np.abs(r.u).sum(axis=1) / ONE.mass
    np.testing.assert_allclose(r.delta_v[1:], np.cumsum(spent), rtol=1e-12)
    # Before the switch the input is the desired one, clipped; after it, never.
    k = int(r.latched_at)
    np.testing.assert_array_equal(r.u[:k], np.clip(r.desired[:k], -1, 1))
    # Predictions start on the run, and the last is what was flown.
    assert len(r.predictions) == 3
    last = r.predictions[-1]
    assert last.t[0] == r.latched_at
    np.testing.assert_allclose(last.x, r.x[k : k + len(last.x)], atol=1e-7)
    np.testing.assert_allclose(last.delta_v, r.delta_v[k : k + len(last.x)], atol=1e-9)


def test_without_the_filter_the_limit_would_be_broken_by_far():
    q = Inspection(deputies=1, delta_v_max=1e5)
    r = fly_fuel_limit(FuelLimit(BackupTracker(q)), wasteful(q), START, 200.0)
    assert r.delta_v[-1] > 1.5 * ONE.delta_v_max
    assert r.latched_at is None
    assert r.reason is None


def test_the_printed_condition_breaks_the_limit_and_ours_does_not():
    """Eq. 39 looks at the backup flight from now; the coming period is nobody's."""
    period, law = 20.0, BackupTracker(ONE, period=20.0, response=60.0)
    Phi, Gamma = law.motion

    def bound(x):
        return fly_backup(law, x, 500).delta_v(ONE.mass, period)[0]

    def fly(look_ahead):
        x, spent = np.array([[200.0, -100.0, 0, 0, 0, 0]]), 0.0
        while True:
            after = x @ Phi.T + np.ones((1, 3)) @ Gamma.T
            needed = 3 * period / ONE.mass + bound(after) if look_ahead else bound(x)
            if not spent + needed <= limit:
                return spent + bound(x)
            x, spent = after, spent + 3 * period / ONE.mass

    totals = []
    for limit in np.linspace(15.0, 25.0, 11):
        totals.append(fly(False) - limit)
        assert fly(True) <= limit
        q = Inspection(deputies=1, delta_v_max=float(limit))
        ours = fly_fuel_limit(
            FuelLimit(BackupTracker(q, period=period, response=60.0)),
            lambda t, x: np.ones((1, 1, 3)),
            [200.0, -100, 0, 0, 0, 0],
            2000.0,
        )
        assert ours.delta_v[-1] <= limit
        assert not ours.exhausted
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
    spent = f.spent.copy()
    first = None
    for k in range(700):
        if k % 20 == 0:
            push = rng.uniform(-2, 2, (2, 3))
        d = f.filter(float(k), x, push)
        if k == 0:
            first = dict(d.margins)
        spent += np.abs(d.u).sum(axis=1) / TWO.mass
        np.testing.assert_allclose(spent, f.spent, rtol=1e-12)
        assert not any(name.startswith("phi12") for name in d.active)
        assert (spent <= TWO.delta_v_max).all()
        assert (np.linalg.norm(x[:, :3], axis=1) > TWO.separation).all()
        x = x @ Phi.T + d.u @ Gamma.T
    assert min(first["reserve[0]"], first["reserve[1]"]) > 0, "the start satisfies the condition"
    assert f.latched.all()
    assert np.abs(d.u).max() < 1e-3
    assert {entry.deputy for entry in f.log} == {0, 1}


def test_a_chief_in_the_way_is_left_clear_of():
    """The deputy is sent straight at the chief, with fuel enough."""
    x0 = [0.0, -400.0, 0.0, 0.0, 0.0, 0.0]
    free = fly_fuel_limit(FuelLimit(BackupTracker(ONE), keep_clear=False), LQR(ONE), x0, 700.0)
    kept = fly_fuel_limit(FuelLimit(BackupTracker(ONE)), LQR(ONE), x0, 700.0)
    assert np.linalg.norm(free.x[:, :3], axis=1).min() < ONE.separation
    assert np.linalg.norm(kept.x[:, :3], axis=1).min() >= ONE.separation
    assert "chief" in kept.reason


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
    assert (bound <= least - ONE.separation).all()
    assert (bound > -np.inf).all()
    assert (
        np.median(least - ONE.separation - bound) < 30.0
    )  # on an ellipse the semi-minor axis is all that is claimed


# ---- edges: what is defined where nothing can be guaranteed


def test_fuel_nearly_used_up_at_the_start():
    """Backup at once; thrust is cut where the fuel ends; the limit holds."""
    r = fly_fuel_limit(
        FuelLimit(BackupTracker(ONE), spent=19.99), wasteful(ONE), [100.0, 50.0, 0.0, 0.5, 0.0, 0.0], 300.0
    )
    assert r.latched_at == 0.0
    assert r.exhausted
    assert r.delta_v[-1] <= ONE.delta_v_max
    assert not r.u[50:].any()


@pytest.mark.parametrize("spent", [20.0, 25.0])
def test_no_fuel_at_all_is_no_thrust_at_all(spent):
    f = FuelLimit(BackupTracker(ONE), spent=spent)
    d = f.filter(0.0, np.array([START]), np.ones((1, 3)))
    assert not d.u.any()
    assert d.status == "coast"
    assert "exhausted" in d.fallback
    assert f.spent[0] == spent


def test_at_the_centre_of_the_chief_the_backup_leads_away():
    r = fly_fuel_limit(FuelLimit(BackupTracker(ONE)), LQR(ONE), np.zeros(6), 3000.0)
    assert r.latched_at == 0.0
    assert "chief" in r.reason
    assert np.linalg.norm(r.x[-1, :3]) > ONE.separation
    assert np.abs(r.u[-1]).max() < 1e-6


def test_a_horizon_too_short_is_not_taken_for_safe():
    f = FuelLimit(BackupTracker(ONE), horizon=5.0)
    f.filter(0.0, np.array([[100.0, 0, 0, 2.0, 0, 0]]), np.ones((1, 3)))
    assert f.latched[0]
    assert "horizon" in f.log[0].reason


def test_a_tiny_thrust_limit_is_refused_by_the_problem_itself():
    with pytest.raises(ScenarioError, match="thrust_max"):
        Inspection(deputies=1, thrust_max=1e-3)


def test_missing_input_is_backup_for_that_period_only():
    x = elliptical_nmt(ONE.mean_motion, 100.0, 1.0)[None] + [0, 0, 0, 0.05, 0, 0]
    law = BackupTracker(ONE)
    for bad in (None, [[np.nan, 0, 0]], [[np.inf, 0, 0]]):
        f = FuelLimit(BackupTracker(ONE))
        d = f.filter(0.0, x, bad)
        np.testing.assert_allclose(d.u, law.thrust(x, law.start(x))[0], atol=1e-12)
        assert d.status == "backup"
        assert "desired input" in d.fallback
        assert not f.latched[0]
        assert f.filter(1.0, x, np.full((1, 3), 0.1)).status == "desired"


def test_late_calls_are_counted_and_recorded():
    x = elliptical_nmt(ONE.mean_motion, 100.0, 1.0)[None]
    f = FuelLimit(BackupTracker(ONE))
    f.filter(0.0, x, np.full((1, 3), 0.4))
    np.testing.assert_allclose(f.spent, 0.1)
    d = f.filter(3.0, x, np.zeros((1, 3)))
    np.testing.assert_allclose(f.spent, 0.3)
    assert "called after 3 s: the last answer was for 1 s" in d.fallback


def test_lost_state_coasts_and_comes_back():
    x = elliptical_nmt(ONE.mean_motion, 100.0, 1.0)[None]
    f = FuelLimit(BackupTracker(ONE))
    assert f.filter(0.0, x, np.full((1, 3), 0.4)).status == "desired"
    d = f.filter(1.0, np.full((1, 6), np.nan), np.full((1, 3), 0.4))
    assert d.status == "coast"
    assert not d.u.any()
    assert f.filter(2.0, x, np.full((1, 3), 0.4)).status == "desired"


def test_clipped_input_is_recorded():
    x = elliptical_nmt(ONE.mean_motion, 100.0, 1.0)[None]
    d = FuelLimit(BackupTracker(ONE)).filter(0.0, x, np.array([[5.0, 0.0, -0.5]]))
    np.testing.assert_array_equal(d.u, [[1.0, 0.0, -0.5]])
    assert d.status == "filtered"
    assert d.intervened[0]


def test_malformed_values_are_answered():
    malformed(FuelLimit(BackupTracker(TWO)))


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
    for spent in (-1.0, np.nan, [1.0, 2.0, 3.0]):
        with pytest.raises(ScenarioError, match="spent"):
            FuelLimit(BackupTracker(TWO), spent=spent)
    with pytest.raises(ScenarioError, match="deputies"):
        fly_fuel_limit(FuelLimit(BackupTracker(TWO)), wasteful(TWO), START)
    with pytest.raises(ScenarioError, match="period"):
        fly_fuel_limit(FuelLimit(BackupTracker(ONE, period=3.0)), wasteful(ONE), START, 10.0)


def test_odd_times_are_answered_and_told():
    x = elliptical_nmt(ONE.mean_motion, 100.0, 1.0)[None]
    odd_times(FuelLimit(BackupTracker(ONE)), x, np.zeros((1, 3)))
