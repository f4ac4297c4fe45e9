"""Close-ups of passages that the plane of the scene does not show."""

from typing import Any

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon

from ...model.system import Array
from ...runs.plot_data import PlotData, seconds
from ..scene.geometry import flat_outline
from ..scene.items import CloseUp, alone
from ..scene.palette import BLACK, DULL_RED, LOOKS, RED, tint
from ..scene.space import Space, moves
from .cuts import mark_cuts
from .style import DASHES, draw_safe_path, shortened, text_width

LETTERS = "abcdef"
HERE = "\N{WHITE CIRCLE}"  # where the chaser is at the time in the title of a close-up


def draw_closeup(
    ax: Any, picture: PlotData, one: CloseUp, letter: str, aspect: float, width: float
) -> list[Any]:
    """Draw one close-up, wholly within `width` [in], as high as `aspect` times that; handles of its own."""
    distance = f"{one.distance:.3g}" if one.distance < 1000 else f"{one.distance:.0f}"
    place = f"{HERE} {seconds(one.time)} s: {distance} m"
    place += " apart" if one.distance < 1000 and text_width(place + " apart") < width else ""
    title = shortened(f"({letter}) {one.obstacle.name}", 0.9 * width)
    ax.locator_params(nbins=4)
    ax.set_title(f"{title}\n{place}", fontsize=7, loc="left", linespacing=1.1, pad=3)
    labels = ["Time (s)", "Distance (m)"]
    if one.axes is None:
        handles = _over_time(ax, picture, one)
    else:
        labels = [picture.frame.labels[picture.frame.axes.index(axis)] for axis in one.axes]
        if moves(one.obstacle, picture):
            labels = [f"Rel. {label[0].lower()}{label[1:]}" for label in labels]
        handles = _in_plane(ax, picture, one, one.axes, aspect)
    ax.set_xlabel(labels[0], fontsize=7)
    ax.set_ylabel(labels[1], fontsize=7)
    ax.grid(True)
    return handles + mark_cuts(ax)


def _in_plane(ax: Any, picture: PlotData, one: CloseUp, axes: list[int], aspect: float) -> list[Any]:
    times, path = picture.safe_path()
    space, origin = Space.from_paths(picture), np.zeros(picture.system.d)
    if moves(one.obstacle, picture):
        path = path - one.obstacle.centre(times, picture.system)
        origin = np.asarray(one.obstacle.centre(one.time, picture.system))
    at = int(np.argmin(np.abs(times - one.time)))
    outline = space.outline(one.obstacle, one.time, axes) - origin[axes]
    ax.add_patch(Polygon(outline, facecolor=tint(RED, 0.45), edgecolor=RED, lw=0.6, zorder=1.5))
    cover = space.cover(one.obstacle, one.time)
    if cover is not None:
        outline = flat_outline(cover[:, axes]) - origin[axes]
        ax.add_patch(Polygon(outline, facecolor="none", edgecolor=DULL_RED, lw=0.7, zorder=1.6))
    near = np.vstack([outline, path[at : at + 1, axes]])
    low, high = near.min(axis=0), near.max(axis=0)
    size, middle = 1.5 * (high - low), (low + high) / 2
    half = 0.5 * np.array([max(size[0], size[1] / aspect), max(size[1], aspect * size[0])])
    (x0, y0), (x1, y1) = middle - half, middle + half
    ax.set(xlim=(x0, x1), ylim=(y0, y1))
    ax.set_aspect("equal")
    draw_safe_path(ax, picture, path[:, axes], one.span)
    ax.plot(*path[at, axes], marker="o", mfc="white", mec=BLACK, mew=0.7, ms=3, zorder=6)
    body = np.vstack([space.corners(one.obstacle, one.time), *([] if cover is None else [cover])]) - origin
    for u in alone(picture):  # where it is no further off in depth than the panel shows beside
        positions = picture.positions(u.flights)
        if moves(one.obstacle, picture):
            positions = positions - one.obstacle.centre(u.flights.times, picture.system)
        far = np.maximum(body.min(axis=0) - half.max() - positions, positions - body.max(axis=0) - half.max())
        positions[np.any(np.delete(far, axes, axis=1) > 0, axis=1)] = np.nan
        _alone(ax, positions[:, axes], u.colour)
    return [] if cover is None else [Line2D([], [], color=DULL_RED, lw=0.7, label=LOOKS["cover"].legend)]


def _alone(ax: Any, path: Array, colour: str) -> None:
    """Draw the path of U alone, where there is any."""
    if np.isfinite(path).any():
        ax.plot(*path.T, color=colour, lw=0.9, ls=DASHES, zorder=3.5)


def _over_time(ax: Any, picture: PlotData, one: CloseUp) -> list[Any]:
    times, path = picture.safe_path()
    distance = one.obstacle.signed_distance(times, path, picture.system)
    a, b = one.span
    top = 4 * one.distance
    near = np.flatnonzero(distance[a:b] <= top) + a
    ends = times[near[0]], times[near[-1]]
    draw_safe_path(ax, picture, np.column_stack([times, distance]), one.span)
    ax.axhspan(-0.2 * top, 0, color=tint(RED, 0.45), lw=0)
    ax.plot(one.time, one.distance, marker="o", mfc="white", mec=BLACK, mew=0.7, ms=3, zorder=6)
    for u in alone(picture):
        gap = one.obstacle.signed_distance(u.flights.times, picture.positions(u.flights), picture.system)
        _alone(ax, np.column_stack([u.flights.times, gap]), u.colour)
    ax.set(xlim=ends if ends[0] < ends[1] else None, ylim=(-0.2 * top, top))
    return []
