"""A scene as the page's script reads it: lines, areas and surfaces, at rest or moving.

A layer is a mapping with ``name``, ``kind`` (``line``, ``area``, ``mesh`` or ``points``), ``group`` (what
switches show and hide), ``colour``, ``opacity``, and either ``p``, coordinates by axis in metres (meshes
also ``f``, corners of the triangles by place), or ``frames``, a list of those. Frame i is shown from
``t[i]`` on. A layer with ``t`` and ``shift`` is carried along that path, its frames too: they must hold until
the next one. A ``slice`` is of the instants ``t`` alone, with frames by run; ``at`` is the chaser. Those of
``over`` (place in ``t``, name, colour) are of the hand-overs.
"""

from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ...runs.plot_data import taking_over
from ..scene.geometry import DrawnShape, closed
from ..scene.items import Item, Scene, View
from ..scene.palette import LOOKS, mode_colour

Layer = dict[str, Any]

DIGITS = 6  # significant digits of what is drawn; tables show the folder's numbers with four
AREAS = {"unsafe": 0.5, "cover": 0.16, "keep_in": 0.16, "goal": 0.2, "ring": 0.12, "initial": 0.4}
AREAS |= {"slice": 0.45, "tube": 0.35, "chief": 0.6}
"""Opacity of areas and surfaces, by role."""

LINES = {"keep_in": (1.5, "dash"), "sides": (1.0, "solid"), "goal": (2.0, "solid"), "initial": (5.0, "solid")}
LINES |= {"reference": (3.0, "dot"), "tail": (1.5, "dot"), "keep": (1.0, "solid"), "sun": (3.0, "dash")}
LINES |= {"predicted": (1.5, "solid")}
"""Width and dashes of lines, by role."""

POINTS = {"start": ("circle", 4), "goal": ("diamond", 5)}  # symbol and size of single points, by role


def plain(values: ArrayLike) -> Any:
    """Nested lists of short numbers, whole ones without ``.0``; those not finite are None."""
    array = np.asarray(values)
    if array.dtype.kind in "iub":
        return array.tolist()
    if array.ndim > 1:
        return [plain(part) for part in array]
    return [_short(value) for value in array.tolist()] if array.ndim else _short(float(array))


def _short(value: float) -> float | int | None:
    if not isfinite(value):
        return None
    short = float(f"{value:.{DIGITS}g}")
    return int(short) if short.is_integer() and abs(short) < 1e15 else short


def scene_data(scene: View) -> dict[str, Any]:
    """A scene: ``space`` (2 or 3 axes), ``equal`` (one scale serves all), ``axes``, ``range``, ``layers``."""
    layers = _slices(scene) if isinstance(scene, Scene) else []
    layers += [_layer(item) for item in scene.items if item.shape is not None]
    frame = {"space": len(scene.labels), "equal": not scene.over_time, "axes": list(scene.labels)}
    return frame | {"range": plain(np.stack([scene.low, scene.high], axis=1)), "layers": layers}


def _layer(item: Item) -> Layer:
    """One thing of a scene as the page's script reads it."""
    shape, look = item.shape, LOOKS[item.role]
    assert shape is not None
    name = item.name or look.name
    layer: Layer = {"name": name, "kind": shape.kind, "group": look.group, "colour": look.colour}
    layer["opacity"] = 1.0
    if shape.kind in ("area", "mesh"):
        layer["opacity"] = AREAS[item.role]
        if item.role == "unsafe" and (shape.kind == "area" or item.cut):
            layer["opacity"] = 0.4 if shape.kind == "area" else 0.25
    elif shape.kind == "line":
        layer["width"], layer["dash"] = LINES[item.role]
        if item.role == "goal" and len(shape.points) == 2:
            layer["width"] = 5.0
    else:
        layer["symbol"], layer["size"] = POINTS[item.role]
    if item.role in ("unsafe", "chief"):
        layer["label"] = name.partition(":")[0] if item.role == "chief" else name
    if item.times is None:
        return layer | _corners(shape)
    layer["t"] = plain(item.times)
    if item.shift is not None:
        layer["shift"] = plain(item.shift.T)
    if len(item.shapes) == 1:
        return layer | _corners(shape)
    return layer | {"frames": [_corners(one) for one in item.shapes]}


def _slices(scene: Scene) -> list[Layer]:
    """Slices of the recoverable sets through the states of each run under Polaris, at their own times."""
    slices, look = scene.picture.slices, LOOKS["slice"]
    if slices is None or "polaris" not in scene.picture.flights:
        return []
    outlines, places = slices.outlines, slices.places[..., scene.axes]
    if scene.over_time:
        along = np.broadcast_to(slices.times[:, None, None, None], outlines.shape)
        outlines = np.concatenate([along, outlines], axis=-1)
        places = np.concatenate([along[:, :, 0], places], axis=-1)
    frames = [
        [
            None if np.isnan(place[-1]) else {"p": plain(closed(outline).T), "at": plain(place)}
            for outline, place in zip(outlines[:, run], places[:, run], strict=True)
        ]
        for run in range(places.shape[1])
    ]
    head = {"name": look.name, "kind": "slice", "group": look.group, "colour": look.colour}
    over = [
        (i, taking_over(t, mode), mode_colour(mode))
        for t, mode in scene.picture.hand_overs.items()
        for i in np.flatnonzero(np.isclose(slices.times, t, rtol=1e-9)).tolist()
    ]
    fields = {"opacity": AREAS["slice"], "pilot": "polaris", "over": over}
    return [head | fields | {"t": plain(slices.times), "frames": frames}]


def _corners(shape: DrawnShape | None) -> dict[str, Any]:
    """Coordinates by axis, and triangles of a surface."""
    if shape is None:
        return {"p": []}
    points = closed(shape.points) if shape.kind == "area" else shape.points
    corners = {"p": plain(points.T)}
    return corners if shape.faces is None else corners | {"f": plain(shape.faces.T)}
