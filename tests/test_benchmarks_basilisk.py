"""Flight software that reads run folders alone; a flight in Basilisk, which is no part of the test extra."""

import shutil

import numpy as np
import pytest

from benchmarks.basilisk.onboard import FlightSoftware, held
from polaris.runs.schedule import write_run
from polaris.scenario.scenario import load_scenario
from polaris.synthesis.schedule.synthesize import synthesize

SAMPLED = [
    "feedback.period_s=10",
    "recoverable.recourse=none",
    "simulation.runs=2",
    "schedule.bound_programs=0",
]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    scenario = load_scenario("static", SAMPLED)
    schedule, place = synthesize(scenario), tmp_path_factory.mktemp("run")
    write_run(place / "static", scenario, schedule)
    return schedule, place / "static"


@pytest.mark.slow
def test_software_commands_what_the_scheduled_controller_does(run):
    schedule, folder = run
    software, rng = FlightSoftware(folder), np.random.default_rng(0)
    q, safety = schedule.safety.tracking.feedback.nodes_per_cell, schedule.safety.reference
    fine = [law.own.fine(q) if hasattr(law, "own") else safety.fine(q) for law in schedule.controllers]
    assert len(set(schedule.modes)) == 2
    for tick in range(q * len(schedule.modes)):
        k, place = divmod(tick, q)
        law, xi = schedule.controllers[schedule.modes[k]], safety.fine(q)[k, place]
        x = xi + rng.normal(size=6) * [5, 5, 5, 0.05, 0.05, 0.05]
        wanted = np.clip(law.command(k, xi, fine[schedule.modes[k]][k, place], x), -0.2, 0.2)
        assert np.allclose(software.command(tick, x), wanted, atol=1e-9)


def test_after_the_schedule_the_safety_controller_keeps_the_coasting_tail(run):
    schedule, folder = run
    software = FlightSoftware(folder)
    tail = schedule.safety.reference.chi
    k = len(schedule.modes) + 7
    tick = k * schedule.safety.tracking.feedback.nodes_per_cell
    assert np.allclose(software.law(tick, tail[k]), 0.0, atol=1e-9)
    assert np.all(software.law(tick, tail[k] + [1, 0, 0, 0, 0, 0])[0] < 0)


def test_a_late_command_is_that_of_the_predicted_state(run):
    folder = run[1]
    prompt, late = FlightSoftware(folder), FlightSoftware(folder)
    late.late = 2
    x, phi, gamma = np.array([0.5, 401, 0.2, 0.24, 0.01, 0]), *held(prompt.A, prompt.B, prompt.period)
    path = [x]
    for tick in range(20):
        path.append(phi @ path[-1] + gamma @ prompt.command(tick, path[-1]))
    for tick in range(18):
        assert np.allclose(late.command(tick, path[tick]), prompt.issued[tick], atol=1e-12)
        assert len(late.issued) == tick + 3


def test_what_is_left_of_a_bit_is_carried_to_the_next_period(run, tmp_path):
    shutil.copytree(run[1], tmp_path / "static")
    declared = tmp_path / "static" / "scenario.toml"
    table = '\n[thrusters]\nimpulse_bit_N_s = 0.3\nremainder = "{}"\n'
    plain = declared.read_text()
    commands, made = np.random.default_rng(1).uniform(-0.25, 0.25, (200, 3)), {}
    for remainder in ("carried", "dropped"):
        declared.write_text(plain + table.format(remainder))
        software = FlightSoftware(tmp_path / "static")
        made[remainder] = np.array([software.impulse(u) for u in commands])
        whole = np.abs(made[remainder] / 0.3 - np.round(made[remainder] / 0.3)) < 1e-9
        assert np.all(whole | np.isclose(np.abs(made[remainder]), 2.0))  # the limit: 0.2 N for 10 s
    asked = np.clip(commands, -0.2, 0.2) * 10
    owed = np.abs(np.cumsum(asked - made["carried"], axis=0)).max()
    assert 0.25 < owed <= 0.3 + 1e-9
    assert 0.14 < np.abs(asked - made["dropped"]).max() <= 0.15 + 1e-9


@pytest.mark.slow
def test_a_flight_in_basilisk_keeps_within_what_was_proven(tmp_path):
    pytest.importorskip("Basilisk")
    from benchmarks.basilisk.__main__ import REAL, Found, scene

    scene("static", 1, tmp_path / "static", [*REAL])
    found = scene("static", 2, tmp_path / "static", [*REAL])
    assert len(found) == len((tmp_path / "static.jsonl").read_text().splitlines()) == 2
    worst = Found.worst(found)
    assert worst.distance > 0
    assert worst.tube <= 1 + 1e-6
    assert worst.thrust <= 1
    assert 0.05 < worst.residual < 1
    assert 0.3 < worst.seen <= 1
    with pytest.raises(ValueError, match="settings"):
        scene("static", 1, tmp_path / "static", [*REAL, "timing.delay_s=0"])
