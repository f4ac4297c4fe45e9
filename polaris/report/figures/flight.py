"""Figures of a flight of the inspection problem: figure 6 of the paper, and more, from its files."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from itertools import chain
from typing import Any

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Circle

from ...inspection.flights.simulation import InspectionRun
from ...inspection.inspection import Inspection
from ...model.hill import free_flight
from ...model.system import Array
from ..scene.inspections import deputies, diagrams
from ..scene.palette import BLUE, LOOKS, RED, SKY, deputy_colour, tint
from ..scene.timelines import Limit, Panel, Series
from ..scene.unsafe import AXES
from .style import WIDTH, dot, legend_above, new_figure
from .timelines import SAFE, UNSAFE, draw_panel, timeline_figure

SHOWN_FLIGHTS = 16  # free flights that are drawn
FINE = 101  # instants of a free flight that are drawn


def _over_time(name: str, height: float, run: InspectionRun) -> Any:
    panels = diagrams(run).get(name)
    return panels and timeline_figure(panels, deputies(run), height=height)


def _overview(run: InspectionRun) -> Any:
    figure, by_name, controllers = new_figure(7.2, 2 * WIDTH), diagrams(run), deputies(run)
    thrust = by_name["thrust"]
    both = replace(thrust[0], label="Thrust", series=list(chain(*(panel.series for panel in thrust))))
    chosen = [None, *(by_name.get(name) for name in ("separation", "sun", "deputy_sun")), None, [both]]
    for letter, ax, panels in zip("abcdef", figure.subplots(3, 2).ravel(), chosen, strict=True):
        if letter in "ae":
            (_speed if letter == "a" else _passive)(ax, run)
        elif panels:
            draw_panel(ax, panels[0], controllers)
        else:
            ax.set_axis_off()
            continue
        ax.text(-0.16, 1.02, f"({letter})", transform=ax.transAxes, ha="right", va="bottom", fontsize=8)
    return figure


def _speed_figure(run: InspectionRun) -> Any:
    figure = new_figure(2.8)
    _speed(figure.add_subplot(), run)
    return figure


def _passive_and_distance(run: InspectionRun) -> Any:
    figure = new_figure(5.0)
    upper, lower = figure.subplots(2, 1, height_ratios=(1.4, 1))
    _passive(upper, run)
    draw_panel(lower, _free_distance(run), [])
    lower.set_xlabel("Time after the thrusters fail (s)")
    return figure


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


def _free_distance(run: InspectionRun) -> Panel:
    """Describe the distance from the chief along the free flights of the deputy that comes nearest."""
    _, after, flights = free_flights(run, nearest_deputy(run))
    series = [Series(after, line, colour=BLUE) for line in np.linalg.norm(flights, axis=2)]
    limits, title = [Limit(run.inspection.separation, "collision", "below")], "Distance from the chief"
    return Panel("free", title, "Distance", "m", limits, series, log=True)


def draw_chief(ax: Any, q: Inspection) -> Any:
    """Draw the sphere round the chief as a circle; a handle for legends."""
    ax.add_patch(Circle((0, 0), q.separation, fc=tint(RED, 0.45), ec=RED, zorder=2.5))
    return dot("o", RED, 5, LOOKS["chief"].legend, mfc=tint(RED, 0.45))


def _speed(ax: Any, run: InspectionRun) -> None:
    """Draw the speed of each deputy against its distance from the chief, among phi1, phi3 and phi6."""
    q = run.inspection
    distance, speed = (np.linalg.norm(part, axis=2) for part in (run.x[..., :3], run.x[..., 3:]))
    right = max(1.08 * q.distance_max, 1.03 * float(distance.max()))
    allowed = np.sqrt(3) * q.speed_max
    top = 1.12 * max(allowed, float(speed.max()))
    corner = min((allowed - q.docking_speed) / q.nu_1, q.distance_max)
    edge = np.array([q.separation, max(corner, q.separation), q.distance_max])
    limit = np.minimum(q.docking_speed + q.nu_1 * edge, allowed)
    ax.axhspan(0, top, color=UNSAFE, lw=0, zorder=0)
    ax.fill_between(edge, 0, limit, color=SAFE, lw=0, zorder=0.1)
    ax.plot([edge[0], *edge, edge[-1]], [0, *limit, 0], color=RED, lw=0.7, zorder=0.2)
    lines = []
    for i in range(q.deputies):
        colour = deputy_colour(i)
        lines += ax.plot(distance[:, i], speed[:, i], color=colour, lw=0.9, zorder=3, label=f"deputy {i}")
        look: Any = {"color": colour, "mec": "white", "mew": 0.4, "zorder": 4}
        ax.plot(distance[0, i], speed[0, i], "o", ms=3.5, **look)
        ax.plot(distance[-1, i], speed[-1, i], "s", ms=3.2, **look)
    style: Any = {"color": RED, "fontsize": 6.5, "zorder": 6, "va": "bottom"}
    ax.text(0.5 * right, allowed + 0.02 * top, "largest speed", ha="center", **style)
    ax.text(q.distance_max + 0.012 * right, 0.04 * top, "keep-in zone", rotation=90, **style)
    ax.set(xlim=(0, right), ylim=(0, top), xlabel="Distance from the chief (m)", ylabel="Speed (m/s)")
    legend_above(ax, lines if q.deputies > 1 else [], 5)


def _passive(ax: Any, run: InspectionRun) -> None:
    """Draw free flights, the path in the plane in which it is longest, and the chief's sphere."""
    deputy = nearest_deputy(run)
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
    legend_above(ax, handles, 3)


FIGURES: Mapping[str, Callable[[InspectionRun], Any]] = {  # figures of a flight
    "overview": _overview,
    "speed": _speed_figure,
    "velocity": partial(_over_time, "velocity", 1.25),
    "separation": partial(_over_time, "separation", 2.0),
    "sun": partial(_over_time, "sun", 1.8),
    "deputy_sun": partial(_over_time, "deputy_sun", 2.0),
    "passive": _passive_and_distance,
    "thrust": partial(_over_time, "thrust", 1.25),
    "delta_v": partial(_over_time, "delta_v", 1.6),
}
