"""The scene in space; for motion in a plane, time is the third axis."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...model.keep_in import KeepIn
from ...model.obstacle import Obstacle
from ...model.shapes import Ball
from ...model.system import Array
from ...runs.picture import Picture
from .geometry import faces
from .paths import by_mode
from .space import Space, moves
from .style import BLACK, GREEN, GREY, ORANGE, RED, mode_colour, tint
from .unsafe import DASHES, instants

PRISMS = 5
"""Instants between which a set that moves in the plane is drawn as a prism."""


def draw_scene_3d(ax: Any, picture: Picture) -> None:
    """Draw the scene into axes with ``projection="3d"``."""
    from matplotlib.ticker import MaxNLocator

    frame, space = picture.frame, picture.system.d == 3
    delta, parts = picture.reference.delta, 8
    before, after = picture.path(parts)
    t = (np.arange(len(picture.reference.nu))[:, None] + np.linspace(0, 1, parts + 1)).ravel() * delta

    def lift(p: Array, times: Array) -> Array:
        return p[:, list(frame.axes)] if space else np.column_stack([p[:, frame.flat], times])

    reference = lift(before, t[: len(before)])
    shown = [reference]
    ax.plot(*reference.T, color=GREY, lw=1.0, ls=(0, (1, 1.4)), label="reference")
    if space and len(after):
        tail = lift(after, t[len(before) :])
        ax.plot(*tail.T, color=tint(GREY, 0.6), lw=0.7, ls=(0, (1, 1.4)))
        shown.append(tail)
    if "experimental" in picture.flights:
        flights = picture.flights["experimental"]
        alone = lift(picture.positions(flights), flights.times)
        ax.plot(*alone.T, color=ORANGE, lw=0.9, ls=(0, (3, 1.2)), label="U alone")
    if "polaris" in picture.flights:
        shown.append(_flown(ax, picture, lift))
    box = np.vstack(shown)
    if not space:
        box = np.vstack([box, [*box[0, :2], 0.0]])
    low, high = box.min(axis=0), box.max(axis=0)
    size = high - low
    if space:  # one scale for all axes, however flat the motion
        size = np.maximum(size, 0.4 * size.max())
    middle, size = (low + high) / 2, size * 1.12 + 1e-9
    low, high = middle - size / 2, middle + size / 2
    place = np.argsort(frame.axes)  # what is cut is cut to these axes
    own = Space(picture, low[place], high[place]) if space else Space.of(picture)
    _solids(ax, own, low, high)
    _goal(ax, own, low, high)
    ax.scatter(*reference[0], color=BLACK, s=8, depthshade=False)
    labels = [*frame.labels] if space else [*frame.labels, "Time (s)"]
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    for axis, label in zip("xyz", labels, strict=True):
        getattr(ax, f"set_{axis}label")(label, fontsize=7, labelpad=-6 if axis == "z" else -3)
        ax.tick_params(axis=axis, labelsize=7, pad=-2 if axis == "z" else -3)
        ticks = getattr(ax, f"{axis}axis")
        ticks.set_pane_color((1, 1, 1, 0))
        ticks.line.set_linewidth(0.5)
        ticks._axinfo["grid"].update(color="#E4E4E4", linewidth=0.4)  # there is no public way
        ticks.set_major_locator(MaxNLocator(4 if axis == "x" else 3))
    ax.set_box_aspect(size if space else (1, np.clip(size[1] / size[0], 0.4, 1.2), 0.7), zoom=1.0)
    ax.view_init(elev=24, azim=-58)


def _flown(ax: Any, picture: Picture, lift: Any) -> Array:
    flights = picture.flights["polaris"]
    flown: Array = lift(picture.positions(flights), flights.times)
    for mode, piece in by_mode(picture, flown).items():
        ax.plot(*piece.T, color=mode_colour(mode), lw=1.5, label=f"under {picture.mode_name(mode)}")
    return flown


def _goal(ax: Any, space: Space, low: Array, high: Array) -> None:
    """The goal: over the plane it stands at the end of the time."""
    picture, label = space.picture, "goal"
    axes, d = list(picture.frame.axes), picture.system.d
    for part in space.goal():
        points = part.points[:, axes]
        if d == 2:
            points = np.column_stack([points, np.full(len(points), picture.duration)])
        if not _seen(points, low, high):
            continue
        if part.kind == "body":
            drawn = faces(points) if d == 3 else [points[np.argsort(_angle(points))]]
            points = np.vstack([np.vstack([face, face[:1], np.full((1, 3), np.nan)]) for face in drawn])
        look: dict[str, Any] = (
            {"lw": 0.8, "ls": (0, (4, 2))} if len(points) > 1 else {"marker": "*", "ls": "none"}
        )
        ax.plot(*points.T, color=GREEN, label=label, **look)
        label = "_"


def _angle(points: Array) -> Array:
    x, y = (points - points.mean(axis=0)).T[:2]
    return np.asarray(np.arctan2(y, x))


def _solids(ax: Any, space: Space, low: Array, high: Array) -> None:
    """Unsafe sets as solids (in space) or as prisms along time (in the plane)."""
    picture = space.picture
    for obstacle in picture.obstacles:
        if picture.system.d == 3:
            times = instants(obstacle, space)[::-1]
            drawn = [faces(space.corners(obstacle, t)[:, list(picture.frame.axes)]) for t in times]
        else:
            times = list(np.linspace(0, picture.duration, PRISMS)) if moves(obstacle, picture) else [0.0]
            drawn = _prisms(obstacle, space, times, low, high)
        drawn = [polygons for polygons in drawn if polygons and _seen(np.vstack(polygons), low, high)]
        if not drawn:
            continue
        if isinstance(obstacle, KeepIn):
            top = _edges(ax, drawn[0], low, high)
        else:
            for strength, polygons in zip(np.linspace(1 / len(drawn), 1, len(drawn)), drawn, strict=True):
                _fill(ax, polygons, float(strength), not isinstance(obstacle.shape, Ball))
            top = np.vstack(drawn[-1])
        if len(top):
            ax.text(*top[np.argmax(top[:, 2])], f" {obstacle.name}", color=RED, fontsize=7, va="bottom")


def _prisms(
    obstacle: Obstacle, space: Space, times: list[float], low: Array, high: Array
) -> list[list[Array]]:
    """What a set in the plane covers from one instant to the next, with time as third axis."""
    flat = space.picture.frame.flat
    ends = [0.0, space.picture.duration] if len(times) == 1 else times
    out = []
    for pair in zip(ends[:-1], ends[1:], strict=True):
        outlines = [(space.wider(1.0).outline(obstacle, float(t), flat), t) for t in pair]
        sides = [
            np.column_stack([np.clip(outline, low[:2], high[:2]), np.full(len(outline), t)])
            for outline, t in outlines
            if len(outline)
        ]
        out.append(faces(np.vstack(sides)) if sides else [])
    return out


def _seen(points: Array, low: Array, high: Array) -> bool:
    return bool(np.all(points.max(axis=0) > low) and np.all(points.min(axis=0) < high))


def _fill(ax: Any, polygons: list[Array], strength: float, edges: bool) -> None:
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    edge = (*tint(RED, strength), 0.8) if edges else "none"
    face = (*tint(RED, 0.7), 0.28 * strength)
    ax.add_collection3d(
        Poly3DCollection(polygons, linewidth=0.35, facecolor=face, edgecolor=edge), autolim=False
    )


def _edges(ax: Any, polygons: list[Array], low: Array, high: Array) -> Array:
    """Draw the edges of a keep-in set as far as they are in view; returns their ends, shape (.., 3)."""
    from mpl_toolkits.mplot3d.art3d import Line3DCollection

    a = np.vstack(polygons)
    b = np.vstack([np.roll(polygon, -1, axis=0) for polygon in polygons])
    step = np.where(np.abs(b - a) > 1e-12, b - a, 1e-12)
    s = np.sort(np.stack([(low - a) / step, (high - a) / step]), axis=0)
    enter, leave = np.maximum(s[0].max(axis=1), 0.0), np.minimum(s[1].min(axis=1), 1.0)
    kept = enter < leave
    ends = np.stack([a + enter[:, None] * (b - a), a + leave[:, None] * (b - a)], axis=1)[kept]
    ax.add_collection3d(
        Line3DCollection(list(ends), colors=RED, linewidths=0.6, alpha=0.6, ls=DASHES), autolim=False
    )
    return np.asarray(ends.reshape(-1, 3))
