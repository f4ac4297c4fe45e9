"""Figures of a campaign (figure 8) and of the fuel limit (figure 9), and parts of those of flights."""

from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Circle

from ...inspection.flights.fuel_run import FuelRun
from ...inspection.inspection import Inspection
from ...runs.inspections.monte_carlo import CampaignPicture
from ..scene.palette import BLACK, BLUE, GREEN, GREY, LOOKS, ORANGE, PURPLE, RED, SKY, VERMILION, tint
from ..scene.unsafe import AXES, ORDER
from .style import ABOVE, WIDTH, dot, new_figure, step_edges

BAR_COLOURS = (RED, ORANGE, PURPLE, SKY, BLACK, BLUE, VERMILION, GREY)

SAFE, UNSAFE = tint(GREEN, 0.14), tint(RED, 0.16)

Panel = Callable[[Any, Any], None]


def stack(height: float, *panels: Panel) -> Callable[[Any], Any]:
    """A figure of some height [in] of panels over each other, named and labelled once."""

    def drawn(run: Any) -> Any:
        figure = new_figure(height)
        axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False).ravel()
        for ax, draw in zip(axes, panels, strict=True):
            draw(ax, run)
            if ax is not axes[0]:
                without_legend(ax)
            if ax is not axes[-1]:
                ax.set_xlabel("")
        return figure

    return drawn


def draw_chief(ax: Any, q: Inspection) -> Any:
    """Draw the sphere round the chief as a circle; a handle for legends."""
    ax.add_patch(Circle((0, 0), q.separation, fc=tint(RED, 0.45), ec=RED, zorder=2.5))
    look: dict[str, Any] = {"marker": "o", "mfc": tint(RED, 0.45), "ls": "none", "ms": 5}
    return Line2D([], [], color=RED, label=LOOKS["chief"].legend, **look)


def shade(ax: Any, low: float, high: float, limits: Any) -> None:
    """Shade an axis of values: safe, and unsafe beyond each limit (value, whether above it is unsafe)."""
    ax.axhspan(low, high, color=SAFE, lw=0, zorder=0)
    for value, above in limits:
        ax.axhspan(value, high if above else low, color=UNSAFE, lw=0, zorder=0.1)
        ax.axhline(value, color=RED, lw=0.7, zorder=0.2)
    ax.set_ylim(low, high)


def shade_thrust(ax: Any, q: Inspection) -> None:
    """Shade the thrust that is within its limits, and that beyond."""
    most = q.thrust_max
    shade(ax, -1.25 * most, 1.25 * most, ((most, True), (-most, False)))


def tell(ax: Any, text: str, x: float, y: float, **options: Any) -> None:
    """Write the name of a limit in its colour."""
    ax.text(x, y, text, color=RED, fontsize=6.5, zorder=6, **options)


def without_legend(ax: Any) -> None:
    """Take the legend away, if there is one."""
    if ax.get_legend() is not None:
        ax.get_legend().remove()


def initial_conditions(picture: CampaignPicture) -> Any:
    """Draw the initial position of every deputy, one panel per study: red those that a failure concerns."""
    count = len(picture.studies)
    columns = min(count, 2)
    rows = -(-count // columns)
    figure = new_figure(0.7 + 2.0 * rows, WIDTH if columns == 1 else 1.35 * WIDTH)
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    order = picture.x[..., :3]
    limit = 1.08 * float(np.abs(order).max())
    size = 9.0 if len(order) * order.shape[1] < 1500 else 3.0
    studies = zip(axes, picture.studies, picture.success, picture.failed, strict=False)
    for ax, name, success, failed in studies:
        for chosen, shown, wide, level in ((~failed, tint(SKY, 0.75), size, 2), (failed, RED, 4 * size, 3)):
            p = order[chosen]
            ax.scatter(p[:, 1], p[:, 0], s=wide, marker="*", color=shown, lw=0, zorder=level, rasterized=True)
        ax.plot([0], [0], "o", color=BLACK, ms=3, zorder=4)
        ax.set_title(f"{name}\n{success.mean():.2%} of {len(success)} runs safe", fontsize=7)
        ax.set(xlim=(-limit, limit), ylim=(-limit, limit))
        ax.set_aspect("equal")
        ax.grid(True)
    for ax in axes[len(picture.studies) :]:
        ax.set_axis_off()
    handles = [dot("*", tint(SKY, 0.75), 5, "not concerned"), dot("*", RED, 5, "failed")]
    handles.append(dot("o", BLACK, 3, "chief"))
    figure.legend(handles=handles, loc="outside upper center", ncols=3)
    figure.supxlabel("Along-track at the start (m)", fontsize=8)
    figure.supylabel("Radial at the start (m)", fontsize=8)
    return figure


def failures(picture: CampaignPicture) -> Any:
    """Draw the number of failed runs of each study, by what failed."""
    figure = new_figure(0.8 + 0.5 * len(picture.studies), 1.35 * WIDTH)
    ax = figure.add_subplot()
    rows = np.arange(len(picture.studies))[::-1]
    height = 0.8 / max(len(picture.whats), 1)
    for k, what in enumerate(picture.whats):
        place = rows + 0.4 - height * (k + 0.5)
        look = {"height": 0.85 * height, "color": BAR_COLOURS[k % 8], "lw": 0, "label": what, "zorder": 2}
        ax.bar_label(ax.barh(place, picture.counts[:, k], **look), fmt=" %d", fontsize=6.5)
    ax.set_yticks(rows, picture.studies)
    ax.set(xlabel="Runs", ylim=(-0.55, len(rows) - 0.45))
    ax.set_xlim(0, 1.15 * max(float(picture.counts.max(initial=0)), 1.0))
    ax.xaxis.get_major_locator().set_params(integer=True)
    ax.grid(True, axis="x")
    ax.tick_params(axis="y", length=0)
    if picture.whats:
        ax.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4)
    else:
        ax.text(0.5, 0.5, "no failures", transform=ax.transAxes, ha="center", va="center", fontsize=8)
    return figure


FIGURES = {"initial_conditions": initial_conditions, "failures": failures}  # figures of a campaign
PIECES = 400  # pieces in which a path changes its colour
AFTER = 500.0  # time [s] for which a predicted flight is shown after its last thrust: nothing more is spent


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
    ax.set(xlabel="Along-track (m)", ylabel="Radial (m)")
    ax.set_xlim(x0, x1, auto=True)  # not fixed: else matplotlib says that it widens them
    ax.set_ylim(y0, y1, auto=True)
    ax.set_aspect("equal", adjustable="datalim")
    ax.grid(True)
    ax.legend(handles=handles, columnspacing=0.9, **ABOVE)
    ax.figure.colorbar(lines, ax=ax, label="Time (s)", aspect=20, pad=0.03)


def _fuel(ax: Any, run: FuelRun) -> None:
    """Draw the velocity change spent, its limit, and that of the predicted backup flights."""
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


FUEL_FIGURES = {"path": stack(2.0, _path), "fuel": stack(2.6, _fuel), "thrust": stack(2.4, _thrust)}
"""Figures of a flight into the fuel limit."""
