"""From the table of a filter to the filter itself."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from .filter_tables import (
    BarrierFilter,
    DecentralizedFilter,
    ExplicitSimplexFilter,
    FlightFilter,
    ImplicitSimplexFilter,
)

if TYPE_CHECKING:
    from ..inspection.constraints.strengthening import Strengthening
    from ..inspection.filters.decision import RunTimeFilter
    from ..inspection.flights.simulation import BatchFilter
    from ..inspection.inspection import Inspection


def build_filter(
    spec: FlightFilter, inspection: Inspection, strengthening: Mapping[str, Strengthening], period: float
) -> BatchFilter:
    """The filter that a table describes, for a control period [s]."""
    if isinstance(spec, BarrierFilter):
        return _barrier_filter(spec, inspection, strengthening, period)
    return _backup_filter(spec, inspection, strengthening, period)


def _barrier_filter(
    spec: BarrierFilter, q: Inspection, alpha: Mapping[str, Strengthening], period: float
) -> BatchFilter:
    from ..inspection.constraints.families import Families
    from ..inspection.constraints.motion import SampledData
    from ..inspection.filters.explicit import CENTRALIZED, make_filter

    sampled = SampledData(period, spec.sampled_data_share) if spec.sampled_data else None
    families = Families(q, alpha, spec.without, sampled)
    return make_filter(families, spec.sharing if isinstance(spec, DecentralizedFilter) else CENTRALIZED)


def _backup_filter(
    spec: FlightFilter, q: Inspection, alpha: Mapping[str, Strengthening], period: float
) -> BatchFilter:
    from ..inspection.backup.parking import Parking
    from ..inspection.constraints.families import Families
    from ..inspection.filters.explicit import Centralized
    from ..inspection.filters.implicit import ImplicitASIF
    from ..inspection.filters.one_flight import OneFlight
    from ..inspection.filters.simplex import ExplicitSimplex, Guarded, ImplicitSimplex

    assert not isinstance(spec, BarrierFilter)
    law, watched = Parking(q, period=period, response=spec.response_s), Families(q, alpha, spec.without)

    def start(sun: float) -> RunTimeFilter:
        if isinstance(spec, ExplicitSimplexFilter):
            backup, limits = Guarded(Centralized(watched), law, sun), (spec.margin, spec.release)
            return ExplicitSimplex(watched, backup, period, *limits, spec.dwell_s, sun, spec.looks)
        if isinstance(spec, ImplicitSimplexFilter):
            release = (spec.release_distance_m, spec.release_speed_m_s)
            return ImplicitSimplex(q, law, spec.horizon_s, *release, spec.dwell_s, sun, spec.without)
        return ImplicitASIF(q, law, spec.horizon_s, spec.rate_1_s, sun, spec.without)

    return OneFlight(start, watched, period)
