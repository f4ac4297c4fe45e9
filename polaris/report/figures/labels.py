"""Placement of names in axes.

Names are placed when the axes are drawn, from the extents of the texts as they are rendered: no name lies
on another, on a tick or outside of the axes, and of all free places the one is taken that is near its
anchor and crosses the fewest lines. The same figure has the same places every time.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.colors import to_rgba
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon
from matplotlib.path import Path
from matplotlib.patheffects import withStroke
from scipy.spatial import cKDTree

from ...model.system import Array

CELL = 2.0  # size of a cell of the map of what is drawn [pt]
GAP = 2.0  # least distance of a name to its anchor, and between names [pt]
ANCHORS = 24  # points along an outline beside which its name may stand
RINGS = (0.0, 0.7, 1.6, 3.0, 5.0, 8.0)  # further distances to the anchor, in heights of the text
SIDES = ((0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1))  # above first, then right
WITHIN = [(x, y) for x in (0, 0.25, -0.25, 0.4, -0.4) for y in (0, 0.25, -0.25)]  # places in a large set
MOST_POINTS = 50_000  # along one line; what goes far beyond the frame has them farther apart
TRIED = 300  # cheapest places of which the first with a free leader is taken
LEADER = 7.0  # a name further than this from its anchor is led to it by a line [pt]
CROSSING, FAR = 4.0, 1 / 40  # what a place costs: all of it crossed by lines; each point of distance


def name(ax: Any, text: str, points: Any, colour: Any, beside: bool = False) -> None:
    """Write a name at an item with these points (N, 2), in the units of the axes, or always `beside` it."""
    labels = next((one for one in ax.artists if isinstance(one, Labels)), None)
    if labels is None:
        labels = ax.add_artist(Labels(zorder=7.9))
        labels.set_in_layout(False)
        labels.set_clip_on(False)
    centre, look = (0.5, 0.5), {"ha": "center", "va": "center", "fontsize": 7, "zorder": 8}
    drawn = ax.text(*centre, text, color=colour, transform=ax.transAxes, **look)
    drawn.set_in_layout(False)
    drawn.set_path_effects([withStroke(linewidth=1.6, foreground="white")])
    labels.texts.append((drawn, np.atleast_2d(np.asarray(points, dtype=float)), beside))


@dataclass(eq=False)
class _Map:
    """Occupied area of a frame [px]: cells (N, 2) of lines and of filled sets, boxes (M, 4) of names."""

    low: Array
    high: Array
    cell: float
    drawn: Array
    filled: Array
    taken: list[Array] = field(default_factory=list)

    def crossed(self, at: Array, size: Array, cells: Array) -> Array:
        """Share of the boxes of one size, about places (M, 2), that some cells take."""
        tree = cKDTree(cells / (size / 2))
        count = tree.query_ball_point(at / (size / 2), 1.0, p=np.inf, return_length=True)
        return np.asarray(count * self.cell**2 / np.prod(size))

    def clashes(self, low: Array, high: Array, gap: float) -> Array:
        """Return the overlap [px] of boxes (M, 2) with those that are taken; 0 for free ones."""
        worst = np.zeros(len(low))
        for x0, y0, x1, y1 in self.taken:
            common = np.minimum(high, (x1, y1)) - np.maximum(low, (x0, y0)) + gap
            worst = np.maximum(worst, np.clip(common.min(axis=1), 0.0, None))
        return worst

    def crosses(self, lines: Array) -> Any:
        """Return True for each of the lines (M, 2, 2) that passes under a name already placed."""
        share = np.linspace(0, 1, 12)[1:-1, None, None]
        along = lines[:, 0] + share * (lines[:, 1] - lines[:, 0])
        boxes = np.array(self.taken).reshape(-1, 1, 1, 4)
        within = np.all((along >= boxes[..., :2]) & (along <= boxes[..., 2:]), axis=-1)
        return np.any(within, axis=(0, 1))


class Labels(Artist):
    """The names in axes, placed anew whenever the axes have another size, view or text."""

    def __init__(self, **look: Any) -> None:
        super().__init__()
        self.set(**look)
        self.texts: list[tuple[Any, Array, bool]] = []  # texts, points (N, 2) that they name, if beside them
        self._placed: Any = None
        self._leaders: list[tuple[Array, Any]] = []

    def draw(self, renderer: Any) -> None:
        """Place the names and draw the lines that lead to those that stand apart."""
        ax: Any = self.axes
        texts = [text.get_text() for text, *_ in self.texts]
        size = np.round(ax.bbox.size / ax.figure.dpi, 4).tolist()
        key = (size, ax.get_xlim(), ax.get_ylim(), texts)  # the same places in each format
        if key != self._placed:
            self._place(renderer)
            self._placed = key
        lines, colours = [line for line, _ in self._leaders], [colour for _, colour in self._leaders]
        leaders = LineCollection(lines, colors=colours, linewidths=0.5, transform=ax.transAxes)
        leaders.set_figure(ax.figure)
        leaders.draw(renderer)

    def _place(self, renderer: Any) -> None:
        ax: Any = self.axes
        point = renderer.points_to_pixels(1.0)
        low, high = ax.bbox.min + point, ax.bbox.max - point
        cell = CELL * point
        drawn = np.unique(np.floor(_drawn(ax, cell, point) / cell), axis=0) * cell + cell / 2
        inside = np.all((drawn >= low) & (drawn < high), axis=1)
        free_space = _Map(low, high, cell, drawn[inside], _filled(ax, low, high, cell))
        names = {text for text, *_ in self.texts}
        others = [text for text in ax.texts if text not in names and text.get_visible() and text.get_text()]
        free_space.taken += [np.array(text.get_window_extent(renderer).extents) for text in others]
        leaders = []
        for text, coords, beside in self.texts:
            points = _display(ax, coords)
            inside = np.all((points >= low) & (points <= high), axis=1) if len(points) > 1 else [True]
            text.set_visible(bool(np.isfinite(points).all() and len(points)))
            if not text.get_visible():
                continue
            box = text.get_window_extent(renderer)
            size = np.array([box.width, box.height])
            anchors = points[inside] if np.any(inside) else np.clip(points, low, high)
            outline = np.clip(anchors[:1] if beside else points, low, high)
            at, leader = _spot(free_space, anchors, outline, size, point)
            free_space.taken.append(np.array([*(at - size / 2), *(at + size / 2)]))
            text.set_position(ax.transAxes.inverted().transform(at))
            if np.isfinite(leader).all():
                along = leader[0] + np.linspace(0, 1, 8)[:, None] * (leader[1] - leader[0])
                free_space.taken += [np.array([*one, *one]) for one in along]
                leaders.append((ax.transAxes.inverted().transform(leader), text.get_color()))
        self._leaders = leaders


def _spot(free_space: _Map, anchors: Array, outline: Array, size: Array, point: float) -> tuple[Array, Array]:
    """Return the middle of the place of a text, at anchors (N, 2) or in an outline (M, 2), and its leader.

    The leader (2, 2) goes from the text to the nearest anchor; nan if the text stands beside it. All in [px].
    """
    chosen = anchors[np.unique(np.linspace(0, len(anchors) - 1, ANCHORS).astype(int))]
    offsets = [np.array(SIDES) * (size / 2 + GAP * point + ring * size[1]) for ring in RINGS]
    places = (chosen[:, None] + np.concatenate(offsets)).reshape(-1, 2)
    middle, extent = (outline.min(axis=0) + outline.max(axis=0)) / 2, np.ptp(outline, axis=0)
    within = middle + np.array(WITHIN) * extent if np.all(extent > 1.5 * size) else np.zeros((0, 2))
    sides = zip(free_space.low, free_space.high, size, strict=True)
    across = [np.arange(a, b, length / 3) for a, b, length in sides]
    anywhere = np.stack(np.meshgrid(*across, indexing="ij"), axis=-1).reshape(-1, 2)
    for candidates in (np.vstack([within, places]), anywhere):
        at = np.maximum(np.minimum(candidates, free_space.high - size / 2), free_space.low + size / 2)
        low, high = at - size / 2, at + size / 2
        clash = free_space.clashes(low, high, GAP * point)
        if np.any(clash == 0):
            break
    ends = np.clip(chosen, low[:, None], high[:, None])
    gaps = np.linalg.norm(chosen - ends, axis=2)
    near, rows = np.argmin(gaps, axis=1), np.arange(len(at))
    leaders, gap = np.stack([ends[rows, near], chosen[near]], axis=1), gaps[rows, near]
    inside = (rows < len(within)) & (candidates is not anywhere)
    led = ~inside & (gap > LEADER * point)
    leaders[~led] = np.nan
    crossed = free_space.crossed(at, size + 2 * point, free_space.drawn)
    crossed += np.where(inside, 0.0, free_space.crossed(at, size + 2 * point, free_space.filled))
    cost = 1e6 * clash + CROSSING * (crossed + 0.08 * (crossed > 0))
    cost += np.where(inside, -0.3, FAR * gap / point) + 0.01 * rows / len(rows)
    best = np.argsort(np.round(cost, 6), kind="stable")[:TRIED]
    best = best[clash[best] <= clash[best[0]]]
    best = best[int(np.argmax(~free_space.crosses(leaders[best])))]  # the first led to clear of other names
    return at[best], leaders[best]


def _display(ax: Any, points: Array) -> Array:
    """Return points [px] along the outline that points (N, 2) of axes make."""
    points = ax.transData.transform(points)
    s = np.linspace(0, 1, max(2, 200 // len(points)))[:-1, None, None]
    return np.asarray(((1 - s) * points + s * np.roll(points, -1, axis=0)).transpose(1, 0, 2).reshape(-1, 2))


def _drawn(ax: Any, step: float, point: float) -> Array:
    """Points (N, 2) [px] along all lines and outlines in axes, and round their markers."""
    parts, cross = [np.zeros((0, 2))], np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
    for artist in (*ax.lines, *ax.patches, *ax.collections):
        if isinstance(artist, PathCollection):
            continue
        for vertices in filter(len, polylines(artist)):
            if isinstance(artist, Line2D) and artist.get_marker() not in ("None", None, "", " "):
                parts += [vertices + turn for turn in cross * artist.get_markersize() / 2 * point]
            if isinstance(artist, Line2D) and artist.get_linestyle() == "None":
                continue
            length = np.nan_to_num(np.linalg.norm(np.diff(vertices, axis=0), axis=1))
            along = np.append(0.0, np.cumsum(length))
            s = np.linspace(0, along[-1], min(int(along[-1] / step) + 2, MOST_POINTS))
            parts.append(np.column_stack([np.interp(s, along, axis) for axis in vertices.T]))
    drawn = np.vstack(parts)
    return np.asarray(drawn[np.isfinite(drawn).all(axis=1)])


def _filled(ax: Any, low: Array, high: Array, cell: float) -> Array:
    """Cells (N, 2) [px] of a frame within filled sets."""
    across = (np.arange(a, b, cell) for a, b in zip(low, high, strict=True))
    grid = np.stack(np.meshgrid(*across), axis=-1).reshape(-1, 2)
    filled = [one for one in ax.patches if isinstance(one, Polygon) and to_rgba(one.get_facecolor())[3]]
    flags = [Path(part).contains_points(grid) for one in filled for part in polylines(one)]
    return np.asarray(grid[np.any(flags, axis=0)]) if flags else grid[:0]


def polylines(artist: Any) -> list[Array]:
    """Vertices (N, 2) [px] of an artist's drawing."""
    paths = [artist.get_path()] if isinstance(artist, (Line2D, Patch)) else artist.get_paths()
    return [part for path in paths for part in _parts(path.transformed(artist.get_transform()))]


def _parts(path: Path) -> list[Array]:
    """Parts (N, 2) of a path, closed ones with their first point again."""
    if path.codes is None:
        return [np.asarray(path.vertices)]
    return [np.asarray(part) for part in path.to_polygons(closed_only=False)]
