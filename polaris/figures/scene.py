"""The scene in the plane of motion: the paper's Figure 2, and close-ups where the plane does not tell."""

from __future__ import annotations

from typing import Any

import numpy as np

from .closeups import CloseUp, closeups, draw_closeup, seconds
from .geometry import flat_outline, tube_polygons, zonotope_outline
from .line import draw_line_scene
from .paths import DASHES, DOTS, draw_safe_path
from .picture import Picture
from .space import Space, position_set
from .style import BLACK, GREEN, GREY, ORANGE, WIDTH, YELLOW, keep_ticks, legend_above, mode_colour, tint
from .unsafe import draw_unsafe
from .view import View

GOAL_DASHES = (0, (4, 2))


def scene_figure(new_figure: Any, picture: Picture) -> tuple[Any, Any]:
    """A figure of the scene with the close-ups it needs, no higher than they ask for; and its main axes."""
    found = closeups(picture)
    wide = 1 if len(found) == 1 else 2
    rows = -(-len(found) // wide)
    figure = new_figure(3.0)
    # One close-up is as wide as the figure.
    panel = 1.15 if wide == 2 else 1.3
    heights = [3.0, *[panel] * rows]
    grid = figure.add_gridspec(1 + rows, wide, height_ratios=heights)
    ax = figure.add_subplot(grid[0, :])
    top = draw_scene(ax, picture, found)
    for i, one in enumerate(found):
        last = wide == 2 and i == len(found) - 1 and i % 2 == 0
        place = grid[1 + i // wide, :] if last else grid[1 + i // wide, i % wide]
        across = 2.8 if wide == 1 or last else 1.25
        draw_closeup(figure.add_subplot(place), picture, one, LETTERS[i], panel / across, across)
    (x0, x1), (y0, y1) = ax.get_xlim(), ax.get_ylim()
    main = 2.9 / 3.5 * WIDTH * ((y1 - y0) / (x1 - x0) if ax.get_aspect() == 1.0 else 0.6)
    grid.set_height_ratios([main + 0.45 + top, *[panel + 0.75] * rows])
    figure.set_figheight(main + 0.58 + top + rows * (panel + 0.75))
    keep_ticks(figure.axes)
    return figure, ax


LETTERS = "abcdef"


def draw_scene(ax: Any, picture: Picture, found: list[CloseUp] | None = None) -> float:
    """Draw everything in the plane of motion; on the line, position over time. Height of the legend [in].

    Parameters
    ----------
    ax : matplotlib axes
    picture : Picture
    found : list of CloseUp, optional
        Close-ups drawn beside it, in the order of their letters; by default there are none.
    """
    if picture.system.d == 1:
        return draw_line_scene(ax, picture)
    frame, space = picture.frame, Space.of(picture)
    view = View.of(space)
    ax.set_aspect("equal")
    ax.set(xlim=view.x, ylim=view.y, xlabel=frame.labels[0], ylabel=frame.labels[1])
    ax.grid(True)
    handles = [*_sets(ax, picture, view), *_goal(ax, space, view), *_paths(ax, picture, view)]
    letters = None if found is None else {id(one): LETTERS[i] for i, one in enumerate(found)}
    draw_unsafe(ax, space, view, closeups(picture) if found is None else found, letters)
    for t, _, outline in picture.printed_slices():
        if len(view.seen(outline)):
            view.label(ax, f"{seconds(t)} s", view.clip(outline), "#6B6200")
    if picture.system.mean_motion is not None:
        ax.plot(0, 0, marker="+", color=BLACK, ms=5, mew=0.8, zorder=6)
        origin = np.zeros(picture.system.d)
        near = [obstacle.signed_distance(0.0, origin, picture.system) for obstacle in picture.obstacles]
        # Else an unsafe set round the target has its own name there.
        if np.all(np.array(near) > 0) and view.contains(np.zeros(2)):
            view.label(ax, "target", np.zeros((1, 2)), BLACK)
    return legend_above(ax, handles, 2)


def _sets(ax: Any, picture: Picture, view: View) -> list[Any]:
    """Recoverable sets, tube, initial set: drawn lightly. Handles of those that can be seen."""
    from matplotlib.collections import PolyCollection
    from matplotlib.patches import Patch, PathPatch, Polygon
    from matplotlib.path import Path

    handles: list[Any] = []
    axes = picture.frame.flat
    slices = list(picture.printed_slices())
    if slices:
        outlines = [outline for _, _, outline in slices]
        colour, edge = tint(YELLOW, 0.28), tint("#8A7F00", 0.5)
        ax.add_collection(PolyCollection(outlines, facecolor=colour, edgecolor="none", zorder=1))
        ax.add_collection(PolyCollection(outlines, facecolor="none", edgecolor=edge, lw=0.35, zorder=1.1))
        for _, place, _ in slices:
            ax.plot(*place[axes], "o", ms=2.6, mfc=YELLOW, mec="#6B6200", mew=0.6, zorder=6)
        if any(len(view.seen(outline)) for outline in outlines):
            handles.append(Patch(facecolor=colour, edgecolor=edge, lw=0.35, label="recoverable sets"))
    if picture.tube is not None:
        tube = picture.tube
        polygons = tube_polygons(
            tube.centre[..., axes], tube.generators[..., axes, :], tube.bow[..., axes], parts=4
        )
        line = 4 / 72 / view.width * (view.x[1] - view.x[0])  # else hidden under the path
        seen: dict[int, Any] = {}
        for mode in np.unique(picture.modes):
            chosen = polygons[picture.modes == mode].reshape(-1, *polygons.shape[-2:])
            colour = tint(mode_colour(int(mode)), 0.3)
            together = Path.make_compound_path_from_polys(chosen)
            patch = PathPatch(together, facecolor=colour, edgecolor=colour, lw=0.2, zorder=2)
            ax.add_artist(patch)  # not add_patch, which would go through every corner for its limits
            wide = int(np.sum(np.min(np.ptp(chosen, axis=1), axis=1) > line))
            if wide:
                seen[wide] = Patch(facecolor=colour, label="reachable tube, by mode")
        if seen:
            handles.append(seen[max(seen)])
    theta = zonotope_outline(position_set(picture), axes)
    ax.add_patch(Polygon(theta, closed=True, facecolor="none", edgecolor=BLACK, lw=0.6, zorder=5))
    return handles


def _goal(ax: Any, space: Space, view: View) -> list[Any]:
    """The goal as far as it is in view; a handle if it is."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Polygon

    axes = space.picture.frame.flat
    handles: list[Any] = []
    line: dict[str, Any] = {"color": GREEN, "lw": 0.7, "ls": GOAL_DASHES}
    star: dict[str, Any] = {"marker": "*", "color": GREEN, "ls": "none"}
    for part in space.goal():
        flat = part.points[:, axes]
        if part.kind == "point" or np.all(np.ptp(flat, axis=0) == 0):  # a line seen end on, too
            ax.plot(*flat[0], **star, ms=12, mec="white", mew=0.4, zorder=5.5)
            seen, own = view.contains(flat[0]), star | {"ms": 6}
        else:
            if part.kind == "body":
                flat = flat_outline(flat)
                ax.add_patch(
                    Polygon(flat, facecolor="none", edgecolor=GREEN, lw=0.7, ls=GOAL_DASHES, zorder=2.5)
                )
            else:
                ax.plot(*flat.T, **line, zorder=2.5)
            seen, own = len(view.seen(flat)) > 0, line
        if seen and not handles:
            rings = len(space.goal()) == 2
            handles.append(Line2D([], [], label="goal ring" if rings else "goal", **own))
    return handles


def _paths(ax: Any, picture: Picture, view: View) -> list[Any]:
    """Reference, U alone, and the trajectory under Polaris coloured by mode."""
    from matplotlib.lines import Line2D

    axes = picture.frame.flat
    before, after = (path[:, axes] for path in picture.path())
    ax.plot(*before.T, color=GREY, lw=1.1, ls=DOTS, zorder=4.5)
    handles = [Line2D([], [], color=GREY, lw=1.1, ls=DOTS, label="reference")]
    if len(after):
        ax.plot(*after.T, color=tint(GREY, 0.6), lw=0.7, ls=DOTS, zorder=2.6)
    if "experimental" in picture.flights:
        alone = picture.positions(picture.flights["experimental"])[:, axes]
        ax.plot(*alone.T, color=ORANGE, lw=0.9, ls=DASHES, zorder=3.5)
        if view.contains(alone).sum() > 1:
            handles.append(Line2D([], [], color=ORANGE, lw=0.9, ls=DASHES, label="U alone"))
    flown = picture.safe_path()[1][:, axes]
    for mode in draw_safe_path(ax, picture, flown):
        handles.append(
            Line2D([], [], color=mode_colour(mode), lw=1.5, label=f"under {picture.mode_name(mode)}")
        )
    ax.plot(*flown[-1], marker="s", color=BLACK, ms=2.6, zorder=6)
    ax.plot(*flown[0], marker="o", color=BLACK, ms=2.6, zorder=6)
    return handles
