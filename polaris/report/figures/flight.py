"""Figures of a flight of the inspection problem: figures 6 to 8 of the paper, from a run folder's files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ...inspection.flights.simulation import InspectionRun
from ...inspection.inspection import Inspection
from ..scene import inspection as data
from ..scene.palette import BLACK, BLUE, GREEN, GREY, LOOKS, RED, SKY, deputy_colour, tint
from .scene3d import frame_axes
from .style import ABOVE, WIDTH, new_figure, save_all, step_edges

DASHES: tuple[Any, ...] = ("-", (0, (5, 1.2)), (0, (1.2, 1)), (0, (4, 1, 1, 1)), (0, (2, 1)))

SAFE, UNSAFE = tint(GREEN, 0.14), tint(RED, 0.16)

MOST_NAMED = 10
"""Most lines that a legend names."""


def draw_flight(run: InspectionRun, folder: Path) -> list[Path]:
    """Draw and write the figures of one flight, each as PDF and PNG; same flight, same bytes."""
    alone = run.inspection.deputies == 1
    names = [name for name in FLIGHT_FIGURES if not (alone and name in ("separation", "deputy_sun"))]
    return save_all(((name, _FIGURES[name](run)) for name in names), folder)


# -- figures ----------------------------------------------------------------------------------------


def panel(draw: Callable[[Any, Any], None], height: float) -> Callable[[Any], Any]:
    """A figure of one panel, so high [in]."""

    def drawn(run: Any) -> Any:
        figure = new_figure(height)
        draw(figure.add_subplot(), run)
        return figure

    return drawn


def _charts(height: float, charts: Callable[[InspectionRun], list[data.Chart]]) -> Callable[[Any], Any]:
    """A figure of charts over each other."""

    def drawn(run: InspectionRun) -> Any:
        figure, found = new_figure(height), charts(run)
        axes = figure.subplots(len(found), 1, sharex=True, squeeze=False).ravel()
        for ax, chart in zip(axes, found, strict=True):
            _chart(ax, run, chart, named=ax is axes[0])
            ax.set_xlabel("Time (s)" if ax is axes[-1] else "")
        return figure

    return drawn


def _overview(run: InspectionRun) -> Any:
    figure = new_figure(7.2, 2 * WIDTH)
    axes = figure.subplots(3, 2).ravel()
    _speed(axes[0], run)
    _chart(axes[2], run, data.sun_chart(run, False))
    if run.inspection.deputies > 1:
        _chart(axes[1], run, data.distance_chart(run))
        _chart(axes[3], run, data.sun_chart(run, True))
    else:
        axes[1].set_axis_off()
        axes[3].set_axis_off()
    _passive(axes[4], run, data.nearest_deputy(run))
    for chart in data.thrust_charts(run.inspection, run.u):
        _chart(axes[5], run, chart, width=0.35, named=False)
    axes[5].set_ylabel("Thrust (N)")
    for letter, ax in zip("abcdef", axes, strict=True):
        if ax.axison:
            ax.text(-0.16, 1.02, f"({letter})", transform=ax.transAxes, ha="right", va="bottom", fontsize=8)
    return figure


def _passive_and_distance(run: InspectionRun) -> Any:
    figure, deputy = new_figure(5.0), data.nearest_deputy(run)
    upper, lower = figure.subplots(2, 1, height_ratios=(1.4, 1))
    _passive(upper, run, deputy)
    _free_distance(lower, run, deputy)
    return figure


def _paths_3d(run: InspectionRun) -> Any:
    """All paths in space about the chief, with the sphere of the keep-in zone."""
    figure, q = new_figure(3.3), run.inspection
    figure.set_layout_engine(None)
    ax = figure.add_axes((0.02, 0.05, 0.88, 0.86), projection="3d", computed_zorder=False)
    for shape in (item.shape for item in data.surroundings(q) if item.role == "keep"):
        assert shape is not None
        ax.plot(*shape.points.T, color=GREY, lw=0.5, ls=(0, (3, 2)), zorder=1)
    for i in range(q.deputies):
        path = run.x[:, i, data.ORDER].T
        ax.plot(*path, color=deputy_colour(i), lw=1.0, label=f"deputy {i}", zorder=3)
        _ends(path, ax, i)
    ax.plot([0], [0], [0], "*", color=BLACK, ms=5, zorder=4, label=LOOKS["chief"].legend)
    limit = np.full(3, 0.8 * q.distance_max)
    frame_axes(ax, [f"{data.AXES[k]} (m)" for k in data.ORDER], -limit, limit)
    for axis in (ax.xaxis, ax.yaxis, ax.zaxis):
        axis.set_ticks([-0.5 * q.distance_max, 0, 0.5 * q.distance_max])
    ax.set_box_aspect((1, 1, 1))
    ax.view_init(elev=22, azim=-52)
    figure.legend(*ax.get_legend_handles_labels(), loc="upper left", ncols=3)
    return figure


# -- panels -----------------------------------------------------------------------------------------


def _chart(
    ax: Any, run: InspectionRun, chart: data.Chart, width: float | None = None, named: bool = True
) -> None:
    """Lines over time, coloured by deputy; of a pair by the first one, dashed by the second."""
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
        _deputy_legend(ax, lines)


def _speed(ax: Any, run: InspectionRun) -> None:
    """The speed of each deputy against its distance from the chief, among phi1, phi3 and phi6."""
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
        _ends((distance[:, i], speed[:, i]), ax, i)
    tell(ax, "largest speed", 0.5 * right, allowed + 0.02 * top, ha="center", va="bottom")
    tell(ax, "keep-in zone", q.distance_max + 0.012 * right, 0.04 * top, rotation=90, va="bottom")
    ax.set(xlim=(0, right), ylim=(0, top), xlabel="Distance from the chief (m)", ylabel="Speed (m/s)")
    _deputy_legend(ax, lines)


def _free_distance(ax: Any, run: InspectionRun, deputy: int) -> None:
    """The distance of one deputy from the chief along its free flights."""
    least = run.inspection.separation
    start, after, flights = data.free_flights(run, deputy)
    distance = np.linalg.norm(flights, axis=2)
    ax.set_yscale("log")
    low, high = 0.6 * min(least, float(distance.min())), 1.6 * float(distance.max())
    shade(ax, low, high, [(least, False)])
    for k, line in enumerate(distance):
        ax.plot(after, line, color=tint(BLUE, 0.35 + 0.65 * k / len(start)), lw=0.8, zorder=3)
    tell(ax, "collision", 0.99 * after[-1], 0.95 * least, ha="right", va="top")
    ax.set(xlim=(0, after[-1]), xlabel="Time after the thrusters fail (s)")
    ax.set_ylabel("Distance from the chief (m)")


def _passive(ax: Any, run: InspectionRun, deputy: int) -> None:
    """The path of one deputy in the plane in which it is longest, free flights, and the chief's sphere."""
    from matplotlib.lines import Line2D

    path = run.x[:, deputy, :3]
    plane = np.sort(np.argsort(np.ptp(path, axis=0))[1:])[::-1]
    for flight in data.free_flights(run, deputy)[2][..., plane]:
        ax.plot(*flight.T, color=SKY, lw=0.7, zorder=2)
        ax.plot(*flight[0], ".", color=BLUE, ms=2.5, zorder=3)
    handles = ax.plot(*path[:, plane].T, color=BLUE, lw=1.4, zorder=3, label=f"deputy {deputy}")
    handles += [Line2D([], [], color=SKY, lw=0.9, label="free flights"), draw_chief(ax, run.inspection)]
    ax.set(xlabel=f"{data.AXES[plane[0]]} (m)", ylabel=f"{data.AXES[plane[1]]} (m)")
    ax.set_aspect("equal", adjustable="datalim")
    ax.grid(True)
    ax.legend(handles=handles, handlelength=1.2, columnspacing=0.9, **ABOVE)


# -- parts ------------------------------------------------------------------------------------------


def draw_chief(ax: Any, q: Inspection) -> Any:
    """Draw the sphere round the chief as a circle; a handle for legends."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Circle

    ax.add_patch(Circle((0, 0), q.separation, fc=tint(RED, 0.45), ec=RED, zorder=2.5))
    look: dict[str, Any] = {"marker": "o", "mfc": tint(RED, 0.45), "ls": "none", "ms": 5}
    return Line2D([], [], color=RED, label=LOOKS["chief"].legend, **look)


def _ends(path: Any, ax: Any, deputy: int) -> None:
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


def _deputy_legend(ax: Any, lines: list[Any]) -> None:
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


_FIGURES: dict[str, Callable[[InspectionRun], Any]] = {
    "overview": _overview,
    "speed": panel(_speed, 2.8),
    "velocity": _charts(3.9, data.velocity_charts),
    "separation": _charts(2.8, lambda run: [data.distance_chart(run)]),
    "sun": _charts(2.6, lambda run: [data.sun_chart(run, False)]),
    "deputy_sun": _charts(2.8, lambda run: [data.sun_chart(run, True)]),
    "passive": _passive_and_distance,
    "thrust": _charts(3.9, lambda run: data.thrust_charts(run.inspection, run.u)),
    "delta_v": _charts(2.4, lambda run: [data.spent_chart(run)]),
    "paths_3d": _paths_3d,
}

FLIGHT_FIGURES = tuple(_FIGURES)
"""Figures of a flight."""
