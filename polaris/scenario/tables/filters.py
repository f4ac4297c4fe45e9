"""Models of the tables of a scenario that describe a filter: strengthening functions, kinds of filter."""

from collections.abc import Mapping
from typing import Annotated, Literal, get_args

from ...inspection.backup.brake import Brake
from ...inspection.backup.tube import Uncertainty
from ...inspection.constraints.families import Families
from ...inspection.constraints.motion import SampledData
from ...inspection.constraints.strengthening import Strengthening
from ...inspection.filters.build import build_filter
from ...inspection.filters.explicit import CENTRALIZED, make_filter
from ...inspection.flights.simulation import BatchFilter, OneFlight
from ...inspection.inspection import Inspection
from ...model import keys as f
from ...rta.one_call import RunTimeFilter
from .fields import BY_KIND, Described, ScenarioPart, unit

Family = Literal[
    "chief_separation",
    "deputy_separation",
    "speed",
    "sun",
    "deputy_sun",
    "keep_in",
    "passive",
    "deputy_passive",
    "velocity",
]

FAMILY_NAMES: tuple[str, ...] = get_args(Family)


class Alpha(Described, makes=Strengthening):
    """See `Strengthening`."""


def _alpha() -> Alpha | None:
    """Field of one family of constraints."""
    field: Alpha | None = unit("-", "Functions of h1 to h8, and of h9 to h11 (velocity).", default=None)
    return field


class StrengtheningTable(ScenarioPart):
    """The functions alpha of eq. 7: a named set, with exceptions for kinds of constraint."""

    preset: f.Text = unit("-", default="polaris")
    """Named set. `afrl-one`, `afrl-five`: from the authors' library, for one and five deputies. `afrl`:
    `afrl-five` with the keep-in zone of `afrl-one`. `linear`: 0.3 h. `polaris`: `linear` for sampled-data
    conditions, else `afrl` with faster velocity limits."""
    chief_separation: Alpha | None = _alpha()
    deputy_separation: Alpha | None = _alpha()
    speed: Alpha | None = _alpha()
    sun: Alpha | None = _alpha()
    deputy_sun: Alpha | None = _alpha()
    keep_in: Alpha | None = _alpha()
    passive: Alpha | None = _alpha()
    deputy_passive: Alpha | None = _alpha()
    velocity: Alpha | None = _alpha()


class BarrierFilter(ScenarioPart):
    """Options of all barrier filters."""

    without: tuple[Family, ...] = unit(
        "-", "Kinds of constraint left out, named as in `[strengthening]`.", default=()
    )
    sampled_data: f.Flag = unit("-", default=True)
    """Make conditions hold in the whole control period."""
    sampled_data_share: f.Real = unit("-", default=0.5, gt=0, le=1)
    """Share of a constraint's value that may be lost in a period; less is calmer."""

    def build(
        self, q: Inspection, alpha: Mapping[str, Strengthening], period: float, uncertainty: Uncertainty
    ) -> BatchFilter:
        """Return the filter, for a control period [s]; it takes everything for exact."""
        longest = period + 2 * uncertainty.jitter
        sampled = SampledData(longest, self.sampled_data_share) if self.sampled_data else None
        families = Families(q, alpha, self.without, sampled)
        return make_filter(families, getattr(self, "sharing", CENTRALIZED))


class CentralizedFilter(BarrierFilter):
    """One quadratic program for the thrust of all deputies."""

    kind: Literal["centralized"] = unit("-", "One filter for all deputies.")


class DecentralizedFilter(BarrierFilter):
    """One quadratic program per deputy, which knows the others' states but not their plans."""

    kind: Literal["decentralized"] = unit("-", "A filter for each deputy.")
    sharing: Literal["coasting", "half", "consensus"] = unit("-", default="coasting")
    """Responsibility for conditions on pairs. `coasting`: each alone, as if the other coasts (the paper's).
    `half`: half each. `consensus`: its part of a common solution."""


class AssuredFilter(ScenarioPart):
    """A filter that applies nothing before a plan after it is proven safe for all time: brake, and hold."""

    kind: str
    without: tuple[Family, ...] = unit(
        "-", "Kinds of constraint left out, named as in `[strengthening]`.", default=()
    )

    def build(
        self, q: Inspection, alpha: Mapping[str, Strengthening], period: float, uncertainty: Uncertainty
    ) -> BatchFilter:
        """Return the filter, for a control period [s]."""
        watched, brake = Families(q, alpha, self.without), Brake(q, period, uncertainty)
        self.start(brake, alpha, 0.0)
        return OneFlight(lambda sun: self.start(brake, alpha, sun), watched, period)

    def start(self, brake: Brake, alpha: Mapping[str, Strengthening], sun: float) -> RunTimeFilter:
        """Return the filter of one flight, from an angle of the sun [rad] on."""
        options = self.arguments()
        if "sampled_data_share" in options:
            options["share"] = options.pop("sampled_data_share")
        return build_filter(
            self.kind, brake.inspection, strengthening=alpha, sun_start=sun, brake=brake, **options
        )


class ExplicitFilter(AssuredFilter):
    """The nearest thrust that keeps every barrier."""

    kind: Literal["explicit"] = unit("-", "Barrier conditions, and a proven plan after every answer.")
    sharing: Literal["centralized", "consensus"] = unit("-", default="centralized")
    """One quadratic program (`centralized`), or one per deputy with its part of a common solution
    (`consensus`)."""
    sampled_data_share: f.Real = unit("-", default=0.5, gt=0, le=1)
    """Share of a constraint's value that may be lost in a period; less is calmer."""


class ImplicitFilter(AssuredFilter):
    """The share of the desired thrust after which a plan is proven."""

    kind: Literal["implicit"] = unit("-", "As near to what is wanted as a proven plan allows.")


class _Switching(AssuredFilter):
    """A filter that passes the desired thrust as it is, or hands a deputy over to its plan."""

    dwell_s: f.NonNegative = unit("s", default=30.0)
    """Time at the release values before a deputy is handed back."""


class SimplexExplicitFilter(_Switching):
    """Passes the desired thrust while all barriers keep the margin and a plan after it is proven."""

    kind: Literal["simplex_explicit"] = unit("-", "The desired thrust or the plan's, by the barriers.")
    margin: f.NonNegative = unit("unit of h", "Least value of barriers for passing.", default=0.0)
    release: f.NonNegative = unit("unit of h", default=0.05)
    """Least value of barriers for handing back."""
    looks: f.Whole = unit("-", default=2, ge=1, le=100)
    """Instants of the coming period at which barriers are evaluated."""


class SimplexImplicitFilter(_Switching):
    """Passes the desired thrust while a plan after it is proven."""

    kind: Literal["simplex_implicit"] = unit("-", "The desired thrust or the plan's, by the proof.")
    release_distance_m: f.NonNegative = unit("m", "Least distances for handing back.", default=2.0)
    release_speed_m_s: f.NonNegative = unit("m/s", "Least speed margins for handing back.", default=0.02)


Filter = Annotated[CentralizedFilter | DecentralizedFilter, *BY_KIND]
"""Those of a Monte Carlo: they answer for many runs at once."""

FlightFilter = Annotated[  # filters of one flight
    CentralizedFilter
    | DecentralizedFilter
    | ExplicitFilter
    | ImplicitFilter
    | SimplexExplicitFilter
    | SimplexImplicitFilter,
    *BY_KIND,
]
