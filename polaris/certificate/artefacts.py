"""The other files of the run folder: hashes, and what the readable ones say about the same numbers."""

from __future__ import annotations

import csv
import re
import tomllib
from pathlib import Path
from typing import Any

from .document import Document
from .files import LARGEST_SCENARIO, contents, found, sha256
from .lemma import Stated
from .repeated import check_gains, check_reference, check_schedule
from .scenario_keys import check_keys
from .summarised import check_summary
from .verdict import Record, Rejected

NEEDED = (
    *("scenario.toml", "schedule.json", "schedule.csv", "reference.csv", "gains.json"),
    *("sets.npz", "tubes.npz", "trajectories.npz"),
)
"""Files that belong to a run; the last three are hashed, not read."""

MOST_DOTS = 1000
"""Most dots between two of ``= , { [`` or the end of a line in a scenario; its keys need two."""

SUMMARY = "summary.json"
"""Has wall times, so it has no hash; what it claims is compared."""


def has_artefacts(document: Document, folder: Path) -> bool:
    """Whether any file of a run folder lies beside the certificate, named in it or not."""
    return any(found(folder / name) for name in (*NEEDED, SUMMARY, *document.artefacts))


def check_hashes(document: Document, folder: Path, record: Record) -> None:
    """Compare every file that the certificate names with its hash; it must name all that are needed.

    Raises
    ------
    Rejected
        Naming ``artefacts``.
    """
    for name, known in sorted(document.artefacts.items()):
        if name != Path(name).name or not (folder / name).is_file():
            raise Rejected("artefacts", f"{ascii(name)} is missing")
        there = sha256(folder / name)
        if there != known:
            raise Rejected("artefacts", f"{ascii(name)} has the hash {there}, not {ascii(known)}")
    for name in NEEDED:
        if name not in document.artefacts:
            raise Rejected("artefacts", f"no hash of {name}")
    record.holds("artefacts", f"{len(document.artefacts)} files")


def read_scenario(folder: Path) -> dict[str, Any]:
    """The scenario file, its keys, types and ranges checked.

    Raises
    ------
    Rejected
        Naming ``artefacts`` or ``scenario``.
    """
    data = contents(folder / "scenario.toml", LARGEST_SCENARIO)
    try:
        text = data.decode("utf-8")
        if max(part.count(".") for part in re.split(r"[=,{[\n]", text)) > MOST_DOTS:
            raise ValueError("a key has too many parts")  # reading it takes the square of their number
        scenario = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise Rejected("artefacts", f"scenario.toml cannot be read: {error}") from error
    check_keys(scenario)
    return scenario


def check_artefacts(document: Document, folder: Path, scenario: dict[str, Any], record: Record) -> Stated:
    """Compare the certificate with the files that can be read.

    Returns
    -------
    Stated
        What they claim that the argument has to confirm.

    Raises
    ------
    Rejected
        Naming ``schedule``, ``margins``, ``reference``, ``controllers``, ``system``, ``sampling``,
        ``recoverable_sets``, ``guarantee``, ``end`` or ``summary`` for a file that says something else
        than the certificate, and ``artefacts`` for one that cannot be read.
    """
    start = None
    try:
        claimed = check_schedule(document, scenario, folder)
        check_reference(document, folder / "reference.csv")
        bounds = check_gains(document, scenario, folder / "gains.json")
        record.holds("schedule", "modes, margins, reference and gains are those of the other files")
        if found(folder / SUMMARY):
            summary = check_summary(document, scenario, claimed, folder / SUMMARY)
            start = summary["synthesis"]["start_margin"]
            record.holds("summary", "claims no more than the certificate")
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, csv.Error) as error:
        raise Rejected("artefacts", f"cannot be read: {type(error).__name__}: {error}") from error
    return Stated(start, bounds)


def unchecked(scenario: dict[str, Any], folder: Path) -> list[str]:
    """What a run folder says besides, and no check confirms."""
    specs, told = scenario["experimental"], []
    plans = [spec["name"] for spec in specs if spec.get("reference", {}).get("kind") == "unaware"]
    if plans:
        told.append(
            f"the plans that {', '.join(plans)} follows are the cheapest (start, dynamics, limits, goal hold)"
        )
    if found(folder / SUMMARY):
        told.append("statistics of simulated runs in summary.json, which prove nothing")
    return told
