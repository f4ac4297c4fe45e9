"""Scenario files of the inspection problem: loading, overriding, what they build, how they break."""

import copy
import tomllib

import jsonschema
import numpy as np
import pytest

import polaris
from docs.generate.scenario_docs import inspection_schema
from polaris.inspection.constraints.constraint import CONSTRAINTS
from polaris.inspection.constraints.strengthening import FAMILIES, PRESETS
from polaris.inspection.filters.explicit import make_filter
from polaris.inspection.flights.evaluation import least_values
from polaris.inspection.flights.simulation import FlightBatch, fly_one
from polaris.model.errors import ScenarioError
from polaris.runs.inspections.inspection import fly_flight
from polaris.scenario.base import set_key
from polaris.scenario.scenario import (
    KINDS,
    FlightScenario,
    InspectionScenario,
    Scenario,
    ScheduleScenario,
    bundled_files,
    load_scenario,
    scenario_folder,
)

NAMES = ("fuel-limit", "inspection", "inspection-decentralized", "inspection-monte-carlo")
BASE = {"fuel": "fuel-limit", "campaign": "inspection-monte-carlo", "flight": "inspection"}
NAN = float("nan")


def document(name):
    return tomllib.loads((scenario_folder() / f"{name}.toml").read_text(encoding="utf-8"))


def test_bundled_scenarios_of_both_kinds_are_apart():
    assert set(bundled_files()) == set(NAMES) | set(polaris.bundled_scenarios())
    assert not set(NAMES) & set(polaris.bundled_scenarios())


@pytest.mark.parametrize("name", NAMES)
def test_bundled_scenario_loads_and_reads_back(name):
    scenario = load_scenario(name)
    assert scenario.name == name and scenario.kind in KINDS and scenario.outline()
    assert InspectionScenario.from_dict(tomllib.loads(scenario.to_toml())).model == scenario.model
    text = (scenario_folder() / f"{name}.toml").read_text(encoding="utf-8")
    assert scenario.text == text and text.startswith("#:schema ../docs/inspection.schema.json")
    jsonschema.Draft202012Validator(inspection_schema()).validate(scenario.to_dict())


def test_strengthening_takes_the_preset_where_nothing_else_is_given():
    scenario = load_scenario("inspection-monte-carlo")
    assert scenario.strengthening(sampled=False) == PRESETS["polaris"]
    assert scenario.strengthening() == PRESETS["linear"]  # for conditions that hold between samples
    changed = scenario.with_assignments(["strengthening.speed={ coefficients = [0.5, 0, 0], bias = 0.01 }"])
    assert changed.strengthening()["speed"].numbers == (0.5, 0.0, 0.0, 0.01, 1.0, 0.0)
    assert changed.strengthening(sampled=False)["sun"] == PRESETS["polaris"]["sun"]


def test_filter_is_what_the_table_says():
    scenario = load_scenario("inspection-decentralized").with_assignments(
        ["filter.sharing=half", 'filter.without=["sun"]', "filter.sampled_data_share=0.25"]
    )
    filtering = scenario.filter(scenario.model.filter, 1.0)
    assert filtering.sharing == "half" and "sun" not in filtering.families.family
    assert filtering.families.sampled.share == 0.25
    plain = scenario.with_assignments(["filter.sampled_data=false"])
    assert plain.filter(plain.model.filter, 1.0).families.sampled is None


def test_drawn_states_are_safe_and_the_same_for_the_same_seed():
    drawn = {"kind": "latin_hypercube", "deputies": 2, "seed": 3}
    scenario = load_scenario("inspection", {"initial": drawn})
    (x, sun), (redrawn, _) = scenario.initial(), scenario.initial()
    assert x.shape == (2, 6) and np.array_equal(x, redrawn)
    assert (scenario.families()(x[None], np.array([sun])).h >= 0).all()


def test_one_loader_gives_each_kind_and_only_that_if_asked():
    with pytest.raises(ScenarioError, match="must be a scenario of the kind 'schedule' here"):
        load_scenario("inspection", only=ScheduleScenario)
    with pytest.raises(ScenarioError, match="'schedule'; must be a scenario of the kind 'inspection' here"):
        load_scenario("static", only=FlightScenario)
    assert all(type(load_scenario(name)) is KINDS[load_scenario(name).kind] for name in ("static", *NAMES))


STATES = document("inspection")["initial"]["states"]
BROKEN = [
    ("flight", {"kind": None}, "unknown key", "parameters"),
    ("flight", {"kind": "schedule"}, "left out for a schedule"),
    ("flight", {"kind": "inspecton"}, "did you mean inspection"),
    ("flight", {"schema_version": 2}, "must be 1"),
    ("flight", {"title": None}, "required"),
    ("flight", {"parameters.mas_kg": 12.0}, "did you mean mass_kg"),
    ("flight", {"parameters.mass_kg": 0.0}, ">= 0.001"),
    ("flight", {"parameters.mass_kg": NAN}, "finite"),
    ("flight", {"parameters.field_of_view_deg": 180.0}, "< 180"),
    ("flight", {"parameters.thrust_max_N": 0.05}, "eq. 28"),
    ("flight", {"parameters.distance_max_m": 9.0}, "must exceed the sum"),
    ("flight", {"parameters.passive_time_s": 4000.0}, "half an orbit"),
    ("flight", {"strengthening.preset": "afl"}, "did you mean afrl"),
    ("flight", {"strengthening.sun": {"coefficients": [0.0, 0.0, 0.0]}}, "not all zero"),
    ("flight", {"strengthening.sun": {"coefficients": [0.1, 0.0, -1.0]}}, ">= 0"),
    ("flight", {"strengthening.speeed": {}}, "did you mean speed"),
    ("flight", {"filter.kind": "central"}, "'centralized', 'decentralized'"),
    ("flight", {"filter.sharing": "half"}, "unknown key"),
    ("flight", {"filter": {"kind": "decentralized", "sharing": "none"}}, "'coasting', 'half' or 'consensus'"),
    ("flight", {"filter.without": ["moon"]}, "'chief_sep", "filter.without[0]"),
    ("flight", {"filter.without": list(FAMILIES)}, "must leave"),
    ("flight", {"filter.sampled_data_share": 0.0}, "> 0"),
    ("flight", {"filter.sampled_data": "yes"}, "bool"),
    ("flight", {"filter": None}, "required"),
    ("flight", {"initial.states": [STATES[0], STATES[1][:5]]}, "must have 6", "initial.states[1]"),
    ("flight", {"initial.states": [[NAN, *STATES[0][1:]]]}, "finite", "initial.states[0][0]"),
    ("flight", {"initial.states": [[0, 5.0, 0, 0, 0, 0]]}, "phi1 is -5", "initial.states[0]"),
    ("flight", {"initial.states": [[0, -300.0, 0, 0, 0.95, 0]]}, "phi3 is", "initial.states[0]"),
    ("flight", {"initial.states": [[-500.0, 0, 0, 0, 0, 0]], "initial.sun_angle_deg": 0.0}, "phi4 is"),
    ("flight", {"initial": {"kind": "latin_hypercube", "deputies": 0}}, ">= 1", "initial.deputies"),
    ("flight", {"flight.period_s": 7.0}, "must divide"),
    ("flight", {"flight.period_s": 1e-4}, "at most 200000"),
    ("flight", {"flight.period_s": 1000.0}, ""),
    ("flight", {"primary[0].start_s": 5.0}, "must be 0"),
    ("flight", {"primary[1].start_s": 0.0}, "later"),
    ("flight", {"primary[0].distance_m": 5.0}, "unknown key"),
    ("flight", {"primary[1].distance_m": None}, "required"),
    ("campaign", {"campaign.runs": 0}, ">= 1"),
    ("campaign", {"studies[1].name": "centralized"}, "must differ"),
    ("campaign", {"campaign.period_s": 3.0}, "must divide"),
    ("fuel", {"initial_state": [0, 400, 0, 0, 0]}, "must have 6"),
    ("fuel", {"initial_state": [0] * 6}, "farther"),
    ("fuel", {"fuel.spent_m_s": 21.0}, "20 m/s"),
    ("fuel", {"fuel.semi_minor_largest_m": 110.0, "fuel.semi_minor_least_m": 100.0}, "at least 130"),
    ("fuel", {"fuel.response_s": 0.1}, "unstable", "flight.period_s"),
    ("flight", {"initial.states": [[0, -30.0, 0, 0, 0.25, 0]], "flight.duration_s": 10.0}, "h7[0] (passive)"),
]
"""A bundled scenario, changes, words of the rule, and the field if it is not below the one changed."""


@pytest.mark.parametrize("case", BROKEN, ids=lambda case: next(iter(case[1])))
def test_broken_scenario_is_one_line_with_field_value_and_rule(case):
    base, changes, rule, *field = case
    data = copy.deepcopy(document(BASE[base]))
    for key, value in changes.items():
        set_key(data, key, value, None)
    with pytest.raises(ScenarioError) as caught:
        Scenario.from_dict(data, "broken.toml")
    error, text = caught.value, str(caught.value)
    assert error.field == field[0] if field else error.field.startswith([*changes][0]), text
    assert rule in error.rule, text
    assert text.startswith("broken.toml: ") and "\n" not in text and "got " in text and len(text) < 700


def test_every_constraint_is_judged_and_holds_for_a_while():
    scenario = load_scenario("inspection").with_assignments(["flight.duration_s=60", "flight.between=3"])
    run = fly_flight(scenario)
    assert tuple(run.constraints) == CONSTRAINTS and tuple(run.barriers) == FAMILIES
    for least in (*run.constraints.values(), *run.barriers.values()):
        assert 0 <= least.value <= least.at_samples and 0 <= least.time <= 60.0
        assert least.violated_share == 0 and 1 <= len(least.deputies) <= 2


def test_judge_sees_what_happens_between_samples():
    """A deputy that flies past the chief within one period: clear at both samples, inside between them."""
    scenario = load_scenario("inspection").with_assignments(["initial.states=[[0, 300, 0, 0, 0, 0]]"])
    x, q = np.array([[[0.0, 20.0, 0.0, 0.0, -40.0, 0.0]]]), scenario.inspection()
    run = fly_one(FlightBatch(q, x, np.zeros(1), 1.0), make_filter(scenario.families(), "centralized"))
    at_samples = least_values(run, scenario.families(), 0).constraints["phi1"]
    between = least_values(run, scenario.families(), 3).constraints["phi1"]
    assert at_samples.value == pytest.approx(10.0, abs=0.1) and at_samples.violated_share == 0
    assert between.value == pytest.approx(-10.0, abs=0.1) and between.time == 0.5
    assert between.at_samples == at_samples.value
