"""The scene in the plane of motion: the paper's Figure 2."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..keep_in import KeepIn
from ..planning.goals import Box, EllipticalNMT, StationaryPoint
from ..system import Array
from .geometry import stretches, tube_polygons, zonotope_outline
from .picture import Picture
from .style import BLACK, GREEN, GREY, ORANGE, RED, YELLOW, legend_above, mode_colour, tint
from .unsafe import draw_unsafe
from .view import View, position_set


def draw_scene(ax: Any, picture: Picture) -> None:
    """Draw everything in the plane of motion; on the line, position over time."""
    if picture.system.d == 1:
        _line_scene(ax, picture)
        return
    frame = picture.frame
    view = View.around(picture)
    ax.set_aspect("equal")
    ax.set(xlim=view.x, ylim=view.y, xlabel=frame.labels[0], ylabel=frame.labels[1])
    ax.grid(True)
    handles = [*_sets(ax, picture), *_goal(ax, picture), *_paths(ax, picture)]
    draw_unsafe(ax, picture, view)
    if picture.system.mean_motion is not None:
        ax.plot(0, 0, marker="+", color=BLACK, ms=5, mew=0.8, zorder=6)
        distances = [
            obstacle.signed_distance(0.0, np.zeros(3), picture.system) for obstacle in picture.obstacles
        ]
        if np.all(np.array(distances) > 0):  # else an unsafe set round the target has its own name there
            view.label(ax, "target", np.zeros((1, 2)), BLACK)
    legend_above(ax, handles, 2)


def _sets(ax: Any, picture: Picture) -> list[Any]:
    """Recoverable sets, tube, initial set: drawn lightly."""
    from matplotlib.collections import PolyCollection
    from matplotlib.patches import Patch, PathPatch, Polygon
    from matplotlib.path import Path

    handles: list[Any] = []
    axes = picture.frame.flat
    if picture.slices is not None:
        outlines = picture.slices.outline + picture.slices.centre[:, None]
        colour, edge = tint(YELLOW, 0.28), tint("#8A7F00", 0.5)
        ax.add_collection(PolyCollection(list(outlines), facecolor=colour, edgecolor="none", zorder=1))
        ax.add_collection(
            PolyCollection(list(outlines), facecolor="none", edgecolor=edge, lw=0.35, zorder=1.1)
        )
        handles.append(Patch(facecolor=colour, edgecolor=edge, lw=0.35, label="recoverable sets (slices)"))
    if picture.tube is not None:
        tube = picture.tube
        polygons = tube_polygons(
            tube.centre[..., axes], tube.generators[..., axes, :], tube.bow[..., axes], parts=4
        )
        for mode in np.unique(picture.modes):
            chosen = polygons[picture.modes == mode].reshape(-1, *polygons.shape[-2:])
            colour = tint(mode_colour(int(mode)), 0.3)
            together = Path.make_compound_path_from_polys(chosen)
            patch = PathPatch(together, facecolor=colour, edgecolor=colour, lw=0.2, zorder=2)
            ax.add_artist(patch)  # not add_patch, which would go through every corner for its limits
        handles.append(Patch(facecolor=tint(GREY, 0.3), label="reachable tube (by mode)"))
    theta = zonotope_outline(position_set(picture), axes)
    ax.add_patch(Polygon(theta, closed=True, facecolor="none", edgecolor=BLACK, lw=0.6, zorder=5))
    return handles


def _goal(ax: Any, picture: Picture) -> list[Any]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Ellipse, Polygon

    goal, axes = picture.goal, picture.frame.flat
    drawn: dict[str, Any] = {
        "edgecolor": GREEN,
        "facecolor": "none",
        "lw": 0.7,
        "ls": (0, (4, 2)),
        "zorder": 2.5,
    }
    line: dict[str, Any] = {"color": GREEN, "lw": 0.7, "ls": (0, (4, 2))}
    if isinstance(goal, EllipticalNMT):
        for b in {goal.inner_semi_minor, goal.outer_semi_minor} - {0.0}:
            ax.add_patch(Ellipse((0, 0), 4 * b, 2 * b, **drawn))
        return [Line2D([], [], label="goal (between ellipses)", **line)]
    if isinstance(goal, StationaryPoint):
        x, y = (picture.system.position @ np.asarray(goal.state))[axes]
        ax.plot(x, y, marker="*", color=GREEN, ms=9, mec="white", mew=0.4, zorder=3.8, ls="none")
        return [Line2D([], [], marker="*", color=GREEN, ls="none", ms=6, label="goal")]
    if isinstance(goal, Box):
        from reach.zonotope import Zonotope

        box = picture.system.position @ Zonotope.box(np.asarray(goal.center), np.asarray(goal.half_widths))
        ax.add_patch(Polygon(zonotope_outline(box, axes), closed=True, **drawn))
        return [Line2D([], [], label="goal", **line)]
    return []


def _paths(ax: Any, picture: Picture) -> list[Any]:
    """Reference, U alone, and the trajectory under Polaris coloured by mode."""
    from matplotlib.lines import Line2D

    axes = picture.frame.flat
    before, after = (path[:, axes] for path in picture.path())
    dots = (0, (1, 1.4))
    ax.plot(*before.T, color=GREY, lw=1.1, ls=dots, zorder=4.5)
    handles = [Line2D([], [], color=GREY, lw=1.1, ls=dots, label="reference")]
    if len(after):
        ax.plot(*after.T, color=tint(GREY, 0.6), lw=0.7, ls=dots, zorder=2.6)
    if "experimental" in picture.flights:
        alone = picture.positions(picture.flights["experimental"])[:, axes]
        dashes = (0, (3, 1.2))
        ax.plot(*alone.T, color=ORANGE, lw=0.9, ls=dashes, zorder=3.5)
        handles.append(Line2D([], [], color=ORANGE, lw=0.9, ls=dashes, label="U alone"))
    if "polaris" in picture.flights:
        flights = picture.flights["polaris"]
        flown = picture.positions(flights)[:, axes]
        per_node = np.repeat(flights.modes, (len(flown) - 1) // len(flights.modes))
        for mode in np.unique(flights.modes):
            colour = mode_colour(int(mode))
            ax.plot(
                *under_mode(flown, per_node == mode).T, color=colour, lw=1.5, zorder=4, solid_capstyle="round"
            )
            handles.append(
                Line2D([], [], color=colour, lw=1.5, label=f"under {picture.mode_name(int(mode))}")
            )
        ax.plot(*flown[-1], marker="s", color=BLACK, ms=2.6, zorder=6)
    else:
        ax.plot(*before[-1], marker="s", color=BLACK, ms=2.6, zorder=6)
    ax.plot(*before[0], marker="o", color=BLACK, ms=2.6, zorder=6)
    return handles


def under_mode(flown: Array, flags: Any) -> Array:
    """The stretches of a path flown under one mode, gaps between them: one line to draw.

    Parameters
    ----------
    flown : ndarray, shape (N+1, d)
    flags : ndarray of bool, shape (N,)
        Whether the mode flies from each point to the next.
    """
    gap = np.full((1, flown.shape[1]), np.nan)
    return np.vstack([part for a, b in stretches(flags) for part in (flown[a : b + 1], gap)])


def _line_scene(ax: Any, picture: Picture) -> None:
    """Position over time, for a system that moves on a line."""
    from matplotlib.lines import Line2D

    delta, parts = picture.reference.delta, 8
    before, _ = picture.path(parts)
    t = (np.arange(picture.planned)[:, None] + np.linspace(0, 1, parts + 1)).ravel() * delta
    ax.plot(t, before[:, 0], color=GREY, lw=1.1, ls=(0, (1, 1.4)), zorder=4.5)
    handles = [Line2D([], [], color=GREY, lw=1.1, ls=(0, (1, 1.4)), label="reference")]
    if "polaris" in picture.flights:
        flights = picture.flights["polaris"]
        flown = picture.positions(flights)[:, 0]
        per_node = np.repeat(flights.modes, (len(flown) - 1) // len(flights.modes))
        for mode in np.unique(flights.modes):
            shown = under_mode(np.column_stack([flights.times, flown]), per_node == mode)
            ax.plot(*shown.T, color=mode_colour(int(mode)), zorder=4)
            handles.append(
                Line2D([], [], color=mode_colour(int(mode)), label=f"under {picture.mode_name(int(mode))}")
            )
    low, high = np.min(before), np.max(before)
    pad = 0.3 * (high - low) + 1e-9
    times = np.linspace(0, picture.duration, 101)
    for obstacle in picture.obstacles:
        spans = [obstacle.outline(float(s), picture.system, 1e6)[:, 0] for s in times]
        edges = np.array([[span.min(), span.max()] for span in spans])
        if isinstance(obstacle, KeepIn):
            ax.plot(times, edges, color=RED, lw=0.8, ls=(0, (5, 1.5)))
        else:
            ax.fill_between(times, edges[:, 0], edges[:, 1], color=tint(RED, 0.45), lw=0, zorder=3)
    ax.set(
        xlabel="Time (s)",
        ylabel=picture.frame.labels[0],
        xlim=(0, picture.duration),
        ylim=(low - pad, high + pad),
    )
    legend_above(ax, handles, 2)
