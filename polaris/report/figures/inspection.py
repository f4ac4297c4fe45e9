"""Figures of a campaign (figure 8) and of the fuel limit (figure 9)."""

from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.collections import LineCollection

from ...inspection.flights.fuel_run import FuelRun
from ...runs.inspections.monte_carlo import CampaignData
from ..scene.inspections import fuel_timeline, predicted_fuel
from ..scene.palette import BLACK, BLUE, GREY, ORANGE, PURPLE, RED, SKY, VERMILION, tint
from ..scene.unsafe import ORDER
from .flight import draw_chief
from .style import WIDTH, dot, legend_above, new_figure
from .timelines import timeline_figure

BAR_COLOURS = (RED, ORANGE, PURPLE, SKY, BLACK, BLUE, VERMILION, GREY)


def initial_conditions(picture: CampaignData) -> Any:
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
        for chosen, fill, wide, level in ((~failed, tint(SKY, 0.75), size, 2), (failed, RED, 4 * size, 3)):
            p = order[chosen]
            ax.scatter(p[:, 1], p[:, 0], s=wide, marker="*", color=fill, lw=0, zorder=level, rasterized=True)
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


def failures(picture: CampaignData) -> Any:
    """Draw the number of failed runs of each study, by the kind of failure."""
    figure = new_figure(0.8 + 0.5 * len(picture.studies), 1.35 * WIDTH)
    ax = figure.add_subplot()
    rows = np.arange(len(picture.studies))[::-1]
    height = 0.8 / max(len(picture.whats), 1)
    for k, failure in enumerate(picture.whats):
        place = rows + 0.4 - height * (k + 0.5)
        look = {"height": 0.85 * height, "color": BAR_COLOURS[k % 8], "lw": 0, "label": failure, "zorder": 2}
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


def _path(run: FuelRun) -> Any:
    """Draw the path in the plane of the orbit, cyan at the start and magenta at the end."""
    figure = new_figure(2.0)
    ax = figure.add_subplot()
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
    legend_above(ax, handles, 3)
    figure.colorbar(lines, ax=ax, label="Time (s)", aspect=20, pad=0.03)
    return figure


def _fuel(run: FuelRun) -> Any:
    """Draw the velocity change spent, its limit, and that of the predicted backup flights."""
    timeline = fuel_timeline(run)
    fuel_panel = timeline.panels[0]
    panel = replace(fuel_panel, series=[*fuel_panel.series, *predicted_fuel(run)])
    return timeline_figure([panel], timeline.controllers, timeline.marks, 2.0)


def _thrust(run: FuelRun) -> Any:
    """Draw the thrust along each axis between its limits, and when the backup took over."""
    timeline = fuel_timeline(run)
    return timeline_figure(timeline.panels[1:], timeline.controllers, timeline.marks)


FUEL_FIGURES = {"path": _path, "fuel": _fuel, "thrust": _thrust}  # figures of a flight into the fuel limit
