"""Figures of the constraints over time, and of the speed against the distance (figures 6a to 6d)."""

from __future__ import annotations

from typing import Any

import numpy as np

from ....inspection.constraints.allowable_set import allowable
from ....inspection.flights.simulation import InspectionRun
from ..style import RED
from .common import SAFE, UNSAFE, colour, deputy_handles, legend, pair_handles, pair_style, shade, tell


def draw_speed(ax: Any, run: InspectionRun) -> None:
    """Draw the speed of each deputy against its distance from the chief, among phi1, phi3 and phi6."""
    q = run.inspection
    distance = np.linalg.norm(run.x[..., :3], axis=2)
    speed = np.linalg.norm(run.x[..., 3:], axis=2)
    right = max(1.08 * q.distance_max, 1.03 * float(distance.max()))
    allowed = np.sqrt(3) * q.speed_max
    top = 1.12 * max(allowed, float(speed.max()))
    corner = min((allowed - q.docking_speed) / q.nu_1, q.distance_max)
    edge = np.array([q.separation, max(corner, q.separation), q.distance_max])
    limit = np.minimum(q.docking_speed + q.nu_1 * edge, allowed)
    ax.axhspan(0, top, color=UNSAFE, lw=0, zorder=0)
    ax.fill_between(edge, 0, limit, color=SAFE, lw=0, zorder=0.1)
    ax.plot([edge[0], *edge, edge[-1]], [0, *limit, 0], color=RED, lw=0.7, zorder=0.2)
    for i in range(q.deputies):
        ax.plot(distance[:, i], speed[:, i], color=colour(i), lw=0.9, zorder=3)
        ax.plot(distance[0, i], speed[0, i], "o", color=colour(i), ms=3.5, mec="white", mew=0.4, zorder=4)
        ax.plot(distance[-1, i], speed[-1, i], "s", color=colour(i), ms=3.2, mec="white", mew=0.4, zorder=4)
    tell(ax, "largest speed", 0.5 * right, allowed + 0.02 * top, ha="center", va="bottom")
    tell(ax, "keep-in zone", q.distance_max + 0.012 * right, 0.04 * top, rotation=90, va="bottom")
    ax.set(xlim=(0, right), ylim=(0, top), xlabel="Distance from the chief (m)", ylabel="Speed (m/s)")
    legend(ax, deputy_handles(q), "Deputy", q.deputies + 1)


def draw_velocity(axes: Any, run: InspectionRun) -> None:
    """Draw the components of the velocity over time between their limits, one panel each."""
    q = run.inspection
    for k, (ax, name) in enumerate(zip(axes, ("Radial", "Along-track", "Cross-track"), strict=True)):
        values = run.x[..., 3 + k]
        top = 1.25 * max(q.speed_max, float(np.abs(values).max()))
        shade(ax, -top, top, [(q.speed_max, True), (-q.speed_max, False)])
        for i in range(q.deputies):
            ax.plot(run.t, values[:, i], color=colour(i), lw=0.8, zorder=3)
        ax.set(xlim=(0, run.t[-1]), ylabel=f"{name}\n(m/s)")
    axes[-1].set_xlabel("Time (s)")
    legend(axes[0], deputy_handles(q), "Deputy", q.deputies + 1)


def draw_separation(ax: Any, run: InspectionRun, named: bool = True) -> None:
    """Draw the distance of every pair over time, logarithmically, and the least that is allowed."""
    q = run.inspection
    least = 2 * q.deputy_radius
    values = allowable(q, run.x, run.sun)["phi2"] + least
    low = min(0.6 * least, 0.8 * float(values.min()))
    ax.set_yscale("log")
    shade(ax, low, 1.6 * float(values.max()), [(least, False)])
    for pair, line in zip(q.pairs, values.T, strict=True):
        shown, dashes = pair_style(pair)
        ax.plot(run.t, line, color=shown, ls=dashes, lw=0.9, zorder=3)
    tell(ax, "collision", 0.99 * run.t[-1], least * 0.95, ha="right", va="top")
    ax.set(xlim=(0, run.t[-1]), xlabel="Time (s)", ylabel="Distance of deputies (m)")
    if named:
        legend(ax, pair_handles(q), "Pair", 6)


def draw_sun(ax: Any, run: InspectionRun) -> None:
    """Draw the angle between each sensor, pointed at the chief, and the sun."""
    q = run.inspection
    half = np.degrees(q.field_of_view / 2)
    values = np.degrees(allowable(q, run.x, run.sun)["phi4"]) + half
    shade(ax, 0, 185, [(half, False)])
    for i in range(q.deputies):
        ax.plot(run.t, values[:, i], color=colour(i), lw=0.9, zorder=3)
    tell(ax, "sun in the field of view", 0.99 * run.t[-1], half - 2, ha="right", va="top")
    ax.set(xlim=(0, run.t[-1]), xlabel="Time (s)", ylabel="Chief to sun (degrees)")
    ax.set_yticks([0, 30, 60, 90, 120, 150, 180])
    legend(ax, deputy_handles(q), "Deputy", q.deputies + 1)


def draw_deputy_sun(ax: Any, run: InspectionRun, named: bool = True) -> None:
    """Draw the smaller angle between the line of two deputies and that of the sun."""
    q = run.inspection
    half = np.degrees(q.field_of_view / 2)
    values = np.degrees(allowable(q, run.x, run.sun)["phi5"]) + half
    shade(ax, 0, 93, [(half, False)])
    for pair, line in zip(q.pairs, values.T, strict=True):
        shown, dashes = pair_style(pair)
        ax.plot(run.t, line, color=shown, ls=dashes, lw=0.9, zorder=3)
    tell(ax, "sun in the field of view", 0.99 * run.t[-1], half - 1, ha="right", va="top")
    ax.set(xlim=(0, run.t[-1]), xlabel="Time (s)", ylabel="Deputy to sun (degrees)")
    ax.set_yticks([0, 30, 60, 90])
    if named:
        legend(ax, pair_handles(q), "Pair", 6)
