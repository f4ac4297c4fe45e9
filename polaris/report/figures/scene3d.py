"""The scene in space; for motion in a plane, time is the third axis."""

from itertools import product
from typing import Any

import numpy as np
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import proj3d
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from ...model.system import Array
from ...runs.picture import Picture
from ..scene.geometry import closed, faces, gapped
from ..scene.items import Item, Scene, alone, by_mode
from ..scene.palette import BLACK, GREEN, GREY, LOOKS, RED, mode_colour, tint
from ..scene.scene import describe, over_time
from .cuts import OUT_OF_FRAME
from .labels import name
from .style import DASHES, DOTS, GOAL_DASHES, LONG, legend_rows, new_figure, shortened, text_width

USUAL = 0.3  # width of ticks for which the margins have room [in]
MARGINS, BELOW = (0.25, 0.62), 0.5  # room beside the box and below it for ticks and labels [in]
HIGHEST, NARROW = 2.2, 2.4  # of a box as it is drawn: greatest height; width with room for two ticks [in]


def scene_3d_figure(picture: Picture) -> Any:
    """A figure of the scene in space; none of motion on a line."""
    if picture.system.d == 1:
        return None
    space = picture.system.d == 3
    figure = new_figure(2.5)
    figure.set_layout_engine(None)
    ax = figure.add_axes((0, 0, 1, 1), projection="3d", computed_zorder=False)
    scene = describe(picture, axes=list(picture.frame.axes)) if space else over_time(picture)
    _paths(ax, scene)
    for item in scene.items:
        if item.role == "unsafe":
            _solids(ax, item, scene)
        elif item.role == "sides":
            _sides(ax, item, scene)
    _goal(ax, scene)
    more = frame_axes(ax, scene.labels, scene.low, scene.high)
    size = scene.high - scene.low
    ax.view_init(elev=24, azim=-58)
    handles, _ = ax.get_legend_handles_labels()
    columns, names = legend_rows(handles, figure.get_figwidth(), 2)
    figure.legend(handles, names, loc="upper left", ncols=columns)
    top = 0.15 * -(-len(names) // columns) + 0.1
    fit_box(ax, size if space else np.array([1, np.clip(size[1] / size[0], 0.4, 1.2), 0.7]), top, more)
    return figure


def fit_box(ax: Any, size: Array, top: float, more: Array) -> None:
    """Fit the box of axes in space, of some proportions, into the figure, with room for its labels.

    The figure becomes as high as that takes, `top` [in] for a legend and `more` (3,) for wide ticks included.
    """
    figure = ax.figure
    (left, right), bottom, width = MARGINS, BELOW + 1.6 * float(more[:2].max()), figure.get_figwidth()
    right += float(more[2])
    zoom = 1.0
    for _ in range(4):
        ax.set_box_aspect(size, zoom=zoom)
        ax.apply_aspect()
        x, y, _ = proj3d.proj_transform(
            *np.array(list(product(*zip(*_limits(ax), strict=True)))).T, ax.get_proj()
        )
        corners = ax.transData.transform(np.column_stack([x, y])) / figure.dpi
        extent = np.ptp(corners, axis=0)
        zoom *= float(min((width - left - right) / extent[0], HIGHEST / extent[1]))
    if extent[0] < NARROW:
        for axis in (ax.xaxis, ax.yaxis):
            axis.get_major_locator().set_params(nbins=2)
    if extent[0] < NARROW or more[:2].any():  # ticks of two axes meet at a corner
        end = ax.get_xlim()[1] - 0.2 * np.ptp(ax.get_xlim())
        ax.set_xticks([tick for tick in ax.get_xticks() if ax.get_xlim()[0] <= tick <= end])
    low = corners.min(axis=0)
    height = bottom + extent[1] + top
    square = ax.get_position(original=True).size * figure.get_size_inches()
    corner = np.array([left + (width - left - right - extent[0]) / 2, bottom]) - low
    figure.set_figheight(height)
    ax.set_position((*(corner / (width, height)), *(square / (width, height))))


def _limits(ax: Any) -> Array:
    return np.array([ax.get_xlim(), ax.get_ylim(), ax.get_zlim()]).T


def frame_axes(ax: Any, labels: Any, low: Array, high: Array) -> Array:
    """Set limits, labels and few ticks of axes in space; returns what wide ticks take beyond others [in]."""
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    more = np.zeros(3)
    for k, (axis, label) in enumerate(zip("xyz", labels, strict=True)):
        ticks = getattr(ax, f"{axis}axis")
        ticks.set_major_locator(MaxNLocator(4 if axis == "x" else 3))
        texts = ticks.get_major_formatter().format_ticks(ticks.get_majorticklocs())
        more[k] = max(max(map(text_width, texts)) - USUAL, 0.0) * (1.0 if axis == "z" else 0.5)
        pad = (-3 if axis == "z" else -2) + 48 * more[k]
        getattr(ax, f"set_{axis}label")(label, fontsize=7, labelpad=pad)
        ax.tick_params(axis=axis, labelsize=7, pad=-2 if axis == "z" else -3)
        ticks.set_pane_color((1, 1, 1, 0))
        ticks.line.set_linewidth(0.5)
        ticks._axinfo["grid"].update(color="#E4E4E4", linewidth=0.4)  # there is no public way
    return more


def _line(ax: Any, scene: Scene, points: Array, label: str, **look: Any) -> None:
    """Draw a line as far as it is in the box, and mark where it leaves."""
    slack = 1e-9 * (scene.high - scene.low)
    inside: Any = np.all((points >= scene.low - slack) & (points <= scene.high + slack), axis=1)
    if not inside.any():
        return
    ax.plot(*np.where(inside[:, None], points, np.nan).T, label=label, **look)
    known: Any = np.isfinite(points).all(axis=1)
    cut = inside & (np.append(~inside[1:] & known[1:], False) | np.append(False, ~inside[:-1] & known[:-1]))
    if cut.any():
        label = "_" if any(one.get_label() == OUT_OF_FRAME for one in ax.lines) else OUT_OF_FRAME
        ax.plot(*points[cut].T, "D", ms=2, color=look["color"], label=label, gid="cut")


def _paths(ax: Any, scene: Scene) -> None:
    for item in scene.of("reference", "tail"):
        colour, width = (GREY, 1.0) if item.role == "reference" else (tint(GREY, 0.6), 0.7)
        _line(ax, scene, item.points, LOOKS[item.role].legend, ls=DOTS, color=colour, lw=width)
    for one in alone(scene.picture):
        path = scene.placed(scene.picture.positions(one.flights), one.flights.times)
        _line(ax, scene, path, one.short, color=one.colour, lw=0.9, ls=DASHES)
    flown = scene.flown("polaris")
    if flown is not None:
        for mode, piece in by_mode(scene.picture, flown).items():
            _line(ax, scene, piece, f"under {scene.picture.mode_name(mode)}", color=mode_colour(mode), lw=1.5)
    start = scene.safe_path()[:1]
    ax.scatter(*start[0], color=BLACK, s=8, depthshade=False)
    name(ax, "start", start, BLACK)


def _goal(ax: Any, scene: Scene) -> None:
    label = "goal"
    for shape in (item.shape for item in scene.of("goal")):
        if shape is None or not _seen(shape.points, scene):
            continue
        points = shape.points
        if shape.kind in ("mesh", "area"):
            drawn = faces(points) if shape.kind == "mesh" else [points]
            points = gapped(map(closed, drawn), 3)
        look: dict[str, Any] = {"lw": 0.8, "ls": GOAL_DASHES}
        if shape.kind == "points":
            look = {"marker": "*", "ls": "none"}
        ax.plot(*points.T, color=GREEN, label=label, **look)
        label = "_"


def _solids(ax: Any, item: Item, scene: Scene) -> None:
    """A set at some instants, the most important one strongest."""
    shown = [mark.shape for mark in item.marks if _seen(mark.shape.points, scene)][::-1]
    for strength, shape in zip(np.linspace(1 / max(len(shown), 1), 1, len(shown)), shown, strict=True):
        polygons = faces(shape.points)
        edge = (*tint(RED, float(strength)), 0.8) if len(polygons) < 50 else "none"  # not of what is round
        face = (*tint(RED, 0.7), (0.12 if item.cut else 0.28) * float(strength))
        many = Poly3DCollection(polygons, linewidth=0.35, facecolor=face, edgecolor=edge)
        ax.add_collection3d(many, autolim=False)
    if shown:
        name(
            ax, shortened(item.name, 1.5) + (f" ({OUT_OF_FRAME})" if item.cut else ""), shown[-1].points, RED
        )


def _sides(ax: Any, item: Item, scene: Scene) -> None:
    """Edges of a keep-in set."""
    if item.shape is not None and _seen(item.points, scene):
        ax.plot(*item.points.T, color=RED, lw=0.6, alpha=0.6, ls=LONG)
        name(ax, shortened(item.name.removesuffix(": its sides"), 1.5) + " (stay inside)", item.points, RED)


def _seen(points: Array, scene: Scene) -> bool:
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    return bool(np.all(high >= scene.low) and np.all(low <= scene.high))
