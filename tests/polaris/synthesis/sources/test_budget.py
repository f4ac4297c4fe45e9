"""A budget of velocity change is a condition: what is returned is proven to keep it, or nothing is."""

import re

import pytest

from polaris.model.errors import NotCertified
from polaris.synthesis.schedule.rules import CHECKED
from polaris.synthesis.schedule.synthesize import synthesize
from tests.polaris.random_scenarios import synthesised as random_scene
from tests.polaris.tiny import synthesised
from tests.sizes import fewer


def under(scenario, budget):
    """The schedule within a budget, or what the message says is the least that was found."""
    try:
        schedule = synthesize(scenario.with_assignments([f"schedule.delta_v_max_m_s={budget!r}"]))
    except NotCertified as error:
        assert error.exit_code == 4
        return None, float(re.search(r"smallest proven delta-v is ([\d.e+-]+) m/s", str(error))[1])
    return schedule, schedule.spent


def judge(scenario, free):
    """Outcomes of a scene under budgets just above and below what it is proven to keep without one."""
    kept = free.spent * (1 + CHECKED)
    same, _ = under(scenario, kept * (1 + 1e-9))
    assert same is not None and same.modes.tolist() == free.modes.tolist()
    none, least = under(scenario, 1e-6 * free.spent)
    assert none is None and 1e-6 * free.spent < least <= kept * (1 + 1e-3)
    cheaper, spent = under(scenario, 0.97 * free.spent)
    if cheaper is None:
        assert spent > 0.97 * free.spent
    else:
        assert spent <= 0.97 * free.spent and cheaper.guarantee == free.guarantee


@pytest.mark.parametrize("recourse", ["none", pytest.param("replan", marks=pytest.mark.slow)])
def test_a_budget_is_kept_or_nothing_is_returned(recourse):
    scenario, free = synthesised()
    scenario = scenario.with_assignments([f"recoverable.recourse={recourse}"])
    free = free if recourse == "none" else synthesize(scenario)
    judge(scenario, free)


@pytest.mark.parametrize("seed", [2])
def test_budgets_of_random_scenes(seed, tmp_path):
    judge(*random_scene(seed, tmp_path))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 3, 5, 7, 8, 9, 10, 19, 20, 21, 23][: fewer(11, 6)])
def test_budgets_of_more_random_scenes(seed, tmp_path):
    test_budgets_of_random_scenes(seed, tmp_path)
