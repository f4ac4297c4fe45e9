"""The part of the plane a scene shows, and where names are written in it."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..keep_in import KeepIn
from ..obstacles import Obstacle
from ..system import Array
from .geometry import zonotope_outline
from .picture import Picture

INSTANTS = 5
"""Instants at which a moving obstacle is drawn."""


class View:
    """The part of the plane that is shown, and where in it there is room for labels."""

    def __init__(self, x: tuple[float, float], y: tuple[float, float], points: Array) -> None:
        self.x, self.y, self.points = x, y, points
        self.taken: list[tuple[float, float, float, float]] = []

    @classmethod
    def around(cls, picture: Picture) -> View:
        """All of the reference, the flights under Polaris, and what rests near them."""
        axes = picture.frame.flat
        before, after = picture.path()
        paths = [before[:, axes], after[:, axes]]
        for name, flights in picture.flights.items():
            shown = picture.positions(flights)[:, axes]
            if name == "polaris" or _near(shown, paths[0]):
                paths.append(shown)
        points = np.vstack(paths)
        low, high = points.min(axis=0), points.max(axis=0)
        reach = 0.3 * np.max(high - low)
        corners = [points, zonotope_outline(position_set(picture), axes)]
        for obstacle in picture.obstacles:
            if isinstance(obstacle, KeepIn):
                continue
            moving = moves(obstacle, picture)
            for t in np.linspace(0, picture.duration, INSTANTS) if moving else (0.0,):
                seen = np.clip(obstacle.outline(float(t), picture.system)[:, axes], low - reach, high + reach)
                if np.all(np.ptp(seen, axis=0) > 0) and not (moving and np.any(np.ptp(seen, axis=0) > reach)):
                    corners.append(seen)
        everything = np.vstack(corners)
        low, high = everything.min(axis=0), everything.max(axis=0)
        pad = 0.05 * np.max(high - low) + 1e-9
        low, high = low - pad, high + pad
        # No figure is more than 2.2 times as wide as it is high, or higher than wide.
        size, middle = high - low, (high + low) / 2
        size = np.array([max(size[0], size[1]), max(size[1], size[0] / 2.2)])
        low, high = middle - size / 2, middle + size / 2
        return cls((low[0], high[0]), (low[1], high[1]), points)

    @property
    def aspect(self) -> float:
        """Height over width."""
        return float((self.y[1] - self.y[0]) / (self.x[1] - self.x[0]))

    def contains(self, points: Array) -> Any:
        """Which points lie in the view."""
        x, y = points[..., 0], points[..., 1]
        return (x > self.x[0]) & (x < self.x[1]) & (y > self.y[0]) & (y < self.y[1])

    def clip(self, outline: Array) -> Array:
        """Cut an outline to the view."""
        return np.clip(outline, (self.x[0], self.y[0]), (self.x[1], self.y[1]))

    def avoid(self, points: Array) -> None:
        """Keep names off these points, too."""
        self.points = np.vstack([self.points, points])

    def label(self, ax: Any, text: str, outline: Array, colour: str) -> None:
        """Write a name beside an outline, or into it if it is large, where fewest lines pass."""
        from matplotlib.patheffects import withStroke

        point = (self.x[1] - self.x[0]) / (2.8 * 72)  # metres per point of type
        w, h = 3.9 * len(text) * point, 8.5 * point
        low, high = outline.min(axis=0) - 3 * point, outline.max(axis=0) + 3 * point
        mid = (low + high) / 2
        places = [
            (mid[0] - w / 2, high[1]),
            (high[0], mid[1] - h / 2),
            (mid[0] - w / 2, low[1] - h),
            (low[0] - w, mid[1] - h / 2),
            (high[0], high[1]),
            (high[0], low[1] - h),
            (low[0] - w, high[1]),
            (low[0] - w, low[1] - h),
        ]
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
        x = min(max(x, self.x[0]), self.x[1] - w)
        self.taken.append((x, y, w, h))
        drawn = ax.text(
            x + w / 2,
            y + h / 2,
            text,
            color=colour,
            fontsize=7,
            ha="center",
            va="center",
            zorder=8,
            clip_on=True,
        )
        drawn.set_path_effects([withStroke(linewidth=1.6, foreground="white")])


def _near(shown: Array, path: Array) -> bool:
    """Whether a flight stays about where the path is, so that it may widen the view."""
    low, high = path.min(axis=0), path.max(axis=0)
    reach = 0.35 * np.max(high - low)
    return bool(np.all(shown > low - reach) and np.all(shown < high + reach))


def position_set(picture: Picture) -> Any:
    """Initial positions."""
    return picture.system.position @ picture.initial_set


def moves(obstacle: Obstacle, picture: Picture) -> bool:
    """Whether an obstacle changes place within the horizon."""
    times = np.linspace(0, picture.duration, 5)
    return bool(np.ptp(obstacle.centre(times, picture.system), axis=0).max() > 0)
