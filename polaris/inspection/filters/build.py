"""One call for every filter of an inspection: from a kind and numbers, without nested constructors."""

from collections.abc import Collection, Mapping
from inspect import signature
from typing import Any

from ...model.checks import of_kind, one_of, positive
from ...model.errors import ScenarioError
from ...rta.one_call import CallByCall
from ..backup.all_time import AllTime
from ..backup.brake import Brake
from ..backup.planner import BackupPlanner
from ..backup.tube import Uncertainty
from ..constraints.families import Families
from ..constraints.motion import SampledData
from ..constraints.strengthening import Strengthening
from ..inspection import Inspection
from .asif import ActiveSetFilter
from .assured import Assured, Explicit, Implicit
from .explicit import CENTRALIZED, SHARINGS, make_filter
from .simplex import SimplexExplicit, SimplexImplicit

SIMPLEX: dict[str, type[Assured]] = {"simplex_explicit": SimplexExplicit, "simplex_implicit": SimplexImplicit}
OPTIONS: dict[str, tuple[str, ...]] = {
    "centralized": ("backup",),
    "decentralized": ("backup",),
    "explicit": (),
    "implicit": (),
    "simplex_explicit": ("margin", "release", "dwell", "looks"),
    "simplex_implicit": ("release_distance", "release_speed", "dwell"),
}
"""Further options of each kind."""

KINDS = tuple(OPTIONS)


def build_filter(
    kind: str,
    inspection: Inspection,
    period: float | None = None,
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
    period : float, optional
        [s]; default 1 s.
    strengthening, without
        As of `Families`.
    sun_start : float
        Angle of the sun at t = 0 [rad].
    uncertainty : Uncertainty, optional
        Its jitter is tolerated by all kinds; of the rest the first two kinds know nothing.
    sharing : str, optional
        As of `Decentralized`, or ``centralized``, which is the default of all kinds but ``decentralized``:
        ``consensus``.
    sampled, share
        Whether conditions are to hold between samples, and as of `SampledData`.
    brake : Brake, optional
        One that has been made, instead of the period and the uncertainty.
    mixed : bool
        As of `BackupPlanner`; the first two kinds have none.
    **options
        Of `SimplexExplicit`, `SimplexImplicit`, or the backup of `ActiveSetFilter`: see `OPTIONS`.

    Raises
    ------
    ScenarioError
        If an argument is of another kind or out of range, no option of the filter, or contradicts the brake.
        If a constraint of one's own is to be proven for all time.
    """
    one_of("kind", kind, KINDS)
    for name, value in options.items():
        if name not in OPTIONS[kind]:
            parameters = [one for one in signature(build_filter).parameters if one != "options"]
            rule = f"is no option of {kind!r}: must be one of {', '.join([*parameters[2:], *OPTIONS[kind]])}"
            raise ScenarioError(name, value, rule)
    for name, flag in (("sampled", sampled), ("mixed", mixed)):
        of_kind(name, flag, bool)
    of_kind("inspection", inspection, Inspection)
    of_kind("brake", brake, Brake | None)
    of_kind("uncertainty", uncertainty, Uncertainty | None)
    for name, value in (("period", period), ("uncertainty", uncertainty)):
        if brake is not None and value is not None:
            raise ScenarioError(name, value, "must be left out with brake, which has its own")
    if brake is not None and brake.inspection != inspection:
        raise ScenarioError("brake", brake.inspection, "must be for the problem of the filter")
    bounds = brake.uncertainty if brake else uncertainty or Uncertainty()
    length = brake.period if brake else positive("period", 1.0 if period is None else period, "s")
    default = "consensus" if kind == "decentralized" else CENTRALIZED
    chosen = default if sharing is None else sharing
    sharings = (CENTRALIZED, *SHARINGS)
    one_of("sharing", chosen, {"centralized": sharings[:1], "decentralized": SHARINGS}.get(kind, sharings))
    tightened = SampledData(length + 2 * bounds.jitter, share) if sampled else None
    filtering = make_filter(Families(inspection, strengthening, without, tightened), chosen)
    if kind in KINDS[:2]:
        if mixed:
            raise ScenarioError("mixed", mixed, f"must be false, as {kind!r} has no plans")
        return ActiveSetFilter(filtering, sun_start=sun_start, **options)
    planner = BackupPlanner(AllTime(brake or Brake(inspection, length, bounds), sun_start, without), mixed)
    if kind == "explicit":
        return Explicit(planner, filtering, **options)
    if kind == "simplex_explicit":
        options["families"] = Families(inspection, strengthening, without)
    filter_class = SIMPLEX.get(kind, Implicit)
    return filter_class(planner, recovery=filtering, **options)
