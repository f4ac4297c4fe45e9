"""Scenario files: loading, overriding, and the objects built from them."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from polaris.model.errors import ScenarioError
from polaris.scenario.reading import parse_toml, write_toml
from polaris.scenario.scenario import Scenario, bundled_scenarios, load_scenario, scenario_folder
from polaris.scenario.tables.fields import whole_parts

DATA = Path(__file__).parents[1] / "data"
SPACE, FLOOR = DATA / "space.toml", DATA / "floor.toml"
NAMES = ("cubesat", "dynamic", "hold_point", "infeasible", "keep_out", "robot", "static")


@pytest.mark.parametrize("name", NAMES)
def test_bundled_scenario_builds_all_its_objects(name):
    assert bundled_scenarios() == NAMES
    scenario = load_scenario(name)
    system, theta = scenario.system(), scenario.initial_set()
    assert scenario.name == name
    assert theta.c.shape == (system.n,) and theta.G.shape[0] == system.n
    assert len(scenario.obstacles()) == len(scenario.model.obstacles) + len(scenario.model.keep_in)
    assert scenario.goal().n == system.n
    tracking = scenario.problem()
    assert tracking.Q.shape == (system.n, system.n) and tracking.R.shape == (system.m, system.m)
    assert scenario.steps * scenario.step == pytest.approx(scenario.model.horizon.duration_s)
    assert scenario.model.experimental
    assert scenario.text == (scenario_folder() / f"{name}.toml").read_text(encoding="utf-8")
    assert scenario.text.startswith("#:schema ") and scenario.text.count("#") >= 6
    assert Scenario.from_dict(tomllib.loads(scenario.to_toml())).model == scenario.model


def test_windows_text_is_read(tmp_path):
    text = (scenario_folder() / "static.toml").read_text(encoding="utf-8").replace("\n", "\r\n")
    file = tmp_path / "a scenario.toml"
    file.write_bytes(b"\xef\xbb\xbf" + text.encode())
    # The description spans lines; TOML reads both line ends as one.
    assert load_scenario(file).model == load_scenario("static").model


@pytest.mark.parametrize(
    ("assignment", "read"),
    [
        ("planner.solver=gurobi", lambda m: m.planner.solver == "gurobi"),
        ('planner.solver="gurobi"', lambda m: m.planner.solver == "gurobi"),
        ("planner.extra_margin_m=7", lambda m: m.planner.extra_margin_m == 7.0),
        ("obstacles[0].half_widths_m=[1, 2, 3]", lambda m: m.obstacles[0].half_widths_m == (1.0, 2.0, 3.0)),
        ("obstacles[0].center_m[1]=260", lambda m: m.obstacles[0].center_m == (125.0, 260.0, 0.0)),
        ("obstacles.0.center_m.1=260", lambda m: m.obstacles[0].center_m == (125.0, 260.0, 0.0)),
        (" recoverable.kind = ball ", lambda m: m.recoverable.kind == "ball"),
        ("feedback={ period_s = 2 }", lambda m: getattr(m.feedback, "period_s", None) == 2.0),
        ("schedule.max_switches=4", lambda m: m.schedule.max_switches == 4),
        ("title=a = b", lambda m: m.title == "a = b"),
    ],
)
def test_assignment(assignment, read):
    scenario = load_scenario(SPACE)
    changed = scenario.with_assignments([assignment])
    assert read(changed.model)
    assert not read(scenario.model), "the original must not change"
    assert changed.text is None


def test_several_overrides_are_checked_together():
    # Neither alone is valid: 2400 is no multiple of 36, nor is 1800 a multiple of 48.
    changed = load_scenario(SPACE).with_overrides({"horizon.duration_s": 2400, "horizon.step_s": 48})
    assert changed.steps == 50
    with pytest.raises(ScenarioError, match="must divide"):
        load_scenario(SPACE).set("horizon.step_s", 48)


@pytest.mark.parametrize(
    ("key", "field"),
    [
        ("planner.solvr", "planner.solvr"),
        ("obstacles[3].name", "obstacles[3]"),
        ("name.first", "name.first"),
        ("obstacles.name", "obstacles.name"),
        ("a b", "--set"),
        ("", "--set"),
        ("planner..solver", "--set"),
    ],
)
def test_override_of_no_such_key(key, field):
    with pytest.raises(ScenarioError) as caught:
        load_scenario(SPACE).set(key, "x")
    assert caught.value.field == field


@pytest.mark.parametrize("text", ["planner", "=", "=3", "", "name=x\nfoo = 1"])
def test_assignment_that_is_none(text):
    with pytest.raises(ScenarioError, match=r"^[^\n]*$"):
        load_scenario(SPACE).with_assignments([text])


def test_ball_contains_its_corners_and_keeps_units_apart():
    scenario = load_scenario(DATA / "ball.toml")
    theta = scenario.initial_set()
    rng = np.random.default_rng(0)
    rays = rng.normal(size=(200, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    points = theta.c + np.hstack([3.0 * rays, 0.01 * rays[::-1]])
    assert theta.contains(points).all()
    assert np.all(theta.half_widths[:3] < 3.0 * 1.15) and np.all(theta.half_widths[3:] < 0.01 * 1.15)


def test_generators_are_rows_in_the_file_and_columns_in_the_set():
    theta = load_scenario(FLOOR).initial_set()
    assert theta.G[:, 1].tolist() == [0.035, -0.035, 0.0, 0.0]


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 100_000), st.floats(1e-3, 1e3))
def test_whole_parts_sees_through_rounding(count, part):
    assert whole_parts(count * part, part) == count
    for total, other in ((10.0, 3.0), (1.0, 0.3), (1.0, 2.0), (1e300, 1e-300)):
        assert not whole_parts(total, other)


toml_values = st.recursive(
    st.integers(-(10**9), 10**9) | st.floats(allow_nan=False) | st.text(max_size=20) | st.booleans(),
    lambda inner: st.lists(inner, max_size=3),
    max_leaves=5,
)


@settings(max_examples=100, deadline=None)
@given(st.dictionaries(st.sampled_from(["a", "b1", "c_d"]), toml_values, max_size=3))
def test_toml_writer_and_reader_agree(table):
    document = {"top": 1, "table": table, "many": [table, {"inner": table}]}
    assert parse_toml(write_toml(document), "x") == document
