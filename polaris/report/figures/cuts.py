"""Marks where the frame of a figure cuts the drawing."""

from typing import Any

import numpy as np
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.colors import to_hex, to_rgba_array
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from ...model.system import Array
from ..scene.palette import GREY
from .labels import polylines
from .style import dot

OUT_OF_FRAME = "goes on outside"
MARKERS = {(0, 0): "<", (0, 1): ">", (1, 0): "v", (1, 1): "^"}  # markers of a cut by axis and side
ROUNDING = 1e-6
APART = 0.03  # least distance of marks of one colour, in shares of the frame
LINES = (Line2D, LineCollection)
PALE = 0.75  # a colour lighter than this is not seen as a mark


def mark_cuts(ax: Any) -> list[Any]:
    """Mark where the frame cuts lines and sets by markers that point on; return a handle of them, if any."""
    limits = np.array([ax.get_xlim(), ax.get_ylim()])
    spacing = APART * np.ptp(limits, axis=1)
    to_data, places = ax.transData.inverted(), {side: list[tuple[float, str]]() for side in MARKERS}
    drawn = [one for one in (*ax.lines, *ax.collections, *ax.patches) if not isinstance(one, PathCollection)]
    drawn = [one for one in drawn if all(one.get_transform().contains_branch_seperately(ax.transData))]
    for artist in sorted(drawn, key=_is_face):  # a face has the mark of its edge
        closed, colour, face = not isinstance(artist, LINES), _colour(artist), _is_face(artist)
        parts = [to_data.transform(part) for part in polylines(artist)]
        for (axis, side), marks in places.items():
            ends = limits[axis, side], limits[1 - axis]
            for at in sorted(at for part in parts for at in _crossings(part, axis, side, *ends, closed)):
                near = [mark for other, mark in marks if abs(at - other) <= spacing[1 - axis]]
                if not (near if face else colour in near):
                    marks.append((at, colour))
    look: dict[str, Any] = {"ms": 3.5, "mec": "white", "mew": 0.3, "clip_on": False, "zorder": 6.5}
    for (axis, side), marks in places.items():
        for at, colour in marks:
            point = (at, limits[axis, side]) if axis else (limits[axis, side], at)
            ax.plot(*point, MARKERS[axis, side], color=colour, gid="cut", **look)
    return [dot(">", GREY, 3.5, OUT_OF_FRAME)] if any(places.values()) else []


def _is_face(artist: Any) -> bool:
    return isinstance(artist, Patch) and not artist.get_linewidth()


def _crossings(part: Array, axis: int, upper: int, side: float, along: Array, closed: bool) -> list[float]:
    """Return the points at which a line crosses one side of the frame; for a set, the middle of each cut."""
    if closed and len(part):
        part = np.vstack([part, part[:1]])
    value = part[:, axis] - side
    slack = ROUNDING * (abs(side) + np.ptp(along))  # it may end at the frame
    beyond = value > slack if upper else value < -slack
    cross = np.flatnonzero((beyond[:-1] != beyond[1:]) & np.isfinite(value[:-1] + value[1:]))
    share = value[cross] / (value[cross] - value[cross + 1])
    at = np.sort(part[cross, 1 - axis] + share * (part[cross + 1, 1 - axis] - part[cross, 1 - axis]))
    low, high = along.min(), along.max()
    if not closed or len(at) % 2:
        return [float(one) for one in at if low <= one <= high]
    pairs = [(max(a, low), min(b, high)) for a, b in at.reshape(-1, 2)]
    return [float(a + b) / 2 for a, b in pairs if a < b]


def _colour(artist: Any) -> str:
    """Colour of the line or edge of an artist, or of its face if it has none; grey if it is too light."""
    if isinstance(artist, Line2D):
        colours = to_rgba_array(artist.get_color())
    else:
        both = artist.get_edgecolor(), artist.get_facecolor()
        colours = np.vstack([to_rgba_array(one) for one in both])
    dark = colours[(colours[:, 3] > 0) & (colours[:, :3].mean(axis=1) < PALE)]
    return to_hex(dark[0]) if len(dark) else GREY
