"""The scene of a schedule: what is shown of space, or of a line over time, and all in it but the flights."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from reach.sets.outlines import polygon

from ...model.scene.keep_in import KeepIn
from ...model.scene.obstacle import Obstacle
from ...model.scene.obstacle import directions as directions_in_space
from ...model.scene.shapes import Ball, Box
from ...model.system import Array
from ...runs.picture import Picture, directions
from . import geometry
from .geometry import Shape, flat_outline
from .items import Item, Mark, Scene, closeups, is_flat
from .space import Space
from .unsafe import unsafe_items

MOST_FRAMES = (1, 960, 240)
"""Most sets of a tube that are drawn on the line (one per step), in the plane and in space."""

PATHS = ("reference", "tail")  # roles of the reference until the horizon and after it


def shown_axes(picture: Picture, paths: Sequence[Array] = ()) -> list[int]:
    """Position coordinates that a page draws: the plane of motion if it shows all, else all of them."""
    frame = picture.frame
    return frame.flat if is_flat(picture, paths) else list(frame.axes)


def describe(picture: Picture, paths: Sequence[Array] | None = None, axes: list[int] | None = None) -> Scene:
    """Return the scene of a picture in two or three axes, by default the plane of the figures.

    Widened for paths flown (N, d) [m] that stay near; motion on a line is drawn over time.
    """
    if picture.system.d == 1:
        return _on_the_line(picture, paths)
    axes = picture.frame.flat if axes is None else axes
    space = Space.of(picture, paths)
    found = closeups(picture) if len(axes) == 2 else []
    items = [
        *unsafe_items(space, axes, found),
        *_goal(space, axes),
        *_start(picture, axes),
        *(_line(role, path[:, axes]) for role, path in zip(PATHS, picture.path(), strict=True) if len(path)),
        *_tube(picture, axes),
    ]
    labels = picture.frame.labels[: len(axes)]
    low, high = space.low[axes], space.high[axes]
    return Scene(picture, axes, labels, low, high, tuple(items), closeups=tuple(found))


def _on_the_line(picture: Picture, paths: Sequence[Array] | None) -> Scene:
    """The scene of a system that moves on a line: position over time."""
    space, end = Stretch.of(picture, paths), picture.duration
    low, high = np.array([0.0, space.low]), np.array([end, space.high])
    scene = Scene(picture, [0], ("Time (s)", picture.frame.labels[0]), low, high, over_time=True)
    start = picture.initial_positions
    reach = float(np.abs(start.G).sum())
    goal = np.array([[end, value] for value in space.goal()])
    items = [item for obstacle in picture.obstacles for item in space.unsafe(obstacle)]
    if len(goal):
        items.append(Item("goal", (Shape("line" if len(goal) == 2 else "points", goal),)))
    items.append(_line("initial", np.array([[0.0, start.c[0] - reach], [0.0, start.c[0] + reach]])))
    items.append(_line("reference", scene.placed(picture.path()[0], picture.path_times())))
    return replace(scene, items=(*items, *_tube(picture, [0])))


def _line(role: str, points: Array) -> Item:
    return Item(role, (Shape("line", points),))


def _start(picture: Picture, axes: list[int]) -> list[Item]:
    body = picture.initial_positions
    c, G = body.c[axes], body.G[axes]
    rays = directions(64) if len(axes) == 2 else directions_in_space(3)
    size = np.abs(rays @ G).sum(axis=-1)
    if len(axes) == 2:
        shape: Shape | None = Shape("area", polygon(rays @ c + size, rays))
    else:
        thick = np.maximum(size, 1e-3 * float(np.max(size, initial=0.0)))
        shape = geometry.polyhedron(rays, rays @ c + thick, c)
    found = [Item("start", (Shape("points", c[None]),))]
    return [*found, Item("initial", (shape,))] if shape else found


def _goal(space: Space, axes: list[int]) -> list[Item]:
    """The goal's positions: rings of ellipses, a stretch, a point or a box."""
    parts = space.goal()
    found = [Item("goal", (shape,)) for part in parts if (shape := _part(part, axes))]
    if len(parts) == 2 and len(axes) == 3:
        inner, outer = (part.points[:, axes] for part in parts)
        a = np.arange(len(inner) - 1)
        b = a + len(inner)
        between = np.vstack([np.stack([a, a + 1, b], axis=1), np.stack([a + 1, b + 1, b], axis=1)])
        found.append(Item("ring", (Shape("mesh", np.vstack([inner, outer]), between),)))
    return found


def _part(part: Shape, axes: list[int]) -> Shape | None:
    """Return one part of the goal in the axes of a scene."""
    points = part.points[:, axes]
    kind = part.kind
    if np.all(np.ptp(points, axis=0) == 0):  # a line seen end on, too
        kind, points = "points", points[:1]
    if kind == "area" and len(axes) == 3:
        return geometry.hull(points)
    return Shape(kind, flat_outline(points) if kind == "area" else points)


def _tube(picture: Picture, axes: list[int]) -> list[Item]:
    """Return the reachable positions over each part of a step, whatever the disturbance."""
    tube, dim, delta = picture.tube, len(axes), picture.reference.delta
    if tube is None or not len(tube.bow):
        return []
    K, q = tube.bow.shape[:2]
    parts = max(1, min(q, 4 if dim == 2 else q, MOST_FRAMES[dim - 1] // K))
    edges = geometry.part_edges(q, parts)
    times = ((np.arange(K)[:, None] + edges[:-1] / q) * delta).ravel()
    rays = directions(32) if dim == 2 else directions_in_space(dim)
    centre = tube.centre[..., axes]
    support = geometry.tube_support(centre, tube.generators[..., axes, :], tube.bow[..., axes], parts, rays)
    support = support.reshape(-1, len(rays))
    shapes: list[Shape | None]
    if dim == 1:
        ends = zip(times, -support[:, 1], support[:, 0], strict=True)
        steps = [np.array([[t, a], [t + delta, a], [t + delta, b], [t, b]]) for t, a, b in ends]
        shapes = [Shape("area", one) for one in steps]
    elif dim == 2:
        shapes = [Shape("area", one) for one in polygon(support, rays)]
    else:
        inside = centre[:, (edges[:-1] + edges[1:]) // 2].reshape(-1, 3)
        shapes = [geometry.polyhedron(rays, b, c) for b, c in zip(support, inside, strict=True)]
    modes = np.repeat(picture.modes, len(edges) - 1) if len(picture.modes) == K else None
    return [Item("tube", tuple(shapes), times=times, modes=modes)]


INSTANTS = 121
WIDEN = 2.5  # sets are shown that are no further from the path than so many times its extent


@dataclass(frozen=True, eq=False)
class Stretch:
    """The stretch of the line that is shown over the horizon, from `low` to `high` [m], and what is in it."""

    picture: Picture
    low: float
    high: float

    @classmethod
    def of(cls, picture: Picture, paths: Sequence[Array] | None) -> "Stretch":
        """Room for paths (N, 1) [m], the initial set, the goal, and limits that are not far away."""
        if paths is None:
            paths = [picture.positions(flights) for flights in picture.flights.values()]
        start = picture.initial_positions
        reach = float(np.abs(start.G).sum())
        shown = [start.c - reach, start.c + reach, picture.path()[0][:, 0], picture.safe_path()[1][:, 0]]
        points = np.concatenate(shown)
        size = float(np.ptp(points))
        flown = (path[:, 0] for path in paths)
        near = [one for one in flown if np.ptp(np.append(one, points)) < (1 + 2 * WIDEN) * size]
        points = np.concatenate([*shown, *near])
        low, high = float(points.min()) - WIDEN * size, float(points.max()) + WIDEN * size
        whole = cls(picture, -np.inf, np.inf)
        edges = [whole.edges(obstacle).ravel() for obstacle in picture.obstacles] + [np.array(whole.goal())]
        points = np.concatenate([points, *([edge[(edge >= low) & (edge <= high)] for edge in edges])])
        pad = 0.12 * float(np.ptp(points)) + 1e-9 * (1 + float(np.abs(points).max()))
        return cls(picture, float(points.min()) - pad, float(points.max()) + pad)

    @property
    def times(self) -> Array:
        """Times at which sets are drawn [s]."""
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
