"""The scene of a system that moves on a line: position over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..keep_in import KeepIn
from ..obstacles import Obstacle
from ..system import Array
from .paths import DASHES, DOTS, draw_safe_path
from .picture import Picture
from .space import position_set
from .style import BLACK, GREEN, GREY, ORANGE, RED, YELLOW, legend_above, mode_colour, shortened, tint
from .view import View

INSTANTS = 121
WIDEN = 2.5
"""Sets are shown that are no further from the path than so many times its extent."""


@dataclass(frozen=True, eq=False)
class LineSpace:
    """The stretch of the line that is shown over the horizon, and what is in it.

    Attributes
    ----------
    picture : Picture
    low, high : float
        [m]
    """

    picture: Picture
    low: float
    high: float

    @classmethod
    def of(cls, picture: Picture, paths: Sequence[Array]) -> LineSpace:
        """Room for paths (N, 1), the initial set, the goal, and limits that are not far away."""
        start = position_set(picture)
        reach = float(np.abs(start.G).sum())
        shown = [start.c - reach, start.c + reach, picture.path()[0][:, 0], picture.safe_path()[1][:, 0]]
        points = np.concatenate(shown)
        size = float(np.ptp(points))
        shown += [
            path[:, 0] for path in paths if np.ptp(np.append(path[:, 0], points)) < (1 + 2 * WIDEN) * size
        ]
        points = np.concatenate(shown)
        low, high = float(points.min()) - WIDEN * size, float(points.max()) + WIDEN * size
        whole = cls(picture, -np.inf, np.inf)
        edges = [whole.edges(obstacle).ravel() for obstacle in picture.obstacles] + [np.array(whole.goal())]
        near = np.concatenate([points, *([edge[(edge >= low) & (edge <= high)] for edge in edges])])
        pad = 0.12 * float(np.ptp(near)) + 1e-9 * (1 + float(np.abs(near).max()))
        return cls(picture, float(near.min()) - pad, float(near.max()) + pad)

    @property
    def times(self) -> Array:
        """When sets are drawn [s]."""
        return np.linspace(0, self.picture.duration, INSTANTS)

    def edges(self, obstacle: Obstacle) -> Array:
        """Ends of a set (of a keep-in set's inside) at `times`, shape (T, 2) [m]; perhaps infinite."""
        system = self.picture.system
        if isinstance(obstacle, KeepIn):
            H, b = (
                obstacle.inside.H[:, 0],
                np.broadcast_to(obstacle.inside.b, (INSTANTS, len(obstacle.inside.b))),
            )
        else:
            centre = np.asarray(obstacle.centre(self.times, system))[:, 0]
            H = getattr(obstacle.shape, "H", np.array([[1.0], [-1.0]]))[:, 0]
            own = getattr(obstacle.shape, "b", None)
            b = (np.full(2, obstacle.shape.radius) if own is None else own) + H * centre[:, None]  # type: ignore[attr-defined]
        high = np.where(H > 0, b / np.abs(H), np.inf).min(axis=1)
        low = np.where(H < 0, -b / np.abs(H), -np.inf).max(axis=1)
        return np.stack([low, high], axis=1)

    def band(self, obstacle: Obstacle) -> Array:
        """The same, cut to what is shown."""
        return np.clip(self.edges(obstacle), self.low, self.high)

    def goal(self) -> tuple[float, ...]:
        """Ends of the goal at the horizon [m]; one if it is a point, none if any position will do."""
        goal, C = self.picture.goal, self.picture.system.position[0]
        state = getattr(goal, "state", None)
        if state is not None:
            return (float(C @ np.asarray(state)),)
        half = np.asarray(getattr(goal, "half_widths", [np.inf]))
        if len(half) != len(C) or np.any(np.isinf(half) & (C != 0)):
            return ()
        reach = float(np.abs(C[C != 0]) @ half[C != 0])
        centre = float(C @ np.asarray(goal.center))
        return (centre - reach, centre + reach)

    def tube(self) -> Array | None:
        """Where the system may be over each step, shape (K, 2) [m]."""
        tube = self.picture.tube
        if tube is None or not len(tube.bow):
            return None
        centre, reach = tube.centre[..., 0], np.abs(tube.generators[..., 0, :]).sum(axis=-1)
        ends = [centre - reach, centre + reach]
        foot = (np.minimum(ends[0][:, :-1], ends[0][:, 1:]) - tube.bow[..., 0]).min(axis=1)
        top = (np.maximum(ends[1][:, :-1], ends[1][:, 1:]) + tube.bow[..., 0]).max(axis=1)
        return np.stack([foot, top], axis=1)


def draw_line_scene(ax: Any, picture: Picture) -> float:
    """Draw position over time; height of the legend [in]."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    own = [picture.positions(item) for item in picture.flights.values()]
    space = LineSpace.of(picture, own)
    times, flown = picture.safe_path()
    view = View((0.0, picture.duration), (space.low, space.high), np.column_stack([times, flown[:, 0]]))
    ax.set(xlabel="Time (s)", ylabel=picture.frame.labels[0], xlim=view.x, ylim=view.y)
    ax.grid(True)
    handles: list[Any] = []
    tube = space.tube()
    if tube is not None:
        delta = picture.reference.delta
        for mode in np.unique(picture.modes):
            colour, chosen = tint(mode_colour(int(mode)), 0.3), picture.modes == mode
            foot, top = tube[chosen].T
            ax.bar(np.flatnonzero(chosen) * delta, top - foot, delta, foot, align="edge", color=colour, lw=0)
            if np.max(top - foot) > 0.03 * (space.high - space.low):
                handles.append(
                    Patch(facecolor=colour, label=f"reachable under {picture.mode_name(int(mode))}")
                )
    slices = picture.slices
    if slices is not None:  # time is an axis: there is room for all of them
        low, high = slices.outlines[:, 0, :, 0].min(axis=1), slices.outlines[:, 0, :, 0].max(axis=1)
        ax.vlines(slices.times, low, high, color=tint(YELLOW, 0.6), lw=1.0, zorder=1)
        if np.any((high > space.low) & (low < space.high)):
            handles.append(Patch(facecolor=tint(YELLOW, 0.6), label="recoverable sets"))
    for obstacle in picture.obstacles:
        _set(ax, space, view, obstacle)
    goal = space.goal()
    if goal and space.low < min(goal) and max(goal) < space.high:
        end = picture.duration
        ax.plot(
            [end] * len(goal),
            goal,
            color=GREEN,
            lw=3,
            marker="*" if len(goal) == 1 else "_",
            ms=8,
            clip_on=False,
            zorder=6,
        )
        handles.append(
            Line2D(
                [],
                [],
                color=GREEN,
                lw=3 if len(goal) == 2 else 0,
                marker="*" if len(goal) == 1 else "",
                label="goal",
            )
        )
    start = position_set(picture)
    reach = float(np.abs(start.G).sum())
    ax.plot([0, 0], [start.c[0] - reach, start.c[0] + reach], color=BLACK, lw=3, clip_on=False, zorder=6)
    if "experimental" in picture.flights:
        flights = picture.flights["experimental"]
        alone = np.column_stack([flights.times, picture.positions(flights)[:, 0]])
        ax.plot(*alone.T, color=ORANGE, lw=0.9, ls=DASHES, zorder=3.5)
        if view.contains(alone).sum() > 1:
            handles.append(Line2D([], [], color=ORANGE, lw=0.9, ls=DASHES, label="U alone"))
    before = picture.path()[0][:, 0]
    parts = len(before) // picture.planned
    steps = np.arange(picture.planned)[:, None] + np.linspace(0, 1, parts)
    ax.plot(steps.ravel() * picture.reference.delta, before, color=GREY, lw=1.1, ls=DOTS, zorder=4.5)
    handles.append(Line2D([], [], color=GREY, lw=1.1, ls=DOTS, label="reference"))
    for mode in draw_safe_path(ax, picture, view.points):
        handles.append(Line2D([], [], color=mode_colour(mode), label=f"under {picture.mode_name(mode)}"))
    return legend_above(ax, handles, 2)


def _set(ax: Any, space: LineSpace, view: View, obstacle: Obstacle) -> None:
    """A band that is unsafe, or the limits of one to stay in, where they are."""
    edges, band = space.edges(obstacle), space.band(obstacle)
    name = shortened(obstacle.name, 1.5)
    if not isinstance(obstacle, KeepIn):
        if np.any(band[:, 1] > band[:, 0]):
            ax.fill_between(space.times, *band.T, facecolor=tint(RED, 0.45), edgecolor=RED, lw=0.6, zorder=3)
            at = int(np.argmax(band[:, 1] - band[:, 0]))
            at = min(max(at, INSTANTS // 4), 3 * INSTANTS // 4)
            if band[at, 1] > band[at, 0]:
                view.label(ax, name, np.column_stack([space.times[[at, at]], band[at]]), RED)
        return
    for edge, end in zip(edges[0], (space.low, space.high), strict=True):
        spot = np.array([[space.times[INSTANTS // 2], np.clip(edge, space.low, space.high)]])
        if space.low < edge < space.high:
            ax.plot(space.times, np.full(INSTANTS, edge), color=RED, lw=0.8, ls=(0, (5, 1.5)), zorder=3)
            view.label(ax, f"{name} (stay inside)", spot, RED)
        elif np.isfinite(edge) and spot[0, 1] == end:
            view.label(ax, f"{name} (stay inside): {edge:.4g} m", spot, RED)
