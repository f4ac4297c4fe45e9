"""The scene in space; for motion in a plane, time is the third axis."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..keep_in import KeepIn
from ..system import Array
from .geometry import faces
from .picture import Picture
from .style import BLACK, GREY, ORANGE, RED, mode_colour, tint
from .view import INSTANTS, moves


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
    _solids(ax, picture, low, high)
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
    per_node = np.repeat(flights.modes, (len(flown) - 1) // len(flights.modes))
    changes = np.flatnonzero(np.diff(per_node)) + 1
    seen: set[int] = set()
    for piece in np.split(np.arange(len(per_node)), changes):
        mode = int(per_node[piece[0]])
        label = None if mode in seen else f"under {picture.mode_name(mode)}"
        seen.add(mode)
        ax.plot(*flown[piece[0] : piece[-1] + 2].T, color=mode_colour(mode), lw=1.5, label=label)
    return flown


def _solids(ax: Any, picture: Picture, low: Array, high: Array) -> None:
    """Unsafe sets as solids (in space) or as prisms along time (in the plane)."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    axes, space = list(picture.frame.axes), picture.system.d == 3
    centre, reach = (low + high) / 2, (high - low) / 2
    extent = float(np.max(np.abs(np.concatenate([low, high]))))
    for obstacle in picture.obstacles:
        instants = np.linspace(0, picture.duration, INSTANTS) if moves(obstacle, picture) else np.zeros(1)
        drawn: list[tuple[float, list[Array]]] = []
        if space:
            for i, t in enumerate(instants):
                solid = obstacle.outline(float(t), picture.system, extent)[:, axes]
                if np.all(np.abs(solid.mean(axis=0) - centre) < 1.3 * reach + np.ptp(solid, axis=0) / 2):
                    drawn.append(((i + 1) / len(instants), faces(solid)))
        else:
            ends = [0.0, picture.duration] if len(instants) == 1 else list(instants)
            for a, b in zip(ends[:-1], ends[1:], strict=True):
                layers = []
                for t in (a, b):
                    flat = obstacle.outline(float(t), picture.system, extent)[:, axes]
                    flat = np.clip(flat, low[:2], high[:2])
                    layers.append(np.column_stack([flat, np.full(len(flat), t)]))
                drawn.append((1.0, faces(np.vstack(layers))))
        for strength, polygons in drawn:
            keep_in = isinstance(obstacle, KeepIn)
            face = (*tint(RED, 0.7), 0.0 if keep_in else 0.28 * strength)
            collection = Poly3DCollection(
                polygons,
                facecolor=face,
                edgecolor=(*tint(RED, strength), 0.3 if keep_in else 0.8),
                linewidth=0.35,
            )
            ax.add_collection3d(collection, autolim=False)
        if drawn and drawn[-1][1]:
            top = np.vstack(drawn[-1][1])
            place = top[np.argmax(top[:, 2])]
            ax.text(*place, f" {obstacle.name}", color=RED, fontsize=7, va="bottom")
