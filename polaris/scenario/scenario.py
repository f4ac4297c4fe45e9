"""Scenarios: load one by name or path, override a value, and build the domain's objects from it.

>>> import polaris
>>> scenario = polaris.load_scenario("static")
>>> scenario.system().n
6
"""

from __future__ import annotations

import copy
import difflib
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from reach.sets.zonotope import Zonotope

from ..model.errors import ScenarioError
from ..model.system import LinearSystem
from . import build
from .overrides import parse_assignment, put
from .reading import NOTHING, printable, read_document, validate, write_toml
from .rules import check
from .scene_tables import Experimental
from .tables import Planner, Recoverable, SampledFeedback, ScenarioModel, Schedule, Simulation

if TYPE_CHECKING:
    from ..model.obstacle import Obstacle
    from ..planning.goal import Goal
    from ..synthesis.controllers import Controller
    from ..synthesis.get_safety import Safety
    from ..synthesis.problem import Problem
    from ..synthesis.search import SwitchingRules

INSPECTION_KINDS = ("inspection", "fuel_limit", "monte_carlo")
"""What `polaris.scenario.inspection` loads, by the key ``kind`` at the top of the file."""


@dataclass(frozen=True, eq=False)
class Scenario:
    """A validated scenario and the builders of what it describes.

    Parameters
    ----------
    model : ScenarioModel
        The fields as in the file.
    source : str or None
        Where it came from, for messages.
    text : str or None
        The file's text, comments included; None once a value has been overridden.

    Raises
    ------
    ScenarioError
        If a rule that joins several fields is broken.
    """

    model: ScenarioModel
    source: str | None = None
    text: str | None = None

    def __post_init__(self) -> None:
        try:
            check(self.model)
        except ScenarioError as error:
            given = NOTHING if error.given is None else error.given
            raise ScenarioError(error.field, given, error.rule, error.where or self.source) from error

    @classmethod
    def from_dict(cls, document: Mapping[str, Any], source: str | None = None) -> Scenario:
        """Validate nested data shaped like the TOML file."""
        return cls(validate(document, source), source)

    # -- overrides ------------------------------------------------------------------------------

    def set(self, key: str, value: Any) -> Scenario:
        """Return a copy with one value replaced.

        Parameters
        ----------
        key : str
            Where, as in ``planner.solver`` or ``obstacles[0].radius_m``. A whole table may be given
            too: ``scenario.set("goal", {"kind": "box", ...})``. None removes an optional value.
        value : object
            The new value.

        Raises
        ------
        ScenarioError
            If there is no such key or the result is not a valid scenario.
        """
        return self.with_overrides({key: value})

    def with_overrides(self, values: Mapping[str, Any]) -> Scenario:
        """Return a copy with several values replaced together, as in `set`; checked once, at the end."""
        if not values:
            return self
        document = self.to_dict()
        for key, value in values.items():
            put(document, key, copy.deepcopy(value), self.source)
        return Scenario(validate(document, self.source), self.source)

    def with_assignments(self, assignments: Iterable[str]) -> Scenario:
        """Return a copy changed by texts ``key=value`` as given to ``--set``.

        The value is read as TOML (``0.5``, ``[1, 2]``, ``true``, ``{ kind = "ball" }``); what is not
        TOML is taken for text, so ``planner.solver=gurobi`` needs no quotes.
        """
        return self.with_overrides(dict(parse_assignment(text) for text in assignments))

    # -- as data --------------------------------------------------------------------------------

    @property
    def name(self) -> str:
        """Short name."""
        return self.model.name

    def to_dict(self) -> dict[str, Any]:
        """All values, defaults included, as nested plain data."""
        data: dict[str, Any] = _lists(self.model.model_dump(exclude_none=True))
        return data

    def to_toml(self) -> str:
        """All values, defaults included, as TOML that loads back to the same scenario."""
        return write_toml(self.to_dict())

    # -- the domain's objects -------------------------------------------------------------------

    @property
    def steps(self) -> int:
        """Number K of steps."""
        count = build.whole_parts(self.model.horizon.duration_s, self.model.horizon.step_s)
        assert count is not None  # checked on construction
        return count

    @property
    def step(self) -> float:
        """Step delta [s]."""
        return self.model.horizon.step_s

    @property
    def periods_per_step(self) -> int | None:
        """Control periods in one step; None if feedback is continuous."""
        feedback = self.model.feedback
        if isinstance(feedback, SampledFeedback):
            return build.whole_parts(self.model.horizon.step_s, feedback.period_s)
        return None

    def system(self) -> LinearSystem:
        """The controlled system."""
        return build.build_system(self.model.system)

    def initial_set(self) -> Zonotope:
        """The initial set Theta, shape (n,); a ball is enclosed by a zonotope."""
        return build.build_initial_set(self.model.initial_set, self.system())

    def obstacles(self) -> tuple[Obstacle, ...]:
        """Unsafe sets of the perception oracle: obstacles first, then keep-in sets."""
        return build.build_obstacles(self.model)

    def goal(self) -> Goal:
        """Where the reference must end."""
        return build.build_goal(self.model.goal, self.system())

    def tracking(self) -> build.TrackingSpec:
        """LQR weights as full matrices, the method of the error bound, and its norm."""
        return build.build_tracking(self.model.tracking)

    def experimental_specs(self) -> tuple[Experimental, ...]:
        """The experimental controllers as validated models, in order of preference."""
        return self.model.experimental

    def controllers(self, safety: Safety) -> tuple[Controller, ...]:
        """The experimental controllers on a safety controller's reference, in order of preference.

        Raises
        ------
        ScenarioError
            If one is malformed.
        SynthesisInfeasible, NotCertified
            If the plan that an ``unaware`` reference stands for cannot be found.
        """
        from .experimental import build_controllers

        return build_controllers(self.experimental_specs(), safety)

    def problem(self) -> Problem:
        """The problem that Algorithm 1 is asked."""
        from ..planning.problem import PlannerOptions
        from ..synthesis.problem import Problem
        from .experimental import gains_of

        system, tracking, planner = self.system(), self.tracking(), self.planner
        feedback = self.model.feedback
        return Problem(
            system=system,
            initial_set=self.initial_set(),
            unsafe=self.obstacles(),
            K=self.steps,
            delta=self.step,
            Q=tracking.Q,
            R=tracking.R,
            goal=self.goal(),
            recoverable=self.recoverable.kind,
            period=feedback.period_s if isinstance(feedback, SampledFeedback) else None,
            bound=tracking.bound,
            weight=tracking.weight,
            objective=planner.objective,
            extra_margin=planner.extra_margin_m,
            thrust_reserve=planner.thrust_reserve,
            planner=PlannerOptions(
                solver=planner.solver,
                max_linear_programs=planner.max_linear_programs,
                max_nodes=planner.max_nodes,
                time_limit=planner.time_limit_s,
                gap=planner.gap,
            ),
            gains=gains_of(self.experimental_specs(), system),
        )

    def switching_rules(self) -> SwitchingRules:
        """Options of Algorithm 2."""
        from ..synthesis.search import SwitchingRules

        rules = self.schedule
        weights = tuple(spec.weight for spec in self.experimental_specs())
        return SwitchingRules(rules.strategy, rules.min_dwell_steps, rules.max_switches, weights, rules.beam)

    @property
    def recoverable(self) -> Recoverable:
        """Which recoverable sets."""
        return self.model.recoverable

    @property
    def planner(self) -> Planner:
        """How the reference is planned."""
        return self.model.planner

    @property
    def schedule(self) -> Schedule:
        """How the switching schedule is chosen."""
        return self.model.schedule

    @property
    def simulation(self) -> Simulation:
        """Closed-loop runs."""
        return self.model.simulation


# -- loading ----------------------------------------------------------------------------------------


def scenario_folder() -> Path:
    """The folder of bundled scenarios: in the installed package, or beside it in a checkout."""
    package = Path(__file__).resolve().parents[1]
    beside = package.parent / "scenarios"
    # A checkout's folder comes first, so that an editable installation never reads an old copy.
    return beside if (package.parent / "pyproject.toml").is_file() else package / "bundled_scenarios"


def bundled_files() -> tuple[str, ...]:
    """Names of all scenario files that come with the package, of every kind, sorted."""
    return tuple(sorted(path.stem for path in scenario_folder().glob("*.toml")))


def bundled_scenarios() -> tuple[str, ...]:
    """Names of the scenarios of switching schedules that come with the package, sorted.

    Those of the inspection problem have a key ``kind`` at the top; `polaris.scenario.inspection` loads them.
    """
    paths = ((name, scenario_folder() / f"{name}.toml") for name in bundled_files())
    return tuple(name for name, path in paths if "kind" not in read_document(path)[0])


def locate(name_or_path: str | Path) -> Path:
    """Path of a bundled scenario, or of one's own; a name wins over a file of the same name."""
    text = str(name_or_path)
    if isinstance(name_or_path, str) and text in bundled_files():
        return scenario_folder() / f"{text}.toml"
    _refuse_unknown(text)
    return Path(name_or_path)


def kind_of(name_or_path: str | Path) -> str | None:
    """The key ``kind`` at the top of a scenario file, as text; None for a switching schedule."""
    document = read_document(locate(name_or_path))[0]
    return str(document["kind"]) if "kind" in document else None


def read_scenario_file(path: Path) -> tuple[dict[str, Any], str, str]:
    """Data and text of a file, and its name for messages."""
    document, written = read_document(path)
    return document, written, printable(path.name)


def load_scenario(name_or_path: str | Path, overrides: Mapping[str, Any] | None = None) -> Scenario:
    """Load a bundled scenario by its name, or one's own by its path.

    Parameters
    ----------
    name_or_path : str or Path
        A name out of `bundled_scenarios()` or the path of a TOML file. A name wins over a file of the
        same name; write ``./static`` for the file.
    overrides : mapping, optional
        Values to replace before validation, as in `Scenario.set`.

    Raises
    ------
    ScenarioError
        If there is no such scenario, or it is not valid: names the field, what was given, the rule.
    """
    document, written, where = read_scenario_file(locate(name_or_path))
    if document.get("kind") in INSPECTION_KINDS:
        rule = "is no switching schedule; `polaris.scenario.inspection.load_inspection` loads it"
        raise ScenarioError("kind", document["kind"], rule, where)
    for key, value in (overrides or {}).items():
        put(document, key, copy.deepcopy(value), where)
    return Scenario(validate(document, where), where, None if overrides else written)


def _refuse_unknown(text: str) -> None:
    """A bare word that is neither a file nor a bundled name: say what there is."""
    try:
        there = Path(text).exists()
    except (OSError, ValueError):
        there = False
    if there or not re.fullmatch(r"[\w-]+", text):
        return
    names = bundled_files()
    near = difflib.get_close_matches(text, names, n=1)
    hint = f"; did you mean {near[0]}?" if near else ""
    rule = f"is neither a file nor a bundled scenario ({', '.join(names)}){hint}"
    raise ScenarioError("scenario", printable(text), rule)


def _lists(data: Any) -> Any:
    """The same data with lists for tuples, as a TOML reader gives it."""
    if isinstance(data, dict):
        return {key: _lists(value) for key, value in data.items()}
    return [_lists(value) for value in data] if isinstance(data, (list, tuple)) else data
