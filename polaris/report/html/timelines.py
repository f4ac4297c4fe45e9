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
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...model.distances import UNKNOWN, signed_distances
from ...model.system import Array
from ...runs.picture import Picture
from ...synthesis.recoverable import directed
from ..scene.palette import GREEN, input_labels, mode_colour
from ..scene.scene import describe, shown_axes
from .bounds import proven_distance
from .numbers import plain
from .scene import scene_data

MOST = 400
"""Most samples of a run that are drawn, besides changes of controller."""

WHO = "Who flies"

Panel = dict[str, Any]
Pilot = dict[str, Any]


@dataclass(frozen=True, eq=False)
class Flown:
    """The runs of one controller or method that can be shown.

    Attributes
    ----------
    key, name : str
    look : dict
        ``colour``, ``dash``, and whether it is ``on`` at first.
    labels : sequence of str, length r
    times : ndarray, shape (N,)
        [s]
    states : ndarray, shape (r, N, n)
    modes : ndarray of int, shape (r, N-1)
    inputs : ndarray, shape (r, N-1, m)
    nearest : ndarray, shape (3, N)
        Least, mean and largest distance over all runs from the nearest unsafe set [m].
    input_range : ndarray, shape (2, N-1, m), optional
        Least and largest input over all runs.
    """

    key: str
    name: str
    look: dict[str, Any]
    labels: Sequence[str]
    times: Array
    states: Array
    modes: NDArray[np.int_]
    inputs: Array
    nearest: Array
    input_range: Array | None = None


def flight_data(
    picture: Picture, flown: Sequence[Flown], proved: bool, by: str, opened: float | None = None
) -> dict[str, Any]:
    """What the page's script draws of a schedule and of those that flew it.

    Parameters
    ----------
    picture : Picture
    flown : sequence of Flown
    proved : bool
        Whether the distance that is proven is shown.
    by : str
        Whether paths are coloured by ``mode`` or by ``pilot``.
    opened : float, optional
        Time that is shown first [s]; default that of the closest approach.
    """
    paths = [one.states[0] @ picture.system.position.T for one in flown]
    scene = describe(picture, paths, shown_axes(picture, paths))
    pilots, distances, drawn = [], [], []
    for one in flown:
        chosen = kept(len(one.times), one.modes, [int(np.argmin(one.nearest[0]))])
        held = np.minimum(chosen, one.inputs.shape[1] - 1)
        times, positions = one.times[chosen], one.states @ picture.system.position.T
        placed, who = scene.placed(positions[:, chosen], times), one.modes[:, held[:-1]]
        pilots.append(pilot(one.key, one.name, one.labels, times, placed, who, **one.look))
        if picture.obstacles:  # other satellites are where they are nominally: no file says where they were
            found = signed_distances(picture.obstacles, one.times, positions, picture.system).min(axis=0)
            band = one.nearest[[0, 2]][:, chosen]
            distances.append({"pilot": one.key, "runs": plain(found[:, chosen]), "band": plain(band)})
        span = None if one.input_range is None else one.input_range[:, held]
        drawn.append((one.key, one.inputs[:, held], span))
    bound = proven_distance(picture) if proved else None
    if bound is not None:
        distances.append(proven_series(bound, picture.reference.delta))
    present = np.concatenate([picture.modes, *(one.modes.ravel() for one in flown)])
    return {
        "scene": scene_data(scene),
        "end": plain(max((one["t"][-1] for one in pilots), default=picture.duration)),
        "open": plain(picture.closest if opened is None else opened),
        "modes": mode_names(picture, present),
        "modes_title": WHO,
        "by": by,
        "pilots": pilots,
        "panels": [
            *([distance_panel(distances)] if picture.obstacles else []),
            margin_panel(picture),
            *input_panels(picture, drawn),
        ],
    }


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


def pilot(
    key: str, name: str, labels: Sequence[str], times: Array, paths: Array, modes: NDArray[Any], **style: Any
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
