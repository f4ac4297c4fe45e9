"""The scene in the plane of motion: the paper's Figure 2, and close-ups where the plane does not tell.

A moving set is drawn at the closest approach and once before and after, on its dotted way; each time is
written at the set and at the chaser's place. Dashed: keep-in sets, and sets that the plane does not show to
be passed. A thin line about another satellite holds all places where it may be.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, PathPatch, Polygon
from matplotlib.path import Path

from ...model.system import Array
from ...runs.plot_data import PlotData, taking_over
from ..scene.geometry import closed
from ..scene.items import Item, Scene, alone
from ..scene.palette import BLACK, DARK_OLIVE, DULL_RED, GREEN, GREY, LOOKS, OLIVE, RED, mode_colour, tint
from ..scene.scene import describe
from . import style
from .closeups import LETTERS, draw_closeup
from .cuts import mark_cuts
from .labels import name
from .style import DASHES, DOTS, GOAL_DASHES, LONG, WIDTH, draw_safe_path, new_figure, shortened

AXES_WIDTH = 2.8  # of the axes [in]


def scene_figure(picture: PlotData, new: Callable[[float], Any] = new_figure) -> Any:
    """A figure of the scene with the close-ups it needs; `new` makes an empty one of some height [in]."""
    scene = describe(picture)
    closeups = scene.closeups
    columns = 1 if len(closeups) == 1 else 2
    rows = -(-len(closeups) // columns)
    figure = new(3.0)
    # One close-up is as wide as the figure.
    panel = 1.15 if columns == 2 else 1.3
    grid = figure.add_gridspec(1 + rows, columns, height_ratios=[3.0, *[panel] * rows])
    ax, handles = figure.add_subplot(grid[0, :]), []
    for i, one in enumerate(closeups):
        last = columns == 2 and i == len(closeups) - 1 and i % 2 == 0
        place = grid[1 + i // columns, :] if last else grid[1 + i // columns, i % columns]
        width = 2.8 if columns == 1 or last else 1.25
        panel_ax = figure.add_subplot(place)
        handles += draw_closeup(panel_ax, picture, one, LETTERS[i], panel / width, width)
    top = draw_scene(ax, scene, handles, lettered=True)
    main = 2.9 / 3.5 * WIDTH * _aspect(scene)
    grid.set_height_ratios([main + 0.45 + top, *[panel + 0.75] * rows])
    figure.set_figheight(main + 0.58 + top + rows * (panel + 0.75))
    style.keep_ticks(figure.axes)
    return figure


def draw_scene(ax: Any, scene: Scene, handles: Sequence[Any] = (), lettered: bool = False) -> float:
    """Draw all in the plane or over time, and a legend, of `handles` too; return the legend's height [in]."""
    frame_axes(ax, scene)
    ax.set(xlabel=scene.labels[0], ylabel=scene.labels[1])
    ax.grid(True)
    drawers: tuple[Callable[..., list[Any]], ...] = (_slices, _tube, _goal, _paths)
    drawn = [handle for draw in drawers for handle in draw(ax, scene)]
    for item in scene.with_roles("initial"):
        if not scene.over_time:
            _outline(ax, item.points, 0.6, "-", BLACK, 5)
        else:
            ax.plot(*item.points.T, color=BLACK, lw=3, clip_on=False, zorder=6)
    drawn += draw_unsafe(ax, scene, lettered)
    slices = scene.picture.printed_slices() if not scene.over_time else ()
    for one in sorted(slices, key=lambda one: np.prod(np.ptp(one.outline, axis=0))):  # least space first
        colour = DARK_OLIVE if one.mode is None else mode_colour(one.mode)
        if len(scene.visible(one.outline)):
            label(ax, scene, taking_over(one.time, one.mode), one.outline, colour)
    system = scene.picture.system
    if system.mean_motion is not None:
        ax.plot(0, 0, marker="+", color=BLACK, ms=5, mew=0.8, zorder=6)
        origin = np.zeros(system.d)
        near = [obstacle.signed_distance(0.0, origin, system) for obstacle in scene.picture.obstacles]
        # Else an unsafe set round the target has its own name there.
        if np.all(np.array(near) > 0) and scene.contains(np.zeros(2)):
            label(ax, scene, "target", np.zeros((1, 2)), BLACK)
    drawn += mark_cuts(ax)
    return style.legend_above(ax, list({one.get_label(): one for one in (*drawn, *handles)}.values()), 3)


def frame_axes(ax: Any, scene: Scene) -> None:
    """Give axes the limits of a scene; one scale serves both, unless one of them is time."""
    if not scene.over_time:
        ax.set_aspect("equal")
    (x0, y0), (x1, y1) = scene.low, scene.high
    ax.set(xlim=(x0, x1), ylim=(y0, y1))


def label(ax: Any, scene: Scene, text: str, points: Array, colour: str, beside: bool = False) -> None:
    """Write a name at the part of an outline (or a point) that is in view."""
    name(ax, text, np.clip(points, scene.low, scene.high), colour, beside)


def _slices(ax: Any, scene: Scene) -> list[Any]:
    """Recoverable sets at the hand-overs, with the chaser in them, rimmed in the colour of who takes over."""
    look, slices, printed = LOOKS["slice"], scene.picture.slices, list(scene.picture.printed_slices())
    colour, edge = tint(look.colour, 0.28), tint(OLIVE, 0.5)
    if slices is not None and scene.over_time:
        ends = slices.outlines[:, 0, :, 0]
        low, high = ends.min(axis=1), ends.max(axis=1)
        colour = edge = tint(look.colour, 0.6)
        ax.vlines(slices.times, low, high, color=colour, lw=1.0, zorder=1)
        in_view = bool(np.any((high > scene.low[1]) & (low < scene.high[1])))
    else:
        outlines = [one.outline for one in printed]
        ax.add_collection(PolyCollection(outlines, facecolor=colour, edgecolor="none", zorder=1))
        in_view = any(len(scene.visible(outline)) for outline in outlines)
    for one in printed:
        rim, instant = edge if one.mode is None else mode_colour(one.mode), np.array([one.time])
        outline = one.outline
        if scene.over_time:
            outline = np.column_stack([np.repeat(instant, len(outline)), outline])
        _outline(ax, outline, 0.35 if one.mode is None else 0.7, "-", rim, 1.1)
        at = scene.placed(one.place[None], instant)
        ax.plot(*at.T, "o", ms=2.6, mfc=look.colour, mec=DARK_OLIVE, mew=0.6, zorder=6)
    if not in_view:
        return []
    chaser = style.dot("o", look.colour, 2.6, "chaser at hand-over", mec=DARK_OLIVE, mew=0.6)
    return [Patch(facecolor=colour, edgecolor=edge, lw=0.35, label=look.legend), *[chaser] * bool(printed)]


def _tube(ax: Any, scene: Scene) -> list[Any]:
    """The tube by mode; the handle is of the mode that can be seen best beside the path."""
    handles: dict[int, Any] = {}
    inch = (scene.high - scene.low) / AXES_WIDTH / (1, _aspect(scene))
    for item in scene.with_roles("tube"):
        outlines = np.stack([shape.points for shape in item.shapes if shape])
        for mode in np.unique(scene.picture.modes):
            chosen = outlines[item.modes == mode]
            colour = tint(mode_colour(int(mode)), 0.3)
            together = Path.make_compound_path_from_polys(chosen)
            patch = PathPatch(together, facecolor=colour, edgecolor=colour, lw=0.2, zorder=2)
            ax.add_artist(patch)  # not add_patch, which would go through every corner for its limits
            size = np.ptp(chosen, axis=1) / inch
            visible = int(np.sum((size[:, 1] if scene.over_time else size.min(axis=1)) > 4 / 72))
            if visible:  # else hidden under the path
                handles[visible] = Patch(facecolor=colour, label=LOOKS["tube"].legend)
    return [handles[max(handles)]] if handles else []


def _aspect(scene: Scene) -> float:
    """Height over width of axes on paper: one scale serves both, or they have a shape of their own."""
    x, y = scene.high - scene.low
    return 0.6 if scene.over_time else float(y / x)


def _goal(ax: Any, scene: Scene) -> list[Any]:
    """The goal as far as it is in view, on the line if it all is; a handle if it is."""
    over, handles, shapes = scene.over_time, list[Any](), [item.shape for item in scene.with_roles("goal")]
    line: dict[str, Any] = {"color": GREEN, "lw": 3 if over else 0.7, "ls": "-" if over else GOAL_DASHES}
    star: dict[str, Any] = {"marker": "*", "color": GREEN, "ls": "none"}
    order: dict[str, Any] = {"zorder": 6 if over else 2.5, "clip_on": not over}
    for shape in filter(None, shapes):
        points = closed(shape.points) if shape.kind == "area" else shape.points
        inside = np.all((points >= scene.low) & (points <= scene.high))
        if over and not inside:
            continue
        if shape.kind == "points":
            ax.plot(*points[0], **star, **order | {"zorder": 5.5}, ms=12, mec="white", mew=0.4)
        else:
            ax.plot(*points.T, **line, **order)
        if not handles and (inside or len(scene.visible(points))):
            look = star | {"ms": 6} if shape.kind == "points" else line
            legend = "goal ring" if len(shapes) == 2 else LOOKS["goal"].legend
            handles.append(Line2D([], [], label=legend, **look))
    return handles


def _outline(
    ax: Any, outline: Array, width: float, dashes: Any, edge: Any, order: float, face: Any = "none"
) -> None:
    ax.add_patch(Polygon(outline, facecolor=face, edgecolor=edge, lw=width, ls=dashes, zorder=order))


def _paths(ax: Any, scene: Scene) -> list[Any]:
    """Reference, U alone, and the trajectory under Polaris coloured by mode."""
    handles = []
    looks: dict[str, dict[str, Any]] = {
        "reference": {"color": GREY, "lw": 1.1, "ls": DOTS},
        "tail": {"color": tint(GREY, 0.6), "lw": 0.7, "ls": DOTS},
    }
    for item in scene.with_roles(*looks):
        ax.plot(*item.points.T, zorder=4.5 if item.role == "reference" else 2.6, **looks[item.role])
        if scene.contains(item.points).sum() > 1:
            handles.append(Line2D([], [], label=LOOKS[item.role].legend, **looks[item.role]))
    for one in alone(scene.picture):
        look: dict[str, Any] = {"color": one.colour, "lw": 0.9, "ls": DASHES}
        path = scene.placed(scene.picture.positions(one.flights), one.flights.times)
        ax.plot(*path.T, zorder=3.5, **look)
        if scene.contains(path).sum() > 1:
            handles.append(Line2D([], [], label=one.short, **look))
    picture, safe_path = scene.picture, scene.safe_path()
    for mode in draw_safe_path(ax, picture, safe_path):
        look = {"color": mode_colour(mode), "lw": 1.5}
        handles.append(Line2D([], [], label=f"under {picture.mode_name(mode)}", **look))
    if not scene.over_time:
        for text, marker, place in (("start", "o", safe_path[0]), ("end", "s", safe_path[-1])):
            ax.plot(*place, marker=marker, color=BLACK, ms=2.6, zorder=6)
            label(ax, scene, text, place[None], BLACK)
    return handles


def draw_unsafe(ax: Any, scene: Scene, lettered: bool = False, named: bool = True) -> list[Any]:
    """Draw every unsafe set and keep-in set, perhaps with its name; a handle of covers, if there are any."""
    covered = False
    for item in scene.items:
        if item.role == "unsafe" and scene.over_time:
            _outline(ax, item.points, 0.6, "-", RED, 3, tint(RED, 0.45))
            for mark in item.marks:
                label(ax, scene, shortened(item.name, 1.5), mark.shape.points, RED)
        elif item.role == "unsafe":
            covered |= _unsafe(ax, scene, item, lettered, named)
        elif item.role == "keep_in":
            _keep_in(ax, scene, item, named)
    return [Line2D([], [], color=DULL_RED, lw=0.7, label=LOOKS["cover"].legend)] if covered else []


def _unsafe(ax: Any, scene: Scene, item: Item, lettered: bool, named: bool) -> bool:
    """Draw one set at some instants, the most important one first; True if a cover is drawn about it."""
    covered = False
    aside = len(item.passages) > 0
    letters = ", ".join(LETTERS[i] for i in item.passages)
    note = "" if not aside else f" (see {letters})" if lettered else " (out of plane)"
    for mark in item.marks:
        first, outline = mark is item.marks[0], mark.shape.points
        around = np.all((outline.min(axis=0) < scene.low) & (outline.max(axis=0) > scene.high))
        if not len(scene.visible(outline)) and (aside or not around):
            continue  # out of view; or passed out of the plane, and all of the view
        edge = tint(RED, 1.0 if first else 0.5)
        if aside:
            _outline(ax, outline, 0.7, LONG, edge, 1.5)
        else:
            _outline(ax, outline, 0.0, "-", "none", 1.5, tint(RED, 0.45 if first else 0.2))
            _outline(ax, outline, 0.6, "-", edge, 1.6)
        if mark.cover is not None:
            _outline(ax, mark.cover, 0.7, "-", DULL_RED, 1.6)
            covered |= len(scene.visible(mark.cover)) > 1
        parts = [shortened(item.name, 1.5), mark.caption]
        if named:
            label(ax, scene, ", ".join(filter(None, parts)) + (note if first else ""), outline, RED)
    if item.path is not None:
        ax.plot(*item.path.T, color=tint(RED, 0.6), lw=0.6, ls=(0, (1, 2)), zorder=1.4)
    for mark in item.marks:
        if mark.place is not None and scene.contains(mark.place):
            ax.plot(*mark.place, "o", ms=3, mfc="white", mec=RED, mew=0.7, zorder=6)
            if named:
                label(ax, scene, f"chaser, {mark.caption}", mark.place[None], RED)
    return covered


def _keep_in(ax: Any, scene: Scene, item: Item, named: bool) -> None:
    """Draw a keep-in set and write its name at the line, as far as it is in view."""
    if item.shape is not None:
        ax.plot(*item.points.T, color=RED, lw=0.8, ls=LONG, zorder=3 if item.marks else 1.6)
    title, _, inside = item.name.rpartition(" (")
    text = f"{shortened(title, 1.5)} ({inside}" + "".join(mark.caption for mark in item.marks)
    points = item.marks[0].shape.points if item.marks else scene.visible(item.points[:-1])
    if named and len(points):
        label(ax, scene, text, points, RED, beside=True)
