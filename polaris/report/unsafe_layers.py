"""Unsafe sets and keep-in sets as layers of a scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..figures.geometry import flat_outline
from ..figures.space import Space, moves
from ..figures.style import RED
from ..keep_in import KeepIn, KeepInCone
from ..obstacles import Obstacle
from ..satellite import SatelliteObstacle
from ..shapes import Ball, Polytope
from ..system import Array
from . import layers
from .layers import Layer
from .numbers import plain
from .solids import Surface, ball, cut_surface, hull, polyhedron

PATH = 121
"""Instants between which a moving set is carried evenly."""

COVER = "#9C4A50"
"""What another satellite is known to be within: duller than the set itself."""


def unsafe_layers(space: Space, axes: Sequence[int]) -> list[Layer]:
    """All unsafe sets of a scene in the plane or in space.

    Parameters
    ----------
    space : Space
        What is shown: unbounded sets are cut to it, in the plane to more, so that they fill any frame.
    axes : sequence of int
        The two or three position coordinates that are drawn.
    """
    found: list[Layer] = []
    space = space.wider(1.0) if len(axes) == 2 else space
    for obstacle in space.picture.obstacles:
        if isinstance(obstacle, KeepIn):
            found += _keep_in(obstacle, space, list(axes))
            continue
        found += _body(obstacle, space, list(axes))
        if isinstance(obstacle, SatelliteObstacle):
            found += _covers(obstacle, space, list(axes))
    return found


def _body(obstacle: Obstacle, space: Space, axes: list[int]) -> list[Layer]:
    """The true set: once, and the way it goes; a moving wall cut to the scene at every instant."""
    picture, moving = space.picture, moves(obstacle, space.picture)
    drawn: Layer | None
    if moving and isinstance(obstacle.shape, Polytope) and not obstacle.shape.bounded:
        times = np.linspace(0, picture.duration, PATH)
        frames = [_at(obstacle, space, axes, float(t)) for t in times]
        known = [one for one in frames if one is not None]
        shift = (obstacle.centre(times, picture.system) - obstacle.centre(0.0, picture.system))[:, axes]
        cut = [one and _from(one, gone) for one, gone in zip(frames, shift, strict=True)]
        return [layers.carried(layers.framed(known[0], times, cut), times, shift)] if known else []
    drawn = _at(obstacle, space, axes, 0.0)
    if drawn is None or not moving:
        return [drawn] if drawn else []
    times = np.linspace(0, picture.duration, PATH)
    centres = obstacle.centre(times, picture.system)
    return [layers.carried(drawn, times, (centres - centres[0])[:, axes])]


def _at(obstacle: Obstacle, space: Space, axes: list[int], t: float) -> Layer | None:
    name = obstacle.name
    if len(axes) == 2:
        outline = space.outline(obstacle, t, axes)
        return layers.area(name, outline, "unsafe", RED, 0.4) | {"label": name} if len(outline) else None
    if isinstance(obstacle.shape, Ball):
        own = ball(obstacle.shape.radius)
        surface: Surface | None = Surface(own.points + obstacle.centre(t, space.picture.system), own.faces)
    else:
        surface = hull(space.corners(obstacle, t))
    if surface is None:
        return None
    cut = isinstance(obstacle.shape, Polytope) and not obstacle.shape.bounded
    return layers.mesh(name, _placed(surface, axes), "unsafe", RED, 0.25 if cut else 0.5) | {"label": name}


def _from(frame: Mapping[str, Any], shift: Array) -> dict[str, Any]:
    """A frame's coordinates seen from where the set has gone by its time: it is carried on from there."""
    points = np.array(frame["p"], dtype=float).T - shift if frame["p"] else np.zeros((0, len(shift)))
    return {key: frame[key] for key in ("p", "f") if key in frame} | {
        "p": plain(points.T) if len(points) else []
    }


def _keep_in(obstacle: KeepIn, space: Space, axes: list[int]) -> list[Layer]:
    """What the chaser must stay inside: a translucent surface, open where it leaves the scene."""
    name, inside = f"{obstacle.name} (stay inside)", obstacle.inside
    if len(axes) == 2:
        outline = layers.closed(flat_outline(space.corners(obstacle, 0.0)[:, axes]))
        return [layers.line(name, outline, "unsafe", RED, 1.5, "dash")] if len(outline) else []
    surface = cut_surface(inside.H, inside.b, space.low, space.high, closed=False)
    found = [layers.mesh(name, _placed(surface, axes), "unsafe", RED, 0.16)] if surface else []
    return found + _rulings(obstacle, space, axes)


def _rulings(obstacle: KeepIn, space: Space, axes: list[int]) -> list[Layer]:
    """Lines from a cone's tip along its sides: a translucent surface alone is hard to read."""
    if not isinstance(obstacle, KeepInCone):
        return []
    tip, axis = obstacle.anchor, np.asarray(obstacle.axis)
    aside = np.linalg.svd(axis[None])[2][1:]
    angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    ways = axis + np.tan(obstacle.half_angle_rad) * np.stack([np.cos(angle), np.sin(angle)], axis=1) @ aside
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.where(
            ways > 0, (space.high - tip) / ways, np.where(ways < 0, (space.low - tip) / ways, np.inf)
        )
    reach = np.maximum(ends.min(axis=1), 0.0)
    if obstacle.length is not None:
        reach = np.minimum(reach, obstacle.length)
    gap = np.full(3, np.nan)
    points = np.array(
        [part for way, s in zip(ways, reach, strict=True) for part in (tip, tip + s * way, gap)]
    )
    return [layers.line(f"{obstacle.name}: its sides", points[:, axes], "unsafe", RED, 1.0)]


def _covers(obstacle: SatelliteObstacle, space: Space, axes: list[int]) -> list[Layer]:
    """The timed cover within which another satellite is known to be, as the proof uses it.

    Its offsets run evenly over a step, as the nominal place does here from one decision to the next: seen
    from there, the larger ones of either end hold for all of the step.
    """
    picture = space.picture
    system, K = picture.system, picture.planned
    times = np.arange(K + 1) * picture.reference.delta
    (timed,) = obstacle.timed_polytopes(system, picture.reference.delta, K)
    centres = obstacle.centre(times, system)
    gone = centres @ timed.normals.T
    ends = np.maximum(timed.offsets[:, 0] - gone[:-1], timed.offsets[:, 1] - gone[1:])
    ends = np.vstack([ends, timed.offsets[-1, 1] - gone[-1]])
    middle = np.zeros(system.d)
    covers = [_cover(timed.normals, b, middle, axes) for b in ends]
    if not any(covers):
        return []
    model: Layer = {
        "name": f"{obstacle.name} is within",
        "kind": "mesh" if len(axes) == 3 else "area",
        "group": "unsafe",
        "colour": COVER,
        "opacity": 0.16,
    }
    return [layers.carried(layers.framed(model, times, covers), times, centres[:, axes])]


def _cover(normals: Array, support: Array, centre: Array, axes: list[int]) -> dict[str, Any] | None:
    if len(axes) == 3:
        surface = polyhedron(normals, support, centre)
        return None if surface is None else layers.corners(_placed(surface, axes))
    if normals.shape[1] == 3:
        solid = polyhedron(normals, support, centre)
        corners = np.zeros((0, 3)) if solid is None else solid.points
    else:
        corners = Polytope(normals, support).vertices()
    return {"p": plain(layers.closed(flat_outline(corners[:, axes])).T)}


def _placed(surface: Surface, axes: list[int]) -> Surface:
    return Surface(surface.points[:, axes], surface.faces)
