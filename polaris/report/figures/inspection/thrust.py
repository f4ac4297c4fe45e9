"""Figures of the thrust (figure 6f) and of what it costs."""

from __future__ import annotations

from typing import Any

import numpy as np

from ....inspection.flights.simulation import InspectionRun
from ..style import step_edges
from .common import colour, deputy_handles, legend, shade


def draw_thrust(axes: Any, run: InspectionRun) -> None:
    """Draw the thrust of every deputy between its limits, one panel for each axis."""
    q = run.inspection
    for k, (ax, name) in enumerate(zip(axes, ("Radial", "Along-track", "Cross-track"), strict=True)):
        _limits(ax, run)
        for i in range(q.deputies):
            ax.step(run.t, step_edges(run.u[:, i, k]), where="post", color=colour(i), lw=0.5, zorder=3)
        ax.set(ylabel=f"{name}\n(N)")
    axes[-1].set_xlabel("Time (s)")
    legend(axes[0], deputy_handles(q), "Deputy", q.deputies + 1)


def draw_all_thrust(ax: Any, run: InspectionRun) -> None:
    """Draw the components of the thrust of every deputy in one panel."""
    _limits(ax, run)
    for i in range(run.inspection.deputies):
        for k in range(3):
            ax.step(run.t, step_edges(run.u[:, i, k]), where="post", color=colour(i), lw=0.35, zorder=3)
    ax.set(xlabel="Time (s)", ylabel="Thrust (N)")


def draw_delta_v(ax: Any, run: InspectionRun) -> None:
    """Draw the velocity change that each deputy has spent."""
    for i in range(run.inspection.deputies):
        ax.plot(run.t, run.delta_v[:, i], color=colour(i), zorder=3)
    ax.set(xlim=(0, run.t[-1]), xlabel="Time (s)", ylabel="Velocity change (m/s)")
    ax.set_ylim(0, 1.05 * max(float(run.delta_v.max()), 1e-9))
    ax.grid(True)
    legend(ax, deputy_handles(run.inspection), "Deputy", run.inspection.deputies + 1)


def _limits(ax: Any, run: InspectionRun) -> None:
    limit = run.inspection.thrust_max
    shade(ax, -1.25 * limit, 1.25 * limit, [(limit, True), (-limit, False)])
    ax.set(xlim=(0, float(np.asarray(run.t)[-1])))
