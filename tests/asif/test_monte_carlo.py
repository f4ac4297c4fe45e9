"""The Monte Carlo: sampling, judgement, failures, any number of workers; the paper's in the slow test."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pytest

from polaris.inspection.constraints.allowable_set import allowable
from polaris.inspection.constraints.families import Families
from polaris.inspection.constraints.motion import SampledData
from polaris.inspection.filters.explicit import Centralized
from polaris.inspection.flights.outcome import STUDIES, Study
from polaris.inspection.flights.primary import LQR, NoInput
from polaris.inspection.flights.sampling import initial_conditions
from polaris.inspection.flights.simulation import fly_one
from polaris.inspection.flights.studies import BLOCK, fly_block, monte_carlo
from polaris.inspection.inspection import Inspection
from polaris.model.errors import ScenarioError

Q = Inspection()


@pytest.fixture(scope="module")
def drawn():
    return initial_conditions(Families(Q), 8, seed=1)


def test_initial_conditions_are_inside_and_reproducible(drawn):
    x, sun, accepted = drawn
    again = initial_conditions(Families(Q), 8, seed=1)
    np.testing.assert_array_equal(x, again[0])
    np.testing.assert_array_equal(sun, again[1])
    assert (Families(Q)(x, sun).h >= 0).all()
    assert not np.array_equal(x, initial_conditions(Families(Q), 8, seed=2)[0])
    # With the cube of 1000 m and 1 m/s, the published library accepts 0.65 % of the samples.
    assert 0.003 < accepted < 0.012
    assert np.abs(x[..., :3]).max() > 400 and np.ptp(sun) > np.pi


def test_sampling_gives_up_where_there_is_no_room(monkeypatch):
    monkeypatch.setattr("polaris.inspection.flights.sampling.PATIENCE", 4000)
    with pytest.raises(ScenarioError, match="hardly any of 4096 samples"):
        initial_conditions(Families(Inspection(deputies=30)), 1)
    with pytest.raises(ScenarioError, match="count"):
        initial_conditions(Families(Q), 0)


def test_least_values_are_those_of_the_flight_flown_alone(drawn):
    x, sun, _ = drawn
    study = Study("central")
    found = fly_block(Q, study, x[:3], sun[:3], 30.0, 1.0, 1)
    for run in range(3):
        flight = fly_one(Q, Centralized(Families(Q)), NoInput(), x[run], float(sun[run]), 30.0)
        for name, values in allowable(Q, flight.x, flight.sun).items():
            at_samples = values.min()
            assert found.least[name][run] <= at_samples + 1e-9
            # Half a second between the instants looked at: nothing moves by more than a metre.
            assert found.least[name][run] > at_samples - 1.0
        np.testing.assert_allclose(found.delta_v[run], flight.delta_v[-1], rtol=1e-9, atol=1e-12)


def test_workers_do_not_change_the_results(drawn):
    x, sun, _ = drawn
    many = (np.tile(x, (BLOCK // 8 + 1, 1, 1))[: BLOCK + 4], np.tile(sun, BLOCK // 8 + 1)[: BLOCK + 4])
    studies = (STUDIES[0], STUDIES[3])
    told = []
    here = monte_carlo(Q, *many, studies, 4.0, progress=lambda done, total: told.append((done, total)))
    with ProcessPoolExecutor(2) as executor:
        there = monte_carlo(Q, *many, studies, 4.0, executor=executor)
    assert told == [(k + 1, 4) for k in range(4)]
    for name, outcome in here.items():
        for key, values in outcome.least.items():
            np.testing.assert_array_equal(values, there[name].least[key])
        np.testing.assert_array_equal(outcome.delta_v, there[name].delta_v)
        assert outcome.success.all() and len(outcome.success) == BLOCK + 4


def test_a_failure_says_what_who_and_when():
    """Two deputies on a collision course, too close to stop; a third is beyond the keep-in zone."""
    q = Inspection(deputies=3)
    x = np.zeros((1, 3, 6))
    x[0, 0] = [0, 300, 0, 0, -0.4, 0]
    x[0, 1] = [0, 289, 0, 0, 0.4, 0]
    x[0, 2] = [0, 0, 1010, 0, 0, 0]
    found = fly_block(q, Study("central"), x, np.zeros(1), 10.0)
    assert not found.success[0] and found.violated[0]
    what = {row["what"]: row for row in found.failures()}
    assert what["phi2"]["deputies"] == (0, 1) and what["phi2"]["value"] < 0 < what["phi2"]["time"] <= 10
    assert what["phi6"]["deputies"] == (2,) and what["phi6"]["time"] == 0.0
    assert what["phi6"]["value"] == pytest.approx(-10)
    assert "no solution" in what and np.isnan(what["no solution"]["value"])


def test_what_is_left_out_is_not_judged(drawn):
    x, sun, _ = drawn
    found = fly_block(Q, Study("without", "coasting", ("deputy_sun",)), x[:2], sun[:2], 3.0)
    assert "phi5" not in found.least and "phi4" in found.least and "phi8" in found.least


def test_left_out_families_and_sampled_studies_are_judged_alike():
    """A fast deputy on its way past the chief: phi9 to phi11 count unless left out, phi7 always."""
    q = Inspection(deputies=1)
    x = np.array([[[0.0, -60.0, 0.0, 0.0, 1.2, 0.0]]])
    sun = np.array([1.0])
    plain = fly_block(q, Study("plain"), x, sun, 3.0)
    assert plain.least["phi10"][0] < 0 and plain.least["phi7"][0] < 0
    without = fly_block(q, Study("without", without=("velocity",)), x, sun, 3.0)
    assert not {"phi9", "phi10", "phi11"} & set(without.least)
    sampled = fly_block(q, Study("sampled", sampled=SampledData(1.0)), x, sun, 3.0)
    assert sampled.least["phi7"][0] < 0 and "phi7" in {row["what"] for row in sampled.failures()}


def test_what_cannot_be_told_is_a_failure(drawn):
    """States that become nan, and a primary controller that does."""
    x, sun, _ = drawn
    lost = x[:1].copy()
    lost[0, 2, 4] = np.nan
    with np.errstate(invalid="ignore"):
        found = fly_block(Q, Study("central"), lost, sun[:1], 2.0)
    assert not found.success[0] and found.least["phi1"][0] == -np.inf

    class Broken:
        def __call__(self, t, states):
            return np.full((*states.shape[:-1], 3), np.nan if t >= 1 else 0.0)

    found = fly_block(Q, Study("central"), x[:2], sun[:2], 3.0, primary=Broken())
    assert not found.success.any() and (found.short == 1.0).all()
    assert np.isfinite(found.least["phi1"]).all() and not found.violated.any()


def test_a_primary_controller_that_attacks_is_filtered(drawn):
    x, sun, _ = drawn
    found = fly_block(Q, STUDIES[0], x[:2], sun[:2], 20.0, 0.2, primary=LQR(Q))
    assert (found.interventions == 1).all() and found.success.all()


def test_names_must_differ(drawn):
    x, sun, _ = drawn
    with pytest.raises(ScenarioError, match="different names"):
        monte_carlo(Q, x, sun, (Study("a"), Study("a", "half")), 1.0)


@pytest.mark.slow
def test_the_papers_monte_carlo():
    """2,000 runs: the paper has 100 %, 90.95 % and 100 %; shared conditions lose none."""
    x, sun, _ = initial_conditions(Families(Q), 2000, seed=1)
    with ProcessPoolExecutor(2) as executor:
        found = monte_carlo(Q, x, sun, executor=executor)
    success = {name: outcome.success.mean() for name, outcome in found.items()}
    assert success["centralized"] == 1.0
    assert 0.9 < success["decentralized"] < 0.99
    assert success["decentralized without h5"] >= 0.999
    assert success["decentralized, shared"] == 1.0
