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
from ...rta.arena import Shown
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
    """Who flew, how it looks (``colour``, ``dash``, ``on`` at first), the runs that can be shown.

    Perhaps with the least and largest input over all runs, shape (2, N, m).
    """

    key: str
    name: str
    look: dict[str, Any]
    runs: Shown
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
    C = picture.system.position
    paths = [one.runs.states[0] @ C.T for one in flown]
    scene = describe(picture, paths, shown_axes(picture, paths))
    pilots, distances, drawn = [], [], []
    for one in flown:
        runs, t = one.runs, one.runs.times
        chosen = kept(len(t), runs.modes, [int(np.argmin(runs.nearest[0]))])
        held, positions = np.minimum(chosen, runs.inputs.shape[1] - 1), runs.states @ C.T
        pilots.append(pilot(one, chosen, scene.placed(positions[:, chosen], t[chosen])))
        if picture.obstacles:  # other satellites are where they are nominally: no file says where they were
            found = signed_distances(picture.obstacles, t, positions, picture.system).min(axis=0)
            band = runs.nearest[[0, 2]][:, chosen]
            distances.append({"pilot": one.key, "runs": plain(found[:, chosen]), "band": plain(band)})
        span = None if one.input_range is None else one.input_range[:, held]
        drawn.append((one.key, runs.inputs[:, held], span))
    bound = proven_distance(picture) if proved else None
    if bound is not None:
        distances.append(_proven(bound, picture.reference.delta))
    panels = [_margins(picture), *_inputs(picture, drawn)]
    if picture.obstacles:
        title = "Distance to the nearest unsafe set"
        panels.insert(0, panel("distance", title, "m", [limit(0.0, "unsafe", "below")], distances))
    present = np.concatenate([picture.modes, *(one.runs.modes.ravel() for one in flown)])
    return {
        "scene": scene_data(scene),
        "end": plain(max((one["t"][-1] for one in pilots), default=picture.duration)),
        "open": plain(picture.closest if opened is None else opened),
        "modes": mode_names(picture, present),
        "modes_title": WHO,
        "by": by,
        "pilots": pilots,
        "panels": panels,
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


def pilot(one: Flown, chosen: NDArray[np.intp], paths: Array) -> Pilot:
    """One pilot at some samples, with paths (r, N, dim) in the axes of the scene [m] at these."""
    shown = one.runs
    modes = shown.modes[:, np.minimum(chosen[:-1], shown.modes.shape[1] - 1)]
    runs = [{"p": plain(path.T), "modes": plain(who)} for path, who in zip(paths, modes, strict=True)]
    told = {"key": one.key, "name": one.name, "labels": list(shown.labels), "t": plain(shown.times[chosen])}
    return told | {"runs": runs} | one.look


def mode_names(picture: Picture, present: ArrayLike) -> list[dict[str, Any]]:
    """Name and colour of every mode that occurs."""
    told = []
    for mode in np.unique(np.asarray(present, dtype=int)).tolist():
        known = 0 <= mode < len(picture.controllers)
        name, colour = picture.mode_name(mode) if known else f"controller {mode}", mode_colour(mode)
        if mode == UNKNOWN:
            name, colour = "filtered input, or not known", "#9A9A9A"
        told.append({"mode": mode, "name": name, "colour": colour})
    return told


def limit(y: float, text: str, unsafe: str = "") -> dict[str, Any]:
    """A limit in a panel; `unsafe` says which side of it is shaded: ``above``, ``below`` or none."""
    return {"y": plain(y), "text": text, "unsafe": unsafe}


def panel(key: str, title: str, unit: str, limits: list[dict[str, Any]], series: list[Any]) -> Panel:
    """One diagram."""
    return {"key": key, "title": title, "unit": unit, "limits": limits, "series": series}


def input_panel(axis: int, title: str, unit: str, most: float, series: list[Any], form: str = ".4g") -> Panel:
    """One input between its limits."""
    limits = [limit(-most, "", "below"), limit(most, f"limit {most:{form}}", "above")]
    return panel(f"input{axis}", title, unit, limits, series)


def _proven(bound: Array, delta: float) -> dict[str, Any]:
    """The distance that is proven, held over every period."""
    K, q = bound.shape
    times = np.append((np.arange(K)[:, None] + np.arange(q) / q).ravel(), K) * delta
    line = {"t": plain(times), "y": plain(np.append(bound.ravel(), bound[-1, -1])), "step": True}
    look = {"colour": GREEN, "dash": "solid", "fill": True}
    return {"pilot": None, "name": "proven for the schedule: at least"} | line | look


def _margins(picture: Picture) -> Panel:
    """Room left in the recoverable sets, step by step."""
    delta = picture.reference.delta
    series = {
        "pilot": None,
        "name": "margin",
        "bars": True,
        "t": plain((np.arange(len(picture.modes)) + 0.5) * delta),
        "width": plain(delta),
        "y": plain(picture.margins),
        "modes": plain(picture.modes),
        "text": [
            f"margin {directed(share, '.3f')}, limit: {name}"
            for share, name in zip(picture.margins, picture.limits, strict=True)
        ],
    }
    title = "Containment margin of each step of the schedule"
    return panel("margin", title, "share of room", [limit(0.0, "")], [series])


def _inputs(picture: Picture, drawn: Sequence[tuple[str, Array, Array | None]]) -> list[Panel]:
    """One panel per input.

    Parameters
    ----------
    picture : Picture
    drawn : sequence of (pilot, inputs, range)
        Inputs of the runs (r, N, m), and least and largest over all runs (2, N, m) if they are known.
    """
    label, names = input_labels(picture.system)
    what, _, unit = label.rstrip(")").partition(" (")
    found = []
    for axis, (name, most) in enumerate(zip(names, picture.system.u_max.tolist(), strict=True)):
        series = []
        for key, inputs, span in drawn:
            band = {} if span is None else {"band": plain(span[..., axis])}
            series.append({"pilot": key, "step": True, "runs": plain(inputs[..., axis])} | band)
        title = f"{what}, {name}" if what != "Input" else f"Input: {name}"
        found.append(input_panel(axis, title, unit, most, series))
    return found
