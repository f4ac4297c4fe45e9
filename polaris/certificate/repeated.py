"""What the readable files of a run folder repeat of the certificate: the same numbers, bit for bit."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterable
from itertools import groupby
from pathlib import Path
from typing import Any

from .document import Document
from .file_keys import GAINS, SCHEDULE
from .files import contents
from .structure import conform, shown, strict_json
from .verdict import Rejected

STEP_COLUMNS = (
    *("step", "t_start_s", "t_end_s", "mode", "controller", "margin", "limit", "limit_time_s"),
    *("need", "room"),
)
"""Header of ``schedule.csv``."""

BEYOND = "limits beyond the loop's memory"
"""What limits a step besides unsafe sets and inputs."""

LAW = "u = mu(t) + gain (xi(t) - x), reference.csv gives xi and mu"
"""The law that ``gains.json`` states."""

MARGIN_ROUNDING = 1e-9
"""How far a margin may be off the need and the room that explain it."""

_NUMBER = r"-?(?:\d[\d.]*(?:e[+-]?\d+)?|inf|nan)"

REASONS = {
    "infinite": r"the reference ends (?P<how>on a closed orbit|at rest), and all unsafe sets are static",
    "one_period": r"the reference does not end on a natural motion trajectory"
    r"|unsafe sets that move \((?P<moving>.*)\) are covered until (?P<until>\S+) s only"
    r"|the period is shorter than the memory of the loop",
    "none": r"not proven after T = (?P<until>\S+) s: "
    rf"(?P<limit>.*) at t = {_NUMBER} s: needs {_NUMBER} of {_NUMBER}",
}
"""Words for why a claim about the time after T reaches as far as it does."""


def same(claim: str, what: str, found: Any, given: Any) -> None:
    """Refuse two values that differ, or whose types do; `found` is the certificate's.

    Raises
    ------
    Rejected
    """
    if isinstance(found, dict) and isinstance(given, dict) and found.keys() == given.keys():
        for key in found:
            same(claim, f"{what}, {key}", found[key], given[key])
    elif found != given or isinstance(found, bool) != isinstance(given, bool):
        raise Rejected(claim, f"{what}: {shown(found)} in the certificate, {shown(given)} in the run folder")


# -- schedule ---------------------------------------------------------------------------------------


def check_schedule(document: Document, scenario: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Compare ``schedule.json`` and ``schedule.csv``; returns the guarantee as they repeat it.

    Raises
    ------
    Rejected
    """
    stored = strict_json(contents(folder / "schedule.json"))
    conform(stored, SCHEDULE, "schedule", "schedule.json")
    K, modes, laws = document.steps, document.modes, document.laws
    same("schedule", "modes", modes, stored["modes"])
    same("schedule", "step [s]", document.delta, stored["step_s"])
    same("schedule", "duration [s]", K * document.delta, stored["duration_s"])
    same("schedule", "number of steps", K, len(stored["steps"]))
    for k, step in enumerate(stored["steps"]):
        _check_step(document, k, step)
    controllers = [_heading(document, mode) for mode in range(len(laws))]
    same("controllers", "controllers", controllers, stored["controllers"])
    same("schedule", "switches", switches(modes), stored["switches"])
    same("schedule", "experimental share", share(modes), stored["experimental_share"])
    shares = {law.name: modes.count(mode) / K for mode, law in enumerate(laws)}
    same("schedule", "share", shares, stored["share"])
    rules = switching_rules(scenario)
    # The effort of the search is no rule; where the scenario says it, the run says the same.
    same("schedule", "rules", rules, {key: stored["rules"][key] for key in rules})
    same("recoverable_sets", "kind of recoverable set", document.recoverable, stored["recoverable"])
    claimed: dict[str, Any] = stored["guarantee"]
    _check_claim(document, claimed)
    rows = [[row[key] for key in STEP_COLUMNS] for row in stored["steps"]]
    _same_table("schedule", folder / "schedule.csv", [STEP_COLUMNS, *rows])
    return claimed


def _heading(document: Document, mode: int) -> dict[str, Any]:
    law = document.laws[mode]
    return {"mode": mode, "name": law.name, "kind": "AnyThrust" if law.gain is None else "AffineController"}


def share(modes: list[int]) -> float:
    """Share of steps under experimental controllers."""
    return sum(mode > 0 for mode in modes) / len(modes)


def _check_step(document: Document, k: int, step: dict[str, Any]) -> None:
    margin = -math.inf if step["margin"] is None else step["margin"]
    same("margins", f"margin of step {k}", document.margins[k], margin)
    same("schedule", "number of a step", k, step["step"])
    same("schedule", f"mode of step {k}", document.modes[k], step["mode"])
    same("controllers", f"controller of step {k}", document.laws[document.modes[k]].name, step["controller"])
    same("schedule", f"start of step {k} [s]", k * document.delta, step["t_start_s"])
    same("schedule", f"end of step {k} [s]", (k + 1) * document.delta, step["t_end_s"])
    if step["limit"] not in limit_names(document):
        raise Rejected("schedule", f"step {k} is limited by {shown(step['limit'])}, which there is not")
    when, last = step["limit_time_s"], document.cells * document.delta
    if when is not None and not 0 <= when <= last * (1 + 1e-9):
        raise Rejected("schedule", f"step {k} is limited at {when} s, of {last} s")
    need, room = step["need"], step["room"]
    if need is not None and room is not None:
        left = 1 - need / room if room > 0 else -math.inf
        if left != margin and not abs(left - margin) <= MARGIN_ROUNDING * (1 + abs(left)):
            raise Rejected("margins", f"step {k} needs {need} of {room}, which leaves {left}, not {margin}")


def limit_names(document: Document) -> set[str]:
    """What a flight under S can be limited by."""
    return {item.name for item in document.unsafe} | {*document.input_names, BEYOND}


def _check_claim(document: Document, claimed: dict[str, Any]) -> None:
    """The guarantee is the certificate's, in numbers and in words."""
    same("guarantee", "kind", document.guarantee, claimed["kind"])
    same("end", "horizon", document.horizon, claimed["horizon"])
    same("end", "until [s]", document.until, claimed["until_s"])
    same("end", "reason", document.reason, claimed["reason"])
    same("assumptions", "assumptions", [*document.assumptions, ARITHMETIC], claimed["assumptions"])
    words = re.fullmatch(REASONS[document.horizon], document.reason)
    if words is None:
        told = f"{shown(document.reason)} is no reason for the claim {document.horizon}"
        raise Rejected("end", told)
    found = words.groupdict()
    if found.get("until") is not None:
        same("end", "time in the reason", f"{document.until:g}", found["until"])
    if found.get("how") is not None:
        how = "at rest" if document.mean_motion is None else "on a closed orbit"
        same("end", "how the reference ends", how, found["how"])
    if found.get("limit") is not None and found["limit"] not in limit_names(document):
        raise Rejected("end", f"{shown(found['limit'])} in the reason is no limit")
    if found.get("moving") is not None:
        moving = ", ".join(item.name for item in document.unsafe if not item.resting)
        same("end", "moving sets in the reason", moving, found["moving"])


ARITHMETIC = "arithmetic: in double precision, its round-off covered by booked tolerances"
"""What the synthesis assumes besides, and the checker does not."""


# -- switching ---------------------------------------------------------------------------------------


def switching_rules(scenario: dict[str, Any]) -> dict[str, Any]:
    """The rules as ``schedule.json`` repeats them; of the effort of the search, what the scenario gives."""
    spec = scenario.get("schedule", {})
    rules = {
        "strategy": spec.get("strategy", "greedy"),
        "min_dwell": spec.get("min_dwell_steps", 1),
        "max_switches": spec.get("max_switches"),
        "weights": [float(item.get("weight", 1.0)) for item in scenario["experimental"]],
    }
    return rules | {key: spec[key] for key in ("beam",) if key in spec}


def switches(modes: list[int]) -> int:
    """Number of changes of mode."""
    return sum(a != b for a, b in zip(modes[:-1], modes[1:], strict=True))


def check_switching(document: Document, scenario: dict[str, Any]) -> str:
    """Whoever takes over keeps control for the dwell, or to T; there are no more switches than the cap.

    Raises
    ------
    Rejected
        Naming the claim ``schedule``.
    """
    rules = switching_rules(scenario)
    held = [len(list(group)) for _, group in groupby(document.modes)]
    for i, steps in enumerate(held[:-1]):
        if steps < rules["min_dwell"]:
            at = sum(held[:i])
            told = f"mode {document.modes[at]} is left {steps} steps after step {at}"
            raise Rejected("schedule", f"{told}; the scenario's dwell is {rules['min_dwell']} steps")
    count, cap = switches(document.modes), rules["max_switches"]
    if cap is not None and count > cap:
        raise Rejected("schedule", f"{count} switches, the scenario allows {cap}")
    return f"{count} switches, dwell and cap of the scenario kept"


# -- reference --------------------------------------------------------------------------------------


def check_reference(document: Document, path: Path) -> None:
    """Compare ``reference.csv``: header, times, states and inputs.

    Raises
    ------
    Rejected
    """
    n, m = len(document.A), len(document.u_max)
    if document.system_kind == "clohessy_wiltshire":
        states = ["r_x_m", "r_y_m", "r_z_m", "v_x_m_s", "v_y_m_s", "v_z_m_s"]
        inputs = ["u_x_N", "u_y_N", "u_z_N"]
    else:
        states, inputs = [f"x{i}" for i in range(n)], [f"u{i}" for i in range(m)]
    held: list[list[Any]] = [*document.inputs, [None] * m]
    rows = [
        [k * document.delta, *state, *u]
        for k, (state, u) in enumerate(zip(document.states, held, strict=True))
    ]
    _same_table("reference", path, [["t_s", *states, *inputs], *rows])


def _same_table(claim: str, path: Path, rows: list[Iterable[Any]]) -> None:
    """A CSV file has exactly these rows, numbers in the shortest form that reads back exactly."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerows([["" if item is None else item for item in row] for row in rows])
    expected = text.getvalue().encode()
    found = contents(path)
    if found == expected:
        return
    lines, given = expected.split(b"\n"), found.split(b"\n")
    for i, line in enumerate(lines):
        if i >= len(given) or given[i] != line:
            there = given[i] if i < len(given) else b""
            told = f"{path.name}, line {i + 1}: {shown(line.decode())} in the certificate"
            raise Rejected(claim, f"{told}, {shown(there.decode(errors='replace'))} in the run folder")
    raise Rejected(claim, f"{path.name} goes on after {len(lines) - 1} lines")


# -- gains ------------------------------------------------------------------------------------------


def check_gains(document: Document, scenario: dict[str, Any], path: Path) -> dict[str, Any]:
    """Compare ``gains.json``: the law, the system, the feedback and every controller.

    Returns
    -------
    dict
        The bounds of Lemma 1, their norm and method compared.

    Raises
    ------
    Rejected
    """
    stored = strict_json(contents(path))
    conform(stored, GAINS, "controllers", "gains.json")
    same("controllers", "law", LAW, stored["law"])
    system = {
        "A": document.A,
        "B": document.B,
        "C": document.C,
        "D": document.D,
        "input_max": document.u_max,
        "disturbance_max": document.w_max,
        "mass_kg": document.mass,
    }
    same("system", "system", system, stored["system"])
    feedback = {
        "sampled": document.sampled,
        "node_spacing_s": document.delta / document.q,
        "nodes_per_step": document.q,
    }
    same("sampling", "feedback", feedback, stored["feedback"])
    same("controllers", "number of controllers", len(document.laws), len(stored["controllers"]))
    for mode, (law, given) in enumerate(zip(document.laws, stored["controllers"], strict=True)):
        expected = _heading(document, mode)
        if law.gain is not None:
            expected |= {"gain": law.gain, "clips": law.kind == "saturated_affine"}
        if law.states is not None:
            expected |= {"own_states": law.states, "own_inputs": law.inputs}
        same("controllers", f"controller {mode}", expected, given)
    bounds: dict[str, Any] = stored["error_bounds"]
    _check_bounds(document, scenario, bounds)
    return bounds


def _check_bounds(document: Document, scenario: dict[str, Any], bounds: dict[str, Any]) -> None:
    """The norm and the method of Lemma 1 are those that were asked for."""
    spec, n = scenario["tracking"], len(document.A)
    same("error_bounds", "method", spec.get("bound", "envelope"), bounds["method"])
    weight = spec.get("weight", "auto")
    expected = document.weight
    if weight != "auto":
        along = [1.0] * n if weight == "identity" else weight
        expected = [[float(along[i]) if i == j else 0.0 for j in range(n)] for i in range(n)]
    same("error_bounds", "weight of the norm", expected, bounds["weight"])
