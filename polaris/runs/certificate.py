"""The certificate of a schedule: everything that the argument for its safety rests on, as JSON.

And what had to be found for it, by which `polaris.read_schedule` proves the schedule again.
"""

from collections.abc import Iterable
from dataclasses import asdict
from itertools import groupby
from pathlib import Path
from typing import Any

from ..certificate.files.document import FORMAT, VERSION, canonical, digest
from ..model.scene.obstacle import chaser_radius
from ..synthesis.safety.passive import Drift, clear
from ..synthesis.schedule.schedule import Schedule
from .files.controllers import system_tables
from .files.ownership import sha256
from .files.tables import strict, write_text


def hexadecimal(values: Any) -> Any:
    """Return nested data with floats as exact hexadecimal text; words, whole numbers and None stay."""
    return strict(values, float.hex)


def certificate(schedule: Schedule, name: str, files: Iterable[Path] = ()) -> dict[str, Any]:
    """Return the certificate of a scenario's schedule, with hashes of files; see docs/certificate.md."""
    safety = schedule.safety
    start, K = safety.problem.initial_set, safety.problem.K
    # Cells over which the unsafe sets are known: those of the reference, and those that drifts need.
    covered = max(safety.reference.cells, 0 if (flight := safety.free_flight) is None else K + flight.cells)
    data: dict[str, Any] = {
        "format": FORMAT,
        "schema_version": VERSION,
        "scenario": {"name": name},
        "artefacts": {path.name: sha256(path) for path in files},
        **system_tables(schedule),
        "initial_set": {"center": start.c, "generators": start.G.T},
        "unsafe_sets": _sets(schedule, covered),
        **({"chaser_radius": radius} if (radius := chaser_radius(safety.problem.unsafe)) else {}),
        "facets": safety.clearance.facets,
        "reference": {"states": safety.reference.chi, "inputs": safety.reference.nu},
        "modes": schedule.modes,
        "slopes": [step.tube.slopes for step in schedule.steps],  # None where nothing clips
        **_weights(schedule),
        **({} if (bound := safety.tracking.feedback_bound) is None else {"feedback_bound": bound}),
        "recoverable": safety.recoverable.kind,
        **_drift(schedule),
        **_powered(schedule),
        "horizon": safety.end.horizon,
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
    unsafe = schedule.safety.clearance.unsafe
    for branch in schedule.powered.branches if schedule.powered else ():
        if branch.safety.reference.cells > cells:
            unsafe, cells = branch.safety.clearance.unsafe, branch.safety.reference.cells
    return [
        {"name": item.name, "keep_in": item.keep_in, "normals": item.normals, "offsets": item.offsets[:cells]}
        | ({"of_state": True} if item.of_state else {})
        for item in unsafe
    ]


def _weights(schedule: Schedule) -> dict[str, Any]:
    """Return weights by which the velocity change is bounded, step by step; None where it is not linear."""
    weights = [None if each is None else [*each.r, *each.b] for each in schedule.spending.weights]
    return {"weights": weights} if any(weights) else {}


def _drift(schedule: Schedule) -> dict[str, Any]:
    """Return where thrust may stop and facets that separate the drift; None for steps that are not clear."""
    passive = schedule.passive
    if passive is None:
        return {}
    steps = [[_departure(part) for part in parts] if clear(parts) else None for parts in passive.drifts]
    abort = passive.flight.abort
    settings = {"horizon": float(abort.horizon), "keep_in": abort.keep_in, "parts": passive.flight.parts}
    return {"drift": {**settings, "steps": steps}}


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
            "tolerance": float(each.goal.tolerance),
            "horizon": each.safety.end.horizon,
        }
        for each in powered.branches
    ]
    steps = [None if way.branch is None else {"branch": way.branch, "cell": way.cell} for way in powered.ways]
    limits = {"within": powered.abort.within, "budget": powered.abort.budget}
    return {"powered": {**limits, "branches": branches, "steps": steps}}


def _departure(part: Drift) -> dict[str, Any]:
    """One set of starts; the facets in runs of how many parts of a step, and which."""
    runs = [[(len(list(run)), facet) for facet, run in groupby(row)] for row in part.facets.tolist()]
    return {"periods": part.periods, "center": part.start.c, "axes": part.start.G.T, "facets": runs}


def _samples(schedule: Schedule) -> dict[str, Any]:
    """Return the statement about samples, and the fitted error sets at the nodes of black boxes' steps."""
    if schedule.sampled_bound is None:
        return {}
    fits = [getattr(step.tube, "fit", None) for step in schedule.steps]
    return {"samples": {**asdict(schedule.sampled_bound), "fits": fits}}


def _choices(schedule: Schedule) -> dict[str, Any]:
    """Return the further choices: a share of thrust, and other references with the modes along them."""
    tracking, data = schedule.safety.tracking, dict[str, Any]()
    if tracking.feedback_bound is not None:
        data["thrust_share"] = tracking.level
    if schedule.objective is not None:
        data["delta_v_unit"] = schedule.objective.unit
        data["library"] = [{"inputs": each.safety.plan.nu, "modes": each.modes} for each in schedule.library]
    return {"choices": data} if data else {}
