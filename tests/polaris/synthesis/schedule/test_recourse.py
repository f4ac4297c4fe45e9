"""References planned with U in view, and what is claimed of the goal and of the velocity change."""

from dataclasses import replace
from functools import cache
from importlib import import_module
from time import perf_counter
from types import SimpleNamespace

import numpy as np
import pytest

from polaris.model.errors import PolarisError, ScenarioError
from polaris.model.scene.distances import stretches
from polaris.planning.following import Followed, FollowingSearch
from polaris.planning.rows import PlanRows
from polaris.scenario.scenario import load_scenario
from polaris.simulation.simulate import simulate
from polaris.synthesis.safety.clearance import error_tube, facet_clearance
from polaris.synthesis.safety.goal_rows import _weights, distance, goal_rows, inset
from polaris.synthesis.schedule.hand_over import HandOvers, reached_sets
from polaris.synthesis.schedule.objective import Objective
from polaris.synthesis.schedule.recourse import ReferenceSearch, followable, in_windows, neighbours
from polaris.synthesis.schedule.rules import SwitchingRules
from polaris.synthesis.schedule.search import ScheduleSearch
from polaris.synthesis.schedule.synthesize import synthesize
from tests.golden.scenes import scenes
from tests.polaris.random_scenarios import synthesised as random_schedule
from tests.polaris.tiny import TINY, synthesised
from tests.sizes import fewer

CHANGED = (37, 41, 65, 68)
"""Random scenes whose printed schedule is given up for one with U in view."""

SOME = [*CHANGED[::3], *(pytest.param(seed, marks=pytest.mark.slow) for seed in CHANGED[1:3])]


@cache
def printed():
    scenario = load_scenario(TINY, ["recoverable.recourse=none"])
    return scenario, synthesize(scenario)


@cache
def random_pair(seed, folder):
    scenario, schedule = random_schedule(seed, folder)
    return scenario, schedule, synthesize(scenario.with_assignments(["recoverable.recourse=none"]))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("replan")


# -- the path -------------------------------------------------------------------------------------


def test_a_followed_path_is_that_of_the_law():
    _, schedule = printed()
    _, law = next(followable(schedule))
    window = ReferenceSearch(schedule, law, 1, Objective.beside(schedule, SwitchingRules(), schedule.safety))
    followed = Followed.from_law(law.system, law.powers[-1], law.own)
    own = law.own
    # On the law's own reference the constant input is the reference's own.
    assert np.allclose(own.chi[: own.cells] @ followed.F.T + followed.f, own.nu, atol=1e-9)
    rows = PlanRows(window.asked)
    search = FollowingSearch(rows, perf_counter() + 60, followed)
    K = rows.problem.K
    free = window.closing | window.limited
    assert not free.all()
    search.set_prices_of_departure(np.where(free, 0.0, np.inf))
    path = search.solve({})
    assert path is not None
    departures = search.departures(path)
    assert departures[~free].max() < 1e-6
    seen = search.look(path)
    nu = path.z.reshape(K, -1) * law.system.u_max
    expected = seen.states[:K] @ followed.F.T + followed.f
    assert np.abs(nu - expected)[~free].max() < 1e-6 * law.system.u_max.max()
    search.set_prices_of_departure(np.zeros(K))
    assert search.solve({}).fuel <= path.fuel + 1e-9, "what is free is no dearer"


def test_windows_and_their_neighbours():
    mask = in_windows([(2, 5), (9, 10)], 12)
    assert stretches(mask) == [(2, 5), (9, 10)]
    masks = {other.tobytes() for other in neighbours(mask)}
    for parts in ([(3, 5), (9, 10)], [(2, 5)], [(2, 10)], [(2, 5), (8, 9)], [(1, 4), (9, 10)]):
        assert in_windows(parts, 12).tobytes() in masks
    assert stretches(np.zeros(4, dtype=bool)) == []


def test_dwell_and_cap_are_kept_by_the_windows():
    _, schedule = printed()
    rules = SwitchingRules(min_dwell=3, max_switches=3)
    objective = Objective.beside(schedule, rules, schedule.safety)
    assert objective.allows(in_windows([(4, 7)], 12))
    assert not objective.allows(in_windows([(4, 6)], 12)), "S keeps control for less than the dwell time"
    assert not objective.allows(in_windows([(2, 6)], 12)), "so does U"
    assert not objective.allows(in_windows([(3, 6), (9, 12)], 18)), "four switches, and one for the return"
    assert objective.allows(in_windows([], 12))


# -- the choice -------------------------------------------------------------------------------------


def test_without_recourse_the_printed_algorithms_are_kept():
    scenario, schedule = printed()
    again = synthesize(scenario, schedule.safety, schedule.controllers[1:])
    assert again.modes.tolist() == schedule.modes.tolist()
    assert "recourse" not in schedule.seconds


@pytest.mark.parametrize("seed", SOME)
def test_with_u_in_view_nothing_is_lost(seed, folder):
    _, schedule, before = random_pair(seed, folder)
    assert not np.array_equal(schedule.safety.reference.chi, before.safety.reference.chi)
    assert schedule.guarantee == before.guarantee == "proved"
    assert schedule.safety.end.until >= before.safety.end.until
    assert schedule.share() >= before.share()
    assert schedule.delta_v[0] <= before.delta_v[0]
    assert schedule.margins[schedule.modes > 0].min(initial=1.0) >= 0


@pytest.mark.slow
def test_what_is_in_the_way_after_the_end_alone_is_passed_with_u_in_view_too():
    """A box on the orbit that the reference of `static` with U in view would coast along after T."""
    late = '{kind="box", name="late", center_m=[-71.0, 75.0, 0.0], half_widths_m=[10.0, 10.0, 10.0]}'
    debris = '{kind="box", name="debris", center_m=[135.0, 215.0, 0.0], half_widths_m=[25.0, 25.0, 25.0]}'
    schedule = synthesize(load_scenario("static", [f"obstacles=[{debris}, {late}]"]))
    assert schedule.safety.plan.status == "replan" and schedule.safety.plan.tail_facets.shape[1] > 0
    assert schedule.safety.end.until == np.inf and schedule.arrival.reached is True
    assert schedule.share() > 0.85 and schedule.switches == 2


def test_what_hand_overs_need_is_what_s_needs_from_the_sets_of_u():
    _, schedule = printed()
    safety = schedule.safety
    tracking, K, q = safety.tracking, safety.problem.K, safety.tracking.feedback.nodes_per_cell
    unsafe = safety.clearance.unsafe
    hand_overs = HandOvers(tracking, unsafe, K)
    sets = reached_sets([schedule.controllers[1]] * K, safety.start, safety.controller)
    for handed in (sets[0], sets[K // 2]):
        for body, tightenings in zip(unsafe, hand_overs.since(handed), strict=True):
            rows = -body.normals @ safety.problem.system.position
            exact = error_tube(tracking, handed, rows).over_cells(K, q)
            assert np.all(tightenings <= exact + 1e-6) and np.all(
                tightenings >= exact - 0.2 * np.abs(exact).max()
            )
    along = hand_overs.tighten(safety.reference, {k: sets[k] for k in range(K)})
    for i, (body, (tightening, lack)) in enumerate(zip(unsafe, along, strict=True)):
        tables = (hand_overs.since(sets[k])[i][: K - k] for k in range(K))
        later = [np.vstack([np.full((k, len(body.normals)), -np.inf), each]) for k, each in enumerate(tables)]
        at = np.maximum(np.max(later, axis=0), 0.0)
        assert np.allclose(tightening, at) and lack.shape == (K, 1) and np.all(lack >= 0)
        clearance = facet_clearance(tracking, safety.reference, body).min(axis=1)[:K]
        assert np.array_equal(lack[:, 0] > 0, np.all(tightening > clearance, axis=1))


@pytest.mark.slow
def test_a_goal_that_is_not_reached_is_planned_again_further_inside(tmp_path):
    scenario = scenes()["random-2+errors"].load(tmp_path)
    before = synthesize(scenario.with_assignments(["recoverable.recourse=none"]))
    schedule = synthesize(scenario)
    assert before.arrival.reached == "not_proven" and schedule.arrival.reached is True
    assert (
        schedule.share() >= before.share() and schedule.arrival.tolerance <= before.arrival.tolerance * 1.01
    )
    problem, length = schedule.safety.problem, schedule.safety.problem.goal_inset
    rows, sides = goal_rows(problem)
    end = schedule.safety.reference.chi[problem.K]
    fixed = 2 * len(problem.goal.conditions.E)
    assert length > 0 and np.all(rows[fixed:] @ end <= sides[fixed:] - length * (1 - 1e-6))


def test_an_inset_goal_keeps_its_equalities():
    scenario, _ = printed()
    problem = scenario.problem()
    goal = problem.goal
    tightened = inset(problem, goal, 0.25)
    assert tightened.n == goal.n and tightened.describe() == goal.describe()
    assert np.array_equal(tightened.conditions.E, goal.conditions.E)
    assert np.all(tightened.conditions.g <= goal.conditions.g)
    for (N, c), (same, more) in zip(goal.conditions.one_of, tightened.conditions.one_of, strict=True):
        assert np.array_equal(N, same) and np.all(more >= c)


@pytest.mark.parametrize("ideal", [True, False])
def test_velocity_change_beyond_the_printed_one_counts_more_without_errors_alone(ideal):
    """Less of U than in the printed schedule counts eleven times."""
    _, schedule = printed()
    rules = SwitchingRules(delta_v_price=0.1, switch_price=0.0)
    objective = Objective.beside(schedule, rules, schedule.safety)
    assert schedule.safety.problem.system.ideal
    objective = objective if ideal else replace(objective, delta_v=np.inf)
    share, spent, unit = schedule.share(), schedule.delta_v_middle, objective.scale
    same = objective.value({1: share}, spent, 0)
    assert objective.value({1: share}, spent + unit, 0) == pytest.approx(same - (10.1 if ideal else 0.1))
    assert objective.value({1: share - 0.01}, spent, 0) == pytest.approx(same - 0.11)


@pytest.mark.slow
def test_with_u_in_view_nothing_is_lost_in_many_scenes(folder):
    kept = changed = proven = 0
    seeds = range(fewer(150, 70))
    for seed in seeds:
        try:
            _, schedule, before = random_pair(seed, folder)
        except PolarisError:
            continue
        if before.guarantee != "proved":
            continue
        proven += 1
        kept += schedule.share() >= before.share() and schedule.delta_v[0] <= before.delta_v[0] + 1e-12
        changed += not np.array_equal(schedule.safety.reference.chi, before.safety.reference.chi)
        assert schedule.safety.end.until >= before.safety.end.until
    assert changed >= fewer(12, 0.04 * len(seeds)) and proven >= fewer(80, 0.4 * len(seeds))
    assert kept >= 0.7 * proven


def test_the_same_scenario_gives_the_same_schedule(folder):
    _, schedule, _ = random_pair(CHANGED[0], folder)
    _, again = random_schedule(CHANGED[0], folder)
    assert np.array_equal(schedule.modes, again.modes)
    assert np.array_equal(schedule.safety.reference.chi, again.safety.reference.chi)


def test_a_share_of_thrust_is_chosen_at_the_price_of_s_alone(monkeypatch):
    """Not at that of the reference that is found first, beside which velocity change seems cheap."""
    scenario, schedule = printed()
    safety = schedule.safety

    def found(share, spent):
        own = replace(safety, plan=replace(safety.plan, delta_v=spent))
        made = {"share": lambda mode=1: share, "delta_v_middle": spent, "switches": 2, "safety": own}
        known = {"controllers": schedule.controllers[:2], "keeps": lambda rules: rules.affords(spent)}
        return SimpleNamespace(**made, **known, approach=SimpleNamespace(reached=True))

    search, unit = (
        ScheduleSearch.from_scenario(scenario, safety, None, SwitchingRules(), None),
        safety.plan.delta_v,
    )
    for share, best in ((0.93, 0.9), (0.97, 0.97)):  # for as much more as S spends alone: 6 % of the time
        module = import_module("polaris.synthesis.schedule.synthesize")
        monkeypatch.setattr(module, "find_safety", lambda problem, like: safety)
        monkeypatch.setattr(module, "best_schedule", lambda *_, share=share: found(share, 4 * unit))
        assert module.best_share(search, found(0.9, 3 * unit), True).share() == best


def test_a_budget_comes_first():
    scenario, schedule = printed()
    free, tight = (
        Objective.beside(schedule, SwitchingRules(delta_v_max=budget), schedule.safety)
        for budget in (None, schedule.delta_v[1] / 2)
    )
    assert free(schedule)[0] and not tight(schedule)[0]
    assert scenario.switching_rules().delta_v_max is None


@pytest.mark.parametrize(
    "rules", [{"delta_v_price": -1.0}, {"switch_price": np.nan}, {"delta_v_max": 0.0}], ids=str
)
def test_prices_that_make_no_sense_are_refused(rules):
    with pytest.raises(ScenarioError, match="schedule"):
        SwitchingRules(**rules)


# -- the claims ---------------------------------------------------------------------------------------


def flights(schedule, n=60):
    return simulate(schedule, n, 3, tail=schedule.safety.reference.cells > schedule.safety.problem.K)


def check_claims(schedule):
    """Every flight keeps the bound on the velocity change and is as near to the goal as is claimed."""
    problem, arrival = schedule.safety.problem, schedule.arrival
    middle, bound = schedule.delta_v
    assert middle <= bound
    alone = simulate(schedule, 60, 3)
    assert alone.delta_v.max() <= bound * (1 + 1e-9)
    runs = flights(schedule)
    if arrival.by is None:
        return False
    node = round(arrival.by / schedule.safety.tracking.flow.h)
    goal = problem.goal.conditions
    rows = np.vstack([goal.E, -goal.E, goal.G, *(-N for N, _ in goal.one_of)])
    sides = np.concatenate([goal.e, -goal.e, goal.g, *(-c for _, c in goal.one_of)])
    weight = _weights(problem, rows)
    off = distance(goal, (runs.states[:, node] @ rows.T - sides) * weight)
    integrated = 1e-8 * np.abs(runs.states).max()
    assert off.max() <= arrival.distance + integrated and arrival.distance <= arrival.tolerance
    assert runs.delta_v.max() >= alone.delta_v.max() - 1e-12
    return True


@pytest.mark.parametrize("seed", SOME)
def test_no_flight_breaks_what_is_claimed(seed, folder):
    check_claims(random_pair(seed, folder)[1])


def test_the_goal_of_the_small_scene_is_reached():
    _, schedule = synthesised()
    assert check_claims(schedule)
    assert schedule.arrival.reached is True
    assert schedule.arrival.delta_v >= schedule.delta_v[1]


def test_a_goal_that_is_too_narrow_is_not_claimed():
    scenario, schedule = synthesised()
    narrow = replace(scenario.problem(), goal_tolerance=1e-9)
    tried = synthesize(narrow, experimental=[])
    assert tried.arrival.reached == "not_proven"
    assert tried.arrival.by is None and tried.arrival.distance > 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("name", ["static", "dynamic", "keep_out", "hold_point", "robot"])
def test_the_bundled_scenes_keep_their_claims(name):
    assert check_claims(synthesize(load_scenario(name)))
