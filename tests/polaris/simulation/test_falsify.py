"""The search for counterexamples: nothing where the claim holds, and everything broken on purpose."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from typer.testing import CliRunner

from polaris.cli.app import app
from polaris.model.errors import ScenarioError
from polaris.runs.case import load_target, replay, write_case
from polaris.runs.schedule import digest, write_run
from polaris.scenario.scenario import load_scenario
from polaris.simulation.disturbances import adjoint_worst_case
from polaris.simulation.falsification.attacks import Attack, Attacker
from polaris.simulation.falsification.claims import EXACT_M, Claims, attained
from polaris.simulation.falsification.search import falsify
from polaris.simulation.integration import Integrator, columns
from polaris.synthesis.controllers.controllers import AnyThrust
from polaris.synthesis.controllers.neural import NeuralController
from polaris.synthesis.controllers.policy import Policy
from polaris.synthesis.safety.carried_rows import error_tube
from polaris.synthesis.safety.get_safety import get_safety
from polaris.synthesis.schedule.synthesize import synthesize
from reach.networks.layers import Activation, Affine
from reach.networks.network import Network
from tests.kept import CHOSEN, printed, quick
from tests.paper.printed_ball import take_printed_balls
from tests.polaris.conftest import synthesised
from tests.polaris.tiny import TINY
from tests.polaris.tiny import flown as tiny_flown
from tests.polaris.tiny import synthesised as tiny
from tests.sizes import fewer

BUNDLED = ["static", "dynamic", "keep_out", "hold_point", "robot"]
STIFF = {"recoverable.recourse": "none", "tracking.R": [400.0] * 3}
"""The printed balls do not know the thrust limits; a stiff tracker runs into them."""


@cache
def with_black_box():
    """A schedule in which a controller flies that may do anything."""
    weak = ["tracking.Q=[1,1,1,1]", "tracking.R=[8,8]", "horizon.step_s=0.25", "planner.thrust_reserve=0.5"]
    return synthesize(load_scenario(TINY, ["experimental.0={kind='any_thrust',name='any'}", *weak]))


def flight_of(schedule, tail=False, substeps=1):
    claims = Claims(schedule, tail)
    return claims, Integrator(schedule, claims.modes, substeps)


# -- where the claim holds --------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.slow] * (n != "static")) for n in BUNDLED]
)
def test_nothing_breaks_a_proven_schedule(name):
    schedule = synthesised(name, *quick(name))[1]
    result = falsify(schedule, 250, seed=1)
    assert result.failure is None and result.runs == 250
    obstacles = len(schedule.safety.clearance.unsafe)
    assert np.all(result.least[:obstacles] >= result.proven[:obstacles] - EXACT_M)
    assert np.all(result.least >= 0)


def test_the_bound_is_neither_violated_nor_idle():
    result = falsify(printed("static", CHOSEN)[1], 1500, seed=0)
    assert 0.6 < result.ratio[0] <= 1, "the debris is approached to within what the proof leaves open"


@pytest.mark.slow
@pytest.mark.parametrize("name", BUNDLED)
def test_many_trajectories_violate_nothing(name):
    """20,000 of each of five scenes; a million in a campaign."""
    count = fewer(200_000, 20_000)
    result = falsify(synthesised(name)[1], count, seed=7)
    summary = result.summary()
    print(f"\n{name}: {result.runs} trajectories, {summary['runs_per_s']:.0f} per second")
    for row in summary["limits"]:
        least, proven = row["least"], row["proven"]
        print(f"  {row['limit']:20} {least:10.4g} of {proven:10.4g} {row['proven_share']:6.1%}")
    assert result.failure is None and result.runs == count


def test_same_seed_same_search():
    first, second = (falsify(tiny()[1], 300, seed=3) for _ in range(2))
    assert np.array_equal(first.least, second.least)
    assert not np.array_equal(first.least, falsify(tiny()[1], 300, seed=4).least)


# -- the attacks ------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["static", pytest.param("hold_point", marks=pytest.mark.slow)])
def test_adjoint_reaches_what_the_tube_of_s_allows(name):
    """No run goes further along a row than the tube, and the closed-form worst case nearly gets there."""
    schedule = synthesised(name, *quick(name))[1]
    safety = schedule.safety
    modes = np.zeros(12, dtype=int)
    flight = Integrator(schedule, modes, 1)
    rows = np.array([[1.0, 0, 0, 0, 0, 0], [0, -1.0, 0, 0, 0, 0], [0, 0, 1.0, 0, 0, 0]])
    w, free, adjoint = adjoint_worst_case(flight, rows, np.full(3, flight.steps))
    assert free is None
    theta = safety.problem.initial_set
    x0 = theta.c + np.sign(adjoint @ theta.G) @ theta.G.T
    ends = Attack(x0, w, None).fly(flight).states[:, -1] - safety.clearance.nodes[11, -1]
    reached = np.einsum("ij,ij->i", ends, rows)
    allowed = error_tube(safety.tracking, safety.start, rows).tightening
    allowed = allowed[min(flight.steps, len(allowed) - 1)]
    assert np.all(reached <= allowed)
    assert np.all(reached >= 0.8 * allowed)
    rng = np.random.default_rng(0)
    tried = rng.normal(size=(flight.steps, 500, 3))
    tried *= safety.problem.system.w_max / np.linalg.norm(tried, axis=2, keepdims=True)
    others = Attack(np.repeat(x0[:1], 500, axis=0), tried, None).fly(flight).states[:, -1]
    assert np.all((others - safety.clearance.nodes[11, -1]) @ rows[0] < reached[0])


def test_disturbances_and_starts_are_admissible():
    schedule = with_black_box()
    claims, flight = flight_of(schedule)
    attacker = Attacker(claims, flight, np.random.default_rng(0))
    first = attacker.worst(40)
    runs = first.fly(flight)
    measured = attained(claims, runs)
    made = [first, attacker.random(40), attacker.again(runs, measured, 40), attacker.mutate(first, 40)]
    system, theta = flight.system, schedule.safety.problem.initial_set
    for attack in made:
        assert np.linalg.norm(attack.w, axis=-1).max() <= system.w_max * (1 + 1e-12)
        assert attack.free is not None and np.all(np.abs(attack.free) <= system.u_max)
        assert theta.contains(attack.x0).all()


def test_black_box_does_what_the_attack_says():
    schedule = with_black_box()
    k = int(np.flatnonzero(schedule.modes == 1)[0])
    claims, flight = flight_of(schedule)
    attack = Attacker(claims, flight, np.random.default_rng(0)).worst(5)
    runs = attack.fly(flight)
    q = schedule.safety.clearance.q
    assert np.array_equal(runs.inputs[:, k * q], attack.free[k * flight.steps_per_cell])


def test_margins_are_those_of_the_timed_polytopes_between_nodes_too():
    schedule = printed("static", CHOSEN)[1]
    claims, coarse = flight_of(schedule)
    box = schedule.safety.problem.unsafe[0]
    attack = Attacker(claims, coarse, np.random.default_rng(0)).worst(60)
    measured = attained(claims, attack.fly(coarse))
    fine = Integrator(schedule, claims.modes, 16)
    fine_attack = Attack(attack.x0, np.repeat(attack.w, 16, axis=0), None)
    x = attack.x0
    nearest = np.full(len(x), np.inf)
    for step in range(fine.steps):
        k, sub = divmod(step, fine.steps_per_cell)
        if sub % 16 == 0:
            limit = fine.system.u_max
            u = np.clip(fine.command(int(claims.modes[k]), k, sub, x), -limit, limit)

        def rate(state, u=u, w=fine_attack.w[step]):
            return state @ fine.system.A.T + u @ fine.system.B.T + w @ fine.system.D.T

        x = x + fine.dt * rate(x + fine.dt / 2 * rate(x))
        outside = np.max(np.abs(x[:, :3] - box.anchor) - np.asarray(box.half_widths), axis=1)
        nearest = np.minimum(nearest, outside)
    assert np.allclose(measured.margin[:, 0], nearest, atol=0.02)


# -- what was broken on purpose -----------------------------------------------------------------------


@pytest.mark.slow
def test_printed_ball_without_thrust_limits_is_caught(tmp_path, monkeypatch):
    take_printed_balls(monkeypatch)
    scenario = load_scenario("static").with_overrides(STIFF)
    schedule = synthesize(scenario)
    result = falsify(schedule, 3000)
    assert result.failure is not None and result.failure.kind == "saturation"
    assert result.failure.margin < 0 and result.runs < 3000
    path = write_case(tmp_path / "ball.json", scenario, result)
    failure, again = replay(path)
    assert failure == result.failure and again.to_dict() == scenario.to_dict()
    done = CliRunner().invoke(app, ["replay", str(path)])
    assert done.exit_code == 5 and f"at t = {result.failure.time_s:g} s" in done.stdout


def test_a_schedule_that_ignores_its_proof_collides():
    schedule = synthesised("static", CHOSEN)[1]
    step = next(step for step in schedule.steps if step.mode == 1)
    reckless = replace(schedule, steps=tuple(replace(s, mode=step.mode) for s in schedule.steps))
    result = falsify(reckless, 500)
    assert result.failure is not None and result.failure.kind == "unsafe set"
    assert result.failure.limit == "debris" and result.failure.margin < 0


def test_a_tube_that_is_too_thin_is_caught():
    scenario, schedule = tiny()
    thin = tuple(
        replace(
            step,
            tube=replace(
                step.tube,
                states=replace(step.tube.states, G=0.3 * step.tube.states.G),
                intersample=0 * step.tube.intersample,
            ),
        )
        for step in schedule.steps
    )
    assert falsify(schedule, 600).failure is None
    result = falsify(replace(schedule, steps=thin), 600)
    assert result.failure is not None and result.failure.kind == "margin"
    assert result.failure.margin > 0, "it enters nothing; it only comes closer than was claimed"


def springy(**more):
    """A schedule whose network swings about the reference, and claims 60 % of its tubes after a while."""
    scenario, _ = tiny()
    sampled = {"feedback": {"period_s": 0.25}, "tracking.R": [60.0, 60.0]}
    safety = get_safety(scenario.with_overrides(sampled | more))
    system, eye = safety.problem.system, np.eye(2)
    layers = (
        Affine(np.hstack([2 * eye, 0.1 * eye]), np.zeros(2)),
        Activation("tanh"),
        Affine(eye, np.zeros(2)),
    )
    policy = Policy(Network(layers), ("error",), np.ones(4), np.ones(2))
    law = NeuralController("spring", system, policy, *[safety.reference] * 2, safety.tracking)
    made, start = synthesize(safety, experimental=[law]), safety.start
    steps = []
    for k, step in enumerate(made.steps):
        tube = law.propagate(start, k)
        start = tube.end
        nodes = replace(tube.nodes, G=(THIN if k > 6 else 1) * tube.nodes.G)
        steps.append(replace(step, mode=1, tube=replace(tube, states=nodes)))
    safety = replace(made.safety, end=replace(made.safety.end, horizon="none"))
    return replace(made, steps=tuple(steps), safety=safety)


THIN = 0.6


def test_gradients_of_a_network_are_those_of_its_flights():
    schedule = springy()
    flight = flight_of(schedule)[1]
    rows, middle = np.eye(4), schedule.safety.problem.initial_set.c
    for target in (flight.steps // 2, flight.steps):
        _, _, adjoint = adjoint_worst_case(flight, rows, np.full(4, target))
        x0 = middle + 1e-5 * np.vstack([np.eye(4), -np.eye(4)])
        ends = flight.run(x0, np.zeros((flight.steps, 8, flight.system.p))).states[:, target]
        assert adjoint == pytest.approx((ends[:4] - ends[4:]).T / 2e-5, rel=1e-4, abs=1e-6)


def test_errors_of_estimates_are_steered_through_a_network():
    schedule = springy(navigation={"state_error": [0.01, 0.01, 0.002, 0.002]})
    flight = flight_of(schedule)[1]
    rows, theta = np.vstack([np.eye(4), -np.eye(4)]), schedule.safety.problem.initial_set
    w, _, _ = adjoint_worst_case(flight, rows, np.full(8, flight.steps))
    w *= 1e-3  # worst to first order: about the undisturbed flight
    x0 = np.repeat(theta.c[None], 8, axis=0)
    eta, rng = columns(flight.system)[1], np.random.default_rng(0)
    # What an axis knows of itself does not matter to the other.
    assert np.all((np.abs(w[..., eta]) == 1e-3 * flight.system.navigation).sum(axis=2) == 2)

    def reached(w):
        return np.einsum("ij,ij->i", flight.run(x0, w).states[:, -1], rows)

    other = w.copy()
    for _ in range(5):
        other[..., eta] = np.abs(w[..., eta]) * rng.choice([-1.0, 1.0], w[..., eta].shape)
        assert np.all(reached(w) > reached(other) + 1e-5)


def test_gradients_of_a_network_find_what_chance_does_not(monkeypatch):
    schedule = springy()
    result = falsify(schedule, 300)
    assert result.failure is not None and result.failure.kind == "margin"
    claims, flight = flight_of(schedule)
    chance = Attacker(claims, flight, np.random.default_rng(0)).random(3000)
    assert attained(claims, chance.fly(flight)).below.max() < -EXACT_M
    monkeypatch.setattr(NeuralController, "pullback", lambda law, k, own, x, weights, later=0.0: x[:, :4] * 0)
    assert falsify(schedule, 3000).failure is None, "nor does the whole search without them"


def test_a_disturbance_beyond_its_bound_breaks_the_margin():
    """The claim rests on the bound: with ten times the disturbance the same search gets through."""
    schedule = synthesised("static", CHOSEN)[1]
    claims, flight = flight_of(schedule)
    attack = Attacker(claims, flight, np.random.default_rng(0)).worst(100)
    assert attained(claims, attack.fly(flight)).below.max() <= EXACT_M
    stronger = Attack(attack.x0, 40 * attack.w, None)
    assert attained(claims, stronger.fly(flight)).below.max() > EXACT_M


# -- files and commands -----------------------------------------------------------------------------


def test_where_there_is_nothing_to_hit_the_thrust_limits_are_attacked():
    scenario, schedule = tiny()
    safety = get_safety(replace(schedule.safety.problem, unsafe=()))
    law = AnyThrust("anything", scenario.system(), safety.reference, safety.tracking)
    result = falsify(synthesize(safety, experimental=[law]), 200)
    assert result.failure is None and result.names == scenario.system().input_names
    assert (result.proven <= result.least).all()


def test_case_that_was_changed_is_refused(tmp_path):
    scenario, schedule = tiny()
    result = falsify(replace(schedule, steps=tuple(replace(s, mode=1) for s in schedule.steps)), 400)
    assert result.failure is not None
    data = json.loads(write_case(tmp_path / "case.json", scenario, result).read_text(encoding="utf-8"))
    assert data["x0"] == result.case[0].x0[0].tolist()
    changes = {"schedule": ["0" * 64], "version": [1], "format": ["other"]}
    changes["x0"] = [["nan?"], [None] * len(data["x0"])]
    changes |= {"violation": [{**data["violation"], "kind": "abort"}, {}], "failing": [{"begins": 0}]}
    for key, value in ((key, value) for key, values in changes.items() for value in values):
        broken = tmp_path / f"{key}.json"
        changed = {**data, "schedule": digest(schedule), key: value}
        broken.write_text(json.dumps(changed), encoding="utf-8")
        assert CliRunner().invoke(app, ["replay", str(broken)]).exit_code == 2
    # The same attack on the schedule that is really made violates nothing.
    fair = tmp_path / "fair.json"
    fair.write_text(json.dumps({**data, "schedule": digest(schedule)}), encoding="utf-8")
    done = CliRunner().invoke(app, ["replay", str(fair)])
    assert done.exit_code == 0 and "no violation in this case" in done.stdout
    with pytest.raises(ScenarioError, match="must come from a search that found a violation"):
        write_case(tmp_path / "none.json", scenario, falsify(schedule, 50))


def test_run_folder_is_attacked_if_nothing_in_it_was_changed(tmp_path):
    scenario, schedule = tiny()
    folder = write_run(tmp_path / "run", scenario, schedule, tiny_flown()).path
    loaded = load_target(str(folder))
    assert digest(loaded.schedule()) == digest(schedule) and loaded.scenario.name == scenario.name
    file = folder / "schedule.json"
    data = json.loads(file.read_text(encoding="utf-8"))
    data["modes"][0] = 1 - data["modes"][0]
    file.write_text(json.dumps(data), encoding="utf-8")
    with pytest.raises(ScenarioError, match="edited or damaged"):
        load_target(str(folder))
    (folder / "certificate.json").unlink()
    with pytest.raises(ScenarioError, match="has no certificate.json"):
        load_target(str(folder)).schedule()


def test_command_reports_margins_and_saves_a_case(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(app, ["falsify", str(TINY), "--runs", "200", "--json"])
    assert done.exit_code == 0
    summary = json.loads(done.stdout)
    assert summary["runs"] == 200 and not summary["violated"] and len(summary["limits"]) >= 3
    take_printed_balls(monkeypatch)
    scenario = load_scenario("static").with_overrides(STIFF)
    (tmp_path / "stiff.toml").write_text(scenario.to_toml(), encoding="utf-8")
    done = CliRunner().invoke(app, ["falsify", "stiff.toml", "--runs", "3000", "--out", "found.json"])
    assert done.exit_code == 5 and "VIOLATED" in done.stdout
    assert (tmp_path / "found.json").is_file()


def test_command_attacks_a_scenario_with_other_values_but_never_a_run_folder(tmp_path):
    given = ["--set", "navigation.state_error=[0.01, 0, 0, 0]", "--runs", "100", "--json"]
    done = CliRunner().invoke(app, ["falsify", str(TINY), *given])
    plain = CliRunner().invoke(app, ["falsify", str(TINY), *given[2:]])
    assert done.exit_code == 0 and json.loads(done.stdout)["limits"] != json.loads(plain.stdout)["limits"]
    refused = CliRunner().invoke(app, ["falsify", str(tmp_path), *given])
    assert refused.exit_code == 2 and "--set" in refused.stderr
