"""Check one certificate: the file, its sources, and the safety argument."""

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import flint

from .claims.argument import Argument
from .claims.joint import Joint
from .code.check import check_code, precisions
from .files.artefacts import (
    check_artefacts,
    check_hashes,
    check_networks,
    has_artefacts,
    read_scenario,
    unchecked,
)
from .files.demands import unchecked_demands
from .files.document import Document, untrusted
from .files.inputs import check_inputs
from .kernel.balls import PRECISION
from .kernel.verdict import (
    LONGEST,
    STATISTICAL,
    UNKNOWN,
    VERIFIED,
    Failed,
    Imprecise,
    Record,
    Rejected,
    Verdict,
)
from .mission import FORMAT as MISSION
from .mission import check_mission
from .model.plants import MOST_BITS, precision_for

NAME = "certificate.json"  # the certificate's name in a run folder

FAILURES = (
    *(ArithmeticError, ValueError, TypeError, LookupError, AttributeError),
    *(AssertionError, MemoryError, RecursionError),
)
"""What numbers that no run has may raise deep in a check; the claim is then not decided."""


def verify(path: str | Path, code: str | Path | None = None) -> Verdict:
    """Check the certificate of a run folder, or a certificate file, and flight code that was made of it.

    Parameters
    ----------
    path : path
        If other files of the run folder lie beside the certificate, it is compared with them too.
    code : path, optional
        Folder of the flight code: S may then take over at every node of an experimental step.

    Raises
    ------
    OSError
        If the file cannot be read.
    """
    source = Path(path)
    is_folder = source.is_dir()
    file = source / NAME if is_folder else source
    code_folder = None if code is None else Path(code)

    def check(record: Record) -> list[str]:
        data = untrusted(file)
        if data.get("format") == MISSION:
            if code_folder is not None:
                raise Rejected("code", "must be checked with the run folder of its leg")
            return check_mission(data, file.parent, record, _check_leg)
        return _check(Document(data), file.parent, record, is_folder, code=code_folder)

    return _judge(check)


def verify_document(data: dict[str, object], folder: Path | None = None) -> Verdict:
    """Check a certificate already read from JSON; without a folder it is compared with no other file."""
    return _judge(lambda record: _check(Document(data), folder, record))


def _judge(check: Callable[[Record], list[str]]) -> Verdict:
    """Run a check and turn how it ends into a verdict."""
    start, precision, record = time.perf_counter(), flint.ctx.prec, Record()
    flint.ctx.prec = PRECISION
    outcome, claim, witness, excess, trusted = VERIFIED, "", "", None, []
    try:
        trusted = check(record)
        outcome = STATISTICAL if record.sampled else VERIFIED
    except Failed as error:
        outcome, claim, witness, excess = error.outcome, error.claim, error.witness, error.excess
    except FAILURES as error:
        outcome, claim, witness = UNKNOWN, "arithmetic", f"{type(error).__name__}: {error}"[:LONGEST]
    finally:
        flint.ctx.prec = precision
    seconds = time.perf_counter() - start
    parts = tuple(record.checked), tuple(trusted), seconds, tuple(record.unchecked)
    return Verdict(outcome, claim, witness, excess, *parts)


def _check_leg(document: Document, folder: Path, record: Record, joint: Joint | None) -> list[str]:
    """Check the run of a leg, and its joint to the next one."""
    return _check(document, folder, record, True, joint)


def _check(
    document: Document,
    folder: Path | None,
    record: Record,
    whole: bool = False,
    joint: Joint | None = None,
    code: Path | None = None,
) -> list[str]:
    """Check everything; return the assumptions that are trusted besides."""
    flint.ctx.prec = precision_for(document)  # `_judge` puts it back
    record.holds("digest", f"unchanged, {document.scenario}, {document.steps} steps of {document.delta:g} s")
    trusted, claims = list(document.assumptions), None
    if folder is None or not (whole or has_artefacts(document, folder)):
        trusted.append("the certificate was made from the scenario it names: no other file lies beside it")
    else:
        check_hashes(document, folder, record)
        scenario = read_scenario(folder)
        check_inputs(document, scenario, record)
        check_networks(document, scenario, folder, record)
        claims = check_artefacts(document, folder, scenario, record)
        claims = replace(claims, joint=joint)
        trusted += unchecked(document, scenario, folder)
        record.unchecked += unchecked_demands(scenario)
        if claims.tank is not None and claims.upkeep is None:
            record.unchecked.append("that the tank lasts, of which the run says nothing: tank.delta_v_m_s")
    if code is not None:
        trusted += check_code(document, code, record)
    confirmed = len(record.checked)
    while True:
        try:
            Argument(document, record, claims, code).run()
            break
        except Imprecise:
            if flint.ctx.prec >= MOST_BITS:
                raise
            flint.ctx.prec *= 2
            del record.checked[confirmed:]
    if code is None and document.guarantee == "proved" and min(document.u_max) > 0:
        record.holds("rounding", precisions(document))
    version = f"python-flint {flint.__version__} (ball arithmetic, {flint.ctx.prec} bit)"
    return [*trusted, f"{version}, SHA-256, and this checker"]
