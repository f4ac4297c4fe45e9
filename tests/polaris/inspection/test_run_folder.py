"""Run folders and commands of the inspection problem: what is written, that it repeats, how it fails."""

import csv
import json
import os
import shutil
import subprocess
import sys
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import polaris
from polaris.cli import app as cli
from polaris.inspection.backup.all_time import AllTime
from polaris.inspection.backup.brake import Brake
from polaris.inspection.backup.planner import BackupPlanner
from polaris.inspection.backup.tube import Uncertainty
from polaris.inspection.constraints.families import Families
from polaris.inspection.constraints.motion import SampledData
from polaris.inspection.filters.assured import Explicit, Implicit
from polaris.inspection.filters.explicit import Centralized
from polaris.inspection.filters.simplex import SimplexExplicit, SimplexImplicit
from polaris.inspection.flights.simulation import BACKUP, UNPROVEN
from polaris.model.errors import ScenarioError
from polaris.rta.projection import FILTERED
from polaris.runs.files.ownership import MANIFEST
from polaris.runs.inspections.inspection import assumptions, covered_periods
from polaris.runs.run import read_run
from polaris.scenario.reading import write_toml
from polaris.scenario.scenario import load_scenario, scenario_folder
from polaris.simulation.metrics import lower_bound

SHORT = ("--set", "flight.duration_s=20")
CAMPAIGN = ("campaign", "inspection-monte-carlo", "--runs", "2", "--set", "campaign.duration_s=5")
ALONE = ("--set", "campaign.deputies=2", "--workers", "1")
TIMES = ("created", "seconds", "filter_seconds")


def invoke(*args):
    return CliRunner().invoke(cli.app, list(map(str, args)))


COMMANDS = {
    "inspection": ("run", "inspection", *SHORT),
    "fuel_limit": ("run", "fuel-limit", *SHORT),
    "monte_carlo": (*CAMPAIGN, *ALONE),
}


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """One run folder of each kind, without figures."""
    place = tmp_path_factory.mktemp("runs")
    for kind, command in COMMANDS.items():
        done = invoke(*command, "--out", place / kind, "--no-figures")
        assert done.exit_code == 0, done.output
        assert "Guarantee: " in done.stdout and "To draw the figures: polaris plot" in done.stdout
    return {kind: place / kind for kind in COMMANDS}


def fly(tmp_path, name, *assignments):
    """Run a scenario with assignments; what the command says, and the summary."""
    words = [word for each in assignments for word in ("--set", each)]
    done = invoke("run", name, *words, "--out", tmp_path / "a", "--no-figures")
    return done, summary(tmp_path / "a")


def summary(folder):
    def refuse(name):
        raise AssertionError(f"{name} is not strict JSON")

    return json.loads((folder / "summary.json").read_text(encoding="utf-8"), parse_constant=refuse)


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
    done, table = fly(tmp_path, "inspection", "flight.duration_s=3", *settings)
    assert done.exit_code == 0, done.output
    claim = table["guarantee"]
    assert claim["kind"] == "none" and word in claim["reason"] and claim["assumptions"] == []


def test_fuel_folder_holds_what_was_flown(folders):
    folder, table = folders["fuel_limit"], summary(folders["fuel_limit"])
    run = read_run(folder).plot_data()
    assert run.x.shape == (21, 6) and table["latched_at_s"] is None and table["safe"]
    delta_v = np.abs(run.u).sum() / run.inspection.mass
    assert run.delta_v[-1] == pytest.approx(delta_v) == table["delta_v_m_s"]


def test_fuel_limit_is_kept_by_the_backup(tmp_path):
    done, table = fly(tmp_path, "fuel-limit", "flight.duration_s=400", "fuel.spent_m_s=18")
    assert done.exit_code == 0 and "The fuel limit is kept." in done.stdout
    assert 0 < table["latched_at_s"] < 400 and 0 <= table["phi12_least_m_s"] < 2
    assert table["guarantee"]["kind"] == "by_prediction" and table["delta_v_m_s"] > 19


@pytest.mark.parametrize(
    ("reason", "settings"),
    [
        ("took over at the start", ("initial_state=[0,60,0,0,-4,0]", "flight.duration_s=200")),  # too fast
        ("cut off", ("initial_state=[0,400,0,0,3,0]", "fuel.spent_m_s=19", "flight.duration_s=20")),
    ],
)
def test_nothing_is_claimed_of_a_flight_that_begins_on_backup(tmp_path, reason, settings):
    done, table = fly(tmp_path, "fuel-limit", *settings)
    assert done.exit_code == 0 and table["latched_at_s"] == 0
    assert table["guarantee"]["kind"] == "none" and reason in table["guarantee"]["reason"]


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


@pytest.mark.parametrize("kind", COMMANDS)
def test_the_same_scenario_gives_the_same_bytes(folders, tmp_path, kind):
    assert invoke(*COMMANDS[kind], "--out", tmp_path / "again", "--no-figures", "-q").exit_code == 0
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


@pytest.mark.parametrize("damage", [b"", b"PK nonsense", None])
def test_damaged_or_missing_file_is_one_readable_error(folders, tmp_path, damage):
    folder = shutil.copytree(folders["inspection"], tmp_path / "broken")
    (folder / "flight.npz").unlink()
    if damage is not None:
        (folder / "flight.npz").write_bytes(damage)
    done = invoke("plot", folder)
    assert done.exit_code == 2 and done.stderr.startswith("error: run folder")
    assert len(done.stderr.strip().splitlines()) == 1


def test_arrays_that_do_not_belong_together_are_refused(folders, tmp_path):
    folder = shutil.copytree(folders["inspection"], tmp_path / "broken")
    with np.load(folder / "flight.npz") as file:
        arrays = dict(file)
    nan_states = arrays["states"].copy()
    nan_states[3, 1, 2] = np.nan
    for states, words in ((arrays["states"][:-1], "wrong shape"), (nan_states, "not finite")):
        np.savez(folder / "flight.npz", **arrays | {"states": states})
        with pytest.raises(ScenarioError, match=words):
            read_run(folder).plot_data()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("campaign", "inspection"), ("polaris run",)),
        (("run", "inspection", "--solver", "highs"), ("planner", "unknown key")),
        (("run", "inspection", "--set", "flight.periode_s=1"), ("did you mean period_s",)),
        (("run", "inspection", "--set", "initial.states[7][0]=1"), ("initial.states[7]",)),
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
    *("initial.states=[[0, -985, 0, 0, -0.1, 0]]", 'filter.without=["keep_in"]', "flight.duration_s=40"),
    *('primary=[{ kind = "to_distance", distance_m = 1200 }]', "parameters.delta_v_max_m_s=0.5"),
)


def test_a_flight_that_violates_ends_with_exit_code_5_and_says_what_exceeds_the_tank(tmp_path):
    """By a process of its own: a caller sees its exit code."""
    words = [word for each in OUTWARDS for word in ("--set", each)]
    command = [sys.executable, "-m", "polaris", "run", "inspection", *words, "--no-figures", "--out", "a"]
    environment = {**os.environ, "PYTHONPATH": str(Path(polaris.__file__).parents[1])}
    done = subprocess.run(
        command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 5, done.stdout + done.stderr
    assert summary(tmp_path / "a")["safe"] is False and "CONSTRAINTS ARE VIOLATED." in done.stdout
    assert "THE FUEL LIMIT IS EXCEEDED" in done.stdout and "of 0.5 m/s" in done.stdout


def test_a_flight_that_violates_nothing_ends_with_exit_code_0_and_says_neither(tmp_path):
    done, table = fly(tmp_path, "inspection", *OUTWARDS, "filter.without=[]", "flight.duration_s=2")
    assert done.exit_code == 0 and table["safe"] is True
    assert "CONSTRAINTS ARE VIOLATED." not in done.stdout and "FUEL LIMIT IS EXCEEDED" not in done.stdout


def test_json_is_the_summary_and_nothing_else(tmp_path):
    out = tmp_path / "a"
    done = invoke("run", "inspection", "--set", "flight.duration_s=2", "--no-figures", "--out", out, "--json")
    assert invoke("check", "inspection").stdout.startswith("inspection is valid: ")
    assert (done.exit_code, done.stderr) == (0, "") and json.loads(done.stdout) == summary(out)


PERIODS = 25
STATES = [[-180.0, -60.0, 40.0, 0.0, 0.0, 0.0], [-200.0, 90.0, -30.0, 0.0, 0.0, 0.0]]
FILTERS = {
    "explicit": {"sampled_data_share": 0.4},
    "implicit": {},
    "simplex_explicit": {"margin": 0.01, "release": 0.06, "looks": 3},
    "simplex_implicit": {"release_distance_m": 3.0, "dwell_s": 5.0},
}


def by_hand(kind, q, alpha, sun):
    planner = BackupPlanner(AllTime(Brake(q, 1.0, Uncertainty(jitter=0.0)), sun))
    return {
        "explicit": lambda: Explicit(planner, Centralized(Families(q, alpha, sampled=SampledData(1.0, 0.4)))),
        "implicit": lambda: Implicit(planner),
        "simplex_explicit": lambda: SimplexExplicit(planner, Families(q, alpha), 0.01, 0.06, looks=3),
        "simplex_implicit": lambda: SimplexImplicit(planner, 3.0, dwell=5.0),
    }[kind]()


@pytest.fixture(scope="module", params=FILTERS)
def flown(request, tmp_path_factory):
    """A file of one's own with such a filter, and its run folder."""
    place = tmp_path_factory.mktemp(request.param)
    document = tomllib.loads((scenario_folder() / "inspection.toml").read_text(encoding="utf-8"))
    document["filter"] = {"kind": request.param, **FILTERS[request.param]}
    document["initial"] = {"kind": "states", "states": STATES, "sun_angle_deg": 180.0}
    document["flight"] = {"duration_s": float(PERIODS), "between": 1}
    file = place / "mine.toml"
    file.write_text(write_toml(document), encoding="utf-8")
    done = invoke("run", file, "--out", place / "run", "--no-figures")
    assert done.exit_code == 0, done.output
    return request.param, place / "run", done.stdout


def test_flight_is_that_of_the_filter_asked_by_hand(flown):
    kind, folder, _ = flown
    scenario = read_run(folder).scenario
    run = read_run(folder).plot_data()
    q, primary = scenario.inspection(), scenario.primary()
    filtering, x = by_hand(kind, q, scenario.strengthening(), float(run.sun[0])), run.x[0]
    Phi, Gamma = q.discretize(1.0)
    for k in range(PERIODS):
        decision = filtering.filter(float(k), x, primary(float(k), x[None])[0])
        np.testing.assert_allclose(run.u[k], decision.u, atol=1e-12)
        assert ((run.status[k] == 0) == ~decision.intervened).all()
        x = x @ Phi.T + decision.u @ Gamma.T
    assert {FILTERED, BACKUP} & set(run.status.ravel().tolist()) and (run.status != UNPROVEN).all()


def test_flight_is_judged_and_told(flown):
    kind, folder, output = flown
    table = summary(folder)
    sharing = "centralized" if kind == "explicit" else None
    assert table["filter"] == {"kind": kind, "sharing": sharing, "without": [], "sampled_data": False}
    judged = [row["constraint"] for row in table["constraints"]]
    assert table["safe"] and judged == [f"phi{k}" for k in range(1, 12)]
    assert sum(table["steps"].values()) == 2 * PERIODS and f"Filter ({kind})" in output
    claim = table["guarantee"]
    assert claim["kind"] == "all_time" and claim["periods_covered"] == PERIODS
    assert "Guarantee: all time" in output


def test_nothing_is_claimed_where_no_plan_is_proven(tmp_path):
    """At 985 m, at rest among the stars, a deputy is faster along an axis than it may, sooner or later."""
    start = 'initial={ kind = "states", sun_angle_deg = 0.0, states = [[985.0, 0.0, 0.0, 0.0, -0.999, 0.0]] }'
    _, table = fly(
        tmp_path, "inspection", 'filter={ kind = "simplex_implicit" }', "flight.duration_s=3", start
    )
    assert table["guarantee"]["kind"] == "none" and "no plan is known" in table["guarantee"]["reason"]
    assert table["guarantee"]["first_missed_s"] == 0.0 and table["steps"]["unproven"] == 3


def test_errors_of_the_tables_are_flown_booked_and_told(tmp_path):
    words = ['filter={ kind = "explicit" }', "flight.duration_s=20", "flight.disturbance_max_m_s2=1e-5"]
    words += ["navigation={ position_error_m = 0.05, velocity_error_m_s = 0.002 }"]
    words += ["thrusters.magnitude_error=0.01"]
    (_, table), folder = fly(tmp_path, "inspection", *words), read_run(tmp_path / "a")
    claim = table["guarantee"]
    assert claim["kind"] == "all_time" and table["safe"]
    assumptions = "; ".join(claim["assumptions"])
    assert all(word in assumptions for word in ("0.05 m and 0.002 m/s", "1e-05 m/s^2", "1 % of each thrust"))
    run, q = folder.plot_data(), folder.scenario.inspection()
    Phi, Gamma = q.discretize(1.0)
    np.testing.assert_allclose(run.x[1:], run.x[:-1] @ Phi.T + run.u @ Gamma.T, atol=1e-9)
    # What acted is off the thrust limits by the errors: they are flown, not only booked.
    assert 1.0 < np.abs(run.u).max() <= 1.0 + 0.01 + 12 * 1e-5
    bare = {"filter": {"kind": "centralized"}, "navigation": {"position_error_m": 0.05}}
    assert not load_scenario("inspection", bare).uncertainty().exact


def test_a_delay_is_an_error_of_what_is_predicted():
    tables = {"navigation": {"position_error_m": [0.05, 0.0, 0.01], "velocity_error_m_s": 0.002}}
    late = load_scenario("inspection", {**tables, "timing": {"delay_s": 3.0}}).uncertainty().estimate
    at_once = load_scenario("inspection", tables).uncertainty().estimate
    np.testing.assert_allclose(at_once, [0.05, 0.0, 0.01, 0.002, 0.002, 0.002])
    np.testing.assert_allclose(late - at_once, [0.006, 0.006, 0.006, 0, 0, 0], atol=3e-5)


@pytest.mark.parametrize("kind", ["centralized", "explicit", "simplex_implicit"])
def test_a_jitter_is_tolerated_by_every_kind(kind):
    scenario = load_scenario("inspection", {"filter": {"kind": kind}, "timing": {"jitter_s": 0.05}})
    assert scenario.uncertainty().jitter == 0.05 and load_scenario("inspection").uncertainty().jitter == 0.0
    filtering = scenario.filter(scenario.model.filter, 1.0)
    if kind == "centralized":
        assert filtering.families.sampled.period == 1.1  # from one late call to another
    else:
        assert filtering.filter.recovery.families.sampled.period == 1.1
    assert any("at most 0.05 s early or late" in assumption for assumption in assumptions(scenario))


SCHEDULES = "timing.clock_error_s=0.1 timing.missed_periods=2 thrusters.pulse=centred"
SCHEDULES += " thrusters.remainder=carried thrusters.thrust_max_N=0.5"


@pytest.mark.parametrize("assignment", SCHEDULES.split())
def test_what_only_schedules_have_is_refused(assignment):
    with pytest.raises(ScenarioError, match=f"{assignment.split('=')[0]}: .*schedules only"):
        load_scenario("inspection").with_assignments([assignment])


@pytest.mark.parametrize(
    ("table", "field", "rule"),
    [
        ({"kind": "implicit", "margin": 0.1}, "filter.margin", "unknown key"),
        ({"kind": "explicit", "sharing": "coasting"}, "filter.sharing", "centralized"),
        ({"kind": "simplex_explicit", "margin": 0.2}, "filter.release", "at least the margin"),
        ({"kind": "simplex_explicit", "looks": 0}, "filter.looks", ">= 1"),
        ({"kind": "simplex_implicit", "without": ["moon"]}, "filter.without[0]", "'chief_sep"),
    ],
)
def test_broken_table_is_one_line_with_field_and_rule(table, field, rule):
    with pytest.raises(ScenarioError) as caught:
        load_scenario("inspection", {"filter": table})
    assert caught.value.field == field and rule in caught.value.rule, str(caught.value)
