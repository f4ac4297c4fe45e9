"""The other files of the run folder: hashes, and what the readable ones say about the same numbers."""

from __future__ import annotations

import csv
import hashlib
import json
from pathlib import Path
from typing import Any

from .document import Document
from .verdict import Record, Rejected

NEEDED = ("scenario.toml", "schedule.json", "reference.csv", "gains.json")
"""Files that a certificate is compared with."""


def has_artefacts(document: Document, folder: Path) -> bool:
    """Whether any file of a run folder lies beside the certificate, named in it or not."""
    return any((folder / name).is_file() for name in (*NEEDED, *document.artefacts))


def check_artefacts(document: Document, folder: Path, record: Record) -> None:
    """Compare every file with its hash, then the certificate with the files that can be read.

    Raises
    ------
    Rejected
        Naming ``artefacts`` for a file that is missing or changed, and ``schedule``, ``reference``,
        ``controllers`` or ``system`` for a certificate that says something else than the files.
    """
    for name, known in sorted(document.artefacts.items()):
        if name != Path(name).name or not (folder / name).is_file():
            raise Rejected("artefacts", f"{name} is missing")
        found = hashlib.sha256((folder / name).read_bytes()).hexdigest()
        if found != known:
            raise Rejected("artefacts", f"{name} has the hash {found}, not {known}")
    for name in NEEDED:
        if name not in document.artefacts:
            raise Rejected("artefacts", f"no hash of {name}")
    record.holds("artefacts", f"{len(document.artefacts)} files")
    try:
        _check_schedule(document, json.loads((folder / "schedule.json").read_text(encoding="utf-8")))
        _check_reference(document, folder / "reference.csv")
        _check_gains(document, json.loads((folder / "gains.json").read_text(encoding="utf-8")))
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, csv.Error) as error:
        raise Rejected("artefacts", f"cannot be read: {type(error).__name__}: {error}") from error
    record.holds("schedule", "modes, margins, reference and gains are those of the other files")


def _same(claim: str, what: str, found: Any, given: Any) -> None:
    if found != given:
        raise Rejected(
            claim, f"{what}: {_short(found)} in the certificate, {_short(given)} in the run folder"
        )


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) <= 80 else f"{text[:77]}..."


def _check_schedule(document: Document, stored: dict[str, Any]) -> None:
    _same("schedule", "modes", document.modes, stored["modes"])
    _same("schedule", "step [s]", document.delta, stored["step_s"])
    for k, (margin, step) in enumerate(zip(document.margins, stored["steps"], strict=True)):
        given = float("-inf") if step["margin"] is None else step["margin"]
        _same("margins", f"margin of step {k}", margin, given)
        _same("schedule", f"mode of step {k}", document.modes[k], step["mode"])
        _same(
            "controllers",
            f"controller of step {k}",
            document.laws[document.modes[k]].name,
            step["controller"],
        )
        for key, at in (("t_start_s", k), ("t_end_s", k + 1)):
            if not abs(step[key] - at * document.delta) <= 1e-9 * at * document.delta:
                raise Rejected("schedule", f"{key} of step {k} is {step[key]} in the run folder")
    _same("recoverable_sets", "kind of recoverable set", document.recoverable, stored["recoverable"])
    for key, value in (
        ("kind", document.guarantee),
        ("horizon", document.horizon),
        ("until_s", document.until),
    ):
        _same("guarantee" if key == "kind" else "end", key, value, stored["guarantee"][key])


def _check_reference(document: Document, path: Path) -> None:
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))[1:]
    n = len(document.A)
    for k, (row, state) in enumerate(zip(rows, document.states, strict=True)):
        if not abs(float(row[0]) - k * document.delta) <= 1e-9 * k * document.delta:
            raise Rejected("reference", f"step {k} starts at {row[0]} s in reference.csv")
        _same("reference", f"state at the start of step {k}", state, [float(x) for x in row[1 : 1 + n]])
    for k, (row, u) in enumerate(zip(rows, document.inputs, strict=False)):
        _same("reference", f"input in step {k}", u, [float(x) for x in row[1 + n :]])


def _check_gains(document: Document, stored: dict[str, Any]) -> None:
    system = stored["system"]
    for key, value in (
        ("A", document.A),
        ("B", document.B),
        ("C", document.C),
        ("D", document.D),
        ("input_max", document.u_max),
        ("disturbance_max", document.w_max),
        ("mass_kg", document.mass),
    ):
        _same("system", key, value, system[key])
    feedback = stored["feedback"]
    _same("sampling", "sampled", document.sampled, feedback["sampled"])
    _same("sampling", "nodes per step", document.q, feedback["nodes_per_step"])
    for mode, (law, given) in enumerate(zip(document.laws, stored["controllers"], strict=True)):
        _same("controllers", f"name of mode {mode}", law.name, given["name"])
        _same("controllers", f"gain of {law.name}", law.gain, given.get("gain"))
        _same(
            "controllers",
            f"clipping of {law.name}",
            law.kind == "saturated_affine",
            given.get("clips", False),
        )
        _same("controllers", f"reference of {law.name}", law.states, given.get("own_states"))
        _same("controllers", f"inputs of {law.name}", law.inputs, given.get("own_inputs"))
