"""The readable files of a run folder, tables (CSV) and strict JSON; a run's further claims, in words."""

import csv
import io
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from ...certificate.files.file_keys import RUN_VERSION
from ...model.craft import Craft
from ...model.errors import escape_controls
from ...model.files import read_text
from ...model.system import LinearSystem
from ...model.timing import Timing
from ...planning.reference import Reference
from ...simulation.metrics import finite
from ...synthesis.safety.recoverable import directed, quantity
from ...synthesis.schedule.schedule import Schedule
from ...synthesis.schedule.synthesize import in_words


def strict(value: Any, number: Callable[[float], Any] = finite) -> Any:
    """Return data for strict JSON: numpy turned plain, floats as `number` says, infinities and NaN null."""
    if isinstance(value, Mapping):
        return {str(key): strict(item, number) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return strict(value.tolist(), number)
    if isinstance(value, list | tuple):
        return [strict(item, number) for item in value]
    return number(value) if isinstance(value, float) else value


def json_text(data: Any) -> str:
    """Strict JSON, readable, the same bytes for the same data, control characters escaped."""
    return escape_controls(json.dumps(strict(data), indent=2, allow_nan=False, ensure_ascii=False)) + "\n"


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 with the same line ends everywhere."""
    path.write_text(text, encoding="utf-8", newline="\n")


def write_csv(path: Path, rows: Sequence[Mapping[str, Any]], header: Sequence[str] = ()) -> None:
    """Write rows by column (the first row's by default), exact numbers, those not finite empty."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, header or list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(map(strict, rows))


def controllers(summary: Mapping[str, Any]) -> dict[str, str]:
    """Return who flew, by key, as people call them; experimental controllers by name if there are several."""
    keys = [key for key in summary if key.startswith("experimental")]
    labels = (f" ({summary[key]['controller']})" if len(keys) > 1 else "" for key in keys)
    titles = {"safety": "S alone", **{key: f"U alone{name}" for key, name in zip(keys, labels, strict=True)}}
    return {key: title for key, title in {**titles, "polaris": "Polaris"}.items() if key in summary}


def write_schedule(folder: Path, schedule: Schedule, rules: Mapping[str, Any], guarantee: Any) -> None:
    """Write ``schedule.csv`` and ``schedule.json``."""
    rows = [
        {
            "step": k,
            "t_start_s": schedule.times[k],
            "t_end_s": schedule.times[k + 1],
            "mode": step.mode,
            "controller": schedule.controllers[step.mode].name,
            "margin": step.margin.value,
            "limit": step.margin.limit,
            "limit_time_s": step.margin.time,
            "tightening": step.margin.tightening,
            "clearance": step.margin.clearance,
        }
        for k, step in enumerate(schedule.steps)
    ]
    write_csv(folder / "schedule.csv", rows)
    controllers: list[dict[str, Any]] = [
        {"mode": mode, "name": controller.name, "kind": type(controller).__name__}
        for mode, controller in enumerate(schedule.controllers)
    ]
    data = {
        "schema_version": RUN_VERSION,
        "step_s": schedule.safety.problem.delta,
        "duration_s": schedule.times[-1],
        "controllers": controllers,
        "rules": rules,
        "modes": schedule.modes,
        "switches": schedule.switches,
        "experimental_share": schedule.share(),
        "share": {row["name"]: schedule.share(row["mode"]) for row in controllers},
        "recoverable": schedule.safety.recoverable.kind,
        "guarantee": guarantee,
        "steps": rows,
    }
    write_text(folder / "schedule.json", json_text(data))


def columns(system: LinearSystem) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Column names of the states and the inputs, with units where they are known."""
    if system.mean_motion is not None and system.n == 6 and system.m == 3:
        states = tuple(f"{name}_{'m' if name[0] == 'r' else 'm_s'}" for name in system.state_names)
        return states, ("u_x_N", "u_y_N", "u_z_N")
    return system.state_names, tuple(f"u{i}" for i in range(system.m))


def write_reference(path: Path, reference: Reference) -> None:
    """Write state at every waypoint and the input held from there on (none at the last)."""
    states, inputs = columns(reference.system)
    rows = [
        {"t_s": k * reference.delta, **dict(zip(states, chi, strict=True))}
        for k, chi in enumerate(reference.chi.tolist())
    ]
    for row, nu in zip(rows, reference.nu.tolist(), strict=False):
        row |= zip(inputs, nu, strict=True)
    write_csv(path, rows)


def read_reference(path: Path, system: LinearSystem, delta: float) -> Reference:
    """Read the file of `write_reference`, bit for bit."""
    rows = list(csv.reader(io.StringIO(read_text(path), newline="")))[1:]
    if len(rows) < 2:
        raise ValueError("too few rows")
    chi = np.array([[float(item) for item in row[1 : 1 + system.n]] for row in rows])
    nu = np.array([[float(item) for item in row[1 + system.n :]] for row in rows[:-1]])
    if chi.shape != (len(rows), system.n) or nu.shape != (len(rows) - 1, system.m):
        raise ValueError("wrong number of columns")
    return Reference(system, delta, chi, nu)


def errors_of(system: Craft) -> dict[str, Any]:
    """Errors of estimates, thrusters and timing, if any."""
    timing = asdict(system.timing)
    extras = "pulse_thrust", "pulse_place", "intersample_offset", "carried_impulse", "edge", "fine"  # if any
    omitted = "period", "by_lag", "lead"  # nothing is derived from them
    timing = {key: x for key, x in timing.items() if key not in omitted and (x or key not in extras)}
    timing = {"bit" if k == "on_time" else k: x["bit"] if k == "on_time" else x for k, x in timing.items()}
    observer = {} if system.observer is None else asdict(system.observer)
    hidden = {"fading", "horizon"} | ({"ages", "by_age"} if observer.get("by_age") is None else set())
    hidden |= set() if observer.get("after") else {"after"}
    hidden |= set() if observer.get("followed") else {"followed"}
    observer = {key: x for key, x in observer.items() if x is not None and key not in hidden}
    thrusters, layout = asdict(system.on_time) | {"bit": system.thrusters.bit}, system.nozzles
    del thrusters["shares"]
    if not thrusters["constant"]:
        del thrusters["constant"]
    if layout is not None:  # of each thruster: what it makes wrong of the inputs is derived
        thrusters |= {"along": layout.along, "across": layout.across, "mass": layout.mass}
    return {
        **({"estimate_error": system.navigation} if np.any(system.navigation) else {}),
        **({} if system.thrusters.exact else {"thrusters": thrusters}),
        **({} if system.timing == Timing() else {"timing": timing}),
        **({} if system.error_by_step is None else {"error_by_step": system.error_by_step}),
        **({"observer": observer} if observer else {}),
    }


def besides(claim: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return a heading and a sentence for everything that a guarantee claims besides."""
    rows = [("Upkeep", _upkeep(claim["upkeep"]))] if claim.get("upkeep") else []
    rows += [("Estimate", _estimate(claim["estimate"]))] if claim.get("estimate") else []
    rows += [("Passive safety", drift_text(claim["abort"]))] if "abort" in claim else []
    powered = claim.get("powered_abort")
    rows += [("Powered abort", abort_text(powered))] if powered else []
    return rows + [("Isolated late", _attributed(fault)) for fault in claim.get("fault_attribution", [])]


def _attributed(claim: Mapping[str, Any]) -> str:
    """Describe the steps that S flies because of a fault, and the bound that is short."""
    fault, steps = f"{claim['fault']} ({claim['lasts_s']:.6g} s)", claim["steps"]
    if not steps:
        return f"fault {fault} reserves no step for S along this reference."
    worst = max(steps, key=lambda step: step["shortfall"] / max(abs(step["clearance"]), 1e-300))
    deficit, instant = quantity(worst["limit"], worst["shortfall"]), f"t = {worst['limit_time_s']:.6g} s"
    return (
        f"fault {fault} reserves {len(steps)} steps for S ({', '.join(str(x['step']) for x in steps)}):"
        f" {worst['controller']} in step {worst['step']} would leave {worst['limit']} {deficit} short in step"
        f" {worst['limit_step']} ({instant})."
    )


def abort_text(claim: Mapping[str, Any]) -> str:
    """Describe from which steps S reaches the orbit of an abort, and why not from the first of the others."""
    steps = claim["steps"]
    reached, failed = ([each for each in steps if (each["why"] is None) == flag] for flag in (True, False))
    text = f"from {len(reached)} of {len(steps)} steps S provably reaches the orbit, aborting at any instant"
    if reached:
        delta_v = directed(max(each["delta_v_m_s"] for each in reached), ".4g", up=True)
        text += f", with a delta-v of at most {delta_v} m/s"
    return f"{text}. Step {failed[0]['step']} fails: {failed[0]['why']}." if failed else f"{text}."


def _upkeep(claim: Mapping[str, Any]) -> str:
    """Describe the cost of flying on after T, and how long the tank lasts."""
    orbit, tank, lifetime = claim["per_orbit_m_s"], claim["tank_m_s"], claim["lasts_s"]
    rate = f"{directed(claim['rate_m_s2'], '.4g', up=True)} m/s per second" if orbit is None else ""
    cost = rate or f"{directed(orbit, '.4g', up=True)} m/s per orbit"
    text = f"S uses a delta-v of at most {cost} from {claim['settled_s']:.6g} s on"
    if tank is None:
        return f"{text}."
    if lifetime is None:
        return f"{text}; the propellant for {tank:g} m/s lasts for ever."
    return f"{text}; the propellant for {tank:g} m/s lasts until {directed(lifetime, '.6g')} s."


def _estimate(claim: Mapping[str, Any]) -> str:
    """Describe how far an observer's estimates may be off."""
    phases = {"settled": "once S has settled", "experimental": "while an experimental controller flies"}
    texts = (
        f"at most {', '.join(directed(x, '.3g', up=True) for x in claim[key])} {phase}"
        for key, phase in phases.items()
        if claim[key] is not None
    )
    return f"errors by state, in state order and SI units: {'; '.join(texts) or 'not bounded'}."


def drift_text(claim: Mapping[str, Any]) -> str:
    """Describe from when to when all thrust may stop, and where the drift is not shown to stay clear."""
    spans = ", ".join(f"{a:.6g} to {b:.6g} s" for a, b in claim["clear_s"])
    margin = "" if claim["least_m"] is None else f", by at least {directed(claim['least_m'], '.4g')} m"
    stays = f"the free drift stays clear for {claim['drift_s']:.6g} s{margin}"
    text = f"if all thrust stops at any time in {spans}, {stays}" if spans else f"in no step {stays}"
    if claim["witness"] is None:
        return f"{text}; this covers the whole flight."
    return f"{text}. Witness: {in_words(claim['witness'])}."
