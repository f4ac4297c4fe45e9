"""Backup flights judged, and the implicit barrier filter."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings

from polaris.inspection.backup.law import Coast, fly_backup
from polaris.inspection.backup.parking import Parking
from polaris.inspection.constraints.allowable_set import AllowableRows, allowable
from polaris.inspection.filters.flight_check import FlightCheck
from polaris.inspection.filters.implicit import ImplicitASIF
from polaris.inspection.flights.primary import LQR
from polaris.inspection.inspection import Inspection
from polaris.model.errors import ScenarioError
from polaris.model.hill import elliptical_nmt

from .garbage import answers, calls, malformed, odd_times

ONE, TWO, THREE = (Inspection(deputies=k) for k in (1, 2, 3))
N = ONE.mean_motion


def formation(q, seed=3):
    """At rest, away from the sun's cone if the sun starts at pi."""
    rng = np.random.default_rng(seed)
    x = np.zeros((q.deputies, 6))
    x[:, 0] = rng.uniform(-250, -120, q.deputies)
    x[:, 1] = np.linspace(-150, 150, q.deputies) + rng.uniform(-20, 20, q.deputies)
    x[:, 2] = rng.uniform(-60, 60, q.deputies)
    return x


# ---- the constraints as rows


def test_rows_agree_with_the_allowable_set():
    rng = np.random.default_rng(0)
    x = np.concatenate([rng.uniform(-1100, 1100, (400, 3, 3)), rng.uniform(-1.2, 1.2, (400, 3, 3))], axis=2)
    x[::2, :, :3] *= 0.03
    sun = rng.uniform(0, 7, 400)
    rows = AllowableRows(THREE)
    ours, theirs = rows(x, sun).h, allowable(THREE, x, sun)
    kinds = np.array([label.split("[")[0] for label in rows.labels])
    for name in ("phi1", "phi2", "phi3", "phi6", "phi9", "phi10", "phi11"):
        np.testing.assert_allclose(ours[:, kinds == name], theirs[name], atol=1e-9)
    np.testing.assert_array_equal(ours[:, kinds == "phi4"] >= 0, theirs["phi4"] >= 0)
    both = np.minimum(ours[:, kinds == "phi5+"], ours[:, kinds == "phi5-"])
    np.testing.assert_array_equal(both >= 0, theirs["phi5"] >= 0)
    assert all((value < 0).any() and (value > 0).any() for value in theirs.values())


def test_gradients_and_changes_against_differences():
    rng = np.random.default_rng(1)
    x = np.concatenate([rng.uniform(-300, 300, (20, 3, 3)), rng.uniform(-1, 1, (20, 3, 3))], axis=2)
    sun = rng.uniform(0, 7, 20)
    rows = AllowableRows(THREE)
    phi = rows(x, sun)
    for i in range(3):
        for k in range(6):
            step = np.zeros((3, 6))
            step[i, k] = 1e-5
            numeric = (rows(x + step, sun).h - rows(x - step, sun).h) / 2e-5
            sign = np.where(rows.first == i, 1.0, np.where(rows.second == i, -1.0, 0.0))
            np.testing.assert_allclose(phi.gradient[..., k] * sign, numeric, atol=1e-5)
    numeric = (rows(x, sun - N * 0.05).h - rows(x, sun + N * 0.05).h) / 0.1
    np.testing.assert_allclose(phi.change, numeric, atol=1e-5)


def test_a_flight_is_judged_from_where_it_begins():
    """Too near the chief now, and far enough after the period that is tried."""
    x = np.array([[0.0, -ONE.separation + 0.05, 0.0, 0.0, -0.2, 0.0]])
    Phi, _ = ONE.held(1.0)
    check = FlightCheck(Parking(ONE), 600.0, np.pi)
    chief = check.rows.among("chief_separation")
    assert (allowable(ONE, x @ Phi.T, np.pi)["phi1"] > 0).all()
    assert (check(0.0, x, np.zeros((1, 3)))[chief] <= -0.05).all()
    assert (check(0.0, x @ Phi.T)[chief] > 0).all()


@pytest.mark.parametrize("who", [0, 1])
def test_a_pair_on_parking_orbits_is_as_uncertain_as_both_together(who):
    check = FlightCheck(Parking(TWO), 600.0, np.pi)
    x = elliptical_nmt(N, np.array([150.0, 150.0]), np.array([3.7, 4.7]))
    outlook = fly_backup(check.law, x, check.steps, 0.02).outlook
    strays = outlook.strays.copy()
    strays[who] += 3.0
    pair = check.rows.among("deputy_separation")
    less = check.parked(0.0, outlook) - check.parked(0.0, replace(outlook, strays=strays))
    assert pair.any() and less[pair] == pytest.approx(3.0)


def test_kinds_left_out():
    assert "phi5+[0,1]" in AllowableRows(TWO).labels
    assert "phi5+[0,1]" not in AllowableRows(TWO, ("deputy_sun",)).labels
    with pytest.raises(ScenarioError, match="without"):
        AllowableRows(TWO, ("phi5",))


def test_bounds_between_samples_hold():
    rng = np.random.default_rng(5)
    rows, D = AllowableRows(TWO), 5.0
    for _ in range(30):
        x = np.hstack([rng.uniform(-60, 60, (2, 3)), rng.uniform(-1, 1, (2, 3))])
        u = rng.uniform(-1, 1, (2, 3))
        taus = np.linspace(0, D, 51)
        dense = np.stack([x @ P.T + u @ G.T for P, G in (TWO.held(float(tau)) for tau in taus)])
        value = rows(dense, TWO.sun_angle(taus, 1.0)).h
        ends = dense[[0, -1]]
        bound = rows.between(value[[0, -1]], ends, D, np.sqrt(3) / TWO.mass)
        assert (bound[0] <= value.min(axis=0) + 1e-12).all()


# ---- flights judged


@pytest.mark.parametrize("seed", range(2))
def test_margins_bound_a_dense_flight_of_two_revolutions(seed):
    law = Parking(TWO)
    check = FlightCheck(law, 600.0, sun_start=np.pi)
    x = formation(TWO, seed)
    x[:, 3:] = np.random.default_rng(seed).uniform(-0.2, 0.2, (2, 3))
    u = np.random.default_rng(seed).uniform(-1, 1, (2, 3))
    judged = check(100.0, x, u)
    P, G = TWO.held(0.5)
    t, least, thrust, state = 100.0, np.full(len(judged), np.inf), u, x
    worst = []
    for k in range(int(2 * 2 * np.pi / N / 0.5)):
        if k and k % 2 == 0:
            thrust = law(t, state)
        worst.append(state)
        state, t = state @ P.T + thrust @ G.T, t + 0.5
    states = np.stack(worst)
    sun = TWO.sun_angle(100.0 + 0.5 * np.arange(len(states)), np.pi)
    least = check.rows(states, sun).h.min(axis=0)
    assert np.isfinite(judged).all()
    assert (judged <= least + 1e-9).all()
    assert (least - judged)[~check.rows.is_speed].max() < 12.0  # m: a bound worth having
    assert (least - judged)[check.rows.is_speed].max() < 0.05


def test_flights_that_do_not_settle_are_not_proven():
    x = np.array([[300.0, 0, 0, 1, 1, 0]])
    assert not (FlightCheck(Parking(ONE), 3.0)(0.0, x) > -np.inf).any()
    assert not (FlightCheck(Coast(ONE), 600.0)(0.0, x) > -np.inf).any()
    on_orbit = elliptical_nmt(N, 100.0, 1.0)[None]
    on_orbit[:, 3] = N / 2 * on_orbit[:, 1]
    on_orbit[:, 4] = -2 * N * on_orbit[:, 0]
    assert np.isfinite(FlightCheck(Coast(ONE), 600.0)(0.0, on_orbit)).all()


def test_what_was_proven_stays_proven_along_its_flight():
    check, zero = FlightCheck(Coast(ONE, period=2.0)), np.zeros((1, 3))
    x = np.ones((1, 6))
    after = x @ check.law.motion[0].T

    def proves(t, x, good=False, known=True):
        return check.proves(SimpleNamespace(t=t, x=x, known=np.array([known])), zero, good)

    def begun():
        return proves(10.0, x, good=True)

    assert not proves(0.0, x)
    assert begun() and proves(12.0, after)
    assert begun() and not proves(14.0, after)
    assert begun() and not proves(12.0, after + 1e-3)
    assert begun() and not proves(12.0, after, known=False) and not proves(14.0, after)
    assert not proves(10.0, x, good=True, known=False)


# ---- the filter's conditions


def test_conditions_against_differences_of_the_backup_flight():
    """The rate of phi at the end of the flight while the state moves under some input."""
    f = ImplicitASIF(FlightCheck(Parking(TWO), sun_start=np.pi))
    rows, law = f.check.rows, f.law
    x = formation(TWO) + np.array([0, 0, 0, 0.1, -0.1, 0.05])
    flight = fly_backup(law, x, 80)
    count = len(flight.x)
    G, bound, value = f.conditions(50.0, x, flight)
    u = np.array([[0.3, -0.7, 0.2], [-0.4, 0.5, 0.9]])
    rate = np.einsum("smnj,nj->sm", G, u) - bound - f.rate * value

    def later(dt, k):
        """phi after k periods of backup, dt after the present under u."""
        P, Gm = TWO.held(dt)
        state = x @ P.T + u @ Gm.T
        for _ in range(k):
            state = state @ law.motion[0].T + law(0, state) @ law.motion[1].T
        return rows(state[None], TWO.sun_angle([50.0 + dt + k], np.pi)).h[0]

    chosen = np.unique(np.linspace(0, count - 1, min(count, 40)).round().astype(int))
    for row, k in enumerate(chosen):
        if row % 6 == 0:
            numeric = (later(1e-3, k) - later(-1e-3, k)) / 2e-3
            np.testing.assert_allclose(rate[row], numeric, rtol=1e-3, atol=1e-5)
    # The samples along the parking orbit continue where the flight ends.
    np.testing.assert_allclose(value[len(chosen)], value[len(chosen) - 1], atol=10.0)


@pytest.mark.parametrize(
    ("q", "without"),
    [(ONE, ()), pytest.param(THREE, ("deputy_sun",), marks=pytest.mark.slow)],
    ids=["one", "three"],
)
def test_an_aggressive_primary_is_held_in_the_allowable_set(q, without):
    f = ImplicitASIF(FlightCheck(Parking(q), sun_start=np.pi, without=without))
    primary, x = LQR(q), formation(q)
    Phi, Gamma = f.law.motion
    seen, least, states = set(), np.inf, []
    for k in range(90):
        d = f.filter(float(k), x, primary(k, x[None])[0])
        seen.add(d.status)
        assert d.fallback is None or "not proven" not in d.fallback
        states.append(x)
        x = x @ Phi.T + d.u @ Gamma.T
    values = allowable(q, np.stack(states), q.sun_angle(np.arange(90), np.pi))
    for name, value in values.items():
        if (name != "phi5" or not without) and value.size:
            least = min(least, value.min())
    assert least >= 0
    assert "filtered" in seen
    # It is no mere brake: the deputies went where they were sent, at the speed that is allowed.
    assert np.linalg.norm(x[0, :3]) < np.linalg.norm(formation(q)[0, :3]) - 8


def test_harmless_input_passes_unchanged():
    f = ImplicitASIF(FlightCheck(Parking(ONE), sun_start=np.pi))
    x = elliptical_nmt(N, 150.0, 4.9)[None]
    u = np.array([[0.01, -0.02, 0.01]])
    d = f.filter(0.0, x, u)
    assert d.status == "desired"
    assert d.fallback is None
    assert not d.intervened.any()
    np.testing.assert_array_equal(d.u, u)
    assert min(d.margins.values()) >= 0


def test_a_state_that_cannot_be_helped_is_recorded():
    d = ImplicitASIF(FlightCheck(Parking(ONE))).filter(0.0, np.zeros((1, 6)), np.ones((1, 3)))
    assert d.status == "backup"
    assert "not proven" in d.fallback
    assert np.isfinite(d.u).all()


def test_missing_input_is_backup_and_unknown_state_coasts():
    f = ImplicitASIF(FlightCheck(Parking(TWO), sun_start=np.pi, without=("deputy_sun",)))
    x = formation(TWO)
    x[:, 3:] = f.law.ellipses.nearest(x)[:, 3:]
    d = f.filter(0.0, x, None)
    assert "desired input" in d.fallback
    assert d.intervened.all()
    lost = np.array(x)
    lost[1] = np.nan
    d = f.filter(1.0, lost, np.full((2, 3), 0.01))
    assert "state not known: deputy 1" in d.fallback
    assert not d.u[1].any()
    assert np.isfinite(d.margins["phi2[0,1]"])  # from the last good state, propagated
    fresh = ImplicitASIF(FlightCheck(Parking(TWO), sun_start=np.pi))
    d = fresh.filter(0.0, lost, np.full((2, 3), 0.01))
    assert np.isnan(d.margins["phi2[0,1]"])
    assert np.isfinite(d.margins["phi1[0]"])
    assert fresh.filter(1.0, np.full((2, 6), np.inf), None).status == "coast"


def test_malformed_values_are_answered():
    malformed(ImplicitASIF(FlightCheck(Parking(TWO))))


@given(calls(2, 2))
@settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck))
def test_garbage(sequence):
    answers(ImplicitASIF(FlightCheck(PARKING_2, 60.0)), sequence)


PARKING_2 = Parking(TWO)


def test_odd_times_are_answered_and_told():
    q = TWO
    odd_times(ImplicitASIF(FlightCheck(Parking(q), sun_start=np.pi)), formation(q), np.zeros((2, 3)))
