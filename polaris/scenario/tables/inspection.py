"""Models of the scenario files of the inspection problem: one class per table, units in the names.

These models know the rules of a single field. Rules that join several fields are in
`polaris.scenario.inspection`. Defaults are the paper's Table 1 where it gives a value.
"""

from typing import Annotated, Literal

from pydantic import Field

from ...inspection.inspection import Inspection
from ...model import keys as f
from .errors import ThrustersTable, TimingTable
from .fields import BY_KIND, Described, Head, ScenarioPart, unit
from .filters import Filter, FlightFilter, StrengtheningTable
from .navigation import EstimateTable

MOST_PERIODS = 200_000  # most control periods of one flight


class Parameters(Described, makes=Inspection):
    """See `Inspection`."""


class InitialStates(ScenarioPart):
    """Given states."""

    kind: Literal["states"] = unit("-", "Given states.")
    states: Annotated[tuple[f.Vector, ...], Field(min_length=1, max_length=50)] = unit("m, m/s")
    """One list `[r_x, r_y, r_z, v_x, v_y, v_z]` per deputy, in Hill's frame."""
    sun_angle_deg: f.Number = unit("deg", default=0.0)
    """Initial angle of the sun from the x axis; it turns at -n."""


class InitialSample(ScenarioPart):
    """Latin hypercube samples that satisfy every constraint."""

    kind: Literal["latin_hypercube"] = unit("-", "Drawn states and sun angle.")
    deputies: f.Whole = unit("-", "Number N.", default=5, ge=1, le=50)
    seed: f.Seed = unit("-", "Seed.", default=0)


Initial = Annotated[InitialStates | InitialSample, *BY_KIND]


class FlightTime(ScenarioPart):
    """Duration and steps."""

    duration_s: f.Positive = unit("s", "Duration.", default=3000.0)
    period_s: f.Positive = unit("s", "Control period, which divides duration_s.", default=1.0)
    between: f.Whole = unit("-", default=4, ge=0, le=99)
    """Additional instants per period at which constraints are evaluated."""
    disturbance_max_m_s2: f.NonNegative = unit("m/s^2", default=0.0)
    """Bound on the 2-norm of the disturbance."""
    errors_seed: f.Seed = unit("-", default=0)
    """Seed of estimate errors, thruster errors and disturbance, drawn at their bounds."""


class NoThrust(ScenarioPart):
    """No thrust."""

    kind: Literal["none"] = unit("-", "No thrust.")
    start_s: f.NonNegative = unit("s", "Start of this controller.", default=0.0)


class _Regulator(ScenarioPart):
    """A linear-quadratic regulator; the larger its weight of position, the more aggressive."""

    start_s: f.NonNegative = unit("s", "Start of this controller.", default=0.0)
    position_weight_1_m2: f.Positive = unit("1/m^2", "Position weight.", default=1.0)
    velocity_weight_s2_m2: f.NonNegative = unit("s^2/m^2", "Velocity weight.", default=1.0)
    thrust_weight_1_N2: f.Positive = unit("1/N^2", "Thrust weight.", default=1.0)


class ToChief(_Regulator):
    """A linear-quadratic regulator to the chief."""

    kind: Literal["to_chief"] = unit("-", "To the chief.")


class ToDistance(_Regulator):
    """A linear-quadratic regulator to a distance in the present direction."""

    kind: Literal["to_distance"] = unit("-", "To a distance from the chief, in the direction it is in.")
    distance_m: f.Positive = unit("m", "Distance from the chief.")


Primary = Annotated[NoThrust | ToChief | ToDistance, *BY_KIND]
Phases = Annotated[tuple[Primary, ...], Field(min_length=1, max_length=100)]


class _Scene(Head):
    """Tables of every inspection scenario."""

    kind: str
    parameters: Parameters = unit("-", "Table 1.", default_factory=Parameters)


class _Filtered(_Scene):
    """Tables of flights under barrier filters."""

    strengthening: StrengtheningTable = unit("-", default_factory=StrengtheningTable)
    """The functions alpha of eq. 7."""


class InspectionModel(_Filtered):
    """Deputies about a chief, one flight under a barrier filter."""

    kind: Literal["inspection"] = unit("-", "One flight of N deputies under a filter.")
    filter: FlightFilter = unit("-", "Filter of the primary controller's thrust.")
    initial: Initial = unit("-", "Initial states.")
    flight: FlightTime = unit("-", "Length and control period.", default_factory=FlightTime)
    navigation: EstimateTable = unit("-", "Errors of the estimated states.", default_factory=EstimateTable)
    thrusters: ThrustersTable = unit("-", "Errors of the thrusters.", default_factory=ThrustersTable)
    timing: TimingTable = unit("-", "Delay and jitter of the filter.", default_factory=TimingTable)
    primary: Phases = unit("-", "Primary controllers, one after another.")


class FuelTable(ScenarioPart):
    """The latched switching filter of eq. 39 for `delta_v_max_m_s`, with its backup (eqs. 40, 41)."""

    response_s: f.Positive = unit("s", "Time constant of the backup.", default=20.0)
    semi_minor_least_m: f.Positive | None = unit("m", default=None)
    """Least semi-minor axis of a parking orbit; by default 1.5 (r_d + r_c)."""
    semi_minor_largest_m: f.Positive | None = unit("m", default=None)
    """Largest semi-minor axis; by default from the other limits."""
    cross_track_m: f.Positive | None = unit("m", default=None)
    """Largest cross-track amplitude; by default from the other limits."""
    keep_clear: f.Flag = unit("-", default=True)
    """The predicted flight must also keep clear of the chief (not in eq. 39)."""
    spent_m_s: f.NonNegative = unit("m/s", "Delta-v used before the start.", default=0.0)
    predictions: f.Whole = unit("-", "Backup flights in figures.", default=12, ge=0, le=200)


class Wasteful(ScenarioPart):
    """An aggressive regulator that flies out and back to spend fuel."""

    distance_m: f.Positive = unit("m", "Outer distance; the inner is a quarter of it.", default=400.0)
    swing_s: f.Real = unit("s", "Time between changes of the target.", default=400.0, ge=1, le=1e6)
    position_weight_1_m2: f.Positive = unit("1/m^2", "Position weight.", default=1e-6)
    velocity_weight_s2_m2: f.NonNegative = unit("s^2/m^2", "Velocity weight.", default=0.0)
    thrust_weight_1_N2: f.Positive = unit("1/N^2", "Thrust weight.", default=1.0)


class FuelFlight(ScenarioPart):
    """Duration and steps."""

    duration_s: f.Positive = unit("s", "Duration.", default=7000.0)
    period_s: f.Positive = unit("s", "Control period, which divides duration_s.", default=1.0)


class FuelLimitModel(_Scene):
    """One deputy flown into its fuel limit, until the backup controller takes over for good."""

    kind: Literal["fuel_limit"] = unit("-", "One deputy and its fuel limit.")
    initial_state: f.Vector = unit("m, m/s", "`[r_x, r_y, r_z, v_x, v_y, v_z]` in Hill's frame.")
    flight: FuelFlight = unit("-", "Length and control period.", default_factory=FuelFlight)
    primary: Wasteful = unit("-", "The primary controller.", default_factory=Wasteful)
    fuel: FuelTable = unit("-", "The switching filter and its backup.", default_factory=FuelTable)


class Study(ScenarioPart):
    """One filter, flown from every initial condition."""

    name: f.Name = unit("-", "Unique name.")
    filter: Filter = unit("-", "The filter.")


class Campaign(ScenarioPart):
    """Runs from drawn initial conditions, without thrust of the primary controller."""

    deputies: f.Whole = unit("-", "Number N.", default=5, ge=1, le=50)
    runs: f.Whole = unit("-", default=2000, ge=1, le=1_000_000)
    """Number of initial conditions."""
    seed: f.Seed = unit("-", "Seed.", default=0)
    duration_s: f.Positive = unit("s", "Duration.", default=500.0)
    period_s: f.Positive = unit("s", "Control period, which divides duration_s.", default=1.0)


class MonteCarloModel(_Filtered):
    """Many flights from drawn initial conditions, for one or more filters (`polaris campaign`)."""

    kind: Literal["monte_carlo"] = unit("-", "Many flights.")
    campaign: Campaign = unit("-", "Number and length of runs.", default_factory=Campaign)
    studies: Annotated[tuple[Study, ...], Field(min_length=1, max_length=20)] = unit("-")
    """Filters compared on equal initial conditions."""
