"""Limits on the whole state: they contain what they stand for, are kept, and cannot be forged."""

import tomllib
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from polaris.certificate.checker import verify
from polaris.certificate.model.state_limits import directions as exact_directions
from polaris.model.errors import PolarisError, ScenarioError
from polaris.model.hill import clohessy_wiltshire
from polaris.model.scene.obstacle import directions
from polaris.model.scene.state_limits import (
    KeepInStates,
    SpeedLimit,
    SpeedPolygon,
    StateObstacle,
    covering_cosine,
)
from polaris.model.scene.turning import TurningKeepIn
from polaris.model.system import LinearSystem
from polaris.planning.goals import Box
from polaris.planning.problem import PlanProblem
from polaris.planning.recheck import path_bounds
from polaris.planning.reference import Reference
from polaris.planning.rows import PlanRows
from polaris.report.scene.items import drawn_pilots
from polaris.report.scene.timelines import proven_distance, schedule_timeline
from polaris.rta.arena import compare_methods
from polaris.rta.decision_grid import DecisionGrid
from polaris.rta.methods.asif_explicit import ExplicitASIF
from polaris.rta.methods.monitor import Monitor
from polaris.rta.recovery import Recovery
from polaris.runs.build_plot_data import schedule_plot_data
from polaris.runs.schedule import write_run
from polaris.scenario.reading import write_toml
from polaris.scenario.scenario import load_scenario
from polaris.simulation.falsification.claims import Claims, attained
from polaris.simulation.falsification.search import falsify
from polaris.simulation.simulate import simulate
from polaris.synthesis.schedule.synthesize import synthesize
from reach.numerics.linear import discretize
from tests.polaris.closed_loops import attack, attack_monitor
from tests.polaris.forging import COARSE, Forger, Lie, make
from tests.polaris.random_scenarios import random_scenario
from tests.polaris.tiny import TINY
from tests.sizes import fewer

SPEED = "{kind='speed',name='speed',max_m_s=0.8,per_distance_1_s=0.1,facets=8,towards=[[-3,-4],[4,3],[0,1]]}"
OCTAGON = "{kind='speed_polygon',name='octagon',max_m_s=1.1,sides=8,from_s=2.0,until_s=9.0}"
MIXED = "{kind='states',name='mixed',rows=[[0.1,0,1,0],[0,0,0.5,1]],bounds=[1.5,1.4],until_s=10.0}"
AWAY = "{kind='states',name='dash',rows=[[-1,0,0,0],[1,0,0,0],[0,0,-1,0]],bounds=[-2.5,6.5,-0.95],from_s=1.0}"
PILLAR = "{kind='box',name='pillar',center_m=[4.0,3.0],half_widths_m=[0.6,0.6]}"
SOFT = "tracking.R=[60,60]"
LIMITED = [f"keep_in=[{SPEED},{OCTAGON},{MIXED}]", f"obstacles=[{PILLAR},{AWAY}]", SOFT]
"""The tiny scene with a limit of every kind, one of which ends before T and one of which begins after 0."""


def random_limits(rng, system):
    """A limit of every kind on a system of second order, with random numbers."""
    n, d, count = system.n, system.d, int(rng.integers(1, 4))
    ways = {1: None, 2: int(rng.integers(3, 20)), 3: int(rng.choice([6, 14, 18, 26]))}[d]
    growth = float(rng.choice([0.0, rng.uniform(0.001, 0.5)]))
    aims = rng.normal(size=(count, d)) if rng.random() < 0.7 else None
    rows, bounds = rng.normal(size=(count, n)), rng.normal(size=count)
    yield KeepInStates("rows", rows, bounds)
    yield StateObstacle("out", rows, bounds)
    yield SpeedLimit("norm", rng.uniform(0.1, 2), growth, ways, aims)
    yield SpeedLimit("axes", rng.uniform(0.1, 2, d), growth, None, aims)
    if d > 1:
        axes = rng.choice(d, 2, replace=False).tolist()
        yield SpeedPolygon("polygon", rng.uniform(0.1, 2), int(rng.integers(3, 12)), axes)


def random_plant(rng):
    """A system of second order in one to three axes."""
    d = int(rng.integers(1, 4))
    if d == 3 and rng.random() < 0.5:
        return clohessy_wiltshire(10 ** rng.uniform(-4, -1.5), 10.0, 0.1, w_max=1e-4)
    zero, eye = np.zeros((d, d)), np.eye(d)
    A = np.block([[zero, eye], [rng.normal(size=(d, d)), rng.normal(size=(d, d))]])
    push = np.vstack([zero, eye])
    return LinearSystem(A, push, push, [1.0] * d, w_max=0.01)


@pytest.mark.parametrize("seed", range(20))
def test_all_of_what_is_unsafe_is_in_a_timed_polytope(seed):
    rng = np.random.default_rng(seed)
    system = random_plant(rng)
    x = rng.normal(size=(4000, system.n)) * 10 ** rng.uniform(-1, 1, (4000, 1))
    for limit in random_limits(rng, system):
        slack = limit.signed_distance(0.0, x, system)
        parts = limit.timed_polytopes(system, 2.0, 3)
        covered = [np.all(x @ part.rows(system).T <= part.offsets[0, 0], axis=1) for part in parts]
        unsafe = slack <= 0
        assert unsafe.any() or slack.min() > 0
        assert np.any(covered, axis=0)[unsafe].all(), limit.name
        if isinstance(limit, KeepInStates):  # nothing is added but rounding
            assert not np.any(covered, axis=0)[slack > 1e-6].any()


@pytest.mark.parametrize("d, count", [(1, 2), (2, 3), (2, 8), (2, 12), (3, 6), (3, 14), (3, 18), (3, 26)])
def test_the_covering_cosine_is_the_least_largest_cosine(d, count):
    requested = None if d == 1 else count
    e, c = directions(d, requested), covering_cosine(d, count)
    v = np.random.default_rng(0).normal(size=(200_000, d))
    cosines = (v / np.linalg.norm(v, axis=1, keepdims=True) @ e.T).max(axis=1)
    assert c - 1e-12 <= cosines.min() <= c + 0.02
    exact, cosine = exact_directions(d, requested)
    assert abs(float(cosine) - c) < 1e-14
    assert np.allclose([[float(x) for x in way] for way in exact], e, atol=1e-15)


@pytest.mark.parametrize("seed", range(12))
def test_bounds_on_rows_of_the_state_hold_between_waypoints(seed):
    rng = np.random.default_rng(seed)
    system = random_plant(rng)
    sets = tuple(s for limit in random_limits(rng, system) for s in limit.timed_polytopes(system, 0.8, 5))
    zero = tuple(np.zeros((5, len(s.normals))) for s in sets)
    goal = Box(np.zeros(system.n), np.full(system.n, np.inf))
    nu, x0 = rng.uniform(-1, 1, (5, system.m)), rng.normal(size=system.n)
    task = PlanProblem(system, x0, 5, 0.8, sets, zero, np.ones((5, system.m)), goal)
    path = Reference.propagate(system, 0.8, x0, nu)
    rows = PlanRows(task).surplus(path)
    for s, low, modelled in zip(sets, path_bounds(task, path), rows, strict=True):
        true = path.fine(160) @ s.rows(system).T - s.fine(160)
        least = true.min(axis=1)
        assert np.all(low <= least + 1e-9)
        assert np.all(low >= least - 1e-2 * (1 + np.abs(true).max()))
        assert np.all(modelled <= least + 1e-9 + 1e-3 * (np.abs(true).max()))


# -- proved, verified, flown ------------------------------------------------------------------------


@pytest.fixture(scope="module")
def limited():
    scenario = load_scenario(TINY, LIMITED)
    return scenario, synthesize(scenario)


def test_limits_bind_and_are_kept(limited):
    scenario, schedule = limited
    system, unsafe = scenario.system(), scenario.obstacles()
    assert schedule.guarantee == "proved" and 0 < schedule.share(1) < 1
    names = {step.margin.limit.partition("[")[0] for step in schedule.steps}
    assert names & {"speed", "octagon", "mixed", "dash"}
    free = synthesize(load_scenario(TINY, [SOFT]))
    limits = [item for item in unsafe if item.name in ("speed", "octagon", "mixed", "dash")]
    assert len(limits) == 4
    for about, safe in ((schedule, True), (free, False)):
        path = about.safety.reference
        x = path.fine(64)[: about.safety.problem.K]
        t = (np.arange(12)[:, None] + np.linspace(0, 1, 65)) * 1.0
        worst = min(float(item.signed_distance(t, x, system).min()) for item in limits)
        assert (worst > 0) == safe
    runs = simulate(schedule, 200, 1, tail=True, substeps=4)
    assert not runs.metrics().collided.any()
    for item in limits:
        assert item.signed_distance(runs.times, runs.states, system).min() > 0
    assert falsify(schedule, 1500, 0).failure is None


def test_diagrams_show_what_is_flown_and_no_more_than_is_proven(limited):
    """Speeds are those of the states, and no flight of 200 passes the line of what is proven."""
    scenario, schedule = limited
    system, picture = scenario.system(), schedule_plot_data(schedule)
    runs = simulate(schedule, 200, 2)
    assert {one.name for one in picture.state_limits} == {"speed", "octagon", "mixed", "dash"}
    panels = {
        panel.title.partition("limit ")[2].partition(",")[0]: panel
        for panel in schedule_timeline(picture, drawn_pilots(picture), True).panels
    }
    flights = picture.flights["polaris"]
    speed = next(one for one in panels["speed"].series if one.controller == "polaris")
    assert np.allclose(speed.values, np.linalg.norm(flights.states @ system.velocity.T, axis=-1))
    for limit in picture.state_limits:
        proven = proven_distance(picture, limit)
        assert proven.shape == picture.tube.intersample.shape[:2] and (proven > 0).any()
        slack = limit.signed_distance(runs.times, runs.states, system)
        cells = np.minimum(np.arange(len(runs.times)) * proven.size // (len(runs.times) - 1), proven.size - 1)
        bound = proven.ravel()[cells]
        holds = np.isfinite(slack).all(axis=0) & (bound < 1e6)
        assert holds.any() and (slack[:, holds] >= bound[holds] - 1e-9).all()
        line = next(one for one in panels[limit.name].series if "proven" in one.name)
        assert np.isfinite(line.values).any() and np.isnan(line.values).any() == (limit.name != "speed")


def test_limits_hold_at_every_hand_over(limited):
    """Worst cases of another integrator, in the midst of periods, too."""
    worst = attack(limited[1], 80, 0)
    assert worst.left.min() > 0 and worst.thrust >= 0 and worst.over <= 1e-6


@pytest.mark.parametrize(
    "limits, trust", [(f"keep_in=[{OCTAGON}]", "declared"), (f"obstacles=[{PILLAR},{AWAY}]", "thrust_limits")]
)
def test_limits_hold_under_an_online_monitor(limits, trust):
    schedule = synthesize(load_scenario(TINY, [SOFT, limits]))
    worst, share = attack_monitor(Monitor(DecisionGrid.from_schedule(schedule), trust), 40, 0)
    assert worst.left.min() > 0 and worst.thrust >= 0
    assert share > 0


def test_runs_that_leave_a_limit_are_judged_so(limited):
    scenario, schedule = limited
    free = synthesize(load_scenario(TINY))
    problem = schedule.safety.problem
    safety = replace(free.safety, problem=replace(free.safety.problem, unsafe=problem.unsafe))
    assert simulate(replace(free, safety=safety), 20, 1).metrics().collided.all()


class Thin(Claims):
    """Claims of a schedule about a set of states that lies between two nodes of a run."""

    unsafe = ()


def test_a_limit_that_is_left_between_two_nodes_alone_counts(limited):
    scenario, schedule = limited
    system, problem = scenario.system(), schedule.safety.problem
    runs = simulate(schedule, 5, 1)
    x = runs.states[0, :, 0]
    period = np.argmax(np.diff(x))
    middle, half = x[period : period + 2].mean(), 0.1 * np.diff(x)[period]
    thin = StateObstacle("thin", [[1, 0, 0, 0], [-1, 0, 0, 0]], [middle + half, half - middle])
    assert thin.signed_distance(runs.times, runs.states, system)[0].min() > 0
    safety = replace(schedule.safety, problem=replace(problem, unsafe=(thin,)))
    assert replace(runs, schedule=replace(schedule, safety=safety)).metrics().collided[0]
    claims = Thin(schedule, False)
    Thin.unsafe = thin.timed_polytopes(system, problem.delta, schedule.safety.reference.cells)
    margins = attained(claims, runs)
    assert margins.margin[0, 0] < 0
    assert abs(margins.when[0, 0] - runs.times[period]) < runs.times[1]


@pytest.fixture(scope="module")
def forger(tmp_path_factory):
    folder = tmp_path_factory.mktemp("limited")
    return Forger(make([*LIMITED, COARSE], folder), folder)


def test_an_honest_run_is_verified(forger):
    verdict = Lie(forger).verdict()
    assert verdict.outcome == "VERIFIED", verdict.text()
    assert any(line.startswith("limits on the whole state") for line in forger.honest["assumptions"])


def _sets(lie, name):
    return [item for item in lie.certificate["unsafe_sets"] if item["name"].partition("[")[0] == name]


def _moved(lie, name, change, cells=slice(None)):
    for item in _sets(lie, name):
        for pair in item["offsets"][cells]:
            for row in pair:
                row[:] = [change(float.fromhex(x)).hex() for x in row]


def _turned(lie, name, entry, by):
    normal = _sets(lie, name)[0]["normals"][0]
    normal[entry] = (float.fromhex(normal[entry]) + by).hex()


FORGERIES = {
    "bound widened": lambda lie: _moved(lie, "speed", lambda x: x - 0.1),
    "row of the speed altered": lambda lie: _turned(lie, "speed", 2, 1e-6),
    "growth altered": lambda lie: _turned(lie, "speed", 0, 1e-6),
    "row of states altered": lambda lie: _turned(lie, "mixed", 3, 1e-6),
    "side turned": lambda lie: _turned(lie, "octagon", 3, 1e-6),
    "window shortened": lambda lie: _moved(lie, "octagon", lambda x: -1e9, slice(8, 9)),
    "window begun late": lambda lie: _moved(lie, "dash", lambda x: -1e9, slice(1, 2)),
    "set to stay out of made smaller": lambda lie: _moved(lie, "dash", lambda x: x - 0.01),
    "of positions": lambda lie: [item.pop("of_state") for item in _sets(lie, "mixed")],
    "scenario without it": lambda lie: lie.scenario["keep_in"].pop(1),
    "scenario with another bound": lambda lie: lie.scenario["keep_in"][0].update(max_m_s=0.7),
    "scenario with another row": lambda lie: lie.scenario["keep_in"][2]["rows"][0].__setitem__(0, 0.11),
    "scenario with a longer window": lambda lie: lie.scenario["keep_in"][1].update(until_s=10.0),
    "scenario with an earlier one": lambda lie: lie.scenario["obstacles"][1].update(from_s=0.0),
    "scenario with a window that ends before it begins": lambda lie: lie.scenario["keep_in"][1].update(
        until_s=1.0
    ),
    "scenario with another direction of distance": lambda lie: lie.scenario["keep_in"][0]["towards"][
        0
    ].__setitem__(0, -2.9),
    "scenario with one direction less": lambda lie: lie.scenario["keep_in"][0]["towards"].pop(),
    "scenario with more sides": lambda lie: lie.scenario["keep_in"][1].update(sides=9),
    "scenario with other directions": lambda lie: lie.scenario["keep_in"][0].update(facets=9),
}


@pytest.mark.parametrize("name", FORGERIES)
def test_forgeries_are_refused(forger, name):
    lie = Lie(forger)
    FORGERIES[name](lie)
    lie.judge({"unsafe_sets", "format"})


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
@pytest.mark.parametrize(
    "key", ["max_m_s", "per_distance_1_s", "towards", "from_s", "until_s", "rows", "bounds"]
)
def test_numbers_of_limits_are_finite(forger, key, value):
    lie = Lie(forger)
    at = {"max_m_s": 0, "per_distance_1_s": 0, "towards": 0, "rows": 2, "bounds": 2}.get(key, 1)
    place = lie.scenario["keep_in"][at]
    while isinstance(place[key], list):
        place, key = place[key], 0
    place[key] = value
    lie.judge({"scenario"})
    assert lie.verdict().outcome == "REJECTED"


def test_a_limit_that_is_left_out_everywhere_but_in_the_scenario_is_missed(forger):
    lie = Lie(forger)
    data = lie.certificate
    remaining = [i for i, item in enumerate(data["unsafe_sets"]) if not item["name"].startswith("octagon")]
    data["unsafe_sets"] = [data["unsafe_sets"][i] for i in remaining]
    data["facets"] = [[row[i] for i in remaining] for row in data["facets"]]
    lie.judge({"unsafe_sets", "format"})


@pytest.mark.parametrize("seed", range(fewer(12, 2)))
def test_random_scenes_with_limits_are_proved_verified_and_kept_or_refused(seed, tmp_path):
    """Scenes are first synthesised without limits, to know which speeds their references have."""
    count = 0
    for attempt in range(40 * seed, 40 * seed + 40):
        rng, document = np.random.default_rng(attempt), tomllib.loads(random_scenario(attempt))
        path = tmp_path / "scene.toml"
        path.write_text(write_toml(document), encoding="utf-8")
        try:
            free = load_scenario(path)
            system, schedule = free.system(), synthesize(free)
            if np.any(system.position @ system.B) or np.any(system.position @ system.D):
                continue
            x = schedule.safety.reference.fine(8)[: free.steps]
            fast = float(np.linalg.norm(x @ system.velocity.T, axis=-1).max())
            T = free.steps * free.step
            extra = {"kind": "speed", "name": "speed", "max_m_s": fast * rng.uniform(0.7, 1.3)}
            if rng.random() < 0.5:
                extra["per_distance_1_s"] = extra["max_m_s"] / float(np.abs(x @ system.position.T).max())
                extra["max_m_s"] *= 0.5
            if rng.random() < 0.5:
                extra |= {"from_s": T * rng.uniform(0, 0.4), "until_s": T * rng.uniform(0.6, 1.0)}
            document.setdefault("keep_in", []).append(extra)
            document.setdefault("recoverable", {})["recourse"] = "none"
            path.write_text(write_toml(document), encoding="utf-8")
            scenario = load_scenario(path)
            schedule = synthesize(scenario)
        except PolarisError as error:
            assert error.exit_code in (2, 3, 4), attempt
            continue
        count += 1
        verdict = verify(write_run(tmp_path / f"run-{attempt}", scenario, schedule).path)
        assert verdict.exit_code in (0, 7) or schedule.guarantee == "none", (attempt, verdict.text())
        if schedule.guarantee == "proved":
            runs = simulate(schedule, 50, attempt, substeps=3)
            assert not runs.metrics().collided.any(), attempt
            assert falsify(schedule, 200, attempt).failure is None, attempt
            worst = attack(schedule, 40, attempt)
            assert worst.left.min() > 0 and worst.thrust >= 0, attempt
        break
    assert count


@pytest.mark.parametrize("limits", [f"keep_in=[{OCTAGON}]", f"obstacles=[{PILLAR},{AWAY}]"])
def test_methods_that_prove_keep_limits_between_nodes(limits):
    scenario = load_scenario(TINY, [SOFT, limits])
    compared = compare_methods(synthesize(scenario), 30, 0, methods=["monitor", "schedule", "experimental"])
    hit = {key: bool(each.metrics.collided.any()) for key, each in compared.results.items()}
    assert hit == {"monitor": False, "schedule": False, "experimental": True} and not compared.refused


@pytest.mark.parametrize("seed", range(8))
def test_rows_of_velocity_stray_from_their_chord_by_no_more_than_is_booked(limited, seed):
    """An input held over a period, and any disturbance in it."""
    _, schedule = limited
    recovery, rng = Recovery(DecisionGrid.from_schedule(schedule)), np.random.default_rng(seed)
    system, h, parts = recovery.grid.system, recovery.grid.h, 200
    rows = recovery.grid.clearance.obstacle_rows[0]
    phi, input_map = discretize(system.A, np.hstack([system.B, system.D]), h / parts)
    row = rows[rng.integers(len(rows))]
    way = system.D.T @ (np.sign(row @ system.B) @ system.B.T)
    w = system.w_max * way / np.linalg.norm(way)
    turn, u = rng.uniform(0, 1), rng.uniform(-2, 2, system.m) * system.u_max
    e, path = np.zeros(system.n), [np.zeros(system.n)]
    for i in range(parts):
        e = phi @ e + input_map @ np.r_[u, w if i < turn * parts else -w]
        path.append(e)
    path = np.array(path) @ rows.T
    deviation = np.abs(path - np.linspace(0, 1, parts + 1)[:, None] * path[-1]).max(axis=0)
    assert np.all(deviation <= recovery.intersample)


# -- sets that turn ---------------------------------------------------------------------------------

TURNING = (
    "keep_in=[{kind='turning',name='beam',normals=[[0,1],[0,-1],[1,0]],offsets_m=[2,2,9.5],"
    "rate_rad_s=0.07,rate_error_rad_s=0.002,angle_error_deg=0.5,from_s=1.0,until_s=11.0}]"
)
STILL = "keep_in=[{kind='speed',name='any',max_m_s=9.0}]"
TURNED = [TURNING, "obstacles=[]", SOFT, "goal.state=[5.0,6.5,0,0]"]


@pytest.mark.parametrize("seed", range(12))
def test_whoever_keeps_the_rows_of_a_set_that_turns_is_inside_it_whatever_its_errors(seed):
    rng = np.random.default_rng(seed)
    system = random_plant(rng)
    if system.d == 1:
        system = LinearSystem(
            np.kron([[0, 1], [0, 0]], np.eye(2)), np.eye(4)[:, 2:], np.eye(4)[:, 2:], [1, 1]
        )
    d, count = system.d, int(rng.integers(1, 5))
    axis = rng.normal(size=3) if d == 3 else None
    error, angle = rng.uniform(0, 0.01), rng.uniform(0, 0.2)
    begins, ends = sorted(rng.uniform(0, 10, 2))
    rate, sides = rng.uniform(-0.3, 0.3), (rng.normal(size=(count, d)), rng.normal(size=count))
    limit = TurningKeepIn("turns", *sides, rate, ends, axis, error, angle, begins)
    sets = limit.timed_polytopes(system, 1.0, 10)
    assert len(sets) == 3 * count
    unit = sides[0] / np.linalg.norm(sides[0], axis=1, keepdims=True)
    offsets = sides[1] / np.linalg.norm(sides[0], axis=1)
    x = rng.normal(size=(3000, system.n)) * 10 ** rng.uniform(-1, 1.5, (3000, 1))
    about = np.zeros((3, 3)) if axis is None else np.cross(np.eye(3), axis / np.linalg.norm(axis))
    tested = 0
    for k in range(10):
        outside = [np.all(x @ s.rows(system).T <= s.offsets[k, 0], axis=1) for s in sets]
        clear = x[~np.any(outside, axis=0)]
        low, high = max(k, begins), min(k + 1, ends)
        for t in rng.uniform(low, high, 20) if low < high else ():
            turn = rate * t + rng.choice([-1.0, -0.5, 0.0, 1.0]) * (angle + error * t)
            R = expm(turn * about) if d == 3 else expm(turn * np.array([[0.0, -1.0], [1.0, 0.0]]))
            inside = clear @ system.position.T @ R @ unit.T <= offsets
            assert inside.all()
            assert (limit.signed_distance(t, clear, system) > 0).all()
            tested += len(clear)
    assert tested or ends - begins < 1


@pytest.fixture(scope="module")
def turner(tmp_path_factory):
    folder = tmp_path_factory.mktemp("turned")
    return Forger(make([*TURNED, COARSE], folder), folder)


def test_a_set_that_turns_binds_and_is_kept():
    scenario = load_scenario(TINY, TURNED)
    schedule, free = synthesize(scenario), synthesize(load_scenario(TINY, [*TURNED, STILL]))
    assert schedule.guarantee == "proved" and schedule.share(1) > 0
    assert any(step.margin.limit.startswith("beam") for step in schedule.steps)
    (beam,), system = scenario.obstacles(), scenario.system()
    for about, safe in ((schedule, True), (free, False)):
        t = np.arange(12)[:, None] + np.linspace(0, 1, 33)
        x = about.safety.reference.fine(32)[:12]
        assert (beam.signed_distance(t, x, system).min() > 0) == safe
    assert not simulate(schedule, 200, 1, substeps=3).metrics().collided.any()
    assert falsify(schedule, 800, 0).failure is None


def _facet(lie, to):
    at = [item["name"] for item in lie.certificate["unsafe_sets"]].index("beam[1]")
    lie.certificate["facets"][5][at] = to


TURNS = {
    "another facet": lambda lie: _facet(lie, 5),
    "a row turned": lambda lie: _turned(lie, "beam", 1, 1e-6),
    "bound widened": lambda lie: _moved(lie, "beam", lambda x: x - 0.01 if abs(x) < 1e6 else x),
    "window shortened": lambda lie: _moved(lie, "beam", lambda x: -1e9, slice(10, 11)),
    "another rate": lambda lie: lie.scenario["keep_in"][0].update(rate_rad_s=0.0701),
    "a larger error of the rate": lambda lie: lie.scenario["keep_in"][0].update(rate_error_rad_s=0.0021),
    "a larger error of the angle": lambda lie: lie.scenario["keep_in"][0].update(angle_error_deg=0.51),
    "a longer window": lambda lie: lie.scenario["keep_in"][0].update(until_s=11.5),
    "a narrower side": lambda lie: lie.scenario["keep_in"][0]["offsets_m"].__setitem__(0, 1.9),
    "another side": lambda lie: lie.scenario["keep_in"][0]["normals"][1].__setitem__(0, 0.01),
    "a chaser with a size": lambda lie: lie.scenario.update(chaser={"radius_m": 0.01}),
}


@pytest.mark.parametrize("name", TURNS)
def test_forgeries_of_a_set_that_turns_are_refused(turner, name):
    lie = Lie(turner)
    TURNS[name](lie)
    lie.judge({"unsafe_sets", "format"})


def test_a_set_that_turns_is_verified_with_a_clock_and_a_chaser_too(turner, tmp_path):
    assert Lie(turner).verdict().outcome == "VERIFIED"
    more = [*TURNED, COARSE, "timing={clock_error_s=0.05}", "chaser={radius_m=0.05}"]
    verdict = verify(make(more, tmp_path))
    assert verdict.outcome == "VERIFIED", verdict.text()


# -- refusals ---------------------------------------------------------------------------------------

REFUSED = {
    "no second order": (
        ["system={kind='linear',A=[[0,0],[0,0]],B=[[1,0],[0,1]],D=[[1,0],[0,1]],input_max=1.0,position_states=[0,1]}",
         "initial_set={kind='box',center=[0,0],half_widths=[0.05,0.05]}", "tracking.Q=[1,1]",
         "goal.state=[8,6]", "experimental.0.Q=[1,1]", "keep_in=[{kind='speed',name='s',max_m_s=1.0}]"],
        "velocity that is part of the state",
    ),
    "another number of states": (["keep_in=[{kind='states',name='s',rows=[[1,0]],bounds=[9]}]"], "4 numbers"),
    "another number of bounds": (
        ["keep_in=[{kind='states',name='s',rows=[[1,0,0,0]],bounds=[9,9]}]"], "1 number"
    ),
    "speeds of three axes": (["keep_in=[{kind='speed',name='s',max_m_s=[2.0,2.0,2.0]}]"], "2 numbers"),
    "directions in space": (
        ["keep_in=[{kind='speed',name='s',max_m_s=2.0,per_distance_1_s=0.1,towards=[[1,0,0]]}]"], "2 numbers"
    ),
    "directions that are none": (
        ["keep_in=[{kind='speed',name='s',max_m_s=2.0,per_distance_1_s=0.1,towards=[[0,0]]}]"], "row of zeros"
    ),
    "a drift beside a set that turns": ([*TURNED, "abort={drift_s=5.0}"], "drifts and aborts are not proven"),
    "a set that turns too far": ([*TURNED, "keep_in.0.rate_rad_s=2.5"], "shorter steps"),
    "an axis in the plane": ([*TURNED, "keep_in.0.axis=[0,1]"], "left out in the plane"),
    "balls": ([*LIMITED, "recoverable.kind=ball"], "must be 'polytope'"),
    "a row of zeros": (["keep_in=[{kind='states',name='s',rows=[[0,0,0,0]],bounds=[9]}]"], "row of zeros"),
    "an axis that there is not": (
        ["keep_in=[{kind='speed_polygon',name='s',max_m_s=2.0,axes=[0,2]}]"], "two of the 2 axes"
    ),
    "ends before it begins": (
        ["keep_in=[{kind='speed',name='s',max_m_s=2.0,from_s=3.0,until_s=3.0}]"], "after from_s"
    ),
    "ends after the horizon": (
        ["keep_in=[{kind='speed',name='s',max_m_s=2.0,until_s=13.0}]"], "within duration_s"
    ),
    "a start beyond it": (
        ["keep_in=[{kind='states',name='s',rows=[[-1,0,0,0]],bounds=[-1]}]"], "must be a state that keep_in"
    ),
    "a goal beyond it": (
        ["keep_in=[{kind='states',name='s',rows=[[1,0,0,0]],bounds=[7]}]"], "must be a state that keep_in"
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_meant_is_refused(name):
    overrides, reason = REFUSED[name]
    with pytest.raises(ScenarioError, match=reason):
        scenario = load_scenario(TINY, overrides)
        scenario.obstacles()[-1].timed_polytopes(scenario.system(), 1.0, 1)
        synthesize(scenario)


def test_a_limit_that_no_plan_keeps_says_so():
    scenario = load_scenario(TINY, ["keep_in=[{kind='speed',name='slow',max_m_s=0.4}]"])
    with pytest.raises(PolarisError, match="not with the margins required.*1 m/s counting as 100 m") as error:
        synthesize(scenario)
    assert error.value.exit_code == 3


def test_a_filter_that_brakes_before_walls_refuses_limits_of_states(limited):
    _, schedule = limited
    with pytest.raises(ScenarioError, match="limits the whole state"):
        ExplicitASIF(DecisionGrid.from_schedule(schedule))
