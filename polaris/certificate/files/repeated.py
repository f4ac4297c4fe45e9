"""Readable files of a run folder, which repeat numbers of the certificate bit for bit."""

import csv
import io
import math
import re
from collections.abc import Iterable
from itertools import zip_longest
from pathlib import Path
from typing import Any

from ..kernel.verdict import Rejected
from ..model.transients import check_attribution
from .document import ROUNDED, Document, canonical
from .file_keys import GAINS, SCHEDULE
from .structure import conform, contents, shown, strict_json

STEP_COLUMNS = (
    *("step", "t_start_s", "t_end_s", "mode", "controller", "margin", "limit", "limit_time_s"),
    *("tightening", "clearance"),
)
"""Header of ``schedule.csv``."""

BEYOND = "limits beyond the settling horizon"  # what limits a step besides unsafe sets and inputs

LAW = "u = mu(t) + gain (xi(t) - x), reference.csv gives xi and mu"  # the law that ``gains.json`` states

MARGIN_ROUNDING = 1e-9  # how far a margin may be off the tightening and the clearance that explain it

_NUMBER = r"-?(?:\d[\d.]*(?:e[+-]?\d+)?|inf|nan)"

REASONS = {
    "infinite": r"the reference ends (?P<how>on a closed orbit|at rest), and all unsafe sets are static",
    "one_period": r"the reference does not end on a natural motion trajectory"
    r"|unsafe sets that move \((?P<moving>.*)\) are covered until (?P<until>\S+) s only"
    r"|one period is shorter than the loop's settling horizon",
    "none": r"not proven after T = (?P<until>\S+) s(?:, though S flies on)?: "
    rf"(?P<limit>.*) at t = {_NUMBER} s: needs {_NUMBER}(?: m| N)?, available {_NUMBER}(?: m| N)?",
}
"""Words for why a claim about the time after T reaches as far as it does."""


def same(claim: str, name: str, value: Any, copy: Any) -> None:
    """Refuse two values that differ, or whose types do; `value` is the certificate's.

    Of tables the keys of `value` are compared, in their order, a key that is missing like None; each under
    its own claim, if `CLAIMS` has one.
    """
    if isinstance(value, dict) and isinstance(copy, dict):
        for key in value:
            key_claim = claim if claim == "summary" else CLAIMS.get(key, claim)
            same(key_claim, f"{name}, {key}", value[key], copy.get(key))
    elif isinstance(value, list) and isinstance(copy, list) and any(isinstance(x, dict) for x in value):
        same(claim, f"number of {name}", len(value), len(copy))
        for i, (item, other) in enumerate(zip(value, copy, strict=True)):
            same(claim, f"{name} {i}", item, other)
    elif value != copy or isinstance(value, bool) != isinstance(copy, bool):
        raise Rejected(claim, f"{name}: {shown(value)} in the certificate, {shown(copy)} in the run folder")


CLAIMS = {
    "margin": "margins",
    **dict.fromkeys(("law", "controller", "controllers"), "controllers"),
    "recoverable": "recoverable_sets",
    **dict.fromkeys(("horizon", "until_s", "reason"), "end"),
    **{name: name for name in ("guarantee", "assumptions", "system")},
    "sampling": "sampling",
}
"""Claims under which fields of the schedule and of the gains are compared, if not under the file's own."""


# -- schedule ---------------------------------------------------------------------------------------


def check_schedule(
    document: Document, scenario: dict[str, Any], folder: Path
) -> tuple[dict[str, Any], list[float]]:
    """Compare ``schedule.json`` and ``schedule.csv``; returns the guarantee as they tell it, and margins."""
    stored = conform(strict_json(contents(folder / "schedule.json")), SCHEDULE, "schedule", "schedule.json")
    K, delta, modes, laws = document.steps, document.delta, document.modes, document.laws
    steps, shares = stored["steps"], {law.name: modes.count(mode) / K for mode, law in enumerate(laws)}
    expected = {
        "modes": modes,
        "step_s": delta,
        "duration_s": K * delta,
        "steps": [
            {
                "step": k,
                "mode": mode,
                "controller": laws[mode].name,
                "t_start_s": k * delta,
                "t_end_s": (k + 1) * delta,
            }
            for k, mode in enumerate(modes)
        ],
        "controllers": [_controller(document, mode) for mode in range(len(laws))],
        "switches": switches(modes),
        "experimental_share": share(modes),
        "share": shares | dict.fromkeys(stored["share"].keys() - shares),
        # The effort of the search is no rule; where the scenario says it, the run says the same.
        "rules": switching_rules(scenario),
        "recoverable": document.recoverable,
        "guarantee": {
            "kind": document.guarantee,
            "horizon": document.horizon,
            "until_s": document.claim_end,
            "assumptions": [*document.assumptions, ARITHMETIC],
            **({"sampled_bound": document.sampled_bound} if document.sampled_bound else {}),
            "goal": stored["guarantee"]["goal"],  # derived in the end, by `Arrival`
            "upkeep": stored["guarantee"]["upkeep"],  # likewise
            **({"estimate": stored["guarantee"].get("estimate")} if document.observer else {}),  # likewise
            "abort": _abort(document, stored["guarantee"].get("abort")),
            "fault_attribution": check_attribution(
                document, stored["guarantee"].get("fault_attribution"), limit_names(document)
            ),
            "powered_abort": _powered(document, stored["guarantee"].get("powered_abort")),
        },
    }
    same("schedule", "schedule.json", expected, stored)
    for k, step in enumerate(steps):
        _check_limit(document, k, step)
    _check_reason(document, stored["guarantee"]["reason"])
    rows = [[row[key] for key in STEP_COLUMNS] for row in steps]
    _same_table("schedule", folder / "schedule.csv", [STEP_COLUMNS, *rows])
    return dict(stored["guarantee"]), [_margin(step) for step in steps]


def _margin(step: dict[str, Any]) -> float:
    """Margin of a step; null stands for minus infinity."""
    return -math.inf if step["margin"] is None else float(step["margin"])


def _abort(document: Document, stored: dict[str, Any] | None) -> dict[str, Any] | None:
    """Return the claims of the drift; the least distance is derived by `Drifts`, a witness is no claim."""
    drift = document.drift
    if drift is None or stored is None:
        return None if drift is None else {}
    spans: list[list[float]] = []
    for k, parts in enumerate(drift.steps):
        if parts is not None and spans and spans[-1][1] == k * document.delta:
            spans[-1][1] = (k + 1) * document.delta
        elif parts is not None:
            spans.append([k * document.delta, (k + 1) * document.delta])
    if (None in drift.steps) == (stored["witness"] is None):
        raise Rejected("passive", "a witness belongs to drifts that are not clear from all steps")
    if (witness := stored["witness"]) is not None:
        step, after, delta = witness["step"], witness["after_s"], document.delta
        last = (math.ceil(drift.horizon / delta * (1 - ROUNDED)) + 1) * delta  # whole steps are followed
        valid = step < document.steps and drift.steps[step] is None and witness["distance_m"] <= 0
        if not (valid and witness["t_s"] == step * document.delta and 0 < after <= last * (1 + ROUNDED)):
            raise Rejected("passive", "the witness must be of a step whose drift is not clear")
        if witness["unsafe_set"] not in {item.name for item in document.unsafe}:
            raise Rejected("passive", f"{shown(witness['unsafe_set'])} of the witness is no unsafe set")
    if (stored["least_m"] is None) == bool(spans and document.unsafe):
        raise Rejected("passive", "least_m must be given exactly where the drift is clear from some step")
    return stored | {"drift_s": drift.horizon, "keep_in": drift.keep_in, "clear_s": spans}


def _powered(document: Document, stored: dict[str, Any] | None) -> dict[str, Any] | None:
    """Return aborts with thrust as the readable files tell them; a reason for having none is no claim."""
    powered = document.powered
    if powered is None or stored is None:
        return None if powered is None else {}
    steps: list[dict[str, Any]] = []
    for k, (way, row) in enumerate(zip(powered.steps, stored["steps"], strict=True)):
        values = dict.fromkeys(("leaves_s", "by_s", "delta_v_m_s", "safe_until_s"))
        if (way is None) == (row["why"] is None):
            raise Rejected("powered_abort", f"step {k} must have a reason exactly if it has no abort")
        if way is not None:
            branch, by, delta_v = powered.branches[way.branch], way.cell * document.delta, row["delta_v_m_s"]
            if delta_v is None or (powered.budget is not None and not delta_v <= powered.budget):
                raise Rejected(
                    "powered_abort",
                    f"the abort in step {k} takes {delta_v} m/s, the budget is {powered.budget} m/s",
                )
            values = {"leaves_s": branch.step * document.delta, "by_s": by, "delta_v_m_s": delta_v}
            values["safe_until_s"] = branch.claim_end(document.delta)
        steps.append({"step": k, **values, "why": row["why"]})
    return {"within_s": powered.within, "delta_v_max_m_s": powered.budget, "steps": steps}


KINDS = {"any_thrust": "AnyThrust", "neural": "NeuralController", "black_box": "BlackBox"}
"""Kinds of controllers as the readable files call them, those with a gain apart."""


def _controller(document: Document, mode: int) -> dict[str, Any]:
    law = document.laws[mode]
    return {"mode": mode, "name": law.name, "kind": KINDS.get(law.kind, "AffineController")}


def share(modes: list[int]) -> float:
    """Share of steps under experimental controllers."""
    return sum(mode > 0 for mode in modes) / len(modes)


def _check_limit(document: Document, k: int, step: dict[str, Any]) -> None:
    """Check that a step's limit is one of the scene, in time, and that its numbers give its margin."""
    if step["limit"] not in limit_names(document):
        raise Rejected("schedule", f"step {k} is limited by {shown(step['limit'])}, which does not exist")
    time, last = step["limit_time_s"], document.cells * document.delta
    if time is not None and not 0 <= time <= last * (1 + 1e-9):
        raise Rejected("schedule", f"step {k} is limited at {time} s, beyond 0 to {last} s")
    tightening, clearance, margin = step["tightening"], step["clearance"], _margin(step)
    if margin != -math.inf and None in (time, tightening, clearance):
        raise Rejected(
            "margins", f"step {k} has margin {margin}, but no time, tightening and clearance of a limit"
        )
    if time is not None and time < k * document.delta * (1 - 1e-9):
        raise Rejected("schedule", f"step {k} is limited at {time} s, before it begins")
    if tightening is not None and clearance is not None:
        left = 1 - tightening / clearance if clearance > 0 else -math.inf
        if left != margin and not abs(left - margin) <= MARGIN_ROUNDING * (1 + min(abs(left), abs(margin))):
            raise Rejected(
                "margins", f"step {k} needs {tightening} of {clearance}, which leaves {left}, not {margin}"
            )


def limit_names(document: Document) -> set[str]:
    """Return the names of all that can limit a flight under S."""
    return {item.name for item in document.unsafe} | {*document.input_names, BEYOND}


def _check_reason(document: Document, reason: str) -> None:
    """Check that the words for how far the claim reaches fit the claim, the system and the scene."""
    words = re.fullmatch(REASONS[document.horizon], reason)
    if words is None:
        raise Rejected("end", f"{shown(reason)} is no reason for the claim {document.horizon}")
    expected = {
        "until": f"{document.claim_end:g}" if document.claim_end is not None else "",
        "how": "at rest" if document.mean_motion is None else "on a closed orbit",
        "moving": ", ".join(item.name for item in document.unsafe if document.moves(item)),
    }
    for name, value in words.groupdict().items():
        if name == "limit" and value is not None and value not in limit_names(document):
            raise Rejected("end", f"{shown(value)} in the reason is no limit")
        if name != "limit" and value is not None:
            same("end", f"{name} in the reason", expected[name], value)


ARITHMETIC = "arithmetic: double precision, its round-off covered by rounding allowances"
"""What the synthesis assumes besides, and the checker does not."""


# -- switching ---------------------------------------------------------------------------------------


def switching_rules(scenario: dict[str, Any]) -> dict[str, Any]:
    """Return the rules as ``schedule.json`` repeats them; the effort of the search as the scenario has it."""
    spec = scenario.get("schedule", {})
    return {
        "strategy": spec.get("strategy", "greedy"),
        "min_dwell": spec.get("min_dwell_steps", 1),
        "max_switches": spec.get("max_switches"),
        "delta_v_price": spec.get("delta_v_price", 0.06),
        "switch_price": spec.get("switch_price", 0.005),
        "delta_v_max": spec.get("delta_v_max_m_s"),
        "weights": [item.get("weight", 1.0) for item in scenario["experimental"]],
        **{key: spec[key] for key in ("beam",) if key in spec},
    }


def switches(modes: list[int]) -> int:
    """Number of changes of mode."""
    return sum(a != b for a, b in zip(modes[:-1], modes[1:], strict=True))


# -- reference --------------------------------------------------------------------------------------


def check_reference(document: Document, path: Path) -> None:
    """Compare ``reference.csv``: header, times, states and inputs."""
    n, m = len(document.A), len(document.u_max)
    if document.system_kind == "clohessy_wiltshire":
        states = ["r_x_m", "r_y_m", "r_z_m", "v_x_m_s", "v_y_m_s", "v_z_m_s"]
        inputs = ["u_x_N", "u_y_N", "u_z_N"]
    else:
        states, inputs = [f"x{i}" for i in range(n)], [f"u{i}" for i in range(m)]
    input_rows: list[list[Any]] = [*document.inputs, [None] * m]
    nodes = enumerate(zip(document.states, input_rows, strict=True))
    rows = [[k * document.delta, *state, *u] for k, (state, u) in nodes]
    _same_table("reference", path, [["t_s", *states, *inputs], *rows])


def _same_table(claim: str, path: Path, rows: list[Iterable[Any]]) -> None:
    """Check that a CSV file has exactly these rows, numbers in the shortest form that reads back exactly."""
    text = io.StringIO(newline="")
    csv.writer(text, lineterminator="\n").writerows(rows)
    lines, stored = text.getvalue().encode().split(b"\n"), contents(path).split(b"\n")
    for i, (line, stored_line) in enumerate(zip_longest(lines, stored), 1):
        same(claim, f"{path.name}, line {i}", line, stored_line)


# -- gains ------------------------------------------------------------------------------------------


def check_gains(document: Document, path: Path) -> None:
    """Compare ``gains.json``."""
    stored = conform(strict_json(contents(path)), GAINS, "controllers", "gains.json")
    same("controllers", "gains.json", {"law": LAW, **document.repeated}, stored)
    for key, value in document.repeated.items():
        if canonical(value) != canonical(stored[key]):
            raise Rejected(CLAIMS[key], f"gains.json, {key}: differs from the certificate")
