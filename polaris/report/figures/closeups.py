"""Close-ups: where the plane of motion shows the safe path within an unsafe set, a view of the gap.

A set may be passed above or below. What is drawn is how the path lies to the set: of a moving set, relative
to its centre.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...model.keep_in import KeepIn
from ...model.obstacle import Obstacle
from ...model.system import Array
from ...runs.picture import Picture
from .geometry import flat_outline, stretches
from .paths import draw_safe_path
from .space import Space, moves, outline_gap, plane_gap
from .style import BLACK, RED, shortened, text_width, tint

MOST = 6
"""Most close-ups of a figure: those that are passed nearest."""


FLAT = 0.05
"""Motion out of the plane that nobody would see, as a share of its size."""


@dataclass(frozen=True, eq=False)
class CloseUp:
    """One passage of one unsafe set.

    Attributes
    ----------
    obstacle : Obstacle
    time, distance : float
        Of the closest approach of this passage [s], [m].
    axes : list of two int, or None
        Position coordinates that show the gap; None if only the distance over time does.
    span : (int, int)
        First and one-past-last sample of the safe path at which they do.
    """

    obstacle: Obstacle
    time: float
    distance: float
    axes: list[int] | None
    span: tuple[int, int]


def closeups(picture: Picture) -> list[CloseUp]:
    """Passages that the plane of the figures does not show to be safe, in the order of time.

    A passage is a stretch of the safe path that is drawn within a set at the same time but is outside it. A
    set that is truly entered has none.
    """
    frame = picture.frame
    if picture.system.d < 3:
        return []
    planes = [[frame.axes[0], frame.axes[2]], [frame.axes[1], frame.axes[2]]]
    times, path = picture.safe_path()
    found, space = [], Space.of(picture)
    for obstacle in picture.obstacles:
        if isinstance(obstacle, KeepIn) or not len(space.corners(obstacle, picture.approach(obstacle).time)):
            continue
        distance = obstacle.signed_distance(times, path, picture.system)
        if not np.all(distance > 0):
            continue
        hidden = plane_gap(obstacle, picture, frame.flat) <= 0
        gaps = [plane_gap(obstacle, picture, axes) for axes in planes] if hidden.any() else []
        while hidden.any():
            at = int(np.flatnonzero(hidden)[np.argmin(distance[hidden])])
            best = int(np.argmax([gap[at] for gap in gaps]))
            axes = planes[best] if gaps[best][at] > 0 else None
            shows = distance > 0 if axes is None else gaps[best] > 0
            cover = space.cover(obstacle, float(times[at]))
            if axes is not None and cover is not None:  # the one that is drawn, for all of the stretch
                flat = (
                    path - obstacle.centre(times, picture.system) + obstacle.centre(times[at], picture.system)
                )
                shows &= outline_gap(flat_outline(cover[:, axes]), flat[:, axes]) > 0
                shows[at] = True
            span = next((a, b) for a, b in stretches(shows) if a <= at < b)
            hidden[slice(*span)] = False
            if cover is None:
                at = span[0] + int(np.argmin(distance[slice(*span)]))
            found.append(CloseUp(obstacle, float(times[at]), float(distance[at]), axes, span))
    nearest = sorted(found, key=lambda one: one.distance)[:MOST]
    return sorted(nearest, key=lambda one: one.time)


def is_flat(picture: Picture, paths: Sequence[Array] = ()) -> bool:
    """Whether the plane of the figures shows all there is to see: motion within it, past all sets.

    Parameters
    ----------
    picture : Picture
    paths : sequence of ndarray, shape (N, d)
        Further positions flown [m].
    """
    if picture.system.d < 3:
        return True
    space = Space.of(picture)
    shown = (*picture.path(), picture.safe_path()[1], *paths)
    third = np.concatenate([path[:, picture.frame.axes[2]] for path in shown])
    size = float(np.max((space.high - space.low)[picture.frame.flat]))
    return bool(np.ptp(third) <= FLAT * size) and not closeups(picture)


def draw_closeup(ax: Any, picture: Picture, one: CloseUp, letter: str, aspect: float, width: float) -> None:
    """Draw one close-up, wholly within `width` [in], as high as `aspect` times that."""
    apart = f"{one.distance:.3g}" if one.distance < 1000 else f"{one.distance:.0f}"
    told = f"{seconds(one.time)} s: {apart} m"
    told += " apart" if one.distance < 1000 and text_width(told + " apart") < width else ""
    name = shortened(f"({letter}) {one.obstacle.name}", 0.9 * width)
    ax.locator_params(nbins=4)
    ax.set_title(f"{name}\n{told}", fontsize=7, loc="left", linespacing=1.1, pad=3)
    if one.axes is None:
        _over_time(ax, picture, one)
        return
    times, path = picture.safe_path()
    moving, axes = moves(one.obstacle, picture), one.axes
    origin = np.zeros(picture.system.d)
    if moving:
        path = path - one.obstacle.centre(times, picture.system)
        origin = np.asarray(one.obstacle.centre(one.time, picture.system))
    at = int(np.argmin(np.abs(times - one.time)))
    space = Space.of(picture)
    outline = space.outline(one.obstacle, one.time, axes) - origin[axes]
    cover = space.cover(one.obstacle, one.time)
    _unsafe(ax, outline, None if cover is None else flat_outline(cover[:, axes]) - origin[axes])
    near = np.vstack([outline if cover is None else (cover - origin)[:, axes], path[at : at + 1, axes]])
    low, high = near.min(axis=0), near.max(axis=0)
    size, middle = 1.5 * (high - low), (low + high) / 2
    size = np.array([max(size[0], size[1] / aspect), max(size[1], aspect * size[0])])
    ax.set(xlim=middle[0] + np.array([-0.5, 0.5]) * size[0], ylim=middle[1] + np.array([-0.5, 0.5]) * size[1])
    ax.set_aspect("equal")
    draw_safe_path(ax, picture, path[:, axes], one.span)
    ax.plot(*path[at, axes], marker="o", mfc="white", mec=BLACK, mew=0.7, ms=3, zorder=6)
    labels = [picture.frame.labels[picture.frame.axes.index(axis)] for axis in axes]
    if moving:
        labels = [f"Rel. {label[0].lower()}{label[1:]}" for label in labels]
    ax.set_xlabel(labels[0], fontsize=7)
    ax.set_ylabel(labels[1], fontsize=7)
    ax.grid(True)


def _unsafe(ax: Any, outline: Array, cover: Array | None) -> None:
    from matplotlib.patches import Polygon

    ax.add_patch(Polygon(outline, facecolor=tint(RED, 0.45), edgecolor=RED, lw=0.6, zorder=1.5))
    if cover is not None:
        ax.add_patch(Polygon(cover, facecolor="none", edgecolor=RED, lw=0.5, zorder=1.6))


def _over_time(ax: Any, picture: Picture, one: CloseUp) -> None:
    times, path = picture.safe_path()
    distance = one.obstacle.signed_distance(times, path, picture.system)
    a, b = one.span
    top = 4 * one.distance
    near = np.flatnonzero(distance[a:b] <= top) + a
    ends = times[near[0]], times[near[-1]]
    draw_safe_path(ax, picture, np.column_stack([times, distance]), one.span)
    ax.axhspan(-0.2 * top, 0, color=tint(RED, 0.45), lw=0)
    ax.set(xlim=ends if ends[0] < ends[1] else None, ylim=(-0.2 * top, top))
    ax.set_xlabel("Time (s)", fontsize=7)
    ax.set_ylabel("Distance (m)", fontsize=7)
    ax.grid(True)


def seconds(t: float) -> str:
    """A time in a figure."""
    return f"{t:.0f}" if t >= 100 else f"{t:.3g}"
