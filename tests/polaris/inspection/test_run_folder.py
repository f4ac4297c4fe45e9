"""Run folders and commands of the inspection problem: what is written, that it repeats, how it fails."""

import csv
import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import polaris
from polaris.cli import app as cli
from polaris.model.errors import ScenarioError
from polaris.runs.files.ownership import MANIFEST
from polaris.runs.inspections.inspection import covered_periods
from polaris.runs.run import read_run
from polaris.scenario.scenario import load_scenario
from polaris.simulation.metrics import lower_bound

SHORT = ("--set", "flight.duration_s=20")
CAMPAIGN = ("campaign", "inspection-monte-carlo", "--runs", "2", "--set", "campaign.duration_s=5")
ALONE = ("--set", "campaign.deputies=2", "--workers", "1")
TIMES = ("created", "seconds", "filter_seconds")


def invoke(*args):
    return CliRunner().invoke(cli.app, list(map(str, args)))


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """One run folder of each kind, without figures."""
    place = tmp_path_factory.mktemp("runs")
    made = {}
    for kind, command in {
        "inspection": ("run", "inspection", *SHORT),
        "fuel_limit": ("run", "fuel-limit", *SHORT),
        "monte_carlo": (*CAMPAIGN, *ALONE),
    }.items():
        made[kind] = place / kind
        done = invoke(*command, "--out", made[kind], "--no-figures")
        assert done.exit_code == 0, done.output
        assert "Guarantee: " in done.stdout and "To draw the figures: polaris plot" in done.stdout
    return made


def summary(folder):
    def refuse(name):
        raise AssertionError(f"{name} is not strict JSON")

    return json.loads((folder / "summary.json").read_text(encoding="utf-8"), parse_constant=refuse)


# -- what is in them --------------------------------------------------------------------------------


def test_flight_folder_holds_what_was_flown(folders):
    folder = folders["inspection"]
    run, table = read_run(folder).plot_data(), summary(folder)
    assert run.x.shape == (21, 5, 6) and run.u.shape == (20, 5, 3)
    assert np.array_equal(run.x[0], load_scenario("inspection").initial()[0])
    Phi, Gamma = run.inspection.discretize(1.0)
    assert np.allclose(run.x[1:], run.x[:-1] @ Phi.T + run.u @ Gamma.T, rtol=0, atol=1e-9)
    assert np.abs(run.u).max() <= 1.0 and table["delta_v_m_s"] == pytest.approx(run.delta_v[-1])
    assert sum(table["steps"].values()) == run.status.size
    assert [row["constraint"] for row in table["constraints"]] == [f"phi{k}" for k in range(1, 12)]
    assert table["safe"] and table["guarantee"]["kind"] == "per_period"
    assert table["guarantee"]["periods_covered"] == table["guarantee"]["periods"] == 20
    distance = np.linalg.norm(run.x[..., :3], axis=2)
    assert table["constraints"][0]["least_at_samples"] == pytest.approx(distance.min() - 10.0)
    with (folder / "constraints.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["constraint"] for row in rows[:2]] == ["phi1", "phi2"] and len(rows) == 11 + 9
    assert float(rows[0]["least"]) == table["constraints"][0]["least"]


def test_periods_that_began_unsafe_or_had_no_solution_are_not_covered(folders):
    run = read_run(folders["inspection"]).plot_data()
    assert covered_periods(run).all()
    status, h, x = run.status.copy(), run.h.copy(), run.x.copy()
    status[3, 1], h[5, 0], x[7, 2, :3] = 2, -1e-9, 0.0
    changed = replace(run, status=status, h=h, x=x)
    assert np.flatnonzero(~covered_periods(changed)).tolist() == [3, 5, 7]


@pytest.mark.parametrize(
    ("settings", "word"),
    [
        (("filter.sampled_data=false",), "start of each period"),
        (('filter.without=["sun"]',), "left out: sun"),
        (('filter={ kind = "decentralized", sharing = "coasting" }',), "as if the other did not thrust"),
    ],
)
def test_nothing_is_claimed_beyond_what_the_filter_gives(tmp_path, settings, word):
    options = [part for text in settings for part in ("--set", text)]
    done = invoke(
        "run", "inspection", "--set", "flight.duration_s=3", *options, "--out", tmp_path / "a", "--no-figures"
    )
    assert done.exit_code == 0, done.output
    claim = summary(tmp_path / "a")["guarantee"]
    assert claim["kind"] == "none" and word in claim["reason"] and claim["assumptions"] == []


def test_fuel_folder_holds_what_was_flown(folders):
    folder, table = folders["fuel_limit"], summary(folders["fuel_limit"])
    run = read_run(folder).plot_data()
    assert run.x.shape == (21, 6) and table["latched_at_s"] is None and table["safe"]
    spent = np.abs(run.u).sum() / run.inspection.mass
    assert run.delta_v[-1] == pytest.approx(spent) == table["delta_v_m_s"]


def test_fuel_limit_is_kept_by_the_backup(tmp_path):
    settings = ("--set", "flight.duration_s=400", "--set", "fuel.spent_m_s=18")
    done = invoke("run", "fuel-limit", *settings, "--out", tmp_path / "a", "--no-figures")
    assert done.exit_code == 0 and "The fuel limit is kept." in done.stdout
    table = summary(tmp_path / "a")
    assert 0 < table["latched_at_s"] < 400 and 0 <= table["phi12_least_m_s"] < 2
    assert table["guarantee"]["kind"] == "by_prediction" and table["delta_v_m_s"] > 19


@pytest.mark.parametrize(
    "settings",
    [
        ("initial_state=[0,60,0,0,-4,0]", "flight.duration_s=200"),  # too fast to turn before the chief
        ("initial_state=[0,400,0,0,3,0]", "fuel.spent_m_s=19", "flight.duration_s=20"),  # too little fuel
    ],
)
def test_nothing_is_claimed_of_a_flight_that_begins_on_backup(tmp_path, settings):
    words = [word for setting in settings for word in ("--set", setting)]
    done = invoke("run", "fuel-limit", *words, "--out", tmp_path / "a", "--no-figures")
    table = summary(tmp_path / "a")
    assert done.exit_code == 0 and table["latched_at_s"] == 0
    assert table["guarantee"]["kind"] == "none"
    assert ("thrust was cut off" if "fuel.spent_m_s=19" in settings else "took over at the start") in table[
        "guarantee"
    ]["reason"]


def test_campaign_folder_holds_what_was_flown(folders):
    table, picture = summary(folders["monte_carlo"]), read_run(folders["monte_carlo"]).plot_data()
    assert [study["name"] for study in table["studies"]] == list(picture.studies)
    assert picture.x.shape == (2, 2, 6) and table["guarantee"]["kind"] == "statistical"
    for study, success in zip(table["studies"], picture.success, strict=True):
        assert study["successes"] == success.sum()
        assert study["success_share_lower_95"] == lower_bound(int(success.sum()), 2)


def test_lower_bound_is_clopper_and_pearsons():
    assert lower_bound(0, 10) == 0.0
    assert lower_bound(2000, 2000) == pytest.approx(0.05 ** (1 / 2000))
    assert lower_bound(90, 100) < 0.9


# -- repeating --------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["inspection", "fuel_limit", "monte_carlo"])
def test_the_same_scenario_gives_the_same_bytes(folders, tmp_path, kind):
    command = {
        "inspection": ("run", "inspection", *SHORT),
        "fuel_limit": ("run", "fuel-limit", *SHORT),
        "monte_carlo": (*CAMPAIGN, *ALONE),
    }[kind]
    assert invoke(*command, "--out", tmp_path / "again", "--no-figures", "-q").exit_code == 0
    names = [path.relative_to(folders[kind]) for path in sorted(folders[kind].rglob("*")) if path.is_file()]
    for name in names:
        if name.name not in ("summary.json", "manifest.json", MANIFEST):  # they tell when
            assert (tmp_path / "again" / name).read_bytes() == (folders[kind] / name).read_bytes(), name
    one, other = summary(folders[kind]), summary(tmp_path / "again")
    for key in one.keys() - set(TIMES):
        assert one[key] == other[key], key


def test_overrides_are_noted_and_read_back(folders):
    text = (folders["inspection"] / "scenario.toml").read_text(encoding="utf-8")
    assert "#   flight.duration_s=20" in text
    assert read_run(folders["inspection"]).scenario.model.flight.duration_s == 20.0
    for kind, folder in folders.items():
        assert read_run(folder).kind.name == read_run(folder).scenario.kind == kind
    with pytest.raises(ScenarioError, match=r"must be a run folder; it has no scenario\.toml"):
        read_run(folders["inspection"].parent)


# -- failing ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("damage", [b"", b"PK nonsense", None])
def test_damaged_or_missing_file_is_one_readable_error(folders, tmp_path, damage):
    folder = tmp_path / "broken"
    shutil.copytree(folders["inspection"], folder)
    (folder / "flight.npz").unlink()
    if damage is not None:
        (folder / "flight.npz").write_bytes(damage)
    done = invoke("plot", folder)
    assert done.exit_code == 2 and done.stderr.startswith("error: run folder")
    assert len(done.stderr.strip().splitlines()) == 1


def test_arrays_that_do_not_belong_together_are_refused(folders, tmp_path):
    folder = tmp_path / "broken"
    shutil.copytree(folders["inspection"], folder)
    with np.load(folder / "flight.npz") as file:
        arrays = {name: file[name] for name in file.files}
    np.savez(folder / "flight.npz", **{**arrays, "states": arrays["states"][:-1]})
    with pytest.raises(ScenarioError, match="wrong shape"):
        read_run(folder).plot_data()
    arrays["states"][3, 1, 2] = np.nan
    np.savez(folder / "flight.npz", **arrays)
    with pytest.raises(ScenarioError, match="not finite"):
        read_run(folder).plot_data()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("campaign", "inspection"), ("polaris run",)),
        (("campaign", "nope"), ("nope",)),
        (("run", "inspection", "--solver", "highs"), ("planner", "unknown key")),
        (("run", "inspection", "--set", "flight.periode_s=1"), ("did you mean period_s",)),
        (("run", "inspection", "--set", "initial.states[7][0]=1"), ("initial.states[7]",)),
        (("falsify", "inspection"), ("'schedule' here",)),
        (("model-error", "fuel-limit"), ("'schedule' here",)),
    ],
)
def test_bad_input_is_one_message_and_exit_code_2(tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    done = invoke(*arguments)
    assert done.exit_code == 2, done.output
    lines = [line for line in done.stderr.strip().splitlines() if line.startswith("error: ")]
    assert len(lines) == 1 and all(word in lines[0] for word in words), done.stderr
    assert list(tmp_path.iterdir()) == []


OUTWARDS = (
    "initial.states=[[0, -985, 0, 0, -0.1, 0]]",
    'filter.without=["keep_in"]',
    "flight.duration_s=40",
    'primary=[{ kind = "to_distance", distance_m = 1200 }]',
    "parameters.delta_v_max_m_s=0.5",
)


def outwards(*more):
    """Return the words of a command that flies away from the chief, with other assignments after its own."""
    sets = [word for assignment in (*OUTWARDS, *more) for word in ("--set", assignment)]
    return ["run", "inspection", *sets, "--no-figures", "--out"]


def test_a_flight_that_violates_ends_with_exit_code_5_and_says_what_exceeds_the_tank(tmp_path):
    """By a process of its own: a caller sees its exit code."""
    command = [sys.executable, "-m", "polaris", *outwards(), "a"]
    environment = {**os.environ, "PYTHONPATH": str(Path(polaris.__file__).parents[1])}
    done = subprocess.run(
        command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 5, done.stdout + done.stderr
    assert summary(tmp_path / "a")["safe"] is False
    assert "CONSTRAINTS ARE VIOLATED." in done.stdout
    assert "THE FUEL LIMIT IS EXCEEDED" in done.stdout and "of 0.5 m/s" in done.stdout


def test_a_flight_that_violates_nothing_ends_with_exit_code_0_and_says_neither(tmp_path):
    done = invoke(*outwards("filter.without=[]", "flight.duration_s=2"), tmp_path / "a")
    assert done.exit_code == 0, done.output
    assert summary(tmp_path / "a")["safe"] is True
    assert "CONSTRAINTS ARE VIOLATED." not in done.stdout and "FUEL LIMIT IS EXCEEDED" not in done.stdout


@pytest.mark.parametrize("name", ["inspection", "fuel-limit", "inspection-monte-carlo"])
def test_check_tells_what_a_scenario_is(name):
    done = invoke("check", name)
    assert done.exit_code == 0 and done.stdout.startswith(f"{name} is valid: ")


def test_json_is_the_summary_and_nothing_else(tmp_path):
    out = tmp_path / "a"
    done = invoke("run", "inspection", "--set", "flight.duration_s=2", "--no-figures", "--out", out, "--json")
    assert (done.exit_code, done.stderr) == (0, "")
    assert json.loads(done.stdout) == summary(out)


def test_a_run_that_fails_late_leaves_the_old_folder_whole(folders, tmp_path, monkeypatch):
    folder = tmp_path / "run"
    shutil.copytree(folders["inspection"], folder)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}

    def fail(*args):
        raise RuntimeError("no ink")

    monkeypatch.setattr("polaris.report.figures.draw_figures", fail)
    assert invoke("run", "inspection", "--set", "flight.duration_s=2", "--out", folder, "-q").exit_code == 1
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before
