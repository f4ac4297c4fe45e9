"""The files of a run folder, one function each: tables, strict JSON and plain arrays (no pickle)."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .comparison import Flights
from .controllers import AffineController
from .figures.picture import SlicePicture, TubePicture, recoverable_slices, shown_steps
from .reference import Reference
from .schedule import Schedule
from .system import Array, LinearSystem

STEP_COLUMNS = (
    "step",
    "t_start_s",
    "t_end_s",
    "mode",
    "controller",
    "margin",
    "limit",
    "limit_time_s",
    "need",
    "room",
)


def strict(value: Any) -> Any:
    """The same data for strict JSON: numpy turned plain, infinities and NaN into null."""
    if isinstance(value, Mapping):
        return {str(key): strict(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return strict(value.tolist())
    if isinstance(value, (list, tuple)):
        return [strict(item) for item in value]
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, (int, np.integer)):
        return int(value)
    if isinstance(value, (float, np.floating)):
        return float(value) if np.isfinite(value) else None
    return value


def json_text(data: Any) -> str:
    """Strict JSON, readable, the same bytes for the same data."""
    return json.dumps(strict(data), indent=2, allow_nan=False, ensure_ascii=False) + "\n"


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 with the same line ends everywhere."""
    path.write_text(text, encoding="utf-8", newline="\n")


def write_csv(path: Path, header: tuple[str, ...], rows: list[list[Any]]) -> None:
    """Write a table; numbers in the shortest form that reads back exactly, what is not finite empty."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows([["" if item is None else item for item in strict(row)] for row in rows])


# -- schedule ---------------------------------------------------------------------------------------


def step_rows(schedule: Schedule) -> list[dict[str, Any]]:
    """One row per step of the schedule."""
    times = schedule.times
    return [
        dict(
            zip(
                STEP_COLUMNS,
                (
                    k,
                    times[k],
                    times[k + 1],
                    step.mode,
                    schedule.controllers[step.mode].name,
                    step.margin.value,
                    step.margin.limit,
                    step.margin.time,
                    step.margin.need,
                    step.margin.room,
                ),
                strict=True,
            )
        )
        for k, step in enumerate(schedule.steps)
    ]


def write_schedule(folder: Path, schedule: Schedule, rules: Mapping[str, Any], guarantee: Any) -> None:
    """Write ``schedule.csv`` and ``schedule.json``."""
    rows = step_rows(schedule)
    write_csv(folder / "schedule.csv", STEP_COLUMNS, [list(row.values()) for row in rows])
    names = [controller.name for controller in schedule.controllers]
    data = {
        "schema_version": 1,
        "step_s": schedule.safety.problem.delta,
        "duration_s": schedule.times[-1],
        "controllers": [
            {"mode": mode, "name": name, "kind": type(controller).__name__}
            for mode, (name, controller) in enumerate(zip(names, schedule.controllers, strict=True))
        ],
        "rules": rules,
        "modes": schedule.modes,
        "switches": schedule.switches,
        "experimental_share": schedule.share(),
        "share": {name: schedule.share(mode) for mode, name in enumerate(names)},
        "recoverable": schedule.safety.recoverable.kind,
        "guarantee": guarantee,
        "steps": rows,
    }
    write_text(folder / "schedule.json", json_text(data))


# -- reference and gains ------------------------------------------------------------------------------


def columns(system: LinearSystem) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Column names of the states and the inputs, with units where they are known."""
    if system.mean_motion is not None and system.n == 6 and system.m == 3:
        states = tuple(f"{name}_{'m' if name[0] == 'r' else 'm_s'}" for name in system.state_names)
        return states, ("u_x_N", "u_y_N", "u_z_N")
    return system.state_names, tuple(f"u{i}" for i in range(system.m))


def write_reference(path: Path, reference: Reference) -> None:
    """Write state at every waypoint and the input held from there on (none at the last)."""
    states, inputs = columns(reference.system)
    held: list[Any] = [*reference.nu.tolist(), [None] * reference.system.m]
    rows = [
        [k * reference.delta, *chi, *nu] for k, (chi, nu) in enumerate(zip(reference.chi.tolist(), held, strict=True))
    ]
    write_csv(path, ("t_s", *states, *inputs), rows)


def read_reference(path: Path, system: LinearSystem, delta: float) -> Reference:
    """Read what `write_reference` wrote, bit for bit."""
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))[1:]
    if len(rows) < 2:
        raise ValueError("too few rows")
    chi = np.array([[float(item) for item in row[1 : 1 + system.n]] for row in rows])
    nu = np.array([[float(item) for item in row[1 + system.n :]] for row in rows[:-1]])
    if chi.shape != (len(rows), system.n) or nu.shape != (len(rows) - 1, system.m):
        raise ValueError("wrong number of columns")
    return Reference(system, delta, chi, nu)


def gains(schedule: Schedule) -> dict[str, Any]:
    """System, gains, error bounds and the experimental controllers' own references."""
    safety = schedule.safety
    system, tracking, bounds = safety.problem.system, safety.tracking, safety.bounds
    law = "u = mu(t) + gain (xi(t) - x), reference.csv gives xi and mu"
    controllers: list[dict[str, Any]] = []
    for mode, controller in enumerate(schedule.controllers):
        entry: dict[str, Any] = {"mode": mode, "name": controller.name, "kind": type(controller).__name__}
        if isinstance(controller, AffineController):
            entry |= {"gain": controller.gain, "clips": controller.clips}
            if controller.own is not safety.reference:
                entry |= {"own_states": controller.own.chi, "own_inputs": controller.own.nu}
        controllers.append(entry)
    return {
        "law": law,
        "system": {
            "A": system.A,
            "B": system.B,
            "C": system.position,
            "D": system.D,
            "input_max": system.u_max,
            "disturbance_max": system.w_max,
            "mass_kg": system.mass,
        },
        "feedback": {
            "sampled": tracking.feedback.sampled,
            "node_spacing_s": tracking.flow.h,
            "nodes_per_step": tracking.feedback.nodes_per_cell,
        },
        "controllers": controllers,
        "error_bounds": {
            "method": bounds.method,
            "weight": bounds.W,
            "beta_1_s": bounds.beta,
            "gamma": bounds.gamma,
            "gain": bounds.gain,
            "gamma_position": bounds.gamma_position,
            "gain_position": bounds.gain_position,
            "gamma_input": bounds.gamma_input,
            "gain_input": bounds.gain_input,
        },
    }


# -- sets, tubes, trajectories ------------------------------------------------------------------------


def write_sets(path: Path, schedule: Schedule) -> None:
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
    slices = recoverable_slices(safety)
    if slices is not None:
        arrays |= {
            "slice_step": shown_steps(safety.problem.K),
            "slice_center_m": slices.centre,
            "slice_outline_m": slices.outline,
        }
    np.savez(path, **arrays)


def write_tubes(path: Path, schedule: Schedule) -> None:
    """Write the reachable set of every step at its nodes, in error and in absolute coordinates.

    The set at a node is ``center + generators b`` with every ``|b_i| <= 1``; between two nodes it
    lies in the hull of the two, up to ``bow`` on either side.
    """
    safety = schedule.safety
    q = safety.tracking.feedback.nodes_per_cell
    width = max(step.flight.nodes.order_count for step in schedule.steps)
    error = np.stack([step.flight.nodes.c for step in schedule.steps])
    generators = np.zeros((*error.shape, width))
    for k, step in enumerate(schedule.steps):
        generators[k, ..., : step.flight.nodes.order_count] = step.flight.nodes.G
    start = schedule.times[:-1, None]
    np.savez(
        path,
        t_s=start + np.arange(q + 1) * safety.tracking.flow.h,
        mode=schedule.modes,
        center=error + safety.reference.fine(q)[: len(error)],
        center_error=error,
        generators=generators,
        bow=np.stack([step.flight.bow for step in schedule.steps]),
        final_center_error=schedule.final.c,
        final_generators=schedule.final.G,
    )


def write_flights(path: Path, flown: Mapping[str, Flights]) -> None:
    """Write some runs of every controller and the envelope of all of them."""
    arrays: dict[str, Any] = {}
    for key, flights in flown.items():
        arrays |= {
            f"{key}_controller": np.array(flights.controller),
            f"{key}_labels": np.array(flights.labels),
            f"{key}_t_s": flights.times,
            f"{key}_states": flights.states,
            f"{key}_inputs": flights.inputs,
            f"{key}_modes": flights.modes,
            f"{key}_distance_m": flights.nearest,
            f"{key}_input_range": flights.input_range,
        }
    np.savez(path, **arrays)


def read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """All arrays of a file; nothing in it is ever unpickled."""
    with np.load(path, allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def read_flights(path: Path) -> dict[str, Flights]:
    """Read what `write_flights` wrote."""
    arrays = read_arrays(path)
    out = {}
    for key in ("safety", "experimental", "polaris"):
        if f"{key}_t_s" in arrays:
            names = ("controller", "labels", "t_s", "states", "inputs", "modes", "distance_m", "input_range")
            controller, labels, *rest = (arrays[f"{key}_{name}"] for name in names)
            out[key] = Flights(str(controller), tuple(labels.tolist()), *rest)
    return out


def read_tube(path: Path, C: Array) -> TubePicture:
    """Positions out of what `write_tubes` wrote."""
    arrays = read_arrays(path)
    return TubePicture(arrays["center"] @ C.T, C @ arrays["generators"], arrays["bow"] @ np.abs(C).T)


def read_slices(path: Path) -> SlicePicture | None:
    """Slices out of what `write_sets` wrote."""
    arrays = read_arrays(path)
    if "slice_outline_m" not in arrays:
        return None
    return SlicePicture(arrays["slice_center_m"], arrays["slice_outline_m"])
