"""What a scene consists of, as the page's script reads it: lines, areas and surfaces, at rest or moving.

A layer is a mapping with ``name``, ``kind`` (``line``, ``area``, ``mesh`` or ``points``), ``group`` (what
switches show and hide), ``colour``, ``opacity``, and either ``p``, coordinates by axis in metres (meshes
also ``f``, corners of the triangles by place), or ``frames``, a list of those. Frame i is shown from
``t[i]`` on. A layer with ``t`` and ``shift`` is carried along that path, its frames too: they must hold
until the next one. A ``slice`` is of the instants ``t`` alone, with frames by run; ``at`` is the chaser.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..figures.style import YELLOW
from ..system import Array
from .numbers import plain
from .solids import Surface

Layer = dict[str, Any]


def line(name: str, points: Array, group: str, colour: str, width: float = 2.0, dash: str = "solid") -> Layer:
    """A path through points (N, dim) [m]; gaps where they are nan."""
    return {
        "name": name,
        "kind": "line",
        "group": group,
        "colour": colour,
        "opacity": 1.0,
        "width": width,
        "dash": dash,
        "p": plain(points.T),
    }


def markers(name: str, points: Array, group: str, colour: str, symbol: str, size: float) -> Layer:
    """Single points (N, dim) [m]."""
    return {
        "name": name,
        "kind": "points",
        "group": group,
        "colour": colour,
        "opacity": 1.0,
        "symbol": symbol,
        "size": size,
        "p": plain(points.T),
    }


def area(name: str, outline: Array, group: str, colour: str, opacity: float = 0.35) -> Layer:
    """The inside of an outline (V, dim) [m]."""
    return {
        "name": name,
        "kind": "area",
        "group": group,
        "colour": colour,
        "opacity": opacity,
        "p": plain(closed(outline).T),
    }


def mesh(name: str, surface: Surface, group: str, colour: str, opacity: float = 0.35) -> Layer:
    """A surface in space."""
    return {"name": name, "kind": "mesh", "group": group, "colour": colour, "opacity": opacity} | corners(
        surface
    )


def corners(surface: Surface) -> dict[str, Any]:
    """Coordinates and triangles of a surface."""
    return {"p": plain(surface.points.T), "f": plain(surface.faces.T)}


def slices(times: Array, outlines: Array, places: Array) -> Layer:
    """Recoverable sets at times (S,) [s] by run, as in `SlicePicture`; those that are nan are left out."""
    if outlines.shape[-1] == 1:  # on the line, over time
        along = np.broadcast_to(times[:, None, None, None], outlines.shape)
        outlines = np.concatenate([along, outlines], axis=-1)
        places = np.concatenate([along[:, :, 0], places], axis=-1)
    frames = [
        [
            None if np.isnan(place[-1]) else {"p": plain(closed(outline).T), "at": plain(place)}
            for outline, place in zip(outlines[:, run], places[:, run], strict=True)
        ]
        for run in range(places.shape[1])
    ]
    look = {"name": "recoverable set", "kind": "slice", "group": "slice", "colour": YELLOW, "opacity": 0.45}
    return look | {"pilot": "polaris", "t": plain(times), "frames": frames}


def carried(layer: Layer, times: ArrayLike, shift: Array) -> Layer:
    """The same layer, moved by ``shift`` (T, dim) [m] at times (T,) [s], evenly in between.

    The times are those of its frames, if it has any.
    """
    return layer | {"t": plain(times), "shift": plain(shift.T)}


def framed(layer: Layer, times: ArrayLike, frames: Sequence[dict[str, Any] | None]) -> Layer:
    """The same layer with other coordinates from each time on; None hides it."""
    return {key: value for key, value in layer.items() if key not in ("p", "f")} | {
        "t": plain(times),
        "frames": [frame or {"p": []} for frame in frames],
    }


def closed(outline: Array) -> Array:
    """An outline whose last point is its first."""
    return np.vstack([outline, outline[:1]]) if len(outline) else outline
