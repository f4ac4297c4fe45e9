"""Scenario files of the inspection problem: loading, overriding, what they build, how they break."""

import copy
import tomllib

import jsonschema
import numpy as np
import pytest

import polaris
from docs.generate.scenario_docs import inspection_schema
from polaris.inspection.constraints.constraint import CONSTRAINTS
from polaris.inspection.constraints.families import Families
from polaris.inspection.constraints.strengthening import FAMILIES, PRESETS
from polaris.inspection.filters.explicit import Filtered
from polaris.inspection.flights.evaluation import least_values
from polaris.inspection.flights.simulation import FlightBatch, fly_one
from polaris.inspection.inspection import Inspection
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
from polaris.scenario.tables.filters import FAMILY_NAMES

NAMES = ("fuel-limit", "inspection", "inspection-decentralized", "inspection-monte-carlo")
BASE = {"fuel": "fuel-limit", "campaign": "inspection-monte-carlo", "flight": "inspection"}
NAN = float("nan")


def document(name):
    return tomllib.loads((scenario_folder() / f"{name}.toml").read_text(encoding="utf-8"))


# -- loading ----------------------------------------------------------------------------------------


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


def test_table_1_is_what_the_problem_has_by_default():
    defaults = load_scenario("inspection-monte-carlo").inspection()
    assert defaults == Inspection()
    assert load_scenario("inspection").inspection() == Inspection()


def test_families_of_the_models_are_those_of_the_filters():
    assert FAMILY_NAMES == FAMILIES


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
    (x, sun), (again, _) = scenario.initial(), scenario.initial()
    assert x.shape == (2, 6) and np.array_equal(x, again)
    assert (scenario.families()(x[None], np.array([sun])).h >= 0).all()


def test_phases_take_over_in_turn():
    scenario = load_scenario("inspection")
    primary, x = scenario.primary(), scenario.initial()[0]
    inwards, outwards = primary(0.0, x[None])[0], primary(1000.0, x[None])[0]
    p = x[:, :3]
    assert ((inwards * p).sum(axis=1) < 0).all() and ((outwards * p).sum(axis=1) > 0).all()


def test_both_scenes_start_from_the_same_states():
    one, other = load_scenario("inspection"), load_scenario("inspection-decentralized")
    assert one.model.initial == other.model.initial and one.model.primary == other.model.primary


def test_one_loader_gives_each_kind_and_only_that_if_asked():
    with pytest.raises(ScenarioError, match="must be a scenario of the kind 'schedule' here"):
        load_scenario("inspection", only=ScheduleScenario)
    with pytest.raises(ScenarioError, match="'schedule'; must be a scenario of the kind 'inspection' here"):
        load_scenario("static", only=FlightScenario)
    assert all(type(load_scenario(name)) is KINDS[load_scenario(name).kind] for name in ("static", *NAMES))


# -- broken files -----------------------------------------------------------------------------------

STATES = document("inspection")["initial"]["states"]
BROKEN = {
    "no kind": ("flight", {"kind": None}, "parameters", "unknown key"),
    "kind of a schedule": ("flight", {"kind": "schedule"}, "kind", "left out for a schedule"),
    "unknown kind": ("flight", {"kind": "inspecton"}, "kind", "did you mean inspection"),
    "kind is a number": ("flight", {"kind": 3}, "kind", "must be one of"),
    "version 2": ("flight", {"schema_version": 2}, "schema_version", "must be 1"),
    "no title": ("flight", {"title": None}, "title", "required"),
    "slip of the pen": ("flight", {"parameters.mas_kg": 12.0}, "parameters.mas_kg", "did you mean mass_kg"),
    "mass zero": ("flight", {"parameters.mass_kg": 0.0}, "parameters.mass_kg", ">= 0.001"),
    "mass in quotes": ("flight", {"parameters.mass_kg": "12"}, "parameters.mass_kg", "must be a number"),
    "mass is NaN": ("flight", {"parameters.mass_kg": NAN}, "parameters.mass_kg", "finite"),
    "field of view flat": (
        "flight",
        {"parameters.field_of_view_deg": 180.0},
        "parameters.field_of_view_deg",
        "< 180",
    ),
    "thrust too weak": ("flight", {"parameters.thrust_max_N": 0.05}, "parameters.thrust_max_N", "eq. 28"),
    "keep-in inside the chief": (
        "flight",
        {"parameters.distance_max_m": 9.0},
        "parameters.distance_max_m",
        "must exceed the sum",
    ),
    "more than half an orbit": (
        "flight",
        {"parameters.passive_time_s": 4000.0},
        "parameters.passive_time_s",
        "half an orbit",
    ),
    "unknown preset": (
        "flight",
        {"strengthening.preset": "afl"},
        "strengthening.preset",
        "did you mean afrl",
    ),
    "two coefficients": (
        "flight",
        {"strengthening.speed": {"coefficients": [1.0, 0.0]}},
        "strengthening.speed.coefficients",
        "at least 3",
    ),
    "coefficients zero": (
        "flight",
        {"strengthening.sun": {"coefficients": [0.0, 0.0, 0.0]}},
        "strengthening.sun.coefficients",
        "not all zero",
    ),
    "coefficient negative": (
        "flight",
        {"strengthening.sun": {"coefficients": [0.1, 0.0, -1.0]}},
        "strengthening.sun.coefficients[2]",
        ">= 0",
    ),
    "unknown family": ("flight", {"strengthening.speeed": {}}, "strengthening.speeed", "did you mean speed"),
    "unknown filter": ("flight", {"filter.kind": "central"}, "filter.kind", "'centralized', 'decentralized'"),
    "sharing of a centralized filter": (
        "flight",
        {"filter.sharing": "half"},
        "filter.sharing",
        "unknown key",
    ),
    "unknown sharing": (
        "flight",
        {"filter": {"kind": "decentralized", "sharing": "none"}},
        "filter.sharing",
        "'coasting', 'half' or 'consensus'",
    ),
    "unknown family left out": ("flight", {"filter.without": ["moon"]}, "filter.without[0]", "'chief_sep"),
    "everything left out": ("flight", {"filter.without": list(FAMILIES)}, "filter.without", "must leave"),
    "share zero": ("flight", {"filter.sampled_data_share": 0.0}, "filter.sampled_data_share", "> 0"),
    "sampled data is a word": ("flight", {"filter.sampled_data": "yes"}, "filter.sampled_data", "bool"),
    "no filter": ("flight", {"filter": None}, "filter", "required"),
    "state of five numbers": (
        "flight",
        {"initial.states": [STATES[0], STATES[1][:5]]},
        "initial.states[1]",
        "must have 6",
    ),
    "state is NaN": ("flight", {"initial.states": [[NAN, *STATES[0][1:]]]}, "initial.states[0][0]", "finite"),
    "no states": ("flight", {"initial.states": []}, "initial.states", "at least 1"),
    "start inside the chief": (
        "flight",
        {"initial.states": [[0, 5.0, 0, 0, 0, 0]]},
        "initial.states[0]",
        "phi1 is -5",
    ),
    "start too fast": (
        "flight",
        {"initial.states": [[0, -300.0, 0, 0, 0.95, 0]]},
        "initial.states[0]",
        "phi3 is",
    ),
    "start into the sun": (
        "flight",
        {"initial.states": [[-500.0, 0, 0, 0, 0, 0]], "initial.sun_angle_deg": 0.0},
        "initial.states[0]",
        "phi4 is",
    ),
    "no deputies drawn": (
        "flight",
        {"initial": {"kind": "latin_hypercube", "deputies": 0}},
        "initial.deputies",
        ">= 1",
    ),
    "period does not divide": ("flight", {"flight.period_s": 7.0}, "flight.period_s", "must divide"),
    "too many periods": ("flight", {"flight.period_s": 1e-4}, "flight.period_s", "at most 200000"),
    "period too long for what is claimed": ("flight", {"flight.period_s": 1000.0}, "flight.period_s", ""),
    "first phase late": ("flight", {"primary[0].start_s": 5.0}, "primary[0].start_s", "must be 0"),
    "phases out of order": ("flight", {"primary[1].start_s": 0.0}, "primary[1].start_s", "later"),
    "no phases": ("flight", {"primary": []}, "primary", "at least 1"),
    "distance of a phase to the chief": (
        "flight",
        {"primary[0].distance_m": 5.0},
        "primary[0].distance_m",
        "unknown key",
    ),
    "no distance": ("flight", {"primary[1].distance_m": None}, "primary[1].distance_m", "required"),
    "no runs": ("campaign", {"campaign.runs": 0}, "campaign.runs", ">= 1"),
    "half a run": ("campaign", {"campaign.runs": 1.5}, "campaign.runs", "whole number"),
    "studies of one name": ("campaign", {"studies[1].name": "centralized"}, "studies[1].name", "must differ"),
    "study without a filter": ("campaign", {"studies[0].filter": None}, "studies[0].filter", "required"),
    "campaign's period": ("campaign", {"campaign.period_s": 3.0}, "campaign.period_s", "must divide"),
    "campaign with a flight": ("campaign", {"flight": {}}, "flight", "unknown key"),
    "five numbers": ("fuel", {"initial_state": [0, 400, 0, 0, 0]}, "initial_state", "must have 6"),
    "fuel start in the chief": ("fuel", {"initial_state": [0] * 6}, "initial_state", "farther"),
    "more fuel than there is": ("fuel", {"fuel.spent_m_s": 21.0}, "fuel.spent_m_s", "20 m/s"),
    "ellipses without room": (
        "fuel",
        {"fuel.semi_minor_least_m": 100.0, "fuel.semi_minor_largest_m": 110.0},
        "fuel.semi_minor_largest_m",
        "at least 130",
    ),
    "response too quick": ("fuel", {"fuel.response_s": 0.1}, "flight.period_s", "unstable"),
    "start that cannot stop": (
        "flight",
        {"initial.states": [[0, -30.0, 0, 0, 0.25, 0]], "flight.duration_s": 10.0},
        "initial.states[0]",
        "h7[0] (passive)",
    ),
}


@pytest.mark.parametrize("case", BROKEN.values(), ids=BROKEN)
def test_broken_scenario_is_one_line_with_field_value_and_rule(case):
    base, changes, field, rule = case
    data = copy.deepcopy(document(BASE[base]))
    for key, value in changes.items():
        set_key(data, key, value, None)
    with pytest.raises(ScenarioError) as caught:
        Scenario.from_dict(data, "broken.toml")
    error = caught.value
    text = str(error)
    assert error.field == field and rule in error.rule, text
    assert text.startswith("broken.toml: ") and "\n" not in text and "got " in text and len(text) < 700


# -- flights ----------------------------------------------------------------------------------------


class Unfiltered:
    """No filter at all: what is desired, within the thrust limits."""

    def __init__(self, q):
        self.limit, self.families = q.thrust_max, Families(q, without=("passive", "deputy_passive"))

    def batch(self, x, sun, desired):
        u = np.clip(desired, -self.limit, self.limit)
        return Filtered(u, np.zeros(u.shape[:2], dtype=np.int8), self.families(x, sun))


def fly_unfiltered(q, primary, x, sun, duration):
    return fly_one(FlightBatch(q, x[None], np.array([sun]), duration, primary=primary), Unfiltered(q))


def test_primary_alone_breaks_what_the_filter_keeps():
    scenario = load_scenario("inspection").with_assignments(["flight.duration_s=1200"])
    x, sun = scenario.initial()
    alone = fly_unfiltered(scenario.inspection(), scenario.primary(), x, sun, 1200.0)
    broken = {
        name
        for name, least in least_values(alone, scenario.families(), 0).constraints.items()
        if least.value < 0
    }
    assert broken >= {"phi1", "phi2", "phi3", "phi7", "phi8", "phi10", "phi11"}


def test_every_constraint_is_judged_and_holds_for_a_while():
    scenario = load_scenario("inspection").with_assignments(["flight.duration_s=60", "flight.between=3"])
    flown = fly_flight(scenario)
    assert tuple(flown.constraints) == CONSTRAINTS and tuple(flown.barriers) == FAMILIES
    for least in (*flown.constraints.values(), *flown.barriers.values()):
        assert 0 <= least.value <= least.at_samples and 0 <= least.time <= 60.0
        assert least.violated_share == 0 and 1 <= len(least.deputies) <= 2


def test_judge_sees_what_happens_between_samples():
    """A deputy that flies past the chief within one period: clear at both samples, inside between them."""
    scenario = load_scenario("inspection").with_assignments(["initial.states=[[0, 300, 0, 0, 0, 0]]"])
    x = np.array([[0.0, 20.0, 0.0, 0.0, -40.0, 0.0]])
    run = fly_unfiltered(scenario.inspection(), lambda t, x: np.zeros((1, 1, 3)), x, 0.0, 1.0)
    at_samples = least_values(run, scenario.families(), 0).constraints["phi1"]
    between = least_values(run, scenario.families(), 3).constraints["phi1"]
    assert at_samples.value == pytest.approx(10.0, abs=0.1) and at_samples.violated_share == 0
    assert between.value == pytest.approx(-10.0, abs=0.1) and between.time == 0.5
    assert between.at_samples == at_samples.value
