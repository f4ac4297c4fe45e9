"""The explicit filter, call by call: what it answers to good input, and to bad."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from polaris.inspection.constraints.families import Families
from polaris.inspection.constraints.motion import SampledData
from polaris.inspection.filters.asif import ActiveSetFilter
from polaris.inspection.filters.explicit import Centralized, make_filter
from polaris.inspection.flights.sampling import InitialConditions
from polaris.inspection.inspection import Inspection
from polaris.model.errors import ScenarioError
from tests.polaris.inspection.garbage import malformed, odd_times

Q = Inspection()
SHARINGS = ("centralized", "coasting", "half", "consensus")


def active(q, sharing="centralized", strengthening="polaris", sampled=None, **options):
    return ActiveSetFilter(make_filter(Families(q, strengthening, sampled=sampled), sharing), **options)


@pytest.fixture(scope="module")
def drawn():
    x, sun = InitialConditions(Families(Q), seed=4).first(6)
    return x, sun


@pytest.mark.parametrize("sharing", SHARINGS)
def test_it_answers_as_the_batch_does(drawn, sharing):
    x, sun = drawn
    rng = np.random.default_rng(0)
    for k in range(6):
        asif = active(Q, sharing, sun_start=float(sun[k]))
        u = rng.uniform(-1, 1, (5, 3))
        decision = asif.filter(0.0, x[k], u)
        batch = asif.filtering.batch(x[k][None], sun[k : k + 1], u[None])
        np.testing.assert_array_equal(decision.u, batch.u[0])
        assert decision.status in ("desired", "filtered") and decision.fallback is None
        np.testing.assert_array_equal(decision.intervened, (decision.u != u).any(axis=1))
        assert bool(decision.active) == bool(decision.intervened.any())
        assert len(decision.margins) == 80 and min(decision.margins.values()) >= 0


def test_active_constraints_are_those_that_bind():
    """One deputy that wants to leave: only the keep-in zone can hold it."""
    q = Inspection(deputies=1)
    asif = active(q, sun_start=np.pi)
    x = np.array([[0.0, 0.0, 999.0, 0.0, 0.0, 0.2]])
    decision = asif.filter(0.0, x, [[0.0, 0.0, 0.5]])
    assert decision.intervened[0] and decision.u[0, 2] < 0.5
    assert decision.active == ("h6[0]",)
    assert decision.margins["h6[0]"] > 0


def test_the_sun_turns_with_time(drawn):
    x, _ = drawn
    asif = active(Q, sun_start=1.0)
    later = asif.filter(500.0, x[0], np.zeros((5, 3))).margins["h4[0]"]
    other = active(Q, sun_start=1.0 - 500 * Q.mean_motion).filter(0.0, x[0], np.zeros((5, 3)))
    assert later == other.margins["h4[0]"]


def test_sampled_rows_are_summed_up_by_name(drawn):
    x, sun = drawn
    asif = active(Q, sampled=SampledData(1.0), sun_start=float(sun[0]))
    decision = asif.filter(0.0, x[0], np.zeros((5, 3)))
    assert len(decision.margins) == 80
    rows = asif.families(x[0][None], sun[:1]).h[0]
    labels = np.array(asif.families.labels)
    assert decision.margins["h8[1,3]"] == rows[labels == "h8[1,3]"].min()


def test_no_desired_input_means_the_backup_filtered(drawn):
    x, sun = drawn
    push = np.tile([0.0, 0.0, 0.7], (5, 1))
    asif = active(Q, backup=lambda t, x: push, sun_start=float(sun[0]))
    for missing in (None, np.full((5, 3), np.nan), np.full((5, 3), np.inf)):
        decision = asif.filter(0.0, x[0], missing)
        assert decision.status == "backup" and decision.intervened.all()
        assert "desired input" in decision.fallback
        expected = Centralized(asif.families).batch(x[0][None], sun[:1], push[None]).u[0]
        np.testing.assert_allclose(decision.u, expected, atol=1e-12)
    some = push.copy()
    some[2, 1] = np.nan
    assert "deputy 2" in asif.filter(0.0, x[0], some).fallback


def test_backup_that_fails_is_no_thrust(drawn):
    x, sun = drawn
    asif = active(Q, backup=lambda t, x: np.full((5, 3), np.nan), sun_start=float(sun[0]))
    reference = active(Q, sun_start=float(sun[0]))
    np.testing.assert_array_equal(
        asif.filter(0.0, x[0], None).u, reference.filter(0.0, x[0], np.zeros((5, 3))).u
    )


@pytest.mark.parametrize("answer", [0.2, np.full(3, 0.2), np.full((4, 3), 0.2), np.full((5, 3), np.inf)])
def test_backup_with_a_wrong_answer_is_no_thrust_and_recorded(drawn, answer):
    x, sun = drawn
    asif = active(Q, backup=lambda t, x: answer, sun_start=float(sun[0]))
    reference = active(Q, sun_start=float(sun[0]))
    decision = asif.filter(0.0, x[0], None)
    np.testing.assert_array_equal(decision.u, reference.filter(0.0, x[0], np.zeros((5, 3))).u)
    assert "the backup controller failed" in decision.fallback


def test_an_unknown_state_is_predicted_then_given_up(drawn):
    x, sun = drawn
    asif = active(Q, sun_start=float(sun[0]))
    u = asif.filter(0.0, x[0], np.full((5, 3), 0.3)).u
    Phi, Gamma = Q.discretize(1.0)
    moved = x[0] @ Phi.T + u @ Gamma.T
    lost = moved.copy()
    lost[3, 2] = np.nan
    decision = asif.filter(1.0, lost, np.zeros((5, 3)))
    assert "deputy 3" in decision.fallback
    honest = active(Q, sun_start=float(sun[0])).filter(1.0, moved, np.zeros((5, 3)))
    np.testing.assert_allclose(decision.u, honest.u, atol=1e-9)
    gone = asif.filter(1000.0, np.full((5, 6), np.nan), np.ones((5, 3)))
    assert gone.status == "coast" and not gone.u.any() and gone.intervened.all()
    never = active(Q).filter(0.0, np.full((5, 6), np.inf), np.ones((5, 3)))
    assert never.status == "coast" and not never.u.any()


def test_no_solution_is_recorded_and_never_the_desired_input():
    """Two deputies overlap, and both want to go on."""
    q = Inspection(deputies=2)
    x = np.zeros((2, 6))
    x[:, 1] = [300.0, 304.0]
    x[:, 4] = [0.5, -0.5]
    desired = np.array([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])
    for sharing in SHARINGS:
        decision = active(q, sharing, sun_start=np.pi / 2 + 0.1).filter(0.0, x, desired)
        assert decision.status == "short" and "least violation" in decision.fallback
        assert decision.intervened.all()
        assert decision.u[0, 1] < 0 < decision.u[1, 1], "they part"


def test_malformed_values_are_answered():
    malformed(active(Inspection(deputies=2)))


def test_unknown_sharing_is_refused():
    with pytest.raises(ScenarioError, match="sharing"):
        active(Q, "shared")


WILD = st.sampled_from([0.0, 1.0, -3.0, 1e3, 1e9, 1e300, -1e300, np.inf, -np.inf, np.nan, 1e-320])


@settings(max_examples=60, deadline=None)
@given(
    sharing=st.sampled_from(SHARINGS),
    x=st.lists(WILD, min_size=12, max_size=12),
    u=st.one_of(st.none(), st.lists(WILD, min_size=6, max_size=6)),
    sampled=st.booleans(),
)
def test_garbage_never_gets_through(sharing, x, u, sampled):
    q = Inspection(deputies=2)
    asif = active(q, sharing, sampled=SampledData(1.0) if sampled else None)
    states = np.array(x).reshape(2, 6)
    desired = None if u is None else np.array(u).reshape(2, 3)
    with np.errstate(all="ignore"):
        decision = asif.filter(0.0, states, desired)
    assert np.isfinite(decision.u).all() and (np.abs(decision.u) <= q.thrust_max).all()
    if decision.status == "desired":
        np.testing.assert_array_equal(decision.u, desired)
    elif decision.status in ("short", "coast", "backup"):
        assert decision.fallback


@pytest.mark.parametrize("deputies", [1, 2, 20, 50])
def test_any_number_of_deputies(deputies):
    q = Inspection(deputies=deputies)
    rng = np.random.default_rng(1)
    x = np.zeros((deputies, 6))
    x[:, :3] = rng.uniform(-500, 500, (deputies, 3))
    decision = active(q, "coasting").filter(0.0, x, rng.uniform(-1, 1, (deputies, 3)))
    assert decision.u.shape == (deputies, 3) and np.isfinite(decision.u).all()
    pairs = deputies * (deputies - 1) // 2
    assert len(decision.margins) == 8 * deputies + 4 * pairs


def test_an_unknown_deputy_never_gets_its_desired_input(drawn):
    """Not even while its state can be predicted: what is wanted of a state nobody knows is worth nothing."""
    x, sun = drawn
    for sharing in SHARINGS:
        asif = active(Q, sharing, sun_start=float(sun[0]))
        asif.filter(0.0, x[0], np.zeros((5, 3)))
        lost = x[0].copy()
        lost[[1, 4]] = np.nan
        decision = asif.filter(1.0, lost, np.full((5, 3), 0.9))
        assert decision.status == "backup" and decision.intervened[[1, 4]].all()
        assert (decision.u[[1, 4]] != 0.9).any(axis=1).all()


def test_sampled_conditions_held_for_too_long_are_recorded(drawn):
    x, sun = drawn
    asif = active(Q, sampled=SampledData(1.0), sun_start=float(sun[0]))
    zero = np.zeros((5, 3))
    assert asif.filter(0.0, x[0], zero).fallback is None
    assert asif.filter(1.0, x[0], zero).fallback is None
    assert "25 s" in asif.filter(26.0, x[0], zero).fallback
    asif.reset()
    assert asif.filter(90.0, x[0], zero).fallback is None


def test_nearly_coincident_deputies_get_finite_thrust():
    """So near that the numbers of the program span fifteen orders of magnitude."""
    q = Inspection(deputies=3)
    first = np.array([-18.80678, 1643.32782, -2168.62645, -0.52032, -0.82569, -0.67765])
    apart = np.array([4.66e-5, -2.412e-5, -1.22e-4, 0.19349, -0.15129, -0.02066])
    third = np.array([2016.3176, 1371.41478, 1732.06817, 0.69687, 0.21865, -0.02129])
    rng = np.random.default_rng(0)
    for _ in range(20):
        x = np.stack([first, first + rng.uniform(0.5, 2) * apart, third])
        for sharing in SHARINGS:
            decision = active(q, sharing, "afrl").filter(0.0, x, rng.uniform(-1, 1, (3, 3)))
            assert np.isfinite(decision.u).all() and (np.abs(decision.u) <= q.thrust_max).all()
            assert decision.status in ("short", "backup") and decision.fallback


@pytest.mark.parametrize("sharing", SHARINGS)
def test_a_program_that_fails_is_answered_by_the_backup(drawn, sharing, monkeypatch):
    x, sun = drawn
    monkeypatch.setattr(
        "polaris.rta.projection.daqp.solve", lambda H, f, *rest, **how: (np.full(len(f), np.nan), 0, -9, {})
    )
    monkeypatch.setattr("polaris.rta.priorities.lowest", lambda *_, **how: None)
    push = np.tile([0.1, -0.2, 0.3], (5, 1))
    asif = active(Q, sharing, backup=lambda t, z: push, sun_start=float(sun[0]))
    x = x[0].copy()
    x[1, :3] = x[0, :3] + [8.0, 0.0, 0.0]  # too near: no row alone decides
    x[0, 3:], x[1, 3:] = [0.5, 0.0, 0.0], [-0.5, 0.0, 0.0]
    decision = asif.filter(0.0, x, np.full((5, 3), 0.9))
    assert decision.status == "backup" and "failed" in decision.fallback
    np.testing.assert_array_equal(decision.u[:2], push[:2])
    assert decision.intervened[:2].all()


def test_a_backup_that_raises_is_recorded(drawn):
    x, sun = drawn

    def broken(t, z):
        raise RuntimeError("no")

    decision = active(Q, backup=broken, sun_start=float(sun[0])).filter(0.0, x[0], None)
    assert "the backup controller failed: raised RuntimeError" in decision.fallback
    assert np.isfinite(decision.u).all()
    shape = active(Q, backup=lambda t, z: np.zeros((2, 2)), sun_start=float(sun[0]))
    assert "the backup controller failed" in shape.filter(0.0, x[0], None).fallback


def test_leaving_out_everything_is_refused():
    from polaris.inspection.constraints.strengthening import FAMILIES

    with pytest.raises(ScenarioError, match="must leave a constraint"):
        Families(Q, without=FAMILIES)
    single = [name for name in FAMILIES if not name.startswith("deputy")]
    with pytest.raises(ScenarioError, match="must leave a constraint"):
        Families(Inspection(deputies=1), without=single)


def test_odd_times_are_answered_and_told(drawn):
    x, sun = drawn
    for sampled in (None, SampledData(1.0)):
        odd_times(active(Q, sampled=sampled, sun_start=float(sun[0])), x[0], np.zeros((5, 3)))


@pytest.mark.parametrize("then", [9.0, np.nextafter(10.0, 0.0), 71.0, -1e6])
def test_no_state_is_propagated_across_a_break_of_the_clock(drawn, then):
    x, sun = drawn
    asif = active(Q, sun_start=float(sun[0]))
    asif.filter(10.0, x[0], np.zeros((5, 3)))
    decision = asif.filter(then, np.full((5, 6), np.nan), np.zeros((5, 3)))
    assert decision.status == "coast" and "the time" in decision.fallback
    known = active(Q, sun_start=float(sun[0]))
    known.filter(10.0, x[0], np.zeros((5, 3)))
    again = known.filter(then, x[0], np.full((5, 3), 0.1))
    fresh = active(Q, sun_start=float(sun[0])).filter(then, x[0], np.full((5, 3), 0.1))
    np.testing.assert_array_equal(again.u, fresh.u)


@pytest.mark.parametrize("sharing", SHARINGS)
def test_what_is_missed_is_recorded(sharing):
    """By name and in newtons, as the rows at the answer say; nothing is missed where all can be met."""
    q = Inspection(deputies=2)
    x = np.zeros((2, 6))
    x[:, 1] = [300.0, 304.0]
    x[:, 4] = [0.5, -0.5]
    asif = active(q, sharing, sun_start=np.pi / 2 + 0.1)
    decision = asif.filter(0.0, x, np.zeros((2, 3)))
    rows = asif.families(x[None], q.sun_angle([0.0], asif.sun_start))
    expected = {}
    for k, label in enumerate(asif.families.labels):
        i, j = asif.families.first[k], asif.families.second[k]
        push = decision.u[i] - (decision.u[j] if j >= 0 else 0.0)
        gap = rows.bound[0, k] - rows.G[0, k] @ push
        if gap > 0:
            gap /= np.linalg.norm(rows.G[0, k]) * (np.sqrt(2) if j >= 0 else 1)
            expected |= {label: max(gap, expected.get(label, 0.0))} if gap > 1e-7 else {}
    assert decision.status == "short" and decision.missed == pytest.approx(expected) and expected
    assert all(name in decision.fallback for name in sorted(expected, key=expected.get)[-3:])
    fine = active(q, sharing, sun_start=np.pi / 2 + 0.1)
    x[1, :3] = [60.0, 340.0, 200.0]
    x[:, 3:] = 0.0
    assert fine.filter(0.0, x, np.zeros((2, 3))).missed == {}
