"""Figures of a flight of the inspection problem: figure 6 of the paper, and more, from its files."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from matplotlib.lines import Line2D

from ...inspection.constraints.allowable_set import allowable
from ...inspection.flights.simulation import InspectionRun
from ...model.hill import free_flight
from ...model.system import Array
from ..scene.palette import BLUE, RED, SKY, deputy_colour, tint
from ..scene.unsafe import AXES
from .inspection import SAFE, UNSAFE, Panel, draw_chief, shade, shade_thrust, stack, tell, without_legend
from .style import ABOVE, WIDTH, new_figure, step_edges

DASHES: tuple[Any, ...] = ("-", (0, (5, 1.2)), (0, (1.2, 1)), (0, (4, 1, 1, 1)), (0, (2, 1)))
SHOWN_FLIGHTS = 16  # free flights that are drawn
FINE = 101  # instants of a free flight that are drawn
MOST_NAMED = 10  # most lines that a legend names


def _of_pairs(draw: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """A figure that a deputy alone has not."""
    return lambda run: draw(run) if run.inspection.deputies > 1 else None


def _overview(run: InspectionRun) -> Any:
    figure = new_figure(7.2, 2 * WIDTH)
    panels: list[Panel] = [_speed, _distance, partial(_sun, False), partial(_sun, True), _passive, _thrusts]
    axes = figure.subplots(3, 2).ravel()
    for letter, ax, draw in zip("abcdef", axes, panels, strict=True):
        if run.inspection.deputies == 1 and letter in "bd":
            ax.set_axis_off()
            continue
        draw(ax, run)
        ax.text(-0.16, 1.02, f"({letter})", transform=ax.transAxes, ha="right", va="bottom", fontsize=8)
    return figure


def _passive_and_distance(run: InspectionRun) -> Any:
    figure = new_figure(5.0)
    upper, lower = figure.subplots(2, 1, height_ratios=(1.4, 1))
    _passive(upper, run)
    _free_distance(lower, run)
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


def _lines(ax: Any, run: InspectionRun, label: str, values: Array, pairs: bool = False, **look: Any) -> None:
    """Values (N, n) over time, coloured by deputy; of pairs by the first one, dashed by the second."""
    q = run.inspection
    who = q.pairs if pairs else [(i, 0) for i in range(q.deputies)]
    lines, look = [], {"lw": 0.9, "zorder": 3} | look
    for (first, second), line in zip(who, values.T, strict=True):
        dashes = DASHES[int(second) % len(DASHES)]
        lines += ax.plot(run.t, line, color=deputy_colour(int(first)), ls=dashes, **look)
    ax.set(xlim=(0, run.t[-1]), xlabel="Time (s)", ylabel=label)
    _legend(ax, lines, q.pairs if pairs else None)


def _velocity(k: int, ax: Any, run: InspectionRun) -> None:
    """A component of the velocity of every deputy between its limits."""
    most, values = run.inspection.speed_max, run.x[..., 3 + k]
    top = 1.25 * max(most, float(np.abs(values).max()))
    shade(ax, -top, top, ((most, True), (-most, False)))
    _lines(ax, run, f"{AXES[k]}\n(m/s)", values, lw=0.8)


def _thrust(k: int, ax: Any, run: InspectionRun, width: float = 0.5) -> None:
    """A component of the thrust of every deputy between its limits."""
    shade_thrust(ax, run.inspection)
    values = step_edges(run.u[..., k])
    _lines(ax, run, f"{AXES[k]}\n(N)", values, lw=width, drawstyle="steps-post")


def _thrusts(ax: Any, run: InspectionRun) -> None:
    """All components of the thrust, which nobody could name."""
    for k in range(3):
        _thrust(k, ax, run, 0.35)
    without_legend(ax)
    ax.set_ylabel("Thrust (N)")


def _distance(ax: Any, run: InspectionRun) -> None:
    """Distance of every pair, logarithmically, and the least that is allowed."""
    least = 2 * run.inspection.deputy_radius
    values = allowable(run.inspection, run.x, run.sun)["phi2"] + least
    ax.set_yscale("log")
    shade(ax, min(0.6 * least, 0.8 * float(values.min())), 1.6 * float(values.max()), ((least, False),))
    _lines(ax, run, "Distance of deputies (m)", values, pairs=True)
    tell(ax, "collision", 0.99 * run.t[-1], 0.95 * least, ha="right", va="top")


def _sun(pairs: bool, ax: Any, run: InspectionRun) -> None:
    """Angle between the sun and each sensor, pointed at the chief, or the line of two deputies."""
    half = float(np.degrees(run.inspection.field_of_view / 2))
    values = np.degrees(allowable(run.inspection, run.x, run.sun)["phi5" if pairs else "phi4"]) + half
    label, most = ("Deputy to sun (degrees)", 90) if pairs else ("Chief to sun (degrees)", 180)
    top = most + (3.0 if pairs else 5.0)
    shade(ax, 0, top, ((half, False),))
    _lines(ax, run, label, values, pairs=pairs)
    ax.set_yticks(range(0, most + 1, 30))
    tell(ax, "sun in the field of view", 0.99 * run.t[-1], half - top / 92.5, ha="right", va="top")


def _spent(ax: Any, run: InspectionRun) -> None:
    """Velocity change that each deputy has spent."""
    ax.set_ylim(0.0, 1.05 * max(float(run.delta_v.max()), 1e-9))
    ax.grid(True)
    _lines(ax, run, "Velocity change (m/s)", run.delta_v, lw=1.2)


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
    _legend(ax, lines)


def _free_distance(ax: Any, run: InspectionRun) -> None:
    """The distance from the chief along the free flights of the deputy that comes nearest."""
    least = run.inspection.separation
    start, after, flights = free_flights(run, nearest_deputy(run))
    distance = np.linalg.norm(flights, axis=2)
    ax.set_yscale("log")
    low, high = 0.6 * min(least, float(distance.min())), 1.6 * float(distance.max())
    shade(ax, low, high, [(least, False)])
    for k, line in enumerate(distance):
        ax.plot(after, line, color=tint(BLUE, 0.35 + 0.65 * k / len(start)), lw=0.8, zorder=3)
    tell(ax, "collision", 0.99 * after[-1], 0.95 * least, ha="right", va="top")
    ax.set(xlim=(0, after[-1]), xlabel="Time after the thrusters fail (s)")
    ax.set_ylabel("Distance from the chief (m)")


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
    ax.legend(handles=handles, handlelength=1.2, columnspacing=0.9, **ABOVE)


def _ends(path: Any, ax: Any, deputy: int) -> None:
    """Mark where the path of a deputy begins and ends."""
    look = {"color": deputy_colour(deputy), "mec": "white", "mew": 0.4, "zorder": 4}
    ax.plot(*(axis[:1] for axis in path), "o", ms=3.5, **look)
    ax.plot(*(axis[-1:] for axis in path), "s", ms=3.2, **look)


def _legend(ax: Any, lines: list[Any], pairs: Any = None) -> None:
    """Name the lines of deputies, or of pairs, above the axes: not of one deputy, nor of too many lines."""
    if len(lines) <= (pairs is None) or len(lines) > MOST_NAMED:
        return
    title, names, columns = "Deputy", [str(i) for i in range(len(lines))], len(lines) + 1
    if pairs is not None:
        title, names, columns = "Pair", [f"{i}, {j}" for i, j in pairs], 6
    look = ABOVE | {"handlelength": 1.2, "columnspacing": 0.7, "handletextpad": 0.3, "labelspacing": 0.25}
    handles = [Line2D([], [], ls="none"), *lines]
    legend = ax.legend(handles, [title, *names], **look | {"ncols": columns})
    for handle in legend.legend_handles:  # thin lines could not be told apart
        handle.set_linewidth(1.2)


FIGURES: dict[str, Callable[[InspectionRun], Any]] = {
    "overview": _overview,
    "speed": stack(2.8, _speed),
    "velocity": stack(3.9, *(partial(_velocity, k) for k in range(3))),
    "separation": _of_pairs(stack(2.8, _distance)),
    "sun": stack(2.6, partial(_sun, False)),
    "deputy_sun": _of_pairs(stack(2.8, partial(_sun, True))),
    "passive": _passive_and_distance,
    "thrust": stack(3.9, *(partial(_thrust, k) for k in range(3))),
    "delta_v": stack(2.4, _spent),
}
"""Figures of a flight."""
