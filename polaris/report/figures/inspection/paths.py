"""Figures of the paths: free flights of one deputy (figure 6e), and all paths in space."""

from __future__ import annotations

from typing import Any

import numpy as np

from ....inspection.flights.simulation import InspectionRun
from ....inspection.inspection import Inspection
from ...scene.inspection import AXES, ORDER, free_flights, nearest_deputy, surroundings
from ...scene.palette import BLACK, BLUE, GREY, LOOKS, RED, SKY, deputy_colour, tint
from ..scene3d import frame_axes
from ..style import ABOVE
from .charts import ends


def draw_passive(ax: Any, run: InspectionRun, deputy: int | None = None) -> None:
    """Draw the path of one deputy, free flights from some instants, and the sphere of the chief.

    The plane is that of the two coordinates in which the path is longest.
    """
    from matplotlib.lines import Line2D

    deputy = nearest_deputy(run) if deputy is None else deputy
    path = run.x[:, deputy, :3]
    plane = np.sort(np.argsort(np.ptp(path, axis=0))[1:])[::-1]
    for flight in free_flights(run, deputy)[2][..., plane]:
        ax.plot(*flight.T, color=SKY, lw=0.7, zorder=2)
        ax.plot(*flight[0], ".", color=BLUE, ms=2.5, zorder=3)
    handles = ax.plot(*path[:, plane].T, color=BLUE, lw=1.4, zorder=3, label=f"deputy {deputy}")
    handles += [Line2D([], [], color=SKY, lw=0.9, label="free flights"), draw_chief(ax, run.inspection)]
    ax.set(xlabel=f"{AXES[plane[0]]} (m)", ylabel=f"{AXES[plane[1]]} (m)")
    ax.set_aspect("equal", adjustable="datalim")
    ax.grid(True)
    ax.legend(handles=handles, handlelength=1.2, columnspacing=0.9, **ABOVE)


def draw_chief(ax: Any, q: Inspection) -> Any:
    """Draw the sphere round the chief as a circle; a handle for legends."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Circle

    ax.add_patch(Circle((0, 0), q.separation, fc=tint(RED, 0.45), ec=RED, zorder=2.5))
    look: dict[str, Any] = {"marker": "o", "mfc": tint(RED, 0.45), "ls": "none", "ms": 5}
    return Line2D([], [], color=RED, label=LOOKS["chief"].legend, **look)


def draw_paths(ax: Any, run: InspectionRun) -> None:
    """Draw all paths in space about the chief, with the sphere of the keep-in zone."""
    q = run.inspection
    for shape in (item.shape for item in surroundings(q) if item.role == "keep"):
        assert shape is not None
        ax.plot(*shape.points.T, color=GREY, lw=0.5, ls=(0, (3, 2)), zorder=1)
    for i in range(q.deputies):
        path = run.x[:, i, ORDER].T
        ax.plot(*path, color=deputy_colour(i), lw=1.0, label=f"deputy {i}", zorder=3)
        ends(path, ax, i)
    ax.plot([0], [0], [0], "*", color=BLACK, ms=5, zorder=4, label=LOOKS["chief"].legend)
    limit = np.full(3, 0.8 * q.distance_max)
    frame_axes(ax, [f"{AXES[k]} (m)" for k in ORDER], -limit, limit)
    for axis in (ax.xaxis, ax.yaxis, ax.zaxis):
        axis.set_ticks([-0.5 * q.distance_max, 0, 0.5 * q.distance_max])
    ax.set_box_aspect((1, 1, 1))
    ax.view_init(elev=22, azim=-52)
