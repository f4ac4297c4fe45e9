"""Figures of the fuel limit: path, spent velocity change, thrust (figures 9a to 9c)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..style import BLACK, BLUE, ORANGE, PURPLE, RED, SKY, VERMILION, step_edges, tint
from .common import shade, tell

if TYPE_CHECKING:
    from ....inspection.flights.fuel_run import FuelRun

PIECES = 400
"""Pieces in which a path changes its colour."""

AFTER = 500.0
"""Time [s] for which a predicted flight is shown after its last thrust: nothing more is spent."""


def draw_path(ax: Any, run: FuelRun) -> None:
    """Draw the path in the plane of the orbit, cyan at the start and magenta at the end."""
    from matplotlib.collections import LineCollection
    from matplotlib.lines import Line2D
    from matplotlib.patches import Circle

    q = run.inspection
    chosen = np.unique(np.linspace(0, len(run.t) - 1, PIECES + 1).astype(int))
    points = run.x[chosen][:, [1, 0]]
    lines = LineCollection(
        list(np.stack([points[:-1], points[1:]], axis=1)),
        cmap="cool",
        array=run.t[chosen[:-1]],
        lw=1.3,
        zorder=3,
    )
    ax.add_collection(lines)
    ax.plot(*points[0], "o", color=BLACK, ms=3.5, zorder=4)
    handles = [Line2D([], [], ls="none", marker="o", color=BLACK, ms=3.5, label="start")]
    if run.latched_at is not None:
        k = int(np.searchsorted(run.t, run.latched_at))
        ax.plot(run.x[k, 1], run.x[k, 0], "D", color=VERMILION, ms=4, mec="white", mew=0.4, zorder=5)
        handles.append(
            Line2D([], [], ls="none", marker="D", color=VERMILION, ms=4, label="backup takes over")
        )
    ax.add_patch(Circle((0, 0), q.separation, fc=tint(RED, 0.45), ec=RED, zorder=2.5))
    handles.append(Line2D([], [], color=RED, marker="o", mfc=tint(RED, 0.45), ls="none", ms=5, label="chief"))
    low, high = np.minimum(points.min(axis=0), -1.5 * q.separation), points.max(axis=0)
    high = np.maximum(high, 1.5 * q.separation)
    middle, size = (low + high) / 2, 1.1 * (high - low)
    size = np.maximum(size, 0.55 * size.max())
    ax.set(xlim=middle[0] + size[0] * np.array([-0.5, 0.5]), ylim=middle[1] + size[1] * np.array([-0.5, 0.5]))
    ax.set(xlabel="Along-track (m)", ylabel="Radial (m)")
    ax.set_aspect("equal")
    ax.grid(True)
    ax.legend(handles=handles, loc="lower left", bbox_to_anchor=(-0.02, 1.0), ncols=3, columnspacing=0.9)
    ax.figure.colorbar(lines, ax=ax, label="Time (s)", aspect=20, pad=0.03)


def draw_fuel(ax: Any, run: FuelRun) -> None:
    """Draw what was spent, the limit, and what predicted backup flights would have spent."""
    from matplotlib.lines import Line2D

    q = run.inspection
    top = 1.1 * max(q.delta_v_max, float(run.delta_v.max()))
    shade(ax, 0, top, [(q.delta_v_max, True)])
    for one in run.predictions:
        ax.plot([*one.t, one.t[-1] + AFTER], [*one.delta_v, one.delta_v[-1]], color=SKY, lw=0.9, zorder=2)
    switch = len(run.t) - 1 if run.latched_at is None else int(np.searchsorted(run.t, run.latched_at))
    ax.plot(run.t[: switch + 1], run.delta_v[: switch + 1], color=BLUE, lw=1.6, zorder=3)
    ax.plot(run.t[switch:], run.delta_v[switch:], color=VERMILION, lw=1.6, zorder=3)
    tell(ax, "fuel limit", 0.99 * run.t[-1], q.delta_v_max * 1.005, ha="right", va="bottom")
    ax.set(xlim=(0, run.t[-1]), xlabel="Time (s)", ylabel="Velocity change (m/s)")
    handles = [
        Line2D([], [], color=BLUE, lw=1.6, label="primary"),
        Line2D([], [], color=VERMILION, lw=1.6, label="backup"),
        Line2D([], [], color=SKY, lw=0.9, label="backup flights, predicted"),
    ]
    ax.legend(handles=handles, loc="lower left", bbox_to_anchor=(-0.02, 1.0), ncols=3, columnspacing=0.9)


def draw_fuel_thrust(ax: Any, run: FuelRun) -> None:
    """Draw the thrust along each axis between its limits, and when the backup took over."""
    from matplotlib.lines import Line2D

    limit = run.inspection.thrust_max
    shade(ax, -1.25 * limit, 1.25 * limit, [(limit, True), (-limit, False)])
    handles = []
    for k, (name, shown) in enumerate((("Radial", BLUE), ("Along-track", ORANGE), ("Cross-track", PURPLE))):
        ax.step(run.t, step_edges(run.u[:, k]), where="post", color=shown, lw=0.8, zorder=3)
        handles.append(Line2D([], [], color=shown, label=name))
    if run.latched_at is not None:
        ax.axvline(run.latched_at, color=BLACK, lw=0.7, ls=(0, (3, 2)), zorder=2)
        ax.text(run.latched_at, 1.13 * limit, " backup", fontsize=6.5, va="center")
    ax.set(xlim=(0, run.t[-1]), xlabel="Time (s)", ylabel="Thrust (N)")
    ax.legend(handles=handles, loc="lower left", bbox_to_anchor=(-0.02, 1.0), ncols=3, columnspacing=0.9)
