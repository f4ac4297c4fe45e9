"""Scenarios of the inspection problem: load one by name or path, override a value, build its objects.

>>> from polaris.scenario.inspection import load_inspection
>>> load_inspection("inspection").inspection().deputies
5
"""

from __future__ import annotations

import copy
import difflib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..inspection.constraints.strengthening import PRESETS, Strengthening
from ..inspection.inspection import Inspection
from ..model.checks import counted
from ..model.errors import ScenarioError
from . import inspection_tables as models
from .filter_tables import Alpha, FlightFilter
from .inspection_rules import check
from .overrides import parse_assignment, put
from .reading import NOTHING, validate_as, write_toml
from .scenario import locate, read_scenario_file

if TYPE_CHECKING:
    from ..inspection.constraints.families import Families
    from ..inspection.flights.primary import Primary
    from ..inspection.flights.simulation import BatchFilter
    from ..model.system import Array

Model = models.InspectionModel | models.FuelLimitModel | models.MonteCarloModel

KINDS: dict[str, type[Model]] = {
    "inspection": models.InspectionModel,
    "fuel_limit": models.FuelLimitModel,
    "monte_carlo": models.MonteCarloModel,
}
"""Kinds of scenario by the key ``kind`` at the top of the file."""

_PARAMETERS = {
    "mass": "mass_kg",
    "mean_motion": "mean_motion_rad_s",
    "deputy_radius": "deputy_radius_m",
    "chief_radius": "chief_radius_m",
    "docking_speed": "docking_speed_m_s",
    "speed_slope": "speed_slope_1_s",
    "delta_v_max": "delta_v_max_m_s",
    "distance_max": "distance_max_m",
    "passive_time": "passive_time_s",
    "speed_max": "speed_max_m_s",
    "thrust_max": "thrust_max_N",
    "smoothing": "smoothing_m",
}


@dataclass(frozen=True, eq=False)
class InspectionScenario:
    """A validated scenario of the inspection problem and the builders of what it describes.

    Parameters
    ----------
    model : InspectionModel or another of `KINDS`
        The fields as in the file.
    source : str or None
        Where it came from, for messages.
    text : str or None
        The file's text; None once a value has been overridden.

    Raises
    ------
    ScenarioError
        If a rule that joins several fields is broken.
    """

    model: Model
    source: str | None = None
    text: str | None = None

    def __post_init__(self) -> None:
        try:
            check(self)
        except ScenarioError as error:
            given = NOTHING if error.given is None else error.given
            raise ScenarioError(error.field, given, error.rule, error.where or self.source) from error

    @classmethod
    def from_dict(cls, document: Mapping[str, Any], source: str | None = None) -> InspectionScenario:
        """Validate nested data shaped like the TOML file."""
        return cls(validate_as(model_of(document, source), document, source), source)

    # -- overrides and data ---------------------------------------------------------------------

    def with_overrides(self, values: Mapping[str, Any]) -> InspectionScenario:
        """Return a copy with several values replaced together, as in `Scenario.set`."""
        if not values:
            return self
        document = self.to_dict()
        for key, value in values.items():
            put(document, key, copy.deepcopy(value), self.source)
        return self.from_dict(document, self.source)

    def with_assignments(self, assignments: Iterable[str]) -> InspectionScenario:
        """Return a copy changed by texts ``key=value`` as given to ``--set``."""
        return self.with_overrides(dict(parse_assignment(text) for text in assignments))

    @property
    def name(self) -> str:
        """Short name."""
        return self.model.name

    @property
    def kind(self) -> str:
        """One of `KINDS`."""
        return self.model.kind

    def to_dict(self) -> dict[str, Any]:
        """All values, defaults included, as nested plain data."""
        return self.model.model_dump(mode="json", exclude_none=True)

    def to_toml(self) -> str:
        """All values, defaults included, as TOML that loads back to the same scenario."""
        return write_toml(self.to_dict())

    def outline(self) -> str:
        """What it describes, on one line."""
        model, crew = self.model, counted(self.deputies, "deputy", "deputies")
        if isinstance(model, models.MonteCarloModel):
            plan, studies = model.campaign, ", ".join(study.name for study in model.studies)
            return f"{counted(plan.runs, 'run')} of {crew} for {plan.duration_s:g} s, studies: {studies}"
        flight = model.flight
        if isinstance(model, models.FuelLimitModel):
            flown = f"1 deputy, {flight.duration_s:g} s in periods of {flight.period_s:g} s"
            return f"{flown}, fuel limit {model.parameters.delta_v_max_m_s:g} m/s"
        return (
            f"{crew}, {flight.duration_s:g} s in periods of {flight.period_s:g} s, {model.filter.kind} filter"
        )

    # -- the domain's objects -------------------------------------------------------------------

    def inspection(self) -> Inspection:
        """The problem."""
        given = self.model.parameters
        values = {name: getattr(given, field) for name, field in _PARAMETERS.items()}
        try:
            return Inspection(self.deputies, field_of_view=np.radians(given.field_of_view_deg), **values)
        except ScenarioError as error:
            field = f"parameters.{_PARAMETERS.get(error.field, error.field)}"
            raise ScenarioError(field, error.given, error.rule) from error

    @property
    def deputies(self) -> int:
        """Number N of deputies."""
        if isinstance(self.model, models.MonteCarloModel):
            return self.model.campaign.deputies
        if isinstance(self.model, models.FuelLimitModel):
            return 1
        initial = self.model.initial
        return len(initial.states) if isinstance(initial, models.InitialStates) else initial.deputies

    def strengthening(self) -> dict[str, Strengthening]:
        """The functions alpha, for every family."""
        assert not isinstance(self.model, models.FuelLimitModel)
        table = self.model.strengthening
        if table.preset not in PRESETS:
            near = difflib.get_close_matches(table.preset, PRESETS, n=1)
            hint = f"; did you mean {near[0]}?" if near else ""
            rule = f"must be one of {', '.join(map(repr, PRESETS))}{hint}"
            raise ScenarioError("strengthening.preset", table.preset, rule)
        chosen = dict(PRESETS[table.preset])
        for family in chosen:
            given: Alpha | None = getattr(table, family)
            if given is not None:
                c1, c2, c3 = given.coefficients
                try:
                    chosen[family] = Strengthening((c1, c2, c3), given.bias, given.recovery, given.push)
                except ScenarioError as error:
                    raise ScenarioError(
                        f"strengthening.{family}.{error.field}", error.given, error.rule
                    ) from error
        return chosen

    def families(self) -> Families:
        """All constraints, nothing tightened: the judge of a flight."""
        from ..inspection.constraints.families import Families

        return Families(self.inspection(), self.strengthening(), exact=True)

    def filter(self, spec: FlightFilter, period: float) -> BatchFilter:
        """The filter that a table describes."""
        from .filters import build_filter

        return build_filter(spec, self.inspection(), self.strengthening(), period)

    def initial(self) -> tuple[Array, float]:
        """States of the deputies, shape (N, 6), and the angle of the sun [rad]."""
        from ..inspection.flights.sampling import initial_conditions

        assert isinstance(self.model, models.InspectionModel)
        given = self.model.initial
        if isinstance(given, models.InitialStates):
            return np.array(given.states, dtype=float), float(np.radians(given.sun_angle_deg))
        x, sun, _ = initial_conditions(self.families(), 1, given.seed, block=1024)
        return x[0], float(sun[0])

    def primary(self) -> Primary:
        """The primary controller, phase by phase."""
        from ..inspection.flights.primary import LQR, NoInput, Phases

        assert isinstance(self.model, models.InspectionModel)
        q = self.inspection()
        controllers: list[Primary] = []
        for phase in self.model.primary:
            if isinstance(phase, models.NoThrust):
                controllers.append(NoInput())
                continue
            distance = phase.distance_m if isinstance(phase, models.ToDistance) else 0.0
            controllers.append(
                LQR(
                    q,
                    distance,
                    phase.position_weight_1_m2,
                    phase.velocity_weight_s2_m2,
                    phase.thrust_weight_1_N2,
                )
            )
        return Phases([phase.start_s for phase in self.model.primary], controllers)


# -- loading ----------------------------------------------------------------------------------------


def model_of(document: Mapping[str, Any], where: str | None = None) -> type[Model]:
    """Model of a document by its key ``kind``.

    Raises
    ------
    ScenarioError
        If there is no such kind.
    """
    kind = document.get("kind", NOTHING)
    if isinstance(kind, str) and kind in KINDS:
        return KINDS[kind]
    near = difflib.get_close_matches(kind, KINDS, n=1, cutoff=0.5) if isinstance(kind, str) else []
    hint = f"; did you mean {near[0]}?" if near else ""
    words = ", ".join(map(repr, KINDS))
    raise ScenarioError("kind", kind, f"must be one of {words}, or left out for a schedule{hint}", where)


def load_inspection(
    name_or_path: str | Path, overrides: Mapping[str, Any] | None = None
) -> InspectionScenario:
    """Load a bundled scenario of the inspection problem by its name, or one's own by its path.

    Parameters
    ----------
    name_or_path : str or Path
        A name listed by ``polaris scenarios`` or the path of a TOML file.
    overrides : mapping, optional
        Values to replace before validation.

    Raises
    ------
    ScenarioError
        If there is no such scenario, or it is not valid: names the field, what was given, the rule.
    """
    document, written, where = read_scenario_file(locate(name_or_path))
    for key, value in (overrides or {}).items():
        put(document, key, copy.deepcopy(value), where)
    model = validate_as(model_of(document, where), document, where)
    return InspectionScenario(model, where, None if overrides else written)
