"""The scene of a system that moves on a line: position over time."""

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
from .items import Item, Mark, Scene
from .palette import LOOKS
from .space import Space

INSTANTS = 121
WIDEN = 2.5
"""Sets are shown that are no further from the path than so many times its extent."""


def line_scene(picture: Picture, paths: Sequence[Array] | None = None) -> Scene:
    """What the scene of motion on a line shows; see `scene.describe`."""
    flights = map(picture.positions, picture.flights.values())
    space = _Stretch.of(picture, list(flights) if paths is None else paths)
    start, end = picture.initial_positions, picture.duration
    reach = float(np.abs(start.G).sum())
    low, high = np.array([0.0, space.low]), np.array([end, space.high])
    scene = Scene(picture, [0], ("Time (s)", picture.frame.labels[0]), low, high, time_axis=0)
    way = scene.placed(picture.path()[0], picture.path_times())
    ends = np.array([[0.0, start.c[0] - reach], [0.0, start.c[0] + reach]])
    goal = np.array([[end, value] for value in space.goal()])
    items = [item for obstacle in picture.obstacles for item in _unsafe(space, obstacle)]
    if len(goal):
        items.append(Item("goal", "goal", (Shape("line" if len(goal) == 2 else "points", goal),)))
    items.append(Item("initial", LOOKS["initial"].name, (Shape("line", ends),)))
    items.append(Item("reference", LOOKS["reference"].name, (Shape("line", way),)))
    return Scene(picture, [0], scene.labels, low, high, (*items, *_tube(picture)), time_axis=0)


@dataclass(frozen=True, eq=False)
class _Stretch:
    """The stretch of the line that is shown over the horizon, from `low` to `high` [m], and what is in it."""

    picture: Picture
    low: float
    high: float

    @classmethod
    def of(cls, picture: Picture, paths: Sequence[Array]) -> _Stretch:
        """Room for paths (N, 1), the initial set, the goal, and limits that are not far away."""
        start = picture.initial_positions
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


def _unsafe(space: _Stretch, obstacle: Obstacle) -> list[Item]:
    """A band that is unsafe, or the limits of one to stay in, where they are."""
    edges, times = space.edges(obstacle), space.times
    if isinstance(obstacle, KeepIn):
        return _limits(space, obstacle, edges[0])
    low, high = np.clip(edges, space.low, space.high).T
    if not np.any(high > low):
        return []
    at = min(max(int(np.argmax(high - low)), INSTANTS // 4), 3 * INSTANTS // 4)
    widest = np.array([[times[at], low[at]], [times[at], high[at]]])
    band = Shape("area", np.column_stack([np.r_[times, times[::-1]], np.r_[low, high[::-1]]]))
    marks = (Mark(Shape("line", widest)),) if high[at] > low[at] else ()
    return [Item("unsafe", obstacle.name, (band,), marks=marks)]


def _limits(space: _Stretch, obstacle: KeepIn, edges: Array) -> list[Item]:
    """Both limits; one that is out of view is told at the edge of the view."""
    found = []
    ends, middle = [0.0, space.picture.duration], space.picture.duration / 2
    for edge, end in zip(edges, (space.low, space.high), strict=True):
        seen, near = space.low < edge < space.high, np.clip(edge, space.low, space.high)
        mark = Mark(Shape("points", np.array([[middle, near]])), "" if seen else f": {edge:.4g} m")
        rim = Shape("line", np.column_stack([ends, [edge, edge]])) if seen else None
        if seen or (np.isfinite(edge) and near == end):
            found.append(Item("keep_in", f"{obstacle.name} (stay inside)", (rim,), marks=(mark,)))
    return found


def _tube(picture: Picture) -> list[Item]:
    """Where the system may be over each step."""
    tube = picture.tube
    if tube is None or not len(tube.bow):
        return []
    centre, reach = tube.centre[..., 0], np.abs(tube.generators[..., 0, :]).sum(axis=-1)
    low, high = centre - reach, centre + reach
    foot = (np.minimum(low[:, :-1], low[:, 1:]) - tube.bow[..., 0]).min(axis=1)
    top = (np.maximum(high[:, :-1], high[:, 1:]) + tube.bow[..., 0]).max(axis=1)
    delta = picture.reference.delta
    starts = np.arange(len(foot)) * delta
    shapes = [
        Shape("area", np.array([[t, a], [t + delta, a], [t + delta, b], [t, b]]))
        for t, a, b in zip(starts, foot, top, strict=True)
    ]
    modes = picture.modes if len(picture.modes) == len(shapes) else None
    return [Item("tube", LOOKS["tube"].name, tuple(shapes), starts, modes=modes)]
