"""The scene of a system that moves on a line: position over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..figures.line import LineSpace
from ..figures.picture import Picture
from ..figures.space import position_set
from ..figures.style import GREEN, GREY, RED
from ..keep_in import KeepIn
from ..system import Array
from . import layers
from .layers import Layer
from .numbers import plain


def line_scene(picture: Picture, paths: Sequence[Array]) -> dict[str, Any]:
    """The scene as the page's script reads it; see `scene.scene_of`.

    Parameters
    ----------
    picture : Picture
        Of a system with one position coordinate.
    paths : sequence of ndarray, shape (N, 1)
        Positions flown [m].
    """
    space = LineSpace.of(picture, paths)
    before, end = picture.path(4)[0], picture.duration
    steps = np.arange(picture.planned)[:, None] + np.linspace(0, 1, len(before) // picture.planned)
    start, cut = position_set(picture), picture.slices
    reach = float(np.abs(start.G).sum())
    ends = np.array([[0.0, start.c[0] - reach], [0.0, start.c[0] + reach]])
    way = np.column_stack([steps.ravel() * picture.reference.delta, before[:, 0]])
    return {
        "space": 2,
        "equal": False,
        "axes": ["Time (s)", picture.frame.labels[0]],
        "range": plain([[0.0, end], [space.low, space.high]]),
        "layers": [
            *_unsafe(space),
            *_goal(space, end),
            layers.line("initial set", ends, "initial", "#404040", 5),
            layers.line("safe reference", way, "reference", GREY, 3, "dot"),
            *(
                [layers.slices(cut.times, cut.outlines, cut.places)]
                if cut and "polaris" in picture.flights
                else []
            ),
            *_tube(space),
        ],
    }


def _unsafe(space: LineSpace) -> list[Layer]:
    found: list[Layer] = []
    for obstacle in space.picture.obstacles:
        if isinstance(obstacle, KeepIn):
            name = f"{obstacle.name} (stay inside)"
            for edge in space.edges(obstacle)[0]:
                if space.low < edge < space.high:
                    rim = np.column_stack([space.times[[0, -1]], [edge, edge]])
                    found.append(layers.line(name, rim, "unsafe", RED, 1.5, "dash"))
            continue
        low, high = space.band(obstacle).T
        if np.any(high > low):
            band = np.column_stack([np.r_[space.times, space.times[::-1]], np.r_[low, high[::-1]]])
            found.append(layers.area(obstacle.name, band, "unsafe", RED, 0.4) | {"label": obstacle.name})
    return found


def _goal(space: LineSpace, end: float) -> list[Layer]:
    goal = space.goal()
    points = np.array([[end, value] for value in goal])
    if len(goal) == 2:
        return [layers.line("goal", points, "goal", GREEN, 6)]
    return [layers.markers("goal", points, "goal", GREEN, "diamond", 5)] if goal else []


def _tube(space: LineSpace) -> list[Layer]:
    tube, delta = space.tube(), space.picture.reference.delta
    if tube is None:
        return []
    starts = np.arange(len(tube)) * delta
    frames = [
        {"p": plain([[t, t + delta, t + delta, t, t], [low, low, high, high, low]])}
        for t, (low, high) in zip(starts, tube, strict=True)
    ]
    look = {"kind": "area", "group": "tube", "colour": "#56B4E9", "opacity": 0.35}
    return [layers.framed({"name": "reachable now"} | look, starts, frames)]
