"""The plane that is drawn, where in it there is room for names, and close-ups where it does not tell."""

from typing import Any

import numpy as np
from matplotlib.patches import Polygon
from matplotlib.patheffects import withStroke

from ...model.system import Array
from ...runs.picture import Picture, seconds
from ..scene.geometry import flat_outline
from ..scene.items import CloseUp, Scene
from ..scene.palette import BLACK, RED, tint
from ..scene.space import Space, moves
from .style import draw_safe_path, shortened, text_width

WIDTH = 2.8  # of the axes [in]
CLASH = 4.0  # what it counts if a name lies on another: more than all else; then a line further off will do


class View:
    """The rectangle that a scene in two axes shows, and what is in it already; a mute one has no names."""

    def __init__(self, scene: Scene, mute: bool = False) -> None:
        self.low, self.high, self.mute = scene.low, scene.high, mute
        self.span = np.stack([self.low, self.high], axis=1).tolist()
        flown = [path for key in scene.picture.flights if (path := scene.flown(key)) is not None]
        drawn = [item.points for item in scene.of("reference", "tail")]
        self.points = np.vstack([*drawn, *flown])  # what names should not cover, shape (N, 2)
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
        places = around = [sides[list(place), [0, 1]] for place in beside]
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
            return min(over, 20) / 20 + np.any(place != wanted) + CLASH * clash

        if min(map(cost, places)) >= CLASH:
            off = [np.array([0.0, 1.2 * (row - 1) * size[1]]) for _, row in beside]
            places = [*places, *map(np.add, around, off)]
        place = into(min(places, key=cost))
        self.taken.append((place, size))
        look = {"ha": "center", "va": "center", "zorder": 8, "clip_on": True}
        drawn = ax.text(*(place + size / 2), text, color=colour, fontsize=7, **look)
        drawn.set_path_effects([withStroke(linewidth=1.6, foreground="white")])


LETTERS = "abcdef"


def draw_closeup(ax: Any, picture: Picture, one: CloseUp, letter: str, aspect: float, width: float) -> None:
    """Draw one close-up, wholly within `width` [in], as high as `aspect` times that."""
    apart = f"{one.distance:.3g}" if one.distance < 1000 else f"{one.distance:.0f}"
    told = f"{seconds(one.time)} s: {apart} m"
    told += " apart" if one.distance < 1000 and text_width(told + " apart") < width else ""
    name = shortened(f"({letter}) {one.obstacle.name}", 0.9 * width)
    ax.locator_params(nbins=4)
    ax.set_title(f"{name}\n{told}", fontsize=7, loc="left", linespacing=1.1, pad=3)
    labels = ["Time (s)", "Distance (m)"]
    if one.axes is None:
        _over_time(ax, picture, one)
    else:
        labels = [picture.frame.labels[picture.frame.axes.index(axis)] for axis in one.axes]
        if moves(one.obstacle, picture):
            labels = [f"Rel. {label[0].lower()}{label[1:]}" for label in labels]
        _in_plane(ax, picture, one, one.axes, aspect)
    ax.set_xlabel(labels[0], fontsize=7)
    ax.set_ylabel(labels[1], fontsize=7)
    ax.grid(True)


def _in_plane(ax: Any, picture: Picture, one: CloseUp, axes: list[int], aspect: float) -> None:
    times, path = picture.safe_path()
    space, origin = Space.of(picture), np.zeros(picture.system.d)
    if moves(one.obstacle, picture):
        path = path - one.obstacle.centre(times, picture.system)
        origin = np.asarray(one.obstacle.centre(one.time, picture.system))
    at = int(np.argmin(np.abs(times - one.time)))
    outline = space.outline(one.obstacle, one.time, axes) - origin[axes]
    ax.add_patch(Polygon(outline, facecolor=tint(RED, 0.45), edgecolor=RED, lw=0.6, zorder=1.5))
    cover = space.cover(one.obstacle, one.time)
    if cover is not None:
        outline = flat_outline(cover[:, axes]) - origin[axes]
        ax.add_patch(Polygon(outline, facecolor="none", edgecolor=RED, lw=0.5, zorder=1.6))
    near = np.vstack([outline, path[at : at + 1, axes]])
    low, high = near.min(axis=0), near.max(axis=0)
    size, middle = 1.5 * (high - low), (low + high) / 2
    half = 0.5 * np.array([max(size[0], size[1] / aspect), max(size[1], aspect * size[0])])
    (x0, y0), (x1, y1) = middle - half, middle + half
    ax.set(xlim=(x0, x1), ylim=(y0, y1))
    ax.set_aspect("equal")
    draw_safe_path(ax, picture, path[:, axes], one.span)
    ax.plot(*path[at, axes], marker="o", mfc="white", mec=BLACK, mew=0.7, ms=3, zorder=6)


def _over_time(ax: Any, picture: Picture, one: CloseUp) -> None:
    times, path = picture.safe_path()
    distance = one.obstacle.signed_distance(times, path, picture.system)
    a, b = one.span
    top = 4 * one.distance
    near = np.flatnonzero(distance[a:b] <= top) + a
    ends = times[near[0]], times[near[-1]]
    draw_safe_path(ax, picture, np.column_stack([times, distance]), one.span)
    ax.axhspan(-0.2 * top, 0, color=tint(RED, 0.45), lw=0)
    ax.set(xlim=ends if ends[0] < ends[1] else None, ylim=(-0.2 * top, top))
