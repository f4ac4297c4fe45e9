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
        self.low, self.high, self.mute = scene.low, scene.high, mute
        self.span = np.stack([self.low, self.high], axis=1).tolist()
        flown = [path for key in scene.picture.flights if (path := scene.flown(key)) is not None]
        drawn = [item.points for item in scene.of("reference", "tail")]
        self.points = np.vstack([*drawn, *flown])
        """What names should not cover, shape (N, 2)."""
        self.taken: list[tuple[Array, Array]] = []

    @property
    def aspect(self) -> float:
        """Height over width."""
        x, y = self.high - self.low
        return float(y / x)

    def contains(self, points: Array) -> Any:
        """Which points lie in the view."""
        return np.all((points > self.low) & (points < self.high), axis=-1)

    def seen(self, outline: Array) -> Array:
        """Points along a closed outline that are in the view, shape (N, 2)."""
        s = np.linspace(0, 1, 200)[:, None, None]
        edge = ((1 - s) * outline + s * np.roll(outline, -1, axis=0)).reshape(-1, 2)
        return np.asarray(edge[self.contains(edge)])

    def within(self, outline: Array) -> bool:
        """Whether an outline goes round all of the view."""
        return bool(np.all((outline.min(axis=0) < self.low) & (outline.max(axis=0) > self.high)))

    def inch(self, ax: Any) -> Array:
        """What one inch of these axes is along x and y, in their units."""
        # On paper, one scale serves both axes or they have a shape of their own.
        shape = self.aspect if ax.get_aspect() == 1.0 else 0.6
        return np.asarray((self.high - self.low) / (1, shape) / WIDTH)

    def clip(self, outline: Array) -> Array:
        """Cut an outline to the view."""
        return np.clip(outline, self.low, self.high)

    def avoid(self, points: Array) -> None:
        """Keep names off these points, too."""
        self.points = np.vstack([self.points, points])

    def label(self, ax: Any, text: str, outline: Array, colour: str) -> None:
        """Write a name beside an outline, or into it if it is large, where fewest lines pass."""
        if self.mute:
            return
        per_inch = self.inch(ax)
        size, gap = np.array([text_width(text) + 0.04, 8.5 / 72]) * per_inch, 3 / 72 * per_inch
        low, high = outline.min(axis=0) - gap, outline.max(axis=0) + gap
        middle = (low + high) / 2 - size / 2
        sides = np.stack([low - size, middle, high])
        beside = ((1, 2), (2, 1), (1, 0), (0, 1), (2, 2), (2, 0), (0, 2), (0, 0))  # above first, then right
        places = [sides[list(place), [0, 1]] for place in beside]
        if np.all(size * (1, 1.8) < high - low):
            heights = (low[1] + share * (high[1] - low[1]) - size[1] / 2 for share in (0.5, 0.25, 0.75))
            places = [*(np.array([middle[0], height]) for height in heights), *places]

        def into(place: Array) -> Array:
            return np.maximum(np.minimum(place, self.high - size), self.low)

        def cost(wanted: Array) -> float:
            place = into(wanted)
            crossing = self.points - place
            over = int(np.count_nonzero(np.all((crossing > 0) & (crossing < size), axis=1)))
            clash = any(np.all((place < at + own) & (at < place + size)) for at, own in self.taken)
            return min(over, 20) / 20 + np.any(place != wanted) + 2 * clash

        place = into(min(places, key=cost))
        self.taken.append((place, size))
        look = {"ha": "center", "va": "center", "zorder": 8, "clip_on": True}
        drawn = ax.text(*(place + size / 2), text, color=colour, fontsize=7, **look)
        drawn.set_path_effects([withStroke(linewidth=1.6, foreground="white")])
