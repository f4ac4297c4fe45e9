"""The filters at random states: exact where nothing is wrong, optimal elsewhere, never silent."""

import numpy as np
import pytest
from hypothesis import event, given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from polaris.inspection.constraints.families import Families
from polaris.inspection.constraints.motion import SampledData
from polaris.inspection.filters.explicit import SHARINGS, Centralized, Decentralized
from polaris.inspection.inspection import Inspection
from polaris.rta.projection import DESIRED, SHORT
from tests.polaris.inspection.test_projection import CLOSE, residuals

N = 4
Q = Inspection(deputies=N)
FAMILIES = {
    "continuous": Families(Q),
    "sampled": Families(Q, sampled=SampledData(1.0)),
    "without": Families(Q, without=("deputy_sun", "passive")),
}


def situation(seed, R=12, spread=(20.0, 600.0)):
    """Deputies near each other and their boundaries, some of them beyond; desired inputs of all sizes."""
    rng = np.random.default_rng(seed)
    size = np.exp(rng.uniform(*np.log(spread), (R, 1, 1)))
    x = rng.uniform(-1, 1, (R, N, 6))
    x[..., :3] *= size
    x[..., 3:] *= 0.2 + Q.nu_1 * size * 0.5
    return x, rng.uniform(-np.pi, np.pi, R), rng.standard_normal((R, N, 3)) * 10 ** rng.uniform(-2, 1)


def within(desired):
    """Clip inputs to the thrust limits: the nearest to the result is looked for."""
    return np.clip(desired, -Q.thrust_max, Q.thrust_max)


def wide_rows(families, G, coupled=True):
    """Rows on all inputs together, written out."""
    M = len(families.first)
    wide = np.zeros((M, N, 3))
    for m in range(M):
        wide[m, families.first[m]] += G[m]
        if families.second[m] >= 0:
            wide[m, families.second[m]] -= G[m]
    return wide.reshape(M, -1)


@pytest.mark.parametrize("name", list(FAMILIES))
@given(seed=st.integers(0, 10**6))
@settings(max_examples=12)
def test_centralized_is_the_projection(name, seed):
    families = FAMILIES[name]
    x, sun, desired = situation(seed)
    for R in (len(x), 1):
        answer = Centralized(families).batch(x[:R], sun[:R], desired[:R])
        assert np.isfinite(answer.u).all() and np.abs(answer.u).max() <= Q.thrust_max
        for r in range(R):
            wide, bound = wide_rows(families, answer.rows.G[r]), answer.rows.bound[r]
            given_ = desired[r].ravel()
            kept = (wide @ given_ >= bound + 1e-12).all() and np.abs(given_).max() <= Q.thrust_max
            if kept:
                assert (answer.u[r] == desired[r]).all() and (answer.status[r] == DESIRED).all()
            if (answer.status[r] < SHORT).all():
                finite = bound > -np.inf
                primal, stationarity = residuals(
                    wide[finite], bound[finite], within(given_), Q.thrust_max, answer.u[r].ravel()
                )
                assert primal < CLOSE and stationarity < CLOSE
                changed = (answer.u[r] != desired[r]).any(axis=1)
                assert (changed == (answer.status[r] != DESIRED)).all()
            else:
                assert (answer.status[r] == SHORT).all()
                assert not feasible(wide, bound)


def feasible(wide, bound, limit=Q.thrust_max):
    """Can all rows, scaled to length 1, be met? By a linear program for the least shortage."""
    length = np.linalg.norm(wide, axis=1)
    if (bound[length == 0] > 0).any() or (bound == np.inf).any():
        return False
    some = (length > 0) & (bound > -np.inf)
    rows, tightening = wide[some] / length[some, None], bound[some] / length[some]
    size = wide.shape[1]
    answer = linprog(
        np.r_[np.zeros(size), 1.0],
        -np.c_[rows, np.ones(len(tightening))],
        -tightening,
        bounds=[(-limit, limit)] * size + [(-1, None)],
    )
    return answer.status == 0 and answer.fun <= -1e-9


@pytest.mark.parametrize("name", list(FAMILIES))
@given(seed=st.integers(0, 10**6))
@settings(max_examples=8)
def test_coasting_is_the_projection_of_each_deputy(name, seed):
    families = FAMILIES[name]
    x, sun, desired = situation(seed)
    for R in (len(x), 1):
        answer = Decentralized(families).batch(x[:R], sun[:R], desired[:R])
        assert np.isfinite(answer.u).all() and np.abs(answer.u).max() <= Q.thrust_max
        for r in range(R):
            for i in range(N):
                mine = (families.first == i) | (families.second == i)
                sign = np.where(families.second[mine] == i, -1.0, 1.0)
                rows, bound = answer.rows.G[r, mine] * sign[:, None], answer.rows.bound[r, mine]
                if answer.status[r, i] < SHORT:
                    finite = bound > -np.inf
                    primal, stationarity = residuals(
                        rows[finite], bound[finite], within(desired[r, i]), Q.thrust_max, answer.u[r, i]
                    )
                    assert primal < CLOSE and stationarity < CLOSE
                else:
                    assert not feasible(rows, bound)


@pytest.mark.parametrize("sharing", ["half", "consensus"])
@pytest.mark.parametrize("name", list(FAMILIES))
@given(seed=st.integers(0, 10**6))
@settings(max_examples=10)
def test_shares_add_up_to_the_whole_condition(sharing, name, seed):
    """A pair's condition holds if both deputies meet their shares, whatever was desired."""
    families = FAMILIES[name]
    x, sun, desired = situation(seed, spread=(100.0, 600.0))
    answer = Decentralized(families, sharing).batch(x, sun, desired)
    pair = families.second >= 0
    first, second = families.first, np.where(pair, families.second, families.first)
    met = (answer.status[:, first] < SHORT) & (answer.status[:, second] < SHORT)
    relative = answer.u[:, first] - np.where(pair[:, None], answer.u[:, second], 0.0)
    slack = np.einsum("rmv,rmv->rm", answer.rows.G, relative) - answer.rows.bound
    assert slack[met].min(initial=np.inf) >= -1e-9
    event(f"{met[:, pair].any(axis=1).sum()} of {len(x)} met")


@pytest.mark.parametrize("sharing", ["half", "consensus"])
@pytest.mark.parametrize("name", list(FAMILIES))
def test_shares_are_met_often_enough_to_be_tested(sharing, name):
    met = 0
    for seed in range(5):
        x, sun, desired = situation(seed, spread=(100.0, 600.0))
        answer = Decentralized(FAMILIES[name], sharing).batch(x, sun, desired)
        met += (answer.status < SHORT).all(axis=1).sum()
    assert met > 5


def test_coasting_shares_do_not_add_up():
    """The paper's: each as if the other did not thrust. Two that push the same way break the condition."""
    broken = 0
    for seed in range(30):
        families = FAMILIES["continuous"]
        x, sun, desired = situation(seed)
        answer = Decentralized(families).batch(x, sun, desired)
        pair = families.second >= 0
        first, second = families.first[pair], families.second[pair]
        met = (answer.status[:, first] < SHORT) & (answer.status[:, second] < SHORT)
        relative = answer.u[:, first] - answer.u[:, second]
        slack = np.einsum("rmv,rmv->rm", answer.rows.G[:, pair], relative) - answer.rows.bound[:, pair]
        broken += (slack[met] < -1e-6).sum()
    assert broken > 0


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
    families, exact = Families(Q, "linear", sampled=SampledData(2.0)), Families(Q, "linear", exact=True)
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
                Phi, Gamma = Q.discretize(part)
                after = x[r] @ Phi.T + answer.u[r] @ Gamma.T
                assert exact(after[None], Q.sun_angle([part], sun[r])).h.min() >= -1e-9
    assert tried >= 5 and solved >= tried / 3


@pytest.mark.parametrize("sharing", ["centralized", *SHARINGS])
def test_hopeless_states_are_flagged_with_an_admissible_input(sharing):
    """Deep inside each other, at the chief, far outside, racing: finite, within limits, SHORT."""
    families = FAMILIES["continuous"]
    make = Centralized(families) if sharing == "centralized" else Decentralized(families, sharing)
    x = np.zeros((5, N, 6))
    x[:, :, :3] = np.random.default_rng(0).uniform(-300, 300, (N, 3))
    x[0, :2, :3] = [100.0, 0.0, 0.0]  # on top of each other
    x[1, 0, :3] = 0.0  # at the chief's centre
    x[2, 0, :3] = [1e6, 0.0, 0.0]
    x[3, 0, 3:] = [50.0, -50.0, 0.0]
    x[4, 0] = [11.0, 0.0, 0.0, -5.0, 0.0, 0.0]
    desired = np.full((5, N, 3), 0.5)
    for runs in ([0, 1, 2, 3, 4], [0], [1], [2], [3], [4]):
        with np.errstate(all="raise", under="ignore"):
            answer = make.batch(x[runs], np.zeros(5)[runs], desired[runs])
        assert np.isfinite(answer.u).all() and np.abs(answer.u).max() <= Q.thrust_max
        assert (answer.status >= SHORT).any(axis=1).all()
        assert (answer.status == SHORT).any()


def test_one_deputy_has_no_pairs():
    q = Inspection(deputies=1)
    families = Families(q)
    x = np.array([[[100.0, 20.0, 0.0, -0.4, 0.0, 0.0]]])
    answers = [Centralized(families).batch(x, np.zeros(1), np.zeros((1, 1, 3)))]
    answers += [Decentralized(families, s).batch(x, np.zeros(1), np.zeros((1, 1, 3))) for s in SHARINGS]
    for answer in answers[1:]:
        np.testing.assert_allclose(answer.u, answers[0].u, atol=1e-10)
