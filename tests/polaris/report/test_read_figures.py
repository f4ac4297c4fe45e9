"""Figures can be read: names apart and whole, all that is drawn explained, no set cut without a mark."""

import itertools
import re
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from matplotlib.text import Text

from polaris.model.scene.keep_in import KeepInPolytope
from polaris.report.figures import FIGURES
from polaris.report.figures.labels import name as write_name
from polaris.report.figures.style import DASHES, new_figure, style
from polaris.report.scene.items import alone, closeups
from polaris.report.scene.palette import BLACK, RED, mode_colour
from polaris.runs.build_plot_data import schedule_plot_data
from polaris.runs.plot_data import SliceData, directions
from polaris.simulation.baselines import FlightEnvelope
from tests.kept import scheduled
from tests.polaris.report.test_figures import over, random_picture
from tests.polaris.tiny import flown, synthesised
from tests.sizes import fewer

MANY = [0, *(pytest.param(i, marks=pytest.mark.slow) for i in range(1, fewer(90, 24)))]


def crowded(seed):
    """A random scene that is handed over many times within one size of its recoverable sets."""
    picture = random_picture(seed)
    delta, d, rng = picture.reference.delta, picture.system.d, np.random.default_rng(seed)
    path = picture.reference.chi @ picture.system.position.T
    size = 0.2 * float(np.ptp(path, axis=0).max())
    flat = picture.frame.flat
    shape = directions(12) if d > 1 else np.array([[-1.0], [1.0]])
    outlines = path[:, None, flat] + size * rng.uniform(0.5, 1.5, (len(path), 1, 1)) * shape
    modes = np.array([0, 1, 0, 2, 2, 0, 1, 1, 0, 1, 0, 0])[: len(picture.modes)]
    slices = SliceData(np.arange(len(path)) * delta, path[:, None], outlines[:, None])
    return replace(picture, slices=slices, modes=modes)


def tiny():
    """The small scene of the tests as it was flown."""
    flights = {key: item.flights for key, item in flown().items()}
    return replace(schedule_plot_data(synthesised()[1]), flights=flights)


def draw(picture, name="scene"):
    """A figure as it is saved."""
    with style():
        figure = FIGURES[name](picture)
        figure.set_dpi(150)
        figure.draw_without_rendering()
    return figure


def texts_of(figure):
    """All texts that are seen, with their extents."""
    renderer = figure._get_renderer()
    hidden = {text for ax in figure.axes for text in ax.texts if not text.get_visible()}
    texts = [one for one in figure.findobj(Text) if one.get_text().strip() and one.get_visible()]
    for ax in figure.axes:
        for axis in ax._axis_map.values():
            low, high = sorted(axis.get_view_interval())
            ticks = [*axis.get_major_ticks(), *axis.get_minor_ticks()]
            hidden |= {
                text
                for tick in ticks
                for text in (tick.label1, tick.label2)
                if not low <= tick.get_loc() <= high or not tick.get_visible()
            }
        hidden |= set() if ax.axison else set(ax.findobj(Text))
    return [(one, one.get_window_extent(renderer)) for one in texts if one not in hidden]


def assert_texts_are_apart(figure):
    """No text lies on another, and all are within the figure; the ones that are turned lie along paths."""
    texts, slack = texts_of(figure), 1.0
    for one, box in texts:
        assert box.x0 >= -slack and box.y0 >= -slack, one
        assert box.x1 <= figure.bbox.x1 + slack and box.y1 <= figure.bbox.y1 + slack, one
    for (one, a), (other, b) in itertools.combinations(texts, 2):
        wide, high = min(a.x1, b.x1) - max(a.x0, b.x0), min(a.y1, b.y1) - max(a.y0, b.y0)
        rotated = one.get_rotation() % 90 or other.get_rotation() % 90
        assert min(wide, high) <= slack or rotated, (one, other)


@pytest.mark.parametrize("seed", MANY)
def test_random_scenes_can_be_read(seed):
    picture = crowded(seed)
    assert len(picture.hand_overs) >= 5
    assert_texts_are_apart(draw(picture))


@pytest.mark.parametrize("name", FIGURES)
def test_the_small_scene_can_be_read(name):
    assert_texts_are_apart(draw(tiny(), name))


@pytest.mark.slow
@pytest.mark.parametrize("scenario", ["keep_out", "dynamic", "robot"])
def test_bundled_scenes_can_be_read(scenario):
    picture = schedule_plot_data(scheduled(scenario)[1])
    assert_texts_are_apart(draw(picture))
    assert_u_alone_is_in_every_panel(picture)
    for name in ("modes", "margin"):
        assert_texts_are_apart(draw(picture, name))


def assert_u_alone_is_in_every_panel(picture):
    """Every panel with an unsafe set has U alone, unless it never comes into that part of space."""
    main, *panels = draw(picture).axes
    (u,) = alone(picture)
    assert len(dashed(main, u.colour)) == 1
    path = picture.positions(u.flights)
    for ax, one in zip(panels, closeups(picture), strict=True):
        gap = one.obstacle.signed_distance(u.flights.times, path, picture.system)
        if one.axes is None or np.any(gap < 0):
            assert dashed(ax, u.colour), one


def dashed(ax, colour):
    """Paths of U alone in axes."""
    with style():
        look = Line2D([], [], ls=DASHES, lw=0.9)
    lines = [one for one in ax.lines if one.get_color() == colour and one._dash_pattern == look._dash_pattern]
    low, high = np.array([ax.get_xlim(), ax.get_ylim()]).T
    visible = [np.all((one.get_xydata() > low) & (one.get_xydata() < high), axis=1) for one in lines]
    return [one for one, flags in zip(lines, visible, strict=True) if flags.any()]


def test_u_alone_flies_through_a_set_beside_the_path_that_passes_it():
    picture = over(60.0)
    times = np.linspace(0, picture.duration, 81)
    states = np.linspace([-300.0, 0, 0, 1, 0, 0], [300.0, 0, 0, 1, 0, 0], 81)[None]
    inputs, modes = np.zeros((1, 80, 3)), np.ones(20, dtype=int)
    flights = FlightEnvelope("fast", ("nominal",), times, states, inputs, modes, np.ones((3, 81)))
    picture = replace(picture, controllers=("safety", "fast"), flights={"experimental": flights})
    assert len(closeups(picture)) == 1
    assert_u_alone_is_in_every_panel(picture)


def test_each_of_several_experimental_controllers_is_named_and_drawn_alone():
    base = tiny()
    one = base.flights["experimental"]
    flights = {"experimental": replace(one, controller="a"), "second": replace(one, controller="b")}
    picture = replace(base, controllers=("safety", "a", "b"), flights={**base.flights, **flights})
    for name in ("scene", "distance"):
        names = {text.get_text() for text, _ in texts_of(draw(picture, name))}
        assert {"U alone (a)", "U alone (b)"} <= names, name
    assert [one.colour for one in alone(picture)] == [mode_colour(1), mode_colour(2)]
    assert [one.short for one in alone(base)] == ["U alone"]


@pytest.mark.parametrize("beside", [False, True])
def test_names_lie_on_no_filled_set_but_their_own(beside):
    """Two sides of a box are in view, with a set in the middle; or a point in another set has a name."""
    with style():
        ax = new_figure(3.0).add_subplot()
        ax.set(xlim=(0, 100), ylim=(0, 100))
        for corner in ((15, 15), (65, 75)):
            square = np.array(corner) + 50 / (1 + corner[0] // 50) * np.array(
                [[0, 0], [1, 0], [1, 1], [0, 1]]
            )
            ax.add_patch(Polygon(square, facecolor=RED, edgecolor=RED))
        s = np.linspace(0, 1, 200)[:, None]
        sides = np.vstack([(1 - s) * [2, 2] + s * [2, 80], (1 - s) * [2, 80] + s * [80, 80]])
        if beside:
            write_name(ax, "stay", sides, RED, beside=True)
        else:
            write_name(ax, "end", [[77, 87]], BLACK)
        ax.figure.draw_without_rendering()
    (text,) = ax.texts
    low, high = ax.transData.inverted().transform(text.get_window_extent().get_points())
    for a, b in (((15, 15), (65, 65)), ((65, 75), (90, 100))):
        assert np.any(np.minimum(high, b) < np.maximum(low, a))


def test_every_time_in_the_scene_says_of_what_it_is():
    texts = [text.get_text() for ax in draw(tiny()).axes[:1] for text in ax.texts]
    times = [text for text in texts if text.endswith(" s")]
    assert any(text.startswith("chaser, ") for text in times)
    assert all(re.match(r"(S from|U from|chaser,|trolley,) ", text) for text in times), times


def test_distances_name_the_nearest_set_and_say_when_a_box_begins():
    base = tiny()
    near, far = (base.duration * share for share in (0.25, 0.5))
    size = 1.0 + np.abs(base.flights["polaris"].states).max()
    late = KeepInPolytope("late", np.eye(2), [size, size], begins=far)
    early = KeepInPolytope("early", np.eye(2), [9 * size, 9 * size], ends=near)
    first = draw(replace(base, obstacles=(*base.obstacles, early, late)), "distance").axes[0]
    texts = [text.get_text() for text in first.texts]
    assert "late begins" in texts and "early ends" in texts
    marks = [line.get_xdata()[0] for line in first.lines if line.get_color() == RED and line.get_lw() == 0.7]
    assert {near, far} <= set(marks)
    times, states = base.flights["polaris"].times, base.flights["polaris"].states[0]
    every = [one.signed_distance(times, states[:, :2], base.system) for one in base.obstacles]
    texts = [text.get_text() for text in draw(base, "distance").axes[0].texts]
    nearest = {base.obstacles[i].name for i in np.argmin(every, axis=0)}
    assert {text for text in texts if text.startswith("nearest")} == {f"nearest: {one}" for one in nearest}


def test_a_margin_near_zero_has_a_bar_that_can_be_seen():
    base = tiny()
    margins = np.full(len(base.modes), 0.5)
    margins[:3] = 0.0006, -np.inf, 0.0
    bars = sorted(draw(replace(base, margins=margins), "margin").axes[0].patches, key=lambda one: one.get_x())
    heights = [bar.get_height() for bar in bars if bar.get_y() == 0][:3]
    assert heights[0] == heights[2] > 0.01 and heights[1] < 0
