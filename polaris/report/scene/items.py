"""Parts of a scene: plain data in its axes, and passages that the plane does not show to be safe."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...model.scene.distances import stretches
from ...model.scene.keep_in import KeepIn
from ...model.scene.obstacle import Obstacle
from ...model.scene.satellite import SatelliteObstacle
from ...model.scene.shapes import BallShape
from ...model.system import Array
from ...runs.plot_data import PlotData
from ...simulation.baselines import FlightEnvelope
from .geometry import DrawnShape, flat_outline, gapped
from .palette import PILOTS, mode_colour
from .space import Space


@dataclass(frozen=True, eq=False)
class Mark:
    """The true set at an instant that print shows, its caption, a cover's outline, the chaser's place."""

    shape: DrawnShape
    caption: str = ""
    cover: Array | None = None
    place: Array | None = None


@dataclass(frozen=True, eq=False)
class Item:
    """One thing of a scene; its role is a key of `palette.LOOKS`, which has a name for it, too.

    There is one shape, or one for each of the times (T,) [s], shown from then on (None where nothing is
    there). `shift` (T, dim) [m] says how far the shape is carried by each time, evenly in between; `modes`
    (T,) who flies from each time on. Marks are in order of importance; `path` (N, dim) is the path of the
    centre of a moving set; `passages` say which close-ups of the scene show how it is passed, if the plane
    does not; `cut` says that it goes on beyond the scene.
    """

    role: str
    shapes: tuple[DrawnShape | None, ...]
    name: str = ""
    times: NDArray[np.floating[Any]] | None = None
    shift: Array | None = None
    modes: NDArray[np.int_] | None = None
    marks: tuple[Mark, ...] = ()
    path: Array | None = None
    passages: tuple[int, ...] = ()
    cut: bool = False

    @property
    def shape(self) -> DrawnShape | None:
        """The first shape there is."""
        return next((one for one in self.shapes if one is not None), None)

    @property
    def points(self) -> Array:
        """Points of that shape, (N, dim); none if there is none."""
        return np.zeros((0, 2)) if self.shape is None else self.shape.points


@dataclass(frozen=True, eq=False)
class View:
    """Items in two or three axes, from `low` to `high` (dim,) [m]; `over_time` the first is time [s]."""

    axes: list[int]
    labels: tuple[str, ...]
    low: Array
    high: Array
    items: tuple[Item, ...] = ()
    over_time: bool = False

    def placed(self, positions: Array, times: Array) -> Array:
        """Positions (..., N, d) at times (N,) in the axes of the scene, shape (..., N, dim)."""
        coords = positions[..., self.axes]
        if not self.over_time:
            return coords
        along = np.broadcast_to(times[:, None], (*coords.shape[:-1], 1))
        return np.concatenate([along, coords], axis=-1)

    def with_roles(self, *roles: str) -> list[Item]:
        """Items of these roles, in their order."""
        return [item for role in roles for item in self.items if item.role == role]

    def contains(self, points: Array) -> Any:
        """Return True for each point (..., dim) that is within."""
        return np.all((points > self.low) & (points < self.high), axis=-1)

    def visible(self, outline: Array) -> Array:
        """Points along a closed outline that are within, shape (N, dim)."""
        s = np.linspace(0, 1, 200)[:, None, None]
        edge = ((1 - s) * outline + s * np.roll(outline, -1, axis=0)).reshape(-1, outline.shape[1])
        return np.asarray(edge[self.contains(edge)])


@dataclass(frozen=True, eq=False)
class Scene(View):
    """Drawing of a picture."""

    picture: PlotData = field(kw_only=True)
    closeups: tuple[CloseUp, ...] = ()

    def safe_path(self) -> Array:
        """The first run under Polaris, or the reference without one, shape (N, dim)."""
        times, path = self.picture.safe_path()
        return self.placed(path, times)


class Actor(NamedTuple):
    """Controller or spacecraft, its names on the page and in print, and its runs; shown at first if `on`."""

    key: str
    name: str
    short: str
    colour: str
    dash: str
    flights: FlightEnvelope
    on: bool = True


def drawn_pilots(picture: PlotData) -> list[Actor]:
    """Everyone whose flights a picture holds; several experimental controllers are named."""
    controllers, several = [], len(picture.controllers) > 2
    for key in (key for key in {**PILOTS, **picture.flights} if key in picture.flights):
        name, short, colour, dash = PILOTS.get(key, PILOTS["experimental"])
        flights = picture.flights[key]
        if short == PILOTS["experimental"][1] and several:
            name = short = f"{short} ({flights.controller})"
            if flights.controller in picture.controllers:
                colour = mode_colour(picture.controllers.index(flights.controller))
        controllers.append(Actor(key, name, short, colour, dash, flights, key == "polaris"))
    return controllers


def alone(picture: PlotData) -> list[Actor]:
    """Experimental controllers that flew on their own."""
    return [one for one in drawn_pilots(picture) if one.key not in ("polaris", "safety")]


def modes_per_node(runs: FlightEnvelope) -> NDArray[np.int_]:
    """Return the mode that flies from each node to the next in every run, shape (r, N)."""
    if np.ndim(runs.modes) == 2:
        return np.asarray(runs.modes)
    one = np.repeat(runs.modes, (len(runs.times) - 1) // len(runs.modes))
    return np.tile(one, (len(runs.labels), 1))


def under_mode(path: Array, flags: NDArray[np.bool_]) -> Array:
    """The stretches of a path (N+1, d) flown under one mode, which `flags` (N,) tells from each point on."""
    return gapped([path[a : b + 1] for a, b in stretches(flags)], path.shape[1])


def by_mode(picture: PlotData, path: Array, span: tuple[int, int] | None = None) -> dict[int, Array]:
    """The first run under Polaris at places (N+1, dim) by mode, over nodes `span`: most flown first."""
    a, b = (0, len(path)) if span is None else span
    mode_at = modes_per_node(picture.flights["polaris"])[0, a : b - 1]
    modes, counts = np.unique(mode_at, return_counts=True)
    order = modes[np.argsort(-counts, kind="stable")]
    return {int(mode): under_mode(path[a:b], mode_at == mode) for mode in order}


MOST = 6  # most close-ups of a figure: those that are passed nearest
FLAT = 0.05  # motion out of the plane that nobody would see, as a share of its size


@dataclass(frozen=True, eq=False)
class CloseUp:
    """One passage of an unsafe set, closest at a time [s] with a distance [m].

    `axes` are the coordinates that show the gap, None if only distance over time does; `span` its samples.
    """

    obstacle: Obstacle
    time: float
    distance: float
    axes: list[int] | None
    span: tuple[int, int]


def closeups(picture: PlotData) -> list[CloseUp]:
    """Passages that the plane of the figures does not show to be safe, in the order of time.

    Stretches of the safe path drawn within a set but outside it; none of a set truly entered.
    """
    if picture.system.d < 3:
        return []
    path, space = picture.safe_path()[1], Space.from_paths(picture)
    passages: list[CloseUp] = []
    for obstacle in picture.obstacles:
        if isinstance(obstacle, KeepIn) or not len(space.corners(obstacle, picture.approach(obstacle).time)):
            continue
        distance = obstacle.signed_distance(picture.safe_path()[0], path, picture.system)
        if np.all(distance > 0):
            passages += _passages(obstacle, space, distance)
    nearest = sorted(passages, key=lambda one: one.distance)[:MOST]
    return sorted(nearest, key=lambda one: one.time)


def _passages(obstacle: Obstacle, space: Space, distance: Array) -> list[CloseUp]:
    """Passages of one set, until the panels together show the distance (N,) of all samples."""
    picture, frame = space.picture, space.picture.frame
    times, path = picture.safe_path()
    planes = [[frame.axes[0], frame.axes[2]], [frame.axes[1], frame.axes[2]]]
    hidden = plane_gap(obstacle, picture, frame.flat) <= 0
    gaps = [plane_gap(obstacle, picture, axes) for axes in planes] if hidden.any() else []
    passages = []
    while hidden.any():
        index = int(np.flatnonzero(hidden)[np.argmin(distance[hidden])])
        widest = int(np.argmax([gap[index] for gap in gaps]))
        axes = planes[widest] if gaps[widest][index] > 0 else None
        shows = distance > 0 if axes is None else gaps[widest] > 0
        cover = space.cover(obstacle, float(times[index]))
        if axes is not None and cover is not None:  # the one that is drawn, for all of the stretch
            shift = obstacle.centre(times, picture.system) - obstacle.centre(times[index], picture.system)
            shows &= outline_gap(flat_outline(cover[:, axes]), (path - shift)[:, axes]) > 0
            shows[index] = True
        span = next((a, b) for a, b in stretches(shows) if a <= index < b)
        hidden[slice(*span)] = False
        if cover is None:
            index = span[0] + int(np.argmin(distance[slice(*span)]))
        passages.append(CloseUp(obstacle, float(times[index]), float(distance[index]), axes, span))
    return passages


def is_flat(picture: PlotData, paths: Sequence[Array] = ()) -> bool:
    """Return True if the plane of the figures shows all there is to see, of `paths` (N, d) [m] flown too."""
    if picture.system.d < 3:
        return True
    space = Space.from_paths(picture)
    all_paths = (*picture.path(), picture.safe_path()[1], *paths)
    third = np.concatenate([path[:, picture.frame.axes[2]] for path in all_paths])
    size = float(np.max((space.high - space.low)[picture.frame.flat]))
    return bool(np.ptp(third) <= FLAT * size) and not closeups(picture)


def plane_gap(obstacle: Obstacle, picture: PlotData, axes: Sequence[int]) -> Array:
    """Return the distance (N,) [m] of the safe path from a set (or a satellite's cover) in two axes."""
    axes, system, shape = list(axes), picture.system, obstacle.drawn
    times, path = picture.safe_path()
    if isinstance(obstacle, SatelliteObstacle) or not shape.bounded:  # by the facets that are seen edge on
        (timed,) = obstacle.timed_polytopes(system, picture.reference.delta, picture.planned)
        rows = np.all(np.abs(np.delete(timed.normals, axes, axis=1)) < 1e-9, axis=1)
        offsets = timed.offsets_at(times, picture.reference.delta)[:, rows]
        return np.asarray((path @ timed.normals[rows].T - offsets).max(axis=1, initial=-np.inf))
    path = path - obstacle.centre(times, system)
    if isinstance(shape, BallShape):
        return np.asarray(np.linalg.norm(path[:, axes], axis=1) - shape.radius)
    return outline_gap(flat_outline(shape.vertices()[:, axes]), path[:, axes])


def outline_gap(outline: Array, points: Array) -> Array:
    """Return a lower bound on the distance of points (N, 2) from a convex outline (V, 2); negative inside."""
    edge = np.roll(outline, -1, axis=0) - outline
    normal = np.stack([edge[:, 1], -edge[:, 0]], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return np.asarray((points @ normal.T - np.sum(normal * outline, axis=1)).max(axis=1))
