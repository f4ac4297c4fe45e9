"""Unsafe sets and keep-in sets as layers of a scene."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..figures.geometry import directions, flat_outline
from ..figures.picture import Picture
from ..figures.style import RED
from ..figures.view import moves
from ..keep_in import KeepIn, KeepInCone
from ..obstacles import Obstacle
from ..satellite import SatelliteObstacle
from ..shapes import Ball, Polytope
from ..system import Array
from . import layers
from .layers import Layer
from .numbers import plain
from .solids import Surface, ball, cut_outline, cut_surface, polyhedron

PATH = 121
"""Instants between which a moving set is carried evenly."""

COVER = "#9C4A50"
"""What another satellite is known to be within: duller than the set itself."""


def unsafe_layers(picture: Picture, low: Array, high: Array) -> list[Layer]:
    """All unsafe sets of a scene in the plane or in space.

    Parameters
    ----------
    picture : Picture
    low, high : ndarray, shape (d,)
        The part of space that is shown [m], in the system's coordinates: unbounded sets are cut to it.

    Returns
    -------
    list of mapping
        In the axes of the figures.
    """
    found: list[Layer] = []
    for obstacle in picture.obstacles:
        if isinstance(obstacle, KeepIn):
            found += _keep_in(obstacle, picture, low, high)
        elif isinstance(obstacle, SatelliteObstacle):
            found += _satellite(obstacle, picture)
        else:
            found += _rigid(obstacle, picture, low, high)
    return found


def _rigid(obstacle: Obstacle, picture: Picture, low: Array, high: Array) -> list[Layer]:
    """A set of constant size: its surface once, and the way it goes."""
    if isinstance(obstacle.shape, Polytope) and not obstacle.shape.bounded:
        return _unbounded(obstacle, obstacle.shape, picture, low, high)
    start = np.asarray(obstacle.centre(0.0, picture.system))
    drawn = _shape(obstacle.name, obstacle.shape, start, picture)
    return [_moved(drawn, obstacle, picture)] if drawn else []


def _shape(name: str, shape: Any, centre: Array, picture: Picture) -> Layer | None:
    axes = list(picture.frame.axes)
    if picture.system.d < 3:
        outline = shape.radius * directions(48) if isinstance(shape, Ball) else flat_outline(shape.vertices())
        return layers.area(name, (centre + outline)[:, axes], "unsafe", RED, 0.4) | {"label": name}
    if isinstance(shape, Ball):
        surface: Surface | None = ball(shape.radius)
    else:
        surface = polyhedron(shape.H, shape.b, shape.middle)
    if surface is None:
        return None
    return layers.mesh(name, _placed(surface, centre, axes), "unsafe", RED, 0.5) | {"label": name}


def _moved(drawn: Layer, obstacle: Obstacle, picture: Picture) -> Layer:
    if not moves(obstacle, picture):
        return drawn
    times = np.linspace(0, picture.duration, PATH)
    centres = obstacle.centre(times, picture.system)
    return layers.carried(drawn, times, (centres - centres[0])[:, list(picture.frame.axes)])


def _unbounded(obstacle: Obstacle, shape: Polytope, picture: Picture, low: Array, high: Array) -> list[Layer]:
    """A wall or a wedge, cut to the scene at every instant at which it is drawn."""
    moving = moves(obstacle, picture)
    times = np.linspace(0, picture.duration, PATH) if moving else np.zeros(1)
    centres = obstacle.centre(times, picture.system)
    drawn = [
        _cut(obstacle.name, shape.H, shape.b + shape.H @ centre, picture, low, high) for centre in centres
    ]
    known = [one for one in drawn if one is not None]
    if not known:
        return []
    return [layers.framed(known[0], times, [one and _place(one) for one in drawn])] if moving else known


def _place(layer: Layer) -> dict[str, Any]:
    return {key: layer[key] for key in ("p", "f") if key in layer}


def _cut(name: str, H: Array, b: Array, picture: Picture, low: Array, high: Array) -> Layer | None:
    axes = list(picture.frame.axes)
    if picture.system.d == 3:
        surface = cut_surface(H, b, low, high)
        if surface is None:
            return None
        return layers.mesh(name, _placed(surface, np.zeros(3), axes), "unsafe", RED, 0.25) | {"label": name}
    outline = cut_outline(H, b, low, high)
    if not len(outline):
        return None
    return layers.area(name, outline[:, axes], "unsafe", RED, 0.4) | {"label": name}


def _keep_in(obstacle: KeepIn, picture: Picture, low: Array, high: Array) -> list[Layer]:
    """What the chaser must stay inside: a translucent surface, open where it leaves the scene."""
    axes, name = list(picture.frame.axes), f"{obstacle.name} (stay inside)"
    inside = obstacle.inside
    if picture.system.d == 3:
        surface = cut_surface(inside.H, inside.b, low, high, closed=False)
        found = (
            [layers.mesh(name, _placed(surface, np.zeros(3), axes), "unsafe", RED, 0.16)] if surface else []
        )
        return found + _rulings(obstacle, low, high, axes)
    outline = layers.closed(cut_outline(inside.H, inside.b, low, high))
    return [layers.line(name, outline[:, axes], "unsafe", RED, 1.5, "dash")]


def _rulings(obstacle: KeepIn, low: Array, high: Array, axes: list[int]) -> list[Layer]:
    """Lines from a cone's tip along its sides: a translucent surface alone is hard to read."""
    if not isinstance(obstacle, KeepInCone):
        return []
    tip, axis = obstacle.anchor, np.asarray(obstacle.axis)
    aside = np.linalg.svd(axis[None])[2][1:]
    angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    ways = axis + np.tan(obstacle.half_angle_rad) * np.stack([np.cos(angle), np.sin(angle)], axis=1) @ aside
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.where(ways > 0, (high - tip) / ways, np.where(ways < 0, (low - tip) / ways, np.inf))
    reach = np.maximum(ends.min(axis=1), 0.0)
    if obstacle.length is not None:
        reach = np.minimum(reach, obstacle.length)
    gap = np.full(3, np.nan)
    points = np.array(
        [part for way, s in zip(ways, reach, strict=True) for part in (tip, tip + s * way, gap)]
    )
    name = f"{obstacle.name}: its sides"
    return [layers.line(name, points[:, axes], "unsafe", RED, 1.0)]


def _satellite(obstacle: SatelliteObstacle, picture: Picture) -> list[Layer]:
    """Another satellite: the ball about its nominal place, and the timed cover that the proof uses."""
    axes, system, K = list(picture.frame.axes), picture.system, picture.planned
    times = np.arange(K + 1) * picture.reference.delta
    (timed,) = obstacle.timed_polytopes(system, picture.reference.delta, K)
    ends = np.full((K + 1, len(timed.normals)), -np.inf)  # where two cells meet, what covers both
    ends[1:] = timed.offsets[:, 1]
    ends[:-1] = np.maximum(ends[:-1], timed.offsets[:, 0])
    centres = obstacle.centre(times, system)
    drawn = _shape(obstacle.name, obstacle.shape, centres[0], picture)
    nominal = [_moved(drawn, obstacle, picture)] if drawn else []
    covers = [_cover(timed.normals, b, c, axes) for b, c in zip(ends, centres, strict=True)]
    if not any(covers):
        return nominal
    name = f"{obstacle.name} is within"
    model: Layer = {"name": name, "kind": "mesh" if system.d == 3 else "area", "group": "unsafe"}
    return [*nominal, layers.framed(model | {"colour": COVER, "opacity": 0.16}, times, covers)]


def _cover(normals: Array, support: Array, centre: Array, axes: list[int]) -> dict[str, Any] | None:
    if len(axes) == 3:
        surface = polyhedron(normals, support, centre)
        return None if surface is None else layers.corners(_placed(surface, np.zeros(3), axes))
    outline = flat_outline(Polytope(normals, support).vertices())[:, axes]
    return {"p": plain(layers.closed(outline).T)}


def _placed(surface: Surface, centre: Array, axes: list[int]) -> Surface:
    return Surface((surface.points + centre)[:, axes], surface.faces)
