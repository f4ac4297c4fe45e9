"""Broken scenarios: each ends in one `ScenarioError`, one line, naming the field, the value and the rule."""

import copy
import os
import tomllib
from pathlib import Path
from typing import get_args

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
WALL = {
    "kind": "polytope",
    "name": "wall",
    "normals": [[0.0, -1.0, 0.0]],
    "offsets_m": [-900.0],
    "unbounded": True,
}
CONE = {"kind": "cone", "name": "view", "apex_m": [0, 0, 0], "axis": [0, 1, 0], "half_angle_deg": 20.0}
SATELLITE = {
    "kind": "satellite",
    "name": "visitor",
    "state": [373.7, 266.7, -12.7, -0.643, -0.4113, 0.013],
    "state_half_widths": [2, 2, 2, 0.002, 0.002, 0.002],
    "radius_m": 20.0,
}
LINEAR = {"kind": "linear", "A": [[0, 1], [0, 0]], "B": [[0], [1]], "D": [[0], [1]], "input_max": 1.0}


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


# What is changed in `data/space.toml`, the field to blame, and a piece of the rule.
BROKEN = {
    "negative mass": ({"system.mass_kg": -10.0}, "system.mass_kg", ">= 0.001"),
    "zero mass": ({"system.mass_kg": 0}, "system.mass_kg", ">= 0.001"),
    "mass in quotes": ({"system.mass_kg": "10"}, "system.mass_kg", "must be a number"),
    "mass is true": ({"system.mass_kg": True}, "system.mass_kg", "must be a number"),
    "mass is NaN": ({"system.mass_kg": NAN}, "system.mass_kg", "finite"),
    "mass is infinite": ({"system.mass_kg": INF}, "system.mass_kg", "finite"),
    "mass of 5000 digits": ({"system.mass_kg": 10**5000}, "system.mass_kg", "1e+12"),
    "varies, as it was called": (
        {"thrusters": {"varies": "never"}},
        "thrusters.varies",
        "called errors_vary",
    ),
    "in_view, as it was called": (
        {"recoverable.recourse": "in_view"},
        "recoverable.recourse",
        "called replan",
    ),
    "mean motion in degrees": ({"system.mean_motion_rad_s": 0.0688}, "system.mean_motion_rad_s", "<= 0.01"),
    "mean motion zero": ({"system.mean_motion_rad_s": 0.0}, "system.mean_motion_rad_s", "> 0"),
    "thrust zero": ({"system.thrust_max_N": 0.0}, "system.thrust_max_N", "> 0"),
    "thrust of two axes": ({"system.thrust_max_N": [0.1, 0.1]}, "system.thrust_max_N", "must have 3"),
    "thrust negative on an axis": (
        {"system.thrust_max_N": [0.1, -0.1, 0.1]},
        "system.thrust_max_N[1]",
        "> 0",
    ),
    "thrust in words": ({"system.thrust_max_N": "lots"}, "system.thrust_max_N", "must be a number"),
    "disturbance negative": ({"system.disturbance_max_m_s2": -1e-6}, "system.disturbance_max_m_s2", ">= 0"),
    "unknown kind of system": ({"system.kind": "newton"}, "system.kind", "'clohessy_wiltshire', 'linear'"),
    "no kind of system": ({"system.kind": None}, "system.kind", "must be one of"),
    "system is a number": ({"system": 3}, "system", "must be a table"),
    "no system": ({"system": None}, "system", "required"),
    "no mass": ({"system.mass_kg": None}, "system.mass_kg", "required"),
    "slip of the pen": (
        {"system.mass_kg": None, "system.mas_kg": 10.0},
        "system.mas_kg",
        "did you mean mass_kg",
    ),
    "unknown table": ({"sistem": {}}, "sistem", "did you mean system"),
    "unknown key with a line break": ({"a\nb": 1}, '"a\\nb"', "unknown key"),
    "version 2": ({"schema_version": 2}, "schema_version", "must be 1"),
    "version true": ({"schema_version": True}, "schema_version", "whole number 1"),
    "no version": ({"schema_version": None}, "schema_version", "required"),
    "name with a slash": ({"name": "../../etc/passwd"}, "name", "letters"),
    "name with a line break": ({"name": "a\nb"}, "name", "letters"),
    "name of 100 letters": ({"name": "a" * 100}, "name", "at most 64"),
    "empty title": ({"title": ""}, "title", "must not be empty"),
    "start of five numbers": (
        {"initial_set.center": [0, 400, 0, 0.24, 0]},
        "initial_set.center",
        "must have 6",
    ),
    "start is NaN": ({"initial_set.center": [0, 400, 0, NAN, 0, 0]}, "initial_set.center[3]", "finite"),
    "start nested": ({"initial_set.center": [[0, 400, 0, 0.24, 0, 0]]}, "initial_set.center[0]", "a number"),
    "width negative": (
        {"initial_set.half_widths": [3, 3, -3, 0, 0, 0]},
        "initial_set.half_widths[2]",
        ">= 0",
    ),
    "start too far": ({"initial_set.center": [0, 2e5, 0, 0, 0, 0]}, "initial_set.center", "1e+05|100000"),
    "start in an obstacle": ({"obstacles[0].center_m": [0, 400, 0]}, "initial_set.center", "is 25 m inside"),
    "edge of the start in an obstacle": (
        {"obstacles[0].center_m": [0, 427, 0]},
        "initial_set.half_widths",
        "reaches 1 m into",
    ),
    "start in a moving ball": (
        {"obstacles[0]": {**BALL, "center_m": [0, 390, 0], "velocity_m_s": [1, 0, 0]}},
        "initial_set.center",
        "is 10 m inside",
    ),
    "edge of the start in a ball": (
        {"obstacles[0]": {**BALL, "center_m": [0, 422, 0]}},
        "initial_set.half_widths",
        "reaches 1 m into",
    ),
    "start in another satellite's uncertainty": (
        {
            "obstacles[0]": {
                **SATELLITE,
                "state": [0, 430, 0, 0, 0, 0],
                "state_half_widths": [12, 12, 12, 0, 0, 0],
            }
        },
        "initial_set.center",
        "is 2 m inside",
    ),
    "start in a polytope": ({"obstacles[0]": {**WALL, "offsets_m": [-300.0]}}, "initial_set.center", "100 m"),
    "start outside a cone": (
        {"keep_in": [{**CONE, "axis": [1, 0, 0]}]},
        "initial_set.center",
        "must be inside",
    ),
    "edge of the start outside a cone": (
        {"keep_in": [{**CONE, "half_angle_deg": 0.5}]},
        "initial_set.half_widths",
        "out of it",
    ),
    "start beyond a cone's end": (
        {"keep_in": [{**CONE, "length_m": 350.0}]},
        "initial_set.center",
        "50 m outside",
    ),
    "start outside a polytope to stay in": (
        {"keep_in": [{"kind": "polytope", "name": "in", "normals": [[0, 1, 0]], "offsets_m": [380]}]},
        "initial_set.center",
        "20 m outside",
    ),
    "duration negative": ({"horizon.duration_s": -1}, "horizon.duration_s", "> 0"),
    "step does not divide": ({"horizon.step_s": 7.0}, "horizon.step_s", "must divide duration_s = 1800"),
    "step beyond the horizon": ({"horizon.step_s": 3600.0}, "horizon.step_s", "must divide"),
    "step zero": ({"horizon.step_s": 0}, "horizon.step_s", "> 0"),
    "a thousand million steps": ({"horizon.step_s": 1.8e-6}, "horizon.step_s", "at most 100000 steps"),
    "step of no size": ({"horizon.step_s": 1e-310}, "horizon.step_s", "at most 100000 steps"),
    "period does not divide": (
        {"feedback": {"period_s": 7.0}},
        "feedback.period_s",
        "must divide step_s = 30",
    ),
    "period longer than a step": ({"feedback": {"period_s": 60.0}}, "feedback.period_s", "must divide"),
    "period tiny": ({"feedback": {"period_s": 1e-6}}, "feedback.period_s", "at most 100000"),
    "kind of feedback": (
        {"feedback": {"kind": "continuous"}},
        "feedback.kind",
        "all feedback is sampled: write period_s alone",
    ),
    "Q of five numbers": ({"tracking.Q": [1, 1, 1, 1, 1]}, "tracking.Q", "6 numbers"),
    "Q indefinite": ({"tracking.Q": [1, 1, 1, 1, 1, -1]}, "tracking.Q", "semidefinite"),
    "Q zero": ({"tracking.Q": [0, 0, 0, 0, 0, 0]}, "tracking.Q", "must weight every mode"),
    "Q not symmetric": (
        {"tracking.Q": [[float(i == j) + (i < j) * 0.1 for j in range(6)] for i in range(6)]},
        "tracking.Q",
        "symmetric",
    ),
    "Q ragged": ({"tracking.Q": [[1, 0], [0]]}, "tracking.Q", "equal length"),
    "Q is a word": ({"tracking.Q": "high"}, "tracking.Q", "must be a list"),
    "R indefinite": ({"tracking.R": [1, 1, 0]}, "tracking.R", "positive definite"),
    "R has a hidden direction": ({"tracking.R": [[1, 1, 0], [1, 1, 0], [0, 0, 1]]}, "tracking.R", "definite"),
    "Q and R far apart": ({"tracking.R": [1e-30] * 3, "tracking.Q": [1e12] * 6}, "tracking.Q", "Riccati"),
    "weight of two": ({"tracking.weight": [1, 1]}, "tracking.weight", "must have 6"),
    "weight unknown": ({"tracking.weight": "best"}, "tracking.weight", "'auto' or 'identity'"),
    "bound unknown": ({"tracking.bound": "guess"}, "tracking.bound", "'envelope' or 'lyapunov'"),
    "printed ball": ({"recoverable.kind": "paper_ball"}, "recoverable.kind", "must be 'polytope' or 'ball'"),
    "time-varying ball": (
        {"recoverable.kind": "time_varying_ball"},
        "recoverable.kind",
        "must be 'polytope' or 'ball'",
    ),
    "recoverable unknown": ({"recoverable.kind": "cube"}, "recoverable.kind", "'polytope'"),
    "solver unknown": ({"planner.solver": "cplex"}, "planner.solver", "'facets', 'highs' or 'gurobi'"),
    "gap of one": ({"planner.gap": 1.0}, "planner.gap", "< 1"),
    "certainty": (
        {"experimental": [{"kind": "black_box", "name": "box", "confidence": 1.0}]},
        "experimental[0].confidence",
        "must be <= 0.999999999",
    ),
    "nearly certain": (
        {"experimental": [{"kind": "black_box", "name": "box", "confidence": 0.9999999999}]},
        "experimental[0].confidence",
        "must be <= 0.999999999",
    ),
    "no time": ({"planner.time_limit_s": 0}, "planner.time_limit_s", "> 0"),
    "goal inside out": ({"goal.inner_semi_minor_m": 90.0}, "goal.inner_semi_minor_m", "must be below"),
    "goal between the polygons": (
        {"goal.inner_semi_minor_m": 79.0},
        "goal.inner_semi_minor_m",
        "must be below",
    ),
    "goal of three sides": ({"goal.sides": 3}, "goal.sides", ">= 4"),
    "goal of 4.5 sides": ({"goal.sides": 4.5}, "goal.sides", "whole number"),
    "hold point that drifts": (
        {"goal": {"kind": "stationary", "state": [10, 60, 0, 0, 0, 0]}},
        "goal.state",
        "must be at rest without input",
    ),
    "hold point in an obstacle": (
        {"goal": {"kind": "stationary", "state": [0, 60, 0, 0, 0, 0]}, "obstacles[0].center_m": [0, 60, 0]},
        "goal.state",
        "at the end",
    ),
    "hold point where a ball arrives": (
        {
            "goal": {"kind": "stationary", "state": [0, 60, 0, 0, 0, 0]},
            "obstacles[0]": {**BALL, "center_m": [180, 60, 0], "velocity_m_s": [-0.1, 0, 0]},
        },
        "goal.state",
        "is 20 m inside",
    ),
    "hold point outside the cone": (
        {"goal": {"kind": "stationary", "state": [0, -60, 0, 0, 0, 0]}, "keep_in": [CONE]},
        "goal.state",
        "must be inside keep_in[0]",
    ),
    "goal box negative": (
        {"goal": {"kind": "box", "center": [0] * 6, "half_widths": [1, 1, 1, 1, 1, -1]}},
        "goal.half_widths[5]",
        ">= 0",
    ),
    "no goal": ({"goal": None}, "goal", "required"),
    "nothing to be safe from": ({"obstacles": []}, "obstacles", "at least one obstacle"),
    "obstacle of two axes": ({"obstacles[0].center_m": [125, 230]}, "obstacles[0].center_m", "must have 3"),
    "obstacle flat": ({"obstacles[0].half_widths_m": [25, 0, 25]}, "obstacles[0].half_widths_m", "> 0"),
    "ball with a negative radius": (
        {"obstacles[0]": {**BALL, "radius_m": -1}},
        "obstacles[0].radius_m",
        "> 0",
    ),
    "ball of seven facets": (
        {"obstacles[0]": {**BALL, "facets": 7}},
        "obstacles[0].facets",
        "6, 14, 18 or 26",
    ),
    "obstacle at orbital speed": (
        {"obstacles[0].velocity_m_s": [0, 7500, 0]},
        "obstacles[0].velocity_m_s",
        "at most at 100 m/s",
    ),
    "satellite at orbital speed": (
        {"obstacles[0]": {**SATELLITE, "state": [400, 0, 0, 0, 7500, 0]}},
        "obstacles[0].state",
        "at most at 100 m/s",
    ),
    "satellite of three numbers": (
        {"obstacles[0]": {**SATELLITE, "state": [400, 0, 0]}},
        "obstacles[0].state",
        "must have 6",
    ),
    "polytope without room": (
        {"obstacles[0]": {**WALL, "normals": [[0, -1, 0], [0, 1, 0]], "offsets_m": [-900, 800]}},
        "obstacles[0].offsets_m",
        "interior",
    ),
    "polytope with a row of zeros": (
        {"obstacles[0]": {**WALL, "normals": [[0, 0, 0]]}},
        "obstacles[0].normals",
        "row 0 must not be zero",
    ),
    "polytope with a row forgotten": (
        {"obstacles[0]": {**WALL, "unbounded": False}},
        "obstacles[0].normals",
        "must bound the set",
    ),
    "polytope with an offset too few": (
        {"obstacles[0]": {**WALL, "normals": [[0, -1, 0], [1, 0, 0]]}},
        "obstacles[0].offsets_m",
        "must have 2",
    ),
    "cone without an axis": (
        {"keep_in": [{**CONE, "axis": [0, 0, 0]}]},
        "keep_in[0].axis",
        "must not be zero",
    ),
    "cone of a half plane": (
        {"keep_in": [{**CONE, "half_angle_deg": 90}]},
        "keep_in[0].half_angle_deg",
        "<= 89",
    ),
    "two of one name": ({"obstacles": [BALL, BALL]}, "obstacles[1].name", "must be unique"),
    "keep-in set with an obstacle's name": (
        {"keep_in": [{**CONE, "name": "debris"}]},
        "keep_in[0].name",
        "must be unique",
    ),
    "obstacles in a table": ({"obstacles": {"kind": "ball"}}, "obstacles", "must be a list"),
    "sixty-five obstacles": (
        {"obstacles": [{**BALL, "name": f"rock{i}"} for i in range(65)]},
        "obstacles",
        "at most 64",
    ),
    "no experimental controller": ({"experimental": []}, "experimental", "at least 1"),
    "controller with R only": ({"experimental[0].Q": None}, "experimental[0].Q", "must be given"),
    "controller with gain and Q": (
        {"experimental[0].gain": [[0.0] * 6] * 3},
        "experimental[0].gain",
        "not both",
    ),
    "gain turned": (
        {"experimental[0]": {"kind": "affine", "name": "u", "gain": [[0.0] * 3] * 6}},
        "experimental[0].gain",
        "3 x 6",
    ),
    "controller called safety": ({"experimental[0].name": "safety"}, "experimental[0].name", "must not be"),
    "reference unknown": (
        {"experimental[0].reference.kind": "fast"},
        "experimental[0].reference.kind",
        "'shared'",
    ),
    "setpoint of three numbers": (
        {"experimental[0].reference": {"kind": "setpoint", "state": [0, 0, 0]}},
        "experimental[0].reference.state",
        "must have 6",
    ),
    "any thrust with a gain": (
        {"experimental[0]": {"kind": "any_thrust", "name": "u", "gain": [[1.0]]}},
        "experimental[0].gain",
        "unknown key",
    ),
    "dwell longer than the horizon": (
        {"schedule.min_dwell_steps": 61},
        "schedule.min_dwell_steps",
        "at most",
    ),
    "dwell of half a step": ({"schedule.min_dwell_steps": 0.5}, "schedule.min_dwell_steps", "whole number"),
    "no runs": ({"simulation.runs": 0}, "simulation.runs", ">= 1"),
    "seed negative": ({"simulation.seed": -1}, "simulation.seed", ">= 0"),
    "seed too large": ({"simulation.seed": 2**64}, "simulation.seed", "<= 9"),
    "date as a number": (
        {"horizon.step_s": tomllib.loads("d = 2024-01-01")["d"]},
        "horizon.step_s",
        "a number",
    ),
}

# The same for `data/floor.toml`, a system given by its matrices.
BROKEN_LINEAR = {
    "A not square": ({"system.A": [[0, 1, 0, 0]] * 3}, "system.A", "square"),
    "A ragged": ({"system.A": [[0, 1], [0]]}, "system.A", "equal length"),
    "A with infinity": ({"system.A": [[0, INF], [0, 0]]}, "system.A[0][1]", "finite"),
    "A empty": ({"system.A": []}, "system.A", "at least 1"),
    "B of three rows": ({"system.B": [[0, 0], [0, 0], [1, 0]]}, "system.B", "4 rows"),
    "D of three rows": ({"system.D": [[0, 0], [0, 0], [1, 0]]}, "system.D", "4 rows"),
    "an axis without thrust": (
        {"system.B": [[0, 0], [0, 0], [1, 0], [0, 0]]},
        "system.B",
        "not stabilisable",
    ),
    "an unstable mode out of reach": (
        {
            "system.A": [[0, 0, 1, 0], [0, 0.1, 0, 0], [0, 0, 0, 0], [0, 0, 0, -1]],
            "system.B": [[0, 0], [0, 0], [1, 0], [0, 1]],
        },
        "system.B",
        "not stabilisable: eigenvalue 0.1",
    ),
    "a step too long for the dynamics": (
        {"system.A": [[0, 0, 1, 0], [0, 0, 0, 1], [0, 0, 500, 0], [0, 0, 0, 500]]},
        "horizon.step_s",
        "for the fastest mode",
    ),
    "limits of three inputs": ({"system.input_max": [1, 1, 1]}, "system.input_max", "must have 2"),
    "position from state 4": ({"system.position_states": [0, 4]}, "system.position_states", "below 4"),
    "position twice the same": ({"system.position_states": [1, 1]}, "system.position_states", "different"),
    "position of four": ({"system.position_states": [0, 1, 2, 3]}, "system.position_states", "at most 3"),
    "position by two means": ({"system.C": [[1, 0, 0, 0]]}, "system.C", "left out with position_states"),
    "C too narrow": ({"system.position_states": None, "system.C": [[1, 0]]}, "system.C", "4 numbers"),
    "C of one direction twice": (
        {"system.position_states": None, "system.C": [[1, 0, 0, 0], [2, 0, 0, 0]]},
        "system.C",
        "independent",
    ),
    "generator of two numbers": (
        {"initial_set.generators": [[1, 0]]},
        "initial_set.generators[0]",
        "must have 4",
    ),
    "generator into the pillar": (
        {"initial_set.generators": [[3.5, 2.5, 0, 0]]},
        "initial_set.generators",
        "reaches",
    ),
    "ball where position is a sum of states": (
        {
            "system.position_states": None,
            "system.C": [[1, 1, 0, 0], [0, 1, 0, 0]],
            "initial_set": {
                "kind": "ball",
                "center": [0] * 4,
                "position_radius_m": 1,
                "velocity_radius_m_s": 1,
            },
        },
        "initial_set.kind",
        "choice of states",
    ),
    "an ellipse on the floor": (
        {"goal": {"kind": "elliptical_nmt", "inner_semi_minor_m": 1, "outer_semi_minor_m": 2}},
        "goal.kind",
        "Hill's frame",
    ),
    "an NMT to follow on the floor": (
        {"experimental[0].reference": {"kind": "nmt", "semi_minor_m": 1}},
        "experimental[0].reference.kind",
        "Hill's frame",
    ),
    "a cone on a line": (
        {
            "system": LINEAR,
            "initial_set": {"kind": "box", "center": [0, 0], "half_widths": [1, 1]},
            "tracking": {"Q": [1, 1], "R": [1]},
            "goal": {"kind": "stationary", "state": [5, 0]},
            "obstacles": [],
            "keep_in": [{"kind": "cone", "name": "c", "apex_m": [-9], "axis": [1], "half_angle_deg": 5}],
            "experimental": [{"kind": "any_thrust", "name": "u"}],
        },
        "keep_in[0].apex_m",
        "2 or 3 axes",
    ),
}


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


def check(name, changes, field, rule):
    error = refused(broken(name, changes))
    assert error.field == field, str(error)
    assert any(piece in error.rule for piece in rule.split("|")), str(error)


@pytest.mark.parametrize("case", BROKEN)
def test_broken(case):
    check("space", *BROKEN[case])


@pytest.mark.parametrize("case", BROKEN_LINEAR)
def test_broken_linear(case):
    check("floor", *BROKEN_LINEAR[case])


def test_there_are_enough():
    assert len(BROKEN) + len(BROKEN_LINEAR) >= 45


def test_several_mistakes_are_counted():
    error = refused(broken("space", {"system.mass_kg": -1, "goal.sides": 1, "name": ""}))
    assert "and 2 more to correct: " in str(error)


def test_value_is_shown_and_cut():
    error = refused(broken("space", {"system.kind": "x" * 10_000}))
    assert "'xxxx" in str(error) and len(str(error)) < 300


# -- files ------------------------------------------------------------------------------------------


def refused_file(path):
    with pytest.raises(ScenarioError) as caught:
        load_scenario(path)
    text = str(caught.value)
    assert "\n" not in text and text.isprintable() and len(text) < 600, text
    return text


FILES = {
    "binary garbage": (bytes(range(256)) * 20, "UTF-8"),
    "zeros": (bytes(1000), "TOML"),
    "empty": (b"", "must not be empty"),
    "blank": (b" \n\t\n", "must not be empty"),
    "only a comment": (b"# nothing\n", "is required"),
    "huge": (b"#" * (MAX_BYTES + 1), "at most"),
    "not TOML": (b"name: static\n", "line 1"),
    "JSON": (b'{"schema_version": 1}', "TOML"),
    "bracket left open": (b"[system\nmass_kg = 1\n", "line 1"),
    "same key twice": (b"name = 'a'\nname = 'b'\n", "line 2"),
    "deeply nested": (b"a = " + b"[" * 200_000, "TOML"),
    "nested and closed": (b"name = " + b"[" * 300 + b"]" * 300, "name"),
    "number of 5000 digits": (b"x = " + b"9" * 5000, "TOML"),
    "hexadecimal number of 5000 digits": (b"schema_version = 0x" + b"f" * 5000, "schema_version"),
    "impossible date": (b"x = 2024-02-31\n", "TOML"),
    "text of UTF-16": ("name = 'static'".encode("utf-16"), "UTF-8"),
    "escape codes in a key": (b'"\\u001b[31m" = 1\n', "unknown key"),
}


@pytest.mark.parametrize("case", FILES)
def test_broken_file(case, tmp_path):
    data, rule = FILES[case]
    file = tmp_path / "broken.toml"
    file.write_bytes(data)
    text = refused_file(file)
    assert rule in text and "broken.toml" in text, text


def test_missing_file(tmp_path):
    assert "there is no such file" in refused_file(tmp_path / "nowhere.toml")


def test_directory(tmp_path):
    assert "directory" in refused_file(tmp_path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe.toml")
    assert "regular file" in refused_file(tmp_path / "pipe.toml")


def test_unreadable_file(tmp_path):
    file = tmp_path / "secret.toml"
    file.write_text("name = 'x'")
    file.chmod(0)
    if os.access(file, os.R_OK):
        pytest.skip("this user reads every file")
    assert "cannot be read" in refused_file(file)


@pytest.mark.parametrize("name", ["a" * 5000, "a\x00b", "", "no\nsuch", "."])
def test_odd_paths(name):
    refused_file(name)


def test_misspelt_name_is_answered_with_the_right_one():
    text = refused_file("statik")
    assert "did you mean static?" in text and "keep_out" in text


# -- lengths ----------------------------------------------------------------------------------------


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


# -- anything at all --------------------------------------------------------------------------------

LEAVES = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5)
ANYTHING = st.recursive(
    LEAVES,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
)
PLACES = (
    "system",
    "system.A",
    "initial_set",
    "initial_set.center",
    "tracking.Q",
    "obstacles",
    "goal",
    "experimental",
)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.sampled_from(PLACES), ANYTHING)
def test_anything_in_any_place_is_refused_in_one_line(place, value):
    data = document("floor")
    table, _, field = place.rpartition(".")
    (data[table] if table else data)[field] = value
    refused(data)
