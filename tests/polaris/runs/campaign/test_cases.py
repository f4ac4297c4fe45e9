"""Grids, names and seeds of cases; statistics."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom

from polaris.model.errors import ScenarioError
from polaris.runs.campaign import CampaignPlan, ScheduleRuns, make_cases, parse_grid
from polaris.runs.campaign.schedules import batch_seeds
from polaris.simulation.metrics import POSSIBLE, mean_interval, possible, violation_interval
from tests.polaris.runs.campaign.scene import TINY, cases


def test_every_combination_of_the_grid_is_a_case():
    grid = parse_grid(["planner.extra_margin_m=0.3, 0.4", "system.input_max=1.0,2.0,3.0"])
    assert grid == {"planner.extra_margin_m": [0.3, 0.4], "system.input_max": [1.0, 2.0, 3.0]}
    all_cases = make_cases([TINY], grid, ["simulation.runs=3"])
    assert [dict(case.parameters) for case in all_cases] == [
        {"planner.extra_margin_m": margin, "system.input_max": limit}
        for margin in (0.3, 0.4)
        for limit in (1.0, 2.0, 3.0)
    ]
    assert all_cases[4].label == "tiny, planner.extra_margin_m=0.4, system.input_max=2"
    assert "input_max = 2.0" in all_cases[4].text and "runs = 3" in all_cases[4].text


def test_values_of_a_grid_are_those_of_set():
    texts = ["a=highs,gurobi", "b=[1, 2],[3, 4]", 'c={ kind = "x", n = [1, 2] },1', 'd="p,q",r', "e=true,1"]
    assert parse_grid(texts) == {
        "a": ["highs", "gurobi"],
        "b": [[1, 2], [3, 4]],
        "c": [{"kind": "x", "n": [1, 2]}, 1],
        "d": ["p,q", "r"],
        "e": [True, 1],
    }


@pytest.mark.parametrize("grid", [["system.input_max"], ["=1"], ["system.input_max="], ["a=1", "a=2"]])
def test_malformed_grids_are_refused(grid):
    with pytest.raises(ScenarioError, match="key=value|must be given once"):
        parse_grid(grid)


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (([TINY], {"system.input_max": [1.0, 1.0]}), "each once"),
        (([TINY], {"system.input_max": []}), "at least one value"),
        (([TINY], {"system.colour": ["red"]}), "colour"),
        (([TINY], {"system.input_max": [1.0]}, ["system.input_max=2"]), "left out of --set"),
        (([TINY, TINY],), "different cases"),
        (([],), "different cases"),
    ],
)
def test_cases_that_make_no_sense_are_refused(arguments, word):
    with pytest.raises(ScenarioError, match=word):
        make_cases(*arguments)


@pytest.mark.parametrize(
    ("changed", "word"),
    [
        ({"runs": 0}, "--runs"),
        ({"batch": 0}, "--batch"),
        ({"seed": -1}, "--seed"),
        ({"modes": ()}, "--mode"),
        ({"modes": ("polaris", "polaris")}, "--mode"),
        ({"modes": ("autopilot",)}, "must be one of polaris, safety, experimental, experimental_2, "),
        ({"modes": ("experimental_2",)}, "must be one of polaris, safety, experimental for tiny"),
        ({"initial": "anywhere"}, "--initial"),
        ({"disturbance": "storm"}, "--disturbance"),
        ({"cases": ()}, "cases"),
    ],
)
def test_plans_that_make_no_sense_are_refused(changed, word):
    kinds = {name: changed[name] for name in ("modes", "initial", "disturbance") if name in changed}
    more = {name: value for name, value in changed.items() if name not in kinds}
    with pytest.raises(ScenarioError, match=word):
        CampaignPlan(**({"cases": cases(), "runs": 5} | more), kind=ScheduleRuns(**kinds))


def test_seeds_hang_on_the_campaign_the_case_and_the_batch_alone():
    plan = CampaignPlan(cases(), 22, batch=5)
    assert [(task.case, task.batch, task.runs) for task in plan.tasks()] == [
        (case, batch, runs) for case in (0, 1) for batch, runs in enumerate([5, 5, 5, 5, 2])
    ]
    plan = CampaignPlan(cases(), 100, 3, 10)
    seeds = [seed for task in plan.tasks() for seed in batch_seeds(task)]
    assert len(set(seeds)) == 2 * 20 and all(0 <= seed < 2**63 for seed in seeds)
    alone = CampaignPlan(cases()[1:], 40, 3, 10)
    assert [batch_seeds(task) for task in alone.tasks()] == [batch_seeds(plan.task(1, i)) for i in range(4)]
    other = CampaignPlan(cases()[1:], 40, 4, 10)
    assert batch_seeds(other.task(0, 0)) != batch_seeds(alone.task(0, 0))


def test_digest_hangs_on_all_but_the_number_of_runs():
    plan = CampaignPlan(cases(), 22)
    assert CampaignPlan(cases(), 1000).digest == plan.digest == CampaignPlan.from_data(plan.data()).digest
    kinds = ScheduleRuns(("safety",)), ScheduleRuns(initial="random"), ScheduleRuns(disturbance="none")
    changes = {"seed": 1}, {"batch": 3}, *({"kind": kind} for kind in kinds)
    others = [CampaignPlan(cases()[:1], 22), *(CampaignPlan(cases(), 22, **changed) for changed in changes)]
    assert len({plan.digest, *(other.digest for other in others)}) == 7


@given(st.integers(1, 400), st.data())
def test_interval_of_a_probability_is_that_of_clopper_and_pearson(runs, data):
    violations = data.draw(st.integers(0, runs))
    low, high = violation_interval(violations, runs)
    assert low <= violations / runs <= high
    # By its definition: at each end the tail beyond what was seen has probability 2.5 %.
    if violations:
        assert binom.sf(violations - 1, runs, low) == pytest.approx(0.025, rel=1e-6)
    else:
        assert low == 0
    if violations < runs:
        assert binom.cdf(violations, runs, high) == pytest.approx(0.025, rel=1e-6)
    else:
        assert high == 1


def test_no_confidence_bound_is_impossible():
    rng = np.random.default_rng(1)
    covered = sum(
        low <= 3 <= high for _, low, high in (mean_interval(rng.normal(3, 2, 8)) for _ in range(2000))
    )
    assert 0.935 < covered / 2000 < 0.965
    assert mean_interval(np.array([2.0])) == (2.0, None, None)
    for name, (least, largest) in POSSIBLE.items():
        for scale in (1e-3, 0.5, 1.0):
            values = np.minimum(scale * rng.uniform(size=3) ** 4, largest)
            values[0] = least
            mean, low, high = mean_interval(values, within=possible(name))
            assert least <= low <= mean <= high <= largest
            mean, low, high = mean_interval(values - values[::-1], within=possible(name, difference=True))
            assert least - largest <= low <= mean <= high <= largest - least
