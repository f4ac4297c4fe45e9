"""The report of an ordinary run folder: S alone, U alone, and the schedule."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...model.system import Array
from ...runs.folder import RunFolder
from ...runs.picture import Picture
from ...simulation.baselines import Flights
from ..figures.style import mode_colour
from . import timelines
from .bounds import proven_distance
from .numbers import plain
from .scene import scene_of, shown_axes

NAMES = {"polaris": "Polaris (the schedule)", "safety": "S alone", "experimental": "U alone"}


def run_data(folder: RunFolder) -> dict[str, Any]:
    """What the page's script draws of a run folder.

    Raises
    ------
    ScenarioError
        If a file is missing or damaged.
    """
    picture = folder.picture()
    flights = {key: picture.flights[key] for key in NAMES if key in picture.flights}
    proved = folder.summary["guarantee"]["kind"] == "proved"
    present = [item.modes for item in flights.values()] + [picture.modes]
    flown = [picture.positions(item) for item in flights.values()]
    axes = shown_axes(picture, flown)
    pilots, distances, inputs = [], [], []
    for key, item in flights.items():
        chosen = _kept(item)
        who = _modes(item)[chosen[:-1]]
        paths = timelines.paths_of(picture, item.times[chosen], item.states[:, chosen], axes)
        runs = len(item.labels)
        style = {"colour": mode_colour({"safety": 0, "experimental": 1}.get(key, 6)), "on": key == "polaris"}
        if key == "polaris":
            style["colour"] = "#000000"
        style["dash"] = {"safety": "dash", "experimental": "dot"}.get(key, "solid")
        pilots.append(
            timelines.pilot(
                key, NAMES[key], item.labels, item.times[chosen], paths, np.tile(who, (runs, 1)), **style
            )
        )
        distances += _distance(picture, key, item, chosen)
        held = np.minimum(chosen, len(item.inputs[0]) - 1)
        inputs.append((key, item.inputs[:, held], item.input_range[:, held]))
    bound = proven_distance(picture) if proved else None
    if bound is not None:
        distances.append(timelines.proven_series(bound, picture.reference.delta))
    panels = [
        *([timelines.distance_panel(distances)] if picture.obstacles else []),
        timelines.margin_panel(picture),
        *timelines.input_panels(picture, inputs),
    ]
    return {
        "scene": scene_of(picture, flown, axes),
        "end": plain(picture.duration),
        "open": plain(picture.closest),
        "modes": timelines.mode_names(picture, np.concatenate(present)),
        "modes_title": timelines.WHO,
        "by": "mode",
        "pilots": pilots,
        "panels": panels,
    }


def _modes(flights: Flights) -> Any:
    """Who flies from each node on, shape (N,)."""
    return np.repeat(flights.modes, (len(flights.times) - 1) // len(flights.modes))


def _kept(flights: Flights) -> Any:
    must = [int(np.argmin(flights.nearest[0]))]
    return timelines.kept(len(flights.times), _modes(flights), must)


def _distance(picture: Picture, key: str, flights: Flights, chosen: Any) -> list[dict[str, Any]]:
    found: Array | None = timelines.own_distance(picture, flights.times, flights.states)
    if found is None:
        return []
    band = flights.nearest[[0, 2]][:, chosen]
    return [{"pilot": key, "runs": plain(found[:, chosen]), "band": plain(band)}]
