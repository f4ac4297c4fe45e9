"""Figures of a campaign: initial conditions by success (figure 8), failures by constraint."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ...scene.palette import BLACK, BLUE, GREY, ORANGE, PURPLE, RED, SKY, VERMILION, tint

if TYPE_CHECKING:
    from ....runs.monte_carlo import CampaignPicture

BAR_COLOURS = (RED, ORANGE, PURPLE, SKY, BLACK, BLUE, VERMILION, GREY)


def draw_initial_conditions(axes: Any, picture: CampaignPicture) -> None:
    """Draw where every deputy of every run starts, one panel per study: red where it failed, else cyan.

    Of a run that failed, the deputies that the failures concern are red.
    """
    from matplotlib.lines import Line2D

    order = picture.x[..., :3]
    limit = 1.08 * float(np.abs(order).max())
    few = len(order) * order.shape[1] < 1500
    size = 9.0 if few else 3.0
    for ax, name, success, failed in zip(
        axes, picture.studies, picture.success, picture.failed, strict=False
    ):
        for chosen, shown, wide, level in ((~failed, tint(SKY, 0.75), size, 2), (failed, RED, 4 * size, 3)):
            p = order[chosen]
            ax.scatter(p[:, 1], p[:, 0], s=wide, marker="*", color=shown, lw=0, zorder=level, rasterized=True)
        ax.plot([0], [0], "o", color=BLACK, ms=3, zorder=4)
        share = f"{name}\n{success.mean():.2%} of {len(success)} runs safe"
        ax.set_title(share, fontsize=7)
        ax.set(xlim=(-limit, limit), ylim=(-limit, limit))
        ax.set_aspect("equal")
        ax.grid(True)
    for ax in axes[len(picture.studies) :]:
        ax.set_axis_off()
    handles = [
        Line2D([], [], ls="none", marker="*", color=tint(SKY, 0.75), ms=5, label="not concerned"),
        Line2D([], [], ls="none", marker="*", color=RED, ms=5, label="failed"),
        Line2D([], [], ls="none", marker="o", color=BLACK, ms=3, label="chief"),
    ]
    axes[0].figure.legend(handles=handles, loc="outside upper center", ncols=3)
    axes[0].figure.supxlabel("Along-track at the start (m)", fontsize=8)
    axes[0].figure.supylabel("Radial at the start (m)", fontsize=8)


def draw_failures(ax: Any, picture: CampaignPicture) -> None:
    """Draw how many runs of each study failed, by what failed."""
    rows = np.arange(len(picture.studies))[::-1]
    height = 0.8 / max(len(picture.whats), 1)
    for k, what in enumerate(picture.whats):
        counts = picture.counts[:, k]
        place = rows + 0.4 - height * (k + 0.5)
        ax.barh(place, counts, height=0.85 * height, color=BAR_COLOURS[k % 8], lw=0, label=what, zorder=2)
        for y, count in zip(place, counts.tolist(), strict=True):
            ax.text(count, y, f" {count}", va="center", fontsize=6.5)
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
