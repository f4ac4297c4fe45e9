"""The certificate of a schedule: everything that the argument for its safety rests on, as JSON."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from reach.numerics.linear import growth

from ..certificate.document import FORMAT, VERSION, canonical, digest
from ..model.system import Array
from ..model.timed_polytope import TimedPolytope
from ..model.tolerances import ROUNDING
from ..synthesis.clearance import error_tube
from ..synthesis.controllers import AffineController, Controller, TubeSegment
from ..synthesis.get_safety import Safety
from ..synthesis.schedule import Schedule, Step, assumed


def hexadecimal(values: Any) -> Any:
    """The same nested lists, floats as exact hexadecimal text."""
    if isinstance(values, list):
        return [hexadecimal(item) for item in values]
    if isinstance(values, (np.ndarray, tuple)):
        return hexadecimal(np.asarray(values, dtype=float).tolist())
    return float(values).hex()


def file_hash(path: Path) -> str:
    """SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def certificate(schedule: Schedule, name: str, files: Iterable[Path] = ()) -> dict[str, Any]:
    """Build the certificate of a schedule.

    Parameters
    ----------
    schedule : Schedule
    name : str
        Name of the scenario.
    files : iterable of Path
        Files whose hashes it carries.

    Returns
    -------
    dict
        JSON data; see docs/certificate.md.
    """
    safety, until = schedule.safety, schedule.safety.end.until
    data: dict[str, Any] = {
        "format": FORMAT,
        "schema_version": VERSION,
        "scenario": {"name": name},
        "artefacts": {path.name: file_hash(path) for path in files},
        **_setting(safety),
        "unsafe_sets": [_unsafe(item, safety.reference.cells) for item in safety.clearance.unsafe],
        "facets": safety.clearance.facets.tolist(),
        "reference": {
            "states": hexadecimal(safety.reference.chi),
            "inputs": hexadecimal(safety.reference.nu),
        },
        "controllers": [_controller(item, safety) for item in schedule.controllers],
        "schedule": {
            "modes": schedule.modes.tolist(),
            "margins": [hexadecimal(m) if np.isfinite(m) else None for m in schedule.margins.tolist()],
        },
        **_bounds(safety),
        "recoverable": {
            "kind": safety.recoverable.kind,
            "weight": hexadecimal(safety.tracking.W),
            "radius": [
                None if np.isinf(radius) else hexadecimal(radius)  # where nothing is claimed from there on
                for radius in (
                    safety.recoverable.radius(k * safety.clearance.q) for k in range(safety.problem.K + 1)
                )
            ],
        },
        "enclosures": _enclosures(schedule),
        "end": {
            "horizon": safety.end.horizon,
            "until": hexadecimal(until) if np.isfinite(until) else None,
            "reason": safety.end.reason,
        },
        "guarantee": schedule.guarantee,
        "assumptions": assumed(safety),
    }
    data["digest"] = digest(data)
    return data


def _setting(safety: Safety) -> dict[str, Any]:
    """The system, its sampling, and where it starts."""
    system, tracking = safety.problem.system, safety.tracking
    return {
        "system": {
            "kind": "linear" if system.mean_motion is None else "clohessy_wiltshire",
            "mean_motion": None if system.mean_motion is None else hexadecimal(system.mean_motion),
            "mass": hexadecimal(system.mass),
            "A": hexadecimal(system.A),
            "B": hexadecimal(system.B),
            "C": hexadecimal(system.position),
            "D": hexadecimal(system.D),
            "input_max": hexadecimal(system.u_max),
            "disturbance_max": hexadecimal(system.w_max),
            "input_names": list(system.input_names),
        },
        "sampling": {
            "kind": "sampled" if tracking.feedback.sampled else "continuous",
            "step": hexadecimal(safety.problem.delta),
            "steps": safety.problem.K,
            "nodes_per_step": tracking.feedback.nodes_per_cell,
        },
        "initial_set": {
            "center": hexadecimal(safety.problem.initial_set.c),
            "generators": hexadecimal(safety.problem.initial_set.G.T),
        },
    }


def write_certificate(folder: Path, schedule: Schedule, name: str, files: Iterable[str]) -> None:
    """Write ``certificate.json`` into a folder that holds the named files."""
    data = certificate(schedule, name, [folder / file for file in files])
    (folder / "certificate.json").write_text(canonical(data) + "\n", encoding="utf-8", newline="\n")


def _unsafe(item: TimedPolytope, cells: int) -> dict[str, Any]:
    return {
        "name": item.name,
        "keep_in": item.keep_in,
        "normals": hexadecimal(item.normals),
        "offsets": hexadecimal(item.offsets[:cells]),
    }


def _controller(item: Controller, safety: Safety) -> dict[str, Any]:
    if item is safety.controller:
        return {"name": item.name, "kind": "safety", "gain": hexadecimal(safety.controller.gain)}
    if not isinstance(item, AffineController):
        return {"name": item.name, "kind": "any_thrust"}
    entry = {
        "name": item.name,
        "kind": "saturated_affine" if item.clips else "affine",
        "gain": hexadecimal(item.gain),
    }
    if item.own is not safety.reference:
        entry |= {"own_states": hexadecimal(item.own.chi), "own_inputs": hexadecimal(item.own.nu)}
    return entry


def _bounds(safety: Safety) -> dict[str, Any]:
    """S's error from the initial set along positions and gain rows, and its largest command."""
    tracking, K, q = safety.tracking, safety.problem.K, safety.clearance.q
    C, gain = tracking.system.position, tracking.gain
    rows = np.vstack([C, -C, gain, -gain])
    tube = error_tube(tracking, safety.start, rows).over_cells(K, q)
    below, above = np.split(tube[:, 2 * len(C) :], 2, axis=1)
    nu = safety.reference.nu[:K]
    peak = np.maximum(above + nu, below - nu)
    return {
        "error_bounds": {
            "per_step": hexadecimal(tube),
            "settled": hexadecimal(tracking.disturbance(rows)[-1]),
        },
        "thrust": {"peak": hexadecimal(peak * (1 + ROUNDING))},
    }


def _enclosures(schedule: Schedule) -> dict[str, Any]:
    """Boxes around the errors at the start of every step and at T, and around the states during steps."""
    safety = schedule.safety
    sets = [safety.start, *(step.tube.end for step in schedule.steps)]
    arcs = safety.reference.fine(safety.clearance.q)
    hulls = [_hull(step.tube, arcs[k], safety, k) for k, step in enumerate(schedule.steps)]
    center, half = np.array([z.c for z in sets]), np.array([z.half_widths for z in sets])
    lower, upper = np.array([low for low, _ in hulls]), np.array([high for _, high in hulls])
    # Errors are differences of states: they are rounded as the states are, however small they are.
    states = np.abs(safety.reference.chi).max(axis=0)
    booked = ROUNDING * (states + 1e-6 * states.max())
    beyond = ROUNDING * (np.abs(lower) + np.abs(upper)) + booked
    return {
        "center": hexadecimal(center),
        "half_widths": hexadecimal(half + ROUNDING * (np.abs(center) + half) + booked),
        "lower": hexadecimal(lower - beyond),
        "upper": hexadecimal(upper + beyond),
        "slopes": [_slopes(step) for step in schedule.steps],
    }


def _slopes(step: Step) -> list[Any] | None:
    """Slopes of the bands about a clipped command, by period; None if nothing clips."""
    slopes = step.tube.slopes
    return None if slopes is None else hexadecimal(slopes)


def _hull(flight: TubeSegment, arc: Array, safety: Safety, k: int) -> tuple[Array, Array]:
    """Lowest and highest of every state over one step: nodes, what happens between them, the arc's bow."""
    system, h = safety.problem.system, safety.tracking.flow.h
    rate = arc[:-1] @ system.A.T + safety.reference.nu[k] @ system.B.T
    bow = flight.bow + h**2 / 8 * np.abs(rate) @ (np.abs(system.A) @ growth(system.A, h)).T
    centre, half = flight.nodes.c + arc, flight.nodes.half_widths
    low = np.minimum((centre - half)[:-1], (centre - half)[1:]) - bow
    high = np.maximum((centre + half)[:-1], (centre + half)[1:]) + bow
    return low.min(axis=0), high.max(axis=0)
