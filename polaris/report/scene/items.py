"""What a scene is made of: plain data in the axes of the scene, whoever draws it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...model.system import Array
from ...runs.picture import Picture
from .closeups import CloseUp
from .geometry import Shape, gapped, stretches

if TYPE_CHECKING:
    from ...rta.arena import Shown
    from ...simulation.baselines import Flights


@dataclass(frozen=True, eq=False)
class Mark:
    """The true set at one of the instants that print shows, and what is written there besides its name.

    Perhaps with the outline (V, 2) of where another satellite is known to be, and the chaser's place (dim,).
    """

    shape: Shape
    told: str = ""
    cover: Array | None = None
    place: Array | None = None


@dataclass(frozen=True, eq=False)
class Item:
    """One thing of a scene; its role is a key of `palette.LOOKS`, which has a name for it, too.

    There is one shape, or one for each of the times (T,) [s], shown from then on (None where nothing is
    there). `shift` (T, dim) [m] says how far the shape is carried by each time, evenly in between; `modes`
    (T,) who flies from each time on. Marks are in order of importance; `way` (N, dim) is the path of the
    centre of a moving set; `passages` say which close-ups of the scene show how it is passed, if the plane
    does not; `cut` says that it goes on beyond the scene.
    """

    role: str
    shapes: tuple[Shape | None, ...]
    name: str = ""
    times: NDArray[np.floating[Any]] | None = None
    shift: Array | None = None
    modes: NDArray[np.int_] | None = None
    marks: tuple[Mark, ...] = ()
    way: Array | None = None
    passages: tuple[int, ...] = ()
    cut: bool = False

    @property
    def shape(self) -> Shape | None:
        """The first shape there is."""
        return next((one for one in self.shapes if one is not None), None)

    @property
    def points(self) -> Array:
        """Points of that shape, (N, dim); none if there is none."""
        return np.zeros((0, 2)) if self.shape is None else self.shape.points


@dataclass(frozen=True, eq=False)
class Scene:
    """What is drawn of a picture in two or three axes, from `low` to `high` (dim,) [m], along time [s].

    `axes` are the position coordinates drawn; `time_axis` is the first axis for motion on a line, the last
    one for a plane seen in space; `closeups` are the passages that the plane does not show to be safe.
    """

    picture: Picture
    axes: list[int]
    labels: tuple[str, ...]
    low: Array
    high: Array
    items: tuple[Item, ...] = ()
    time_axis: int | None = None
    closeups: tuple[CloseUp, ...] = ()

    def placed(self, positions: Array, times: Array) -> Array:
        """Positions (..., N, d) at times (N,) in the axes of the scene, shape (..., N, dim)."""
        shown = positions[..., self.axes]
        if self.time_axis is None:
            return shown
        along = np.broadcast_to(times[:, None], (*shown.shape[:-1], 1))
        parts = [along, shown] if self.time_axis == 0 else [shown, along]
        return np.concatenate(parts, axis=-1)

    def flown(self, key: str) -> Array | None:
        """The first run of a pilot, shape (N, dim); None if there is none."""
        flights = self.picture.flights.get(key)
        return None if flights is None else self.placed(self.picture.positions(flights), flights.times)

    def safe_path(self) -> Array:
        """The first run under Polaris, or the reference without one, shape (N, dim)."""
        times, path = self.picture.safe_path()
        return self.placed(path, times)

    def of(self, *roles: str) -> list[Item]:
        """Items of these roles, in their order."""
        return [item for role in roles for item in self.items if item.role == role]


def modes_per_node(runs: Flights | Shown) -> NDArray[np.int_]:
    """Who flies from each node to the next in every run, shape (r, N)."""
    if np.ndim(runs.modes) == 2:
        return np.asarray(runs.modes)
    one = np.repeat(runs.modes, (len(runs.times) - 1) // len(runs.modes))
    return np.tile(one, (len(runs.labels), 1))


def under_mode(flown: Array, flags: NDArray[np.bool_]) -> Array:
    """The stretches of a path (N+1, d) flown under one mode, which `flags` (N,) tells from each point on."""
    return gapped([flown[a : b + 1] for a, b in stretches(flags)], flown.shape[1])


def by_mode(picture: Picture, shown: Array, span: tuple[int, int] | None = None) -> dict[int, Array]:
    """The first run under Polaris in pieces by mode: the one that flew most first, so that none is hidden.

    `shown` (N+1, dim) says where its nodes are drawn, `span` the first and one-past-last node to draw.
    """
    a, b = (0, len(shown)) if span is None else span
    who = modes_per_node(picture.flights["polaris"])[0, a : b - 1]
    modes, counts = np.unique(who, return_counts=True)
    order = modes[np.argsort(-counts, kind="stable")]
    return {int(mode): under_mode(shown[a:b], who == mode) for mode in order}
