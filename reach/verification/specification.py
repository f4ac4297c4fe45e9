"""Requirements on all trajectories, and the verdict on them."""

from dataclasses import dataclass

from ..numerics.checks import Array, as_numbers
from ..numerics.errors import ReachError
from ..sets.polytope import HPolytope
from ..short_repr import short_repr
from ..tubes.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class Specification:
    """Requirement on the state at all times of an interval.

    Parameters
    ----------
    region : HPolytope
        May be unbounded.
    during : tuple of float, optional
        First and last time at which it must hold; the whole horizon if not given. The two may be
        the same.
    """

    region: HPolytope
    during: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.region, HPolytope):
            kind = type(self.region).__name__
            raise ReachError(f"its region must be an HPolytope, got {kind}; use its to_polytope()")
        if self.during is not None and as_numbers("during", self.during).shape != (2,):
            raise ReachError(f"`during` must be two times, got {self.during!r}")


class Always(Specification):
    """The state stays in a polytope."""


class Never(Specification):
    """The state never enters a polytope (its boundary belongs to it)."""


@short_repr
@dataclass(frozen=True, eq=False)
class Verdict:
    """Answer of `verify`; true only if proven.

    Attributes
    ----------
    status : {"proven", "violated", "unknown"}
    margin : float
        Of a proof: distance kept to the limits, in the units of the normals of the region, over
        the lengths of these. Of a violation: how far the trajectory goes beyond them (negative).
        nan if unknown.
    bounds : ndarray, shape (r,)
        Upper bounds on the rows of the region to stay in (`Always`), or on the directions that were
        to separate (`Never`; its rows negated come first), from the last tube computed.
    reached : ndarray, shape (r,)
        Values that trajectories reach in these rows; nan where it was not asked.
    trajectory : Trajectory or None
        Of a violation: initial state and inputs that are admissible, replayed; it ends at the
        instant of the violation.
    steps : int
        Steps of the last tube.
    reason : str
        One sentence.
    seconds : float
        Wall time.
    """

    status: str
    margin: float
    bounds: Array
    reached: Array
    trajectory: Trajectory | None
    steps: int
    reason: str
    seconds: float = 0.0

    def __bool__(self) -> bool:
        return self.status == "proven"
