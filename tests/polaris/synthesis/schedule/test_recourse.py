"""References planned with U in view, and what is claimed of the goal and of the velocity change."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from polaris import PolarisError, SwitchingRules, load_scenario, simulate, synthesize
from polaris.synthesis.safety.clearance import error_tube, facet_clearance
from polaris.synthesis.safety.goal_rows import _weights, distance, goal_rows
from polaris.synthesis.schedule.hand_over import HandOvers, reached_sets
from polaris.synthesis.schedule.objective import Objective
from polaris.synthesis.schedule.recourse import in_windows
from tests.golden.scenes import scenes
from tests.kept import scheduled
from tests.polaris.random_scenarios import synthesised as random_schedule
from tests.polaris.synthesis.schedule.test_arrival import sided
from tests.polaris.tiny import TINY, synthesised
from tests.sizes import fewer


@cache
def printed():
    scenario = load_scenario(TINY, ["recoverable.recourse=none"])
    return scenario, synthesize(scenario)


def random_pair(seed, folder):
    scenario, schedule = random_schedule(seed, folder)
    return scenario, schedule, synthesize(scenario.with_assignments(["recoverable.recourse=none"]))


@pytest.mark.parametrize("seed", [37, pytest.param(41, marks=pytest.mark.slow)])
def test_with_u_in_view_nothing_is_lost_and_no_flight_breaks_what_is_claimed(seed, tmp_path):
    """Random scenes whose printed schedule is given up for one with U in view."""
    _, schedule, before = random_pair(seed, tmp_path)
    assert not np.array_equal(schedule.safety.reference.chi, before.safety.reference.chi)
    assert schedule.guarantee == before.guarantee == "proved"
    assert schedule.safety.end.until >= before.safety.end.until
    assert schedule.share() >= before.share() and schedule.delta_v[0] <= before.delta_v[0]
    assert schedule.margins[schedule.modes > 0].min(initial=1.0) >= 0
    check_claims(schedule)


def test_dwell_and_cap_are_kept_by_the_windows():
    _, schedule = printed()
    rules = SwitchingRules(min_dwell=3, max_switches=3)
    objective = Objective.beside(schedule, rules, schedule.safety)
    assert objective.allows(in_windows([(4, 7)], 12))
    assert not objective.allows(in_windows([(4, 6)], 12)), "S keeps control for less than the dwell time"
    assert not objective.allows(in_windows([(2, 6)], 12)), "so does U"
    assert not objective.allows(in_windows([(3, 6), (9, 12)], 18)), "four switches, and one for the return"
    assert objective.allows(in_windows([], 12))


def test_what_hand_overs_need_is_what_s_needs_from_the_sets_of_u():
    _, schedule = printed()
    safety = schedule.safety
    tracking, K, q = safety.tracking, safety.problem.K, safety.tracking.feedback.nodes_per_cell
    unsafe = safety.clearance.unsafe
    hand_overs = HandOvers(tracking, unsafe, K)
    sets = reached_sets([schedule.controllers[1]] * K, safety.start, safety.controller)
    for error_set in (sets[0], sets[K // 2]):
        for body, tightenings in zip(unsafe, hand_overs.since(error_set), strict=True):
            rows = -body.normals @ safety.problem.system.position
            exact = error_tube(tracking, error_set, rows).over_cells(K, q)
            assert np.all(tightenings <= exact + 1e-6) and np.all(
                tightenings >= exact - 0.2 * np.abs(exact).max()
            )
    along = hand_overs.tighten(safety.reference, {k: sets[k] for k in range(K)})
    for i, (body, (tightening, shortfall)) in enumerate(zip(unsafe, along, strict=True)):
        tables = (hand_overs.since(sets[k])[i][: K - k] for k in range(K))
        later = [np.vstack([np.full((k, len(body.normals)), -np.inf), each]) for k, each in enumerate(tables)]
        at = np.maximum(np.max(later, axis=0), 0.0)
        assert np.allclose(tightening, at) and shortfall.shape == (K, 1) and np.all(shortfall >= 0)
        clearance = facet_clearance(tracking, safety.reference, body).min(axis=1)[:K]
        assert np.array_equal(shortfall[:, 0] > 0, np.all(tightening > clearance, axis=1))


@pytest.mark.slow
def test_a_goal_that_is_not_reached_is_planned_again_further_inside(tmp_path):
    scenario = scenes()["random-2+errors"].load(tmp_path)
    before = synthesize(scenario.with_assignments(["recoverable.recourse=none"]))
    schedule = synthesize(scenario)
    assert before.arrival.reached == "not_proven" and schedule.arrival.reached is True
    assert schedule.share() >= before.share()
    assert schedule.arrival.tolerance <= before.arrival.tolerance * 1.01
    problem, length = schedule.safety.problem, schedule.safety.problem.goal_inset
    rows, sides = goal_rows(problem)
    end = schedule.safety.reference.chi[problem.K]
    fixed = 2 * len(problem.goal.conditions.E)
    assert length > 0 and np.all(rows[fixed:] @ end <= sides[fixed:] - length * (1 - 1e-6))


@pytest.mark.slow
def test_with_u_in_view_nothing_is_lost_in_many_scenes(tmp_path):
    no_worse = changed = proven = 0
    seeds = range(fewer(150, 30))
    for seed in seeds:
        try:
            _, schedule, before = random_pair(seed, tmp_path)
        except PolarisError:
            continue
        if before.guarantee != "proved":
            continue
        proven += 1
        no_worse += schedule.share() >= before.share() and schedule.delta_v[0] <= before.delta_v[0] + 1e-12
        changed += not np.array_equal(schedule.safety.reference.chi, before.safety.reference.chi)
        assert schedule.safety.end.until >= before.safety.end.until
    assert changed >= fewer(12, 0.02 * len(seeds)) and proven >= fewer(80, 0.4 * len(seeds))
    assert no_worse >= 0.7 * proven


def check_claims(schedule):
    """Every flight keeps the bound on the velocity change and is as near to the goal as is claimed."""
    problem, arrival, (middle, bound) = schedule.safety.problem, schedule.arrival, schedule.delta_v
    assert middle <= bound
    assert simulate(schedule, 60, 3).delta_v.max() <= bound * (1 + 1e-9)
    if arrival.by is None:
        return False
    runs = simulate(schedule, 60, 3, tail=schedule.safety.reference.cells > problem.K)
    node = round(arrival.by / schedule.safety.tracking.flow.h)
    rows, sides = sided(problem.goal.conditions)
    gap = distance(problem.goal.conditions, (runs.states[:, node] @ rows.T - sides) * _weights(problem, rows))
    integrated = 1e-8 * np.abs(runs.states).max()
    assert gap.max() <= arrival.distance + integrated and arrival.distance <= arrival.tolerance
    return True


@pytest.mark.parametrize("name", ["tiny", pytest.param("static", marks=pytest.mark.slow)])
def test_the_goal_of_a_scene_is_reached_as_claimed(name):
    scenario, schedule = synthesised() if name == "tiny" else scheduled(name)
    assert check_claims(schedule) and schedule.arrival.reached is True
    assert schedule.arrival.delta_v >= schedule.delta_v[1]
    narrow = replace(scenario.problem(), goal_tolerance=1e-9)
    tried = synthesize(narrow, experimental=[])
    assert tried.arrival.reached == "not_proven"
    assert tried.arrival.by is None and tried.arrival.distance > 1e-9
