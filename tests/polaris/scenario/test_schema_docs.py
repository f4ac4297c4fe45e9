"""The reference page is that of the models; schemas are made with the pages and judge as the models do."""

import inspect
import re
from pathlib import Path
from typing import get_args

import jsonschema
import numpy as np
import pytest

import polaris
from docs.generate.scenario_docs import REFERENCE_FILE, inspection_schema, reference_text, schema
from polaris.model.errors import ScenarioError
from polaris.model.keys import keys_of
from polaris.scenario.reading import validate
from polaris.scenario.scenario import bundled_scenarios, load_scenario
from polaris.scenario.tables import goals as goal_tables
from polaris.scenario.tables import scene as scene
from polaris.scenario.tables import schedule as scenario_model

DOCS = Path(__file__).resolve().parents[3] / "docs"


def test_committed_page_is_up_to_date():
    committed = (DOCS / REFERENCE_FILE).read_text(encoding="utf-8")
    assert committed == reference_text(), "run: make schema"


def _tables():
    tables = schema()
    yield "top level", tables
    yield from tables["$defs"].items()
    yield from inspection_schema()["$defs"].items()


def test_every_field_has_description_and_the_unit_in_its_name():
    for table, node in _tables():
        assert node["description"] and node["additionalProperties"] is False, table
        for name, field in node["properties"].items():
            assert field.get("description") and field.get("unit"), f"{table}.{name}"
            ending = next((e for e in sorted(UNITS, key=len, reverse=True) if name.endswith(e)), "")
            assert field["unit"].startswith(UNITS.get(ending, "")), f"{table}.{name}: {field['unit']}"


UNITS = {"_m": "m", "_s": "s", "_kg": "kg", "_m2_kg": "m^2/kg", "_N": "N", "_N_s": "N s", "_m_s": "m/s"}
UNITS |= {"_m_s2": "m/s^2", "_rad": "rad", "_1_s": "1/s", "_1_m2": "1/m^2", "_s2_m2": "s^2/m^2"}
UNITS |= {"_1_N2": "1/N^2", "_deg": "deg", "_rad_s": "rad/s"}


def test_schema_is_valid_and_accepts_the_bundled_scenarios():
    validator = jsonschema.Draft202012Validator(schema())
    validator.check_schema(schema())
    for name in bundled_scenarios():
        validator.validate(load_scenario(name).to_dict())


@pytest.mark.parametrize(
    ("name", "key", "value"),
    [
        ("static", "system.mass_kg", -1),
        ("static", "system.mass", 3),
        ("static", "goal.kind", "moon"),
        ("static", "horizon.step_s", "30"),
        ("static", "name", "a/b"),
        ("inspection", "parameters.mass_kg", -1),
        ("inspection", "parameters.mass", 3),
        ("inspection", "filter.kind", "moon"),
        ("inspection", "flight.period_s", "1"),
    ],
)
def test_schemas_refuse_what_the_models_refuse(name, key, value):
    document, spec = load_scenario(name).to_dict(), schema() if name == "static" else inspection_schema()
    validator = jsonschema.Draft202012Validator(spec)
    validator.check_schema(spec)
    assert validator.is_valid(document)
    table, _, field = key.rpartition(".")
    (document[table] if table else document)[field] = value
    assert not validator.is_valid(document)


ITEM = re.compile(r"^- ((?:`\w+`(?:,\s+)?)+)(?: \(|:|$)", re.M)
"""Item of the reference: one key, or more with equal values and descriptions."""


def test_reference_names_every_field_of_every_table():
    text = reference_text()
    field_names = {name for keys in ITEM.findall(text) for name in re.findall(r"\w+", keys)}
    field_names |= set(re.findall(r"^#+ `\[+(?:\w+\.)*(\w+)\]+`$", text, re.M)) | {"kind"}
    field_names |= set(re.findall(r"`\[+(\w+)\]+`", text))
    for table, node in _tables():
        assert set(node["properties"]) <= field_names, table


def test_an_item_leaves_out_what_its_key_says():
    text = reference_text()
    assert "\n- `semi_major_axis_m` (required)\n" in text  # a number in metres, the semi-major axis
    assert "\n- `position_error_m`, `velocity_error_m_s` (number or list, default 0): " in text
    assert "[m/s^2]" not in text and "- `bias` ([unit of h], default 0): " in text


UNIT = re.compile(r"_(m_s2|rad_s|m_s|deg|rad|steps|kg|N|m|s)$")
NAMES = {"normals": "H", "offsets": "b", "half_angle": "half_angle_rad"}

IN_FILES_ONLY = {"StateObstacle", "KeepInStates", "SpeedLimit", "SpeedPolygon", "TurningKeepIn"}
"""Classes of sets that have no public name."""

UNIONS = scene.Obstacle, scene.KeepIn, goal_tables.Goal
SETS_AND_GOALS = [table for union in UNIONS for table in get_args(get_args(union)[0])]
TABLES = [*SETS_AND_GOALS, scenario_model.ScheduleTable]


@pytest.mark.parametrize("table", TABLES, ids=lambda table: table.__name__)
def test_classes_of_tables_have_public_names(table):
    """A new obstacle, keep-in set or goal is a line in `polaris/__init__.pyi`, and one in `docs/api.md`."""
    name = table.MAKES.__name__
    assert (getattr(polaris, name, None) is table.MAKES) == (name not in IN_FILES_ONLY)


PUBLIC = [table for table in TABLES if table.MAKES.__name__ not in IN_FILES_ONLY]


@pytest.mark.parametrize("table", PUBLIC, ids=lambda table: table.__name__)
def test_python_names_are_those_of_the_file_without_units(table):
    """As the reference says: one rule, and the exceptions it lists."""
    bare = {UNIT.sub("", key) for key in table.model_fields} - {"kind"}
    if issubclass(table, goal_tables.GoalTable):
        bare -= {"tolerance", "velocity_tolerance"}  # a field of `Problem`
    bare -= {"bound_programs"}  # an argument of `share_bound`
    accepted = set(inspect.signature(table.MAKES).parameters)
    assert {NAMES.get(name, name) for name in bare} <= accepted


SATELLITE = {"name": "o", "state": [0.0] * 6, "state_half_widths": [0.0] * 6, "radius": 1.0}
SQUARE = {"name": "o", "center": [0, 0], "half_widths": [1, 1]}
DISC = {"name": "o", "center": [0, 0], "radius": 1.0}
LINE = {"mean_motion": 0.0012, "amplitude_max": 5.0}
CONE = {"name": "o", "apex": [0, 0, 0], "axis": [0, 1, 0], "half_angle_rad": 0.5}
ELLIPSE = {"mean_motion": 0.0012, "inner_semi_minor": 40.0, "outer_semi_minor": 80.0}


@pytest.mark.parametrize(
    "table, given, field, bad",
    [
        (scene.BoxObstacleTable, SQUARE, "half_widths", [1, -1]),
        (scene.BallObstacleTable, DISC, "radius", 0.0),
        (scene.BallObstacleTable, DISC, "facets", 65),
        (scene.BallObstacleTable, DISC, "velocity", [True, 0]),
        (scene.PolytopeObstacleTable, {"name": "o", "H": [[1.0], [-1.0]], "b": [1, 1]}, "unbounded", 1),
        (scene.SatelliteObstacleTable, SATELLITE, "thrust_accel_max", -1e-3),
        (scene.KeepInConeTable, CONE, "half_angle_rad", 1.6),
        (goal_tables.EllipticalNMTGoal, ELLIPSE, "sides", 4.5),
        (goal_tables.LinearNMTGoal, LINE, "along_track", float("nan")),
        (goal_tables.BoxGoal, {"center": [0, 0], "half_widths": [1, float("inf")]}, "half_widths", [1, -1]),
        (scenario_model.Orbit, {"mean_motion": 0.0012}, "rate_deviation", 0.2),
    ],
)
def test_python_is_held_to_the_rules_of_a_file(table, given, field, bad):
    """One description of a field checks both: what Python refuses a file refuses by the same rule."""
    instance, keys = table.MAKES(**given), keys_of(table.MAKES)
    with pytest.raises(ScenarioError) as python:
        table.MAKES(**given | {field: bad})
    values = {name: getattr(instance, name) for name in keys} | {field: bad}
    converted = {name: np.degrees(x) if keys[name].name.endswith("_deg") else x for name, x in values.items()}
    written = {keys[name].name: x for name, x in converted.items() if x is not None}
    if "kind" in table.model_fields:
        (written["kind"],) = get_args(table.model_fields["kind"].annotation)
    with pytest.raises(ScenarioError) as file:
        validate(table, written)
    assert python.value.field.endswith(f".{field}") and file.value.field.startswith(keys[field].name)
    assert python.value.rule.partition(" [")[0] == file.value.rule
