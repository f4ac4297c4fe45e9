"""The scene of a schedule: the part of space that is shown, and everything in it but the flights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from reach.zonotope import Zonotope

from ..figures.geometry import tube_polygons, zonotope_outline
from ..figures.picture import Picture, shown_steps
from ..figures.style import GREEN, GREY, YELLOW
from ..figures.view import View, position_set
from ..obstacle_base import directions as directions_in_space
from ..planning.goals import Box, EllipticalNMT, Goal, LinearNMT, StationaryPoint
from ..system import Array
from . import layers
from .layers import Layer
from .line_scene import line_scene
from .numbers import plain
from .solids import Surface, polyhedron
from .unsafe_layers import unsafe_layers

MOST_FRAMES = 240
"""Most sets of a tube that are drawn: neighbours within a step are drawn as one beyond it."""

TUBE, SLICE, INITIAL = "#56B4E9", YELLOW, "#404040"


@dataclass(frozen=True)
class Bounds:
    """The part of space that is shown, in the axes of the figures.

    Attributes
    ----------
    low, high : ndarray, shape (d,)
        [m]
    """

    low: Array
    high: Array

    @classmethod
    def of(cls, picture: Picture, paths: Sequence[Array]) -> Bounds:
        """What the figures show of the plane, and the heights of the paths (N, d) that stay in it."""
        axes = list(picture.frame.axes)
        view = View.around(picture)
        low, high = np.array([view.x[0], view.y[0]]), np.array([view.x[1], view.y[1]])
        near = [path for path in paths if _near(path[:, axes[:2]], low, high)]
        for path in near:
            low = np.minimum(low, path[:, axes[:2]].min(axis=0))
            high = np.maximum(high, path[:, axes[:2]].max(axis=0))
        if len(axes) == 2:
            return cls(low, high)
        third = np.concatenate([path[:, axes[2]] for path in (*picture.path(), *near)])
        middle, size = (third.min() + third.max()) / 2, 1.15 * float(np.ptp(third))
        size = max(size, 0.35 * float(np.max(high - low)))  # depth enough to see solids as such
        return cls(np.append(low, middle - size / 2), np.append(high, middle + size / 2))

    def own(self, picture: Picture) -> tuple[Array, Array]:
        """The same box in the system's order of coordinates."""
        place = np.argsort(picture.frame.axes)
        return self.low[place], self.high[place]


def _near(path: Array, low: Array, high: Array) -> bool:
    reach = 0.25 * float(np.max(high - low))
    return bool(np.all(path > low - reach) and np.all(path < high + reach))


def scene_of(picture: Picture, paths: Sequence[Array]) -> dict[str, Any]:
    """The scene of a run folder as the page's script reads it.

    Parameters
    ----------
    picture : Picture
    paths : sequence of ndarray, shape (N, d)
        Positions flown [m]; the scene is widened for those that stay near it.

    Returns
    -------
    dict
        ``space`` (2 or 3 axes), ``equal`` (whether one scale serves all), ``axes``, ``range``, ``layers``.
    """
    if picture.system.d == 1:
        return line_scene(picture, paths)
    bounds = Bounds.of(picture, paths)
    low, high = bounds.own(picture)
    found = [
        *unsafe_layers(picture, low, high),
        *_goal(picture),
        *_start(picture),
        *_reference(picture),
        *_slices(picture),
        *_tube(picture),
    ]
    return {
        "space": picture.system.d,
        "equal": True,
        "axes": list(picture.frame.labels),
        "range": plain(np.stack([bounds.low, bounds.high], axis=1)),
        "layers": found,
    }


def _reference(picture: Picture) -> list[Layer]:
    axes = list(picture.frame.axes)
    before, after = picture.path(4)
    found = [layers.line("safe reference", before[:, axes], "reference", GREY, 3, "dot")]
    if len(after):
        found.append(layers.line("reference after T", after[:, axes], "reference", "#B5B5B5", 1.5, "dot"))
    return found


def _start(picture: Picture) -> list[Layer]:
    axes = list(picture.frame.axes)
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


def _goal(picture: Picture) -> list[Layer]:
    """The goal's positions: rings of ellipses, a stretch, a point or a box."""
    goal: Goal = picture.goal
    axes = list(picture.frame.axes)
    if isinstance(goal, EllipticalNMT):
        angle = np.linspace(0, 2 * np.pi, 121)
        ring = np.stack([2 * np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
        rims = [b for b in (goal.inner_semi_minor, goal.outer_semi_minor) if b > 0]
        found = [layers.line("goal: rim of the ring", rims[-1] * ring, "goal", GREEN, 2)]
        if len(rims) == 2:
            found.append(layers.line("goal: inner rim", rims[0] * ring, "goal", GREEN, 2))
            found.append(layers.mesh("goal", _strip(rims[0] * ring, rims[1] * ring), "goal", GREEN, 0.12))
        return found
    if isinstance(goal, LinearNMT):
        ends = np.array([[0.0, goal.along_track, z] for z in (-goal.amplitude_max, goal.amplitude_max)])
        return [layers.line("goal", ends[:, axes], "goal", GREEN, 5)]
    if isinstance(goal, StationaryPoint):
        place = (picture.system.position @ np.asarray(goal.state))[axes]
        return [layers.markers("goal", place[None], "goal", GREEN, "diamond", 5)]
    if isinstance(goal, Box):
        C, half = picture.system.position, np.asarray(goal.half_widths)
        known = np.isfinite(half)
        if np.any(C[:, ~known]):  # any position will do along some axis
            return []
        body = C @ Zonotope.box(np.asarray(goal.center), np.where(known, half, 0.0))
        drawn = _body("goal", body, axes, "goal", GREEN, 0.2)
        return [drawn] if drawn else []
    return []


def _strip(inner: Array, outer: Array) -> Surface:
    """The ring between two outlines of as many points."""
    a = np.arange(len(inner) - 1)
    b = a + len(inner)
    faces = np.vstack([np.stack([a, a + 1, b], axis=1), np.stack([a + 1, b + 1, b], axis=1)])
    return Surface(np.vstack([inner, outer]), faces)


def _slices(picture: Picture) -> list[Layer]:
    """Recoverable positions in the plane of the figures, at rest relative to the reference."""
    if picture.slices is None:
        return []
    steps = shown_steps(picture.planned)
    times = steps * picture.reference.delta
    outlines = picture.slices.centre[:, None] + picture.slices.outline
    if picture.system.d == 3:
        third = (picture.reference.chi[steps] @ picture.system.position.T)[:, picture.frame.axes[2]]
        level = np.broadcast_to(third[:, None, None], (*outlines.shape[:2], 1))
        outlines = np.concatenate([outlines, level], axis=2)
    name = "recoverable, last slice reached"
    if picture.system.d == 3:
        corner = np.arange(1, outlines.shape[1] - 1)
        fan = np.stack([np.zeros_like(corner), corner, corner + 1], axis=1)  # a slice is convex
        flat = [Surface(outline, fan) for outline in outlines]
        model = layers.mesh(name, flat[0], "slice", SLICE, 0.5)
        return [layers.framed(model, times, [layers.corners(one) for one in flat])]
    filled = layers.area(name, outlines[0], "slice", SLICE, 0.45)
    return [layers.framed(filled, times, [{"p": plain(layers.closed(one).T)} for one in outlines])]


def _tube(picture: Picture) -> list[Layer]:
    """Where the spacecraft may be over each part of a step, whatever the disturbance."""
    tube, axes = picture.tube, list(picture.frame.axes)
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
