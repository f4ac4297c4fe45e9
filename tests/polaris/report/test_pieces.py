"""Numbers, surfaces and tables that reports are made of."""

import json
from html.parser import HTMLParser

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from markupsafe import escape

from polaris.model.hill import clohessy_wiltshire
from polaris.model.scene.keep_in import KeepInCone, KeepInPolytope
from polaris.model.scene.obstacles import BallObstacle, perceive
from polaris.report.html.page import script_json, table
from polaris.report.html.scene import plain
from polaris.report.html.timelines import MOST, drawn_samples
from polaris.report.scene.geometry import boxed, cut_surface, hull, polyhedron
from polaris.report.sentences import limit_words, set_of_limit, side_words
from polaris.report.tables import Cell, Measure, Table, value_cell, words

CUBE = np.vstack([np.eye(3), -np.eye(3)])


def test_what_is_not_finite_becomes_null():
    assert plain([[1.0, np.nan], [np.inf, -2.5]]) == [[1, None], [None, -2.5]]
    assert plain(np.float64("inf")) is None and plain(np.array([True, False])) == [True, False]


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False, width=64), min_size=1))
def test_numbers_keep_six_digits(values):
    assert np.allclose(plain(values), values, rtol=5e-6, atol=0.0)


@given(st.text())
@example("</script>&\"'")
def test_no_text_leaves_its_script_or_its_attribute(text):
    inert = script_json({"text": text})
    assert not set("<>&") & set(inert) and json.loads(inert)["text"] == text
    assert not set("<>\"'") & set(escape(text))


@pytest.mark.parametrize(
    ("value", "key", "told"),
    [
        (None, "", "none"),
        (None, "min_ttc_s", "∞"),
        (None, "min_distance_m", "none"),
        (float("inf"), "", "∞"),
        (float("-inf"), "", "−∞"),
        (float("nan"), "", "none"),
        (1.23456, "", "1.235"),
        (3.8e-16, "", "0"),
        (123456.7, "", "123457"),
        (4.2e-6, "", "4.2e-06"),
        ({"sign_changes": 0.16533333, "by axis": {"x": 1.0}}, "", "sign changes 0.1653, by axis x 1"),
        (100, "", "100"),
        (True, "", "yes"),
        ("<b>", "", "<b>"),
        ([1.0, None], "", "1, "),
    ],
)
def test_values_in_words(value, key, told):
    cell = value_cell(value, key)
    assert told in cell.text
    assert not any(raw in cell.text.lower() for raw in ("nan", "null", "inf"))
    assert bool(cell.reason) == (told in ("none", "∞", "−∞"))


def test_means_have_their_bounds_and_collisions_stand_out():
    distance = Measure.from_key("min_distance_m")
    cell = distance.cell({"mean": 1.0, "low": 0.5, "high": 1.5, "worst": -0.25}, unit=False)
    assert cell.sort == 1.0 and cell.alarm and cell.lines == ("0.5 to 1.5", "worst -0.25")
    assert not distance.cell({"mean": -1.0, "low": -2.0, "high": 0.0}, difference=True).alarm
    assert not distance.cell(None).alarm and distance.cell(None).sort is None
    assert Measure.from_key("collided").cell(True).alarm
    assert not Measure.from_key("collided_runs").cell(0).alarm


@pytest.mark.parametrize(
    ("key", "bounds", "difference", "told"),
    [
        ("experimental_share", (-0.2, 1.07), False, "0.0 to 100.0"),
        ("experimental_share", (-1.2, 1.07), True, "-100.0 to 100.0"),
        ("min_ttc_s", (-3.0, 7.0), False, "0 to 7"),
        ("min_ttc_s", (-3.0, 7.0), True, "-3 to 7"),
        ("switches", (-1.0, 4.0), False, "0 to 4"),
        ("min_distance_m", (-1.0, 4.0), False, "-1 to 4"),  # a penetration
    ],
)
def test_no_bound_lies_where_no_value_can(key, bounds, difference, told):
    low, high = bounds
    cell = Measure.from_key(key).cell({"mean": 0.5, "low": low, "high": high}, difference=difference)
    assert cell.lines == (told,)


class Tags(HTMLParser):
    """Every start tag, and the texts."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.texts = [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data):
        self.texts.append(data)


def test_table_has_heads_scopes_and_inert_texts():
    evil = '"><img src=x onerror=alert(1)>'
    tags = Tags(
        table(Table(evil, [evil, "b"], [[Cell(evil), words(evil)], [Cell("x"), value_cell(2.5)]], True))
    )
    assert not [tag for tag, _ in tags.tags if tag == "img"]
    assert tags.texts.count(evil) == 4  # caption, head, two cells
    assert [attrs["scope"] for tag, attrs in tags.tags if tag == "th"] == ["col", "col", "row", "row"]
    assert [attrs["data-sort"] for tag, attrs in tags.tags if tag == "td"] == [evil, "2.5"]


def test_thinning_keeps_ends_changes_and_what_must_be():
    modes = np.zeros((2, 9999), dtype=int)
    modes[1, 4321:] = 1
    chosen = drawn_samples(10_000, modes, [1234])
    assert {0, 4321, 1234, 9999} <= set(chosen.tolist()) and MOST <= len(chosen) <= MOST + 2
    assert len(drawn_samples(10_000, np.arange(9999) % 2)) <= 2 * MOST + 1
    assert drawn_samples(5).tolist() == [0, 1, 2, 3, 4]


def volume(surface):
    """By cones from the middle: the surface is closed and convex."""
    a, b, c = np.moveaxis(surface.points[surface.faces] - surface.points.mean(axis=0), 1, 0)
    return float(np.abs(np.einsum("ij,ij->i", a, np.cross(b, c))).sum() / 6)


@given(
    st.lists(st.floats(0.1, 50), min_size=6, max_size=6),
    st.lists(st.floats(-100, 100), min_size=3, max_size=3),
)
def test_polyhedron_has_the_volume_of_its_box(half, centre):
    support = CUBE @ np.array(centre) + np.array(half)
    surface = polyhedron(CUBE, support, np.array(centre))
    sizes = np.array(half[:3]) + np.array(half[3:])
    assert volume(surface) == pytest.approx(float(np.prod(sizes)), rel=1e-6)
    assert np.all(surface.points @ CUBE.T <= support + 1e-6)


def test_sets_without_volume_have_no_surface():
    assert hull(np.zeros((8, 3))) is None and hull(np.eye(3)) is None
    assert polyhedron(CUBE, np.array([1.0, 1, 0, 1, 1, 0]), np.zeros(3)) is None


def test_cone_is_cut_to_the_scene_and_stays_open():
    H = np.array([[-1.0, 1, 0], [-1.0, -1, 0], [-1.0, 0, 1], [-1.0, 0, -1]]) / np.sqrt(2)
    low, high = np.array([-1.0, -20, -20]), np.array([10.0, 20, 20])
    opened = cut_surface(H, np.zeros(4), low, high)
    assert np.allclose(opened.points.max(axis=0), [10, 10, 10]) and len(opened.faces) == 4
    assert cut_surface(H, np.zeros(4), high + 90 * np.array([0, 1, 1]), high + 100) is None


def test_outline_is_cut_in_the_plane():
    wall = boxed(np.array([[0.0, -1.0]]), np.array([-7.0]), np.zeros(2), np.array([5.0, 9.0])).vertices()
    assert sorted(map(tuple, wall.round(9).tolist())) == [(0, 7), (0, 9), (5, 7), (5, 9)]
    assert boxed(np.array([[0.0, -1.0]]), np.array([-70.0]), np.zeros(2), np.ones(2)).depth < 0


def test_sides_of_keep_in_sets_have_numbers_from_one_and_axes_where_they_have_one():
    box = KeepInPolytope("within-0", CUBE, np.full(6, 9.0))
    cone = KeepInCone("sight", [0.0, -9, 0], [0.0, 1, 0], 0.5, facets=5)
    system = clohessy_wiltshire(0.0011, 10.0, 0.1)
    unsafe = perceive([box, cone, BallObstacle("ball", [0.0, 5, 0], 1.0)], system, 10.0, 2)
    words = side_words(unsafe, system)
    axes = ("+radial", "+along-track", "+cross-track", "-radial", "-along-track", "-cross-track")
    assert [words[f"within-0[{i}]"] for i in range(6)] == [
        f"within-0, side {i + 1} of 6 ({axis})" for i, axis in enumerate(axes)
    ]
    assert words["sight[4]"] == "sight, side 5 of 5" and words["ball"] == "ball"
    for i, one in enumerate(unsafe[:6]):  # the middle of a side is on the boundary of its unsafe half
        assert one.normals[0] @ (9.0 * CUBE[i]) == pytest.approx(one.offsets[0, 0, 0])
    assert limit_words("sight[4]") == "sight, side 5" and limit_words("radial thrust") == "radial thrust"
    assert set_of_limit("sight[4]") == "sight" and set_of_limit("input 0") == "input 0"
