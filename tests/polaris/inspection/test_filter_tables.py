"""Simplex and implicit filters out of a scenario file: flown, judged, told and drawn like the others."""

import json
import tomllib

import numpy as np
import pytest
from typer.testing import CliRunner

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
from polaris.report.figures import flight
from polaris.rta.projection import FILTERED
from polaris.runs.inspections.inspection import assumptions
from polaris.runs.run import read_run
from polaris.scenario.reading import write_toml
from polaris.scenario.scenario import load_scenario, scenario_folder

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
    if kind == "explicit":
        return Explicit(planner, Centralized(Families(q, alpha, sampled=SampledData(1.0, 0.4))))
    if kind == "implicit":
        return Implicit(planner)
    if kind == "simplex_explicit":
        return SimplexExplicit(planner, Families(q, alpha), 0.01, 0.06, looks=3)
    return SimplexImplicit(planner, 3.0, dwell=5.0)


def invoke(*args):
    return CliRunner().invoke(cli.app, list(map(str, args)))


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
    kind, folder, shown = flown
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    assert summary["filter"] == {
        "kind": kind,
        "sharing": "centralized" if kind == "explicit" else None,
        "without": [],
        "sampled_data": False,
    }
    assert summary["safe"] and [row["constraint"] for row in summary["constraints"]] == [
        f"phi{k}" for k in range(1, 12)
    ]
    assert sum(summary["steps"].values()) == 2 * PERIODS and f"Filter ({kind})" in shown
    claim = summary["guarantee"]
    assert claim["kind"] == "all_time" and claim["periods_covered"] == PERIODS
    assert "Guarantee: all time" in shown


def test_flight_is_on_the_page_and_in_the_figures(flown, tmp_path, monkeypatch):
    monkeypatch.setattr(flight, "FIGURES", {"speed": flight.FIGURES["speed"]})
    assert invoke("plot", flown[1]).exit_code == 0
    assert (flown[1] / "figures" / "speed.pdf").is_file()
    done = invoke("report", flown[1], "--out", tmp_path / "page.html")
    assert done.exit_code == 0, done.output
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "Answers of the filter" in page


def test_nothing_is_claimed_where_no_plan_is_proven(tmp_path):
    """At 985 m, at rest among the stars, a deputy is faster along an axis than it may, sooner or later."""
    table = 'filter={ kind = "simplex_implicit" }', "flight.duration_s=3"
    start = 'initial={ kind = "states", sun_angle_deg = 0.0, states = [[985.0, 0.0, 0.0, 0.0, -0.999, 0.0]] }'
    words = [word for setting in (*table, start) for word in ("--set", setting)]
    assert invoke("run", "inspection", *words, "--out", tmp_path / "a", "--no-figures").exit_code == 0
    summary = json.loads((tmp_path / "a" / "summary.json").read_text(encoding="utf-8"))
    assert summary["guarantee"]["kind"] == "none" and "no plan is known" in summary["guarantee"]["reason"]
    assert summary["guarantee"]["first_missed_s"] == 0.0 and summary["steps"]["unproven"] == 3


def test_errors_of_the_tables_are_flown_booked_and_told(tmp_path):
    words = ['filter={ kind = "explicit" }', "flight.duration_s=20", "flight.disturbance_max_m_s2=1e-5"]
    words += ["navigation={ position_error_m = 0.05, velocity_error_m_s = 0.002 }"]
    words += ["thrusters.magnitude_error=0.01"]
    words = [word for setting in words for word in ("--set", setting)]
    assert invoke("run", "inspection", *words, "--out", tmp_path / "a", "--no-figures").exit_code == 0
    folder = read_run(tmp_path / "a")
    summary = json.loads((tmp_path / "a" / "summary.json").read_text(encoding="utf-8"))
    claim = summary["guarantee"]
    assert claim["kind"] == "all_time" and summary["safe"]
    said = "; ".join(claim["assumptions"])
    assert all(word in said for word in ("0.05 m and 0.002 m/s", "1e-05 m/s^2", "1 % of each thrust"))
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
    assert any("at most 0.05 s early or late" in said for said in assumptions(scenario))


@pytest.mark.parametrize(
    ("assignment", "field"),
    [
        ("timing.clock_error_s=0.1", "timing.clock_error_s"),
        ("thrusters.pulse=centred", "thrusters.pulse"),
        ("thrusters.remainder=carried", "thrusters.remainder"),
        ("timing.missed_periods=2", "timing.missed_periods"),
        ("thrusters.thrust_max_N=0.5", "thrusters.thrust_max_N"),
    ],
)
def test_what_only_schedules_have_is_refused(assignment, field):
    with pytest.raises(ScenarioError, match=f"{field}: .*schedules only"):
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


def test_many_runs_at_once_are_for_barrier_filters():
    with pytest.raises(ScenarioError, match="centralized"):
        load_scenario("inspection-monte-carlo", {"studies[0].filter": {"kind": "implicit"}})
