"""Simplex and implicit filters out of a scenario file: flown, judged, told and drawn like the others."""

import json
import tomllib

import numpy as np
import pytest
from typer.testing import CliRunner

from polaris.cli import app as cli
from polaris.inspection.backup.parking import Parking
from polaris.inspection.constraints.families import Families
from polaris.inspection.filters.explicit import Centralized
from polaris.inspection.filters.flight_check import FlightCheck
from polaris.inspection.filters.implicit import ImplicitASIF
from polaris.inspection.filters.simplex import ExplicitSimplex, Guarded, ImplicitSimplex
from polaris.inspection.flights.simulation import BACKUP, UNPROVEN
from polaris.model.errors import ScenarioError
from polaris.report.figures import flight
from polaris.rta.projection import FILTERED
from polaris.runs.run import read_run
from polaris.scenario.reading import write_toml
from polaris.scenario.scenario import load_scenario, scenario_folder

PERIODS = 25
STATES = [[-180.0, -60.0, 40.0, 0.0, 0.0, 0.0], [-200.0, 90.0, -30.0, 0.0, 0.0, 0.0]]
FILTERS = {
    "explicit_simplex": {"margin": 0.01, "release": 0.06, "looks": 3},
    "implicit_simplex": {"release_distance_m": 3.0, "horizon_s": 500.0},
    "implicit_asif": {"rate_1_s": 0.2},
}


def by_hand(kind, q, alpha, sun):
    law = Parking(q, response=25.0)
    if kind == "explicit_simplex":
        families = Families(q, alpha)
        return ExplicitSimplex(
            families, Guarded(Centralized(families), law, sun), 1.0, 0.01, 0.06, sun_start=sun, looks=3
        )
    if kind == "implicit_simplex":
        return ImplicitSimplex(FlightCheck(law, 500.0, sun), 3.0)
    return ImplicitASIF(FlightCheck(law, sun_start=sun), 0.2)


def invoke(*args):
    return CliRunner().invoke(cli.app, list(map(str, args)))


@pytest.fixture(scope="module", params=FILTERS)
def flown(request, tmp_path_factory):
    """A file of one's own with such a filter, and its run folder."""
    place = tmp_path_factory.mktemp(request.param)
    document = tomllib.loads((scenario_folder() / "inspection.toml").read_text(encoding="utf-8"))
    document["filter"] = {"kind": request.param, "response_s": 25.0, **FILTERS[request.param]}
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
    run = read_run(folder).picture()
    q, primary = scenario.inspection(), scenario.primary()
    filtering, x = by_hand(kind, q, scenario.strengthening(), float(run.sun[0])), run.x[0]
    Phi, Gamma = q.held(1.0)
    for k in range(PERIODS):
        decision = filtering.filter(float(k), x, primary(float(k), x[None])[0])
        np.testing.assert_allclose(run.u[k], decision.u, atol=1e-12)
        assert ((run.status[k] == 0) == ~decision.intervened).all()
        x = x @ Phi.T + decision.u @ Gamma.T
    assert {FILTERED, BACKUP} & set(run.status.ravel().tolist()) and (run.status != UNPROVEN).all()


def test_flight_is_judged_and_told(flown):
    kind, folder, shown = flown
    told = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    assert told["filter"] == {"kind": kind, "sharing": None, "without": [], "sampled_data": False}
    assert told["safe"] and [row["constraint"] for row in told["constraints"]] == [
        f"phi{k}" for k in range(1, 12)
    ]
    assert sum(told["steps"].values()) == 2 * PERIODS and f"Filter ({kind})" in shown
    claim = told["guarantee"]
    assert claim["kind"] == ("none" if kind == "explicit_simplex" else "by_prediction")
    assert kind == "explicit_simplex" or claim["periods_covered"] == PERIODS


def test_flight_is_on_the_page_and_in_the_figures(flown, tmp_path, monkeypatch):
    monkeypatch.setattr(flight, "FIGURES", {"speed": flight.FIGURES["speed"]})
    assert invoke("plot", flown[1]).exit_code == 0
    assert (flown[1] / "figures" / "speed.pdf").is_file()
    done = invoke("report", flown[1], "--out", tmp_path / "page.html")
    assert done.exit_code == 0, done.output
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "Answers of the filter" in page


def test_nothing_is_claimed_where_the_backup_is_not_proven(tmp_path):
    """From the states of the scene two parking orbits cross: no backup flight is proven."""
    settings = ('filter={ kind = "implicit_simplex" }', "flight.duration_s=3")
    words = [word for setting in settings for word in ("--set", setting)]
    assert invoke("run", "inspection", *words, "--out", tmp_path / "a", "--no-figures").exit_code == 0
    told = json.loads((tmp_path / "a" / "summary.json").read_text(encoding="utf-8"))
    assert told["guarantee"]["kind"] == "none" and "not even the backup" in told["guarantee"]["reason"]
    assert told["guarantee"]["first_missed_s"] == 0.0 and told["steps"]["unproven"] == 15


@pytest.mark.parametrize(
    ("table", "field", "rule"),
    [
        ({"kind": "implicit_asif", "margin": 0.1}, "filter.margin", "unknown key"),
        ({"kind": "implicit_asif", "horizon_s": 0.5}, "filter.horizon_s", "must be 1 s"),
        ({"kind": "implicit_asif", "rate_1_s": 0.0}, "filter.rate_1_s", "> 0"),
        ({"kind": "explicit_simplex", "margin": 0.2}, "filter.release", "at least the margin"),
        ({"kind": "explicit_simplex", "looks": 0}, "filter.looks", ">= 1"),
        ({"kind": "implicit_simplex", "without": ["moon"]}, "filter.without[0]", "'chief_sep"),
        ({"kind": "implicit_simplex", "response_s": 0.1}, "flight.period_s", "unstable"),
    ],
)
def test_broken_table_is_one_line_with_field_and_rule(table, field, rule):
    with pytest.raises(ScenarioError) as caught:
        load_scenario("inspection", {"filter": table})
    assert caught.value.field == field and rule in caught.value.rule, str(caught.value)


def test_many_runs_at_once_are_for_barrier_filters():
    with pytest.raises(ScenarioError, match="centralized"):
        load_scenario("inspection-monte-carlo", {"studies[0].filter": {"kind": "implicit_asif"}})
