"""Scenarios of the inspection problem: one flight under a filter, one into the fuel limit, many."""

from abc import abstractmethod
from dataclasses import replace

import numpy as np

from ..inspection.backup.tracker import BackupTracker
from ..inspection.backup.tube import Uncertainty
from ..inspection.constraints.allowable_set import allowable
from ..inspection.constraints.families import Families
from ..inspection.constraints.strengthening import PRESETS, Strengthening, preset
from ..inspection.enmt import Ellipses
from ..inspection.flights.primary import LQR, NoInput, Phases, Primary
from ..inspection.flights.sampling import InitialConditions
from ..inspection.flights.simulation import BatchFilter, SampledErrors
from ..inspection.inspection import Inspection
from ..model.checks import counted
from ..model.craft import Array, Craft
from ..model.errors import ScenarioError
from ..model.estimates.prediction import prediction_error
from .base import Scenario, cached
from .reading import did_you_mean
from .tables import inspection as models
from .tables.fields import check_length, in_file_terms, whole_parts
from .tables.filters import FAMILY_NAMES, Alpha, FlightFilter

SCHEDULES_ONLY = (  # tables and keys that inspection scenarios have without a meaning
    *(("thrusters", key) for key in ("directions", "thrust_max_N", "allocation", "pulse", "remainder")),
    *(("thrusters", key) for key in ("resolution", "rise_s", "fall_s", "errors_vary")),
    *(("timing", key) for key in ("missed_periods", "clock_error_s")),
)


class InspectionScenario(Scenario):
    """Base of the scenarios of the inspection problem; see `Scenario`."""

    model: models.InspectionModel | models.FuelLimitModel | models.MonteCarloModel

    @property
    @abstractmethod
    def deputies(self) -> int:
        """Number N of deputies."""

    @cached
    def inspection(self) -> Inspection:
        """Return the problem."""
        problem: Inspection = self.model.parameters.make("parameters", deputies=self.deputies)
        return problem

    def _check_time(self, table: str, spec: models.FlightTime | models.FuelFlight | models.Campaign) -> None:
        """Check that periods divide the flight, and that there are not too many."""
        duration, period = spec.duration_s, spec.period_s
        count = whole_parts(duration, period)
        if not count:
            raise ScenarioError(f"{table}.period_s", period, f"must divide duration_s = {duration:g} s")
        if count > models.MOST_PERIODS:
            rule = f"must give at most {models.MOST_PERIODS} periods, not {count}"
            raise ScenarioError(f"{table}.period_s", period, rule)


class FilteredScenario(InspectionScenario):
    """Base of the scenarios of flights under barrier filters."""

    model: models.InspectionModel | models.MonteCarloModel

    def strengthening(self, sampled: bool = True) -> dict[str, Strengthening]:
        """Return the functions alpha, for every family, of conditions between samples or at samples only."""
        table = self.model.strengthening
        if table.preset not in PRESETS:
            rule = f"must be one of {', '.join(map(repr, PRESETS))}{did_you_mean(table.preset, PRESETS)}"
            raise ScenarioError("strengthening.preset", table.preset, rule)
        chosen = preset(table.preset, sampled)
        for family in chosen:
            alpha: Alpha | None = getattr(table, family)
            if alpha is not None:
                chosen[family] = alpha.make(f"strengthening.{family}")
        return chosen

    def families(self) -> Families:
        """All constraints, nothing tightened: the judge of a flight."""
        return Families(self.inspection(), self.strengthening(), exact=True)

    def filter(self, spec: FlightFilter, period: float) -> BatchFilter:
        """Return the filter that a table describes."""
        alpha = self.strengthening(getattr(spec, "sampled_data", True))
        return spec.build(self.inspection(), alpha, period, self.uncertainty())

    def uncertainty(self) -> Uncertainty:
        """Return bounds on uncertain values; none, where the scenario has no tables of it."""
        return Uncertainty(jitter=0.0)

    def _check_filter(self, path: str, spec: FlightFilter, table: str, period: float) -> None:
        """Build a filter once: the conditions between samples bound the control period."""
        if len(set(spec.without)) == len(FAMILY_NAMES):
            raise ScenarioError(f"{path}.without", list(spec.without), "must leave a kind of constraint")
        with in_file_terms(path, spec, period=f"{table}.period_s"):
            self.filter(spec, period)


class FlightScenario(FilteredScenario):
    """One flight of N deputies under a filter."""

    model: models.InspectionModel
    MODEL = models.InspectionModel

    def _check(self) -> None:
        model, initial = self.model, self.model.initial
        self._check_time("flight", model.flight)
        self.inspection()
        self._check_phases([phase.start_s for phase in model.primary])
        if isinstance(initial, models.InitialStates):
            for k, state in enumerate(initial.states):
                check_length(f"initial.states[{k}]", state, 6)
        self.strengthening()
        self.uncertainty()
        self._check_filter("filter", model.filter, "flight", model.flight.period_s)
        if isinstance(initial, models.InitialStates):
            self._check_start(initial)

    def _check_phases(self, starts: list[float]) -> None:
        """Check that the phases of the primary controller follow one another from 0 on."""
        if starts[0] != 0:
            raise ScenarioError("primary[0].start_s", starts[0], "must be 0")
        for k in range(1, len(starts)):
            if starts[k] <= starts[k - 1]:
                rule = f"must be later than the phase before it, {starts[k - 1]:g} s"
                raise ScenarioError(f"primary[{k}].start_s", starts[k], rule)

    def _check_start(self, initial: models.InitialStates) -> None:
        """Check that every constraint holds at the start: a filter keeps a flight safe, it makes none so."""
        (x, sun), q, families = self.initial(), self.inspection(), self.families()
        broken: list[tuple[str, int, float]] = []
        for name, values in allowable(q, x, sun).items():
            deputies = q.pairs[:, 0] if name in ("phi2", "phi5") else np.arange(len(x))
            broken += [(name, int(i), float(v)) for i, v in zip(deputies, values, strict=True) if not v >= 0]
        h = families(x[None], np.array([sun])).h[0]
        for k in np.flatnonzero(~(h >= 0)):
            broken.append((f"{families.labels[k]} ({families.family[k]})", int(families.first[k]), h[k]))
        if broken:
            name, i, value = broken[0]
            rule = f"must satisfy every constraint; {name} is {value:.3g} at the start"
            raise ScenarioError(f"initial.states[{i}]", list(initial.states[i]), rule)

    def outline(self) -> str:
        """Describe the flight on one line."""
        crew, flight = counted(self.deputies, "deputy", "deputies"), self.model.flight
        summary = f"{crew}, {flight.duration_s:g} s in periods of {flight.period_s:g} s"
        return f"{summary}, {self.model.filter.kind} filter"

    @property
    def deputies(self) -> int:
        """Number N of deputies."""
        initial = self.model.initial
        return len(initial.states) if isinstance(initial, models.InitialStates) else initial.deputies

    def initial(self) -> tuple[Array, float]:
        """States of the deputies, shape (N, 6), and the angle of the sun [rad]."""
        initial = self.model.initial
        if isinstance(initial, models.InitialStates):
            return np.array(initial.states, dtype=float), float(np.radians(initial.sun_angle_deg))
        x, sun = InitialConditions(self.families(), initial.seed, block=1024).first(1)
        return x[0], float(sun[0])

    def uncertainty(self) -> Uncertainty:
        """Return bounds on uncertain values."""
        model, push = self.model, self.model.flight.disturbance_max_m_s2
        for table, key in SCHEDULES_ONLY:
            part = getattr(model, table)
            if (value := getattr(part, key)) != type(part).model_fields[key].default:
                raise ScenarioError(f"{table}.{key}", value, "must be left out: it applies to schedules only")
        system = Craft.from_system(replace(self.inspection().system, w_max=push))
        errors = model.thrusters.build(system, model.flight.period_s)
        eta, thrust_error = model.navigation.build(system), errors.error(system.u_max)
        eta = prediction_error(system, eta, thrust_error, model.timing.delay_s)
        bounds = tuple(eta[:3].tolist()), tuple(eta[3:].tolist()), push, errors
        return Uncertainty(*bounds, model.timing.jitter_s)

    def errors(self) -> SampledErrors | None:
        """Return the errors that are flown, if any."""
        bounds, seed = self.uncertainty(), self.model.flight.errors_seed
        return None if bounds.exact else SampledErrors(bounds, self.inspection(), seed)

    def primary(self) -> Primary:
        """Return the primary controller, phase by phase."""
        controllers: list[Primary] = []
        for phase in self.model.primary:
            if isinstance(phase, models.NoThrust):
                controllers.append(NoInput())
            else:
                distance = phase.distance_m if isinstance(phase, models.ToDistance) else 0.0
                controllers.append(LQR(self.inspection(), distance, *_weights(phase)))
        return Phases([phase.start_s for phase in self.model.primary], controllers)


class FuelLimitScenario(InspectionScenario):
    """One deputy and its fuel limit."""

    model: models.FuelLimitModel
    MODEL = models.FuelLimitModel
    deputies = 1

    def _check(self) -> None:
        model, q, start = self.model, self.inspection(), self.model.initial_state
        self._check_time("flight", model.flight)
        check_length("initial_state", start, 6)
        distance = float(np.linalg.norm(start[:3]))
        if distance <= q.separation:
            rule = f"must be farther from the chief than {q.separation:g} m, not {distance:.3g} m"
            raise ScenarioError("initial_state", list(start), rule)
        if model.fuel.spent_m_s > q.delta_v_max:
            rule = f"must not exceed the limit, {q.delta_v_max:g} m/s"
            raise ScenarioError("fuel.spent_m_s", model.fuel.spent_m_s, rule)
        self.backup()

    def outline(self) -> str:
        """Describe the flight on one line."""
        flight, limit = self.model.flight, self.model.parameters.delta_v_max_m_s
        summary = f"1 deputy, {flight.duration_s:g} s in periods of {flight.period_s:g} s"
        return f"{summary}, fuel limit {limit:g} m/s"

    @cached
    def backup(self) -> BackupTracker:
        """Return the backup controller."""
        fuel, q, default = self.model.fuel, self.inspection(), Ellipses.for_inspection(self.inspection())
        limits = {
            "least": fuel.semi_minor_least_m,
            "largest": fuel.semi_minor_largest_m,
            "cross_track": fuel.cross_track_m,
        }
        keys = {"least": "fuel.semi_minor_least_m", "largest": "fuel.semi_minor_largest_m"}
        with in_file_terms("fuel", fuel, period="flight.period_s", **keys):
            ellipses = replace(default, **{name: x for name, x in limits.items() if x is not None})
            return BackupTracker(q, ellipses, self.model.flight.period_s, fuel.response_s)

    def primary(self) -> Primary:
        """Regulators to the outer and to the inner target in turn."""
        q, spec = self.inspection(), self.model.primary
        targets = [LQR(q, spec.distance_m / part, *_weights(spec)) for part in (4, 1)]
        starts = np.arange(0.0, self.model.flight.duration_s, spec.swing_s)
        return Phases(starts.tolist(), [targets[k % 2] for k in range(len(starts))])


class MonteCarloScenario(FilteredScenario):
    """Many flights from drawn initial conditions, for one or more filters."""

    model: models.MonteCarloModel
    MODEL = models.MonteCarloModel

    def _check(self) -> None:
        names = [study.name for study in self.model.studies]
        self._check_time("campaign", self.model.campaign)
        for k, name in enumerate(names):
            if name in names[:k]:
                raise ScenarioError(f"studies[{k}].name", name, "must differ from those before it")
        self.inspection()
        self.strengthening()
        for k, study in enumerate(self.model.studies):
            path, period = f"studies[{k}].filter", self.model.campaign.period_s
            self._check_filter(path, study.filter, "campaign", period)

    def outline(self) -> str:
        """Describe the campaign on one line."""
        plan, crew = self.model.campaign, counted(self.deputies, "deputy", "deputies")
        studies = ", ".join(study.name for study in self.model.studies)
        return f"{counted(plan.runs, 'run')} of {crew} for {plan.duration_s:g} s, studies: {studies}"

    @property
    def deputies(self) -> int:
        """Number N of deputies."""
        return self.model.campaign.deputies


def _weights(table: models.ToChief | models.ToDistance | models.Wasteful) -> tuple[float, float, float]:
    """Weights of position, velocity and thrust."""
    return table.position_weight_1_m2, table.velocity_weight_s2_m2, table.thrust_weight_1_N2
