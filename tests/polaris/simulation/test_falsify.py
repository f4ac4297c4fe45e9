"""The search for counterexamples: nothing where the claim holds, and everything broken on purpose."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from typer.testing import CliRunner

from polaris.cli.app import app
from polaris.cli.attacks import show_falsification
from polaris.model.errors import ScenarioError
from polaris.runs.case import replay, write_case
from polaris.runs.schedule import digest
from polaris.scenario.scenario import load_scenario
from polaris.simulation.disturbances import adjoint_worst_case
from polaris.simulation.falsification.attacks import Attack, Attacker
from polaris.simulation.falsification.claims import EXACT_M, Claims, attained
from polaris.simulation.falsification.search import falsify
from polaris.simulation.falsification.violations import Failure
from polaris.simulation.integration import Integrator
from polaris.synthesis.controllers.controllers import AnyThrust
from polaris.synthesis.safety.get_safety import get_safety
from polaris.synthesis.schedule.synthesize import synthesize
from tests.kept import CHOSEN, printed, quick
from tests.paper.printed_ball import take_printed_balls
from tests.polaris.conftest import synthesised
from tests.polaris.synthesis.controllers.test_neural import scene as network_scene
from tests.polaris.tiny import TINY
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


@pytest.mark.parametrize("name", ["static", pytest.param("robot", marks=pytest.mark.slow)])
def test_nothing_breaks_a_proven_schedule(name):
    schedule = synthesised(name, *quick(name))[1]
    result = falsify(schedule, 250, seed=1)
    assert result.failure is None and result.runs == 250
    obstacles = len(schedule.safety.clearance.unsafe)
    assert np.all(result.least[:obstacles] >= result.proven[:obstacles] - EXACT_M)
    assert np.all(result.least >= 0)
    first, second = (falsify(schedule, 60, seed=seed).least for seed in (3, 3))
    assert np.array_equal(first, second) and not np.array_equal(first, falsify(schedule, 60, seed=4).least)


def test_printed_margins_have_units_and_sides_of_boxes_have_axes(capsys):
    box = "navigation={within_m=[900.0, 900.0, 900.0], position_error_m=0.05, velocity_error_m_s=0.001}"
    result = falsify(synthesised("static", *quick("static"), box)[1], 60, seed=1)
    show_falsification("static", result)
    _, head, *rows = capsys.readouterr().out.splitlines()
    at = head.index("unit")
    units = {row[:at].strip(): row[at : at + 4].strip() for row in rows[:-2]}
    assert units["within, side 5 of 6 (-along-track)"] == "m" and units["radial thrust"] == "N"
    assert len(units) == len(result.names) and set(units.values()) == {"m", "N"}
    show_falsification("static", replace(result, failure=Failure("unsafe set", "within[4]", 9.0, -1.0, 0.0)))
    assert "VIOLATED: within, side 5 of 6 (-along-track) is entered at t = 9 s" in capsys.readouterr().out


def test_the_bound_is_neither_violated_nor_idle():
    result = falsify(printed("static", CHOSEN)[1], 1500, seed=0)
    assert 0.6 < result.ratio[0] <= 1, "the debris is approached to within what the proof leaves open"


@pytest.mark.slow
@pytest.mark.parametrize("name", BUNDLED)
def test_many_trajectories_violate_nothing(name):
    """10,000 of each of five scenes; a million in a campaign."""
    count = fewer(200_000, 10_000)
    result = falsify(synthesised(name)[1], count, seed=7)
    assert result.failure is None and result.runs == count, result.summary()


def test_disturbances_and_starts_are_admissible():
    schedule = with_black_box()
    claims, flight = flight_of(schedule)
    attacker = Attacker(claims, flight, np.random.default_rng(0))
    first = attacker.worst(40)
    runs = first.fly(flight)
    measured = attained(claims, runs)
    attacks = [first, attacker.random(40), attacker.again(runs, measured, 40), attacker.mutate(first, 40)]
    system, theta = flight.system, schedule.safety.problem.initial_set
    for attack in attacks:
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
    stronger = Attack(attack.x0, 40 * attack.w, None)
    assert measured.below.max() <= EXACT_M < attained(claims, stronger.fly(coarse)).below.max()
    fine = Integrator(schedule, claims.modes, 16)
    disturbances, x = np.repeat(attack.w, 16, axis=0), attack.x0
    nearest, system = np.full(len(x), np.inf), fine.system
    for step in range(fine.steps):
        k, sub = divmod(step, fine.steps_per_cell)
        if sub % 16 == 0:
            u = np.clip(fine.command(int(claims.modes[k]), k, sub, x), -system.u_max, system.u_max)

        def rate(state, u=u, w=disturbances[step]):
            return state @ system.A.T + u @ system.B.T + w @ system.D.T

        x = x + fine.dt * rate(x + fine.dt / 2 * rate(x))
        outside = np.max(np.abs(x[:, :3] - box.anchor) - np.asarray(box.half_widths), axis=1)
        nearest = np.minimum(nearest, outside)
    assert np.allclose(measured.margin[:, 0], nearest, atol=0.02)


@pytest.mark.slow
def test_printed_ball_without_thrust_limits_is_caught(tmp_path, monkeypatch):
    take_printed_balls(monkeypatch)
    scenario = load_scenario("static").with_overrides(STIFF)
    schedule = synthesize(scenario)
    result = falsify(schedule, 3000)
    assert result.failure is not None and result.failure.kind == "saturation"
    assert result.failure.margin < 0 and result.runs < 3000
    path = write_case(tmp_path / "ball.json", scenario, result)
    failure, loaded = replay(path)
    assert failure == result.failure and loaded.to_dict() == scenario.to_dict()
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
    schedule = tiny()[1]

    def thinner(tube):
        return replace(
            tube, states=replace(tube.states, G=0.3 * tube.states.G), intersample=0 * tube.intersample
        )

    thin = tuple(replace(step, tube=thinner(step.tube)) for step in schedule.steps)
    assert falsify(schedule, 600).failure is None
    result = falsify(replace(schedule, steps=thin), 600)
    assert result.failure is not None and result.failure.kind == "margin"
    assert result.failure.margin > 0, "it enters nothing; it only comes closer than was claimed"


def test_a_proof_without_unsafe_sets_has_its_thrust_limits_attacked():
    scenario, schedule = tiny()
    safety = get_safety(replace(schedule.safety.problem, unsafe=()))
    law = AnyThrust("anything", scenario.system(), safety.reference, safety.tracking)
    result = falsify(synthesize(safety, experimental=[law]), 200)
    assert result.failure is None and result.names == scenario.system().input_names
    assert (result.proven <= result.least).all()


def test_errors_of_estimates_are_steered_to_their_worst():
    settings = ["feedback.period_s=0.25", "navigation={state_error=[0.01,0.01,0.002,0.002]}"]
    schedule = synthesize(load_scenario(TINY, settings))
    flight, rows = flight_of(schedule)[1], np.vstack([np.eye(4), -np.eye(4)])
    x0 = np.repeat(schedule.safety.problem.initial_set.c[None], 8, axis=0)
    w, rng = 1e-3 * adjoint_worst_case(flight, rows, np.full(8, flight.steps))[0], np.random.default_rng(0)
    other, eta = w.copy(), flight.columns[1]
    reached = np.sum(flight.run(x0, w).states[:, -1] * rows, axis=1)
    for _ in range(5):
        other[..., eta] = np.abs(w[..., eta]) * rng.choice([-1.0, 1.0], w[..., eta].shape)
        assert np.all(reached > np.sum(flight.run(x0, other).states[:, -1] * rows, axis=1) + 1e-7)


def test_gradients_of_a_network_are_those_of_its_flights(tmp_path):
    schedule = synthesize(load_scenario(network_scene(tmp_path)))
    schedule = replace(schedule, steps=tuple(replace(step, mode=1) for step in schedule.steps))
    flight = flight_of(schedule)[1]
    rows, middle = np.eye(4), schedule.safety.problem.initial_set.c
    for target in (flight.steps // 2, flight.steps):
        _, _, adjoint = adjoint_worst_case(flight, rows, np.full(4, target))
        x0 = middle + 1e-5 * np.vstack([np.eye(4), -np.eye(4)])
        ends = flight.run(x0, np.zeros((flight.steps, 8, flight.system.p))).states[:, target]
        assert adjoint == pytest.approx((ends[:4] - ends[4:]).T / 2e-5, rel=1e-3, abs=1e-5)


def test_case_that_was_changed_is_refused(tmp_path):
    scenario, schedule = tiny()
    result = falsify(replace(schedule, steps=tuple(replace(s, mode=1) for s in schedule.steps)), 400)
    assert result.failure is not None
    data = json.loads(write_case(tmp_path / "case.json", scenario, result).read_text(encoding="utf-8"))
    assert data["x0"] == result.case[0].x0[0].tolist()
    changes = {"schedule": ["0" * 64], "version": [1], "format": ["other"]}
    changes["x0"] = [["nan?"], [None] * len(data["x0"])]
    changes |= {"violation": [{**data["violation"], "kind": "abort"}, {}], "faults": [{"begins": 0}]}
    for key, value in ((key, value) for key, values in changes.items() for value in values):
        broken = tmp_path / f"{key}.json"
        changed = {**data, "schedule": digest(schedule), key: value}
        broken.write_text(json.dumps(changed), encoding="utf-8")
        assert CliRunner().invoke(app, ["replay", str(broken)]).exit_code == 2
    older = {key: value for key, value in data.items() if key != "faults"} | {"version": 3, "failing": None}
    broken.write_text(json.dumps(older), encoding="utf-8")
    with pytest.raises(ScenarioError, match="got 3; must be of version 4"):
        replay(broken)
    # The same attack on the schedule that is really made violates nothing.
    fair = tmp_path / "fair.json"
    fair.write_text(json.dumps({**data, "schedule": digest(schedule)}), encoding="utf-8")
    done = CliRunner().invoke(app, ["replay", str(fair)])
    assert done.exit_code == 0 and "no violation in this case" in done.stdout
    with pytest.raises(ScenarioError, match="must come from a search that found a violation"):
        write_case(tmp_path / "none.json", scenario, falsify(schedule, 50))


def test_command_reports_margins_and_saves_a_case(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    arguments = ["falsify", str(TINY), "--runs", "100", "--json"]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0
    summary = json.loads(done.stdout)
    assert summary["runs"] == 100 and not summary["violated"] and len(summary["limits"]) >= 3
    override = ["--set", "navigation.state_error=[0.01, 0, 0, 0]"]
    done = CliRunner().invoke(app, [*arguments, *override])
    assert done.exit_code == 0 and json.loads(done.stdout)["limits"] != summary["limits"]
    refused = CliRunner().invoke(app, ["falsify", str(tmp_path), *override])
    assert refused.exit_code == 2 and "--set" in refused.stderr
    take_printed_balls(monkeypatch)
    scenario = load_scenario("static").with_overrides(STIFF)
    (tmp_path / "stiff.toml").write_text(scenario.to_toml(), encoding="utf-8")
    done = CliRunner().invoke(app, ["falsify", "stiff.toml", "--runs", "3000", "--out", "found.json"])
    assert done.exit_code == 5 and "VIOLATED" in done.stdout
    assert (tmp_path / "found.json").is_file()
