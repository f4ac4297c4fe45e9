"""Bounds on the velocity change of linear laws (Proposition 14 (c)), attacked, and budgets that are kept."""

import re
from dataclasses import replace

import numpy as np
import pytest

from benchmarks import tenfold
from polaris import NotCertified, falsify, load_scenario, replay, synthesize, write_case
from polaris.model.thrusters import Thrusters
from polaris.model.tolerances import ROUNDING
from polaris.simulation.falsification.attacks import Attacker
from polaris.synthesis.schedule import spending
from polaris.synthesis.schedule.rules import CHECKED
from polaris.synthesis.schedule.spending import FlightSpending
from tests.kept import kept
from tests.polaris.random_scenarios import synthesised as random_scene
from tests.polaris.tiny import TINY, synthesised
from tests.sizes import fewer

SAMPLED = ["feedback.period_s=0.25"]
NOISY = [*SAMPLED, "navigation.state_error=[0.01, 0.01, 0.005, 0.005]"]
WEAK = [*SAMPLED, "thrusters.magnitude_error=0.03", "thrusters.impulse_bit_N_s=0.002"]
CARRIED = [*WEAK, "thrusters.remainder=carried"]


def tiny(*more):
    """The schedule of the tiny scene with overrides."""
    return kept("-".join(["tiny", *more]), lambda: synthesize(load_scenario(TINY).with_assignments(more)))


@pytest.mark.parametrize("errors", [SAMPLED, NOISY, CARRIED], ids=["none", "estimate", "left"])
def test_the_worst_flights_spend_most_of_what_is_proven(errors):
    schedule = tiny(*errors)
    attacker = Attacker.from_schedule(schedule, False, np.random.default_rng(1))
    delta_v = float(attacker.spending(20).fly(attacker.flight).delta_v.max())
    by_chance = float(attacker.random(20).fly(attacker.flight).delta_v.max())
    assert by_chance < delta_v <= schedule.delta_v[1] * (1 + 1e-9)
    assert delta_v > 0.6 * schedule.delta_v[1]


def test_periods_cannot_all_be_the_worst():
    schedule = tiny(*NOISY)
    scale = schedule.safety.tracking.flow.h / schedule.safety.problem.system.mass
    count = len(schedule.steps) * schedule.safety.clearance.q
    flight = FlightSpending(schedule._spells, count)
    assert schedule.delta_v[1] < 0.75 * flight.summed(count) * scale
    assert flight.thrust_bound(0) == 0 and flight.thrust_bound(7) <= flight.thrust_bound(8) <= flight.summed(
        8
    ) * (1 + ROUNDING)


def test_a_bound_that_is_too_small_is_found_out_and_flown_again(monkeypatch, tmp_path):
    schedule = tiny(*NOISY)
    assert falsify(schedule, 700, seed=3).failure is None
    without = replace(schedule)  # nothing of what was worked out
    middles = lambda law, steps, *more: sum(np.abs(step.middle).sum() for step in steps)  # noqa: E731
    monkeypatch.setattr(spending, "together", middles)
    result = falsify(without, 700, seed=3)
    assert result.failure.kind == "velocity change" and "delta-v" in str(result.failure)
    case = write_case(tmp_path / "case.json", load_scenario(TINY).with_assignments(NOISY), result)
    assert str(replay(case)[0]) == str(result.failure)
    monkeypatch.undo()
    assert replay(case)[0] is None


def test_attacks_count_with_errors_of_thrusters_that_grow_with_commands():
    rng, small = np.random.default_rng(0), 1e-6 * np.eye(3)[:, None]
    thrusters, u, weights = Thrusters(0.1, 0.05, 0.2), rng.normal(size=(4, 3)), rng.uniform(0, 2, (4, 3))
    change = ((thrusters.part(u + small) - thrusters.part(u - small)) * weights).sum(axis=-1).T / 2e-6
    assert thrusters.slope(u, weights) == pytest.approx(change, abs=1e-8)


@pytest.mark.slow
def test_the_table_of_tightness_has_a_row_for_every_source_and_no_share_above_all():
    """One scene of the table in docs/tightness.md; the others give the rest of its figures."""
    from benchmarks import tightness

    table = [row.split("|")[1:-1] for row in tightness.rows((5000,))]
    page = tightness.PLACE.read_text(encoding="utf-8").split(tightness.BEGIN)[1].split(tightness.END)[0]
    assert [row.split("|")[1] for row in page.splitlines()[2:]] == [cells[0] for cells in table]
    shares = np.array([[float(cell.strip(" %")) for cell in cells[1:]] for cells in table])
    assert np.all(shares <= 100)
    for cells, (used, _, unmerged, *_) in zip(table, shares, strict=True):
        assert used <= unmerged + 1, cells[0]


@pytest.mark.slow
@pytest.mark.parametrize("scene", tenfold.SCENES)
def test_sums_with_all_errors_are_near_to_what_worst_cases_spend(scene):
    """Until the goal and per orbit: the figures of docs/tightness.md."""
    from benchmarks import tightness

    sums = tightness.sums(scene)
    assert all(1 <= ratio <= limit for ratio, limit in zip(sums.ratios, (1.7, 2.5), strict=True)), sums
    page = tightness.PLACE.read_text(encoding="utf-8").split(tightness.BEGIN_SUMS)[1]
    row = next(row for row in page.splitlines() if row.startswith(f"| {scene} |"))
    page_values = [float(cell) for cell in row.split("|")[2:-1]]
    assert [*sums.until_goal, *sums.per_orbit] == pytest.approx(page_values, abs=0.02)


@pytest.mark.slow
def test_the_deviation_by_error_source_is_that_of_the_page():
    """Deviation at the tightest place with all errors at once: the figures of docs/tightness.md."""
    from benchmarks import error_sources

    page = (
        error_sources.PLACE.read_text(encoding="utf-8")
        .split(error_sources.BEGIN)[1]
        .split(error_sources.END)[0]
    )
    printed, table = (
        [[cell.strip() for cell in row.split("|")[1:-1]] for row in rows]
        for rows in (page.splitlines(), error_sources.table(error_sources.SCENES))
    )
    assert [cells[0] for cells in table] == [cells[0] for cells in printed] and table[:2] == printed[:2]
    *sizes, whole = np.array([[float(cell) for cell in cells[1::2]] for cells in table[2:]])
    page_values = np.array([[float(cell) for cell in cells[1::2]] for cells in printed[2:]])
    assert np.vstack([*sizes, whole]) == pytest.approx(page_values, abs=0.05)
    assert np.sum(sizes, axis=0) == pytest.approx(whole, abs=0.1)
    attained = np.array([float(cell) for cell in table[-1][2::2]])
    assert table[-1][0] == "all" and np.all((0.55 * whole <= attained) & (attained <= whole))


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
    budget = free.spent * (1 + CHECKED)
    same, _ = under(scenario, budget * (1 + 1e-9))
    assert same is not None and same.modes.tolist() == free.modes.tolist()
    none, least = under(scenario, 1e-6 * free.spent)
    assert none is None and 1e-6 * free.spent < least <= budget * (1 + 1e-3)
    cheaper, delta_v = under(scenario, 0.97 * free.spent)
    if cheaper is None:
        assert delta_v > 0.97 * free.spent
    else:
        assert delta_v <= 0.97 * free.spent and cheaper.guarantee == free.guarantee


@pytest.mark.parametrize("recourse", ["none", pytest.param("replan", marks=pytest.mark.slow)])
def test_a_budget_is_kept_or_nothing_is_returned(recourse):
    scenario, free = synthesised()
    scenario = scenario.with_assignments([f"recoverable.recourse={recourse}"])
    free = free if recourse == "none" else synthesize(scenario)
    judge(scenario, free)


SEEDS = [0, 3, 5, 7, 8, 9, 10, 19, 20, 21, 23][: fewer(11, 3)]


@pytest.mark.parametrize("seed", [2, *(pytest.param(seed, marks=pytest.mark.slow) for seed in SEEDS)])
def test_budgets_of_random_scenes(seed, tmp_path):
    judge(*random_scene(seed, tmp_path))
