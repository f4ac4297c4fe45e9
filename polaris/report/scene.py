"""The scene of a schedule: the part of space that is shown, and everything in it but the flights."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from reach.zonotope import Zonotope

from ..figures.closeups import is_flat
from ..figures.geometry import flat_outline, tube_polygons, zonotope_outline
from ..figures.picture import Picture
from ..figures.space import Part, Space, position_set
from ..figures.style import GREEN, GREY
from ..obstacle_base import directions as directions_in_space
from ..system import Array
from . import layers
from .layers import Layer
from .line_scene import line_scene
from .numbers import plain
from .solids import Surface, hull, polyhedron
from .unsafe_layers import unsafe_layers

MOST_FRAMES = 240
"""Most sets of a tube that are drawn: neighbours within a step are drawn as one beyond it."""

TUBE, INITIAL = "#56B4E9", "#404040"


def shown_axes(picture: Picture, paths: Sequence[Array]) -> list[int]:
    """Position coordinates that are drawn: the plane of motion if it shows all, else all of them."""
    frame = picture.frame
    return frame.flat if is_flat(picture, paths) else list(frame.axes)


def scene_of(picture: Picture, paths: Sequence[Array], axes: list[int] | None = None) -> dict[str, Any]:
    """The scene of a run folder as the page's script reads it.

    Parameters
    ----------
    picture : Picture
    paths : sequence of ndarray, shape (N, d)
        Positions flown [m]; the scene is widened for those that stay near it.
    axes : list of int, optional
        Position coordinates to draw, two or three; default `shown_axes`.

    Returns
    -------
    dict
        ``space`` (2 or 3 axes), ``equal`` (whether one scale serves all), ``axes``, ``range``, ``layers``.
    """
    if picture.system.d == 1:
        return line_scene(picture, paths)
    axes = shown_axes(picture, paths) if axes is None else axes
    space = Space.of(picture, paths)
    found = [
        *unsafe_layers(space, axes),
        *_goal(space, axes),
        *_start(picture, axes),
        *_reference(picture, axes),
        *_slices(picture, axes),
        *_tube(picture, axes),
    ]
    return {
        "space": len(axes),
        "equal": True,
        "axes": list(picture.frame.labels[: len(axes)]),
        "range": plain(np.stack([space.low, space.high], axis=1)[axes]),
        "layers": found,
    }


def _reference(picture: Picture, axes: list[int]) -> list[Layer]:
    before, after = picture.path(4)
    found = [layers.line("safe reference", before[:, axes], "reference", GREY, 3, "dot")]
    if len(after):
        found.append(layers.line("reference after T", after[:, axes], "reference", "#B5B5B5", 1.5, "dot"))
    return found


def _start(picture: Picture, axes: list[int]) -> list[Layer]:
    start = position_set(picture)
    centre = np.asarray(start.c)[axes][None]
    found = [layers.markers("start", centre, "initial", INITIAL, "circle", 4)]
    drawn = _body("initial set", start, axes, "initial", INITIAL, 0.4)
    return [*found, drawn] if drawn else found


def _body(
    name: str, body: Zonotope, axes: list[int], group: str, colour: str, opacity: float
) -> Layer | None:
    """One set of positions."""
    if len(axes) == 2:
        return layers.area(name, zonotope_outline(body, axes), group, colour, opacity)
    rays = directions_in_space(3)
    c, G = body.c[axes], body.G[axes]
    size = np.abs(rays @ G).sum(axis=-1)
    surface = polyhedron(rays, rays @ c + np.maximum(size, 1e-3 * float(np.max(size, initial=0.0))), c)
    return None if surface is None else layers.mesh(name, surface, group, colour, opacity)


def _goal(space: Space, axes: list[int]) -> list[Layer]:
    """The goal's positions: rings of ellipses, a stretch, a point or a box."""
    parts = space.goal()
    found = [drawn for part in parts if (drawn := _part(part, axes))]
    if len(parts) == 2 and len(axes) == 3:
        rims = [part.points[:, axes] for part in parts]
        found.append(layers.mesh("goal", _strip(*rims), "goal", GREEN, 0.12))
    return found


def _part(part: Part, axes: list[int]) -> Layer | None:
    points = part.points[:, axes]
    if part.kind == "point" or np.all(np.ptp(points, axis=0) == 0):  # a line seen end on, too
        return layers.markers("goal", points[:1], "goal", GREEN, "diamond", 5)
    if part.kind == "curve":
        return layers.line("goal", points, "goal", GREEN, 2 if len(points) > 2 else 5)
    if len(axes) == 2:
        return layers.area("goal", flat_outline(points), "goal", GREEN, 0.2)
    surface = hull(points)
    return None if surface is None else layers.mesh("goal", surface, "goal", GREEN, 0.2)


def _strip(inner: Array, outer: Array) -> Surface:
    """The ring between two outlines of as many points."""
    a = np.arange(len(inner) - 1)
    b = a + len(inner)
    faces = np.vstack([np.stack([a, a + 1, b], axis=1), np.stack([a + 1, b + 1, b], axis=1)])
    return Surface(np.vstack([inner, outer]), faces)


def _slices(picture: Picture, axes: list[int]) -> list[Layer]:
    """Slices of the recoverable sets through the states of each run under Polaris, at their own times."""
    if picture.slices is None or "polaris" not in picture.flights:
        return []
    slices = picture.slices
    return [layers.slices(slices.times, slices.outlines, slices.places[..., axes])]


def _tube(picture: Picture, axes: list[int]) -> list[Layer]:
    """Where the spacecraft may be over each part of a step, whatever the disturbance."""
    tube = picture.tube
    if tube is None or not len(tube.bow):
        return []
    K, q = tube.bow.shape[:2]
    parts = max(1, min(q, MOST_FRAMES // K))
    edges = np.unique(np.linspace(0, q, parts + 1).astype(int))
    times = (np.arange(K)[:, None] + edges[:-1] / q) * picture.reference.delta
    centre, generators, bow = tube.centre[..., axes], tube.generators[..., axes, :], tube.bow[..., axes]
    model: Layer = {"name": "reachable now", "group": "tube", "colour": TUBE, "opacity": 0.35}
    if len(axes) == 2:
        outlines = tube_polygons(centre, generators, bow, parts, 24).reshape(-1, 24, 2)
        frames = [{"p": plain(layers.closed(outline).T)} for outline in outlines]
        return [layers.framed(model | {"kind": "area"}, times.ravel(), frames)]
    rays = directions_in_space(3)
    node = centre @ rays.T + np.abs(np.einsum("ri,kqig->kqrg", rays, generators)).sum(axis=-1)
    between = np.maximum(node[:, :-1], node[:, 1:]) + bow @ np.abs(rays).T
    support = np.stack(
        [between[:, a:b].max(axis=1) for a, b in zip(edges[:-1], edges[1:], strict=True)], axis=1
    )
    inside = np.stack([centre[:, (a + b) // 2] for a, b in zip(edges[:-1], edges[1:], strict=True)], axis=1)
    solids = [
        polyhedron(rays, b, c)
        for b, c in zip(support.reshape(-1, len(rays)), inside.reshape(-1, 3), strict=True)
    ]
    frames = [layers.corners(solid) if solid else {"p": []} for solid in solids]
    return [layers.framed(model | {"kind": "mesh"}, times.ravel(), frames)]
