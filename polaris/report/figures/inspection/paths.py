"""Figures of the paths: free flights of one deputy (figure 6e), and all paths in space."""

from __future__ import annotations

from typing import Any

import numpy as np

from ....inspection.flights.simulation import InspectionRun
from ....model.hill import free_flight
from ....model.system import Array
from ..style import BLACK, BLUE, GREY, RED, SKY, tint
from .common import colour, shade, tell

SHOWN_FLIGHTS = 16
"""Free flights that are drawn."""

FINE = 101
"""Instants of a free flight that are drawn."""

AXES = ("Radial (m)", "Along-track (m)", "Cross-track (m)")


def free_flights(run: InspectionRun, deputy: int) -> tuple[Array, Array, Array]:
    """Instants, times of flight, and positions of free flights of shape (instants, times, 3)."""
    q = run.inspection
    chosen = np.unique(np.linspace(0, len(run.t) - 1, SHOWN_FLIGHTS + 2).astype(int)[1:-1])
    after = np.linspace(0, q.passive_time, FINE)
    Phi = free_flight(q.mean_motion, after)[:, :3]
    return run.t[chosen], after, np.einsum("tij,kj->kti", Phi, run.x[chosen, deputy])


def nearest_deputy(run: InspectionRun) -> int:
    """The deputy whose free flights come nearest to the chief, of those that are drawn."""
    least = [np.linalg.norm(free_flights(run, i)[2], axis=2).min() for i in range(run.inspection.deputies)]
    return int(np.argmin(least))


def draw_passive(ax: Any, run: InspectionRun, deputy: int | None = None) -> None:
    """Draw the path of one deputy, free flights from some instants, and the sphere of the chief.

    The plane is that of the two coordinates in which the path is longest.
    """
    from matplotlib.lines import Line2D
    from matplotlib.patches import Circle

    q = run.inspection
    deputy = nearest_deputy(run) if deputy is None else deputy
    path = run.x[:, deputy, :3]
    _, _, flights = free_flights(run, deputy)
    across, up = np.sort(np.argsort(np.ptp(path, axis=0))[1:])[::-1]
    for flight in flights:
        ax.plot(flight[:, across], flight[:, up], color=SKY, lw=0.7, zorder=2)
        ax.plot(flight[0, across], flight[0, up], ".", color=BLUE, ms=2.5, zorder=3)
    ax.plot(path[:, across], path[:, up], color=BLUE, lw=1.4, zorder=3)
    ax.add_patch(Circle((0, 0), q.separation, fc=tint(RED, 0.45), ec=RED, zorder=2.5))
    ax.set(xlabel=AXES[across], ylabel=AXES[up])
    ax.set_aspect("equal", adjustable="datalim")
    ax.grid(True)
    handles = [
        Line2D([], [], color=BLUE, lw=1.4, label=f"deputy {deputy}"),
        Line2D([], [], color=SKY, lw=0.9, label="free flights"),
        Line2D([], [], color=RED, marker="o", mfc=tint(RED, 0.45), ls="none", ms=5, label="chief"),
    ]
    ax.legend(
        handles=handles,
        loc="lower left",
        bbox_to_anchor=(-0.02, 1.0),
        ncols=3,
        handlelength=1.2,
        columnspacing=0.9,
    )


def draw_free_distance(ax: Any, run: InspectionRun, deputy: int | None = None) -> None:
    """Draw the distance from the chief along those free flights."""
    q = run.inspection
    deputy = nearest_deputy(run) if deputy is None else deputy
    start, after, flights = free_flights(run, deputy)
    distance = np.linalg.norm(flights, axis=2)
    ax.set_yscale("log")
    shade(
        ax,
        0.6 * min(q.separation, float(distance.min())),
        1.6 * float(distance.max()),
        [(q.separation, False)],
    )
    for k, line in enumerate(distance):
        ax.plot(after, line, color=tint(BLUE, 0.35 + 0.65 * k / len(start)), lw=0.8, zorder=3)
    tell(ax, "collision", 0.99 * after[-1], 0.95 * q.separation, ha="right", va="top")
    ax.set(
        xlim=(0, after[-1]), xlabel="Time after the thrusters fail (s)", ylabel="Distance from the chief (m)"
    )


def draw_paths(ax: Any, run: InspectionRun) -> None:
    """Draw all paths in space about the chief, with the sphere of the keep-in zone."""
    q = run.inspection
    around = np.linspace(0, 2 * np.pi, 73)
    ring = q.distance_max * np.stack([np.cos(around), np.sin(around), np.zeros_like(around)])
    for order in ((0, 1, 2), (2, 0, 1), (1, 2, 0)):
        x, y, z = ring[list(order)]
        ax.plot(y, x, z, color=GREY, lw=0.5, ls=(0, (3, 2)), zorder=1)
    for i in range(q.deputies):
        x, y, z = run.x[:, i, :3].T
        ax.plot(y, x, z, color=colour(i), lw=1.0, label=f"deputy {i}", zorder=3)
        ax.plot(y[:1], x[:1], z[:1], "o", color=colour(i), ms=3.5, mec="white", mew=0.4, zorder=4)
        ax.plot(y[-1:], x[-1:], z[-1:], "s", color=colour(i), ms=3.2, mec="white", mew=0.4, zorder=4)
    ax.plot([0], [0], [0], "*", color=BLACK, ms=5, zorder=4, label="chief")
    limit = 0.8 * q.distance_max
    ax.set(xlim=(-limit, limit), ylim=(-limit, limit), zlim=(-limit, limit))
    ax.set_box_aspect((1, 1, 1))
    ax.set_xlabel(AXES[1], labelpad=-6)
    ax.set_ylabel(AXES[0], labelpad=-6)
    ax.set_zlabel(AXES[2], labelpad=-6)
    ax.tick_params(pad=-3)
    ticks = [-0.5 * q.distance_max, 0, 0.5 * q.distance_max]
    for axis in (ax.xaxis, ax.yaxis, ax.zaxis):
        axis.set_ticks(ticks)
        axis.pane.set_facecolor("white")
        axis._axinfo["grid"].update(color="#E4E4E4", linewidth=0.4)
    ax.view_init(elev=22, azim=-52)
