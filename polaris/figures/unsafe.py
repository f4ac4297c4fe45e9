"""Unsafe sets in the plane of motion: at rest once, in motion several times, fading into the past."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..keep_in import KeepIn
from ..obstacles import Obstacle
from ..shapes import Ball
from ..system import Array
from .geometry import directions, flat_outline
from .picture import Picture
from .style import RED, tint
from .view import INSTANTS, View, moves

DASHES = (0, (5, 1.5))


def draw_unsafe(ax: Any, picture: Picture, view: View) -> None:
    """Draw every unsafe set with its name.

    What is filled is the true set (about the nominal centre, for another satellite); a thin line
    is what the planner keeps clear of, where that is larger. Small dots mark where the chaser is
    at the instants at which a moving set is drawn. Dashed: keep-in sets, and sets that the chaser
    passes at another cross-track distance at all those instants.
    """
    from matplotlib.patches import Polygon

    extent = 3 * max(abs(value) for value in (*view.x, *view.y))
    axes = picture.frame.flat
    for obstacle in picture.obstacles:
        if isinstance(obstacle, KeepIn):
            rim = flat_outline(obstacle.outline(0.0, picture.system, extent)[:, axes])
            ax.add_patch(Polygon(rim, facecolor="none", edgecolor=RED, lw=0.8, ls=DASHES, zorder=3))
            _name_edge(ax, view, f"{obstacle.name} (stay inside)", rim)
            continue
        instants = _instants(obstacle, picture, view)
        if len(instants) == 0:
            continue
        solid = [obstacle.outline(float(t), picture.system, extent) for t in instants]
        covers = [flat_outline(points[:, axes]) for points in solid]
        trues = [
            _true_outline(obstacle, picture, float(t), cover)
            for t, cover in zip(instants, covers, strict=True)
        ]
        aside = _out_of_plane(picture, instants, solid)
        shades = np.linspace(0.3, 1.0, len(instants)) if len(instants) > 1 else np.ones(1)
        for cover, true, shade in zip(covers, trues, shades, strict=True):
            edge = tint(RED, float(shade))
            if aside:
                ax.add_patch(Polygon(cover, facecolor="none", edgecolor=edge, lw=0.6, ls=DASHES, zorder=1.6))
                continue
            ax.add_patch(
                Polygon(true, facecolor=tint(RED, 0.45 * float(shade)), edgecolor="none", zorder=1.5)
            )
            width = 0.6 if true is cover else 0.35
            ax.add_patch(Polygon(cover, facecolor="none", edgecolor=edge, lw=width, zorder=1.6))
        text = obstacle.name
        if aside:
            text += " (out of plane)"
        elif len(instants) > 1:
            text += f", {_seconds(instants[0])} to {_seconds(instants[-1])} s"
            spots = _chaser(picture, instants)[:, axes]
            ax.scatter(*spots.T, s=9, facecolors="white", edgecolors=RED, linewidths=0.7, zorder=4.6)
        view.label(ax, text, view.clip(trues[-1]), RED)


def _seconds(t: float) -> str:
    return f"{t:.0f}" if t >= 100 else f"{t:.3g}"


def _true_outline(obstacle: Obstacle, picture: Picture, t: float, cover: Array) -> Array:
    """Outline of the true set: a circle for balls, else what covers it."""
    if not isinstance(obstacle.shape, Ball):
        return cover
    centre = obstacle.centre(t, picture.system)[picture.frame.flat]
    return np.asarray(centre + obstacle.shape.radius * directions(48))


def _out_of_plane(picture: Picture, instants: Array, solid: list[Array]) -> bool:
    """Whether a set is above or below the whole path of the chaser at all instants drawn."""
    if len(picture.frame.axes) < 3:
        return False
    third = picture.frame.axes[2]
    before, _ = picture.path()
    low, high = before[:, third].min() - 1e-9, before[:, third].max() + 1e-9
    return all(points[:, third].min() > high or points[:, third].max() < low for points in solid)


def _chaser(picture: Picture, instants: Array) -> Array:
    """Positions of the chaser under Polaris (or of the reference) at some instants."""
    flights = picture.flights.get("polaris")
    if flights is None:
        times = np.arange(len(picture.reference.chi)) * picture.reference.delta
        known = picture.reference.chi @ picture.system.position.T
    else:
        times, known = flights.times, picture.positions(flights)
    return np.stack([np.interp(instants, times, column) for column in known.T], axis=1)


def _instants(obstacle: Obstacle, picture: Picture, view: View) -> Array:
    """When a set is drawn: once if it rests, else evenly over the time its centre is in view."""
    if not moves(obstacle, picture):
        outline = obstacle.outline(0.0, picture.system)[:, picture.frame.flat]
        return np.zeros(1) if np.all(np.ptp(view.clip(outline), axis=0) > 0) else np.zeros(0)
    times = np.linspace(0, picture.duration, 201)
    seen = times[view.contains(obstacle.centre(times, picture.system)[:, picture.frame.flat])]
    return np.asarray(
        seen[np.unique(np.linspace(0, len(seen) - 1, INSTANTS).astype(int))] if len(seen) else seen
    )


def _name_edge(ax: Any, view: View, text: str, outline: Array) -> None:
    """Write the name of a keep-in set at the end of its edge that is in view, inside the view."""
    s = np.linspace(0, 1, 200)[:, None, None]
    edge = ((1 - s) * outline + s * np.roll(outline, -1, axis=0)).reshape(-1, 2)
    seen = edge[view.contains(edge)]
    if len(seen):
        view.avoid(seen)
        far = seen[np.argmax(np.linalg.norm(seen - view.points.mean(axis=0), axis=1))]
        view.label(ax, text, far[None], RED)
