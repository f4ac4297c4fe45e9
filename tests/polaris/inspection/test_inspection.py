"""Refused values, and that the message says why; names of rows; premises of conditions."""

from dataclasses import replace

import numpy as np
import pytest

from polaris.inspection.constraints.families import Families
from polaris.inspection.constraints.strengthening import FAMILIES, PRESETS, Strengthening
from polaris.inspection.filters.explicit import Decentralized
from polaris.inspection.inspection import Inspection
from polaris.inspection.vectors import CENTRE
from polaris.model.errors import ScenarioError

Q = Inspection()

NUMBERS = "mass mean_motion deputy_radius chief_radius docking_speed speed_slope delta_v_max field_of_view"
NUMBERS += " distance_max passive_time speed_max thrust_max smoothing"


def refused(field, **values):
    with pytest.raises(ScenarioError) as caught:
        Inspection(**values)
    assert caught.value.field == field
    return str(caught.value)


def test_defaults_are_table_1():
    assert (Q.mass, Q.mean_motion, Q.deputy_radius, Q.chief_radius) == (12.0, 0.001027, 5.0, 5.0)
    assert (Q.docking_speed, Q.delta_v_max, Q.distance_max, Q.passive_time) == (0.2, 20.0, 1000.0, 500.0)
    assert (Q.speed_max, Q.thrust_max, Q.nu_1) == (1.0, 1.0, 2 * Q.mean_motion)
    assert Q.field_of_view == pytest.approx(np.radians(60))
    assert Q.a_max == pytest.approx(1 / 12 - 3 * 0.001027**2 * 1000 - 2 * 0.001027)
    assert replace(Q, thrust_max=0.5).a_max == pytest.approx(Q.a_max - 0.5 / 12)  # it follows the thrust


@pytest.mark.parametrize("field", NUMBERS.split())
@pytest.mark.parametrize("value", [np.nan, np.inf, -1.0, 0.0, "one", None])
def test_numbers_must_be_positive(field, value):
    if field != "speed_slope" or value is not None:  # the default, 2 n
        refused(field, **{field: value})


@pytest.mark.parametrize(
    ("words", "changed"),
    [
        *(("must be", {"deputies": count}) for count in (0, -1, 51, 2.0, np.nan, True, "3", None)),
        ("< 180 [deg]", {"field_of_view": np.pi}),
        ("collision radii", {"distance_max": 10.0}),
        ("half an orbit", {"passive_time": np.pi / Q.mean_motion + 1}),
        ("eq. 36", {"thrust_max": 1.0, "distance_max": 60.0, "speed_max": 3.0, "docking_speed": 3.0}),
        ("eq. 36", {"thrust_max": 1.0, "distance_max": 60.0, "smoothing": 60.0}),
        ("apart", {"deputy_radius": 0.4 * CENTRE, "chief_radius": 1.0}),
        ("apart", {"deputy_radius": CENTRE / 2}),
        ("wider", {"field_of_view": 0.01}),
    ],
)
def test_values_that_leave_no_room_are_refused(words, changed):
    """Within `CENTRE` directions fade: a smaller sphere or a thinner cone would go unprotected."""
    assert words in refused(next(iter(changed)), **changed)


def test_the_thinnest_cone_that_is_allowed_holds_its_axis():
    families = Families(Inspection(deputies=1, field_of_view=2.001 * np.arcsin(CENTRE / 10)))
    x = np.array([[[-10.5, 0, 0, 0, 0, 0]]])
    assert families(x, np.zeros(1)).h[0, families.labels.index("h4[0]")] < 0


NATURAL = 3 * Q.mean_motion**2
WEAK = {"speed_slope": 1e-4, "docking_speed": 1.7}
TURN, SLOPE = NATURAL * 1000 + 2 * Q.mean_motion, 2 * Q.mean_motion
STOP = SLOPE * np.sqrt(3) + NATURAL * (np.sqrt(3) - 0.2) / SLOPE + SLOPE


@pytest.mark.parametrize(
    ("equation", "needed", "values"), [("eq. 28", TURN, WEAK), ("eq. 32", STOP, {}), ("eq. 37", TURN, WEAK)]
)
def test_weak_thrust_names_the_equation(equation, needed, values):
    enough = needed * Q.mass
    assert equation in refused("thrust_max", thrust_max=enough * 0.999, **values)
    try:
        Inspection(thrust_max=enough * 1.001, **values)
    except ScenarioError as error:
        assert equation not in str(error)  # too weak for others, which are named


def test_the_thrust_asked_for_is_enough():
    message = refused("thrust_max", thrust_max=0.001)
    assert all(word in message for word in ("eq. 28", "eq. 32", "radial", "along-track", "cross-track"))
    least = float(message.split("must exceed ")[1].split(" N")[0])
    Inspection(thrust_max=least * 1.001)
    refused("thrust_max", thrust_max=least * 0.999)


def test_acceleration_inside_the_keep_in_sphere_leaves_room_for_the_turn():
    fastest = np.sqrt(3) * Q.speed_max
    assert Q.a_max / 2 <= Q.a_inside < Q.a_max - fastest**2 / Q.distance_max
    # Where the speed limit allows no fast turn, little is lost.
    slow = Inspection(docking_speed=0.01, speed_slope=0.001, distance_max=500.0, speed_max=0.2, deputies=1)
    assert slow.a_inside == pytest.approx(slow.a_max, rel=0.01)


COEFFICIENTS = [(0.0, 0.0, 0.0), (-1.0, 0.0, 1.0), (np.nan, 0.0, 1.0), (np.inf, 0.0, 0.0), (1.0, 0.0)]
COEFFICIENTS += [(1.0, 0.0, 0.0, 1.0), (), None, 1.0, "abc", (None, 0.0, 1.0), ("1", 0.0, 1.0)]
LEAST = {"bias": 0.0, "recovery": 1.0, "push": 0.0}


@pytest.mark.parametrize("field", ["coefficients", *LEAST])
def test_bad_strengthening_is_refused(field):
    for value in [LEAST[field] - 1e-9, np.nan, np.inf, "x", None] if field in LEAST else COEFFICIENTS:
        with pytest.raises(ScenarioError, match=f"^{field}"):
            Strengthening(**{"coefficients": (1.0, 0.0, 0.0), field: value})


def test_presets_are_the_published_numbers_of_each_code():
    """Coefficients of h and h^3, and the bias, as their library has them; below zero 10 alpha - 0.01."""
    far, velocity = ((0.01, 0.001), 0.0), ((0.1, 0.01), 1e-3)
    shared = dict.fromkeys(("chief_separation", "deputy_separation", "passive", "deputy_passive"), far)
    shared |= {"sun": ((0.001, 0.0001), 1e-3), "deputy_sun": ((0.0, 0.1), 1e-3), "velocity": velocity}
    zone, speed = ((0.01, 0.001), 1e-3), ((0.0, 0.1), 2e-3)
    published = {
        "afrl-one": {**shared, "keep_in": zone, "speed": ((0.05, 0.005), 1e-3)},
        "afrl-five": {**shared, "keep_in": far, "speed": speed},
        "afrl": {**shared, "keep_in": zone, "speed": speed},
    }
    for name, of_each in published.items():
        for family, ((c1, c3), bias) in of_each.items():
            assert PRESETS[name][family].numbers == (c1, 0.0, c3, bias, 10.0, 0.01), (name, family)


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("rate", [1e-6, 0.01, 1.0, 50.0])
def test_where_alpha_reaches_a_rate(family, rate):
    alpha = PRESETS["afrl"][family]
    at = alpha.reaches(rate)
    assert alpha(at) >= rate and alpha(at - 1e-6 * (1 + at)) < rate * (1 + 1e-9)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Families(Q, "nasa"), "strengthening.*afrl"),
        (lambda: Families(Q, without=("sunshine",)), "without.*chief_separation"),
        (lambda: Families(Q, without=FAMILIES), "must leave a constraint"),
        (lambda: Families(Q, {name: PRESETS["afrl"][name] for name in FAMILIES[1:]}), "is missing"),
        (lambda: Decentralized(Families(Q), "alone"), "sharing.*consensus"),
    ],
)
def test_unknown_names(make, words):
    with pytest.raises(ScenarioError, match=words):
        make()


@pytest.mark.parametrize("N", [1, 2, 5])
def test_rows_and_labels(N):
    families = Families(Inspection(deputies=N))
    pairs = N * (N - 1) // 2
    assert len(families.labels) == len(set(families.labels)) == 8 * N + 4 * pairs
    for label, family, first, second in zip(
        families.labels, families.family, families.first, families.second, strict=True
    ):
        assert label.endswith(f"[{first},{second}]" if second >= 0 else f"[{first}]")
        assert (second >= 0) == family.startswith("deputy_")
    kinds = {label.split("[")[0] for label in families.labels}
    expected = {"h1", "h3", "h4", "h6", "h7", "h9", "h10", "h11"}
    assert kinds == expected | ({"h2", "h5+", "h5-", "h8"} if N > 1 else set())


@pytest.mark.parametrize("left_out", FAMILIES)
def test_families_can_be_left_out(left_out):
    q = Inspection(deputies=3)
    full, reduced = Families(q), Families(q, without=(left_out,))
    rows_kept = [k for k, family in enumerate(full.family) if family != left_out]
    assert [full.labels[k] for k in rows_kept] == list(reduced.labels)
    x = np.random.default_rng(0).uniform(-100, 100, (2, 3, 6)) * [1, 1, 1, 0.003, 0.003, 0.003]
    all_rows, rows = full(x, np.zeros(2)), reduced(x, np.zeros(2))
    np.testing.assert_allclose(rows.h, all_rows.h[:, rows_kept], rtol=1e-9)
    np.testing.assert_allclose(rows.bound, all_rows.bound[:, rows_kept], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("duration", [np.nan, "x", None, np.inf])
def test_held_refuses_what_is_no_time(duration):
    with pytest.raises(ScenarioError, match="duration"):
        Q.discretize(duration)
