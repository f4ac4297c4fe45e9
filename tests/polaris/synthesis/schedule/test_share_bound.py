"""The bound on the share of U over all schedules (Proposition 13): below nothing that can be flown."""

from dataclasses import replace
from functools import cache
from itertools import combinations, product
from types import SimpleNamespace

import numpy as np
import pytest

from polaris import AffineController, AnyThrust, PolarisError, SwitchingRules, load_scenario, synthesize
from polaris.planning.lp import GrowingLP
from polaris.synthesis.schedule.share_bound import Master, share_bound
from polaris.synthesis.schedule.undisturbed import FREE, UndisturbedFlights, _Clear
from reach import discretize
from tests.kept import printed as bundled
from tests.kept import quick
from tests.polaris.random_scenarios import synthesised as random_schedule
from tests.polaris.tiny import TINY
from tests.sizes import fewer


@cache
def printed(*more):
    scenario = load_scenario(TINY, ["recoverable.recourse=none", *more])
    return scenario, synthesize(scenario)


def flights_of(problem, law, modes, count, seed):
    """Undisturbed flights at the ends of the steps, shape (count, K, n): random thrust where it is free."""
    rng = np.random.default_rng(seed)
    system, K, m = problem.system, problem.K, problem.system.m
    parts = law.feedback.nodes_per_cell
    A, B = discretize(system.A, system.B, problem.delta / parts)
    path = law.own.fine(parts)
    x = np.repeat(np.asarray(problem.initial_set.c)[None], count, axis=0)
    states = np.zeros((count, K, system.n))
    one = rng.uniform(-1.5, 1.5, (count, 1, m)).clip(-1, 1)
    each = rng.uniform(-1.5, 1.5, (count, K, m)).clip(-1, 1)
    thrust = np.where(rng.random((count, 1, 1)) < 0.5, one, each)
    changes, at = rng.random((count, K)) < 0.3, rng.random((count, K))
    for k in range(K):
        for j in range(parts):
            if modes[k] == FREE:
                sign = np.where(changes[:, k] & (at[:, k] * parts < j), -1.0, 1.0)
                u = thrust[:, k] * system.u_max * sign[:, None]
            else:
                u = np.clip(law.own.nu[k] + (path[k, j] - x) @ law.gain.T, -system.u_max, system.u_max)
            x = x @ A.T + u @ B.T
        states[:, k] = x
    return states


@pytest.mark.parametrize("more", [(), ("feedback={period_s=0.25}",)], ids=["chosen", "given"])
@pytest.mark.parametrize("times", [1.0, 4.0])
def test_every_flight_lies_in_what_is_enclosed(more, times):
    _, schedule = printed(*more)
    problem, law = schedule.safety.problem, schedule.controllers[1]
    law = replace(law, gain=times * law.gain)
    flights, rng, clipped = UndisturbedFlights(schedule.safety, [law]), np.random.default_rng(5), 0
    for seed in range(6):
        modes = tuple(np.where(rng.random(problem.K) < 0.35, FREE, 1).tolist())
        c, G, _ = flights.propagate(modes)
        states = flights_of(problem, law, modes, 200, seed)
        rows = rng.normal(size=(40, problem.system.n))
        clearance = c @ rows.T + np.abs(rows @ G).sum(axis=2)
        assert np.all(states[:, : len(c)] @ rows.T <= clearance + 1e-9)
        assert times > 1 or len(c) == problem.K
        corrections = np.abs((states - law.own.chi[1:]) @ law.gain.T).max(axis=(0, 2))
        clipped += int(np.sum(corrections[:-1][np.array(modes[1:]) == 1] > problem.system.u_max.max()))
    assert clipped > 10, "the clip has something to do"


def test_the_word_of_a_solver_is_not_enough(monkeypatch):
    _, schedule = printed()
    flights, K = UndisturbedFlights(schedule.safety, schedule.controllers[1:]), schedule.safety.problem.K
    free = (FREE,) * K
    assert not flights.impossible(free)
    monkeypatch.setattr(GrowingLP, "solve", lambda self, seconds: None)
    for weights in (np.zeros, np.ones, lambda count: -np.ones(count)):
        monkeypatch.setattr(GrowingLP, "ray", lambda self, ray=weights: ray(self.rows))
        assert not flights.impossible(free)


def test_nothing_that_can_be_flown_is_called_impossible():
    scenario, schedule = printed("feedback={period_s=0.25}")
    problem, law = schedule.safety.problem, schedule.controllers[1]
    flights, rng = UndisturbedFlights(schedule.safety, [law]), np.random.default_rng(1)
    steps, refuted, fewest = range(problem.K), 0, problem.K
    sets = [free for count in range(3) for free in combinations(steps, count)]
    sets += [np.flatnonzero(rng.random(problem.K) < 0.4).tolist() for _ in range(20)]
    for i, free in enumerate(sets):
        modes = tuple(FREE if k in free else 1 for k in steps)
        impossible, clearance = flights.impossible(modes), np.inf
        states = flights_of(problem, law, modes, 250, i)
        for rows, offsets in zip(flights.rows, flights.offsets, strict=True):
            clearance = np.minimum(clearance, (states @ rows.T - offsets).max(axis=2).min(axis=1))
        if clearance.max() > 0.02:
            assert not impossible, free
            fewest = min(fewest, len(free))
        refuted += impossible
        if impossible:
            wide = flights.widened(modes)
            assert flights.impossible(wide), "still, and demands no less"
            assert all(mode in (FREE, modes[k]) for k, mode in enumerate(wide))
    bound = share_bound(schedule, scenario.switching_rules(), 400)
    assert refuted > 5 and bound.ended == "reached" and bound.share == 1 - fewest / problem.K


def test_every_side_of_every_set_is_tried():
    """Along a line the near sides of some sets lead into others; beyond them there is a way, or none."""
    sides, c, G = np.array([[1.0], [-1.0]]), np.array([[0.1]]), np.array([[[3.0]]])
    near = [[1.0, 1.0], [2.9, -0.5], [3.05, -2.0], [3.2, -3.0]]  # clear of each: x above, or -x above
    for sets, refuted in ((near, False), ([*near, [-0.5, 9.0]], True)):
        flights = SimpleNamespace(system=SimpleNamespace(position=np.eye(1)), rows=[sides] * len(sets))
        flights.offsets = [np.array([each]) for each in sets]
        assert _Clear(flights, c, G, np.array([[3.1]])).impossible() is refuted


def kept(modes, rules, demands):
    """Return True if modes keep the dwell time between switches, the cap, and every demand."""
    edges = [k for k in range(1, len(modes)) if modes[k] != modes[k - 1]]
    cap = rules.max_switches
    dwelt = all(b - a >= rules.min_dwell for a, b in zip(edges, edges[1:], strict=False))
    within = cap is None or len(edges) + (modes[-1] != FREE) <= cap
    return dwelt and within and all(any(f not in (FREE, m) for f, m in zip(d, modes)) for d in demands)  # noqa: B905


@pytest.mark.parametrize("seed", range(12))
def test_the_integer_program_finds_the_fewest_steps(seed):
    rng = np.random.default_rng(seed)
    K, modes = 7, int(rng.integers(2, 4))
    cap = None if rng.random() < 0.4 else int(rng.integers(0, 5))
    rules = SwitchingRules(min_dwell=int(rng.integers(1, 4)), max_switches=cap)
    master, demands = Master(K, modes, rules), []
    for _ in range(6):
        demand = tuple(np.where(rng.random(K) < 0.5, FREE, rng.integers(1, modes, K)).tolist())
        if any(demand):
            demands.append(demand[: int(rng.integers(3, K + 1))])
        demands = [demand for demand in demands if any(demand)]
    for demand in demands:
        master.demand(demand)
    every = [m for m in product(range(modes), repeat=K) if kept(m, rules, demands)]
    fewest, chosen = master.solve()
    assert fewest == min((m.count(FREE) for m in every), default=K + 1)
    assert chosen is None if not every else chosen in every
    objectives = (0.0, *rng.choice([0.5, 1.0, 2.0], modes - 1))
    best = max((sum(objectives[mode] for mode in m) / K for m in every), default=0.0)
    assert best <= master.objective_bound(objectives) <= best + 1e-3


@pytest.mark.parametrize("name", ["static", pytest.param("dynamic", marks=pytest.mark.slow)])
def test_where_u_alone_collides_less_than_everything_is_reached(name):
    scenario, schedule = bundled(name, *quick(name))
    bound = share_bound(schedule, scenario.switching_rules(), scenario.model.schedule.bound_programs)
    assert schedule.share() <= bound.share == 58 / 60
    assert bound.ended == "reached" and bound.programs < 100


MANY = range(fewer(150, 43)), fewer(80, 17), fewer(8, 1)


@pytest.mark.parametrize(
    ("seeds", "least", "below"), [([70, 37], 2, 1), pytest.param(*MANY, marks=pytest.mark.slow)]
)
def test_no_schedule_of_random_scenes_beats_the_bound(seeds, least, below, tmp_path):
    bounds = []
    for seed in seeds:
        try:
            scenario, schedule = random_schedule(seed, tmp_path)
        except PolarisError:
            continue
        if schedule.guarantee == "proved":
            bounds.append(share_bound(schedule, scenario.switching_rules(), 200).share)
            assert schedule.share() <= bounds[-1], seed
    assert len(bounds) >= least and np.sum(np.array(bounds) < 1) >= below


def test_more_effort_bounds_no_less():
    scenario, schedule = printed()
    rules = scenario.switching_rules()
    bounds = [share_bound(schedule, rules, limit) for limit in (0, 1, 5, 400)]
    shares = [bound.share for bound in bounds]
    assert shares == sorted(shares, reverse=True) and shares[0] == 1 > shares[-1]
    assert share_bound(schedule, rules, 400) == bounds[-1]
    assert share_bound(schedule, SwitchingRules(max_switches=0), 400).share == 0


def test_a_law_without_a_path_of_its_own_bounds_nothing():
    scenario, schedule = printed()
    safety, law = schedule.safety, schedule.controllers[1]
    assert isinstance(law, AffineController)
    free = AnyThrust("any", law.system, safety.reference, safety.tracking)
    sharing = replace(law, own=safety.reference)
    for other in (free, sharing):
        both = replace(schedule, controllers=(*schedule.controllers, other))
        assert share_bound(both, scenario.switching_rules(), 400).share == 1


def test_the_unsafe_sets_are_those_that_the_proof_keeps_clear_of():
    scenario, schedule = printed()
    safety, rules = schedule.safety, scenario.switching_rules()
    shifted = tuple(replace(unsafe, offsets=unsafe.offsets - 100.0) for unsafe in safety.clearance.unsafe)
    clear = replace(safety, clearance=replace(safety.clearance, unsafe=shifted))
    assert share_bound(schedule, rules, 400).share < 1
    assert share_bound(replace(schedule, safety=clear), rules, 400).share == 1
