"""Single runs flown again from a campaign's folder, and the commands."""

import csv
import json
import shutil

import numpy as np
import pytest
from typer.testing import CliRunner

from polaris.cli import app as cli
from polaris.model.errors import PolarisError, ScenarioError
from polaris.runs.campaign import find_worst, make_cases, read_campaign, replay_run, schedules
from polaris.runs.campaign.plan import parse_grid
from polaris.scenario.scenario import load_scenario
from tests.polaris.rta.test_late_faults import TWOS
from tests.polaris.runs.campaign.scene import MODES, RUNS, TINY, rows, table
from tests.polaris.runs.campaign.scene import run as fly_campaign
from tests.polaris.synthesis.sources.test_transients import LATE, LOST, OBSERVED


def invoke(*arguments):
    return CliRunner().invoke(cli.app, [str(argument) for argument in arguments])


@pytest.mark.parametrize("mode", MODES)
def test_replay_gives_the_numbers_of_the_table(flown, mode):
    folder, mass = read_campaign(flown.path), load_scenario(TINY).problem().system.mass
    for case, batch, run in ((0, 0, 0), (1, 2, 3), (1, 4, 1)):
        replayed = replay_run(folder, case, batch, run, mode)
        (row,) = [
            row
            for row in rows(flown.path)
            if (row["case"], row["batch"], row["run"], row["mode"]) == (case, batch, run, mode)
        ]
        np.testing.assert_equal(replayed.row, row)
        # the trajectory is that of these numbers, up to the refinement between the nodes
        distances, times = replayed.arrays["distances_m"], replayed.arrays["times_s"]
        assert distances.min() == pytest.approx(row["min_distance_m"], abs=5e-3)
        assert distances.min() >= row["min_distance_m"]
        delta_v = np.abs(replayed.arrays["inputs"]).sum() * times[1] / mass
        assert delta_v == pytest.approx(row["delta_v_m_s"], rel=0.05)


@pytest.mark.parametrize(
    ("kind", "late", "seen"),
    [("loss", LATE, [OBSERVED]), ("navigation_lost", LOST, [])],
    ids=["loss-observer", "navigation_lost-state"],
)
def test_a_fault_befalls_every_second_run_and_is_flown_again(kind, late, seen, tmp_path):
    scene = load_scenario(TINY).with_assignments([*SOFT, *TWOS, late, *seen])
    folder = fly_campaign(make_cases([scene]), 12, tmp_path / "c", batch=6)
    lines, calm = rows(folder.path), fly_campaign(make_cases([scene]), 12, tmp_path / "d", batch=6, calm=True)
    assert [row["fault"] for row in lines] == ["", kind] * 6
    assert len({row["fault_begins_s"] for row in lines[1::2]}) > 3
    for i, (row, other) in enumerate(zip(lines, rows(calm.path), strict=True)):
        assert not row["collided"] and row["max_thrust_ratio_safety"] <= 1
        same = row["min_distance_m"] == pytest.approx(other["min_distance_m"], rel=1e-9)
        assert same and row["fault_ends_s"] != row["fault_ends_s"] if i % 2 == 0 else "fault" not in other
        replayed = replay_run(folder, 0, row["batch"], row["run"])
        np.testing.assert_equal(replayed.row, row)
        modes, times = replayed.arrays["modes"], replayed.arrays["times_s"][:-1]
        assert (1 in modes) or i % 2
        assert not np.any(modes[times >= row["fault_ends_s"]])
    changes = [a["delta_v_m_s"] - b["delta_v_m_s"] for a, b in zip(lines, rows(calm.path), strict=True)]
    assert np.all(np.abs(changes[1::2]) > 1e-6)


def test_the_worst_runs_are_found_in_their_order(flown):
    folder = read_campaign(flown.path)
    for mode in MODES:
        ordered = sorted(
            (row["min_distance_m"], row["case"], row["batch"], row["run"])
            for row in rows(flown.path)
            if row["mode"] == mode
        )
        for rank in (1, 2, 2 * RUNS):
            assert find_worst(folder, rank, mode) == ordered[rank - 1][1:]
        ones = [entry for entry in ordered if entry[1] == 1]
        assert find_worst(folder, 3, mode, 1) == ones[2][1:]
    with pytest.raises(ScenarioError, match=rf"from 1 to the number of runs, {2 * RUNS}"):
        find_worst(folder, 2 * RUNS + 1)


@pytest.mark.parametrize(
    ("place", "mode", "word"),
    [
        ((2, 0, 0), "polaris", "--case"),
        ((0, 5, 0), "polaris", "--batch"),
        ((0, 4, 2), "polaris", "--run"),
        ((0, 0, 0), "safety", "must be a mode that was flown"),
    ],
)
def test_runs_that_are_not_there_are_refused(flown, place, mode, word):
    with pytest.raises(ScenarioError, match=word):
        replay_run(read_campaign(flown.path), *place, mode)


@pytest.mark.parametrize(
    ("arguments", "code", "word"),
    [
        (
            ("campaign", TINY, "--runs", 3, "--workers", 1, "--set", "system.input_max=0.02", "-q"),
            3,
            "no case has a schedule; tiny: ",
        ),
        (("campaign", TINY, "--grid", "x"), 2, "key=value"),
        (("campaign", TINY, "--workers", 2, "--scheduler", "tcp://127.0.0.1:1"), 2, "--workers"),
        (("campaign", TINY, "inspection-monte-carlo"), 2, "inspection scenario, which must be alone"),
        (("campaign", "inspection-monte-carlo", "--seed", 3), 2, "--seed"),
        (("campaign", "inspection", "--workers", 1), 2, "polaris run"),
        (("campaign-replay", "nope", "--worst", 1), 2, "manifest.json"),
        (("campaign-replay", "{flown}", "--case", 0), 2, "--worst"),
        (("campaign-replay", "{flown}", "--worst", 1, "--run", 2), 2, "left out with --batch"),
        (("campaign-replay", "{flown}", "--worst", 1, "--out", "a.txt"), 2, ".csv or .npz"),
    ],
)
def test_bad_input_is_one_message_and_an_exit_code(flown, tmp_path, monkeypatch, arguments, code, word):
    monkeypatch.chdir(tmp_path)
    done = invoke(*(str(each).format(flown=flown.path) for each in arguments))
    assert (done.exit_code, done.stdout) == (code, ""), done.output
    assert done.stderr.startswith("error: ") and done.stderr.count("\n") == 1 and word in done.stderr


def test_missing_parts_and_other_numbers_are_told(flown, tmp_path, monkeypatch):
    shutil.copytree(flown.path, tmp_path / "c")
    folder = read_campaign(tmp_path / "c")
    (folder.path / "runs" / "case-0000-batch-00001.parquet").unlink()
    with pytest.raises(ScenarioError, match=r"case-0000-batch-00001\.parquet is missing or damaged"):
        replay_run(folder, 0, 1, 0)
    with pytest.raises(ScenarioError, match="must be finished"):
        find_worst(folder, 1)
    real = schedules.ScheduleRuns.fly

    def another(self, task, mode, run=None):
        outcome = real(self, task, mode, run)
        outcome.columns["delta_v_m_s"] = np.nextafter(outcome.columns["delta_v_m_s"], np.inf)
        return outcome

    monkeypatch.setattr(schedules.ScheduleRuns, "fly", another)
    with pytest.raises(PolarisError, match="differs on this machine: delta_v_m_s"):
        replay_run(folder, 0, 0, 0)


def test_commands_fly_print_and_replay(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    options = ("--runs", 6, "--batch", 4, "--workers", 1, "--mode", "safety", "--mode", "polaris")
    grid = ("--grid", "system.input_max=1.0,0.02", "--set", "planner.extra_margin_m=0.3")
    done = invoke("campaign", TINY, *options, *grid)
    assert done.exit_code == 0, done.output
    assert (
        "0: tiny, system.input_max=1 " in done.stdout
        and "1: tiny, system.input_max=0.02: no schedule" in (done.stdout)
    )
    before = table("runs/tiny-campaign")
    printed = invoke("campaign", TINY, *options, *grid, "--json")
    assert printed.exit_code == 0 and table("runs/tiny-campaign") == before
    summary = json.loads(printed.stdout)
    assert [("failure" in case) for case in summary["cases"]] == [False, True]
    worst = summary["cases"][0]["modes"]["polaris"]["worst_runs"][1]
    replayed = invoke(
        "campaign-replay", "runs/tiny-campaign", "--worst", 2, "--mode", "polaris", "--json", "--out", "w.csv"
    )
    assert replayed.exit_code == 0, replayed.output
    row = json.loads(replayed.stdout)
    assert (row["batch"], row["run"], row["min_distance_m"]) == tuple(worst.values())
    with open("w.csv", encoding="utf-8", newline="") as file:
        lines = list(csv.DictReader(file))
    place = ("--case", 0, "--batch", row["batch"], "--run", row["run"], "--mode", "polaris")
    replayed = invoke("campaign-replay", "runs/tiny-campaign", *place, "--out", "w.npz")
    assert replayed.exit_code == 0 and f"{row['delta_v_m_s']}" in replayed.stdout
    with np.load("w.npz") as arrays:
        np.testing.assert_array_equal([float(line["t_s"]) for line in lines], arrays["times_s"])
        assert float(lines[7]["distance_pillar_m"]) == arrays["distances_m"][0, 7]
        assert lines[0]["mode"] == "0" and lines[-1]["mode"] == ""
    assert {path.name for path in tmp_path.iterdir()} == {"runs", "w.csv", "w.npz"}


SOFT = ["feedback.period_s=0.25", "tracking.R=[60.0,60.0]"]
LITTLE = "state_error=[0.001,0.001,0.001,0.001]"
PLACES = "matrix=[[1.0,0.0,0.0,0.0],[0.0,1.0,0.0,0.0]]"
TOGETHER = (
    (
        *(
            f"navigation.{LITTLE}",
            f"navigation.phases=[{{from_s=4.0,{LITTLE}}}]",
            "navigation.phases[0].within_m=20.0",
        ),
        *("timing.delay_s=0.25", "timing.missed_periods=1", "timing.clock_error_s=0.01"),
        *("thrusters.magnitude_error=0.01", "thrusters.mass_error=0.01", "chaser.radius_m=0.01"),
        *("faults=[{kind='navigation_lost',lasts_s=0.5}]", "tank.delta_v_m_s=50.0"),
        *("abort.keep_in=false", "tracking.thrust_share=1.0"),
    ),
    (
        *("navigation.measurement.error=[0.01,0.01]", f"navigation.measurement.initial={{{LITTLE}}}"),
        *("timing.delay_s=0.1", "thrusters.impulse_bit_N_s=0.001", "thrusters.remainder=carried"),
        *("thrusters.pulse=held,centred", "faults[0].share=0.05", "abort.orbit={kind='goal'}"),
        *("abort.within_s=6.0", "abort.delta_v_max_m_s=20.0"),
    ),
)


@pytest.mark.parametrize("texts", TOGETHER)
def test_what_flights_may_suffer_from_can_be_a_grid_and_is_replayed(texts, tmp_path):
    """Keys that have no meaning without others may be of the grid, and those others common to all."""
    common = ["abort.drift_s=1.0"]
    if texts is not TOGETHER[0]:
        common = [f"navigation.measurement.{PLACES}", "faults=[{kind='loss',share=0.1}]"]
    cases = make_cases([TINY], parse_grid(texts), [*SOFT, *common])
    folder = fly_campaign(cases, 3, tmp_path / "c")
    assert len(rows(folder.path)) == 3 * len(cases)
    for row in rows(folder.path)[::2]:
        np.testing.assert_equal(replay_run(folder, row["case"], row["batch"], row["run"]).row, row)
