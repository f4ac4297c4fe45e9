"""Run folders: what is in them, that it reads back, and that they are never half there."""

import csv
import itertools
import json
import math
import re
import shutil

import numpy as np
import pytest
from typer.testing import CliRunner

import polaris
from polaris.certificate.checker import verify
from polaris.cli.app import app
from polaris.cli.show.schedule import show_summary
from polaris.model.errors import ScenarioError
from polaris.report import report_page
from polaris.report.figures import draw_run
from polaris.rta.arena import compare_methods
from polaris.runs.comparison import write_comparison
from polaris.runs.run import read_run
from polaris.runs.schedule import DATA_FILES, write_run
from polaris.scenario.scenario import load_scenario
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


def test_all_files_are_there_and_nothing_else(folder):
    names = {path.name for path in folder.path.iterdir()}
    assert names == {*DATA_FILES, "certificate.json", "summary.json", "figures", ".polaris.jsonl"}
    assert len(list((folder.path / "figures").glob("[!.]*"))) == 8
    assert [path.name for path in folder.path.parent.iterdir()] == ["tiny"]


def test_same_seed_same_bytes_times_apart(folder, tmp_path):
    scenario, schedule = synthesised()
    again = write_run(tmp_path / "again", scenario, schedule)  # flown anew from the scenario's seed
    for name in (*DATA_FILES, "certificate.json"):  # and figures: see test_figures
        assert (again.path / name).read_bytes() == (folder.path / name).read_bytes(), name
    summaries = [folder.summary, again.summary]
    for summary in summaries:
        del summary["created"], summary["synthesis"]["seconds"]
    assert json.dumps(summaries[0]) == json.dumps(summaries[1])


def belong_somewhere(seconds):
    """Return True if all times but the total add up to it, and none is negative but by rounding."""
    named = [spent for stage, spent in seconds.items() if stage not in ("total", "plan_parts")]
    return math.isclose(sum(named), seconds["total"], rel_tol=1e-9) and min(named) > -1e-6


def test_every_second_belongs_to_a_stage_or_to_other(folder, tmp_path):
    """As a run tells it, on the console too, and where a schedule made before is written."""
    assert belong_somewhere(folder.summary["synthesis"]["seconds"])
    out = tmp_path / "whole"
    done = CliRunner().invoke(app, ["run", str(TINY), "--set", QUARTER, "--out", str(out), "--no-figures"])
    seconds = load_strict(out / "summary.json")["synthesis"]["seconds"]
    wanted = {"bounds", "plan", "recoverable", "schedule", "bound", "simulation", "files", "other"}
    assert belong_somewhere(seconds) and wanted <= set(seconds), done.output
    text = " ".join(done.stdout.split())
    total, stages = re.search(r"Computation time: ([\d.]+) s \((.*?)\)\.", text).groups()
    shown = [float(stage.split()[-1]) for stage in stages.split(", ")]
    assert sum(shown) == pytest.approx(float(total), abs=0.005 * (len(seconds) + 1))
    short = polaris.run("inspection", tmp_path / "short", overrides=["flight.duration_s=5"])
    assert belong_somewhere(short.summary["seconds"])


@pytest.mark.parametrize("change", [QUARTER, "schedule.delta_v_max_m_s=5.3"])
def test_stages_of_a_synthesis_follow_one_another(change, monkeypatch):
    """By a clock that counts its readings: no reading is counted twice, none is left out."""
    ticks = itertools.count()
    monkeypatch.setattr("polaris.synthesis.safety.attempts.time.perf_counter", lambda: float(next(ticks)))
    scenario = load_scenario(TINY, [change])
    first = next(ticks)
    schedule = polaris.synthesize(scenario)
    last = next(ticks)
    assert first < sum(schedule.seconds.values()) + first < last
    assert last - first - sum(schedule.seconds.values()) < 5


def test_each_of_several_experimental_controllers_flies_alone_and_is_named(tmp_path, capsys):
    """In the console's table, the summary, the files, the page, a comparison, and for the checker."""
    more = {"kind": "any_thrust", "name": "pilot", "weight": 1.0}
    tables = [more, *load_scenario(TINY).to_dict()["experimental"]]
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
    shown = report_page(run)
    compared = compare_methods(schedule, 2, methods=["experimental"])
    assert list(compared.results) == list(alone)
    folder = write_comparison(tmp_path / "compared", scenario, compared)
    for name in alone.values():
        title = f"U alone ({name})"
        assert title in str({key: text for key, _, text in shown.sections}["numbers"])
        assert title in [controller["name"] for controller in shown.data["pilots"]]
        assert title in [method["name"] for method in folder.summary["methods"]]
    assert {one.metrics.switches.max() for one in compared.results.values()} == {0}
    show_summary(run.summary, "here")
    words = capsys.readouterr().out
    assert all(f"({name})" in words for name in alone.values())


def test_summary_holds_the_promised_keys(folder):
    summary = load_strict(folder.path / "summary.json")
    keys = {
        "min_distance_m",
        "min_ttc_s",
        "min_ttc_free_drift_s",
        "experimental_share",
        "switches",
        "delta_v_m_s",
    }
    for who in ("safety", "experimental", "polaris"):
        assert keys | {"collided", "max_thrust_ratio", "runs"} <= set(summary[who])
        assert set(summary[who]) - {"controller", "drift_horizon_s"} <= set(summary["definitions"])
    assert {"bounds", "plan", "recoverable", "schedule", "total"} <= set(summary["synthesis"]["seconds"])
    assert {"status", "gap", "solver", "delta_v_m_s", "margin_m"} <= set(summary["synthesis"]["planner"])
    claims = {"kind", "horizon", "until_s", "reason", "assumptions", "goal", "upkeep"}
    assert set(summary["guarantee"]) == claims
    assert summary["guarantee"]["kind"] == "proved" and summary["seed"] == 0
    assert summary["experimental"]["collided"] and summary["experimental"]["min_distance_m"] < 0
    for who in ("safety", "polaris"):
        assert not summary[who]["collided"] and summary[who]["min_distance_m"] > 0
    assert summary["safety"]["experimental_share"] == 0 and summary["experimental"]["experimental_share"] == 1
    for who, other in (("safety", "experimental"), ("experimental", "safety")):
        assert summary[who][f"max_thrust_ratio_{who}"] == summary[who]["max_thrust_ratio"]
        assert summary[who][f"max_thrust_ratio_{other}"] is None
    both = [summary["polaris"][f"max_thrust_ratio_{who}"] for who in ("safety", "experimental")]
    assert max(both) == summary["polaris"]["max_thrust_ratio"] and both[0] <= 1


def test_times_are_only_where_they_can_be_stripped(folder):
    summary = folder.summary
    assert "T" in summary.pop("created")
    assert summary["synthesis"].pop("seconds")
    assert "seconds" not in json.dumps({**summary, "definitions": {}})


def test_scenario_copy_is_the_file_itself(folder):
    assert (folder.path / "scenario.toml").read_bytes() == TINY.read_bytes()


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


def test_reference_reads_back_bit_for_bit(folder):
    reference, read = synthesised()[1].safety.reference, folder.plot_data().reference
    np.testing.assert_array_equal(read.chi, reference.chi)
    np.testing.assert_array_equal(read.nu, reference.nu)
    header = (folder.path / "reference.csv").read_text(encoding="utf-8").splitlines()[0]
    assert header == "t_s,x0,x1,x2,x3,u0,u1"


def test_gains_hold_what_a_replay_needs(folder):
    data, schedule = load_strict(folder.path / "gains.json"), synthesised()[1]
    np.testing.assert_array_equal(data["controllers"][0]["gain"], schedule.safety.tracking.gain)
    assert np.shape(data["controllers"][1]["reference_states"]) == (13, 4)
    feedback = schedule.safety.tracking.feedback
    assert data["sampling"] == {"step": 1.0, "steps": 12, "nodes_per_step": feedback.nodes_per_cell}


@pytest.mark.parametrize("name", ["sets.npz", "tubes.npz", "trajectories.npz"])
def test_arrays_load_without_pickle(folder, name):
    with np.load(folder.path / name, allow_pickle=False) as arrays:
        for key in arrays.files:
            assert arrays[key].dtype != object
            if arrays[key].dtype.kind == "f" and not key.startswith(("thrust_clearance", "slice")):
                assert not np.any(np.isnan(arrays[key])), key


def test_tubes_contain_the_runs(folder):
    schedule = synthesised()[1]
    with np.load(folder.path / "tubes.npz", allow_pickle=False) as tubes:
        half = np.abs(tubes["generators"]).sum(axis=1, dtype=float).swapaxes(0, 1)
        low, high = tubes["center"] - half, tubes["center"] + half
    exact = np.array([step.tube.nodes.half_widths for step in schedule.steps])
    assert np.all(half >= exact) and np.all(half <= exact * (1 + 1e-6) + 1e-30)  # single precision
    q = schedule.safety.tracking.feedback.nodes_per_cell
    with np.load(folder.path / "trajectories.npz", allow_pickle=False) as runs:
        states = runs["polaris_states"]
        assert runs["polaris_labels"][0] == "nominal" and "closest" in runs["polaris_labels"]
    for k in range(len(schedule.steps)):
        inside = states[:, k * q : (k + 1) * q + 1]
        assert np.all(inside >= low[k] - 1e-9) and np.all(inside <= high[k] + 1e-9)


def test_sets_hold_the_radius_of_every_node(folder):
    safety = synthesised()[1].safety
    with np.load(folder.path / "sets.npz", allow_pickle=False) as sets:
        assert str(sets["kind"]) == "polytope" and sets["slice_outline_m"].shape[1:] == (5, 24, 2)
        assert sets["slice_place_m"].shape == (len(sets["slice_t_s"]), 5, 2)
        q = safety.tracking.feedback.nodes_per_cell
        assert sets["radius"][3] == safety.recoverable.radius(3 * q)
        assert sets["obstacle_clearance_m"].shape == (safety.reference.cells, q + 1, 2)


# -- replacing and reading ----------------------------------------------------------------------------


def test_a_newer_run_replaces_the_older_one(tmp_path):
    scenario, schedule = synthesised()
    target = tmp_path / "deep" / "er"
    write_run(target, scenario, schedule, flown())
    (target / "note.txt").write_text("mine", encoding="utf-8")
    other = scenario.with_assignments(["simulation.seed=5"])
    write_run(target, other, schedule, flown())
    assert (target / "note.txt").read_text(encoding="utf-8") == "mine"
    assert read_run(target).scenario.simulation.seed == 5
    assert [path.name for path in target.parent.iterdir()] == ["er"]


def test_an_empty_folder_is_taken(tmp_path):
    scenario, schedule = synthesised()
    (tmp_path / "empty").mkdir()
    written = write_run(tmp_path / "empty", scenario, schedule, flown())
    assert written.summary["scenario"] == "tiny"


@pytest.mark.parametrize("name", DATA_FILES)
def test_missing_file_is_named(folder, tmp_path, name):
    import shutil

    copy = tmp_path / "copy"
    shutil.copytree(folder.path, copy)
    (copy / name).unlink()
    with pytest.raises(ScenarioError, match=name):
        read_run(copy)


@pytest.mark.parametrize("name", [n for n in DATA_FILES if n not in ("schedule.csv", "gains.json")])
@pytest.mark.parametrize("damage", [b"", b"\x00\xff garbage", b"{}"])
def test_damaged_file_is_one_readable_error(folder, tmp_path, name, damage):
    import shutil

    copy = tmp_path / "copy"
    shutil.copytree(folder.path, copy)
    (copy / name).write_bytes(damage)
    with pytest.raises(ScenarioError) as error:
        read_run(copy).plot_data()
    assert "\n" not in str(error.value)


def test_pickled_arrays_are_refused(folder, tmp_path):
    import shutil

    copy = tmp_path / "copy"
    shutil.copytree(folder.path, copy)
    np.savez(copy / "tubes.npz", center=np.array([{"code": "run me"}], dtype=object))
    with pytest.raises(ScenarioError, match="damaged"):
        read_run(copy).plot_data()


# -- evaluation -------------------------------------------------------------------------------------


def test_metrics_of_batches_join_to_those_of_all(monkeypatch):
    from polaris.simulation import baselines as comparison

    schedule = synthesised()[1]
    monkeypatch.setattr(comparison, "BATCH", 5)
    parts = comparison.compare(schedule, 12, 0)
    for who, item in parts.items():
        metrics, flights = item.metrics, item.flights
        assert len(metrics.min_distance) == 12
        assert flights.labels[0] == "nominal" and np.all(np.diff(flights.nearest, axis=0) >= -1e-12)
        closest = flights.states[flights.labels.index("closest")]
        place = closest @ schedule.safety.problem.system.position.T
        gaps = [o.signed_distance(flights.times, place) for o in schedule.safety.problem.unsafe]
        assert np.min(gaps) == pytest.approx(metrics.min_distance.min(), abs=0.05), who


def test_metrics_as_a_table(monkeypatch):
    import sys
    from types import SimpleNamespace

    monkeypatch.setitem(sys.modules, "pandas", SimpleNamespace(DataFrame=dict))
    metrics = flown()["polaris"].metrics
    table = metrics.to_pandas()
    assert {len(column) for column in table.values()} == {len(metrics.min_distance)}
    assert np.array_equal(table["delta_v_m_s"], metrics.delta_v)


def test_closest_approach_is_not_missed_between_nodes():
    from polaris.simulation.run_metrics import evaluate
    from polaris.simulation.simulate import simulate

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


def test_no_obstacles_reads_null_and_not_infinity():
    from dataclasses import replace

    from polaris.simulation.run_metrics import evaluate
    from polaris.simulation.simulate import simulate

    schedule = synthesised()[1]
    bare = replace(schedule.safety, problem=replace(schedule.safety.problem, unsafe=()))
    runs = simulate(schedule, 2)
    summary = evaluate(replace(runs, schedule=replace(schedule, safety=bare))).summary()
    assert summary["min_distance_m"] is None and summary["min_ttc_s"] is None and not summary["collided"]


def test_true_states_of_another_satellite_stay_in_what_is_known():
    from polaris.model.hill import clohessy_wiltshire
    from polaris.model.scene.satellite import SatelliteObstacle, true_states

    system = clohessy_wiltshire(0.0012, 10.0, 0.1, 1e-5)
    visitor = SatelliteObstacle(
        "visitor", [100.0, 200, 0, 0, 0.1, 0], [2.0, 2, 2, 0.01, 0.01, 0.01], 20.0, 1e-4
    )
    times = np.arange(31) * 20.0
    states = true_states([visitor], system, times, 40, np.random.default_rng(0))["visitor"]
    assert states.shape == (40, 31, 6)
    cover = visitor.timed_polytopes(system, 20.0, 30)[0]
    heights = states[:, :-1] @ system.position.T @ cover.normals.T + visitor.radius
    assert np.all(heights <= cover.offsets[:, 0] + 1e-6)


@pytest.mark.parametrize("name", DATA_FILES)
def test_a_changed_file_is_not_read_as_part_of_the_run(folder, tmp_path, name):
    """Whatever was edited: no picture or report of a proof that was never made."""
    shutil.copytree(folder.path, tmp_path / "run")
    path = tmp_path / "run" / name
    path.write_bytes(path.read_bytes() + b"\n")
    with pytest.raises(ScenarioError, match=f"{name}.*edited"):
        read_run(tmp_path / "run")


def test_an_edited_scenario_is_never_drawn_as_proven(folder, tmp_path):
    shutil.copytree(folder.path, tmp_path / "run")
    path = tmp_path / "run" / "scenario.toml"
    path.write_text(path.read_text("utf-8").replace("[4.0, 3.0]", "[2.0, 3.0]"), encoding="utf-8")
    for command in (["plot"], ["report"], ["falsify", "--runs", "1"], ["export"]):
        more = [str(tmp_path / "t.json")] if command == ["export"] else []
        done = CliRunner().invoke(app, [command[0], str(tmp_path / "run"), *more, *command[1:]])
        assert done.exit_code == 2 and "scenario.toml" in done.stderr, done.output


def test_a_schedule_is_not_written_under_another_scenario(tmp_path):
    scenario, schedule = synthesised()
    for key, value in (
        ("obstacles[0].center_m", "[3, 3]"),
        ("system.input_max", "2"),
        ("horizon.step_s", "2"),
    ):
        with pytest.raises(ScenarioError, match="must"):
            write_run(tmp_path / "run", scenario.with_assignments([f"{key}={value}"]), schedule)
    assert list(tmp_path.iterdir()) == []
