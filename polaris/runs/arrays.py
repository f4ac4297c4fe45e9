"""The arrays of a run folder: recoverable sets, tubes, simulated runs. Plain arrays, no pickle."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..model.system import Array
from ..simulation.baselines import Flights
from ..synthesis.schedule import Schedule
from .picture import SlicePicture, TubePicture


def write_sets(path: Path, schedule: Schedule, slices: SlicePicture | None) -> None:
    """Write everything the recoverable sets are made from, in error coordinates, and slices for figures."""
    safety = schedule.safety
    clearance, tracking, kind = safety.clearance, safety.tracking, safety.recoverable.kind
    rows, index = clearance.obstacle_rows
    above, below = clearance.thrust
    names = [unsafe.name for unsafe in clearance.unsafe]
    nodes = np.arange(safety.problem.K + 1) * clearance.q
    arrays: dict[str, Any] = {
        "kind": np.array(kind),
        "unsafe": np.array(names, dtype=str),
        "facets": clearance.facets,
        "obstacle_rows": rows,
        "obstacle_row_index": index,
        "obstacle_room_m": clearance.room,
        "thrust_rows": tracking.gain,
        "thrust_room_above": above,
        "thrust_room_below": below,
        "transition": tracking.flow.phi,
        "decay": tracking.decay,
        "disturbance_obstacle": tracking.disturbance(rows),
        "disturbance_thrust": tracking.disturbance(tracking.gain),
        "curvature_obstacle": tracking.curvature(rows),
        "curvature_thrust": tracking.curvature(tracking.gain),
        "weight": tracking.W,
        "node": nodes,
        "t_s": nodes * tracking.flow.h,
        "radius": np.array([safety.recoverable.radius(int(node)) for node in nodes]),
        "start_center": safety.start.c,
        "start_generators": safety.start.G,
    }
    if slices is not None:
        arrays |= {
            "slice_t_s": slices.times,
            "slice_place_m": slices.places,
            "slice_outline_m": slices.outlines,
        }
    np.savez(path, **arrays)


def write_tubes(path: Path, schedule: Schedule) -> None:
    """Write the reachable set of every step at its nodes, in error and in absolute coordinates.

    The set at a node is ``center + generators b`` with every ``|b_i| <= 1``; between two nodes it
    lies in the hull of the two, up to ``bow`` on either side.
    """
    safety = schedule.safety
    q = safety.tracking.feedback.nodes_per_cell
    width = max(step.tube.nodes.order_count for step in schedule.steps)
    error = np.stack([step.tube.nodes.c for step in schedule.steps])
    generators = np.zeros((*error.shape, width))
    for k, step in enumerate(schedule.steps):
        generators[k, ..., : step.tube.nodes.order_count] = step.tube.nodes.G
    start = schedule.times[:-1, None]
    np.savez(
        path,
        t_s=start + np.arange(q + 1) * safety.tracking.flow.h,
        mode=schedule.modes,
        center=error + safety.reference.fine(q)[: len(error)],
        center_error=error,
        generators=generators,
        bow=np.stack([step.tube.bow for step in schedule.steps]),
        final_center_error=schedule.final.c,
        final_generators=schedule.final.G,
    )


FLIGHTS = {
    "controller": "controller",
    "labels": "labels",
    "t_s": "times",
    "states": "states",
    "inputs": "inputs",
    "modes": "modes",
    "distance_m": "nearest",
    "input_range": "input_range",
}
"""Attribute of the flights of a controller by the name of its array."""


def write_flights(path: Path, flown: Mapping[str, Flights]) -> None:
    """Write some runs of every controller and the envelope of all of them."""
    arrays: dict[str, Any] = {
        f"{key}_{name}": np.array(getattr(flights, held))
        for key, flights in flown.items()
        for name, held in FLIGHTS.items()
    }
    np.savez(path, **arrays)


def read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """All arrays of a file; nothing in it is ever unpickled."""
    with np.load(path, allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def read_finite(path: Path, finite: Iterable[str]) -> dict[str, NDArray[Any]]:
    """All arrays of a file, some of which must be of finite numbers; `ValueError` if they are not."""
    arrays = read_arrays(path)
    if not all(np.isfinite(arrays[name]).all() for name in finite):
        raise ValueError(f"{path.name}: numbers that are not finite")
    return arrays


def read_flights(path: Path) -> dict[str, Flights]:
    """Read what `write_flights` wrote."""
    arrays, out = read_arrays(path), {}
    for key in ("safety", "experimental", "polaris"):
        if f"{key}_t_s" in arrays:
            found: dict[str, Any] = {held: arrays[f"{key}_{name}"] for name, held in FLIGHTS.items()}
            found |= {"controller": str(found["controller"]), "labels": tuple(found["labels"].tolist())}
            out[key] = Flights(**found)
    return out


def read_tube(path: Path, C: Array) -> TubePicture:
    """Positions out of what `write_tubes` wrote."""
    arrays = read_arrays(path)
    return TubePicture(arrays["center"] @ C.T, C @ arrays["generators"], arrays["bow"] @ np.abs(C).T)


def read_slices(path: Path) -> SlicePicture | None:
    """Slices out of what `write_sets` wrote; None of a folder whose slices were not those of its runs."""
    arrays = read_arrays(path)
    if "slice_place_m" not in arrays:
        return None
    return SlicePicture(arrays["slice_t_s"], arrays["slice_place_m"], arrays["slice_outline_m"])
