"""Run folders: what is in them, that it reads back, and that they are never half there."""

import csv
import json
import math
import re
import shutil
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

import polaris
from polaris.certificate.checker import verify
from polaris.cli.app import app
from polaris.cli.show.schedule import show_summary
from polaris.model.errors import ScenarioError
from polaris.model.hill import clohessy_wiltshire
from polaris.model.scene.satellite import SatelliteObstacle, true_states
from polaris.report import report_page
from polaris.report.figures import draw_run
from polaris.rta.arena import compare_methods
from polaris.runs.comparison import write_comparison
from polaris.runs.files.arrays import tube_arrays
from polaris.runs.run import read_run
from polaris.runs.schedule import DATA_FILES, write_run
from polaris.scenario.scenario import load_scenario
from polaris.simulation import baselines
from polaris.simulation.run_metrics import evaluate
from polaris.simulation.simulate import simulate
from tests.polaris.forging import QUARTER
from tests.polaris.tiny import TINY, flown, synthesised


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    scenario, schedule = synthesised()
    return write_run(tmp_path_factory.mktemp("runs") / "tiny", scenario, schedule, flown(), draw=draw_run)


def load_strict(path):
    def refuse(name):
        raise AssertionError(f"{name} is not strict JSON")

    return json.loads(path.read_text(encoding="utf-8"), parse_constant=refuse)


def test_same_seed_same_bytes_times_apart(folder, tmp_path):
    names = {path.name for path in folder.path.iterdir()}
    assert names == {*DATA_FILES, "certificate.json", "summary.json", "figures", ".polaris.jsonl"}
    scenario, schedule = synthesised()
    rerun = write_run(tmp_path / "again", scenario, schedule)  # flown anew from the scenario's seed
    for name in (*DATA_FILES, "certificate.json"):  # and figures: see test_figures
        assert (rerun.path / name).read_bytes() == (folder.path / name).read_bytes(), name
    assert (folder.path / "scenario.toml").read_bytes() == TINY.read_bytes()
    summaries = [dict(each.summary) for each in (folder, rerun)]
    for summary in summaries:
        del summary["created"]
        summary["synthesis"] = {**summary["synthesis"], "seconds": {}}
    assert json.dumps(summaries[0]) == json.dumps(summaries[1])


def belong_somewhere(seconds):
    """Return True if all times but the total add up to it, and none is negative but by rounding."""
    stages = [duration for stage, duration in seconds.items() if stage not in ("total", "plan_parts")]
    return math.isclose(sum(stages), seconds["total"], rel_tol=1e-9) and min(stages) > -1e-6


def test_every_second_belongs_to_a_stage_or_to_other(folder, tmp_path):
    """As a run tells it, on the console too, and where a schedule made before is written."""
    assert belong_somewhere(folder.summary["synthesis"]["seconds"])
    out = tmp_path / "whole"
    done = CliRunner().invoke(app, ["run", str(TINY), "--set", QUARTER, "--out", str(out), "--no-figures"])
    seconds = load_strict(out / "summary.json")["synthesis"]["seconds"]
    expected = {"bounds", "plan", "recoverable", "schedule", "bound", "simulation", "files", "other"}
    assert belong_somewhere(seconds) and expected <= set(seconds), done.output
    text = " ".join(done.stdout.split())
    total, stages = re.search(r"Computation time: ([\d.]+) s \((.*?)\)\.", text).groups()
    printed = [float(stage.split()[-1]) for stage in stages.split(", ")]
    assert sum(printed) == pytest.approx(float(total), abs=0.005 * (len(seconds) + 1))
    short = polaris.run("inspection", tmp_path / "short", overrides=["flight.duration_s=5"])
    assert belong_somewhere(short.summary["seconds"])


def test_each_of_several_experimental_controllers_flies_alone_and_is_named(tmp_path, capsys):
    """In the console's table, the summary, the files, the page, a comparison, and for the checker."""
    pilot_law = {"kind": "any_thrust", "name": "pilot", "weight": 1.0}
    tables = [pilot_law, *load_scenario(TINY).to_dict()["experimental"]]
    scenario = load_scenario(TINY).with_overrides({"experimental": tables, "simulation.runs": 4})
    schedule = polaris.synthesize(scenario)
    run = write_run(tmp_path / "several", scenario, schedule)
    alone = {"experimental": "pilot", "experimental_2": "hasty"}
    assert {key: run.summary[key]["controller"] for key in alone} == alone
    assert run.summary["experimental_2"]["collided"] and run.summary["experimental_2"]["switches"] == 0
    assert list(run.plot_data().flights) == ["safety", *alone, "polaris"]
    assert set(run.plot_data().flights["experimental_2"].modes.tolist()) == {2}
    assert verify(run.path).outcome == "VERIFIED"
    summary = json.loads((run.path / "summary.json").read_text(encoding="utf-8"))
    del summary["experimental_2"]
    forged = shutil.copytree(run.path, tmp_path / "forged")
    (forged / "summary.json").write_text(json.dumps(summary), encoding="utf-8")
    assert verify(forged).outcome == "REJECTED"
    page = report_page(run)
    compared = compare_methods(schedule, 2, methods=["experimental"])
    assert list(compared.results) == list(alone)
    folder = write_comparison(tmp_path / "compared", scenario, compared)
    for name in alone.values():
        title = f"U alone ({name})"
        assert title in str({key: text for key, _, text in page.sections}["numbers"])
        assert title in [pilot["name"] for pilot in page.data["pilots"]]
        assert title in [method["name"] for method in folder.summary["methods"]]
    assert {one.metrics.switches.max() for one in compared.results.values()} == {0}
    show_summary(run.summary, "here")
    words = capsys.readouterr().out
    assert all(f"({name})" in words for name in alone.values())


def test_summary_holds_the_promised_keys(folder):
    summary = load_strict(folder.path / "summary.json")
    keys = {"min_distance_m", "min_ttc_s", "min_ttc_free_drift_s", "experimental_share", "switches"}
    for source in ("safety", "experimental", "polaris"):
        assert keys | {"delta_v_m_s", "collided", "max_thrust_ratio", "runs"} <= set(summary[source])
        assert set(summary[source]) - {"controller", "drift_horizon_s"} <= set(summary["definitions"])
    assert {"status", "gap", "solver", "delta_v_m_s", "margin_m"} <= set(summary["synthesis"]["planner"])
    claims = {"kind", "horizon", "until_s", "reason", "assumptions", "goal", "upkeep"}
    assert set(summary["guarantee"]) == claims
    assert summary["guarantee"]["kind"] == "proved" and summary["seed"] == 0
    assert summary["experimental"]["collided"] and summary["experimental"]["min_distance_m"] < 0
    for source in ("safety", "polaris"):
        assert not summary[source]["collided"] and summary[source]["min_distance_m"] > 0
    assert summary["safety"]["experimental_share"] == 0 and summary["experimental"]["experimental_share"] == 1
    for source, other in (("safety", "experimental"), ("experimental", "safety")):
        assert summary[source][f"max_thrust_ratio_{source}"] == summary[source]["max_thrust_ratio"]
        assert summary[source][f"max_thrust_ratio_{other}"] is None
    both = [summary["polaris"][f"max_thrust_ratio_{source}"] for source in ("safety", "experimental")]
    assert max(both) == summary["polaris"]["max_thrust_ratio"] and both[0] <= 1


@pytest.mark.parametrize("name", DATA_FILES)
def test_a_changed_or_missing_file_is_not_read_as_part_of_the_run(folder, tmp_path, name):
    """Whatever was edited: no picture or report of a proof that was never made."""
    shutil.copytree(folder.path, tmp_path / "run")
    path = tmp_path / "run" / name
    for content in (path.read_bytes() + b"\n", b"", b"\x00\xff garbage"):
        path.write_bytes(content)
        with pytest.raises(ScenarioError, match=name) as error:
            read_run(tmp_path / "run")
        assert "\n" not in str(error.value)
    path.unlink()
    with pytest.raises(ScenarioError, match=name):
        read_run(tmp_path / "run")


def test_schedule_tables_agree_with_the_schedule(folder):
    schedule = synthesised()[1]
    data = load_strict(folder.path / "schedule.json")
    assert data["modes"] == schedule.modes.tolist() and data["switches"] == schedule.switches
    with (folder.path / "schedule.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(schedule.steps) == len(data["steps"])
    for k, (row, step) in enumerate(zip(rows, schedule.steps, strict=True)):
        assert (int(row["step"]), int(row["mode"])) == (k, step.mode)
        assert row["controller"] == schedule.controllers[step.mode].name
        assert float(row["margin"] or "-inf") == step.margin.value and row["limit"] == step.margin.limit
        assert float(row["t_end_s"]) == pytest.approx((k + 1) * 1.0)


def test_gains_hold_what_a_replay_needs(folder):
    data, schedule = load_strict(folder.path / "gains.json"), synthesised()[1]
    np.testing.assert_array_equal(data["controllers"][0]["gain"], schedule.safety.tracking.gain)
    assert np.shape(data["controllers"][1]["reference_states"]) == (13, 4)
    feedback = schedule.safety.tracking.feedback
    assert data["sampling"] == {"step": 1.0, "steps": 12, "nodes_per_step": feedback.nodes_per_cell}
    reference, read = schedule.safety.reference, folder.plot_data().reference
    np.testing.assert_array_equal(read.chi, reference.chi)
    np.testing.assert_array_equal(read.nu, reference.nu)
    header = (folder.path / "reference.csv").read_text(encoding="utf-8").splitlines()[0]
    assert header == "t_s,x0,x1,x2,x3,u0,u1"


@pytest.mark.parametrize("name", ["sets.npz", "tubes.npz", "trajectories.npz"])
def test_arrays_load_without_pickle(folder, name):
    with np.load(folder.path / name, allow_pickle=False) as arrays:
        for key in arrays.files:
            assert arrays[key].dtype != object
            if arrays[key].dtype.kind == "f" and not key.startswith(("thrust_clearance", "slice")):
                assert not np.any(np.isnan(arrays[key])), key
        if name == "sets.npz":
            safety = synthesised()[1].safety
            q = safety.tracking.feedback.nodes_per_cell
            assert str(arrays["kind"]) == "polytope" and arrays["slice_outline_m"].shape[1:] == (5, 24, 2)
            assert arrays["slice_place_m"].shape == (len(arrays["slice_t_s"]), 5, 2)
            assert arrays["radius"][3] == safety.recoverable.radius(3 * q)
            assert arrays["obstacle_clearance_m"].shape == (safety.reference.cells, q + 1, 2)


CARRIED = ("thrusters.impulse_bit_N_s=0.02", "thrusters.remainder=carried", "thrusters.pulse=centred")


@pytest.mark.parametrize("more", [CARRIED, ("timing.jitter_s=0.02",)], ids=["carried", "jitter"])
def test_tubes_of_the_file_hold_what_displaces_states_and_flights(more):
    schedule = polaris.synthesize(load_scenario(TINY, [QUARTER, *more]))
    arrays, tracking = tube_arrays(schedule), schedule.safety.tracking
    half = np.abs(arrays["generators"]).sum(axis=1, dtype=float).swapaxes(0, 1)
    exact = np.array([step.tube.nodes.half_widths for step in schedule.steps]) + tracking.unmodelled
    assert np.all(half >= exact * (1 - 1e-12)) and np.all(half <= exact * (1 + 1e-6) + 1e-30)
    offset = schedule.safety.problem.system.timing.intersample_offset or 0.0
    assert np.any(tracking.unmodelled > 0) or np.any(offset)
    intersamples = np.array([step.tube.intersample for step in schedule.steps])
    np.testing.assert_array_equal(arrays["intersample"], intersamples + offset)
    runs, (K, q) = simulate(schedule, 100, 0, initial="corners"), arrays["intersample"].shape[:2]
    errors = (
        runs.states[:, np.arange(K)[:, None] * q + np.arange(q + 1)] - schedule.safety.reference.fine(q)[:K]
    )
    assert np.all(np.abs(errors - arrays["center_error"]) <= half + 1e-9)


def test_metrics_of_batches_join_to_those_of_all(monkeypatch):
    schedule = synthesised()[1]
    monkeypatch.setattr(baselines, "BATCH", 5)
    for source, item in baselines.compare(schedule, 12, 0).items():
        metrics, flights = item.metrics, item.flights
        assert len(metrics.min_distance) == 12
        assert flights.labels[0] == "nominal" and np.all(np.diff(flights.nearest, axis=0) >= -1e-12)
        closest = flights.states[flights.labels.index("closest")]
        place = closest @ schedule.safety.problem.system.position.T
        gaps = [o.signed_distance(flights.times, place) for o in schedule.safety.problem.unsafe]
        assert np.min(gaps) == pytest.approx(metrics.min_distance.min(), abs=0.05), source


def test_closest_approach_is_not_missed_between_nodes(monkeypatch):
    schedule = synthesised()[1]
    runs = simulate(schedule, 8, seed=3, mode=1)
    metrics = evaluate(runs)
    fine = np.linspace(0, runs.times[-1], 20000)
    for run in range(8):
        path = np.stack([np.interp(fine, runs.times, column) for column in runs.positions[run].T], axis=1)
        gaps = [o.signed_distance(fine, path) for o in schedule.safety.problem.unsafe]
        assert metrics.min_distance[run] <= np.min(gaps) + 0.01
    assert metrics.collided.all() and np.all(metrics.min_ttc == 0)
    assert math.isfinite(metrics.summary()["min_distance_m"])
    assert runs.metrics().columns()["closest_set"][0] == "pillar"
    monkeypatch.setitem(sys.modules, "pandas", SimpleNamespace(DataFrame=dict))
    assert np.array_equal(metrics.to_pandas()["delta_v_m_s"], metrics.delta_v)
    bare = replace(schedule.safety, problem=replace(schedule.safety.problem, unsafe=()))
    summary = evaluate(replace(runs, schedule=replace(schedule, safety=bare))).summary()
    assert summary["min_distance_m"] is None and summary["min_ttc_s"] is None and not summary["collided"]


def test_true_states_of_another_satellite_stay_in_what_is_known():
    system = clohessy_wiltshire(0.0012, 10.0, 0.1, 1e-5)
    spread = [2.0, 2, 2, 0.01, 0.01, 0.01]
    visitor = SatelliteObstacle("visitor", [100.0, 200, 0, 0, 0.1, 0], spread, 20.0, 1e-4)
    rng = np.random.default_rng(0)
    states = true_states([visitor], system, np.arange(31) * 20.0, 40, rng)["visitor"]
    assert states.shape == (40, 31, 6)
    cover = visitor.timed_polytopes(system, 20.0, 30)[0]
    heights = states[:, :-1] @ system.position.T @ cover.normals.T + visitor.radius
    assert np.all(heights <= cover.offsets[:, 0] + 1e-6)


def test_a_schedule_is_not_written_under_another_scenario(tmp_path):
    scenario, schedule = synthesised()
    for change in ("obstacles[0].center_m=[3, 3]", "system.input_max=2", "horizon.step_s=2"):
        with pytest.raises(ScenarioError, match="must"):
            write_run(tmp_path / "run", scenario.with_assignments([change]), schedule)
    assert list(tmp_path.iterdir()) == []
