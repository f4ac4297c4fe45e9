"""Unsafe and keep-in sets in a scene: in the plane, in space, and about a chief."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...inspection.inspection import Inspection
from ...model.scene.keep_in import KeepIn
from ...model.scene.obstacle import Obstacle
from ...model.scene.satellite import SatelliteObstacle
from ...model.scene.shapes import BallShape, PolytopeShape
from ...model.system import Array
from ...runs.plot_data import seconds
from . import geometry
from .geometry import DrawnShape, boxed, closed, flat_outline, gapped, hull, on_box
from .items import CloseUp, Item, Mark
from .palette import LOOKS
from .space import Space, moves

AXES = ("Radial", "Along-track", "Cross-track")
ORDER = [1, 0, 2]  # Hill's coordinates in the order of the axes of a scene: along-track, radial, cross-track
PATH = 121  # instants between which a moving set is carried evenly
APART = 2.2
"""A moving set is marked before and after the closest approach where it has moved so many times its width."""


def unsafe_items(space: Space, axes: list[int], passages: Sequence[CloseUp]) -> list[Item]:
    """All unsafe sets of a scene by its axes and close-ups; unbounded ones are cut."""
    items: list[Item] = []
    for obstacle in space.picture.obstacles:
        if isinstance(obstacle, KeepIn):
            items += _keep_in(obstacle, space.wider(1.0) if len(axes) == 2 else space, axes)
            continue
        items += _body(obstacle, space, axes, passages)
        if isinstance(obstacle, SatelliteObstacle):
            items += _covers(obstacle, space, axes)
    return items


def _body(obstacle: Obstacle, space: Space, axes: list[int], closeups: Sequence[CloseUp]) -> list[Item]:
    """The true set: once, and the way it goes; a moving wall cut to the scene at every instant."""
    system, end = space.picture.system, space.picture.duration
    view = space.wider(1.0) if len(axes) == 2 else space
    passages = tuple(i for i, one in enumerate(closeups) if one.obstacle is obstacle)
    moving, cut = moves(obstacle, space.picture), not obstacle.drawn.bounded
    marks: tuple[Mark, ...] = ()
    if len(axes) == 2:
        chosen = [closeups[i].time for i in passages] or instants(obstacle, space)
        marks = _marks(obstacle, view, axes, chosen if moving else chosen[:1], moving)
    shapes: tuple[DrawnShape | None, ...] = (_at(obstacle, view, axes, 0.0),)
    motion: dict[str, Any] = {}
    if moving:
        times = np.linspace(0, end, PATH)
        shift = (obstacle.centre(times, system) - obstacle.centre(0.0, system))[:, axes]
        frames = [_at(obstacle, view, axes, float(t)) for t in (times if cut else times[:1])]
        shapes = tuple(one and one.translated(-offset) for one, offset in zip(frames, shift, strict=False))
        way = obstacle.centre(np.linspace(0, end, 201), system)[:, axes]
        motion = {"times": times, "shift": shift, "path": way}
    item = Item("unsafe", shapes, obstacle.name, marks=marks, passages=passages, cut=cut, **motion)
    return [item] if item.shape else []


def _at(obstacle: Obstacle, space: Space, axes: list[int], t: float) -> DrawnShape | None:
    if len(axes) == 2:
        outline = space.outline(obstacle, t, axes)
        return DrawnShape("area", outline) if len(outline) else None
    if isinstance(obstacle.drawn, BallShape):
        centre = obstacle.centre(t, space.picture.system)
        return geometry.ball(obstacle.drawn.radius).translated(centre).with_axes(axes)
    surface = hull(space.corners(obstacle, t))
    return surface and surface.with_axes(axes)


def _marks(
    obstacle: Obstacle, space: Space, axes: list[int], times: list[float], moving: bool
) -> tuple[Mark, ...]:
    """Return the set in the plane at some instants, the most important one first, and the chaser then."""
    path_times, path = space.picture.safe_path()
    marks = []
    for order, t in enumerate(times):
        shape = _at(obstacle, space, axes, t)
        if shape is None:
            continue
        cover = space.cover(obstacle, t) if order == 0 else None
        rim = None if cover is None else flat_outline(cover[:, axes])
        place = path[int(np.argmin(np.abs(path_times - t)))][axes]
        place = place if moving and t not in space.picture.hand_overs else None  # a slice has it
        marks.append(Mark(shape, f"{seconds(t)} s" if moving else "", rim, place))
    return tuple(marks)


def instants(obstacle: Obstacle, space: Space) -> list[float]:
    """Return when a set is marked: closest approach; if it moves, at hand-overs, or once before and after."""
    picture, axes, system = space.picture, space.picture.frame.flat, space.picture.system
    closest = picture.approach(obstacle).time
    if not moves(obstacle, picture):
        return [0.0]
    times = np.unique(np.append(np.linspace(0, picture.duration, 201), closest))
    centres = np.asarray(obstacle.centre(times, system))
    in_view = np.all((centres > space.low) & (centres < space.high), axis=1)
    outline = space.outline(obstacle, closest, axes)
    at = int(np.searchsorted(times, closest))
    if not len(outline):
        return [closest]
    travel = np.linalg.norm((centres - centres[at])[:, axes], axis=1)
    spacing = APART * float(np.max(np.ptp(outline, axis=0)))
    chosen = [closest]
    for t in picture.hand_overs:
        node = int(np.argmin(np.abs(times - t)))
        others = np.asarray(obstacle.centre(np.array(chosen), system))[:, axes]
        gaps = np.linalg.norm(others - obstacle.centre(t, system)[axes], axis=1)
        if in_view[node] and gaps.min() > 0.1 * spacing:
            chosen.append(t)
    if picture.hand_overs:
        return chosen
    for side in (np.arange(at), np.arange(at + 1, len(times))):
        side = side[in_view[side] & (travel[side] > 0.5 * spacing)]
        if len(side):
            chosen.append(float(times[side[np.argmin(np.abs(travel[side] - spacing))]]))
    return chosen


def _keep_in(obstacle: KeepIn, space: Space, axes: list[int]) -> list[Item]:
    """Return a keep-in set's items: a surface, open where it leaves the scene, and lines along it."""
    name = f"{obstacle.name} (stay inside)"
    if len(axes) == 2:
        outline = closed(flat_outline(space.corners(obstacle, 0.0)[:, axes]))
        return [Item("keep_in", (DrawnShape("line", outline),), name)] if len(outline) else []
    inside = obstacle.inside
    surface = geometry.cut_surface(inside.H, inside.b, space.low, space.high)
    items = [Item("keep_in", (surface.with_axes(axes),), name)] if surface else []
    within = boxed(inside.H, inside.b, space.low, space.high)
    lines = geometry.edges(within.vertices() if within.depth > 0 else np.zeros((0, 3)))
    lines = lines[~on_box(lines, space.low, space.high)][..., axes]
    if len(lines):
        items.append(Item("sides", (DrawnShape("line", gapped(lines, 3)),), f"{obstacle.name}: its sides"))
    return items


def _covers(obstacle: SatelliteObstacle, space: Space, axes: list[int]) -> list[Item]:
    """Another satellite's timed cover, as in the proof: larger offsets of either end all through a step."""
    picture = space.picture
    system, K = picture.system, picture.planned
    times = np.asarray(np.arange(K + 1) * picture.reference.delta)
    (timed,) = obstacle.timed_polytopes(system, picture.reference.delta, K)
    centres = obstacle.centre(times, system)
    shifts = centres @ timed.normals.T
    ends = np.maximum(timed.offsets[:, 0] - shifts[:-1], timed.offsets[:, 1] - shifts[1:])
    ends = np.vstack([ends, timed.offsets[-1, 1] - shifts[-1]])
    shapes = tuple(_cover(timed.normals, b, axes) for b in ends)
    item = Item("cover", shapes, f"{obstacle.name}: its bounds", times, centres[:, axes])
    return [item] if item.shape else []


def _cover(normals: Array, support: Array, axes: list[int]) -> DrawnShape | None:
    """A cover about its middle."""
    if normals.shape[1] != 3:
        return DrawnShape("area", flat_outline(PolytopeShape(normals, support).vertices()[:, axes]))
    solid = geometry.polyhedron(normals, support, np.zeros(3))
    if solid is None or len(axes) == 3:
        return solid and solid.with_axes(axes)
    return DrawnShape("area", flat_outline(solid.points[:, axes]))


def surroundings(q: Inspection) -> list[Item]:
    """The chief's sphere, and three circles of the sphere to stay within, in the axes of a scene."""
    angle = np.linspace(0, 2 * np.pi, 73)
    ring = q.distance_max * np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    rings = gapped((np.roll(ring, turn, axis=1) for turn in range(3)), 3)
    chief, name = Item("chief", (geometry.ball(q.separation),)), f"{LOOKS['keep'].name}, {q.distance_max:g} m"
    return [chief, Item("keep", (DrawnShape("line", rings),), name)]
