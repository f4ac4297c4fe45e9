"""Figures: drawn from files, readable at column width, nothing covered, the same bytes every time."""

import itertools
from dataclasses import replace
from functools import cache, lru_cache

import matplotlib
import numpy as np
import pytest
from matplotlib.lines import Line2D
from matplotlib.text import Text

from polaris.model.errors import PolarisError
from polaris.model.hill import clohessy_wiltshire
from polaris.model.scene.distances import stretches
from polaris.model.scene.keep_in import KeepInCone, KeepInPolytope
from polaris.model.scene.obstacles import BallObstacle, BoxObstacle, PolytopeObstacle
from polaris.model.scene.satellite import SatelliteObstacle
from polaris.model.system import LinearSystem
from polaris.planning.goals import Box, EllipticalNMT, LinearNMT, StationaryPoint
from polaris.planning.reference import Reference
from polaris.report.figures import FIGURES, draw_figures, plot_reference, plot_schedule
from polaris.report.figures.style import legend_above, new_figure, style
from polaris.report.figures.timelines import limit_group
from polaris.report.scene.geometry import edges, flat_outline, tube_support
from polaris.report.scene.items import MOST, closeups, outline_gap, under_mode
from polaris.report.scene.palette import (
    GREEN,
    INPUT_SHADES,
    MODE_COLOURS,
    RED,
    SET_SHADES,
    YELLOW,
    input_labels,
    shades,
)
from polaris.report.scene.space import Space
from polaris.runs.build_plot_data import safety_plot_data, schedule_plot_data
from polaris.runs.plot_data import Frame, PlotData, directions
from polaris.simulation.baselines import FlightEnvelope
from reach.sets.outlines import polygon
from reach.sets.zonotope import Zonotope
from tests.polaris.random_scenarios import synthesised as random_schedule
from tests.polaris.tiny import flown, synthesised
from tests.sizes import fewer


@pytest.fixture(scope="module", autouse=True)
def few_slices():
    """Draw every slice here: tests look at them."""


@pytest.fixture(scope="module")
def picture():
    schedule = synthesised()[1]
    return replace(schedule_plot_data(schedule), flights={key: item.flights for key, item in flown().items()})


@lru_cache(maxsize=16)
def drawn(name, picture, dpi=150):
    """A figure to look at, not to change."""
    with style():
        figure = FIGURES[name](picture)
        figure.set_dpi(dpi)
        figure.draw_without_rendering()
    return figure


# -- what a reader sees -------------------------------------------------------------------------------


@pytest.mark.parametrize("name", FIGURES)
def test_column_width_and_type_of_at_least_7_points(picture, name):
    figure = drawn(name, picture)
    assert figure.get_figwidth() == 3.5
    sizes = [text.get_fontsize() for text in figure.findobj(Text) if text.get_text()]
    assert sizes and min(sizes) >= 7


@pytest.mark.parametrize("name", ["scene", "distance", "margin"])
def test_legends_cover_no_data(picture, name):
    figure = drawn(name, picture)
    for ax in (ax for ax in figure.axes if ax.get_legend()):
        legend = ax.get_legend().get_window_extent()
        assert legend.y0 >= ax.get_window_extent().y1 - 1
        assert legend.x1 <= figure.bbox.x1 + 1 and legend.y1 <= figure.bbox.y1 + 1


@pytest.mark.parametrize("count", range(1, 9))
def test_a_legend_of_any_names_is_as_narrow_as_it_was_measured(count):
    long = ["Polaris", "S alone", "U alone (learned_policy)", "U alone (fuel_saver)"] * 2
    with style():
        figure = new_figure(2.0)
        ax = figure.add_subplot()
        legend_above(ax, [Line2D([], [], label=name) for name in long[:count]], 3)
        figure.canvas.draw()
        assert ax.get_legend().get_window_extent().x1 <= figure.bbox.x1 + 1
        assert ax.get_window_extent().width > 0.7 * figure.bbox.width


@pytest.mark.parametrize("name", ["scene", "distance", "modes", "margin"])
def test_nothing_is_cut_off(picture, name):
    figure = drawn(name, picture)
    box = figure.get_tightbbox().transformed(figure.dpi_scale_trans)
    assert box.x0 >= -1 and box.y0 >= -1
    assert box.x1 <= figure.bbox.x1 + 1 and box.y1 <= figure.bbox.y1 + 1


def test_axes_have_units_and_obstacles_have_names(picture):
    ax = drawn("scene", picture).axes[0]
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("Position x (m)", "Position y (m)")
    texts = " ".join(text.get_text() for text in ax.texts)
    assert "pillar" in texts and "trolley, " in texts
    upper, *_, lower = drawn("distance", picture).axes
    assert upper.get_ylabel() == "Distance (m)" and lower.get_xlabel() == "Time (s)"


def test_every_hand_over_has_the_set_of_its_own_time(picture):
    texts = [text.get_text() for text in drawn("scene", picture).axes[0].texts]
    switches = np.flatnonzero(np.diff(picture.modes)) + 1
    assert (
        len(switches) and [one.mode for one in picture.printed_slices()] == picture.modes[switches].tolist()
    )
    for one, k in zip(picture.printed_slices(), switches, strict=True):
        assert one.time == pytest.approx(k * picture.reference.delta)
        assert f"{'SU'[one.mode]} from {one.time:.3g} s" in texts
        for obstacle in picture.obstacles:  # this is why it is safe
            assert obstacle.signed_distance(np.full(len(one.outline), one.time), one.outline).min() > 0
    gone = replace(picture.slices, times=picture.slices.times + 0.1 * picture.reference.delta)
    assert not list(replace(picture, slices=gone).printed_slices())


def test_hills_frame_is_along_track_to_the_right_and_radial_up():
    frame = Frame.from_system(clohessy_wiltshire(0.0012, 10.0, 0.1))
    assert frame.axes == (1, 0, 2)
    assert frame.labels == ("Along-track (m)", "Radial (m)", "Cross-track (m)")


def test_modes_keep_the_papers_colours():
    assert MODE_COLOURS[:2] == ("#0072B2", "#E69F00")  # blue S, orange U, out of Okabe and Ito's palette
    assert len(set(MODE_COLOURS)) == len(MODE_COLOURS)


def test_inputs_are_named_by_axis_in_hills_frame_and_by_number_elsewhere():
    space = clohessy_wiltshire(0.0012, 10.0, 0.1)
    assert space.input_names == ("radial thrust", "along-track thrust", "cross-track thrust")
    assert input_labels(space) == ("Thrust (N)", ("radial", "along-track", "cross-track"))
    plane = synthesised()[1].safety
    assert plane.problem.system.input_names == ("input 0", "input 1")
    assert input_labels(plane.problem.system) == ("Input", ("input 0", "input 1"))
    limits = plane.clearance.limits
    assert [limits.name(0, limits.facets + i) for i in range(4)] == ["input 0", "input 1"] * 2


def test_limits_of_one_keep_in_set_are_one_name():
    assert limit_group("cone[3]") == limit_group("cone[11]") == "cone"


# -- files ------------------------------------------------------------------------------------------


def test_files_hold_no_dates_and_are_the_same_twice(picture, tmp_path, monkeypatch):
    names = ("scene", "margin")
    chosen = {name: FIGURES[name] for name in names}
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    first, second = (draw_figures(picture, tmp_path / one, chosen) for one in "ab")
    assert [path.name for path in first] == [f"{name}.{end}" for name in names for end in ("pdf", "png")]
    for a, b in zip(first, second, strict=True):
        assert a.read_bytes() == b.read_bytes()
        assert b"CreationDate" not in a.read_bytes() and b"tIME" not in a.read_bytes()


def test_pdfs_embed_truetype_fonts_whose_text_can_be_searched(picture, tmp_path, monkeypatch):
    chosen = {"modes": FIGURES["modes"]}
    draw_figures(picture, tmp_path, chosen)
    plain = (tmp_path / "modes.pdf").read_bytes()
    assert b"/FontFile2" in plain and b"/ToUnicode" in plain and b"/Type3" not in plain
    assert b"PolarisSans" in plain and b"DejaVuSans" not in plain
    # A letter that the light font lacks comes from the full one.
    draw_figures(
        replace(picture, controllers=("safety", "\N{CYRILLIC CAPITAL LETTER ZHE}")), tmp_path, chosen
    )
    assert b"DejaVuSans" in (tmp_path / "modes.pdf").read_bytes()


def test_each_format_is_drawn_once_and_the_layout_solved_once(picture, tmp_path, monkeypatch):
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    calls = []
    for owner, name in ((Figure, "draw"), (ConstrainedLayoutEngine, "execute")):
        true = getattr(owner, name)

        def counted(self, *args, true=true, name=name):
            calls.append(name)
            return true(self, *args)

        monkeypatch.setattr(owner, name, counted)
    draw_figures(picture, tmp_path, {name: FIGURES[name] for name in ("scene", "modes")})
    assert calls == ["execute", "draw", "draw"] * 2


def test_the_users_settings_come_back(picture):
    before = dict(matplotlib.rcParams)
    drawn.__wrapped__("modes", picture)
    assert dict(matplotlib.rcParams) == before


# -- drawing from results ---------------------------------------------------------------------------


def test_plots_go_into_given_axes_and_new_ones():
    from matplotlib import pyplot
    from matplotlib.figure import Figure

    schedule = synthesised()[1]
    ax = Figure().add_subplot()
    assert plot_reference(schedule.safety, ax) is ax and plot_schedule(schedule, Figure().add_subplot()).texts
    pyplot.switch_backend("agg")
    try:
        assert plot_schedule(schedule).figure.get_figwidth() == 3.5
    finally:
        pyplot.close("all")


def test_reference_alone_has_no_modes():
    picture = safety_plot_data(synthesised()[1].safety)
    assert len(picture.modes) == 0 and picture.tube is None and picture.slices is not None


def bare(system, obstacles, goal, chi0, delta=30.0, steps=20):
    """A picture with no more than a free path."""
    reference = Reference.propagate(system, delta, np.array(chi0, dtype=float), np.zeros((steps, system.m)))
    return PlotData(
        "bare", system, tuple(obstacles), goal, Zonotope.box(chi0, np.full(system.n, 0.1)), reference, steps
    )


def test_scene_in_space_with_every_kind_of_set():
    system = clohessy_wiltshire(0.0012, 10.0, 0.1)
    sets = [
        BoxObstacle("debris", [60.0, 100.0, 0.0], [20.0] * 3),
        BallObstacle("ball", [0.0, 0.0, 50.0], 10.0, velocity=[0.05, 0.0, 0.0]),
        SatelliteObstacle("visitor", [80.0, 250, 0, 0, -0.1, 0], [2.0, 2, 2, 0.001, 0.001, 0.001], 15.0),
        KeepInCone("sight", [0.0, 0.0, 0.0], [0.0, 1.0, 0.0], 0.6),
    ]
    picture = bare(system, sets, EllipticalNMT(0.0012, 60.0, 120.0), [0, 200.0, 0, 0.12, 0, 0], steps=170)
    texts = [text.get_text() for text in drawn("scene", picture).axes[0].texts]
    assert {"debris", "sight (stay inside)"} <= set(texts)
    assert all(any(text.startswith(name) for text in texts) for name in ("visitor, ", "ball, "))


def test_scene_on_the_line_is_drawn_over_time(tmp_path):
    system = LinearSystem(
        np.array([[0, 1], [0, 0]]), np.array([[0], [1]]), np.array([[0], [1]]), np.array([1.0])
    )
    goal = Box(np.array([8.0, 0.0]), np.array([1.0, 1.0]))
    picture = bare(system, [BoxObstacle("wall", [20.0], [1.0])], goal, [0.0, 0.2], 1.0)
    ax = drawn("scene", picture).axes[0]
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("Time (s)", "Position x (m)")


# -- scenes of every kind ----------------------------------------------------------------------------

LINE = LinearSystem(np.array([[0, 1.0], [0, 0]]), np.array([[0], [1.0]]), np.array([[0], [1.0]]), np.ones(1))
HILL = clohessy_wiltshire(0.0012, 10.0, 0.1)


@cache
def random_picture(seed):
    """A flight by modes in one to three dimensions, with every kind of set and goal, in units of any size."""
    rng = np.random.default_rng(seed)
    d, unit, steps = 1 + seed % 3, 10.0 ** rng.uniform(-3, 6), 12
    zero, one = np.zeros((d, d)), np.eye(d)
    A, B = np.block([[zero, one], [zero, zero]]), np.vstack([zero, one])
    system = HILL if seed % 6 == 5 else LinearSystem(A, B, B, np.ones(d))
    n, delta = system.n, 40.0
    chi0 = np.r_[rng.uniform(-1, 1, d), rng.uniform(-1, 1, d) / (steps * delta)] * 3 * unit
    push = rng.normal(size=(steps, system.m)) * unit / (steps * delta) ** 2 * (10 if system is HILL else 3)
    reference = Reference.propagate(system, delta, chi0, push)
    times = np.linspace(0, steps * delta, 4 * steps + 1)
    path = np.vstack([arc[:-1] for arc in reference.fine(4)] + [reference.chi[-1:]])
    size = float(np.ptp(path[:, :d], axis=0).max())
    at = path[rng.integers(len(path), size=4), :d] + rng.normal(size=(4, d)) * size / 5
    sets = [
        BallObstacle("ball", at[0], 0.05 * size, velocity=rng.normal(size=d) * size / (steps * delta)),
        BoxObstacle(
            "a-box-with-a-very-long-name-that-nobody-would-read", at[1], rng.uniform(0.02, 0.1, d) * size
        ),
        SatelliteObstacle(
            "visitor",
            np.r_[at[2], np.zeros(n - d)],
            np.r_[np.full(d, 0.02 * size), np.zeros(n - d)],
            0.03 * size,
        ),
        PolytopeObstacle("wall", [rng.normal(size=d)], [-2.0 * float(np.abs(path).max())], unbounded=True),
        KeepInPolytope(
            "corridor", np.vstack([np.eye(d), -np.eye(d)]), np.full(2 * d, 1.5 * np.abs(path[:, :d]).max())
        ),
    ]
    half = np.where(rng.random(n) < 0.4, np.inf, rng.uniform(0, 0.2, n) * size)
    goals = [StationaryPoint(reference.chi[-1]), Box(reference.chi[-1], half)]
    if system is HILL:
        goals += [LinearNMT(0.0012, 0.2 * size, 0.1 * size), EllipticalNMT(0.0012, 0.1 * size, 0.2 * size)]
    modes = rng.integers(0, 3, steps)
    ones = np.ones((3, len(times)))
    flights = FlightEnvelope(
        "polaris", ("nominal",), times, path[None], np.zeros((1, len(times) - 1, system.m)), modes, ones,
        np.zeros((2, len(times) - 1, system.m)),
    )  # fmt: skip
    limits = [system.input_names[0], "corridor[0]", "corridor[1]", "visitor", "wall", sets[1].name]
    return PlotData(
        "random", system, tuple(sets[i] for i in range(5) if rng.random() < 0.8),
        goals[rng.integers(len(goals))],
        Zonotope.box(chi0, np.r_[np.full(d, 0.01 * size), np.zeros(n - d)]), reference, steps,
        ("safety", "a learned policy whose name is far too long for any legend", "other"), modes,
        rng.uniform(-0.1, 1, steps), tuple(limits[i] for i in rng.integers(0, 6, steps)),
        {"polaris": flights, "experimental": replace(flights, states=flights.states + 0.03 * size)},
    )  # fmt: skip


def legends(figure):
    return [one for ax in figure.axes if (one := ax.get_legend()) is not None] + list(figure.legends)


def assert_well_drawn(figure):
    """Legends within the figure and over no axes' data, nothing cut off, no number that is none."""
    for legend in legends(figure):
        box = legend.get_window_extent()
        assert box.x0 >= -1 and box.x1 <= figure.bbox.x1 + 1 and box.y1 <= figure.bbox.y1 + 1
    box = figure.get_tightbbox().transformed(figure.dpi_scale_trans)
    assert box.x0 >= -1 and box.y0 >= -1 and box.x1 <= figure.bbox.x1 + 1 and box.y1 <= figure.bbox.y1 + 1
    for ax in figure.axes:
        ticks = [text.get_window_extent() for text in ax.get_xticklabels() if text.get_text()]
        assert all(a.x1 < b.x0 for a, b in itertools.pairwise(ticks))
        assert not ax.xaxis.get_offset_text().get_text() and not ax.yaxis.get_offset_text().get_text()
        for text in ax.texts:
            assert np.all(np.isfinite(text.get_position()))
        for line in ax.lines:
            data = np.column_stack(line.get_data())
            assert np.isfinite(data).any() and not np.isinf(data.astype(float)).any()
            assert np.array_equal(
                np.isnan(data).any(axis=1), np.isnan(data).all(axis=1)
            )  # gaps, nothing else
        for patch in ax.patches:
            assert np.isfinite(patch.get_path().vertices).all()
        for many in ax.collections:
            assert all(np.isfinite(path.vertices).all() for path in many.get_paths())


def assert_legend_is_seen(figure):
    """Every colour a legend names is somewhere in the axes, but for the edge of what lies under something."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.colors import to_rgb

    canvas = FigureCanvasAgg(figure)
    for legend in legends(figure):
        ax = legend.axes
        legend.set_visible(False)
        canvas.draw()
        image = np.asarray(canvas.buffer_rgba())[::-1, :, :3] / 255.0
        legend.set_visible(True)
        x0, y0, x1, y1 = (int(v) for v in ax.get_window_extent().extents)
        seen = image[y0:y1, x0:x1].reshape(-1, 3)
        for handle, text in zip(legend.legend_handles, legend.get_texts(), strict=True):
            colour = to_rgb(
                handle.get_facecolor() if hasattr(handle, "get_facecolor") else handle.get_color()
            )
            count = np.count_nonzero(np.abs(seen - colour).max(axis=1) < 0.02)
            assert count >= 2, (text.get_text(), count)


SEEDS = (0,)
"""Scene of the quick test."""


@pytest.mark.parametrize(
    "seed",
    [*SEEDS, *(pytest.param(i, marks=pytest.mark.slow) for i in range(fewer(120, 41)) if i not in SEEDS)],
)
def test_random_scenes_are_well_drawn(seed):
    picture = random_picture(seed)
    for name in ("scene", "margin"):
        figure = drawn(name, picture)
        assert_well_drawn(figure)
        assert_legend_is_seen(figure)


@pytest.mark.parametrize("name", ["scene", "margin", "distance"])
def test_legends_name_only_what_is_seen(picture, name):
    figure = drawn(name, picture)
    assert_well_drawn(figure)
    assert_legend_is_seen(figure)


def test_no_two_kinds_of_thing_share_a_colour():
    from matplotlib.colors import to_rgb

    kinds = {
        "controllers": MODE_COLOURS,
        "sets": [*shades(SET_SHADES, 5), RED],
        "inputs": shades(INPUT_SHADES, 3),
        "goal": [GREEN],
        "recoverable": [YELLOW],
    }
    for one, other in itertools.combinations(kinds, 2):
        for a, b in itertools.product(kinds[one], kinds[other]):
            assert np.linalg.norm(np.subtract(to_rgb(a), to_rgb(b))) > 0.2, (one, a, other, b)
    for seed in range(4):
        colours = {}
        legend = drawn("margin", random_picture(seed)).axes[0].get_legend()
        for handle, text in zip(legend.legend_handles, legend.get_texts(), strict=True):
            assert colours.setdefault(handle.get_facecolor(), text.get_text()) == text.get_text()


# -- the picture tells why it is safe ----------------------------------------------------------------


def drawn_gap(picture, obstacle, times, path, axes):
    """Least distance of drawn positions from the drawn outline of the true set at the same time."""
    space = Space.from_paths(picture)
    gaps = []
    for t, p in zip(times, path, strict=True):
        outline = space.wider(20.0).outline(obstacle, float(t), axes)
        edge = np.roll(outline, -1, axis=0) - outline
        normal = np.stack([edge[:, 1], -edge[:, 0]], axis=1)
        gaps.append(np.max(np.sum((p[axes] - outline) * normal, axis=1) / np.linalg.norm(normal, axis=1)))
    return np.array(gaps)


@pytest.mark.parametrize(
    "seed", [5, 11, 2, 8, *(pytest.param(i, marks=pytest.mark.slow) for i in range(14, 300, 3))]
)
def test_some_panel_shows_every_passage_of_a_set_that_is_not_entered(seed):
    picture = random_picture(seed)
    times, path = picture.safe_path()
    panels = closeups(picture)
    for obstacle in picture.obstacles:
        distance = obstacle.signed_distance(times, path, picture.system)
        own = [one for one in panels if one.obstacle is obstacle]
        inside = Space.from_paths(picture).corners(obstacle, picture.approach(obstacle).time)
        if isinstance(obstacle, KeepInPolytope) or distance.min() <= 0 or not len(inside):
            assert own == []
            continue
        shown = drawn_gap(picture, obstacle, times, path, picture.frame.flat) > 0
        for one in own:
            a, b = one.span
            assert times[a] <= one.time <= times[b - 1]
            cover = Space.from_paths(picture).cover(obstacle, one.time)
            if one.axes is not None and cover is not None:  # nor does the path cross the cover that is drawn
                centres = obstacle.centre(times[a:b], picture.system)
                beside = path[a:b] - centres + obstacle.centre(one.time, picture.system)
                assert np.all(outline_gap(flat_outline(cover[:, one.axes]), beside[:, one.axes]) > 0)
            if one.axes is not None:
                assert np.all(drawn_gap(picture, obstacle, times[a:b], path[a:b], one.axes) > 0)
            shown[a:b] = True
        assert shown.all() or len(panels) == MOST


def over(height, radius=40.0):
    """A straight flight that passes over a ball."""
    at = np.array([0.0, 0.0, 0.0])
    A = np.block([[np.zeros((3, 3)), np.eye(3)], [np.zeros((3, 6))]])
    system = LinearSystem(A, np.eye(6)[:, 3:], np.eye(6)[:, 3:], np.ones(3))
    return bare(
        system, [BallObstacle("ball", at, radius)], StationaryPoint(np.zeros(6)), [-300, 0, height, 1, 0, 0]
    )


def test_a_set_passed_above_has_a_close_up_that_shows_the_gap():
    picture = over(60.0)
    (one,) = closeups(picture)
    assert one.axes == [0, 2] and one.distance == pytest.approx(20.0) and one.time == pytest.approx(300.0)
    figure = drawn("scene", picture)
    assert len(figure.axes) == 2
    main, close = figure.axes
    assert "ball (see a)" in [text.get_text() for text in main.texts]
    assert (
        close.get_title(loc="left") == "(a) ball\n○ 300 s: 20 m apart"
        and close.get_ylabel() == "Position z (m)"
    )
    assert_well_drawn(figure)


def test_a_set_that_is_entered_is_drawn_as_such_and_a_free_path_needs_no_close_up():
    for picture in (over(30.0), over(60.0, 1.0)):
        assert (closeups(picture) == []) == (len(drawn("scene", picture).axes) == 1)
    texts = [text.get_text() for text in drawn("scene", over(30.0)).axes[0].texts]
    assert "ball" in texts and closeups(over(30.0)) == []


def test_moving_sets_and_the_chaser_bear_the_same_times(picture):
    texts = [text.get_text() for text in drawn("scene", picture).axes[0].texts if text.get_color() == RED]
    times = [
        float(text.removeprefix("trolley, ").removesuffix(" s")) for text in texts if text.endswith(" s")
    ]
    assert 2 <= len(times) <= 6 and all(times.count(t) == 2 for t in times)
    trolley = picture.obstacles[1]
    closest = picture.approach(trolley)
    assert f"trolley, {closest.time:.3g} s" in texts


# -- on the line -------------------------------------------------------------------------------------


def test_limits_on_the_line_are_drawn_where_they_are():
    sets = [
        BoxObstacle("wall", [9.0], [1.0]),
        KeepInPolytope("track", [[1.0], [-1.0]], [12.0, 5.0]),
        KeepInPolytope("far", [[1.0], [-1.0]], [1e5, 2e5]),
    ]
    picture = bare(LINE, sets, Box(np.array([4.0, 0.0]), np.array([1.0, np.inf])), [0.0, 0.2], 1.0)
    ax = drawn("scene", picture).axes[0]
    level = [set(line.get_ydata()) for line in ax.lines if len(set(line.get_ydata())) == 1]
    low, high = ax.get_ylim()
    assert {12.0} in level and {-5.0} in level and low < -5 and 12 < high < 50
    texts = [text.get_text() for text in ax.texts]
    assert texts.count("track (stay inside)") == 2 and "wall" in texts
    assert {"far (stay inside): 1e+05 m", "far (stay inside): -2e+05 m"} <= set(texts)
    assert any(list(line.get_ydata()) == [3.0, 5.0] for line in ax.lines)  # the goal


# -- geometry ---------------------------------------------------------------------------------------


def inside(points, outline, slack=1e-9):
    edge = np.roll(outline, -1, axis=0) - outline
    gap = points[:, None] - outline
    return np.all(edge[:, 0] * gap[..., 1] - edge[:, 1] * gap[..., 0] >= -slack, axis=1)


def test_polygon_is_circumscribed():
    rng = np.random.default_rng(0)
    G, rays = rng.normal(size=(2, 5)), directions()
    outline = polygon(np.abs(rays @ G).sum(axis=1), rays)
    assert inside(rng.uniform(-1, 1, (500, 5)) @ G.T, outline).all()


def test_tube_outlines_contain_the_tube():
    tube, rng = schedule_plot_data(synthesised()[1]).tube, np.random.default_rng(1)
    outlines = polygon(
        tube_support(tube.centre, tube.generators, tube.intersample, 3, directions()), directions()
    )
    q = tube.intersample.shape[1]
    edges = np.unique(np.linspace(0, q, 4).astype(int))
    for k in (0, 5, 11):
        for part in range(3):
            for node in range(edges[part], edges[part + 1] + 1):
                signs = rng.uniform(-1, 1, (20, tube.generators.shape[-1]))
                points = tube.centre[k, node] + signs @ tube.generators[k, node].T
                assert inside(points, outlines[k, part]).all()


def assert_slices_are_of_their_instants(schedule, picture):
    """Each contains its own run's place, ends where its own set does, and none that is claimed is missing."""
    system, delta, slices = schedule.safety.problem.system, picture.reference.delta, picture.slices
    q, recoverable = schedule.safety.tracking.feedback.nodes_per_cell, schedule.safety.recoverable
    flights, flat = picture.flights["polaris"], picture.frame.flat
    lift = np.linalg.pinv(system.position)[:, flat].T
    switches = (np.flatnonzero(np.diff(picture.modes)) + 1) * delta
    for t in [0.0, *switches]:
        assert np.abs(slices.times - t).min() < 1e-6 * delta
    for t, places, outlines in zip(slices.times, slices.places, slices.outlines, strict=True):
        step, part = divmod(round(t / delta * q), q)
        xi = picture.reference.chi[step] if part == 0 else picture.reference.fine(q)[step, part]
        states = flights.states[:, int(np.argmin(np.abs(flights.times - t)))]
        claimed = recoverable.contains(step * q + part, states - xi)
        # A flight under U is inside to its end; S, once it has taken over there, may leave sets that shrink.
        flew = step == 0 or np.any(picture.modes[max(step - 1 + (part > 0), 0) : step + 1])
        assert claimed[0] or not flew or schedule.guarantee != "proved"
        np.testing.assert_array_equal(claimed, ~np.isnan(places).any(axis=1))
        for state, place, outline in zip(states[claimed], places[claimed], outlines[claimed], strict=True):
            size = np.ptp(outline, axis=0).max()
            np.testing.assert_allclose(place, system.position @ state, rtol=0, atol=1e-9 * size)
            middle = outline.mean(axis=0)
            if len(flat) == 1:
                assert outline.min() <= place <= outline.max()
            else:
                assert inside(place[None, flat], outline, 1e-9 * size**2).all()
            for share, known in ((0.999, True), (1.1, False)):
                moved = middle + share * (outline - middle) - place[flat]
                within = recoverable.contains(step * q + part, state - xi + moved @ lift)
                assert within.all() if known else not within.any()


def test_slices_contain_the_chaser_of_every_run():
    schedule = synthesised()[1]
    flights = {key: item.flights for key, item in flown().items()}
    assert len(flights["polaris"].labels) > 3
    assert_slices_are_of_their_instants(schedule, schedule_plot_data(schedule, flights))


PROVED = (1,)
"""Random scene of the quick test, which has a schedule."""


@pytest.mark.parametrize(
    "seed",
    [*PROVED, *(pytest.param(i, marks=pytest.mark.slow) for i in range(fewer(60, 30)) if i not in PROVED)],
)
def test_slices_of_random_scenes_are_of_their_instants(seed, tmp_path):
    try:
        schedule = random_schedule(seed, tmp_path)[1]
    except PolarisError:
        assert seed not in PROVED, "or nothing is looked at"
        pytest.skip("refused")
    picture = schedule_plot_data(schedule)
    assert_slices_are_of_their_instants(schedule, picture)
    for t, _, place, outline in picture.printed_slices():
        i = int(np.argmin(np.abs(picture.safe_path()[0] - t)))
        np.testing.assert_allclose(picture.safe_path()[1][i], place, rtol=1e-12)
        assert (
            picture.system.d == 1
            or inside(place[None, picture.frame.flat], outline, 1e-9 * np.ptp(outline)).all()
        )


def test_a_path_is_drawn_under_the_mode_that_flew_it():
    flown, flags = np.arange(7.0)[:, None] * [1.0, 2.0], np.array([True, False, True, True, False, True])
    drawn = under_mode(flown, flags)[:, 0]
    np.testing.assert_array_equal(drawn, [0, 1, np.nan, 2, 3, 4, np.nan, 5, 6, np.nan])
    assert stretches(flags) == [(0, 1), (2, 4), (5, 6)] and stretches([]) == []


def test_outline_and_faces_of_a_cube():
    corners = np.array(np.meshgrid([0, 1], [0, 1], [0, 1])).reshape(3, -1).T.astype(float)
    assert sorted(np.ptp(edges(corners), axis=1).sum(axis=1)) == [1] * 12
    assert len(flat_outline(np.vstack([corners[:, :2], [[0.5, 0.5]]]))) == 4
    assert len(edges(corners[:, [0, 1, 1]])) == 0
