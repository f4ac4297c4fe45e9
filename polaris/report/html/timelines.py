"""Who flew, and what is drawn over time, as the page's script reads it.

A pilot is one controller, method or spacecraft with the runs of it that can be shown:
``{key, name, colour, dash, on, labels, t, runs: [{p, modes}]}``, where ``p`` are the coordinates by axis and
``modes`` who flies from each sample on.

A panel is one diagram: ``{key, title, unit, limits, series}``. A series belongs to a pilot (``pilot``) or
to none, and has ``y`` (one line) or ``runs`` (a line per run of its pilot), samples ``t`` if they are not
the pilot's, ``step`` if it is held until the next sample, and perhaps a ``band`` of two lines.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...model.distances import UNKNOWN, signed_distances
from ...model.system import Array
from ...runs.picture import Picture
from ...synthesis.recoverable import directed
from ..figures.style import BLACK, BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILION, input_labels, mode_colour
from .numbers import plain

MOST = 400
"""Most samples of a run that are drawn, besides changes of controller."""

# S alone and U alone come first, in the colours of S and U.
COLOURS = (
    BLUE,
    ORANGE,
    BLACK,
    GREEN,
    PURPLE,
    VERMILION,
    SKY,
    "#6B4A0F",
    "#8A8A8A",
    "#B8860B",
    "#7A1FA2",
    "#4D7A00",
)
DASHES = ("solid", "dash", "dot", "dashdot", "longdash")

WHO = "Who flies"

Panel = dict[str, Any]
Pilot = dict[str, Any]


def kept(count: int, modes: ArrayLike = (), must: Sequence[int] = ()) -> NDArray[np.intp]:
    """Samples that are drawn of `count`: evenly many, the ends, changes of mode, and some that must be.

    Parameters
    ----------
    count : int
    modes : array_like, shape (r, count-1)
        Of every run, from each sample on.
    must : sequence of int
        Such as that of the least distance.
    """
    if count <= MOST:
        return np.arange(count)
    even = np.linspace(0, count - 1, MOST).astype(int)
    changes = np.flatnonzero(np.diff(np.atleast_2d(modes), axis=1).any(axis=0)) + 1
    if len(changes) > MOST:  # nobody could see them all
        changes = changes[:: -(-len(changes) // MOST)]
    return np.unique(np.concatenate([even, changes, must]).astype(int))


def style_of(place: int) -> dict[str, str]:
    """Colour and dashes of the i-th pilot: no two of the first fifty are alike."""
    return {
        "colour": COLOURS[place % len(COLOURS)],
        "dash": DASHES[(place // len(COLOURS) + place) % len(DASHES)],
    }


def pilot(
    key: str, name: str, labels: Sequence[str], times: Array, paths: Array, modes: Array, **style: Any
) -> Pilot:
    """One pilot.

    Parameters
    ----------
    key, name : str
    labels : sequence of str, length r
    times : ndarray, shape (N,)
        [s]
    paths : ndarray, shape (r, N, dim)
        Positions in the axes of the figures [m].
    modes : ndarray of int, shape (r, N-1)
    **style : str or bool
        ``colour``, ``dash``, and whether it is ``on`` at first.
    """
    runs = [{"p": plain(path.T), "modes": plain(who)} for path, who in zip(paths, modes, strict=True)]
    return {"key": key, "name": name, "labels": list(labels), "t": plain(times), "runs": runs} | style


def paths_of(picture: Picture, times: Array, states: Array, axes: list[int]) -> Array:
    """Positions of runs along the axes of the scene, from states (r, N, n); on the line, over time."""
    positions = (states @ picture.system.position.T)[..., axes]
    if picture.system.d > 1:
        return np.asarray(positions)
    return np.stack([np.broadcast_to(times, positions.shape[:2]), positions[..., 0]], axis=-1)


def mode_names(picture: Picture, present: ArrayLike) -> list[dict[str, Any]]:
    """Name and colour of every mode that occurs."""
    told = []
    for mode in np.unique(np.asarray(present, dtype=int)).tolist():
        known = 0 <= mode < len(picture.controllers)
        name = picture.mode_name(mode) if known else f"controller {mode}"
        if mode == UNKNOWN:
            told.append({"mode": mode, "name": "filtered input, or not known", "colour": "#9A9A9A"})
        else:
            told.append({"mode": mode, "name": name, "colour": mode_colour(mode)})
    return told


def own_distance(picture: Picture, times: Array, states: Array) -> Array | None:
    """Distance of every run from the nearest unsafe set, shape (r, N) [m]; None if there is none.

    Other satellites are where they are nominally: a run folder does not say where they truly were.
    """
    if not picture.obstacles:
        return None
    positions = states @ picture.system.position.T
    found = signed_distances(picture.obstacles, times, positions, picture.system)
    return np.asarray(found.min(axis=0))


def limit(y: float, text: str, unsafe: str = "") -> dict[str, Any]:
    """A limit in a panel; `unsafe` says which side of it is shaded: ``above``, ``below`` or none."""
    return {"y": plain(y), "text": text, "unsafe": unsafe}


def distance_panel(series: list[dict[str, Any]]) -> Panel:
    """Distance to the nearest unsafe set."""
    return {
        "key": "distance",
        "title": "Distance to the nearest unsafe set",
        "unit": "m",
        "limits": [limit(0.0, "unsafe", "below")],
        "series": series,
    }


def proven_series(bound: Array, delta: float) -> dict[str, Any]:
    """The distance that is proven, held over every period."""
    K, q = bound.shape
    times = np.append((np.arange(K)[:, None] + np.arange(q) / q).ravel(), K) * delta
    values = np.append(bound.ravel(), bound[-1, -1])
    return {
        "pilot": None,
        "name": "proven for the schedule: at least",
        "t": plain(times),
        "y": plain(values),
        "step": True,
        "colour": GREEN,
        "dash": "solid",
        "fill": True,
    }


def margin_panel(picture: Picture) -> Panel:
    """Room left in the recoverable sets, step by step."""
    K, delta = len(picture.modes), picture.reference.delta
    return {
        "key": "margin",
        "title": "Containment margin of each step of the schedule",
        "unit": "share of room",
        "limits": [limit(0.0, "")],
        "series": [
            {
                "pilot": None,
                "name": "margin",
                "bars": True,
                "t": plain((np.arange(K) + 0.5) * delta),
                "width": plain(delta),
                "y": plain(picture.margins),
                "modes": plain(picture.modes),
                "text": [
                    f"margin {directed(share, '.3f')}, limit: {name}"
                    for share, name in zip(picture.margins, picture.limits, strict=True)
                ],
            }
        ],
    }


def input_panels(picture: Picture, drawn: Sequence[tuple[str, Array, Array | None]]) -> list[Panel]:
    """One panel per input, against its limits.

    Parameters
    ----------
    picture : Picture
    drawn : sequence of (pilot, inputs, range)
        Inputs of the runs (r, N, m), and least and largest over all runs (2, N, m) if they are known.
    """
    label, names = input_labels(picture.system)
    what, _, rest = label.partition(" (")
    found = []
    for axis, (name, most) in enumerate(zip(names, picture.system.u_max.tolist(), strict=True)):
        series = []
        for key, inputs, span in drawn:
            one: dict[str, Any] = {"pilot": key, "step": True, "runs": plain(inputs[..., axis])}
            if span is not None:
                one["band"] = plain(span[..., axis])
            series.append(one)
        limits = [limit(-most, "", "below"), limit(most, f"limit {most:.4g}", "above")]
        title = f"{what}, {name}" if what != "Input" else f"Input: {name}"
        unit = rest.rstrip(")")
        found.append(
            {"key": f"input{axis}", "title": title, "unit": unit, "limits": limits, "series": series}
        )
    return found
