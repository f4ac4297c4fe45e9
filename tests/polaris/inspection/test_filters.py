"""The filters at random states: exact where nothing is wrong, optimal elsewhere, never silent."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from polaris.inspection.constraints.families import Families
from polaris.inspection.constraints.motion import SampledData
from polaris.inspection.filters.asif import ActiveSetFilter
from polaris.inspection.filters.explicit import Centralized, Decentralized, make_filter
from polaris.inspection.flights.sampling import InitialConditions
from polaris.inspection.inspection import Inspection
from polaris.rta.projection import DESIRED, SHORT
from tests.polaris.inspection.garbage import answers, calls, malformed, odd_times
from tests.polaris.inspection.test_priorities import CLOSE, residuals

N = 4
FOUR = Inspection(deputies=N)
FAMILIES = {
    "continuous": Families(FOUR),
    "sampled": Families(FOUR, sampled=SampledData(1.0)),
    "without": Families(FOUR, without=("deputy_sun", "passive")),
}


def situation(seed, R=12, spread=(20.0, 600.0)):
    """Deputies near each other and their boundaries, some of them beyond; desired inputs of all sizes."""
    rng = np.random.default_rng(seed)
    size = np.exp(rng.uniform(*np.log(spread), (R, 1, 1)))
    x = rng.uniform(-1, 1, (R, N, 6))
    x[..., :3] *= size
    x[..., 3:] *= 0.2 + FOUR.nu_1 * size * 0.5
    return x, rng.uniform(-np.pi, np.pi, R), rng.standard_normal((R, N, 3)) * 10 ** rng.uniform(-2, 1)


def within(desired):
    """Clip inputs to the thrust limits: the nearest to the result is looked for."""
    return np.clip(desired, -FOUR.thrust_max, FOUR.thrust_max)


def wide_rows(families, G):
    """Rows on all inputs together, written out."""
    M = np.arange(len(families.first))
    wide, pair = np.zeros((len(M), N, 3)), families.second >= 0
    wide[M, families.first] = G
    wide[M[pair], families.second[pair]] = -G[pair]
    return wide.reshape(len(M), -1)


def feasible(wide, bound):
    """Can all rows, scaled to length 1, be met? By a linear program for the least shortage."""
    length, size, limit = np.linalg.norm(wide, axis=1), wide.shape[1], FOUR.thrust_max
    if (bound[length == 0] > 0).any() or (bound == np.inf).any():
        return False
    bounding = (length > 0) & (bound > -np.inf)
    rows = np.c_[wide[bounding] / length[bounding, None], np.ones(bounding.sum())]
    limits = [(-limit, limit)] * size + [(-1, None)]
    answer = linprog(np.r_[np.zeros(size), 1.0], -rows, -bound[bounding] / length[bounding], bounds=limits)
    return answer.status == 0 and answer.fun <= -1e-9


def check_projection(rows, bound, desired, u, solved):
    """The nearest input that meets all rows, or there is none."""
    if not solved:
        assert not feasible(rows, bound)
        return
    finite = bound > -np.inf
    primal, stationarity = residuals(rows[finite], bound[finite], within(desired), FOUR.thrust_max, u)
    assert primal < CLOSE and stationarity < CLOSE


@pytest.mark.parametrize("name", list(FAMILIES))
@given(seed=st.integers(0, 10**6))
@settings(max_examples=12)
def test_centralized_is_the_projection(name, seed):
    families = FAMILIES[name]
    x, sun, desired = situation(seed)
    for R in (len(x), 1):
        answer = Centralized(families).batch(x[:R], sun[:R], desired[:R])
        assert np.isfinite(answer.u).all() and np.abs(answer.u).max() <= FOUR.thrust_max
        for r in range(R):
            wide, bound = wide_rows(families, answer.rows.G[r]), answer.rows.bound[r]
            target = desired[r].ravel()
            unchanged = (wide @ target >= bound + 1e-12).all() and np.abs(target).max() <= FOUR.thrust_max
            if unchanged:
                assert (answer.u[r] == desired[r]).all() and (answer.status[r] == DESIRED).all()
            solved = (answer.status[r] < SHORT).all()
            check_projection(wide, bound, target, answer.u[r].ravel(), solved)
            changed = (answer.u[r] != desired[r]).any(axis=1)
            assert (changed == (answer.status[r] != DESIRED) if solved else answer.status[r] == SHORT).all()


@pytest.mark.parametrize("name", list(FAMILIES))
@given(seed=st.integers(0, 10**6))
@settings(max_examples=8)
def test_coasting_is_the_projection_of_each_deputy(name, seed):
    families = FAMILIES[name]
    x, sun, desired = situation(seed)
    for R in (len(x), 1):
        answer = Decentralized(families).batch(x[:R], sun[:R], desired[:R])
        assert np.isfinite(answer.u).all() and np.abs(answer.u).max() <= FOUR.thrust_max
        for r in range(R):
            for i in range(N):
                involved = (families.first == i) | (families.second == i)
                sign = np.where(families.second[involved] == i, -1.0, 1.0)
                rows, bound = answer.rows.G[r, involved] * sign[:, None], answer.rows.bound[r, involved]
                solved = answer.status[r, i] < SHORT
                check_projection(rows, bound, desired[r, i], answer.u[r, i], solved)


@pytest.mark.parametrize("sharing", ["half", "consensus"])
@pytest.mark.parametrize("name", list(FAMILIES))
def test_shares_add_up_to_the_whole_condition(sharing, name):
    """A pair's condition holds if both deputies meet their shares, whatever was desired."""
    families, count = FAMILIES[name], 0
    pair = families.second >= 0
    first, second = families.first, np.where(pair, families.second, families.first)
    for seed in range(5):
        x, sun, desired = situation(seed, spread=(100.0, 600.0))
        answer = Decentralized(families, sharing).batch(x, sun, desired)
        solved = (answer.status[:, first] < SHORT) & (answer.status[:, second] < SHORT)
        relative = answer.u[:, first] - np.where(pair[:, None], answer.u[:, second], 0.0)
        slack = np.einsum("rmv,rmv->rm", answer.rows.G, relative) - answer.rows.bound
        assert slack[solved].min(initial=np.inf) >= -1e-9
        count += (answer.status < SHORT).all(axis=1).sum()
    assert count > 5


@pytest.mark.parametrize("name", list(FAMILIES))
@given(seed=st.integers(0, 10**6))
@settings(max_examples=12)
def test_consensus_can_be_met_whenever_the_centralized_program_can(name, seed):
    families = FAMILIES[name]
    x, sun, desired = situation(seed, spread=(10.0, 400.0))
    rows = families(x, sun)  # those that hold for every thrust: nobody knows the others'
    status = Centralized(families).project(rows, within(desired))[1]
    agreed = Decentralized(families, "consensus").batch(x, sun, desired)
    for r in range(len(x)):
        if (agreed.status[r] >= SHORT).any():
            # Either no program has a solution, or by less than rounding.
            assert (status[r] == SHORT).all() or not feasible(wide_rows(families, rows.G[r]), rows.bound[r])
        else:
            assert (status[r] < SHORT).all()


def test_curvature_by_the_thrust_chosen_solves_what_the_worst_thrust_cannot():
    """Drawn near and beyond boundaries: the answers keep every barrier that held, between samples as well."""
    families, exact = Families(FOUR, "linear", sampled=SampledData(2.0)), Families(FOUR, "linear", exact=True)
    solved = tried = 0
    for seed in range(25):
        x, sun, desired = situation(seed, spread=(60.0, 500.0))
        status = Centralized(families).project(families(x, sun), within(desired))[1]
        inside = (exact(x, sun).h >= 0).all(axis=1)
        answer = Centralized(families).batch(x, sun, desired)
        short = np.flatnonzero((status >= SHORT).any(axis=1) & inside)
        tried += len(short)
        for r in short[(answer.status[short] < SHORT).all(axis=1)]:
            solved += 1
            for part in np.linspace(0.1, 2.0, 20):
                Phi, Gamma = FOUR.discretize(part)
                after = x[r] @ Phi.T + answer.u[r] @ Gamma.T
                assert exact(after[None], FOUR.sun_angle([part], sun[r])).h.min() >= -1e-9
    assert tried >= 5 and solved >= tried / 3


Q = Inspection()
ALL = ("centralized", "coasting", "half", "consensus")


def active(q, sharing="centralized", strengthening="polaris", sampled=None, **options):
    return ActiveSetFilter(make_filter(Families(q, strengthening, sampled=sampled), sharing), **options)


@pytest.fixture(scope="module")
def drawn():
    x, sun = InitialConditions(Families(Q), seed=4).first(6)
    return x, sun


@pytest.mark.parametrize("sharing", ALL)
def test_it_answers_as_the_batch_does(drawn, sharing):
    x, sun = drawn
    rng = np.random.default_rng(0)
    for k in range(6):
        asif = active(Q, sharing, sun_start=float(sun[k]))
        u = rng.uniform(-1, 1, (5, 3))
        decision = asif.filter(0.0, x[k], u)
        later = asif.filter(500.0, x[k], u).margins["h4[0]"]
        start = active(Q, sharing, sun_start=float(sun[k]) - 500 * Q.mean_motion)
        assert later == start.filter(0.0, x[k], u).margins["h4[0]"]  # the sun turns
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
    assert decision.intervened[0] and decision.u[0, 2] < 0.5 and decision.active == ("h6[0]",)
    assert decision.margins["h6[0]"] > 0


def test_sampled_rows_are_summed_up_by_name(drawn):
    x, sun = drawn
    asif = active(Q, sampled=SampledData(1.0), sun_start=float(sun[0]))
    decision, labels = asif.filter(0.0, x[0], np.zeros((5, 3))), np.array(asif.families.labels)
    rows = asif.families(x[0][None], sun[:1]).h[0]
    assert len(decision.margins) == 80
    assert all(value == rows[labels == name].min() for name, value in decision.margins.items())


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
    partial = push.copy()
    partial[2, 1] = np.nan
    assert "deputy 2" in asif.filter(0.0, x[0], partial).fallback


def broken(t, x):
    raise RuntimeError("no")


@pytest.mark.parametrize("answer", [0.2, np.full((4, 3), 0.2), np.full((5, 3), np.nan), broken])
def test_backup_with_a_wrong_answer_is_no_thrust_and_recorded(drawn, answer):
    x, sun = drawn
    backup = answer if callable(answer) else lambda t, x: answer
    decision = active(Q, backup=backup, sun_start=float(sun[0])).filter(0.0, x[0], None)
    expected = active(Q, sun_start=float(sun[0])).filter(0.0, x[0], np.zeros((5, 3)))
    np.testing.assert_array_equal(decision.u, expected.u)
    assert "the backup controller failed" in decision.fallback
    assert callable(answer) == ("raised RuntimeError" in decision.fallback)


def test_an_unknown_state_is_predicted_then_given_up(drawn):
    x, sun = drawn
    asif = active(Q, sun_start=float(sun[0]))
    u = asif.filter(0.0, x[0], np.full((5, 3), 0.3)).u
    Phi, Gamma = Q.discretize(1.0)
    states = x[0] @ Phi.T + u @ Gamma.T
    partial = states.copy()
    partial[3, 2] = np.nan
    decision = asif.filter(1.0, partial, np.zeros((5, 3)))
    assert "deputy 3" in decision.fallback
    honest = active(Q, sun_start=float(sun[0])).filter(1.0, states, np.zeros((5, 3)))
    np.testing.assert_allclose(decision.u, honest.u, atol=1e-9)
    late = asif.filter(1000.0, np.full((5, 6), np.nan), np.ones((5, 3)))
    assert late.status == "coast" and not late.u.any() and late.intervened.all()
    never = active(Q).filter(0.0, np.full((5, 6), np.inf), np.ones((5, 3)))
    assert never.status == "coast" and not never.u.any()


OVERLAP = np.array([[0, 300.0, 0, 0, 0.5, 0], [0, 304.0, 0, 0, -0.5, 0]])
"""Two deputies overlap, and go on."""


@given(sharing=st.sampled_from(ALL), sampled=st.booleans(), sequence=calls(2))
@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
def test_garbage_never_gets_through(sharing, sampled, sequence):
    q = Inspection(deputies=2)
    with np.errstate(all="ignore"):
        answers(active(q, sharing, sampled=SampledData(1.0) if sampled else None), sequence, planned=True)


def test_sampled_conditions_held_for_too_long_are_recorded(drawn):
    x, sun = drawn
    asif = active(Q, sampled=SampledData(1.0), sun_start=float(sun[0]))
    zero = np.zeros((5, 3))
    assert asif.filter(0.0, x[0], zero).fallback is None
    assert asif.filter(1.0, x[0], zero).fallback is None
    assert "25 s" in asif.filter(26.0, x[0], zero).fallback
    asif.reset()
    assert asif.filter(90.0, x[0], zero).fallback is None


@pytest.mark.parametrize("sharing", ALL)
def test_a_program_that_fails_is_answered_by_the_backup(drawn, sharing, monkeypatch):
    x, sun = drawn
    monkeypatch.setattr(
        "polaris.rta.projection.daqp.solve", lambda H, f, *rest, **extra: (np.full(len(f), np.nan), 0, -9, {})
    )
    monkeypatch.setattr("polaris.rta.priorities.lowest", lambda *_, **extra: None)
    push = np.tile([0.1, -0.2, 0.3], (5, 1))
    asif = active(Q, sharing, backup=lambda t, z: push, sun_start=float(sun[0]))
    x = x[0].copy()
    x[1, :3] = x[0, :3] + [8.0, 0.0, 0.0]  # too near: no row alone decides
    x[0, 3:], x[1, 3:] = [0.5, 0.0, 0.0], [-0.5, 0.0, 0.0]
    decision = asif.filter(0.0, x, np.full((5, 3), 0.9))
    assert decision.status == "backup" and "failed" in decision.fallback
    np.testing.assert_array_equal(decision.u[:2], push[:2])
    assert decision.intervened[:2].all()


def test_malformed_values_and_odd_times_are_answered_and_told(drawn):
    x, sun = drawn
    malformed(active(Inspection(deputies=2)))
    for sampled in (None, SampledData(1.0)):
        odd_times(active(Q, sampled=sampled, sun_start=float(sun[0])), x[0], np.zeros((5, 3)))


@pytest.mark.parametrize("then", [9.0, np.nextafter(10.0, 0.0), 71.0, -1e6])
def test_no_state_is_propagated_across_a_break_of_the_clock(drawn, then):
    x, sun = drawn
    asif = active(Q, sun_start=float(sun[0]))
    asif.filter(10.0, x[0], np.zeros((5, 3)))
    decision = asif.filter(then, np.full((5, 6), np.nan), np.zeros((5, 3)))
    assert decision.status == "coast" and "the time" in decision.fallback
    asif_known = active(Q, sun_start=float(sun[0]))
    asif_known.filter(10.0, x[0], np.zeros((5, 3)))
    after = asif_known.filter(then, x[0], np.full((5, 3), 0.1))
    expected = active(Q, sun_start=float(sun[0])).filter(then, x[0], np.full((5, 3), 0.1))
    np.testing.assert_array_equal(after.u, expected.u)


@pytest.mark.parametrize("sharing", ALL)
def test_what_is_missed_is_recorded(sharing):
    """By name and in newtons, as the rows at the answer say; the desired input is never the answer."""
    q, x = Inspection(deputies=2), OVERLAP
    asif = active(q, sharing, sun_start=np.pi / 2 + 0.1)
    decision = asif.filter(0.0, x, np.array([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]]))
    assert "least violation" in decision.fallback and decision.intervened.all()
    assert decision.u[0, 1] < 0 < decision.u[1, 1], "they part"
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
    satisfied = active(q, sharing, sun_start=np.pi / 2 + 0.1)
    separated = np.array([[0, 300.0, 0, 0, 0, 0], [60.0, 340.0, 200.0, 0, 0, 0]])
    assert satisfied.filter(0.0, separated, np.zeros((2, 3))).missed == {}
