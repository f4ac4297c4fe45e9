"""Figures of a flight into the fuel limit: path, spent velocity change, thrust (figures 9a to 9c)."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D

from ...inspection.flights.fuel_run import FuelRun
from ..scene.palette import BLACK, BLUE, LOOKS, ORANGE, PURPLE, SKY, VERMILION
from ..scene.unsafe import AXES, ORDER
from .flight import draw_chief, shade, shade_thrust, stack, tell
from .style import ABOVE, step_edges

PIECES = 400
"""Pieces in which a path changes its colour."""

AFTER = 500.0
"""Time [s] for which a predicted flight is shown after its last thrust: nothing more is spent."""


def _path(ax: Any, run: FuelRun) -> None:
    """The path in the plane of the orbit, cyan at the start and magenta at the end."""
    near = 1.5 * run.inspection.separation
    chosen = np.unique(np.linspace(0, len(run.t) - 1, PIECES + 1).astype(int))
    points = run.x[chosen][:, ORDER[:2]]
    pieces = list(np.stack([points[:-1], points[1:]], axis=1))
    lines = LineCollection(pieces, cmap="cool", array=run.t[chosen[:-1]], lw=1.3, zorder=3)
    ax.add_collection(lines)
    handles = ax.plot(*points[0], "o", color=BLACK, ms=3.5, zorder=4, label="start")
    if run.latched_at is not None:
        place = run.x[int(np.searchsorted(run.t, run.latched_at)), ORDER[:2]]
        look: dict[str, Any] = {"color": VERMILION, "ms": 4, "mec": "white", "mew": 0.4}
        handles += ax.plot(*place, "D", zorder=5, label="backup takes over", **look)
    handles.append(draw_chief(ax, run.inspection))
    low, high = np.minimum(points.min(axis=0), -near), np.maximum(points.max(axis=0), near)
    middle, size = (low + high) / 2, 1.1 * (high - low)
    half = 0.5 * np.maximum(size, 0.55 * size.max())
    (x0, y0), (x1, y1) = middle - half, middle + half
    ax.set(xlim=(x0, x1), ylim=(y0, y1), xlabel="Along-track (m)", ylabel="Radial (m)")
    ax.set_aspect("equal")
    ax.grid(True)
    ax.legend(handles=handles, columnspacing=0.9, **ABOVE)
    ax.figure.colorbar(lines, ax=ax, label="Time (s)", aspect=20, pad=0.03)


def _fuel(ax: Any, run: FuelRun) -> None:
    """What was spent, the limit, and what predicted backup flights would have spent."""
    most = run.inspection.delta_v_max
    shade(ax, 0, 1.1 * max(most, float(run.delta_v.max())), [(most, True)])
    for one in run.predictions:
        ax.plot([*one.t, one.t[-1] + AFTER], [*one.delta_v, one.delta_v[-1]], color=SKY, lw=0.9, zorder=2)
    switch = len(run.t) - 1 if run.latched_at is None else int(np.searchsorted(run.t, run.latched_at))
    ax.plot(run.t[: switch + 1], run.delta_v[: switch + 1], color=BLUE, lw=1.6, zorder=3)
    ax.plot(run.t[switch:], run.delta_v[switch:], color=VERMILION, lw=1.6, zorder=3)
    tell(ax, "fuel limit", 0.99 * run.t[-1], most * 1.005, ha="right", va="bottom")
    ax.set(xlim=(0, run.t[-1]), xlabel="Time (s)", ylabel="Velocity change (m/s)")
    told = ((BLUE, 1.6, "primary"), (VERMILION, 1.6, "backup"), (SKY, 0.9, LOOKS["predicted"].legend))
    handles = [Line2D([], [], color=colour, lw=width, label=name) for colour, width, name in told]
    ax.legend(handles=handles, columnspacing=0.9, **ABOVE)


def _thrust(ax: Any, run: FuelRun) -> None:
    """The thrust along each axis between its limits, and when the backup took over."""
    for name, values, shown in zip(AXES, step_edges(run.u).T, (BLUE, ORANGE, PURPLE), strict=True):
        ax.plot(run.t, values, drawstyle="steps-post", color=shown, lw=0.8, zorder=3, label=name)
    shade_thrust(ax, run.inspection)
    if run.latched_at is not None:
        ax.axvline(run.latched_at, color=BLACK, lw=0.7, ls=(0, (3, 2)), zorder=2)
        ax.text(run.latched_at, 1.13 * run.inspection.thrust_max, " backup", fontsize=6.5, va="center")
    ax.set(xlim=(0, run.t[-1]), xlabel="Time (s)", ylabel="Thrust (N)")
    ax.legend(columnspacing=0.9, **ABOVE)


FIGURES = {"path": stack(2.0, _path), "fuel": stack(2.6, _fuel), "thrust": stack(2.4, _thrust)}
"""Figures of a flight into the fuel limit."""
