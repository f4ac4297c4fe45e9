"""Figures: drawn from files, readable at column width, nothing covered, the same bytes every time."""

from dataclasses import replace

import matplotlib
import numpy as np
import pytest
from matplotlib.text import Text

from polaris.figures import _FIGURES, NAMES, draw_figures, plot_reference, plot_schedule
from polaris.figures.geometry import directions, faces, flat_outline, polygon, stretches, tube_polygons
from polaris.figures.picture import Picture, picture_of, picture_of_safety, recoverable_slices, tube_of
from polaris.figures.scene import under_mode
from polaris.figures.style import MODE_COLOURS, Frame, input_labels, new_figure, style
from polaris.figures.timelines import limit_group
from polaris.hill import clohessy_wiltshire
from polaris.obstacles import BallObstacle, BoxObstacle, KeepInCone, SatelliteObstacle
from polaris.planning.goals import Box, EllipticalNMT
from polaris.reference import Reference
from polaris.system import LinearSystem
from reach.zonotope import Zonotope

from .tiny import flown, synthesised


@pytest.fixture(scope="module")
def picture():
    schedule = synthesised()[1]
    return replace(picture_of(schedule), flights={key: item.flights for key, item in flown().items()})


def drawn(name, picture):
    with style():
        figure = _FIGURES[name](picture, new_figure)
        figure.draw_without_rendering()
    return figure


# -- what a reader sees -------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_column_width_and_type_of_at_least_7_points(picture, name):
    figure = drawn(name, picture)
    assert figure.get_figwidth() == 3.5
    sizes = [text.get_fontsize() for text in figure.findobj(Text) if text.get_text()]
    assert sizes and min(sizes) >= 7


@pytest.mark.parametrize("name", ["scene", "distance", "margin"])
def test_legends_cover_no_data(picture, name):
    figure = drawn(name, picture)
    for ax in figure.axes:
        legend = ax.get_legend().get_window_extent()
        assert legend.y0 >= ax.get_window_extent().y1 - 1
        assert legend.x1 <= figure.bbox.x1 + 1 and legend.y1 <= figure.bbox.y1 + 1


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
    assert "pillar" in texts and "trolley, 0 to 12 s" in texts
    upper, lower = drawn("distance", picture).axes
    assert upper.get_ylabel() == "Distance (m)" and lower.get_xlabel() == "Time (s)"


def test_hills_frame_is_along_track_to_the_right_and_radial_up():
    frame = Frame.of(clohessy_wiltshire(0.0012, 10.0, 0.1))
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
    assert {"input 0", "input 1"} < set(plane.recoverable.names)


def test_limits_of_one_keep_in_set_are_one_name():
    assert limit_group("cone[3]") == limit_group("cone[11]") == "cone"


# -- files ------------------------------------------------------------------------------------------


def test_files_hold_no_dates_and_are_the_same_twice(picture, tmp_path, monkeypatch):
    names = ("scene", "scene_3d", "margin")
    monkeypatch.setattr("polaris.figures.NAMES", names)
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    first, second = draw_figures(picture, tmp_path / "a"), draw_figures(picture, tmp_path / "b")
    assert [path.name for path in first] == [f"{name}.{end}" for name in names for end in ("pdf", "png")]
    for a, b in zip(first, second, strict=True):
        assert a.read_bytes() == b.read_bytes()
        assert b"CreationDate" not in a.read_bytes() and b"tIME" not in a.read_bytes()


def test_pdfs_embed_truetype_fonts_whose_text_can_be_searched(picture, tmp_path, monkeypatch):
    monkeypatch.setattr("polaris.figures.NAMES", ("modes",))
    draw_figures(picture, tmp_path)
    plain = (tmp_path / "modes.pdf").read_bytes()
    assert b"/FontFile2" in plain and b"/ToUnicode" in plain and b"/Type3" not in plain
    assert b"PolarisSans" in plain and b"DejaVuSans" not in plain
    # A letter that the light font lacks comes from the full one.
    draw_figures(replace(picture, controllers=("safety", "\N{CYRILLIC CAPITAL LETTER ZHE}")), tmp_path)
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
    monkeypatch.setattr("polaris.figures.NAMES", ("scene", "scene_3d"))
    draw_figures(picture, tmp_path)
    assert calls == ["execute", "draw", "draw", "draw", "draw"]


def test_the_users_settings_come_back(picture):
    before = dict(matplotlib.rcParams)
    drawn("modes", picture)
    assert dict(matplotlib.rcParams) == before


# -- drawing from results ---------------------------------------------------------------------------


def test_plots_go_into_given_axes_and_new_ones():
    from matplotlib import pyplot
    from matplotlib.figure import Figure

    schedule = synthesised()[1]
    ax = Figure().add_subplot()
    assert plot_reference(schedule.safety, ax) is ax and schedule.plot(Figure().add_subplot()).texts
    pyplot.switch_backend("agg")
    try:
        assert plot_schedule(schedule).figure.get_figwidth() == 3.5
    finally:
        pyplot.close("all")


def test_reference_alone_has_no_modes():
    picture = picture_of_safety(synthesised()[1].safety)
    assert len(picture.modes) == 0 and picture.tube is None and picture.slices is not None


def bare(system, obstacles, goal, chi0, delta=30.0, steps=20):
    """A picture with no more than a free path."""
    reference = Reference.propagate(system, delta, np.array(chi0, dtype=float), np.zeros((steps, system.m)))
    return Picture(
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
    assert {"debris", "sight (stay inside)", "ball (out of plane)"} <= set(texts)
    assert any(text.startswith("visitor, ") for text in texts)
    assert len(drawn("scene_3d", picture).axes[0].collections) >= 3


def test_scene_on_the_line_is_drawn_over_time(tmp_path):
    system = LinearSystem(
        np.array([[0, 1], [0, 0]]), np.array([[0], [1]]), np.array([[0], [1]]), np.array([1.0])
    )
    goal = Box(np.array([8.0, 0.0]), np.array([1.0, 1.0]))
    picture = bare(system, [BoxObstacle("wall", [20.0], [1.0])], goal, [0.0, 0.2], 1.0)
    ax = drawn("scene", picture).axes[0]
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("Time (s)", "Position x (m)")


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
    tube, rng = tube_of(synthesised()[1]), np.random.default_rng(1)
    outlines = tube_polygons(tube.centre, tube.generators, tube.bow, parts=3)
    q = tube.bow.shape[1]
    edges = np.unique(np.linspace(0, q, 4).astype(int))
    for k in (0, 5, 11):
        for part in range(3):
            for node in range(edges[part], edges[part + 1] + 1):
                signs = rng.uniform(-1, 1, (20, tube.generators.shape[-1]))
                points = tube.centre[k, node] + signs @ tube.generators[k, node].T
                assert inside(points, outlines[k, part]).all()


def test_slices_end_at_the_boundary_of_the_recoverable_sets():
    safety = synthesised()[1].safety
    slices = recoverable_slices(safety, [0, 4])
    q = safety.tracking.feedback.nodes_per_cell
    for k, outline in zip((0, 4), slices.outline, strict=True):
        errors = np.hstack([outline, np.zeros_like(outline)])
        assert safety.recoverable.contains(k * q, errors * 0.999).all()
        assert not safety.recoverable.contains(k * q, errors * 1.2).any()


def test_a_path_is_drawn_under_the_mode_that_flew_it():
    flown, flags = np.arange(7.0)[:, None] * [1.0, 2.0], np.array([True, False, True, True, False, True])
    drawn = under_mode(flown, flags)[:, 0]
    np.testing.assert_array_equal(drawn, [0, 1, np.nan, 2, 3, 4, np.nan, 5, 6, np.nan])
    assert stretches(flags) == [(0, 1), (2, 4), (5, 6)] and stretches([]) == []


def test_outline_and_faces_of_a_cube():
    corners = np.array(np.meshgrid([0, 1], [0, 1], [0, 1])).reshape(3, -1).T.astype(float)
    assert sorted(map(len, faces(corners))) == [4] * 6
    assert len(flat_outline(np.vstack([corners[:, :2], [[0.5, 0.5]]]))) == 4
    assert faces(corners[:, [0, 1, 1]]) == []
