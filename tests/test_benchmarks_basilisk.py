"""Flight software that reads run folders alone; a flight in Basilisk, which is no part of the test extra."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from benchmarks.basilisk.onboard import CraftSoftware, FlightSoftware, held
from polaris.runs.schedule import write_run
from polaris.scenario.scenario import load_scenario
from polaris.simulation.allocating import thrusts_of
from polaris.synthesis.schedule.synthesize import synthesize

SAMPLED = ["feedback.period_s=10", "recoverable.recourse=none", "simulation.runs=2"]
SAMPLED += ["schedule.bound_programs=0"]


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
        expected = np.clip(law.command(k, xi, fine[schedule.modes[k]][k, place], x), -0.2, 0.2)
        assert np.allclose(software.command(tick, x), expected, atol=1e-9)


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
    commands, impulses = np.random.default_rng(1).uniform(-0.25, 0.25, (200, 3)), {}
    for remainder in ("carried", "dropped"):
        declared.write_text(plain + table.format(remainder))
        software = FlightSoftware(tmp_path / "static")
        impulses[remainder] = np.array([software.impulse(u) for u in commands])
        multiple = np.abs(impulses[remainder] / 0.3 - np.round(impulses[remainder] / 0.3)) < 1e-9
        assert np.all(multiple | np.isclose(np.abs(impulses[remainder]), 2.0))  # the limit: 0.2 N for 10 s
    commanded = np.clip(commands, -0.2, 0.2) * 10
    owed = np.abs(np.cumsum(commanded - impulses["carried"], axis=0)).max()
    assert 0.25 < owed <= 0.3 + 1e-9
    assert 0.14 < np.abs(commanded - impulses["dropped"]).max() <= 0.15 + 1e-9


@pytest.fixture(scope="module")
def craft(tmp_path_factory):
    """Files of a run folder that flight software reads, without a synthesis: the bundled craft at rest."""
    scenario, folder = load_scenario("cubesat"), tmp_path_factory.mktemp("craft") / "cubesat"
    problem, period = scenario.problem(), scenario.period()
    system, allocation, rng = problem.system, problem.allocation, np.random.default_rng(0)
    table = {name: np.asarray(getattr(system, name)).tolist() for name in ("A", "B")}
    table["input_max"] = system.u_max.tolist()
    table["timing"] = {"measured_error": [0.2] * 3 + [0.004] * 3}
    table["observer"] = {x: getattr(system.observer, x).tolist() for x in ("measures", "noise", "gain")}
    table["allocation"] = {x: getattr(allocation, x).tolist() for x in ("directions", "limits", "mixes")}
    gain = np.hstack([1e-4 * np.eye(3), 1e-2 * np.eye(3)]) * rng.uniform(0.5, 1, (3, 6))
    laws = [{"name": name, "gain": (share * gain).tolist()} for name, share in (("S", 1.0), ("U", 0.5))]
    nodes = round(problem.delta / period)
    sampling = {"step": problem.delta, "nodes_per_step": nodes}
    gains = {"system": table, "controllers": laws, "sampling": sampling}
    folder.mkdir()
    (folder / "gains.json").write_text(json.dumps(gains))
    (folder / "scenario.toml").write_text(scenario.copy_text())
    (folder / "schedule.csv").write_text("step,mode\n" + "".join(f"{k},1\n" for k in range(4)))
    rows = [[problem.delta * k, *[0.0] * 9] for k in range(6)]
    (folder / "reference.csv").write_text("t\n" + "".join(",".join(map(str, row)) + "\n" for row in rows))
    return system, folder


def test_the_observer_on_board_forgets_what_it_did_not_know(craft):
    """In the linear model, with held inputs and exact positions that are a second old."""
    system, folder = craft
    software, x = CraftSoftware(folder), np.array([30.0, 80.0, -20.0, 0.01, -0.02, 0.03])
    phi, gamma = held(system.A, system.B, 1.0)
    assert (software.delay, software.since, software.period) == (1.0, 1.0, 2.0)
    software.estimate = np.linalg.solve(phi @ phi @ phi, x + [0.1, -0.1, 0.1, 0.004, 0.004, -0.004])
    measured, errors = None, []
    for tick in range(-20, 100):
        u = software.command(tick, measured)
        assert np.any(u) == (tick >= 0)
        predicted = phi @ software.estimate + gamma @ software.before  # what was in force until now
        errors.append(np.abs(predicted - x).max())
        if tick >= 0:
            assert u == pytest.approx(np.clip(software.law(tick, predicted), -system.u_max, system.u_max))
        measured = phi @ x + gamma @ u
        x = phi @ measured + gamma @ u
    assert errors[0] > 0.09 and errors[-1] < 0.1 * errors[0]


@pytest.mark.parametrize("kind", ["pseudo_inverse", "linear_program", "nearest"])
def test_the_declared_allocation_is_flown_or_refused(craft, tmp_path, kind):
    """Commands are made without a fault as the allocation says, and by others with a valve isolated."""
    system, folder = craft
    declared = load_scenario("cubesat", [f"thrusters.allocation={kind}"]).problem().allocation
    shutil.copytree(folder, tmp_path / "run")
    gains = json.loads((folder / "gains.json").read_text())
    names = "directions", "limits", "mixes"
    gains["system"]["allocation"] = {x: getattr(declared, x).tolist() for x in names} | {"kind": kind}
    gains["system"]["input_max"] = declared.u_max.tolist()
    (tmp_path / "run" / "gains.json").write_text(json.dumps(gains))
    if kind == "nearest":
        with pytest.raises(ValueError, match="allocation is nearest"):
            CraftSoftware(tmp_path / "run")
        return
    whole, broken = CraftSoftware(tmp_path / "run"), CraftSoftware(tmp_path / "run")
    broken.isolate("stuck_off", 4)
    mixed = CraftSoftware(folder)
    commands = np.random.default_rng(5).uniform(-1, 1, (100, 3)) * declared.u_max
    for u, f in zip(commands, thrusts_of(declared, commands), strict=True):
        assert np.allclose(whole.thrusts(u), f, atol=1e-9)
        assert np.allclose(broken.thrusts(u) @ declared.directions, u, atol=1e-9)
        assert broken.thrusts(u)[4] == 0 and np.all(broken.thrusts(u) <= declared.limits + 1e-9)
    assert any(not np.allclose(whole.thrusts(u), mixed.thrusts(u), atol=1e-4) for u in commands)


def test_the_page_has_200_flights_of_cubesat_within_what_is_proven():
    page = (Path(__file__).parents[1] / "docs" / "model-error.md").read_text(encoding="utf-8")
    text = page.split("<!-- table cubesat -->")[1].split("<!-- end -->")[0]
    rows = [[x.strip(" %") for x in row.split("|")[1:-1]] for row in text.splitlines() if row[:2] == "| "]
    _, *flights, proven = rows
    assert [int(row[1]) for row in flights] == [100, 50, 50]
    for row in flights:
        assert row[2] == "0" and float(row[3]) > 0 and row[4] == row[1]
        assert all(float(share) <= 100 for share in row[8:])
    overall = flights[0]
    assert float(overall[3]) > float(proven[3]) > 0
    assert float(overall[5]) < float(proven[5]) and float(overall[7]) < float(proven[7])


@pytest.mark.slow
def test_cubesat_with_valves_stuck_keeps_within_what_was_proven_in_basilisk(tmp_path):
    pytest.importorskip("Basilisk")
    from benchmarks.basilisk.craft import fly_scene, table

    settings = ["simulation.runs=2", "schedule.bound_programs=0"]
    scene, flights = fly_scene("cubesat", 4, tmp_path / "cubesat", settings)
    proven = scene.proven
    assert [one.stuck for one in flights] == ["", "stuck_off", "", "stuck_on"]
    for one in flights:
        assert one.distance > 0 and one.tube <= 1 + 1e-6 and one.thrust <= 1
        assert one.residual < 1 and 0.1 < one.seen <= 1
        assert one.stuck or (one.distance >= proven["distance"] and one.goal <= proven["goal"])
        assert one.stuck or one.delta_v <= proven["delta_v"]
    assert len(table(scene, flights)) == 4


@pytest.mark.slow
def test_a_flight_in_basilisk_keeps_within_what_was_proven(tmp_path):
    pytest.importorskip("Basilisk")
    from benchmarks.basilisk.__main__ import REAL, Found, scene

    scene("static", 1, tmp_path / "static", [*REAL])
    flights = scene("static", 2, tmp_path / "static", [*REAL])
    assert len(flights) == len((tmp_path / "static.jsonl").read_text().splitlines()) == 2
    worst = Found.worst(flights)
    assert worst.distance > 0
    assert worst.tube <= 1 + 1e-6
    assert worst.thrust <= 1
    assert 0.05 < worst.residual < 1
    assert 0.3 < worst.seen <= 1
    with pytest.raises(ValueError, match="settings"):
        scene("static", 1, tmp_path / "static", [*REAL, "timing.delay_s=0"])
