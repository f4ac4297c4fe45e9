"""What is asked of all trajectories, and the answer."""

from __future__ import annotations

from dataclasses import dataclass

from ..numerics.checks import Array, as_numbers
from ..numerics.errors import ReachError
from ..sets.polytope import HPolytope
from ..tubes.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class Always:
    """The state stays in a polytope.

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
        _checked(self)


@dataclass(frozen=True, eq=False)
class Never:
    """The state never enters a polytope (its boundary belongs to it).

    Parameters
    ----------
    region : HPolytope
        May be unbounded.
    during : tuple of float, optional
        As for `Always`.
    """

    region: HPolytope
    during: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        _checked(self)


def _checked(spec: Always | Never) -> None:
    """Refuse what is no region, and what are no two times."""
    if not isinstance(spec.region, HPolytope):
        given = type(spec.region).__name__
        raise ReachError(f"its region must be an HPolytope, got {given}; use its to_polytope()")
    if spec.during is not None and as_numbers("during", spec.during).shape != (2,):
        raise ReachError(f"`during` must be two times, got {spec.during!r}")


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
        What trajectories reach in these rows; nan where it was not asked.
    trajectory : Trajectory or None
        Of a violation: initial state and inputs that are admissible, replayed; it ends at the
        instant of the violation.
    steps : int
        Steps of the last tube.
    seconds : float
        Wall time.
    reason : str
        One sentence.
    """

    status: str
    margin: float
    bounds: Array
    reached: Array
    trajectory: Trajectory | None
    steps: int
    seconds: float
    reason: str

    def __bool__(self) -> bool:
        return self.status == "proven"
