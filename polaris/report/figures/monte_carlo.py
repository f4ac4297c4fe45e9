"""Figures of a campaign: initial conditions by success (figure 8), failures by constraint."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.lines import Line2D

from ...runs.monte_carlo import CampaignPicture
from ..scene.palette import BLACK, BLUE, GREY, ORANGE, PURPLE, RED, SKY, VERMILION, tint
from .style import WIDTH, new_figure

BAR_COLOURS = (RED, ORANGE, PURPLE, SKY, BLACK, BLUE, VERMILION, GREY)


def initial_conditions(picture: CampaignPicture) -> Any:
    """Where every deputy of every run starts, one panel per study: red where it failed, else cyan.

    Of a run that failed, the deputies that the failures concern are red.
    """
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
    handles = [
        Line2D([], [], ls="none", marker=marker, color=colour, ms=size, label=told)
        for marker, colour, size, told in (
            ("*", tint(SKY, 0.75), 5, "not concerned"),
            ("*", RED, 5, "failed"),
            ("o", BLACK, 3, "chief"),
        )
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=3)
    figure.supxlabel("Along-track at the start (m)", fontsize=8)
    figure.supylabel("Radial at the start (m)", fontsize=8)
    return figure


def failures(picture: CampaignPicture) -> Any:
    """How many runs of each study failed, by what failed."""
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


FIGURES = {"initial_conditions": initial_conditions, "failures": failures}
"""Figures of a campaign."""
