"""The arrays of a run folder: recoverable sets, tubes, simulated runs. Plain arrays, no pickle."""

import math
import zipfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reach.numerics.files import open_regular
from reach.sets.zonotope import Zonotope

from ...model.system import Array
from ...simulation.baselines import FlightEnvelope
from ...synthesis.schedule.schedule import Schedule
from ..plot_data import SliceData, TubeData

LARGEST = 2**30  # most bytes of the arrays of a file, compressed or not

SLICES = {"slice_t_s": "times", "slice_place_m": "places", "slice_outline_m": "outlines"}
"""Attribute of slices by the name of its array."""


def set_arrays(schedule: Schedule, slices: SliceData) -> dict[str, Any]:
    """Return the arrays that define the recoverable sets, in error coordinates, and slices for figures."""
    safety = schedule.safety
    clearance, tracking, kind = safety.clearance, safety.tracking, safety.recoverable.kind
    rows, index = clearance.obstacle_rows
    above, below = clearance.thrust
    nodes = np.arange(safety.problem.K + 1) * clearance.q
    return {
        "kind": np.array(kind),
        "unsafe": np.array([unsafe.name for unsafe in clearance.unsafe], dtype=str),
        "facets": clearance.facets,
        "obstacle_rows": rows,
        "obstacle_row_index": index,
        "obstacle_clearance_m": clearance.distances,
        "thrust_rows": tracking.gain,
        "thrust_clearance_above": above,
        "thrust_clearance_below": below,
        "transition": tracking.flow.phi,
        "decay": tracking.decay,
        "disturbance_obstacle": tracking.disturbance(rows),
        "disturbance_thrust": tracking.disturbance(tracking.commands[: tracking.system.m]),
        "curvature_obstacle": tracking.curvature(rows),
        "curvature_thrust": tracking.curvature(tracking.gain),
        "weight": tracking.W,
        "node": nodes,
        "t_s": nodes * tracking.flow.h,
        "radius": np.array([safety.recoverable.radius(int(node)) for node in nodes]),
        "start_center": (start := tracking.error(safety.start)).c,
        "start_generators": start.G[:, np.any(start.G != 0, axis=0)],
        **array_fields(slices, SLICES),
    }


def tube_arrays(schedule: Schedule) -> dict[str, Any]:
    """Return the reachable set of every step at its nodes, in error and in absolute coordinates.

    ``center + generators b``, ``|b_i| <= 1``; between nodes in the hull of two, widened by ``intersample``.
    Generators (q+1, g, K, n) are in single precision; a box of what that takes, and of what jitter, pulses
    and carried impulses displace the true state from the modelled one, is the last n of them.
    """
    safety, nodes = schedule.safety, Zonotope.stack([step.tube.nodes for step in schedule.steps])
    system, final = safety.problem.system, safety.tracking.error(schedule.final)
    offset = safety.tracking.unmodelled
    single, infinity = nodes.G.astype(np.float32), np.float32(np.inf)
    half_widths = (np.abs(nodes.G - single).sum(axis=-1) + offset).astype(np.float32)
    box = np.nextafter(half_widths, infinity)[..., None] * np.eye(nodes.dim, dtype=np.float32)
    q = safety.tracking.feedback.nodes_per_cell
    return {
        "t_s": schedule.times[:-1, None] + np.arange(q + 1) * safety.tracking.flow.h,
        "mode": schedule.modes,
        "center": nodes.c + safety.reference.fine(q)[: len(nodes.c)],
        "center_error": nodes.c,
        "generators": np.concatenate([single, box], axis=-1).transpose(1, 3, 0, 2),
        "intersample": np.stack([step.tube.intersample for step in schedule.steps])
        + (system.timing.intersample_offset or 0.0),
        "final_center_error": final.c,
        "final_generators": np.hstack([final.G, np.diag(offset)]),
    }


def tube_pictures(arrays: Mapping[str, Any], C: Array) -> dict[str, TubeData]:
    """Return the reachable positions and states out of `tube_arrays`, by attribute of `PlotData`."""
    matrices = {"tube": C, "state_tube": np.eye(C.shape[1])}
    return {
        name: TubeData(
            arrays["center"] @ M.T,
            (arrays["generators"] @ M.T).transpose(2, 0, 3, 1),
            arrays["intersample"] @ np.abs(M).T,
        )
        for name, M in matrices.items()
    }


FLIGHTS = {  # attribute of the flights of a controller or method by the name of its array
    "controller": "controller",
    "labels": "labels",
    "t_s": "times",
    "states": "states",
    "inputs": "inputs",
    "modes": "modes",
    "distance_m": "nearest",
    "input_range": "input_range",
}


def flight_arrays(envelopes: Mapping[str, FlightEnvelope]) -> dict[str, Any]:
    """Return some runs of every controller or method, and the envelope of all of them."""
    parts = (array_fields(flights, FLIGHTS, f"{key}_") for key, flights in envelopes.items())
    return {name: values for part in parts for name, values in part.items() if values is not None}


def array_fields(item: Any, names: Mapping[str, str], prefix: str = "") -> dict[str, Any]:
    """Attributes of an item by the names their arrays have."""
    return {prefix + name: getattr(item, field) for name, field in names.items()}


def read_fields(arrays: Mapping[str, Any], names: Mapping[str, str], prefix: str = "") -> dict[str, Any]:
    """Return attributes by name from arrays: the inverse of `array_fields`."""
    return {field: arrays[prefix + name] for name, field in names.items()}


def read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Return all arrays of a file, once their declared sizes are known; nothing in it is ever unpickled.

    `OSError`, `ValueError`, `BadZipFile` if it is no regular file, damaged, or of more than `LARGEST` bytes.
    """
    with open_regular(path, LARGEST) as file:
        with zipfile.ZipFile(file) as parts:
            for part in parts.infolist():
                _check_header(parts, part)
            size = sum(part.file_size for part in parts.infolist())
        if size > LARGEST:
            raise ValueError(f"{path.name}: its arrays take {size} bytes; must be at most {LARGEST}")
        file.seek(0)
        with np.load(file, allow_pickle=False) as arrays:
            return {name: arrays[name] for name in arrays.files}


def _check_header(parts: zipfile.ZipFile, part: zipfile.ZipInfo) -> None:
    """Raise a ValueError unless an array has the size that the archive declares for it."""
    with parts.open(part) as file:
        version = np.lib.format.read_magic(file)  # it and what follows read no more than a header
        read_header = (
            np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        )
        shape, _, dtype = read_header(file)
        if math.prod(shape) * dtype.itemsize + file.tell() != part.file_size:
            raise ValueError(
                f"{part.filename}: its shape {shape} does not fit its size, {part.file_size} bytes"
            )


def read_finite(path: Path, finite: Iterable[str]) -> dict[str, NDArray[Any]]:
    """All arrays of a file, some of which must be of finite numbers; `ValueError` if they are not."""
    arrays = read_arrays(path)
    if not all(np.isfinite(arrays[name]).all() for name in finite):
        raise ValueError(f"{path.name}: numbers that are not finite")
    return arrays


def read_flights(path: Path) -> dict[str, FlightEnvelope]:
    """Read the arrays of `flight_arrays`, by key."""
    arrays, flights = read_arrays(path), {}
    for key in [name.removesuffix("_t_s") for name in arrays if name.endswith("_t_s")]:
        fields: dict[str, Any] = {field: arrays.get(f"{key}_{name}") for name, field in FLIGHTS.items()}
        fields["controller"] = str(arrays.get(f"{key}_controller", key))
        fields["labels"] = tuple(fields["labels"].tolist())
        flights[key] = FlightEnvelope(**fields)
    return flights
