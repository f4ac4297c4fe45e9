"""The stretch of a line that a scene shows over time, and the unsafe sets on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...model.keep_in import KeepIn
from ...model.obstacle import Obstacle
from ...model.shapes import Ball, Box
from ...model.system import Array
from ...runs.picture import Picture
from .geometry import Shape
from .items import Item, Mark
from .space import Space

INSTANTS = 121
WIDEN = 2.5
"""Sets are shown that are no further from the path than so many times its extent."""


@dataclass(frozen=True, eq=False)
class Stretch:
    """The stretch of the line that is shown over the horizon, from `low` to `high` [m], and what is in it."""

    picture: Picture
    low: float
    high: float

    @classmethod
    def of(cls, picture: Picture, paths: Sequence[Array] | None) -> Stretch:
        """Room for paths (N, 1) [m], the initial set, the goal, and limits that are not far away."""
        if paths is None:
            paths = [picture.positions(flights) for flights in picture.flights.values()]
        start = picture.initial_positions
        reach = float(np.abs(start.G).sum())
        shown = [start.c - reach, start.c + reach, picture.path()[0][:, 0], picture.safe_path()[1][:, 0]]
        points = np.concatenate(shown)
        size = float(np.ptp(points))
        near = [
            path[:, 0] for path in paths if np.ptp(np.append(path[:, 0], points)) < (1 + 2 * WIDEN) * size
        ]
        points = np.concatenate([*shown, *near])
        low, high = float(points.min()) - WIDEN * size, float(points.max()) + WIDEN * size
        whole = cls(picture, -np.inf, np.inf)
        edges = [whole.edges(obstacle).ravel() for obstacle in picture.obstacles] + [np.array(whole.goal())]
        points = np.concatenate([points, *([edge[(edge >= low) & (edge <= high)] for edge in edges])])
        pad = 0.12 * float(np.ptp(points)) + 1e-9 * (1 + float(np.abs(points).max()))
        return cls(picture, float(points.min()) - pad, float(points.max()) + pad)

    @property
    def times(self) -> Array:
        """When sets are drawn [s]."""
        return np.linspace(0, self.picture.duration, INSTANTS)

    def edges(self, obstacle: Obstacle) -> Array:
        """Ends of a set (of a keep-in set's inside) at `times`, shape (T, 2) [m]; perhaps infinite."""
        shape, centre = obstacle.drawn, obstacle.centre(self.times, self.picture.system)
        if isinstance(shape, Ball):
            shape = Box.of(np.full(1, shape.radius))
        H = shape.H[:, 0]
        b = shape.b + H * centre
        high = np.where(H > 0, b / np.abs(H), np.inf).min(axis=1)
        low = np.where(H < 0, -b / np.abs(H), -np.inf).max(axis=1)
        return np.stack([low, high], axis=1)

    def goal(self) -> tuple[float, ...]:
        """Ends of the goal at the horizon [m]; one if it is a point, none if any position will do."""
        parts = Space(self.picture, np.zeros(1), np.ones(1)).goal()  # what is infinite here has no place
        points = parts[0].points[:, 0] if parts else np.zeros(0)
        return tuple(dict.fromkeys((float(points.min()), float(points.max())))) if len(points) else ()

    def unsafe(self, obstacle: Obstacle) -> list[Item]:
        """A band that is unsafe, or the limits of one to stay in, where they are."""
        edges, times = self.edges(obstacle), self.times
        if isinstance(obstacle, KeepIn):
            return self._limits(obstacle, edges[0])
        low, high = np.clip(edges, self.low, self.high).T
        if not np.any(high > low):
            return []
        at = min(max(int(np.argmax(high - low)), INSTANTS // 4), 3 * INSTANTS // 4)
        widest = np.array([[times[at], low[at]], [times[at], high[at]]])
        band = Shape("area", np.column_stack([np.r_[times, times[::-1]], np.r_[low, high[::-1]]]))
        marks = (Mark(Shape("line", widest)),) if high[at] > low[at] else ()
        return [Item("unsafe", (band,), obstacle.name, marks=marks)]

    def _limits(self, obstacle: KeepIn, edges: Array) -> list[Item]:
        """Both limits [m]; one that is out of view is told at the edge of the view."""
        found = []
        ends, middle = [0.0, self.picture.duration], self.picture.duration / 2
        for edge, end in zip(edges, (self.low, self.high), strict=True):
            seen, near = self.low < edge < self.high, np.clip(edge, self.low, self.high)
            mark = Mark(Shape("points", np.array([[middle, near]])), "" if seen else f": {edge:.4g} m")
            rim = Shape("line", np.column_stack([ends, [edge, edge]])) if seen else None
            if seen or (np.isfinite(edge) and near == end):
                found.append(Item("keep_in", (rim,), f"{obstacle.name} (stay inside)", marks=(mark,)))
        return found
