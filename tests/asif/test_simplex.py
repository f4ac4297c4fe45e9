"""Simplex filters: when they switch, whom, when they hand back, and what they say about it."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings

from polaris.inspection.backup.parking import Parking
from polaris.inspection.constraints.allowable_set import allowable
from polaris.inspection.constraints.families import Families
from polaris.inspection.filters.explicit import Centralized
from polaris.inspection.filters.flight_check import FlightCheck
from polaris.inspection.filters.simplex import ExplicitSimplex, Guarded, ImplicitSimplex
from polaris.inspection.flights.primary import LQR, Phases
from polaris.inspection.inspection import Inspection
from polaris.model.errors import ScenarioError
from polaris.model.hill import elliptical_nmt

from .garbage import answers, calls, malformed, odd_times
from .test_implicit import formation

ONE, TWO, THREE = (Inspection(deputies=k) for k in (1, 2, 3))
PARKING_2, FAMILIES_2 = Parking(TWO), Families(TWO)
GENTLE = 2e4  # velocity weight of a primary that brakes


def both(q):
    without = ("deputy_sun",) if q.deputies > 1 else ()
    yield ExplicitSimplex(Families(q, without=without), sun_start=np.pi)
    yield ImplicitSimplex(FlightCheck(Parking(q), sun_start=np.pi, without=("deputy_sun",)))


def fly(f, primary, x, count):
    Phi, Gamma = f.inspection.held(1.0)
    states, decisions = [x], []
    for k in range(count):
        d = f.filter(float(k), x, primary(float(k), x[None])[0])
        x = x @ Phi.T + d.u @ Gamma.T
        decisions.append(d)
        states.append(x)
    return np.stack(states), decisions


@pytest.mark.parametrize("which", [0, 1], ids=["explicit", "implicit"])
@pytest.mark.parametrize("q", [ONE, THREE], ids=["one", "three"])
def test_constraints_hold_and_switching_is_latched(q, which):
    f = list(both(q))[which]
    primary = Phases([0, 60], [LQR(q, velocity_weight=GENTLE), LQR(q, 300, velocity_weight=GENTLE)])
    states, decisions = fly(f, primary, formation(q), 120)
    for name, value in allowable(q, states, q.sun_angle(np.arange(121), np.pi)).items():
        if name != "phi5" and value.size:
            assert value.min() >= 0, name
    assert all(d.fallback is None for d in decisions)
    assert {d.status for d in decisions} >= {"backup"}
    # The log, replayed: per deputy alternating, at least the dwell time on backup.
    for i in range(q.deputies):
        own = [entry for entry in f.log if entry.deputy == i]
        assert own
        assert [entry.to for entry in own] == ["backup", "desired"] * (len(own) // 2) + ["backup"] * (
            len(own) % 2
        )
        for a, b in zip(own[::2], own[1::2], strict=False):
            assert b.t - a.t >= 30
            assert "would be" in a.reason
            assert "release" in b.reason
    assert any(entry.to == "desired" for entry in f.log)


@pytest.mark.parametrize("which", [0, 1], ids=["explicit", "implicit"])
def test_input_is_either_the_desired_or_the_backups(which):
    f = list(both(ONE))[which]
    primary = LQR(ONE)
    Phi, Gamma = ONE.held(1.0)
    x = formation(ONE)
    for k in range(60):
        wanted = primary(k, x[None])[0]
        backup = f.backup(float(k), x)
        d = f.filter(float(k), x, wanted)
        if f.latched[0]:
            np.testing.assert_allclose(d.u, backup, atol=1e-12)
            assert d.status == "backup"
            assert d.active
        else:
            np.testing.assert_array_equal(d.u, np.clip(wanted, -1, 1))
        x = x @ Phi.T + d.u @ Gamma.T
    assert f.latched[0]


@pytest.mark.parametrize("which", [0, 1], ids=["explicit", "implicit"])
def test_hand_back_waits_for_the_release_and_the_dwell_time(which):
    f = list(both(ONE))[which]
    x = elliptical_nmt(ONE.mean_motion, 150.0, 4.9)[None]
    f.latched[0] = True
    Phi, _ = ONE.held(1.0)
    t = 0.0
    for _ in range(25):
        f.filter(t, x, np.zeros((1, 3)))
        x, t = x @ Phi.T, t + 1
    assert f.latched[0]
    f.filter(t, x, None)  # an interruption: the clock starts again
    x, t = x @ Phi.T, t + 1
    begin = t
    while f.latched[0]:
        assert t < begin + 60
        f.filter(t, x, np.zeros((1, 3)))
        x, t = x @ Phi.T, t + 1
    assert f.log[-1].to == "desired"
    assert f.log[-1].t == begin + 30


@pytest.mark.parametrize("which", [0, 1], ids=["explicit", "implicit"])
def test_the_dwell_begins_anew_when_a_release_is_missed(which, monkeypatch):
    f = list(both(ONE))[which]
    x = elliptical_nmt(ONE.mean_motion, 150.0, 4.9)[None]
    f.latched[0] = True
    for k in range(60):
        # kept, but less than is wanted for handing back
        value = np.full(len(f.rows.labels), f._release) + (-0.01 if k == 20 else 1.0)
        monkeypatch.setattr(f, "_try", lambda t, x, u, value=value: value)
        f.filter(float(k), x, np.zeros((1, 3)))
        assert f.latched[0] == (k < 21 + f.dwell), k


@pytest.mark.parametrize("which", [0, 1], ids=["explicit", "implicit"])
def test_a_constraint_of_which_nothing_can_be_told_is_not_kept(which, monkeypatch):
    f = list(both(ONE))[which]
    x = elliptical_nmt(ONE.mean_motion, 150.0, 4.9)[None]
    monkeypatch.setattr(f, "_try", lambda t, x, u: np.full(len(f.rows.labels), np.nan))
    for k in range(40):  # longer than the dwell
        decision = f.filter(float(k), x, np.zeros((1, 3)))
        assert f.latched.all() and decision.status == "backup" and decision.unproven


def test_only_those_concerned_are_switched():
    x = elliptical_nmt(THREE.mean_motion, np.full(3, 150.0), np.array([3.7, 4.7, 5.7]))
    u = np.zeros((3, 3))
    u[1] = [1.0, 1.0, 1.0]
    clear_pairs = ("deputy_sun", "deputy_passive", "deputy_separation")
    explicit = ExplicitSimplex(Families(THREE, without=clear_pairs), sun_start=np.pi)
    for f in (explicit, list(both(THREE))[1]):
        state = np.array(x)
        state[1, 3:] *= (0.2 + 2 * THREE.mean_motion * np.linalg.norm(x[1, :3]) - 0.05) / np.linalg.norm(
            x[1, 3:]
        )
        f.filter(0.0, state, u)
        assert f.latched.tolist() == [False, True, False], type(f).__name__
        assert f.log[0].deputy == 1


def test_implicit_stops_earlier_than_a_look_at_the_next_state_would():
    """The state after the period is allowable, and yet nothing can keep it so."""
    x = np.array([[0.0, -60.0, 0.0, 0.0, 0.3, 0.0]])
    explicit_phi = allowable(ONE, x @ ONE.held(1.0)[0].T, np.pi)
    assert min(value.min() for value in explicit_phi.values() if value.size) > 0
    f = ImplicitSimplex(FlightCheck(Parking(ONE), sun_start=np.pi))
    for y in np.linspace(-60, -12, 200):
        x[0, 1] = y
        f = ImplicitSimplex(FlightCheck(Parking(ONE), sun_start=np.pi))
        f.filter(0.0, x, np.zeros((1, 3)))
        if f.latched[0]:
            break
    assert f.latched[0]
    assert np.linalg.norm(x[0, :3]) > ONE.separation + 0.3


def test_guarded_backup_answers_within_limits_also_where_the_program_fails():
    guarded = Guarded(Centralized(Families(ONE)), Parking(ONE))
    for x in (np.zeros((1, 6)), np.array([[9.0, 0, 0, -5, 0, 0]]), np.array([[1e6, 0, 0, 1e3, 0, 0]])):
        u = guarded(0.0, x)
        assert np.isfinite(u).all()
        assert (np.abs(u) <= 1).all()


def test_a_hopeless_state_is_recorded():
    for f in both(ONE):
        d = f.filter(0.0, np.zeros((1, 6)), np.ones((1, 3)))
        assert d.status == "backup"
        assert "does not keep" in d.fallback


def test_missing_input_is_backup_without_a_latch():
    for f in both(ONE):
        x = elliptical_nmt(ONE.mean_motion, 150.0, 4.9)[None]
        d = f.filter(0.0, x, None)
        assert d.status == "backup"
        assert "desired input" in d.fallback
        assert not f.latched.any()
        assert f.filter(1.0, x, np.zeros((1, 3))).status == "desired"


def test_a_backup_that_fails_is_answered_and_told():
    def raises(t, x):
        raise RuntimeError("no")

    for broken, word in (
        (raises, "RuntimeError"),
        (lambda t, x: np.zeros(3), "shape"),
        (lambda t, x: x[:, :3] * np.nan, "finite"),
    ):
        d = ExplicitSimplex(FAMILIES_2, broken).filter(0.0, formation(TWO), None)
        assert "the backup controller failed" in d.fallback and word in d.fallback
        assert d.status == "backup" and not d.u.any()


def test_malformed_values_are_answered():
    for f in both(TWO):
        malformed(f)


def test_release_below_the_margin_is_refused():
    with pytest.raises(ScenarioError, match="release"):
        ExplicitSimplex(FAMILIES_2, margin=0.1, release=0.05)
    with pytest.raises(ScenarioError, match="release_distance"):
        ImplicitSimplex(FlightCheck(PARKING_2), release_distance=-1.0)
    with pytest.raises(ScenarioError, match="dwell"):
        ImplicitSimplex(FlightCheck(PARKING_2), dwell=-1.0)


@given(calls(2, 3))
@settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck))
def test_garbage_explicit(sequence):
    answers(ExplicitSimplex(FAMILIES_2, PARKING_2), sequence)


@given(calls(2, 2))
@settings(max_examples=10, deadline=None, suppress_health_check=list(HealthCheck))
def test_garbage_implicit(sequence):
    answers(ImplicitSimplex(FlightCheck(PARKING_2, 60.0)), sequence)


@given(calls(2, 2))
@settings(max_examples=10, deadline=None, suppress_health_check=list(HealthCheck))
def test_garbage_guarded(sequence):
    answers(ExplicitSimplex(FAMILIES_2, GUARDED_2), sequence)


GUARDED_2 = Guarded(Centralized(FAMILIES_2), PARKING_2)


def test_odd_times_are_answered_and_told():
    for f in both(TWO):
        odd_times(f, formation(TWO), np.zeros((2, 3)))


def test_a_jump_of_the_clock_is_no_time_in_which_all_was_well():
    """Thirty seconds without trouble hand back; two calls thirty seconds apart show nothing of the kind."""
    x = formation(TWO)
    for f in both(TWO):
        f.latched[:] = True
        for t in (0.0, 1.0, 2.0, 40.0, 41.0, 10.0, np.nan, 12.0):
            f.filter(t, x, np.zeros((2, 3)))
            assert f.latched.all(), t
        for t in range(
            13, 11 + int(f.dwell)
        ):  # the time that is none stands for 11 s, where the count begins
            f.filter(float(t), x, np.zeros((2, 3)))
            assert f.latched.all(), t
        f.filter(11.0 + f.dwell, x, np.zeros((2, 3)))
        assert not f.latched.any()
