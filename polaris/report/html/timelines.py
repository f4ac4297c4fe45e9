"""Flights over time as the page's script reads them.

A pilot is ``{key, name, colour, dash, on, labels, t, runs: [{p, modes}]}``, where ``p`` are the coordinates
by axis of the scene and ``modes`` who flies from each sample on. A panel is ``{key, title, unit, limits,
series}``. A series belongs to a pilot, and has ``runs``, a line for each of them, or to none, and has ``y``
at times ``t``.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...model.system import Array
from ..scene.items import Actor, View, modes_per_node
from ..scene.timelines import Panel, Series, Timeline
from .scene import plain, scene_data

MOST = 400  # most samples of a run that are drawn, besides changes of controller
Samples = NDArray[np.intp]


def page_data(scene: View, timeline: Timeline, position: Array) -> dict[str, Any]:
    """Return the plot data of a page: a scene and the flights in it; `position` (d, n) is that of a state."""
    controllers, chosen = timeline.controllers, dict[str, Samples]()
    for key, runs in ((one.key, one.flights) for one in controllers):  # the closest approach among them
        chosen[key] = drawn_samples(len(runs.times), modes_per_node(runs), [int(np.argmin(runs.nearest[0]))])
    return {
        "scene": scene_data(scene),
        "end": plain(max((one.flights.times[-1] for one in controllers), default=timeline.opened)),
        "open": plain(timeline.opened),
        "modes": [{"mode": mode, "name": name, "colour": colour} for mode, name, colour in timeline.modes],
        "modes_title": timeline.modes_title,
        "by": timeline.by,
        "marks": [one._asdict() | {"t": plain(one.t)} for one in timeline.marks],
        "pilots": [_pilot(one, scene, position, chosen[one.key]) for one in controllers],
        "panels": [_panel(one, chosen) for one in timeline.panels],
    }


def drawn_samples(count: int, modes: ArrayLike = (), must: Sequence[int] = ()) -> Samples:
    """Samples of `count` that are drawn: evenly many, the ends, changes of modes (r, N-1), required ones."""
    if count <= MOST:
        return np.arange(count)
    even = np.linspace(0, count - 1, MOST).astype(int)
    changes = np.flatnonzero(np.diff(np.atleast_2d(modes), axis=1).any(axis=0)) + 1
    if len(changes) > MOST:  # nobody could see them all
        changes = changes[:: -(-len(changes) // MOST)]
    return np.unique(np.concatenate([even, changes, must]).astype(int))


def _pilot(one: Actor, scene: View, position: Array, chosen: Samples) -> dict[str, Any]:
    runs, times = one.flights, one.flights.times[chosen]
    paths = scene.placed(runs.states[:, chosen] @ position.T, times)
    pairs = zip(paths, modes_per_node(runs)[:, chosen[:-1]], strict=True)
    fields = {key: getattr(one, key) for key in ("key", "name", "colour", "dash", "on")}
    entries = [{"p": plain(path.T), "modes": plain(modes)} for path, modes in pairs]
    return fields | {"labels": list(runs.labels), "t": plain(times), "runs": entries}


def _panel(one: Panel, chosen: dict[str, Samples]) -> dict[str, Any]:
    unit = one.unit.replace("^2", "²")
    limits = [{"y": plain(each.y), "text": each.text, "unsafe": each.unsafe} for each in one.limits]
    series = [_series(each, chosen) for each in one.series]
    return {"key": one.key, "title": one.title, "unit": unit, "limits": limits, "series": series}


def _series(one: Series, chosen: dict[str, Samples]) -> dict[str, Any]:
    fields: dict[str, Any] = {"pilot": one.controller, "step": one.step}
    if one.controller is not None:
        samples = chosen[one.controller]
        band = {} if one.band is None else {"band": plain(one.band[:, samples])}
        return fields | band | {"runs": plain(one.values[:, samples])}
    look = {key: getattr(one, key) for key in ("name", "meaning", "colour", "dash", "fill")}
    return fields | look | {"t": plain(one.times), "y": plain(one.values)}
