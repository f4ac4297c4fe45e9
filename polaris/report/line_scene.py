"""The scene of a system that moves on a line: position over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..figures.picture import Picture
from ..figures.style import GREY, RED
from ..figures.view import position_set
from ..keep_in import KeepIn
from ..system import Array
from . import layers
from .layers import Layer
from .numbers import plain

INSTANTS = 121
FAR = 1e6
"""Where the outline of an unbounded set is cut [m], before it is cut to the scene."""


def line_scene(picture: Picture, paths: Sequence[Array]) -> dict[str, Any]:
    """The scene as the page's script reads it; see `scene.scene_of`.

    Parameters
    ----------
    picture : Picture
        Of a system with one position coordinate.
    paths : sequence of ndarray, shape (N, 1)
        Positions flown [m].
    """
    before, _ = picture.path(4)
    delta = picture.reference.delta
    times = ((np.arange(picture.planned)[:, None] + np.linspace(0, 1, 5)) * delta).ravel()
    shown = np.concatenate([before[:, 0], *(path[:, 0] for path in paths)])
    pad = 0.3 * float(np.ptp(shown)) + 1e-9
    low, high = float(shown.min()) - pad, float(shown.max()) + pad
    start = position_set(picture)
    reach = float(np.abs(start.G).sum())
    ends = np.array([[0.0, start.c[0] - reach], [0.0, start.c[0] + reach]])
    return {
        "space": 2,
        "equal": False,
        "axes": ["Time (s)", picture.frame.labels[0]],
        "range": plain([[0.0, picture.duration], [low, high]]),
        "layers": [
            *_unsafe(picture, low, high),
            layers.line("initial set", ends, "initial", "#404040", 5),
            layers.line(
                "safe reference", np.column_stack([times, before[:, 0]]), "reference", GREY, 3, "dot"
            ),
            *_tube(picture),
        ],
    }


def _unsafe(picture: Picture, low: float, high: float) -> list[Layer]:
    times = np.linspace(0, picture.duration, INSTANTS)
    found: list[Layer] = []
    for obstacle in picture.obstacles:
        ends = [obstacle.outline(float(t), picture.system, FAR)[:, 0] for t in times]
        span = np.clip([[end.min(), end.max()] for end in ends], low, high)
        rims = [np.column_stack([times, span[:, side]]) for side in (0, 1)]
        if isinstance(obstacle, KeepIn):
            name = f"{obstacle.name} (stay inside)"
            found += [layers.line(name, rim, "unsafe", RED, 1.5, "dash") for rim in rims]
        else:
            band = np.vstack([rims[0], rims[1][::-1]])
            found.append(layers.area(obstacle.name, band, "unsafe", RED, 0.4) | {"label": obstacle.name})
    return found


def _tube(picture: Picture) -> list[Layer]:
    tube = picture.tube
    if tube is None or not len(tube.bow):
        return []
    K, delta = len(tube.bow), picture.reference.delta
    centre, reach = tube.centre[..., 0], np.abs(tube.generators[..., 0, :]).sum(axis=-1)
    above, below = centre + reach, centre - reach
    bow = tube.bow[..., 0]
    top = (np.maximum(above[:, :-1], above[:, 1:]) + bow).max(axis=1)
    foot = (np.minimum(below[:, :-1], below[:, 1:]) - bow).min(axis=1)
    starts = np.arange(K) * delta
    frames = [
        {"p": plain([[t, t + delta, t + delta, t, t], [low, low, high, high, low]])}
        for t, low, high in zip(starts, foot, top, strict=True)
    ]
    model: Layer = {
        "name": "reachable now",
        "kind": "area",
        "group": "tube",
        "colour": "#56B4E9",
        "opacity": 0.35,
    }
    return [layers.framed(model, starts, frames)]
