"""Scenarios of the inspection problem: one flight under a filter, one into the fuel limit, many."""

from __future__ import annotations

import difflib
from abc import abstractmethod
from typing import TYPE_CHECKING

import numpy as np

from ..inspection.constraints.strengthening import PRESETS, Strengthening
from ..inspection.inspection import Inspection
from ..model.checks import counted
from ..model.errors import ScenarioError
from . import inspection_rules as rules
from . import inspection_tables as models
from .base import Scenario, kept
from .filter_tables import Alpha, FlightFilter

if TYPE_CHECKING:
    from ..inspection.backup.law import Law
    from ..inspection.constraints.families import Families
    from ..inspection.flights.primary import Primary
    from ..inspection.flights.simulation import BatchFilter
    from ..model.system import Array

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


class InspectionScenario(Scenario):
    """What the scenarios of the inspection problem share; see `Scenario`."""

    model: models.InspectionModel | models.FuelLimitModel | models.MonteCarloModel

    @property
    @abstractmethod
    def deputies(self) -> int:
        """Number N of deputies."""

    @kept
    def inspection(self) -> Inspection:
        """The problem."""
        given = self.model.parameters
        values = {name: getattr(given, field) for name, field in _PARAMETERS.items()}
        try:
            return Inspection(self.deputies, field_of_view=np.radians(given.field_of_view_deg), **values)
        except ScenarioError as error:
            field = f"parameters.{_PARAMETERS.get(error.field, error.field)}"
            raise ScenarioError(field, error.given, error.rule) from error


class FilteredScenario(InspectionScenario):
    """What flights under barrier filters share."""

    model: models.InspectionModel | models.MonteCarloModel

    @kept
    def strengthening(self) -> dict[str, Strengthening]:
        """The functions alpha, for every family."""
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
                    field = f"strengthening.{family}.{error.field}"
                    raise ScenarioError(field, error.given, error.rule) from error
        return chosen

    def families(self) -> Families:
        """All constraints, nothing tightened: the judge of a flight."""
        from ..inspection.constraints.families import Families

        return Families(self.inspection(), self.strengthening(), exact=True)

    def filter(self, spec: FlightFilter, period: float) -> BatchFilter:
        """The filter that a table describes."""
        from .filters import build_filter

        return build_filter(spec, self.inspection(), self.strengthening(), period)

    def _check_filter(self, path: str, spec: FlightFilter, table: str, period: float) -> None:
        """Build a filter once: the conditions between samples bound the control period."""
        rules.check_left_out(path, spec)
        try:
            self.filter(spec, period)
        except ScenarioError as error:
            field = f"{table}.period_s" if error.field == "period" else f"{path}.{error.field}"
            raise ScenarioError(field, error.given, error.rule) from error


class FlightScenario(FilteredScenario):
    """One flight of N deputies under a filter."""

    model: models.InspectionModel
    MODEL = models.InspectionModel

    def _check(self) -> None:
        model, initial = self.model, self.model.initial
        rules.check_time("flight", model.flight.duration_s, model.flight.period_s)
        self.inspection()
        rules.check_phases(model)
        if isinstance(initial, models.InitialStates):
            rules.check_states(initial)
        self.strengthening()
        self._check_filter("filter", model.filter, "flight", model.flight.period_s)
        if isinstance(initial, models.InitialStates):
            rules.check_start(self.families(), initial)

    def outline(self) -> str:
        """What it describes, on one line."""
        crew, flight = counted(self.deputies, "deputy", "deputies"), self.model.flight
        flown = f"{crew}, {flight.duration_s:g} s in periods of {flight.period_s:g} s"
        return f"{flown}, {self.model.filter.kind} filter"

    @property
    def deputies(self) -> int:
        """Number N of deputies."""
        initial = self.model.initial
        return len(initial.states) if isinstance(initial, models.InitialStates) else initial.deputies

    def initial(self) -> tuple[Array, float]:
        """States of the deputies, shape (N, 6), and the angle of the sun [rad]."""
        from ..inspection.flights.sampling import InitialConditions

        given = self.model.initial
        if isinstance(given, models.InitialStates):
            return np.array(given.states, dtype=float), float(np.radians(given.sun_angle_deg))
        x, sun = InitialConditions(self.families(), given.seed, block=1024).first(1)
        return x[0], float(sun[0])

    def primary(self) -> Primary:
        """The primary controller, phase by phase."""
        from ..inspection.flights.primary import LQR, NoInput, Phases

        controllers: list[Primary] = []
        for phase in self.model.primary:
            if isinstance(phase, models.NoThrust):
                controllers.append(NoInput())
            else:
                distance = phase.distance_m if isinstance(phase, models.ToDistance) else 0.0
                controllers.append(LQR(self.inspection(), distance, *phase.weights))
        return Phases([phase.start_s for phase in self.model.primary], controllers)


class FuelLimitScenario(InspectionScenario):
    """One deputy and its fuel limit."""

    model: models.FuelLimitModel
    MODEL = models.FuelLimitModel
    deputies = 1

    def _check(self) -> None:
        model = self.model
        rules.check_time("flight", model.flight.duration_s, model.flight.period_s)
        rules.check_fuel(model, self.inspection())
        self.backup()

    def outline(self) -> str:
        """What it describes, on one line."""
        flight, limit = self.model.flight, self.model.parameters.delta_v_max_m_s
        flown = f"1 deputy, {flight.duration_s:g} s in periods of {flight.period_s:g} s"
        return f"{flown}, fuel limit {limit:g} m/s"

    @kept
    def backup(self) -> Law:
        """The backup controller."""
        from ..inspection.backup.parking import Parking
        from ..inspection.backup.tracker import Tracker
        from ..inspection.enmt import Ellipses

        given, q = self.model.fuel, self.inspection()
        usual = Ellipses.of(q)
        try:
            ellipses = Ellipses(
                q.mean_motion,
                usual.least if given.semi_minor_least_m is None else given.semi_minor_least_m,
                usual.largest if given.semi_minor_largest_m is None else given.semi_minor_largest_m,
                usual.cross_track if given.cross_track_m is None else given.cross_track_m,
            )
        except ScenarioError as error:
            names = {"least": "semi_minor_least_m", "largest": "semi_minor_largest_m"}
            field = f"fuel.{names.get(error.field, error.field)}"
            raise ScenarioError(field, error.given, error.rule) from error
        law = Parking if given.backup == "parking" else Tracker
        try:
            return law(q, ellipses, self.model.flight.period_s, given.response_s)
        except ScenarioError as error:
            field = "flight.period_s" if error.field == "period" else f"fuel.{error.field}_s"
            raise ScenarioError(field, error.given, error.rule) from error

    def primary(self) -> Primary:
        """Regulators to the outer and to the inner target in turn."""
        from ..inspection.flights.primary import LQR, Phases

        q, given = self.inspection(), self.model.primary
        targets = [LQR(q, distance, *given.weights) for distance in (given.distance_m / 4, given.distance_m)]
        starts = np.arange(0.0, self.model.flight.duration_s, given.swing_s)
        return Phases(starts.tolist(), [targets[k % 2] for k in range(len(starts))])


class MonteCarloScenario(FilteredScenario):
    """Many flights from drawn initial conditions, for one or more filters."""

    model: models.MonteCarloModel
    MODEL = models.MonteCarloModel

    def _check(self) -> None:
        campaign = self.model.campaign
        rules.check_time("campaign", campaign.duration_s, campaign.period_s)
        rules.check_studies(self.model)
        self.inspection()
        self.strengthening()
        for k, study in enumerate(self.model.studies):
            self._check_filter(f"studies[{k}].filter", study.filter, "campaign", campaign.period_s)

    def outline(self) -> str:
        """What it describes, on one line."""
        plan, crew = self.model.campaign, counted(self.deputies, "deputy", "deputies")
        studies = ", ".join(study.name for study in self.model.studies)
        return f"{counted(plan.runs, 'run')} of {crew} for {plan.duration_s:g} s, studies: {studies}"

    @property
    def deputies(self) -> int:
        """Number N of deputies."""
        return self.model.campaign.deputies
