"""One call for every filter of an inspection: from a kind and numbers, without nested constructors."""

from collections.abc import Collection, Mapping
from typing import Any

from ...model.checks import one_of
from ...rta.one_call import CallByCall
from ..backup.all_time import AllTime
from ..backup.brake import Brake
from ..backup.planner import Planner
from ..backup.tube import Uncertainty
from ..constraints.families import Families
from ..constraints.motion import SampledData
from ..constraints.strengthening import Strengthening
from ..inspection import Inspection
from .asif import ActiveSetFilter
from .assured import Assured, Explicit, Implicit
from .explicit import CENTRALIZED, make_filter
from .simplex import SimplexExplicit, SimplexImplicit

SIMPLEX: dict[str, type[Assured]] = {"simplex_explicit": SimplexExplicit, "simplex_implicit": SimplexImplicit}
KINDS = ("centralized", "decentralized", "explicit", "implicit", *SIMPLEX)


def build_filter(
    kind: str,
    inspection: Inspection,
    period: float = 1.0,
    strengthening: str | Mapping[str, Strengthening] = "polaris",
    *,
    sun_start: float = 0.0,
    uncertainty: Uncertainty | None = None,
    without: Collection[str] = (),
    sharing: str | None = None,
    sampled: bool = True,
    share: float = 0.5,
    brake: Brake | None = None,
    mixed: bool = False,
    **options: Any,
) -> CallByCall:
    """Return a filter that is called once a period.

    Parameters
    ----------
    kind : str
        ``centralized`` and ``decentralized`` keep the barriers; ``explicit``, ``implicit``,
        ``simplex_explicit`` and ``simplex_implicit`` have a proven answer.
    inspection : Inspection
    period : float
        [s]
    strengthening, without
        As of `Families`.
    sun_start : float
        Angle of the sun at t = 0 [rad].
    uncertainty : Uncertainty, optional
        Its jitter is tolerated by all kinds; of the rest the first two kinds know nothing.
    sharing : str, optional
        As of `Decentralized`; default ``centralized``, of ``decentralized`` ``consensus``.
    sampled, share
        Whether conditions are to hold between samples, and as of `SampledData`.
    brake : Brake, optional
        One that has been made, instead of the period and the uncertainty.
    mixed : bool
        As of `Planner`.
    **options
        Of `SimplexExplicit`, `SimplexImplicit`, or the backup of `ActiveSetFilter`.

    Raises
    ------
    ScenarioError
        If an argument is out of range, or a constraint of one's own is to be proven for all time.
    """
    one_of("kind", kind, KINDS)
    known = brake.uncertainty if brake else uncertainty or Uncertainty()
    tightened = (
        SampledData((brake.period if brake else period) + 2 * known.jitter, share) if sampled else None
    )
    chosen = sharing or ("consensus" if kind == "decentralized" else CENTRALIZED)
    filtering = make_filter(Families(inspection, strengthening, without, tightened), chosen)
    if kind in KINDS[:2]:
        return ActiveSetFilter(filtering, sun_start=sun_start, **options)
    planner = Planner(AllTime(brake or Brake(inspection, period, known), sun_start, without), mixed)
    if kind == "explicit":
        return Explicit(planner, filtering, **options)
    if kind == "simplex_explicit":
        options["families"] = Families(inspection, strengthening, without)
    made = SIMPLEX.get(kind, Implicit)
    return made(planner, recovery=filtering, **options)
