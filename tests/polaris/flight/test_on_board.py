"""Compiled flight code in closed loop: in simulations, attacks, the nonlinear motion and the comparison."""

import shutil
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from typer.testing import CliRunner

from polaris.certificate.code.answers import CLIPPED, COMMAND, LATCHED, REFUSED, FlightStep
from polaris.certificate.code.text import PRECISIONS
from polaris.cli.app import app
from polaris.flight.export import export_c
from polaris.model.errors import PolarisError, ScenarioError
from polaris.rta.arena import compare_methods
from polaris.runs.case import replay, write_case
from polaris.runs.read_schedule import read_schedule
from polaris.scenario.scenario import load_scenario
from polaris.simulation.falsification.search import falsify
from polaris.simulation.on_board import FlightCode, code_of
from polaris.simulation.orbit.environment import Environment
from polaris.simulation.orbit.truth import fly_true
from polaris.simulation.simulate import simulate
from polaris.synthesis.schedule.synthesize import synthesize
from tests.kept import CHOSEN, kept, printed
from tests.polaris.certificate.test_honest_sources import SOURCES
from tests.polaris.flight.library import tool
from tests.polaris.forging import COARSE, make
from tests.polaris.random_scenarios import random_scenario
from tests.polaris.simulation.test_model_error import ERRORS
from tests.polaris.synthesis.sources.test_layouts import CRAFT
from tests.polaris.synthesis.sources.test_pulses import PULSED
from tests.polaris.tiny import TINY
from tests.sizes import fewer

LEFT = COMMAND | LATCHED
"""What the code says of a step of U that S flies because of a fault, and after it."""


def declared(*names):
    return [text for name in names for text in SOURCES[name]]


SCENES = {
    "plain": [COARSE, "tracking.R=[60,60]"],
    "nozzles, pulses and valves that stick": [*CRAFT, "tracking.R=[60,60]"],
    "pulses, errors and a delay": [*PULSED, *declared("magnitude", "carried bit", "estimate", "delay")],
    "camera": [
        *("feedback.period_s=0.25", "tracking.R=[60,60]", "system.disturbance_max=0.002"),
        *declared("constant camera", "missed periods", "magnitude"),
    ],
    "loss of thrust": [
        *("feedback.period_s=0.5", "tracking.R=[60,60]", "system.disturbance_max=0.005"),
        *declared("fault", "estimate", "constant magnitude"),
    ],
    "outage": ["feedback.period_s=0.25", "tracking.R=[60,60]", *declared("outage", "delay", "estimate")],
}


@pytest.fixture(autouse=True)
def compiler():
    """Skip without a compiler."""
    tool("cc" if shutil.which("cc") else "gcc")


@cache
def scheduled(name):
    return kept(f"on board {name}", lambda: synthesize(load_scenario(TINY, SCENES[name])))


def answered(code):
    """Faults that the code answered with while U and S flew."""
    return tuple({fault for mode, fault in code.answers if (mode > 0) == by_u} for by_u in (False, True))


def never_clipped(schedule, code):
    """S is never clipped and leaves no range; it takes over early where something fails alone."""
    by_s, by_u = answered(code)
    late = {LATCHED, LEFT} if schedule.safety.problem.system.transients else set()
    assert 0 in by_s and by_s <= {0, *late}
    assert by_u <= {0, CLIPPED} and by_u


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("precision", PRECISIONS)
def test_simulations_and_attacks_fly_the_code(name, precision):
    """As the Python loops fly in double; safe, as proven, in both."""
    schedule = scheduled(name)
    assert {0, 1} == set(schedule.modes.tolist())
    code = code_of(schedule, precision)
    runs = simulate(schedule, 40, 4, tail=True, code=code)
    never_clipped(schedule, code)
    assert not runs.metrics().collided.any()
    deviation = np.abs(runs.states - simulate(schedule, 40, 4, tail=True).states).max()
    whole = any("bit" in text for text in SCENES[name])  # where rounding moves an impulse by one of them
    assert deviation <= (1e-12 if precision == "double" else 0.01 if whole else 1e-5)
    code.answers.clear()
    assert falsify(schedule, 60, 3, code=code).failure is None
    never_clipped(schedule, code)


@pytest.mark.slow
@pytest.mark.parametrize("precision", PRECISIONS)
def test_thousands_of_attacks_on_the_code_violate_nothing(precision):
    """Worst cases of every limit, repeated and mutated, with errors and faults, until T and after it."""
    flights = 0
    for name in SCENES:
        schedule, count = scheduled(name), fewer(20_000, 350)
        code = code_of(schedule, precision)
        attacks = falsify(schedule, count, 7, code=code)
        assert attacks.failure is None, f"{name}: {attacks.failure}"
        never_clipped(schedule, code)
        flights += attacks.runs
    assert flights >= 2000


@pytest.mark.slow
def test_code_of_random_scenes_flies_safely(tmp_path):
    """Of every plant, set, goal, controller and rule that scenes are drawn with; errors and faults, too."""
    rng, proved = np.random.default_rng(2), 0
    for seed in range(fewer(300, 20)):
        names = rng.choice(list(SOURCES), rng.integers(0, 3), replace=False)
        try:
            if names.size:
                periods = f"feedback.period_s={rng.choice([0.25, 0.5])}", "tracking.R=[60,60]"
                schedule = synthesize(load_scenario(TINY, [*periods, *declared(*names)]))
            else:
                (tmp_path / "scene.toml").write_text(random_scenario(seed))
                schedule = synthesize(load_scenario(tmp_path / "scene.toml"))
            codes = [code_of(schedule, precision) for precision in PRECISIONS]
        except PolarisError:
            continue
        for code in codes:
            attacks = falsify(schedule, 100, seed, code=code)
            assert attacks.failure is None, f"{seed}, {names}: {attacks.failure}"
        proved += 1
    assert proved >= 5


def test_attacks_find_code_that_does_not_keep_to_the_proof(tmp_path):
    """With a gain that is three times too small, in the code alone, and flown again to be sure."""
    schedule = scheduled("plain")
    law = schedule.controllers[0]
    weak = replace(law, gain=law.gain / 3)
    safety = replace(schedule.safety, tracking=replace(schedule.safety.tracking, gain=law.gain / 3))
    code = code_of(replace(schedule, safety=safety, controllers=(weak, *schedule.controllers[1:])))
    assert falsify(schedule, 2000, 0).failure is None
    attack = falsify(schedule, 2000, 0, code=code)
    case = write_case(tmp_path / "weak.case.json", load_scenario(TINY, SCENES["plain"]), attack)
    assert attack.failure is not None and replay(case, code)[0] == attack.failure
    assert replay(case)[0] is None


def test_a_command_of_s_that_the_code_clips_counts_as_too_much():
    code = code_of(scheduled("plain"))
    code.start(2)
    x = np.array(code.tables.waypoints[:1] * 2)
    x[1] += 100.0
    u = code.step(0, x, 0, np.zeros((2, 2)))
    limit = np.array(code.tables.limit)
    assert np.all(np.abs(u[0]) <= limit) and np.max(np.abs(u[1]) / limit) > 1


@pytest.mark.parametrize("precision", PRECISIONS)
def test_the_online_monitor_in_the_code_lets_u_fly_safely(tmp_path, precision):
    """U wants to fly all along; who decides is the code."""
    run = make([COARSE], tmp_path)
    export_c(run, tmp_path / "code", precision, monitor=True)
    schedule, code = read_schedule(run), FlightCode(tmp_path / "code")
    runs = simulate(schedule, fewer(2000, 60), 1, mode=1, code=code)
    assert code.online and not runs.metrics().collided.any()
    assert {(mode, fault & ~CLIPPED) for mode, fault in code.answers} == {(0, REFUSED), (1, 0)}
    assert not any(fault & CLIPPED for mode, fault in code.answers if not mode)
    with pytest.raises(ScenarioError, match="must name a controller"):
        simulate(schedule, 1, code=code)


@pytest.mark.parametrize("precision", PRECISIONS)
def test_many_flights_at_once_answer_as_the_python_step(precision):
    """Each with a memory of its own, called in any order."""
    code = code_of(scheduled("plain"), precision)
    code.start(5)
    steps, rng = [FlightStep(code.tables, precision) for _ in range(5)], np.random.default_rng(1)
    reach, limit = np.array(code.tables.range), np.array(code.tables.limit)
    for period in range(len(code.tables.modes) * 2):
        for rows in rng.permutation(5)[:2], rng.permutation(5)[2:]:
            x = rng.uniform(-1, 1, (len(rows), len(reach))) * reach
            u = rng.uniform(-1, 1, (len(rows), len(limit))) * limit
            modes = rng.integers(0, 2, len(rows))
            commands = code.step(period, x, modes, u, rows)
            for i, run in enumerate(rows.tolist()):
                answer = steps[run].step(period, x[i].tolist(), int(modes[i]), u[i].tolist())
                assert code.modes[run] == answer.mode
                past = answer.mode == 0 and answer.fault & CLIPPED
                assert past or tuple(commands[i]) == answer.command


def test_the_nonlinear_motion_is_flown_by_the_code():
    schedule = printed("static", CHOSEN)[1]
    env, code = Environment.from_scenario(printed("static", CHOSEN)[0]), code_of(schedule)
    flights = fly_true(schedule, env, 6, substeps=1, code=code)
    plain = fly_true(schedule, env, 6, substeps=1)
    never_clipped(schedule, code)
    assert not flights.runs.metrics().collided.any()
    assert np.abs(flights.runs.states - plain.runs.states).max() <= 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("precision", PRECISIONS)
def test_the_nonlinear_motion_is_flown_by_the_code_with_all_errors(precision):
    scenario = load_scenario("static", ERRORS)
    schedule = kept("on board static", lambda: synthesize(scenario))
    code = code_of(schedule, precision)
    flights = fly_true(schedule, Environment.from_scenario(scenario), fewer(2000, 60), substeps=1, code=code)
    never_clipped(schedule, code)
    assert flights.within.all() and not flights.runs.metrics().collided.any()


def test_the_arena_flies_the_code_beside_the_schedule():
    schedule = scheduled("loss of thrust")
    results = compare_methods(schedule, 8, 1, methods=("schedule", "code")).results
    one, other = (results[key] for key in ("schedule", "code"))
    assert other.claim.kind == "proved" and not other.metrics.collided.any()
    for name in ("min_distance", "delta_v", "experimental_share"):
        assert np.allclose(getattr(one.metrics, name), getattr(other.metrics, name), atol=1e-9), name


def test_without_a_compiler_the_arena_says_so(monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda name: None)
    refused = compare_methods(scheduled("plain"), 1, 0, methods=("safety", "code")).refused
    assert refused == {"code": "flight code needs a C compiler, but none of cc, gcc, clang is installed"}


def test_what_is_not_proved_is_not_flown_as_code(monkeypatch):
    schedule = scheduled("plain")
    with monkeypatch.context() as patch:
        patch.setattr(type(schedule), "guarantee", "statistical")
        refused = compare_methods(schedule, 1, 0, methods=("safety", "code")).refused
    assert "must be 'proved' to fly" in refused["code"]
    with pytest.raises(ScenarioError, match="be left out otherwise"):
        simulate(schedule, 1, mode=1, code=code_of(schedule))
    with pytest.raises(ScenarioError, match="flight code of this schedule"):
        simulate(schedule, 1, code=code_of(scheduled("outage")))


@pytest.mark.parametrize("precision", PRECISIONS)
def test_code_of_the_same_modes_about_another_reference_is_refused(precision):
    """Attacks and comparisons would be about something else."""
    schedule = scheduled("plain")
    code, safety = code_of(schedule, precision), schedule.safety
    assert code.require_schedule(schedule) is code
    shifted = replace(safety.reference, chi=safety.reference.chi + 0.01)
    with pytest.raises(ScenarioError, match="flight code of this schedule"):
        code.require_schedule(replace(schedule, safety=replace(safety, reference=shifted)))


def test_falsify_flies_a_folder_of_code(tmp_path):
    run = make([COARSE], tmp_path)
    export_c(run, tmp_path / "code", "float")
    command = ["falsify", str(run), "--runs", "40", "--code", str(tmp_path / "code")]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0 and "No violation." in done.stdout, done.output
    (source,) = (tmp_path / "code").glob("*[!t].c")
    source.write_text(source.read_text().replace("= {", "= {,", 1))
    with pytest.raises(ScenarioError, match="must be a folder of flight code: .* numbers"):
        FlightCode(tmp_path / "code")


def test_what_a_compiler_refuses_is_said(tmp_path, monkeypatch):
    export_c(make([COARSE], tmp_path), tmp_path / "code")
    monkeypatch.setattr("polaris.simulation.on_board.FLAGS", ("-DFLT_MAX=}", "-include", "missing.h"))
    with pytest.raises(PolarisError, match="the compiler says"):
        FlightCode(tmp_path / "code")
