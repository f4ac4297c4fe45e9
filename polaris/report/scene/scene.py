"""The scene of a schedule: what is shown of space, or of a line over time, and all in it but the flights."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from reach.sets.outlines import polygon

from ...model.scene.keep_in import KeepIn
from ...model.scene.obstacle import Obstacle
from ...model.scene.obstacle import directions as directions_in_space
from ...model.scene.shapes import BallShape, BoxShape
from ...model.system import Array
from ...runs.plot_data import PlotData, directions
from . import geometry
from .geometry import DrawnShape, flat_outline
from .items import Item, Mark, Scene, closeups, is_flat
from .space import Space
from .unsafe import unsafe_items

MOST_FRAMES = (1, 960, 240)
"""Most sets of a tube that are drawn on the line (one per step), in the plane and in space."""

WIDEN = 2.5  # sets on the line are shown that are no further than so many times what else is shown
INSTANTS = 121  # times at which sets on the line are drawn

PATHS = ("reference", "tail")  # roles of the reference until the horizon and after it


def shown_axes(picture: PlotData, paths: Sequence[Array] = ()) -> list[int]:
    """Position coordinates that a page draws: the plane of motion if it shows all, else all of them."""
    frame = picture.frame
    return frame.flat if is_flat(picture, paths) else list(frame.axes)


def describe(picture: PlotData, paths: Sequence[Array] | None = None, axes: list[int] | None = None) -> Scene:
    """Return the scene of a picture in two or three axes, by default the plane of the figures.

    Widened for paths flown (N, d) [m] that stay near; motion on a line is drawn over time.
    """
    if picture.system.d == 1:
        return _on_the_line(picture, paths)
    axes = picture.frame.flat if axes is None else axes
    space = Space.from_paths(picture, paths)
    passages = closeups(picture) if len(axes) == 2 else []
    items = [
        *unsafe_items(space, axes, passages),
        *_goal(space, axes),
        *_start(picture, axes),
        *(_line(role, path[:, axes]) for role, path in zip(PATHS, picture.path(), strict=True) if len(path)),
        *_tube(picture, axes),
    ]
    labels = picture.frame.labels[: len(axes)]
    low, high = space.low[axes], space.high[axes]
    return Scene(axes, labels, low, high, tuple(items), picture=picture, closeups=tuple(passages))


def _on_the_line(picture: PlotData, paths: Sequence[Array] | None) -> Scene:
    """The scene of a system that moves on a line: position over time."""
    end, start, space = picture.duration, picture.initial_positions, Space.from_paths(picture, paths)
    parts = space.goal()
    goal = np.unique(np.concatenate([part.points[:, 0] for part in parts])) if parts else np.zeros(0)
    sides = [_ends(obstacle, picture)[1].ravel() for obstacle in picture.obstacles]
    points, wide = np.concatenate([space.low, space.high, goal, *sides]), WIDEN * (space.high - space.low)
    nearby = points[(points >= space.low - wide) & (points <= space.high + wide)]
    pad = 0.1 * float(np.ptp(nearby))
    low, high = np.array([0.0, nearby.min() - pad]), np.array([end, nearby.max() + pad])
    labels = ("Time (s)", picture.frame.labels[0])
    scene = Scene([0], labels, low, high, over_time=True, picture=picture)
    items = [item for obstacle in picture.obstacles for item in _on_line(obstacle, scene)]
    if len(goal):
        ends = np.column_stack([np.full(len(goal), end), goal])[:: max(len(goal) - 1, 1)]
        items.append(Item("goal", (DrawnShape("line" if len(goal) > 1 else "points", ends),)))
    reach = float(np.abs(start.G).sum())
    items.append(_line("initial", np.array([[0.0, start.c[0] - reach], [0.0, start.c[0] + reach]])))
    items.append(_line("reference", scene.placed(picture.path()[0], picture.path_times())))
    return replace(scene, items=(*items, *_tube(picture, [0])))


def _ends(obstacle: Obstacle, picture: PlotData) -> tuple[Array, Array]:
    """Times (T,), and the ends then of a set (of a keep-in set's inside), (2, T) [m]; perhaps infinite."""
    times, shape = np.linspace(0, picture.duration, INSTANTS), obstacle.drawn
    if isinstance(shape, BallShape):
        shape = BoxShape.from_half_widths(np.full(1, shape.radius))
    H = shape.H[:, 0]
    at = (shape.b + H * obstacle.centre(times, picture.system)) / H
    low, high = np.where(H < 0, at, -np.inf).max(axis=1), np.where(H > 0, at, np.inf).min(axis=1)
    return times, np.stack([low, high])


def _on_line(obstacle: Obstacle, scene: Scene) -> list[Item]:
    """A band that is unsafe, or both limits of a set to stay in, at the view's edge if they are beyond it."""
    (_, low), (end, high) = scene.low, scene.high
    times, ends = _ends(obstacle, scene.picture)
    if not isinstance(obstacle, KeepIn):
        first, last = np.clip(ends, low, high)
        if not np.any(last > first):
            return []
        at = min(max(int(np.argmax(last - first)), INSTANTS // 4), 3 * INSTANTS // 4)
        widest = np.array([[times[at], first[at]], [times[at], last[at]]])
        band = DrawnShape("area", np.column_stack([np.r_[times, times[::-1]], np.r_[first, last[::-1]]]))
        marks = (Mark(DrawnShape("line", widest)),) if last[at] > first[at] else ()
        return [Item("unsafe", (band,), obstacle.name, marks=marks)]
    items = []
    for edge, side in zip((ends[0][0], ends[1][0]), (low, high), strict=True):
        inside, near = low < edge < high, np.clip(edge, low, high)
        mark = Mark(DrawnShape("points", np.array([[end / 2, near]])), "" if inside else f": {edge:.4g} m")
        rim = DrawnShape("line", np.array([[0.0, edge], [end, edge]])) if inside else None
        if inside or (np.isfinite(edge) and near == side):
            items.append(Item("keep_in", (rim,), f"{obstacle.name} (stay inside)", marks=(mark,)))
    return items


def _line(role: str, points: Array) -> Item:
    return Item(role, (DrawnShape("line", points),))


def _start(picture: PlotData, axes: list[int]) -> list[Item]:
    body = picture.initial_positions
    c, G = body.c[axes], body.G[axes]
    rays = directions(64) if len(axes) == 2 else directions_in_space(3)
    size = np.abs(rays @ G).sum(axis=-1)
    if len(axes) == 2:
        shape: DrawnShape | None = DrawnShape("area", polygon(rays @ c + size, rays))
    else:
        thick = np.maximum(size, 1e-3 * float(np.max(size, initial=0.0)))
        shape = geometry.polyhedron(rays, rays @ c + thick, c)
    items = [Item("start", (DrawnShape("points", c[None]),))]
    return [*items, Item("initial", (shape,))] if shape else items


def _goal(space: Space, axes: list[int]) -> list[Item]:
    """The goal's positions: rings of ellipses, a stretch, a point or a box."""
    parts = space.goal()
    items = [Item("goal", (shape,)) for part in parts if (shape := _part(part, axes))]
    if len(parts) == 2 and len(axes) == 3:
        inner, outer = (part.points[:, axes] for part in parts)
        a = np.arange(len(inner) - 1)
        b = a + len(inner)
        between = np.vstack([np.stack([a, a + 1, b], axis=1), np.stack([a + 1, b + 1, b], axis=1)])
        items.append(Item("ring", (DrawnShape("mesh", np.vstack([inner, outer]), between),)))
    return items


def _part(part: DrawnShape, axes: list[int]) -> DrawnShape | None:
    """Return one part of the goal in the axes of a scene."""
    points = part.points[:, axes]
    kind = part.kind
    if np.all(np.ptp(points, axis=0) == 0):  # a line seen end on, too
        kind, points = "points", points[:1]
    if kind == "area" and len(axes) == 3:
        return geometry.hull(points)
    return DrawnShape(kind, flat_outline(points) if kind == "area" else points)


def _tube(picture: PlotData, axes: list[int]) -> list[Item]:
    """Return the reachable positions over each part of a step, under any disturbance."""
    tube, dim, delta = picture.tube, len(axes), picture.reference.delta
    if tube is None or not len(tube.intersample):
        return []
    K, q = tube.intersample.shape[:2]
    parts = max(1, min(q, 4 if dim == 2 else q, MOST_FRAMES[dim - 1] // K))
    edges = geometry.part_edges(q, parts)
    times = ((np.arange(K)[:, None] + edges[:-1] / q) * delta).ravel()
    rays = directions(32) if dim == 2 else directions_in_space(dim)
    centre = tube.centre[..., axes]
    generators, intersample = tube.generators[..., axes, :], tube.intersample[..., axes]
    support = geometry.tube_support(centre, generators, intersample, parts, rays).reshape(-1, len(rays))
    shapes: list[DrawnShape | None]
    if dim == 1:
        ends = zip(times, -support[:, 1], support[:, 0], strict=True)
        steps = [np.array([[t, a], [t + delta, a], [t + delta, b], [t, b]]) for t, a, b in ends]
        shapes = [DrawnShape("area", one) for one in steps]
    elif dim == 2:
        shapes = [DrawnShape("area", one) for one in polygon(support, rays)]
    else:
        inside = centre[:, (edges[:-1] + edges[1:]) // 2].reshape(-1, 3)
        shapes = [geometry.polyhedron(rays, b, c) for b, c in zip(support, inside, strict=True)]
    modes = np.repeat(picture.modes, len(edges) - 1) if len(picture.modes) == K else None
    return [Item("tube", tuple(shapes), times=times, modes=modes)]
