"""Figures can be read: names apart and whole, all that is drawn explained, no set cut without a mark."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.collections import LineCollection, PathCollection, PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.text import Text

from polaris.report.figures import FIGURES
from polaris.report.figures.cuts import OUT_OF_FRAME
from polaris.report.figures.style import DASHES, style
from polaris.report.scene.items import alone, closeups
from polaris.report.scene.palette import mode_colour
from polaris.runs.build_plot_data import schedule_plot_data
from polaris.runs.plot_data import SliceData, directions
from polaris.simulation.baselines import FlightEnvelope
from tests.kept import scheduled
from tests.polaris.report.test_figures import over, random_picture
from tests.polaris.tiny import flown, synthesised
from tests.sizes import fewer

MANY = [0, *(pytest.param(i, marks=pytest.mark.slow) for i in range(1, fewer(90, 35)))]
POINT = 150 / 72  # pixels


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
    return replace(
        schedule_plot_data(synthesised()[1]), flights={key: item.flights for key, item in flown().items()}
    )


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
    """No text lies on another, and all are within the figure."""
    texts, slack = texts_of(figure), 1.0
    for one, box in texts:
        assert box.x0 >= -slack and box.y0 >= -slack, one
        assert box.x1 <= figure.bbox.x1 + slack and box.y1 <= figure.bbox.y1 + slack, one
    for (one, a), (other, b) in itertools.combinations(texts, 2):
        wide, high = min(a.x1, b.x1) - max(a.x0, b.x0), min(a.y1, b.y1) - max(a.y0, b.y0)
        if min(wide, high) > slack:
            assert one.get_rotation() % 90 or other.get_rotation() % 90, (one, other)
            assert apart(corners(one, figure), corners(other, figure)) > -slack, (one, other)


def corners(text, figure):
    """Corners (4, 2) of a text that is turned."""
    angle, renderer = text.get_rotation(), figure._get_renderer()
    box = text.get_window_extent(renderer)
    middle = (box.min + box.max) / 2
    text.set_rotation(0)
    half = text.get_window_extent(renderer).size / 2
    text.set_rotation(angle)
    c, s = np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))
    return middle + half * [[-1, -1], [1, -1], [1, 1], [-1, 1]] @ np.array([[c, s], [-s, c]])


def apart(one, other):
    """Gap between two rectangles (4, 2), along the side that shows most of it."""
    sides = [
        edge / np.linalg.norm(edge) for box in (one, other) for edge in (box[1] - box[0], box[2] - box[1])
    ]
    ends = [
        ((one @ side).min(), (one @ side).max(), (other @ side).min(), (other @ side).max()) for side in sides
    ]
    return max(max(c - b, a - d) for a, b, c, d in ends)


def colours_of(artist):
    """Colours of lines and edges that are drawn."""
    if isinstance(artist, Line2D):
        marked = artist.get_marker() not in ("None", "", " ", None)
        parts = [artist.get_color()] if artist.get_linestyle() != "None" else []
        return [to_rgba(one) for one in (*parts, *([artist.get_markeredgecolor()] if marked else []))]
    if isinstance(artist, Patch):
        return [artist.get_edgecolor()] if artist.get_linewidth() else [artist.get_facecolor()]
    return [*artist.get_edgecolor(), *artist.get_facecolor()]


def alike(colour, other):
    """Return True if a colour is another one, or that one mixed with white."""
    light, full = 1 - np.array(colour[:3]), 1 - np.array(other[:3])
    share = float(light @ full) / max(float(full @ full), 1e-9)
    return 0.1 < share < 1.05 and np.abs(light - share * full).max() < 0.06


def extents_px(artist):
    paths = [artist.get_path()] if isinstance(artist, (Line2D, Patch)) else artist.get_paths()
    known = [artist.get_transform().transform(path.vertices) for path in paths]
    s = np.linspace(0, 1, 40)[:, None, None]
    points = np.vstack([known[0], *(((1 - s) * one[:-1] + s * one[1:]).reshape(-1, 2) for one in known)])
    return points[np.isfinite(points).all(axis=1)]


def assert_everything_is_explained(figure):
    """Every line, edge and set has its colour in the legend, or beside a text of that colour or its title."""
    legends = [one for ax in figure.axes if (one := ax.get_legend())] + list(figure.legends)
    known = [colour for legend in legends for one in legend.legend_handles for colour in colours_of(one)]
    for ax in figure.axes:
        title = ax.get_title(loc="left")
        for artist in (*ax.lines, *ax.patches, *ax.collections):
            points = extents_px(artist)
            low, high = ax.bbox.min, ax.bbox.max
            if not np.any(np.all((points >= low) & (points <= high), axis=1)):
                continue
            for colour in colours_of(artist):
                if colour[3] == 0 or np.min(colour[:3]) > 0.99 or any(alike(colour, one) for one in known):
                    continue
                if "○" in title and isinstance(artist, Line2D) and artist.get_marker() == "o":
                    continue  # its time and distance are the title
                if title and isinstance(artist, Patch) and title.startswith("("):
                    continue  # the set that the title names
                beside = [box for text, box in texts_of(figure) if alike(colour, to_rgba(text.get_color()))]
                gap = [
                    np.linalg.norm(
                        np.maximum(np.maximum(box.min - points, points - box.max), 0), axis=1
                    ).min()
                    for box in beside
                ]
                assert min(gap, default=np.inf) < 60 * POINT, (artist, colour, title)


def assert_cuts_are_marked(figure):
    """Whatever the frame cuts has a mark of its colour on that side of the frame, and the legend says so."""
    cut_at_all = False
    for ax in figure.axes:
        limits = np.array([ax.get_xlim(), ax.get_ylim()])
        marks = [np.ravel(one.get_data()) for one in ax.lines if one.get_gid() == "cut"]
        assert all(np.any(np.isclose(mark[:, None], limits, rtol=1e-9)) for mark in marks)
        for artist in (*ax.lines, *ax.patches, *ax.collections):
            if isinstance(artist, PathCollection) or artist.get_gid() == "cut":
                continue
            if not all(artist.get_transform().contains_branch_seperately(ax.transData)):
                continue
            paths = [artist.get_path()] if isinstance(artist, (Line2D, Patch)) else artist.get_paths()
            for path in paths:
                points = path.vertices
                closed = isinstance(artist, (Patch, PolyCollection)) and not isinstance(
                    artist, LineCollection
                )
                for axis, side in itertools.product((0, 1), (0, 1)):
                    at = crossing(points, closed, axis, limits, side)
                    if at is None:
                        continue
                    cut_at_all = True
                    near = [mark for mark in marks if np.isclose(mark[axis], limits[axis, side], rtol=1e-9)]
                    low, high = at
                    slack = 0.04 * np.ptp(limits[1 - axis])
                    assert any(low - slack <= mark[1 - axis] <= high + slack for mark in near), (artist, at)
    if cut_at_all:
        names = [
            text.get_text() for ax in figure.axes if ax.get_legend() for text in ax.get_legend().get_texts()
        ]
        assert OUT_OF_FRAME in names


def crossing(points, closed, axis, limits, side):
    """Between which values a dense copy of an outline leaves one side of the frame; None if it does not."""
    points = np.vstack([points, points[:1]]) if closed else points
    s = np.linspace(0, 1, 50)
    dense = points[:-1, None] + s[:, None] * np.diff(points, axis=0)[:, None]
    (low, high), (a, b) = limits[axis], limits[1 - axis]
    size = high - low
    value, along = dense[..., axis], dense[..., 1 - axis]
    beyond = value > high + 1e-3 * size if side else value < low - 1e-3 * size
    inside = (value < high) & (value > low) & (along > a) & (along < b)
    edge = beyond[:, :-1] != beyond[:, 1:]
    where = along[:, 1:][edge]
    where = where[np.isfinite(where)]
    if closed:
        # Cut if some of it is seen and some of it is beyond this side within the frame's width.
        if not inside.any() or len(where) < 2 or where.max() < a or where.min() > b:
            return None
        return max(where.min(), a), min(where.max(), b)
    where = where[(where > a) & (where < b)]
    return (where.min(), where.max()) if len(where) else None


def assert_can_be_read(figure):
    assert_texts_are_apart(figure)
    assert_everything_is_explained(figure)
    assert_cuts_are_marked(figure)


@pytest.mark.parametrize("seed", MANY)
def test_random_scenes_can_be_read(seed):
    picture = crowded(seed)
    assert len(picture.hand_overs) >= 5
    assert_can_be_read(draw(picture))


@pytest.mark.parametrize("name", FIGURES)
def test_the_small_scene_can_be_read(name):
    figure = draw(tiny(), name)
    assert_texts_are_apart(figure)
    if name == "scene":
        assert_can_be_read(figure)


@pytest.mark.slow
@pytest.mark.parametrize("scenario", ["static", "keep_out", "dynamic", "hold_point", "robot"])
def test_bundled_scenes_can_be_read(scenario):
    picture = schedule_plot_data(scheduled(scenario)[1])
    assert_can_be_read(draw(picture))
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
    own = [one for one in ax.lines if one.get_color() == colour and one._dash_pattern == look._dash_pattern]
    low, high = np.array([ax.get_xlim(), ax.get_ylim()]).T
    return [
        one for one in own if np.any(np.all((one.get_xydata() > low) & (one.get_xydata() < high), axis=1))
    ]


def test_u_alone_flies_through_a_set_beside_the_path_that_passes_it():
    picture = over(60.0)
    times = np.linspace(0, picture.duration, 81)
    states = np.linspace([-300.0, 0, 0, 1, 0, 0], [300.0, 0, 0, 1, 0, 0], 81)[None]
    ones = np.ones((3, 81))
    flights = FlightEnvelope(
        "fast", ("nominal",), times, states, np.zeros((1, 80, 3)), np.ones(20, dtype=int), ones
    )
    picture = replace(picture, controllers=("safety", "fast"), flights={"experimental": flights})
    assert len(closeups(picture)) == 1
    assert_u_alone_is_in_every_panel(picture)


def test_each_of_several_experimental_controllers_is_named_and_drawn_alone():
    base = tiny()
    one = base.flights["experimental"]
    flights = {
        **base.flights,
        "experimental": replace(one, controller="a"),
        "second": replace(one, controller="b"),
    }
    picture = replace(base, controllers=("safety", "a", "b"), flights=flights)
    for name in ("scene", "distance"):
        figure = draw(picture, name)
        names = [text.get_text() for text, _ in texts_of(figure)]
        assert {"U alone (a)", "U alone (b)"} <= set(names), name
    assert [one.colour for one in alone(picture)] == [mode_colour(1), mode_colour(2)]
    assert [one.short for one in alone(base)] == ["U alone"]


def test_names_have_the_same_places_in_every_format_and_follow_the_view(tmp_path):
    figure = draw(crowded(1))
    (ax,) = figure.axes
    figure.set_layout_engine(None)
    before = [text.get_position() for text in ax.texts]
    figure.savefig(tmp_path / "a.pdf")
    assert [text.get_position() for text in ax.texts] == before
    figure.set_layout_engine("constrained")
    ax.set_xlim(*(0.7 * np.array(ax.get_xlim())))
    figure.draw_without_rendering()
    assert [text.get_position() for text in ax.texts] != before
    assert_texts_are_apart(figure)
