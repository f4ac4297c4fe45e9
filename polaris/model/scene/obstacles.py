"""The perception oracle: what must be avoided, over-approximated by timed polytopes (Definition 2).

Every obstacle gives both sides of the bargain: `timed_polytopes`, which proofs and the planner rely
on and which contain the true set at every instant of every cell, and the true set itself
(`signed_distance`, `entry_time`), against which simulated runs are judged.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ..checks import positive, vector
from ..errors import ScenarioError
from ..system import Array, LinearSystem
from .obstacle import Obstacle, RigidObstacle, directions, solid
from .shapes import Ball, Box, Polytope
from .timed_polytope import TimedPolytope


@dataclass(frozen=True, eq=False)
class BoxObstacle(RigidObstacle):
    """Axis-aligned box.

    Parameters
    ----------
    name : str
        What tables, figures and messages call it.
    center, half_widths : array_like, shape (d,)
        Centre at t = 0 and half widths [m], > 0.
    velocity : array_like, shape (d,), optional
        Constant velocity [m/s]; default at rest.
    """

    name: str
    center: ArrayLike
    half_widths: ArrayLike
    velocity: ArrayLike | None = None

    def __post_init__(self) -> None:
        center = vector(f"{self.path}.center", self.center)
        half = vector(f"{self.path}.half_widths", self.half_widths, len(center), "center has")
        if np.any(half <= 0):
            raise ScenarioError(f"{self.path}.half_widths", half.tolist(), "must all be > 0 [m]")
        self._put(len(center), center=center, half_widths=half)

    @cached_property
    def shape(self) -> Box:
        """The box, about its centre."""
        return Box.of(np.asarray(self.half_widths))

    def _grown(self, radius: float) -> "BoxObstacle":
        return replace(self, half_widths=np.asarray(self.half_widths) + radius)


@dataclass(frozen=True, eq=False)
class BallObstacle(RigidObstacle):
    """Ball, covered by a circumscribed polytope.

    Parameters
    ----------
    name : str
        What tables, figures and messages call it.
    center : array_like, shape (d,)
        Centre at t = 0 [m].
    radius : float
        [m], > 0.
    velocity : array_like, shape (d,), optional
        Constant velocity [m/s]; default at rest.
    facets : int, optional
        See `directions`. More facets are tighter and cost the planner more.
    """

    name: str
    center: ArrayLike
    radius: float
    velocity: ArrayLike | None = None
    facets: int | None = None

    def __post_init__(self) -> None:
        center = vector(f"{self.path}.center", self.center)
        radius = positive(f"{self.path}.radius", self.radius, "m")
        directions(len(center), self.facets, f"{self.path}.facets")
        self._put(len(center), center=center, radius=radius)

    @cached_property
    def shape(self) -> Ball:
        """The ball, about its centre."""
        return Ball(self.radius)

    @cached_property
    def cover(self) -> Polytope:
        """The circumscribed polytope."""
        normals = directions(len(self.anchor), self.facets, f"{self.path}.facets")
        return Polytope(normals, np.full(len(normals), self.radius))

    def _grown(self, radius: float) -> "BallObstacle":
        return replace(self, radius=self.radius + radius)


@dataclass(frozen=True, eq=False)
class PolytopeObstacle(RigidObstacle):
    """Any convex polytope ``H p <= b`` with an interior.

    Parameters
    ----------
    name : str
        What tables, figures and messages call it.
    H, b : array_like, shapes (F, d) and (F,)
        Facets at t = 0, b in m per unit of row length; rows are scaled to unit length.
    velocity : array_like, shape (d,), optional
        Constant velocity [m/s]; default at rest.
    unbounded : bool
        Must be True for a set that is not bounded (a wall, a wedge): one that is so by a forgotten
        row is refused.
    """

    name: str
    H: ArrayLike
    b: ArrayLike
    velocity: ArrayLike | None = None
    unbounded: bool = False

    def __post_init__(self) -> None:
        polytope = solid(self.path, self.H, self.b)
        if not self.unbounded and not polytope.bounded:
            rule = "must bound the set (or unbounded = true)"
            raise ScenarioError(f"{self.path}.H", polytope.H.tolist(), rule)
        self._put(polytope.d, H=polytope.H, b=polytope.b)

    @cached_property
    def shape(self) -> Polytope:
        """The polytope at t = 0."""
        return Polytope(np.asarray(self.H), np.asarray(self.b))

    def _grown(self, radius: float) -> "PolytopeObstacle":
        return replace(self, b=np.asarray(self.b) + radius)

    @cached_property
    def anchor(self) -> Array:
        """The origin: the facets are given in absolute position."""
        return np.zeros(self.shape.d)


def perceive(
    obstacles: Sequence[Obstacle], system: LinearSystem, delta: float, cells: int
) -> tuple[TimedPolytope, ...]:
    """Timed polytopes that contain every unsafe set, in the order given, over some cells of `delta` [s].

    Each facet of a keep-in set becomes one set with ``keep_in=True``. `ScenarioError` if two share a name, or
    one does not fit the system.
    """
    seen: set[str] = set()
    for obstacle in obstacles:
        if obstacle.name in seen:
            raise ScenarioError(f"{obstacle.path}.name", obstacle.name, "must differ from the other names")
        seen.add(obstacle.name)
    found = [obstacle.timed_polytopes(system, delta, cells) for obstacle in obstacles]
    return tuple(polytope for several in found for polytope in several)
