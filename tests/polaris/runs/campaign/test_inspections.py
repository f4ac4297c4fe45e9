"""The Monte Carlo of the inspection problem as a campaign: resumed, replayed, with and without pyarrow."""

import csv
import json
import sys

import numpy as np
import pytest
from typer.testing import CliRunner

from polaris.cli import app as cli
from polaris.inspection.flights.sampling import InitialConditions
from polaris.model.errors import PolarisError, ScenarioError
from polaris.runs.campaign import find_worst, inspections, read_campaign, replay_run
from polaris.runs.inspections.monte_carlo import run_monte_carlo
from polaris.runs.run import read_run, run
from polaris.scenario.scenario import load_scenario
from tests.polaris.runs.campaign.scene import table

STUDIES = ("centralized", "decentralized", "decentralized-no-h5", "decentralized-shared")
RUNS = 5


def scenario(*changed):
    small = ("campaign.deputies=2", "campaign.duration_s=3", f"campaign.runs={RUNS}")
    return load_scenario("inspection-monte-carlo", (*small, *changed))


@pytest.fixture(scope="module", autouse=True)
def small_blocks():
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("polaris.runs.inspections.monte_carlo.BLOCK", 2)
        yield


@pytest.fixture(scope="module")
def flown(small_blocks, tmp_path_factory):
    return run_monte_carlo(tmp_path_factory.mktemp("campaign") / "here", scenario())


def test_all_studies_fly_the_same_conditions_and_the_picture_is_that_of_the_table(flown):
    columns, picture = flown.read(0), read_run(flown.path).plot_data()
    assert len(columns["run"]) == RUNS * len(STUDIES) and picture.studies == STUDIES
    assert len(list((flown.path / "runs").glob("case-*.parquet"))) == 3
    x, sun = InitialConditions(scenario().families(), 1).first(RUNS)
    np.testing.assert_array_equal(picture.x, x)
    assert len(np.unique(sun)) == RUNS, "no batch flies another one's conditions"
    for k, name in enumerate(STUDIES):
        of_study = columns["mode"] == name
        np.testing.assert_array_equal(columns["deputy_1_vy_m_s"][of_study], picture.x[:, 1, 4])
        np.testing.assert_array_equal(columns["sun_rad"][of_study], sun)
        np.testing.assert_array_equal(columns["success"][of_study], picture.success[k])
    assert np.isnan(columns["least_phi5"][columns["mode"] == "decentralized-no-h5"]).all()
    assert (flown.summary["runs"], flown.summary["seed"]) == (RUNS, 1)


def test_what_is_there_is_not_flown_again_and_more_runs_extend_it(flown, tmp_path, seen):
    out = run_monte_carlo(tmp_path / "c", scenario("campaign.runs=3")).path
    assert seen == [(0, 0), (0, 1)]
    run_monte_carlo(out, scenario())
    assert seen[2:] == [(0, 1), (0, 2)] and table(out) == table(flown.path)
    (out / "runs" / "case-0000-batch-00001.parquet").write_bytes(b"cut short")
    resumed = run(scenario(), out, draw=lambda written: (written.path / "figures").mkdir())
    assert seen[4:] == [(0, 1)] and table(out) == table(flown.path) and (out / "figures").is_dir()
    assert read_run(out).summary["studies"] == resumed.summary["studies"] == flown.summary["studies"]
    with pytest.raises(ScenarioError, match="another campaign"):
        run_monte_carlo(out, scenario("campaign.seed=2"))
    assert run_monte_carlo(out, scenario("campaign.seed=2"), fresh=True).plan.seed == 2
    assert read_run(out).scenario.model.campaign.seed == 2


def test_one_run_is_flown_again_bit_for_bit(flown, monkeypatch):
    folder = read_campaign(flown.path)
    replayed = replay_run(folder, 0, 1, 1, "decentralized")
    columns = folder.read(0)
    place = np.flatnonzero((columns["mode"] == "decentralized") & (columns["batch"] == 1))[1]
    np.testing.assert_equal(replayed.row, {name: values[place] for name, values in columns.items()})
    run = replayed.arrays
    assert run["states"].shape == (4, 2, 6) and run["thrust_N"].shape == (3, 2, 3)
    assert run["states"][0, 1, 2] == replayed.row["deputy_1_rz_m"]
    delta_v = np.abs(run["thrust_N"]).sum(axis=(0, 2)) / scenario().inspection().mass
    assert [replayed.row[f"delta_v_{i}_m_s"] for i in (0, 1)] == pytest.approx(delta_v)
    with pytest.raises(ScenarioError, match="not ranked"):
        find_worst(folder, 1)
    with pytest.raises(ScenarioError, match="must be a mode that was flown"):
        replay_run(folder, 0, 0, 0, "polaris")
    real = inspections.fly_block

    def another(*args, **more):
        outcome = real(*args, **more)
        outcome.columns["delta_v_0_m_s"][:] += 1e-9
        return outcome

    monkeypatch.setattr(inspections, "fly_block", another)
    with pytest.raises(PolarisError, match="differs on this machine: delta_v_0_m_s"):
        replay_run(folder, 0, 1, 1)


def test_no_initial_conditions_is_one_message(tmp_path, monkeypatch):
    monkeypatch.setattr("polaris.inspection.flights.sampling.PATIENCE", 4000)
    monkeypatch.setattr(inspections, "_load_case", inspections._load_case.__wrapped__)
    with pytest.raises(PolarisError, match="hardly any of 4096 samples") as raised:
        run_monte_carlo(tmp_path / "c", scenario("campaign.deputies=30"))
    assert raised.value.exit_code == 2


def invoke(*arguments):
    return CliRunner().invoke(cli.app, [str(argument) for argument in arguments])


@pytest.fixture
def default_install(monkeypatch):
    for name in ("pyarrow", "pyarrow.parquet", "distributed"):
        monkeypatch.setitem(sys.modules, name, None)


@pytest.mark.slow
def test_the_monte_carlo_runs_on_the_default_install(flown, tmp_path, seen, default_install):
    out = tmp_path / "c"
    words = ("campaign", "inspection-monte-carlo", "--runs", RUNS, "--out", out, "--workers", 1)
    words += ("--set", "campaign.deputies=2", "--set", "campaign.duration_s=3")
    assert (done := invoke(*words)).exit_code == 0, done.output
    assert len(seen) == 3 and len(list((out / "runs").glob("case-*.npz"))) == 3
    assert {path.stem for path in (out / "figures").glob("*.pdf")} == {"failures", "initial_conditions"}
    before = table(out)
    (out / "runs" / "case-0000-batch-00002.npz").write_bytes(before["case-0000-batch-00000.npz"][:-99])
    assert invoke(*words, "--no-figures").exit_code == 0 and seen[3:] == [(0, 2)] and table(out) == before
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert summary["studies"] == flown.summary["studies"]
    place = ("--case", 0, "--batch", 1, "--run", 1, "--mode", "centralized", "--out", tmp_path / "one.csv")
    assert (done := invoke("campaign-replay", out, *place)).exit_code == 0, done.output
    with (tmp_path / "one.csv").open(encoding="utf-8", newline="") as file:
        lines = list(csv.DictReader(file))
    assert len(lines) == 4 and lines[-1]["deputy_0_status"] == "" and float(lines[-1]["t_s"]) == 3.0
    assert invoke("plot", out).exit_code == 0 and invoke("report", out).exit_code == 0


@pytest.mark.parametrize(
    "words",
    [
        ("campaign", "inspection-monte-carlo", "--scheduler", "tcp://127.0.0.1:8786"),
        ("campaign-replay", "{flown}", "--case", 0, "--batch", 0, "--run", 0),
        ("plot", "{flown}"),
    ],
)
def test_what_needs_the_extra_says_so(flown, tmp_path, monkeypatch, default_install, words):
    monkeypatch.chdir(tmp_path)
    done = invoke(*(str(word).format(flown=flown.path) for word in words))
    assert (done.exit_code, done.stdout) == (2, ""), done.output
    assert done.stderr.count("\n") == 1 and "pip install 'polaris-rta[campaign]'" in done.stderr
    if "{flown}" in words:
        assert "got 'parquet'; it cannot be read: needs the package pyarrow" in done.stderr
    assert list(tmp_path.iterdir()) == []
