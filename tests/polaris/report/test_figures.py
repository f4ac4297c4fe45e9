"""Figures: drawn from files, readable at column width, nothing covered, the same bytes every time."""

import itertools
from dataclasses import replace
from functools import cache, lru_cache

import matplotlib
import numpy as np
import pytest
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
from polaris.report.figures.style import style
from polaris.report.scene.geometry import flat_outline, tube_support
from polaris.report.scene.items import MOST, closeups, outline_gap, under_mode
from polaris.report.scene.palette import GREEN, INPUT_SHADES, MODE_COLOURS, RED, SET_SHADES, YELLOW, shades
from polaris.report.scene.space import Space
from polaris.runs.build_plot_data import schedule_plot_data
from polaris.runs.plot_data import PlotData, directions
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


def test_every_hand_over_has_the_set_of_its_own_time(picture):
    texts = [text.get_text() for text in drawn("scene", picture).axes[0].texts]
    switches = np.flatnonzero(np.diff(picture.modes)) + 1
    assert len(switches)
    assert [one.mode for one in picture.printed_slices()] == picture.modes[switches].tolist()
    for one, k in zip(picture.printed_slices(), switches, strict=True):
        assert one.time == pytest.approx(k * picture.reference.delta)
        assert f"{'SU'[one.mode]} from {one.time:.3g} s" in texts
        for obstacle in picture.obstacles:  # this is why it is safe
            assert obstacle.signed_distance(np.full(len(one.outline), one.time), one.outline).min() > 0
    shifted = replace(picture.slices, times=picture.slices.times + 0.1 * picture.reference.delta)
    assert not list(replace(picture, slices=shifted).printed_slices())


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


def test_pdfs_embed_truetype_fonts_whose_text_can_be_searched(picture, tmp_path):
    for name, full in (("hasty", False), ("\N{CYRILLIC CAPITAL LETTER ZHE}", True)):
        renamed = replace(picture, controllers=("safety", name))
        pdf = draw_figures(renamed, tmp_path, {"modes": FIGURES["modes"]})[0].read_bytes()
        assert b"/FontFile2" in pdf and b"/ToUnicode" in pdf and b"/Type3" not in pdf
        assert b"PolarisSans" in pdf and (b"DejaVuSans" in pdf) == full  # letters that the light font lacks


def test_plots_go_into_given_axes_and_new_ones(monkeypatch):
    from matplotlib import pyplot
    from matplotlib.figure import Figure

    schedule, before = synthesised()[1], dict(matplotlib.rcParams)
    ax = Figure().add_subplot()
    assert plot_reference(schedule.safety, ax) is ax and plot_schedule(schedule, Figure().add_subplot()).texts
    assert dict(matplotlib.rcParams) == before
    pyplot.switch_backend("agg")
    assert plot_schedule(schedule).figure.get_figwidth() == 3.5
    pyplot.close("all")


def bare(system, obstacles, goal, chi0, delta=30.0, steps=20):
    """A picture with no more than a free path."""
    reference = Reference.propagate(system, delta, np.array(chi0, dtype=float), np.zeros((steps, system.m)))
    return PlotData(
        "bare", system, tuple(obstacles), goal, Zonotope.box(chi0, np.full(system.n, 0.1)), reference, steps
    )


HILL = clohessy_wiltshire(0.0012, 10.0, 0.1)


@cache
def random_picture(seed):
    """A flight by modes in one to three dimensions, with every kind of set and goal, in units of any size."""
    rng = np.random.default_rng(seed)
    d, unit, steps = 1 + seed % 3, 10.0 ** rng.uniform(-3, 6), 12
    zero, one = np.zeros((d, d)), np.eye(d)
    A, B = np.block([[zero, one], [zero, zero]]), np.vstack([zero, one])
    system = HILL if seed % 6 == 5 else LinearSystem(A, B, B, np.ones(d))
    n, delta, zeros = system.n, 40.0, np.zeros(system.n - d)
    chi0 = np.r_[rng.uniform(-1, 1, d), rng.uniform(-1, 1, d) / (steps * delta)] * 3 * unit
    push = rng.normal(size=(steps, system.m)) * unit / (steps * delta) ** 2 * (10 if system is HILL else 3)
    reference = Reference.propagate(system, delta, chi0, push)
    times = np.linspace(0, steps * delta, 4 * steps + 1)
    path = np.vstack([arc[:-1] for arc in reference.fine(4)] + [reference.chi[-1:]])
    size = float(np.ptp(path[:, :d], axis=0).max())
    at = path[rng.integers(len(path), size=4), :d] + rng.normal(size=(4, d)) * size / 5
    sets = [
        BallObstacle("ball", at[0], 0.05 * size, velocity=rng.normal(size=d) * size / (steps * delta)),
        BoxObstacle("a-box-with-a-name-too-long-for-any-legend", at[1], rng.uniform(0.02, 0.1, d) * size),
        SatelliteObstacle("visitor", np.r_[at[2], zeros], np.r_[np.full(d, 0.02 * size), zeros], 0.03 * size),
        PolytopeObstacle("wall", [rng.normal(size=d)], [-2.0 * float(np.abs(path).max())], unbounded=True),
        KeepInPolytope("corridor", np.vstack([one, -one]), np.full(2 * d, 1.5 * np.abs(path[:, :d]).max())),
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
        Zonotope.box(chi0, np.r_[np.full(d, 0.01 * size), zeros]), reference, steps,
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
            assert np.array_equal(np.isnan(data).any(axis=1), np.isnan(data).all(axis=1))  # gaps alone
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
        pixels = image[y0:y1, x0:x1].reshape(-1, 3)
        for handle, text in zip(legend.legend_handles, legend.get_texts(), strict=True):
            get_colour = handle.get_facecolor if hasattr(handle, "get_facecolor") else handle.get_color
            colour = to_rgb(get_colour())
            count = np.count_nonzero(np.abs(pixels - colour).max(axis=1) < 0.02)
            assert count >= 2, (text.get_text(), count)


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(i, marks=pytest.mark.slow) for i in range(1, fewer(120, 24)))]
)
def test_random_scenes_are_well_drawn(seed):
    picture = random_picture(seed)
    for name in ("scene", "margin"):
        figure = drawn(name, picture)
        assert_well_drawn(figure)
        assert_legend_is_seen(figure)


@pytest.mark.parametrize("name", FIGURES)
def test_figures_fit_a_column_and_explain_what_they_show(picture, name):
    figure = drawn(name, picture)
    assert figure.get_figwidth() == 3.5
    assert min(text.get_fontsize() for text in figure.findobj(Text) if text.get_text()) >= 7
    assert_well_drawn(figure)
    for ax in (ax for ax in figure.axes if ax.get_legend()):
        assert ax.get_legend().get_window_extent().y0 >= ax.get_window_extent().y1 - 1  # it covers no data
    if name != "modes":
        assert_legend_is_seen(figure)


def test_no_two_kinds_of_thing_share_a_colour():
    from matplotlib.colors import to_rgb

    assert MODE_COLOURS[:2] == ("#0072B2", "#E69F00")  # of the paper: blue S, orange U
    kinds = [MODE_COLOURS, [*shades(SET_SHADES, 5), RED], shades(INPUT_SHADES, 3), [GREEN], [YELLOW]]
    for one, other in itertools.combinations(kinds, 2):
        for a, b in itertools.product(one, other):
            assert np.linalg.norm(np.subtract(to_rgb(a), to_rgb(b))) > 0.2, (a, b)


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
    "seed", [5, 11, 2, 8, *(pytest.param(i, marks=pytest.mark.slow) for i in range(14, fewer(300, 90), 3))]
)
def test_some_panel_shows_every_passage_of_a_set_that_is_not_entered(seed):
    picture = random_picture(seed)
    times, path = picture.safe_path()
    panels = closeups(picture)
    for obstacle in picture.obstacles:
        distance = obstacle.signed_distance(times, path, picture.system)
        its_panels = [one for one in panels if one.obstacle is obstacle]
        inside = Space.from_paths(picture).corners(obstacle, picture.approach(obstacle).time)
        if isinstance(obstacle, KeepInPolytope) or distance.min() <= 0 or not len(inside):
            assert its_panels == []
            continue
        visible = drawn_gap(picture, obstacle, times, path, picture.frame.flat) > 0
        for one in its_panels:
            a, b = one.span
            assert times[a] <= one.time <= times[b - 1]
            cover = Space.from_paths(picture).cover(obstacle, one.time)
            if one.axes is not None and cover is not None:  # nor does the path cross the cover that is drawn
                centres = obstacle.centre(times[a:b], picture.system)
                relative = path[a:b] - centres + obstacle.centre(one.time, picture.system)
                assert np.all(outline_gap(flat_outline(cover[:, one.axes]), relative[:, one.axes]) > 0)
            if one.axes is not None:
                assert np.all(drawn_gap(picture, obstacle, times[a:b], path[a:b], one.axes) > 0)
            visible[a:b] = True
        assert visible.all() or len(panels) == MOST


def over(height, radius=40.0):
    """A straight flight that passes over a ball."""
    ball = BallObstacle("ball", np.zeros(3), radius)
    A = np.block([[np.zeros((3, 3)), np.eye(3)], [np.zeros((3, 6))]])
    system = LinearSystem(A, np.eye(6)[:, 3:], np.eye(6)[:, 3:], np.ones(3))
    return bare(system, [ball], StationaryPoint(np.zeros(6)), [-300, 0, height, 1, 0, 0])


def test_scene_in_space_with_every_kind_of_set():
    sets = [
        BoxObstacle("debris", [60.0, 100.0, 0.0], [20.0] * 3),
        BallObstacle("ball", [0.0, 0.0, 50.0], 10.0, velocity=[0.05, 0.0, 0.0]),
        SatelliteObstacle("visitor", [80.0, 250, 0, 0, -0.1, 0], [2.0, 2, 2, 0.001, 0.001, 0.001], 15.0),
        KeepInCone("sight", [0.0, 0.0, 0.0], [0.0, 1.0, 0.0], 0.6),
    ]
    picture = bare(HILL, sets, EllipticalNMT(0.0012, 60.0, 120.0), [0, 200.0, 0, 0.12, 0, 0], steps=170)
    texts = [text.get_text() for text in drawn("scene", picture).axes[0].texts]
    assert {"debris", "sight (stay inside)"} <= set(texts)
    assert all(any(text.startswith(name) for text in texts) for name in ("visitor, ", "ball, "))


def test_a_set_passed_above_has_a_close_up_that_shows_the_gap():
    assert closeups(over(30.0)) == [] and len(drawn("scene", over(30.0)).axes) == 1  # it is entered
    picture = over(60.0)
    (one,) = closeups(picture)
    assert one.axes == [0, 2] and one.distance == pytest.approx(20.0) and one.time == pytest.approx(300.0)
    figure = drawn("scene", picture)
    assert len(figure.axes) == 2
    main, close = figure.axes
    assert "ball (see a)" in [text.get_text() for text in main.texts]
    assert close.get_title(loc="left") == "(a) ball\n○ 300 s: 20 m apart"
    assert close.get_ylabel() == "Position z (m)"
    assert_well_drawn(figure)


def test_moving_sets_and_the_chaser_bear_the_same_times(picture):
    texts = [text.get_text() for text in drawn("scene", picture).axes[0].texts if text.get_color() == RED]
    names, times = zip(*(text.split(", ") for text in texts if text.endswith(" s")), strict=True)
    assert 2 <= len(times) <= 6 and all(times.count(t) == 2 for t in times)
    assert names.count("trolley") == names.count("chaser") == len(times) / 2
    assert f"trolley, {picture.approach(picture.obstacles[1]).time:.3g} s" in texts


def inside(points, outline, slack=1e-9):
    edge = np.roll(outline, -1, axis=0) - outline
    gap = points[:, None] - outline
    return np.all(edge[:, 0] * gap[..., 1] - edge[:, 1] * gap[..., 0] >= -slack, axis=1)


def test_tube_outlines_contain_the_tube():
    tube, rng = schedule_plot_data(synthesised()[1]).tube, np.random.default_rng(1)
    outlines = polygon(
        tube_support(tube.centre, tube.generators, tube.intersample, 3, directions()), directions()
    )
    q = tube.intersample.shape[1]
    edges = np.unique(np.linspace(0, q, 4).astype(int))
    for k, part in itertools.product((0, 5, 11), range(3)):
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
            for share, contained in ((0.999, True), (1.1, False)):
                offset = middle + share * (outline - middle) - place[flat]
                within = recoverable.contains(step * q + part, state - xi + offset @ lift)
                assert within.all() if contained else not within.any()


def test_slices_contain_the_chaser_of_every_run():
    schedule = synthesised()[1]
    flights = {key: item.flights for key, item in flown().items()}
    assert len(flights["polaris"].labels) > 3
    assert_slices_are_of_their_instants(schedule, schedule_plot_data(schedule, flights))


@pytest.mark.parametrize(
    "seed", [1, *(pytest.param(i, marks=pytest.mark.slow) for i in range(2, fewer(60, 16)))]
)
def test_slices_of_random_scenes_are_of_their_instants(seed, tmp_path):
    try:
        schedule = random_schedule(seed, tmp_path)[1]
    except PolarisError:
        assert seed != 1, "or nothing is looked at"
        pytest.skip("refused")
    picture = schedule_plot_data(schedule)
    assert_slices_are_of_their_instants(schedule, picture)
    for t, _, place, outline in picture.printed_slices():
        i = int(np.argmin(np.abs(picture.safe_path()[0] - t)))
        np.testing.assert_allclose(picture.safe_path()[1][i], place, rtol=1e-12)
        if picture.system.d > 1:
            assert inside(place[None, picture.frame.flat], outline, 1e-9 * np.ptp(outline)).all()


def test_a_path_is_drawn_under_the_mode_that_flew_it():
    path, flags = np.arange(7.0)[:, None] * [1.0, 2.0], np.array([True, False, True, True, False, True])
    drawn = under_mode(path, flags)[:, 0]
    np.testing.assert_array_equal(drawn, [0, 1, np.nan, 2, 3, 4, np.nan, 5, 6, np.nan])
    assert stretches(flags) == [(0, 1), (2, 4), (5, 6)] and stretches([]) == []
