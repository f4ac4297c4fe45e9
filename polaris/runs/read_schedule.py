"""The schedule of a run folder: search results are read, all that follows from them is proven again."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ..certificate.files.artefacts import check_hashes
from ..certificate.files.document import VERSION, Document, read
from ..certificate.kernel.verdict import Failed, Record, Undecided
from ..model.errors import NotCertified, ScenarioError, SynthesisInfeasible
from ..planning.recheck import known_plan
from ..planning.reference import Reference
from ..scenario.scenario import ScheduleScenario
from ..synthesis.controllers.black_box import Ask, BlackBox, SampledBound
from ..synthesis.controllers.controllers import Controller
from ..synthesis.safety.get_safety import Safety, find_safety
from ..synthesis.safety.problem import Problem
from ..synthesis.schedule.objective import is_as_good
from ..synthesis.schedule.powered import KnownBranches
from ..synthesis.schedule.rules import SwitchingRules
from ..synthesis.schedule.schedule import Schedule
from ..synthesis.schedule.search import ScheduleSearch
from ..synthesis.schedule.synthesize import switching_logic, with_safety
from .files.controllers import system_tables
from .files.folder import SCENARIO, RunFolder, readable
from .run import read_run
from .schedule import SCHEDULE

NAME = "certificate.json"
AGREES = 1e-9
"""Share of the largest number of an array by which others may differ: other libraries round otherwise."""
NOT_PROVEN = "must be proven as the schedule's certificate says; run the scenario again"


def read_schedule(folder: str | Path | RunFolder, black_boxes: Mapping[str, Ask] | None = None) -> Schedule:
    """Return the schedule of a run folder without planning and without searching for modes.

    The reference inputs and the modes are read from ``certificate.json``. Gains, sets and tubes follow from
    them by the functions of the synthesis, and both algorithms prove the schedule again.

    Parameters
    ----------
    folder : path or RunFolder
        Written by `polaris.run` or `polaris.write_run`.
    black_boxes : mapping, optional
        What is asked of black boxes when they fly, by name, as in `polaris.run`. Nothing is asked to read
        them.

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
    run = schedule_folder(folder)
    document = certificate_of(run.path)
    try:
        with readable(run.path):
            schedule = _proven(run, document, _ask_functions(run.scenario, black_boxes))
    except (SynthesisInfeasible, NotCertified) as error:
        rule = f"holds a schedule that this version cannot prove ({error}); run the scenario again"
        raise ScenarioError("run folder", str(run.path), rule) from error
    for place, claimed, derived in _claims(document, schedule):
        if not _agree(claimed, derived):
            raise _contradiction(run, place)
    return schedule


def _contradiction(run: RunFolder, place: str) -> ScenarioError:
    rule = f"{NAME} and {SCENARIO} contradict each other in {place}; run the scenario again"
    return ScenarioError("run folder", str(run.path), rule)


def schedule_folder(folder: str | Path | RunFolder) -> RunFolder:
    """Open a run folder, which must be of a schedule."""
    run = folder if isinstance(folder, RunFolder) else read_run(folder)
    if run.kind is not SCHEDULE:
        rule = f"must be of a schedule; it is of kind {run.kind.name!r}"
        raise ScenarioError("run folder", str(run.path), rule)
    return run


def certificate_of(folder: Path) -> Document:
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


def _ask_functions(scenario: ScheduleScenario, black_boxes: Mapping[str, Ask] | None) -> Mapping[str, Ask]:
    """Return the command functions of black boxes; one that is not given is refused once it flies."""
    if black_boxes:
        return black_boxes

    def missing(name: str) -> Ask:
        def ask(t: float, x: Any, xi: Any) -> Any:
            raise ScenarioError("black box", name, "must be given to fly: read_schedule(folder, {name: ask})")

        return ask

    return {spec.name: missing(spec.name) for spec in scenario.model.experimental if spec.kind == "black_box"}


def _proven(run: RunFolder, document: Document, boxes: Mapping[str, Ask]) -> Schedule:
    """Prove the schedule of a document by both algorithms, along its reference and in its modes."""
    scenario, choices = run.scenario, document.choices
    problem = replace(scenario.problem(), recoverable=document.recoverable)
    if "thrust_share" in choices:
        problem = replace(problem, thrust_share=choices["thrust_share"])
    safety = _safety(problem, document.inputs[: document.steps], document.facets)
    laws = _controllers(scenario, document, safety, boxes)
    rules = scenario.switching_rules()
    search = ScheduleSearch.from_scenario(scenario, safety, laws, rules, None, fits=True)
    modes = tuple(document.modes)  # proven step by step, by whatever rules they were found
    schedule = switching_logic(replace(search, rules=SwitchingRules(), intended=modes))
    if "delta_v_unit" in choices:
        others = _Library(search, schedule, choices.get("library", []))
        schedule = replace(schedule, library=others, objective=rules.prices(choices["delta_v_unit"]))
    if document.sampled_bound:
        schedule = replace(schedule, sampled_bound=SampledBound(**document.sampled_bound))
    schedule = replace(schedule, branches=_branches(run, document))
    demanding = rules.delta_v_max is not None or (problem.abort is not None and problem.abort.required)
    if demanding and not schedule.keeps(rules):
        raise NotCertified("its delta-v or its drift is not proven to meet the scenario")
    if schedule.powered is not None:
        schedule.powered.require()
    return schedule


def _safety(problem: Problem, inputs: Any, facets: Any) -> Safety:
    """Prove a reference by Algorithm 1, from its inputs (K, m) and facets (cells, n_o)."""
    nu = np.array(inputs, dtype=float)
    path = Reference.propagate(problem.system, problem.delta, problem.initial_set.c, nu)
    sides = np.array(facets, dtype=int).reshape(len(facets), -1)
    return find_safety(problem, known_plan(path, problem.K, sides))


def _controllers(
    scenario: ScheduleScenario, document: Document, safety: Safety, boxes: Mapping[str, Ask]
) -> list[Controller]:
    """Build the experimental controllers; those that follow a plan follow the one in the document.

    A black box has the bands of the document, or may do anything where that is what was proven.
    """
    law_by_name = {law.name: law for law in document.laws[1:]}
    planned = {name: np.array(law.inputs) for name, law in law_by_name.items() if law.inputs is not None}
    fits = {k: np.array(fit) for k, fit in enumerate(document.fits) if fit is not None}
    laws = list[Controller]()
    for law in scenario.controllers(safety, boxes, planned):
        if isinstance(law, BlackBox):
            fitted = law.name in law_by_name and law_by_name[law.name].kind == "black_box"
            law = replace(law, fits=fits) if fitted else law.anything
        laws.append(law)
    return laws


def _branches(run: RunFolder, document: Document) -> KnownBranches | None:
    """Return the branches of aborts in a document; ``schedule.json`` says why a step has none."""
    powered, m = document.powered, len(document.u_max)
    if (powered is None) != (run.scenario.problem().powered is None):
        raise _contradiction(run, "powered")
    if powered is None:
        return None
    steps = run.json("schedule.json")["guarantee"]["powered_abort"]["steps"]
    return KnownBranches(
        [each.step for each in powered.branches],
        [np.array(each.inputs, dtype=float).reshape(-1, m) for each in powered.branches],
        [np.array(each.facets, dtype=int).reshape(len(each.facets), -1) for each in powered.branches],
        [None if way is None else way.branch for way in powered.steps],
        [step["why"] or "" for step in steps],
    )


class _Library(Sequence[Schedule]):
    """Schedules along the other references of a document, proven when one of them is first asked for."""

    def __init__(self, search: ScheduleSearch, best: Schedule, choices: Sequence[Mapping[str, Any]]) -> None:
        self.search, self.best, self.choices = search, best, choices

    def __len__(self) -> int:
        return len(self.choices)

    def __getitem__(self, place: Any) -> Any:
        return self._proven[place]

    def __reduce__(self) -> Any:
        return tuple, (self._proven,)  # a search is not pickled, what it found is

    @cached_property
    def _proven(self) -> tuple[Schedule, ...]:
        try:
            return tuple(self._prove(**each) for each in self.choices)
        except (SynthesisInfeasible, NotCertified) as error:
            raise ScenarioError("library", str(error), NOT_PROVEN) from error

    def _prove(self, inputs: Any, modes: list[int]) -> Schedule:
        safety = _safety(self.best.safety.problem, inputs, np.zeros((len(inputs), 0)))
        search = replace(with_safety(self.search, safety), intended=tuple(modes))
        schedule = switching_logic(replace(search, rules=SwitchingRules()))
        if schedule.modes.tolist() != modes or not is_as_good(schedule, self.best, self.search.rules):
            raise ScenarioError("library", f"modes {schedule.modes.tolist()}", NOT_PROVEN)
        return schedule


def _claims(document: Document, schedule: Schedule) -> list[tuple[str, Any, Any]]:
    """Return the key, the stated and the derived value of all that follows from a document's choices."""
    safety, derived = schedule.safety, system_tables(schedule)
    start, unsafe, end = safety.problem.initial_set, safety.clearance.unsafe, safety.end
    feedback_bound, cells = safety.tracking.feedback_bound, safety.reference.cells
    both = document.unsafe, unsafe
    sets, others = ([(u.name, u.keep_in, u.of_state, u.normals) for u in each] for each in both)
    offsets = [np.stack([each.start, each.end], axis=1)[:cells] for each in document.unsafe]
    drift, passive = document.drift, schedule.passive
    clear = [] if drift is None else [parts is not None for parts in drift.steps]
    steps = () if document.powered is None else document.powered.steps
    powered = [way and [way.branch, way.cell] for way in steps]
    ways = () if schedule.powered is None else schedule.powered.ways
    return [
        *((key, document.repeated[key], derived[key]) for key in derived),
        ("initial_set", [document.center, document.generators], [start.c, start.G.T]),
        ("unsafe_sets", sets, others),
        ("unsafe_sets.offsets", offsets, [each.offsets[:cells] for each in unsafe]),
        ("reference", [document.states, document.inputs], [safety.reference.chi, safety.reference.nu]),
        ("feedback_bound", document.feedback_bound, [] if feedback_bound is None else feedback_bound),
        ("modes", document.modes, schedule.modes),
        ("horizon", document.horizon, end.horizon),
        ("guarantee", document.guarantee, schedule.guarantee),
        ("assumptions", document.assumptions, list(schedule.assumptions[:-1])),
        ("drift.steps", clear, [] if passive is None else passive.clear.tolist()),
        ("powered.steps", powered, [None if way.branch is None else [way.branch, way.cell] for way in ways]),
    ]


def _agree(claimed: Any, derived: Any) -> bool:
    """Return True if two nested values are equal, numbers up to rounding."""
    if isinstance(claimed, Mapping):
        same = isinstance(derived, Mapping) and set(claimed) == set(derived)
        return same and all(_agree(claimed[key], derived[key]) for key in claimed)
    if isinstance(derived, np.ndarray | float | int) and not isinstance(derived, bool):
        one, other = np.array(claimed, dtype=float), np.array(derived, dtype=float)
        same = one.size == other.size == 0 or one.shape == other.shape
        return same and bool(np.all(np.abs(one - other) <= AGREES * np.max(np.abs(other), initial=0.0)))
    if isinstance(claimed, list | tuple):
        same = isinstance(derived, list | tuple) and len(claimed) == len(derived)
        return same and all(map(_agree, claimed, derived))
    return bool(claimed == derived)
