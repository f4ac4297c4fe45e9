"""The scene of a schedule: the part of space that is shown, and everything in it but the flights."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...model.obstacle import directions as directions_in_space
from ...model.system import Array
from ...runs.picture import Picture, directions
from .closeups import closeups, is_flat
from .geometry import Shape, flat_outline, hull, part_edges, polygon, polyhedron, tube_support
from .items import Item, Scene
from .line import line_scene
from .palette import LOOKS
from .space import Space
from .unsafe import prisms, unsafe_items

MOST_FRAMES = (960, 240)
"""Most sets of a tube that are drawn in the plane and in space: neighbours are drawn as one beyond it."""


def shown_axes(picture: Picture, paths: Sequence[Array] = ()) -> list[int]:
    """Position coordinates that a page draws: the plane of motion if it shows all, else all of them."""
    frame = picture.frame
    return frame.flat if is_flat(picture, paths) else list(frame.axes)


def describe(picture: Picture, paths: Sequence[Array] | None = None, axes: list[int] | None = None) -> Scene:
    """What a scene shows of a picture.

    Parameters
    ----------
    picture : Picture
    paths : sequence of ndarray, shape (N, d), optional
        Positions flown [m]; the scene is widened for those that stay near it. Default the picture's own.
    axes : list of int, optional
        Position coordinates to draw, two or three; default the plane of the figures. Motion on a line is
        drawn over time.
    """
    if picture.system.d == 1:
        return line_scene(picture, paths)
    axes = picture.frame.flat if axes is None else axes
    space = Space.of(picture, paths)
    found = closeups(picture) if len(axes) == 2 else []
    items = [
        *unsafe_items(space, axes, found),
        *_goal(space, axes),
        *_start(picture, axes),
        *_reference(picture, axes),
        *_tube(picture, axes),
    ]
    labels = picture.frame.labels[: len(axes)]
    low, high = space.low[axes], space.high[axes]
    return Scene(picture, axes, labels, low, high, tuple(items), closeups=tuple(found))


def over_time(picture: Picture) -> Scene:
    """The scene of motion in the plane with time as the third axis."""
    axes, space, end = picture.frame.flat, Space.of(picture), picture.duration
    low, high = np.append(space.low[axes], 0.0), np.append(space.high[axes], end)
    scene = Scene(picture, axes, (*picture.frame.labels, "Time (s)"), low, high, time_axis=2)
    items = [Item("goal", "goal", (_part(part, axes, end),)) for part in space.goal()]
    way = scene.placed(picture.path()[0], picture.path_times())
    items.append(Item("reference", LOOKS["reference"].name, (Shape("line", way),)))
    items += prisms(space)
    return Scene(picture, axes, scene.labels, low, high, tuple(items), time_axis=2)


def _reference(picture: Picture, axes: list[int]) -> list[Item]:
    paths = zip(("reference", "tail"), picture.path(), strict=True)
    return [
        Item(role, LOOKS[role].name, (Shape("line", path[:, axes]),)) for role, path in paths if len(path)
    ]


def _start(picture: Picture, axes: list[int]) -> list[Item]:
    body = picture.initial_positions
    c, G = body.c[axes], body.G[axes]
    rays = directions(64) if len(axes) == 2 else directions_in_space(3)
    size = np.abs(rays @ G).sum(axis=-1)
    if len(axes) == 2:
        shape: Shape | None = Shape("area", polygon(rays @ c + size, rays))
    else:
        thick = np.maximum(size, 1e-3 * float(np.max(size, initial=0.0)))
        shape = polyhedron(rays, rays @ c + thick, c)
    found = [Item("start", "start", (Shape("points", c[None]),))]
    return [*found, Item("initial", LOOKS["initial"].name, (shape,))] if shape else found


def _goal(space: Space, axes: list[int]) -> list[Item]:
    """The goal's positions: rings of ellipses, a stretch, a point or a box."""
    parts = space.goal()
    found = [Item("goal", "goal", (shape,)) for part in parts if (shape := _part(part, axes))]
    if len(parts) == 2 and len(axes) == 3:
        inner, outer = (part.points[:, axes] for part in parts)
        a = np.arange(len(inner) - 1)
        b = a + len(inner)
        between = np.vstack([np.stack([a, a + 1, b], axis=1), np.stack([a + 1, b + 1, b], axis=1)])
        found.append(Item("ring", "goal", (Shape("mesh", np.vstack([inner, outer]), between),)))
    return found


def _part(part: Shape, axes: list[int], at: float | None = None) -> Shape | None:
    """One part of the goal; in the plane perhaps at some height, the time."""
    points = part.points[:, axes]
    kind = part.kind
    if np.all(np.ptp(points, axis=0) == 0):  # a line seen end on, too
        kind, points = "points", points[:1]
    if kind == "area" and len(axes) == 3:
        return hull(points)
    points = flat_outline(points) if kind == "area" else points
    return Shape(kind, points if at is None else np.column_stack([points, np.full(len(points), at)]))


def _tube(picture: Picture, axes: list[int]) -> list[Item]:
    """Where the spacecraft may be over each part of a step, whatever the disturbance."""
    tube = picture.tube
    if tube is None or not len(tube.bow):
        return []
    K, q = tube.bow.shape[:2]
    parts = max(1, min(q, 4 if len(axes) == 2 else q, MOST_FRAMES[len(axes) - 2] // K))
    edges = part_edges(q, parts)
    times = (np.arange(K)[:, None] + edges[:-1] / q) * picture.reference.delta
    rays = directions(32) if len(axes) == 2 else directions_in_space(3)
    centre = tube.centre[..., axes]
    support = tube_support(centre, tube.generators[..., axes, :], tube.bow[..., axes], parts, rays)
    shapes: list[Shape | None]
    if len(axes) == 2:
        shapes = [Shape("area", one) for one in polygon(support, rays).reshape(-1, len(rays), 2)]
    else:
        inside = centre[:, (edges[:-1] + edges[1:]) // 2].reshape(-1, 3)
        pairs = zip(support.reshape(-1, len(rays)), inside, strict=True)
        shapes = [polyhedron(rays, b, c) for b, c in pairs]
    modes = np.repeat(picture.modes, len(edges) - 1) if len(picture.modes) == K else None
    return [Item("tube", LOOKS["tube"].name, tuple(shapes), times.ravel(), modes=modes)]
