"""The certificate of a schedule: everything that the argument for its safety rests on, as JSON.

And what had to be found for it, by which `polaris.read_schedule` proves the schedule again.
"""

from collections.abc import Iterable
from dataclasses import asdict
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from reach.numerics.linear import growth

from ..certificate.files.document import FORMAT, VERSION, canonical, digest
from ..model.scene.obstacle import chaser_radius
from ..model.scene.timed_polytope import TimedPolytope
from ..model.system import Array
from ..model.tolerances import ROUNDING
from ..simulation.metrics import finite
from ..synthesis.controllers.controllers import TubeSegment
from ..synthesis.safety.carried_rows import error_tube
from ..synthesis.safety.demand import command_noise
from ..synthesis.safety.get_safety import Safety
from ..synthesis.safety.passive import Drift, clear
from ..synthesis.schedule.schedule import Schedule
from .files.controllers import flown
from .files.ownership import sha256
from .files.tables import strict, write_text


def hexadecimal(values: Any) -> Any:
    """Return nested data with floats as exact hexadecimal text; words, whole numbers and None stay."""
    return strict(values, float.hex)


def certificate(schedule: Schedule, name: str, files: Iterable[Path] = ()) -> dict[str, Any]:
    """The certificate of a schedule of a named scenario, with hashes of files; see docs/certificate.md."""
    safety = schedule.safety
    start, end = safety.problem.initial_set, safety.end
    K, q = safety.problem.K, safety.tracking.feedback.nodes_per_cell
    # Cells over which the unsafe sets are known: those of the reference, and those that drifts need.
    covered = max(safety.reference.cells, 0 if (flight := safety.free_flight) is None else K + flight.cells)
    data: dict[str, Any] = {
        "format": FORMAT,
        "schema_version": VERSION,
        "scenario": {"name": name},
        "artefacts": {path.name: sha256(path) for path in files},
        **flown(schedule),
        "initial_set": {"center": start.c, "generators": start.G.T},
        "unsafe_sets": _sets(schedule, covered),
        **({"chaser_radius": radius} if (radius := chaser_radius(safety.problem.unsafe)) else {}),
        "facets": safety.clearance.facets,
        "reference": {"states": safety.reference.chi, "inputs": safety.reference.nu},
        "schedule": {"modes": schedule.modes, "margins": [finite(m) for m in schedule.margins]},
        **_bounds(safety),
        "recoverable": {
            "kind": safety.recoverable.kind,
            "weight": safety.tracking.W,
            "radius": [finite(safety.recoverable.radius(k * q)) for k in range(K + 1)],
        },
        "enclosures": _enclosures(schedule),
        **_drift(schedule),
        **_powered(schedule),
        "end": {"horizon": end.horizon, "until": finite(end.until), "reason": end.reason},
        **_samples(schedule),
        **_choices(schedule),
        "guarantee": schedule.guarantee,
        "assumptions": list(schedule.assumptions[:-1]),  # the checker works in ball arithmetic
    }
    data = hexadecimal(data)
    data["digest"] = digest(data)
    return data


def write_certificate(folder: Path, schedule: Schedule, name: str, files: Iterable[str]) -> None:
    """Write ``certificate.json`` into a folder that holds the named files."""
    data = certificate(schedule, name, [folder / file for file in files])
    write_text(folder / "certificate.json", canonical(data) + "\n")


def _sets(schedule: Schedule, cells: int) -> list[dict[str, Any]]:
    """Unsafe sets for as long as anything is said of them."""
    known = schedule.safety.clearance.unsafe
    for branch in schedule.powered.branches if schedule.powered else ():
        if branch.safety.reference.cells > cells:
            known, cells = branch.safety.clearance.unsafe, branch.safety.reference.cells
    return [_unsafe(item, cells) for item in known]


def _drift(schedule: Schedule) -> dict[str, Any]:
    """Return where thrust may stop and facets that separate the drift; None for steps that are not clear."""
    passive = schedule.passive
    if passive is None:
        return {}
    steps = [[_departure(part) for part in parts] if clear(parts) else None for parts in passive.drifts]
    abort = passive.flight.abort
    known = {"horizon": float(abort.horizon), "keep_in": abort.keep_in, "parts": passive.flight.parts}
    return {"drift": {**known, "steps": steps}}


def _powered(schedule: Schedule) -> dict[str, Any]:
    """References that leave the schedule's towards the orbit of an abort, and which serves each step."""
    powered = schedule.powered
    if powered is None:
        return {}
    branches = [
        {
            "step": each.step,
            "inputs": each.safety.reference.nu[each.step : each.safety.problem.K],
            "facets": each.safety.clearance.facets,
            "tail": each.safety.reference.chi[each.safety.problem.K],
            "tolerance": float(each.goal[2]),
            "horizon": each.safety.end.horizon,
            "until": finite(each.safety.end.until),
        }
        for each in powered.branches
    ]
    steps = [
        None if way.branch is None else {"branch": way.branch, "cell": way.cell, "delta_v": way.delta_v}
        for way in powered.ways
    ]
    known = {"within": powered.asked.within, "budget": powered.asked.budget}
    return {"powered": {**known, "branches": branches, "steps": steps}}


def _departure(part: Drift) -> dict[str, Any]:
    """One set of starts; the facets in runs of how many parts of a step, and which."""
    runs = [[(len(list(run)), facet) for facet, run in groupby(row)] for row in part.facets.tolist()]
    return {"periods": part.periods, "center": part.start.c, "axes": part.start.G.T, "facets": runs}


def _unsafe(item: TimedPolytope, cells: int) -> dict[str, Any]:
    known = {"name": item.name, "keep_in": item.keep_in}
    return {**known, "normals": item.normals, "offsets": item.offsets[:cells]}


def _samples(schedule: Schedule) -> dict[str, Any]:
    """Return the statement about samples, and the fitted error sets at the nodes of black boxes' steps."""
    if schedule.statement is None:
        return {}
    fits = [getattr(step.tube, "fit", None) for step in schedule.steps]
    return {"samples": {**asdict(schedule.statement), "fits": fits}}


def _choices(schedule: Schedule) -> dict[str, Any]:
    """Return what was found besides: a share of thrust, and other references with the modes along them."""
    tracking, found = schedule.safety.tracking, dict[str, Any]()
    if tracking.profile is not None:
        found["thrust_share"] = tracking.level
    if schedule.worth is not None:
        found["delta_v_unit"] = schedule.worth.unit
        found["library"] = [{"inputs": each.safety.plan.nu, "modes": each.modes} for each in schedule.library]
    return {"choices": found} if found else {}


def _bounds(safety: Safety) -> dict[str, Any]:
    """S's error from the initial set along positions and gain rows, and its largest command."""
    tracking, K, q = safety.tracking, safety.problem.K, safety.clearance.q
    profile = tracking.profile
    C = tracking.system.position
    rows = np.vstack([tracking.whole(np.vstack([C, -C])), tracking.commands])
    scheduled = safety.clearance.scheduled(rows).max(axis=1)
    scheduled[:, : 2 * len(C)] += np.abs(np.vstack([C, C])) @ tracking.system.displaced  # commands are not
    tube = error_tube(tracking, safety.start, rows).over_cells(K, q) + scheduled[:K]
    below, above = np.split(tube[:, 2 * len(C) :], 2, axis=1)
    nu = safety.reference.nu[:K]
    peak = np.maximum(above + nu, below - nu) + command_noise(tracking, K, K)
    return {
        "error_bounds": {"per_step": tube, "settled": tracking.disturbance(rows)[-1] + scheduled[-1]},
        "thrust": {"peak": peak * (1 + ROUNDING)} | ({} if profile is None else {"profile": profile}),
    }


def _enclosures(schedule: Schedule) -> dict[str, Any]:
    """Boxes around the errors at the start of every step and at T, and around the states during steps."""
    safety = schedule.safety
    sets = [safety.start, *(step.tube.end for step in schedule.steps)]
    arcs = safety.reference.fine(safety.clearance.q)
    hulls = [_hull(step.tube, arcs[k], safety, k) for k, step in enumerate(schedule.steps)]
    center, half = np.array([z.c for z in sets]), np.array([z.half_widths for z in sets])
    half = half + safety.problem.system.displaced
    lower, upper = np.array([low for low, _ in hulls]), np.array([high for _, high in hulls])
    # Errors are differences of states: they are rounded as the states are, however small they are.
    states = np.abs(safety.reference.chi).max(axis=0)
    booked = ROUNDING * (states + 1e-6 * states.max())
    beyond = ROUNDING * (np.abs(lower) + np.abs(upper)) + booked
    return {
        "center": center,
        "half_widths": half + ROUNDING * (np.abs(center) + half) + booked,
        "lower": lower - beyond,
        "upper": upper + beyond,
        "slopes": [step.tube.slopes for step in schedule.steps],  # None where nothing clips
    }


def _hull(flight: TubeSegment, arc: Array, safety: Safety, k: int) -> tuple[Array, Array]:
    """Lowest and highest of every state over one step: nodes, what happens between them, the arc's bow."""
    system, h = safety.problem.system, safety.tracking.flow.h
    rate = arc[:-1] @ system.A.T + safety.reference.nu[k] @ system.B.T
    bow = flight.bow + system.displaced + h**2 / 8 * np.abs(rate) @ (np.abs(system.A) @ growth(system.A, h)).T
    centre, half = flight.nodes.c + arc, flight.nodes.half_widths
    low = np.minimum((centre - half)[:-1], (centre - half)[1:]) - bow
    high = np.maximum((centre + half)[:-1], (centre + half)[1:]) + bow
    return low.min(axis=0), high.max(axis=0)
