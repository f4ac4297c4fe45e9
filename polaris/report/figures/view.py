"""The plane that is drawn, and where in it there is room for names."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.patheffects import withStroke

from ...model.system import Array
from ..scene.items import Scene
from .style import text_width

WIDTH = 2.8
"""Of the axes [in]."""


class View:
    """The rectangle that a scene in two axes shows, and what is in it already; a mute one has no names."""

    def __init__(self, scene: Scene, mute: bool = False) -> None:
        (x0, y0), (x1, y1) = scene.low.tolist(), scene.high.tolist()
        self.x, self.y, self.mute = (x0, x1), (y0, y1), mute
        flown = [path for key in scene.picture.flights if (path := scene.flown(key)) is not None]
        drawn = [item.points for item in scene.of("reference", "tail")]
        self.points = np.vstack([*drawn, *flown])
        """What names should not cover, shape (N, 2)."""
        self.taken: list[tuple[float, float, float, float]] = []

    @property
    def aspect(self) -> float:
        """Height over width."""
        return float((self.y[1] - self.y[0]) / (self.x[1] - self.x[0]))

    def contains(self, points: Array) -> Any:
        """Which points lie in the view."""
        x, y = points[..., 0], points[..., 1]
        return (x > self.x[0]) & (x < self.x[1]) & (y > self.y[0]) & (y < self.y[1])

    def seen(self, outline: Array) -> Array:
        """Points along a closed outline that are in the view, shape (N, 2)."""
        s = np.linspace(0, 1, 200)[:, None, None]
        edge = ((1 - s) * outline + s * np.roll(outline, -1, axis=0)).reshape(-1, 2)
        return np.asarray(edge[self.contains(edge)])

    def within(self, outline: Array) -> bool:
        """Whether an outline goes round all of the view."""
        (x0, y0), (x1, y1) = outline.min(axis=0), outline.max(axis=0)
        return bool(x0 < self.x[0] and y0 < self.y[0] and x1 > self.x[1] and y1 > self.y[1])

    def inch(self, ax: Any) -> Array:
        """What one inch of these axes is along x and y, in their units."""
        # On paper, one scale serves both axes or they have a shape of their own.
        shape = self.aspect if ax.get_aspect() == 1.0 else 0.6
        return np.array([self.x[1] - self.x[0], (self.y[1] - self.y[0]) / shape]) / WIDTH

    def clip(self, outline: Array) -> Array:
        """Cut an outline to the view."""
        return np.clip(outline, (self.x[0], self.y[0]), (self.x[1], self.y[1]))

    def avoid(self, points: Array) -> None:
        """Keep names off these points, too."""
        self.points = np.vstack([self.points, points])

    def label(self, ax: Any, text: str, outline: Array, colour: str) -> None:
        """Write a name beside an outline, or into it if it is large, where fewest lines pass."""
        if self.mute:
            return
        per_inch = self.inch(ax)
        w, h = np.array([text_width(text) + 0.04, 8.5 / 72]) * per_inch
        gap = 3 / 72 * per_inch
        low, high = outline.min(axis=0) - gap, outline.max(axis=0) + gap
        mid = (low + high) / 2
        xs, ys = (low[0] - w, mid[0] - w / 2, high[0]), (low[1] - h, mid[1] - h / 2, high[1])
        beside = ((1, 2), (2, 1), (1, 0), (0, 1), (2, 2), (2, 0), (0, 2), (0, 0))  # above first, then right
        places = [(xs[i], ys[j]) for i, j in beside]
        if w < high[0] - low[0] and 1.8 * h < high[1] - low[1]:
            places = [
                (mid[0] - w / 2, low[1] + share * (high[1] - low[1]) - h / 2) for share in (0.5, 0.25, 0.75)
            ]

        def cost(place: tuple[float, float]) -> float:
            x, y = place
            crossing = self.points - (x, y)
            over = int(np.count_nonzero(np.all((crossing > 0) & (crossing < (w, h)), axis=1)))
            inside = self.x[0] <= x and x + w <= self.x[1] and self.y[0] <= y and y + h <= self.y[1]
            clash = any(x < a + c and a < x + w and y < b + d and b < y + h for a, b, c, d in self.taken)
            return float(min(over, 20)) / 20 + 3 * (not inside) + 2 * clash

        x, y = min(places, key=cost)
        x = max(min(x, self.x[1] - w), self.x[0])
        y = max(min(y, self.y[1] - h), self.y[0])
        self.taken.append((x, y, w, h))
        place = {"ha": "center", "va": "center", "zorder": 8, "clip_on": True}
        drawn = ax.text(x + w / 2, y + h / 2, text, color=colour, fontsize=7, **place)
        drawn.set_path_effects([withStroke(linewidth=1.6, foreground="white")])
