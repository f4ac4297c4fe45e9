"""Charts between limits, and speed against distance (figures 6a to 6d and 6f)."""

from __future__ import annotations

from typing import Any

import numpy as np

from ....inspection.flights.simulation import InspectionRun
from ...scene.inspection import Chart, free_flights
from ...scene.palette import BLUE, GREEN, RED, deputy_colour, tint
from ..style import ABOVE, step_edges

DASHES: tuple[Any, ...] = ("-", (0, (5, 1.2)), (0, (1.2, 1)), (0, (4, 1, 1, 1)), (0, (2, 1)))

SAFE, UNSAFE = tint(GREEN, 0.14), tint(RED, 0.16)

MOST_NAMED = 10
"""Most lines that a legend names."""


def draw_chart(
    ax: Any, run: InspectionRun, chart: Chart, width: float | None = None, named: bool = True
) -> None:
    """Draw lines over time, coloured by deputy; of a pair by the first one, dashed by the second."""
    q = run.inspection
    ax.set_yscale("log" if chart.log else "linear")
    if chart.limits:
        shade(ax, *chart.span, chart.limits)
    else:
        ax.set_ylim(*chart.span)
        ax.grid(True)
    values = step_edges(chart.lines) if chart.held else chart.lines
    who = q.pairs if chart.pairs else [(i, 0) for i in range(q.deputies)]
    lines = []
    for (first, second), line in zip(who, values.T, strict=True):
        look = {"color": deputy_colour(int(first)), "ls": DASHES[int(second) % len(DASHES)], "zorder": 3}
        look |= {"drawstyle": "steps-post"} if chart.held else {}
        lines += ax.plot(run.t, line, lw=width or chart.width, **look)
    if chart.note:
        value = chart.limits[0][0]
        at = 0.95 * value if chart.log else value - chart.span[1] / 92.5
        tell(ax, chart.note, 0.99 * run.t[-1], at, ha="right", va="top")
    ax.set(xlim=(0, run.t[-1]), xlabel="Time (s)", ylabel=chart.label)
    if chart.ticks:
        ax.set_yticks(chart.ticks)
    if named and chart.pairs:
        _legend(ax, lines, [f"{i}, {j}" for i, j in q.pairs], "Pair", 6)
    elif named:
        deputy_legend(ax, lines)


def draw_speed(ax: Any, run: InspectionRun) -> None:
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
        lines += ax.plot(distance[:, i], speed[:, i], color=deputy_colour(i), lw=0.9, zorder=3)
        ends((distance[:, i], speed[:, i]), ax, i)
    tell(ax, "largest speed", 0.5 * right, allowed + 0.02 * top, ha="center", va="bottom")
    tell(ax, "keep-in zone", q.distance_max + 0.012 * right, 0.04 * top, rotation=90, va="bottom")
    ax.set(xlim=(0, right), ylim=(0, top), xlabel="Distance from the chief (m)", ylabel="Speed (m/s)")
    deputy_legend(ax, lines)


def draw_free_distance(ax: Any, run: InspectionRun, deputy: int) -> None:
    """Draw the distance of one deputy from the chief along its free flights."""
    least = run.inspection.separation
    start, after, flights = free_flights(run, deputy)
    distance = np.linalg.norm(flights, axis=2)
    ax.set_yscale("log")
    low, high = 0.6 * min(least, float(distance.min())), 1.6 * float(distance.max())
    shade(ax, low, high, [(least, False)])
    for k, line in enumerate(distance):
        ax.plot(after, line, color=tint(BLUE, 0.35 + 0.65 * k / len(start)), lw=0.8, zorder=3)
    tell(ax, "collision", 0.99 * after[-1], 0.95 * least, ha="right", va="top")
    ax.set(xlim=(0, after[-1]), xlabel="Time after the thrusters fail (s)")
    ax.set_ylabel("Distance from the chief (m)")


def ends(path: Any, ax: Any, deputy: int) -> None:
    """Mark where the path of a deputy begins and ends."""
    look = {"color": deputy_colour(deputy), "mec": "white", "mew": 0.4, "zorder": 4}
    ax.plot(*(axis[:1] for axis in path), "o", ms=3.5, **look)
    ax.plot(*(axis[-1:] for axis in path), "s", ms=3.2, **look)


def shade(ax: Any, low: float, high: float, limits: Any) -> None:
    """Shade an axis of values: safe, and unsafe beyond each limit (value, whether above it is unsafe)."""
    ax.axhspan(low, high, color=SAFE, lw=0, zorder=0)
    for value, above in limits:
        ax.axhspan(value, high if above else low, color=UNSAFE, lw=0, zorder=0.1)
        ax.axhline(value, color=RED, lw=0.7, zorder=0.2)
    ax.set_ylim(low, high)


def tell(ax: Any, text: str, x: float, y: float, **options: Any) -> None:
    """Write the name of a limit in its colour."""
    ax.text(x, y, text, color=RED, fontsize=6.5, zorder=6, **options)


def deputy_legend(ax: Any, lines: list[Any]) -> None:
    """Name the lines of the deputies; one alone needs no name."""
    names = [str(i) for i in range(len(lines))]
    _legend(ax, lines if len(lines) > 1 else [], names, "Deputy", len(lines) + 1)


def _legend(ax: Any, lines: list[Any], names: list[str], title: str, columns: int) -> None:
    """Put a legend with a title on one line above the axes; none of too many lines."""
    from matplotlib.lines import Line2D

    if 0 < len(lines) <= MOST_NAMED:
        look = ABOVE | {"handlelength": 1.2, "columnspacing": 0.7, "handletextpad": 0.3, "labelspacing": 0.25}
        handles = [Line2D([], [], ls="none"), *lines]
        legend = ax.legend(handles, [title, *names], **look | {"ncols": columns})
        for handle in legend.legend_handles:  # thin lines could not be told apart
            handle.set_linewidth(1.2)
