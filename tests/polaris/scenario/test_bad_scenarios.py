"""Broken scenarios: each ends in one `ScenarioError`, one line, naming the field, the value and the rule."""

import copy
import os
import tomllib
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from polaris.model.errors import ScenarioError
from polaris.model.keys import PositivePerAxis, keys_of
from polaris.scenario.reading import MAX_BYTES
from polaris.scenario.scenario import Scenario, load_scenario
from polaris.scenario.tables import goals as goal_tables
from polaris.scenario.tables import scene as scene_tables
from polaris.scenario.tables import schedule as tables

NAN, INF = float("nan"), float("inf")
BALL = {"kind": "ball", "name": "rock", "center_m": [125.0, 230.0, 0.0], "radius_m": 20.0}
WALL = {"kind": "polytope", "name": "wall", "normals": [[0.0, -1.0, 0.0]], "unbounded": True}
WALL |= {"offsets_m": [-900.0]}
CONE = {"kind": "cone", "name": "view", "apex_m": [0, 0, 0], "axis": [0, 1, 0], "half_angle_deg": 20.0}
SATELLITE = {"kind": "satellite", "name": "visitor", "state": [373.7, 266.7, -12.7, -0.643, -0.4113, 0.013]}
SATELLITE |= {"state_half_widths": [2, 2, 2, 0.002, 0.002, 0.002], "radius_m": 20.0}
HOLD = {"goal": {"kind": "stationary", "state": [0, 60, 0, 0, 0, 0]}}


def obstacle(table, **changes):
    return {"obstacles[0]": {**table, **changes}}


def keep_in(**changes):
    return {"keep_in": [{**CONE, **changes}]}


def document(name):
    return tomllib.loads((Path(__file__).parents[1] / "data" / f"{name}.toml").read_text(encoding="utf-8"))


def refused(data):
    """The error of a scenario that must be refused, checked for its form."""
    with pytest.raises(ScenarioError) as caught:
        Scenario.from_dict(data, "broken.toml")
    error = caught.value
    text = str(error)
    assert error.exit_code == 2
    assert "\n" not in text and text.isprintable(), text
    assert text.startswith("broken.toml: ") and error.field in text and error.rule in text and "got " in text
    assert len(text) < 700, text
    return error


BROKEN = [
    ({"system.mass_kg": 0}, "system.mass_kg", ">= 0.001"),
    ({"system.mass_kg": "10"}, "system.mass_kg", "must be a number"),
    ({"system.mass_kg": INF}, "system.mass_kg", "finite"),
    ({"system.mass_kg": 10**5000}, "system.mass_kg", "1e+12"),
    ({"system.thrust_max_N": [0.1, 0.1]}, "system.thrust_max_N", "must have 3"),
    ({"system.thrust_max_N": [0.1, -0.1, 0.1]}, "system.thrust_max_N[1]", "> 0"),
    ({"system.kind": "newton"}, "system.kind", "'clohessy_wiltshire', 'linear'"),
    ({"system.kind": None}, "system.kind", "must be one of"),
    ({"system": None}, "system", "required"),
    ({"system.mass_kg": None}, "system.mass_kg", "required"),
    ({"system.mass_kg": None, "system.mas_kg": 10.0}, "system.mas_kg", "did you mean mass_kg"),
    ({"sistem": {}}, "sistem", "did you mean system"),
    ({"a\nb": 1}, '"a\\nb"', "unknown key"),
    ({"schema_version": True}, "schema_version", "whole number 1"),
    ({"name": "a\nb"}, "name", "letters"),
    ({"name": "a" * 100}, "name", "at most 64"),
    ({"initial_set.center": [[0, 400, 0, 0.24, 0, 0]]}, "initial_set.center[0]", "a number"),
    ({"initial_set.half_widths": [3, 3, -3, 0, 0, 0]}, "initial_set.half_widths[2]", ">= 0"),
    ({"initial_set.center": [0, 2e5, 0, 0, 0, 0]}, "initial_set.center", "1e+05|100000"),
    ({"obstacles[0].center_m": [0, 400, 0]}, "initial_set.center", "is 25 m inside"),
    (obstacle(BALL, center_m=[0, 422, 0]), "initial_set.half_widths", "reaches 1 m into"),
    (
        obstacle(SATELLITE, state=[0, 430, 0, 0, 0, 0], state_half_widths=[12, 12, 12, 0, 0, 0]),
        *("initial_set.center", "is 2 m inside"),
    ),
    (obstacle(WALL, offsets_m=[-300.0]), "initial_set.center", "100 m"),
    (keep_in(axis=[1, 0, 0]), "initial_set.center", "must be inside"),
    (keep_in(half_angle_deg=0.5), "initial_set.half_widths", "out of it"),
    (
        {"keep_in": [{"kind": "polytope", "name": "in", "normals": [[0, 1, 0]], "offsets_m": [380]}]},
        *("initial_set.center", "20 m outside"),
    ),
    ({"horizon.step_s": 7.0}, "horizon.step_s", "must divide duration_s = 1800"),
    ({"horizon.step_s": 1e-310}, "horizon.step_s", "at most 100000 steps"),
    ({"horizon.step_s": tomllib.loads("d = 2024-01-01")["d"]}, "horizon.step_s", "a number"),
    ({"feedback": {"period_s": 7.0}}, "feedback.period_s", "must divide step_s = 30"),
    ({"feedback": {"period_s": 1e-6}}, "feedback.period_s", "at most 100000"),
    ({"feedback": {"kind": "continuous"}}, "feedback.kind", "all feedback is sampled: write period_s alone"),
    ({"tracking.Q": [1, 1, 1, 1, 1, -1]}, "tracking.Q", "semidefinite"),
    ({"tracking.Q": [0, 0, 0, 0, 0, 0]}, "tracking.Q", "must weight every mode"),
    ({"tracking.Q": (np.eye(6) + np.eye(6, k=1)).tolist()}, "tracking.Q", "symmetric"),
    ({"tracking.R": [[1, 1, 0], [1, 1, 0], [0, 0, 1]]}, "tracking.R", "definite"),
    ({"tracking.R": [1e-30] * 3, "tracking.Q": [1e12] * 6}, "tracking.Q", "Riccati"),
    ({"tracking.weight": [1, 1]}, "tracking.weight", "must have 6"),
    ({"tracking.bound": "guess"}, "tracking.bound", "'envelope' or 'lyapunov'"),
    ({"planner.gap": 1.0}, "planner.gap", "< 1"),
    ({"thrusters": {"varies": "never"}}, "thrusters.varies", "called errors_vary"),
    ({"recoverable.recourse": "in_view"}, "recoverable.recourse", "called replan"),
    (
        {"experimental": [{"kind": "black_box", "name": "box", "confidence": 0.9999999999}]},
        *("experimental[0].confidence", "must be <= 0.999999999"),
    ),
    ({"goal.inner_semi_minor_m": 79.0}, "goal.inner_semi_minor_m", "must be below"),
    ({"goal.sides": 3}, "goal.sides", ">= 4"),
    (
        {"goal": {"kind": "stationary", "state": [10, 60, 0, 0, 0, 0]}},
        "goal.state",
        "must be at rest without input",
    ),
    ({**HOLD, "obstacles[0].center_m": [0, 60, 0]}, "goal.state", "at the end"),
    (
        {**HOLD, **obstacle(BALL, center_m=[180, 60, 0], velocity_m_s=[-0.1, 0, 0])},
        *("goal.state", "is 20 m inside"),
    ),
    (
        {"goal": {"kind": "stationary", "state": [0, -60, 0, 0, 0, 0]}, **keep_in()},
        *("goal.state", "must be inside keep_in[0]"),
    ),
    (
        {"goal": {"kind": "box", "center": [0] * 6, "half_widths": [1, 1, 1, 1, 1, -1]}},
        *("goal.half_widths[5]", ">= 0"),
    ),
    ({"obstacles": []}, "obstacles", "at least one obstacle"),
    ({"obstacles[0].half_widths_m": [25, 0, 25]}, "obstacles[0].half_widths_m", "> 0"),
    (obstacle(BALL, facets=7), "obstacles[0].facets", "6, 14, 18 or 26"),
    (obstacle(SATELLITE, state=[400, 0, 0, 0, 7500, 0]), "obstacles[0].state", "at most at 100 m/s"),
    (
        obstacle(WALL, normals=[[0, -1, 0], [0, 1, 0]], offsets_m=[-900, 800]),
        "obstacles[0].offsets_m",
        "interior",
    ),
    (obstacle(WALL, normals=[[0, 0, 0]]), "obstacles[0].normals", "row 0 must not be zero"),
    (obstacle(WALL, unbounded=False), "obstacles[0].normals", "must bound the set"),
    (keep_in(axis=[0, 0, 0]), "keep_in[0].axis", "must not be zero"),
    ({"obstacles": [BALL, BALL]}, "obstacles[1].name", "must be unique"),
    (keep_in(name="debris"), "keep_in[0].name", "must be unique"),
    ({"obstacles": [{**BALL, "name": f"rock{i}"} for i in range(65)]}, "obstacles", "at most 64"),
    ({"experimental[0].Q": None}, "experimental[0].Q", "must be given"),
    ({"experimental[0].gain": [[0.0] * 6] * 3}, "experimental[0].gain", "not both"),
    (
        {"experimental[0]": {"kind": "affine", "name": "u", "gain": [[0.0] * 3] * 6}},
        *("experimental[0].gain", "3 x 6"),
    ),
    ({"experimental[0].name": "safety"}, "experimental[0].name", "must not be"),
    (
        {"experimental[0].reference": {"kind": "setpoint", "state": [0, 0, 0]}},
        *("experimental[0].reference.state", "must have 6"),
    ),
    (
        {"experimental[0]": {"kind": "any_thrust", "name": "u", "gain": [[1.0]]}},
        *("experimental[0].gain", "unknown key"),
    ),
    ({"schedule.min_dwell_steps": 61}, "schedule.min_dwell_steps", "at most"),
    ({"simulation.seed": 2**64}, "simulation.seed", "<= 9"),
]
"""Changes in `data/space.toml`, the field to blame, and a piece of the rule."""

C_OF = {"system.position_states": None}
UNSTABLE = {"system.A": [[0, 0, 1, 0], [0, 0.1, 0, 0], [0, 0, 0, 0], [0, 0, 0, -1]]}
ON_A_LINE = {
    "system": {"kind": "linear", "A": [[0, 1], [0, 0]], "B": [[0], [1]], "D": [[0], [1]], "input_max": 1.0},
    "initial_set": {"kind": "box", "center": [0, 0], "half_widths": [1, 1]},
    "tracking": {"Q": [1, 1], "R": [1]},
    "goal": {"kind": "stationary", "state": [5, 0]},
    "obstacles": [],
    "experimental": [{"kind": "any_thrust", "name": "u"}],
}
ROUND = {"kind": "ball", "center": [0] * 4, "position_radius_m": 1, "velocity_radius_m_s": 1}

BROKEN_LINEAR = [
    ({"system.A": [[0, 1, 0, 0]] * 3}, "system.A", "square"),
    ({"system.A": [[0, INF], [0, 0]]}, "system.A[0][1]", "finite"),
    ({"system.B": [[0, 0], [0, 0], [1, 0]]}, "system.B", "4 rows"),
    ({"system.B": [[0, 0], [0, 0], [1, 0], [0, 0]]}, "system.B", "not stabilisable"),
    (
        {**UNSTABLE, "system.B": [[0, 0], [0, 0], [1, 0], [0, 1]]},
        *("system.B", "not stabilisable: eigenvalue 0.1"),
    ),
    (
        {"system.A": [[0, 0, 1, 0], [0, 0, 0, 1], [0, 0, 500, 0], [0, 0, 0, 500]]},
        *("horizon.step_s", "for the fastest mode"),
    ),
    ({"system.position_states": [0, 4]}, "system.position_states", "below 4"),
    ({"system.position_states": [1, 1]}, "system.position_states", "different"),
    ({"system.position_states": [0, 1, 2, 3]}, "system.position_states", "at most 3"),
    ({"system.C": [[1, 0, 0, 0]]}, "system.C", "left out with position_states"),
    ({**C_OF, "system.C": [[1, 0, 0, 0], [2, 0, 0, 0]]}, "system.C", "independent"),
    ({"initial_set.generators": [[3.5, 2.5, 0, 0]]}, "initial_set.generators", "reaches"),
    (
        {**C_OF, "system.C": [[1, 1, 0, 0], [0, 1, 0, 0]], "initial_set": ROUND},
        *("initial_set.kind", "choice of states"),
    ),
    (
        {"goal": {"kind": "elliptical_nmt", "inner_semi_minor_m": 1, "outer_semi_minor_m": 2}},
        *("goal.kind", "Hill's frame"),
    ),
    (
        {"experimental[0].reference": {"kind": "nmt", "semi_minor_m": 1}},
        *("experimental[0].reference.kind", "Hill's frame"),
    ),
    (
        {
            **ON_A_LINE,
            "keep_in": [{"kind": "cone", "name": "c", "apex_m": [-9], "axis": [1], "half_angle_deg": 5}],
        },
        *("keep_in[0].apex_m", "2 or 3 axes"),
    ),
]
"""The same for `data/floor.toml`, a system given by its matrices."""


def broken(name, changes):
    """A scenario's data with changes at dotted keys; None removes."""
    data = document(name)
    for key, value in changes.items():
        *path, last = key.replace("]", "").replace("[", ".").split(".") if "\n" not in key else [key]
        holder = data
        for part in path:
            holder = holder[int(part)] if isinstance(holder, list) else holder.setdefault(part, {})
        if isinstance(holder, list):
            holder[int(last)] = copy.deepcopy(value)
        elif value is None:
            holder.pop(last)
        else:
            holder[last] = copy.deepcopy(value)
    return data


CASES = [("space", *case) for case in BROKEN] + [("floor", *case) for case in BROKEN_LINEAR]


@pytest.mark.parametrize("name, changes, field, rule", CASES)
def test_broken(name, changes, field, rule):
    error = refused(broken(name, changes))
    assert error.field == field, str(error)
    assert any(piece in error.rule for piece in rule.split("|")), str(error)


def test_several_mistakes_are_counted_and_values_cut():
    error = refused(broken("space", {"system.mass_kg": -1, "goal.sides": 1, "name": ""}))
    assert "and 2 more to correct: " in str(error)
    error = refused(broken("space", {"system.kind": "x" * 10_000}))
    assert "'xxxx" in str(error) and len(str(error)) < 300


def refused_file(path):
    with pytest.raises(ScenarioError) as caught:
        load_scenario(path)
    text = str(caught.value)
    assert "\n" not in text and text.isprintable() and len(text) < 600, text
    return text


@pytest.mark.parametrize(
    "data, rule",
    [
        (bytes(range(256)) * 20, "UTF-8"),
        (bytes(1000), "TOML"),
        (b" \n\t\n", "must not be empty"),
        (b"# nothing\n", "is required"),
        (b"#" * (MAX_BYTES + 1), "at most"),
        (b"[system\nmass_kg = 1\n", "line 1"),
        (b"name = 'a'\nname = 'b'\n", "line 2"),
        (b"a = " + b"[" * 200_000, "TOML"),
        (b"name = " + b"[" * 300 + b"]" * 300, "name"),
        (b"x = " + b"9" * 5000, "TOML"),
        (b"schema_version = 0x" + b"f" * 5000, "schema_version"),
        (b"x = 2024-02-31\n", "TOML"),
        (b'"\\u001b[31m" = 1\n', "unknown key"),
    ],
    ids=lambda value: value if isinstance(value, str) else repr(value[:16]),
)
def test_broken_file(data, rule, tmp_path):
    file = tmp_path / "broken.toml"
    file.write_bytes(data)
    text = refused_file(file)
    assert rule in text and "broken.toml" in text, text


def test_what_is_no_file(tmp_path):
    assert "there is no such file" in refused_file(tmp_path / "nowhere.toml")
    assert "directory" in refused_file(tmp_path)
    text = refused_file("statik")
    assert "did you mean static?" in text and "keep_out" in text
    for name in ("a" * 5000, "a\x00b", "", "no\nsuch", "."):
        refused_file(name)
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe.toml")
        assert "regular file" in refused_file(tmp_path / "pipe.toml")
    (tmp_path / "secret.toml").touch(0)
    if not os.access(tmp_path / "secret.toml", os.R_OK):
        assert "cannot be read" in refused_file(tmp_path / "secret.toml")


def test_the_length_of_every_vector_is_checked():
    """Lists of numbers in a goal or an unsafe set: one for each state, for each axis, or for each facet."""
    unions = (goal_tables.Goal, scene_tables.Obstacle, scene_tables.KeepIn)
    parts = [table for union in unions for table in get_args(get_args(union)[0])]
    for key in (key for table in parts for key in keys_of(table.MAKES).values()):
        lists = "tuple[" in str(key.type)
        others = key.name in ("offsets_m", "bounds", "axes") or key.type is PositivePerAxis
        assert lists == (key.per in ("axis", "state") or others), key
    assert {name for part in get_args(get_args(tables.InitialSet)[0]) for name in part.model_fields} == {
        *("kind", "center", "half_widths", "position_radius_m", "velocity_radius_m_s", "generators")
    }


ANYTHING = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
)
PLACES = ("system", "system.A", "initial_set", "initial_set.center", "tracking.Q", "obstacles", "goal")


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.sampled_from(PLACES), ANYTHING)
def test_anything_in_any_place_is_refused_in_one_line(place, value):
    data = document("floor")
    table, _, field = place.rpartition(".")
    (data[table] if table else data)[field] = value
    refused(data)
