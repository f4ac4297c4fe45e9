"""The schedule of a run folder: what had to be found is read, all that follows from it is proven again."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..certificate.files.artefacts import check_hashes
from ..certificate.files.document import VERSION, Document, read
from ..certificate.kernel.verdict import Failed, Record, Undecided
from ..model.errors import NotCertified, ScenarioError, SynthesisInfeasible
from ..planning.problem import Plan
from ..planning.reference import Reference
from ..scenario.scenario import ScheduleScenario
from ..synthesis.controllers.controllers import Controller
from ..synthesis.safety.get_safety import Safety, find_safety
from ..synthesis.safety.problem import Problem
from ..synthesis.schedule.schedule import Schedule
from ..synthesis.schedule.search import Search, SwitchingRules
from ..synthesis.schedule.synthesize import switching_logic
from .certificate import flown
from .files.folder import SCENARIO, RunFolder
from .run import read_run
from .schedule import SCHEDULE

NAME = "certificate.json"
AGREES = 1e-9
"""Share of the largest number of an array by which others may differ: other libraries round otherwise."""


def read_schedule(folder: str | Path | RunFolder) -> Schedule:
    """Return the schedule of a run folder without planning and without searching for modes.

    The reference inputs and the modes are read from ``certificate.json``. Gains, sets and tubes follow from
    them by the functions of the synthesis, and both algorithms prove the schedule again.

    Parameters
    ----------
    folder : path or RunFolder
        Written by `polaris.run` or `polaris.write_run`.

    Returns
    -------
    Schedule
        Equal to the one that was written, in modes, sets and tubes; `seconds` is empty.

    Raises
    ------
    ScenarioError
        If it is no run folder of a schedule, a file in it was changed, its certificate is of another version,
        or its scenario and its certificate contradict each other.

    Examples
    --------
    >>> import polaris, tempfile
    >>> with tempfile.TemporaryDirectory() as place:
    ...     folder = polaris.run("static", f"{place}/static")
    ...     schedule = polaris.read_schedule(folder.path)
    >>> f"{schedule.share():.0%}", schedule.guarantee
    ('95%', 'proved')
    """
    run = folder if isinstance(folder, RunFolder) else read_run(folder)
    if run.kind is not SCHEDULE:
        raise ScenarioError("run folder", str(run.path), f"must be of a schedule; it is of a {run.kind.name}")
    document = _document(run.path)
    try:
        schedule = _proven(run.scenario, document)
    except (SynthesisInfeasible, NotCertified) as error:
        rule = f"holds a schedule that this version cannot prove ({error}); run the scenario again"
        raise ScenarioError("run folder", str(run.path), rule) from error
    for place, told, made in _repeated(document, schedule):
        if not _agree(told, made):
            rule = f"{NAME} and {SCENARIO} contradict each other in {place}; run the scenario again"
            raise ScenarioError("run folder", str(run.path), rule)
    return schedule


def _document(folder: Path) -> Document:
    """Read the certificate of a folder and compare the hashes of all its files."""
    try:
        document = read(folder / NAME)
        check_hashes(document, folder, Record())
    except OSError as error:
        raise ScenarioError("run folder", str(folder), f"has no {NAME} that can be read ({error})") from error
    except Undecided as error:
        rule = f"cannot be read: {error.witness}; this version reads schema_version {VERSION}"
        raise ScenarioError("run folder", str(folder), f"{rule}: run the scenario again") from error
    except Failed as error:
        rule = f"was changed after it was written: {error.witness}; run the scenario again"
        raise ScenarioError("run folder", str(folder), rule) from error
    return document


def _proven(scenario: ScheduleScenario, document: Document) -> Schedule:
    """Prove the schedule of a document by both algorithms, along its reference and in its modes."""
    problem = replace(scenario.problem(), recoverable=document.recoverable)
    safety = find_safety(problem, known_plan(problem, document.inputs[: document.steps], document.facets))
    laws = _controllers(scenario, document, safety)
    search = Search.over(scenario, safety, laws, SwitchingRules(), None, fits=True)
    return switching_logic(replace(search, intended=tuple(document.modes)))


def known_plan(problem: Problem, inputs: Any, facets: Any) -> Plan:
    """Return a plan of which only the inputs (K, m) and the separating facets (cells, sets) are known."""
    system, K, nu = problem.system, problem.K, np.array(inputs, dtype=float)
    path = Reference.propagate(system, problem.delta, problem.initial_set.c, nu)
    sides = np.array(facets, dtype=int).reshape(len(facets), -1).T
    unknown = np.full((len(sides), K), np.nan)
    spent = float(np.sum(np.abs(nu)) * problem.delta / system.mass)
    parts = path.chi, nu, sides[:, :K], sides[:, K:], np.nan, unknown, unknown, spent
    return Plan(*parts, status="read", objective=np.nan, bound=np.nan, gap=np.nan)


def _controllers(scenario: ScheduleScenario, document: Document, safety: Safety) -> Sequence[Controller]:
    """Build the experimental controllers; those that follow a plan follow the one in the document."""
    planned = {law.name: np.array(law.inputs) for law in document.laws[1:] if law.inputs is not None}
    return scenario.controllers(safety, planned=planned)


def _repeated(document: Document, schedule: Schedule) -> list[tuple[str, Any, Any]]:
    """Return what a document says beside its choices, and what the schedule says of the same."""
    safety = schedule.safety
    start, unsafe, end = safety.problem.initial_set, safety.clearance.unsafe, safety.end
    sets = [(each.name, each.keep_in, each.normals) for each in unsafe]
    cells = safety.reference.cells
    offsets = [np.stack([each.start, each.end], axis=1)[:cells] for each in document.unsafe]
    made = flown(schedule)
    return [
        *((key, document.repeated[key], made[key]) for key in made),
        ("initial_set", [document.center, document.generators], [start.c, start.G.T]),
        ("unsafe_sets", [(each.name, each.keep_in, each.normals) for each in document.unsafe], sets),
        ("unsafe_sets.offsets", offsets, [each.offsets[:cells] for each in unsafe]),
        ("reference", [document.states, document.inputs], [safety.reference.chi, safety.reference.nu]),
        ("schedule.modes", document.modes, schedule.modes),
        ("end.horizon", document.horizon, end.horizon),
        ("end.until", document.until, end.until if np.isfinite(end.until) else None),
        ("end.reason", document.reason, end.reason),
        ("guarantee", document.guarantee, schedule.guarantee),
        ("assumptions", document.assumptions, list(schedule.assumptions[:-1])),
    ]


def _agree(told: Any, made: Any) -> bool:
    """Return True if two nested values are equal, numbers up to rounding."""
    if isinstance(told, Mapping):
        same = isinstance(made, Mapping) and set(told) == set(made)
        return same and all(_agree(told[key], made[key]) for key in told)
    if isinstance(made, np.ndarray | float | int) and not isinstance(made, bool):
        found, wanted = np.array(told, dtype=float), np.array(made, dtype=float)
        same = found.size == wanted.size == 0 or found.shape == wanted.shape
        return same and bool(np.all(np.abs(found - wanted) <= AGREES * np.max(np.abs(wanted), initial=0.0)))
    if isinstance(told, list | tuple):
        same = isinstance(made, list | tuple) and len(told) == len(made)
        return same and all(map(_agree, told, made))
    return bool(told == made)
