"""The reference page is that of the models; schemas are made with the pages and judge as the models do."""

import inspect
import json
import re
from pathlib import Path
from typing import get_args

import jsonschema
import numpy as np
import pytest

import polaris
from docs.generate.scenario_docs import (
    INSPECTION_FILE,
    REFERENCE_FILE,
    SCHEMA_FILE,
    inspection_schema,
    reference_text,
    schema,
    texts,
    write,
)
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


def test_writing_gives_the_page_and_both_schemas(tmp_path):
    written = write(tmp_path / "new")
    assert {path.name for path in written} == {SCHEMA_FILE, INSPECTION_FILE, REFERENCE_FILE}
    for path in written:
        assert path.read_bytes() == texts()[path.name].encode()


def _tables():
    tables = schema()
    yield "top level", tables
    yield from tables["$defs"].items()
    yield from inspection_schema()["$defs"].items()


def test_every_field_has_description_and_unit():
    for table, node in _tables():
        assert node["description"], table
        for name, field in node["properties"].items():
            assert field.get("description"), f"{table}.{name} lacks a description"
            assert field.get("unit"), f"{table}.{name} lacks a unit"


UNITS = {
    "_m": "m",
    "_s": "s",
    "_kg": "kg",
    "_m2_kg": "m^2/kg",
    "_N": "N",
    "_N_s": "N s",
    "_m_s": "m/s",
    "_m_s2": "m/s^2",
    "_rad": "rad",
    "_1_s": "1/s",
    "_1_m2": "1/m^2",
    "_s2_m2": "s^2/m^2",
    "_1_N2": "1/N^2",
    "_deg": "deg",
    "_rad_s": "rad/s",
}


def test_unit_in_the_name_is_the_unit_of_the_field():
    for table, node in _tables():
        for name, field in node["properties"].items():
            ending = next((e for e in sorted(UNITS, key=len, reverse=True) if name.endswith(e)), None)
            if ending:
                assert field["unit"].startswith(UNITS[ending]), f"{table}.{name}: {field['unit']}"


def test_unknown_keys_are_refused_everywhere():
    for table, node in _tables():
        assert node["additionalProperties"] is False, table


def test_schema_is_valid_and_accepts_the_bundled_scenarios():
    validator = jsonschema.Draft202012Validator(schema())
    validator.check_schema(schema())
    for name in bundled_scenarios():
        validator.validate(load_scenario(name).to_dict())


def test_inspection_schema_is_valid_and_refuses_what_the_models_refuse():
    validator = jsonschema.Draft202012Validator(inspection_schema())
    validator.check_schema(inspection_schema())
    document = load_scenario("inspection").to_dict()
    assert validator.is_valid(document)
    for table, field, value in (
        ("parameters", "mass_kg", -1),
        ("parameters", "mass", 3),
        ("filter", "kind", "moon"),
        ("flight", "period_s", "1"),
    ):
        broken = {**document, table: {**document[table], field: value}}
        assert not validator.is_valid(broken), field


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("system.mass_kg", -1),
        ("system.mass", 3),
        ("goal.kind", "moon"),
        ("horizon.step_s", "30"),
        ("name", "a/b"),
    ],
)
def test_schema_refuses_what_the_models_refuse(key, value):
    document = load_scenario("static").to_dict()
    table, _, field = key.rpartition(".")
    (document[table] if table else document)[field] = value
    assert not jsonschema.Draft202012Validator(schema()).is_valid(document)


def test_both_parts_of_the_reference_are_made_anew(monkeypatch):
    monkeypatch.setattr("docs.generate.scenario_docs._schedule_lines", lambda: ["one"])
    monkeypatch.setattr("docs.generate.scenario_docs._inspection_lines", lambda: ["two"])
    text = reference_text()
    assert text.startswith("# Scenario reference\n") and "\n# Scenarios of the inspection problem\n" in text
    assert re.findall(r"-->\n\n(.*?)\n\n<!-- end -->", text, re.S) == ["one", "two"]


ITEM = re.compile(r"^- ((?:`\w+`(?:,\s+)?)+)(?: \(|:|$)", re.M)
"""Item of the reference: one key, or more with equal values and descriptions."""


def test_reference_names_every_field_of_every_table():
    text = reference_text()
    named = {name for keys in ITEM.findall(text) for name in re.findall(r"\w+", keys)}
    named |= set(re.findall(r"^#+ `\[+(?:\w+\.)*(\w+)\]+`$", text, re.M)) | {"kind"}
    named |= set(re.findall(r"`\[+(\w+)\]+`", text))
    for table, node in _tables():
        assert set(node["properties"]) <= named, table


def test_items_of_the_reference_are_keys_and_its_lines_fit():
    names = {name for _, node in _tables() for name in node["properties"]}
    for part in re.findall(r"-->\n\n(.*?)\n\n<!-- end -->", reference_text(), re.S):
        assert max(map(len, part.splitlines())) <= 100
        items = re.findall(r"^ *(?:[-+*]|\d+\.) .*", part, re.M)
        keys = ITEM.findall(part)
        assert len(keys) == len(items) and {name for key in keys for name in re.findall(r"\w+", key)} <= names


def test_an_item_leaves_out_what_its_key_says():
    text = reference_text()
    assert "\n- `semi_major_axis_m` (required)\n" in text  # a number in metres, the semi-major axis
    assert "\n- `position_error_m`, `velocity_error_m_s` (number or list, default 0): " in text
    assert "[m/s^2]" not in text and "- `bias` ([unit of h], default 0): " in text


def test_schema_is_json():
    assert json.loads(texts()["scenario.schema.json"])["title"] == "Polaris scenario"


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
    taken = set(inspect.signature(table.MAKES).parameters)
    assert {NAMES.get(name, name) for name in bare} <= taken


SATELLITE = {"name": "o", "state": [0.0] * 6, "state_half_widths": [0.0] * 6, "radius": 1.0}
CONE = {"name": "o", "apex": [0, 0, 0], "axis": [0, 1, 0], "half_angle_rad": 0.5}
ELLIPSE = {"mean_motion": 0.0012, "inner_semi_minor": 40.0, "outer_semi_minor": 80.0}


@pytest.mark.parametrize(
    "table, given, field, bad",
    [
        (
            scene.BoxObstacleTable,
            {"name": "o", "center": [0, 0], "half_widths": [1, 1]},
            "half_widths",
            [1, -1],
        ),
        (scene.BoxObstacleTable, {"name": "o", "center": [0, 0], "half_widths": [1, 1]}, "name", "a/b"),
        (scene.BallObstacleTable, {"name": "o", "center": [0, 0], "radius": 1.0}, "radius", 0.0),
        (scene.BallObstacleTable, {"name": "o", "center": [0, 0], "radius": 1.0}, "center", [0, 1e13]),
        (scene.BallObstacleTable, {"name": "o", "center": [0, 0], "radius": 1.0}, "facets", 65),
        (scene.BallObstacleTable, {"name": "o", "center": [0, 0], "radius": 1.0}, "velocity", [True, 0]),
        (scene.PolytopeObstacleTable, {"name": "o", "H": [[1.0], [-1.0]], "b": [1, 1]}, "unbounded", 1),
        (scene.SatelliteObstacleTable, SATELLITE, "thrust_accel_max", -1e-3),
        (scene.KeepInConeTable, CONE, "length", "far"),
        (scene.KeepInConeTable, CONE, "half_angle_rad", 1.6),
        (goal_tables.EllipticalNMTGoal, ELLIPSE, "sides", 4.5),
        (
            goal_tables.LinearNMTGoal,
            {"mean_motion": 0.0012, "amplitude_max": 5.0},
            "along_track",
            float("nan"),
        ),
        (goal_tables.BoxGoal, {"center": [0, 0], "half_widths": [1, float("inf")]}, "half_widths", [1, -1]),
        (scenario_model.PlannerTable, {}, "gap", 1.0),
        (scenario_model.Orbit, {"mean_motion": 0.0012}, "rate_deviation", 0.2),
    ],
)
def test_python_is_held_to_the_rules_of_a_file(table, given, field, bad):
    """One description of a field checks both: what Python refuses a file refuses by the same rule."""
    made, keys = table.MAKES(**given), keys_of(table.MAKES)
    with pytest.raises(ScenarioError) as python:
        table.MAKES(**given | {field: bad})
    held = {name: getattr(made, name) for name in keys} | {field: bad}
    turned = {name: np.degrees(x) if keys[name].name.endswith("_deg") else x for name, x in held.items()}
    written = {keys[name].name: x for name, x in turned.items() if x is not None}
    if "kind" in table.model_fields:
        (written["kind"],) = get_args(table.model_fields["kind"].annotation)
    with pytest.raises(ScenarioError) as file:
        validate(table, written)
    assert python.value.field.endswith(f".{field}") and file.value.field.startswith(keys[field].name)
    assert python.value.rule.partition(" [")[0] == file.value.rule
