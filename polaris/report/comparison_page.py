"""What the report of a comparison draws: every method's flights in the scene of its run folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..figures.picture import Picture
from ..runarrays import read_arrays
from ..runfolder import RunFolder
from . import timelines
from .bounds import proven_distance
from .numbers import plain
from .scene import scene_of, shown_axes

FIRST = 4
"""Methods that are shown at first; the others can be chosen."""

Arrays = Mapping[str, NDArray[Any]]


def comparison_data(folder: Path, run: RunFolder, methods: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """What the page's script draws of a comparison.

    Parameters
    ----------
    folder : Path
        With ``comparison.npz``.
    run : RunFolder
        Of the schedule: it has the scene.
    methods : sequence of mapping
        As in ``comparison.json``; those without arrays are left out.
    """
    picture, arrays = run.picture(), read_arrays(folder / "comparison.npz")
    flown = [method for method in methods if f"{method['key']}_t_s" in arrays]
    pilots, distances, inputs, present = [], [], [], [picture.modes]
    paths = [arrays[f"{method['key']}_states"][0] @ picture.system.position.T for method in flown]
    axes = shown_axes(picture, paths)
    for place, method in enumerate(flown):
        key = str(method["key"])
        states, modes, times = (arrays[f"{key}_{name}"] for name in ("states", "modes", "t_s"))
        chosen = timelines.kept(len(times), modes, [int(np.argmin(arrays[f"{key}_distance_m"][0]))])
        held = np.minimum(chosen, modes.shape[1] - 1)
        pilots.append(
            timelines.pilot(
                key,
                str(method["name"]),
                [str(label) for label in arrays[f"{key}_labels"].tolist()],
                times[chosen],
                timelines.paths_of(picture, times[chosen], states[:, chosen], axes),
                modes[:, held[:-1]],
                on=place < FIRST,
                **timelines.style_of(place),
            )
        )
        distances += _distance(picture, key, arrays, chosen)
        inputs.append((key, arrays[f"{key}_inputs"][:, held], None))
        present.append(modes.ravel())
    if run.summary["guarantee"]["kind"] == "proved":
        bound = proven_distance(picture)
        if bound is not None:
            distances.append(timelines.proven_series(bound, picture.reference.delta))
    return {
        "scene": scene_of(replace(picture, slices=None), paths, axes),
        "open": plain(_closest(flown[:FIRST], arrays, picture.closest)),
        "end": plain(max((one["t"][-1] for one in pilots), default=picture.duration)),
        "modes": timelines.mode_names(picture, np.concatenate(present)),
        "modes_title": timelines.WHO,
        "by": "pilot",
        "pilots": pilots,
        "panels": [
            *([timelines.distance_panel(distances)] if picture.obstacles else []),
            timelines.margin_panel(picture),
            *timelines.input_panels(picture, inputs),
        ],
    }


def _closest(flown: Sequence[Mapping[str, Any]], arrays: Arrays, without: float) -> float:
    """When any run of the methods shown at first comes closest to an unsafe set [s]; not at the start."""
    found = [(arrays[f"{one['key']}_distance_m"][0], arrays[f"{one['key']}_t_s"]) for one in flown]
    least = [(float(near.min()), float(t[np.argmin(near)])) for near, t in found if np.isfinite(near).all()]
    return (min(least)[1] if least else 0.0) or without


def _distance(picture: Picture, key: str, arrays: Arrays, chosen: Any) -> list[dict[str, Any]]:
    found = timelines.own_distance(picture, arrays[f"{key}_t_s"], arrays[f"{key}_states"])
    if found is None:
        return []
    band = arrays[f"{key}_distance_m"][[0, 2]][:, chosen]
    return [{"pilot": key, "runs": plain(found[:, chosen]), "band": plain(band)}]
