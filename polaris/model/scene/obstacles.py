"""The perception oracle: the sets to avoid, over-approximated by timed polytopes (Definition 2).

Every obstacle gives both sides of the bargain: `timed_polytopes`, which proofs and the planner rely
on and which contain the true set at every instant of every cell, and the true set itself
(`signed_distance`, `entry_time`), against which simulated runs are judged.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from ..errors import ScenarioError
from ..keys import Flag, Key, Positive, Vector, WidthVector
from ..system import LinearSystem
from .obstacle import FACETS, NAME, Faceted, Obstacle, RigidObstacle, directions
from .shapes import BallShape, BoxShape, PolytopeShape
from .timed_polytope import TimedPolytope

CENTER, VELOCITY = Key("center_m", "m", Vector, "axis"), Key("velocity_m_s", "m/s", Vector, "axis")
"""Keys of rigid obstacles."""


@dataclass(frozen=True, eq=False)
class BoxObstacle(RigidObstacle):
    """An axis-aligned box, at rest or moving straight.

    Parameters
    ----------
    name : str
        Name.
    center : array_like, shape (d,) [m]
        Centre at t = 0.
    half_widths : array_like, shape (d,) [m]
        Half-widths.
    velocity : array_like, shape (d,) [m/s], optional
        Constant velocity.
    """

    name: Annotated[str, NAME]
    center: Annotated[ArrayLike, CENTER]
    half_widths: Annotated[ArrayLike, Key("half_widths_m", "m", WidthVector, "axis")]
    velocity: Annotated[ArrayLike | None, VELOCITY] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        half = np.asarray(self.half_widths)
        if np.any(half <= 0):
            raise ScenarioError(f"{self.path}.half_widths", half.tolist(), "must all be > 0 [m]")

    @cached_property
    def shape(self) -> BoxShape:
        """The box, about its centre."""
        return BoxShape.from_half_widths(np.asarray(self.half_widths))

    def _inflated(self, radius: float) -> "BoxObstacle":
        return replace(self, half_widths=np.asarray(self.half_widths) + radius)


@dataclass(frozen=True, eq=False)
class BallObstacle(RigidObstacle):
    """A ball, at rest or moving straight.

    Parameters
    ----------
    name : str
        Name.
    center : array_like, shape (d,) [m]
        Centre at t = 0.
    radius : float [m]
        Radius.
    velocity : array_like, shape (d,) [m/s], optional
        Constant velocity.
    facets : int, optional
        Facets for the planner: 6, 14, 18 or 26 (default) in space, any number in the plane (default 12).
    """

    name: Annotated[str, NAME]
    center: Annotated[ArrayLike, CENTER]
    radius: Annotated[float, Key("radius_m", "m", Positive)]
    velocity: Annotated[ArrayLike | None, VELOCITY] = None
    facets: Annotated[int | None, FACETS] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        directions(len(self.anchor), self.facets, f"{self.path}.facets")

    @cached_property
    def shape(self) -> BallShape:
        """The ball, about its centre."""
        return BallShape(self.radius)

    @cached_property
    def cover(self) -> PolytopeShape:
        """The circumscribed polytope."""
        normals = directions(len(self.anchor), self.facets, f"{self.path}.facets")
        return PolytopeShape(normals, np.full(len(normals), self.radius))

    def _inflated(self, radius: float) -> "BallObstacle":
        return replace(self, radius=self.radius + radius)


@dataclass(frozen=True, eq=False)
class PolytopeObstacle(Faceted, RigidObstacle):
    """The positions p with ``H p <= b``, at rest or moving straight.

    Parameters
    ----------
    name : str
        Name.
    H : array_like, shape (F, d)
        Outward facet normals, of any length.
    b : array_like, shape (F,) [m]
        Offsets at t = 0.
    velocity : array_like, shape (d,) [m/s], optional
        Constant velocity.
    unbounded : bool
        True allows an unbounded set, such as a wall.

    Notes
    -----
    H and b are scaled so that the rows of H have length 1.
    """

    velocity: Annotated[ArrayLike | None, VELOCITY] = None
    unbounded: Annotated[bool, Key("unbounded", "-", Flag)] = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.unbounded and not self.shape.bounded:
            rule = "must bound the set (or unbounded = true)"
            raise ScenarioError(f"{self.path}.H", self.shape.H.tolist(), rule)

    @property
    def shape(self) -> PolytopeShape:
        """The polytope at t = 0."""
        return self.polytope

    def _inflated(self, radius: float) -> "PolytopeObstacle":
        return replace(self, b=np.asarray(self.b) + radius)


def perceive(
    obstacles: Sequence[Obstacle], system: LinearSystem, delta: float, cells: int
) -> tuple[TimedPolytope, ...]:
    """Timed polytopes that contain every unsafe set, in the order given, over some cells of `delta` [s].

    Each facet of a keep-in set becomes one set with ``keep_in=True``. `ScenarioError` if two share a name, or
    one does not fit the system.
    """
    names: set[str] = set()
    for obstacle in obstacles:
        if obstacle.name in names:
            raise ScenarioError(f"{obstacle.path}.name", obstacle.name, "must differ from the other names")
        names.add(obstacle.name)
    sets = [obstacle.timed_polytopes(system, delta, cells) for obstacle in obstacles]
    return tuple(polytope for several in sets for polytope in several)
