"""Base of all obstacles, and the motion of rigid ones."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from ..checks import halfspaces, positive, whole
from ..craft import Craft
from ..errors import ScenarioError, quoted
from ..keys import Key, Matrix, Name, Vector, Whole, check_fields
from ..system import Array, LinearSystem
from ..tolerances import ROUNDING
from .shapes import FLAT, BallShape, PolytopeShape, Shape
from .timed_polytope import TimedPolytope

NAME, FACETS = Key("name", "-", Name), Key("facets", "-", Annotated[Whole, Field(ge=3, le=64)])
"""Keys that several sets have."""


class Obstacle(ABC):
    """A set to stay out of: a convex `shape` (possibly the outside of one) carried by a motion.

    Subclasses are frozen dataclasses with a `name`.

    Attributes
    ----------
    chaser_radius : float
        Radius [m] of a chaser by which the set has been `inflated`; 0 for a point.
    """

    name: str
    chaser_radius = 0.0

    def __post_init__(self) -> None:
        check_fields(self, self.path)

    def inflated(self, radius: float) -> Self:
        """The set that the centre of a chaser within a ball of a radius [m] must stay out of.

        Facets move out by the radius, so at edges and corners it is somewhat larger than needed.
        """
        if not radius > 0:
            return self
        obstacle = self._inflated(radius)
        object.__setattr__(obstacle, "chaser_radius", self.chaser_radius + radius)
        return obstacle

    def _inflated(self, radius: float) -> Self:
        rule = f"must be left out: {type(self).__name__} does not say how it is inflated (_inflated)"
        raise ScenarioError("chaser.radius_m", radius, rule)

    def blurred(self, clock: float, margin: float) -> Self:
        """The set at every time within `clock` [s] of the one that is asked for, grown by `margin` [m]."""
        if clock > 0:
            rule = f"must be 0 with {self.path}, whose place at other times is not bounded"
            raise ScenarioError("timing.clock_error_s", clock, rule)
        return self._inflated(margin) if margin > 0 else self

    @property
    def path(self) -> str:
        """Beginning of error messages."""
        return f"obstacles[{quoted(self.name)}]"

    @property
    def span(self) -> tuple[float, float]:
        """Times [s] between which the set holds: from the first on, until before the second."""
        return -np.inf, np.inf

    @property
    @abstractmethod
    def shape(self) -> Shape:
        """The true set, relative to `centre`."""

    @property
    @abstractmethod
    def drawn(self) -> BallShape | PolytopeShape:
        """Shape in figures, relative to `centre`: the true one, or a polytope for it."""

    @abstractmethod
    def timed_polytopes(self, system: LinearSystem, delta: float, cells: int) -> tuple[TimedPolytope, ...]:
        """Over-approximation over ``[0, cells * delta]``, cells of `delta` [s]."""

    @abstractmethod
    def motion(
        self, t: ArrayLike, system: LinearSystem | None = None, state: ArrayLike | None = None
    ) -> tuple[Array, Array]:
        """Position [m] and velocity [m/s] of the shape's origin at times t [s], shapes (..., d).

        `system`, or the true `state` (..., n), says where another satellite is; other obstacles need neither.
        """

    def centre(
        self, t: ArrayLike, system: LinearSystem | None = None, state: ArrayLike | None = None
    ) -> Array:
        """Position [m] of `motion`."""
        return self.motion(t, system, state)[0]

    def relative_drift(
        self, t: ArrayLike, x: Array, system: LinearSystem, state: ArrayLike | None = None
    ) -> tuple[Array, Array, Array]:
        """Free motion relative to the shape, from states x (..., n) at times t.

        Returns ``(y, c, v)`` such that the relative position s seconds later is
        ``C e^{A s} y - c - v s``; shapes (..., n), (..., d), (..., d).
        """
        return x, *self.motion(t, system, state)

    def signed_distance(
        self, t: ArrayLike, p: ArrayLike, system: LinearSystem | None = None, state: ArrayLike | None = None
    ) -> Array:
        """Distance [m] from positions p (..., d) at times t (broadcast) to the true unsafe set.

        Positive outside it, negative inside (penetration depth), inf while it does not hold. See `motion` for
        `system` and `state`.
        """
        centre = self.centre(t, system, state)
        distance = self.shape.signed_distance(self._positions("p", p, centre) - centre)
        return np.where(is_holding(self.span, t), distance, np.inf)

    def entry_time(
        self,
        t: ArrayLike,
        p: ArrayLike,
        v: ArrayLike,
        system: LinearSystem | None = None,
        state: ArrayLike | None = None,
    ) -> Array:
        """Seconds until a straight ray at velocity v [m/s] is inside while the set holds; inf if never.

        Both keep the velocity they have at time t.
        """
        centre, velocity = self.motion(t, system, state)
        p, v = self._positions("p", p, centre), self._positions("v", v, centre)
        return entry_while_holding(self.span, t, self.shape.entry_time, p - centre, v - velocity)

    def _positions(self, name: str, value: ArrayLike, centre: Array) -> Array:
        array = np.asarray(value, dtype=float)
        d = centre.shape[-1]
        if array.ndim == 0 or array.shape[-1] != d:
            raise ScenarioError(name, array.shape, f"must end with {d} axes, as {self.path} has")
        if not np.all(np.isfinite(array)):
            index = np.argwhere(~np.isfinite(array))[0].tolist()
            raise ScenarioError(name, float(array[tuple(index)]), f"must be finite numbers (entry {index})")
        return array

    def _check_cells(self, system: LinearSystem, delta: float, cells: int, d: int) -> None:
        positive("delta", delta, "s")
        whole("cells", cells, 1)
        if d != system.d:
            raise ScenarioError(self.path, f"{d} axes", f"must have {system.d} axes, as the position has")


class Anchored(Obstacle):
    """A shape of constant size and orientation about an anchor that keeps its velocity."""

    @property
    @abstractmethod
    def anchor(self) -> Array:
        """Position [m] of the shape's origin at t = 0, shape (d,)."""

    @cached_property
    def _v(self) -> Array:
        return np.zeros(len(self.anchor))

    def blurred(self, clock: float, margin: float) -> Self:
        """Grown by how far it moves meanwhile, too."""
        return super().blurred(0.0, margin + clock * float(np.linalg.norm(self._v)) * (1 + ROUNDING))

    def motion(
        self, t: ArrayLike, system: LinearSystem | None = None, state: ArrayLike | None = None
    ) -> tuple[Array, Array]:
        """Position [m] and velocity [m/s], the same at all times."""
        centre = self.anchor + np.asarray(t, dtype=float)[..., None] * self._v
        return centre, np.broadcast_to(self._v, centre.shape)


@dataclass(frozen=True, eq=False)
class Faceted(Anchored):
    """A polytope ``H p <= b`` in absolute position at t = 0, its rows scaled to length 1."""

    name: Annotated[str, NAME]
    H: Annotated[ArrayLike, Key("normals", "-", Matrix, "axis")]
    b: Annotated[ArrayLike, Key("offsets_m", "m", Vector)]

    def __post_init__(self) -> None:
        polytope = solid(self.path, self.H, self.b)
        object.__setattr__(self, "H", polytope.H)
        object.__setattr__(self, "b", polytope.b)
        super().__post_init__()

    @cached_property
    def polytope(self) -> PolytopeShape:
        """The polytope at t = 0."""
        return PolytopeShape(np.asarray(self.H), np.asarray(self.b))

    @cached_property
    def anchor(self) -> Array:
        """The origin: the facets are given in absolute position."""
        return np.zeros(self.polytope.d)


class RigidObstacle(Anchored):
    """A convex set that stands still or moves at constant velocity: state `anchor`, `shape` and `cover`."""

    center: ArrayLike
    velocity: ArrayLike | None

    @property
    def anchor(self) -> Array:
        """Centre at t = 0."""
        return np.asarray(self.center)

    @property
    def cover(self) -> PolytopeShape:
        """Polytope around the shape, relative to its origin; the shape itself if it is one."""
        assert isinstance(self.shape, PolytopeShape)  # others state theirs
        return self.shape

    @property
    def drawn(self) -> BallShape | PolytopeShape:
        """The shape if figures can show it, else its cover."""
        return self.shape if isinstance(self.shape, (BallShape, PolytopeShape)) else self.cover

    @cached_property
    def _v(self) -> Array:
        return np.zeros(len(self.anchor)) if self.velocity is None else np.asarray(self.velocity, dtype=float)

    def state_boxes(self, system: Craft, h: float, count: int) -> tuple[Array, Array]:
        """Box of position [m] and velocity [m/s] every h [s]: middle and half-widths, (count, 2d).

        What is not known of it is how late the clock is by which it moves.
        """
        t, speed = np.arange(count) * h, np.abs(self._v)
        size = np.abs(self.anchor) + t[:, None] * speed
        half = np.hstack([system.timing.clock * speed + ROUNDING * size, ROUNDING * (speed + 0 * size)])
        return np.hstack(self.motion(t)), half

    def timed_polytopes(self, system: LinearSystem, delta: float, cells: int) -> tuple[TimedPolytope, ...]:
        """One timed polytope: the motion is linear in time, so nothing but round-off is added."""
        self._check_cells(system, delta, cells, len(self.anchor))
        t = np.arange(cells + 1)[:, None] * delta
        normals, b = self.cover.H, self.cover.b
        size = np.abs(b) + np.abs(normals) @ np.abs(self.anchor) + t * (np.abs(normals) @ np.abs(self._v))
        nodes = b + normals @ self.anchor + t * (normals @ self._v) + ROUNDING * size
        offsets = np.stack([nodes[:-1], nodes[1:]], axis=1)
        return (TimedPolytope(self.name, normals, offsets, static=not np.any(self._v)),)


def is_holding(span: tuple[float, float], t: ArrayLike) -> NDArray[np.bool_]:
    """Return True for times t [s] at which a set holds; see `Obstacle.span`."""
    return np.asarray((span[0] <= np.asarray(t)) & (np.asarray(t) < span[1]))


def entry_while_holding(
    span: tuple[float, float], t: ArrayLike, entry_time: Callable[[Array, Array], Array], p: Array, v: Array
) -> Array:
    """Return the seconds from times t until rays are inside a set while it holds, inf if never.

    `entry_time` gives the time to the set, holding or not, on rays from relative positions p at velocities v.
    """
    wait = np.asarray(np.maximum(span[0] - np.asarray(t, dtype=float), 0.0))
    entry = wait + entry_time(p + wait[..., None] * v, v)
    return np.where(np.asarray(t) + entry < span[1], entry, np.inf)


def chaser_radius(unsafe: Iterable[Any]) -> float:
    """Radius [m] by which all of some unsafe sets have been grown; 0 where a chaser is a point."""
    return float(min((getattr(item, "chaser_radius", 0.0) for item in unsafe), default=0.0))


def directions(d: int, facets: int | None = None, path: str = "facets") -> Array:
    """Return unit normals, shape (F, d), of a polytope circumscribed about a ball.

    In the plane a regular polygon (default 12 sides, >= 3). In space the faces of a cube (6), with
    its corners cut (14), its edges (18), or both (26, default). On the line always 2.
    """
    if d == 1:
        return np.array([[1.0], [-1.0]])
    if d == 2:
        count = whole(path, 12 if facets is None else facets, 3)
        if count > 360:
            raise ScenarioError(path, count, "must be at most 360")
        angle = 2 * np.pi * np.arange(count) / count
        return np.stack([np.cos(angle), np.sin(angle)], axis=1)
    counts: dict[object, tuple[int, ...]] = {6: (1,), 14: (1, 3), 18: (1, 2), 26: (1, 2, 3), None: (1, 2, 3)}
    if facets not in counts or isinstance(facets, float):
        raise ScenarioError(path, facets, "must be 6, 14, 18 or 26 in three dimensions")
    grid = np.array(list(product((1.0, 0.0, -1.0), repeat=3)))
    normals = grid[np.isin(np.abs(grid).sum(axis=1), counts[facets])]
    normals = normals[np.argsort(np.abs(normals).sum(axis=1), kind="stable")]
    return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))


def solid(path: str, H: ArrayLike, b: ArrayLike) -> PolytopeShape:
    """Build a polytope with unit rows, refused unless it has an interior."""
    polytope = PolytopeShape(*halfspaces(path, H, b))
    if not polytope.depth > 1e-9 * max(float(np.abs(polytope.b).max()), FLAT):
        detail = "no point satisfies them all" if polytope.depth < 0 else "the set has no volume"
        raise ScenarioError(f"{path}.b", polytope.b.tolist(), f"H p <= b must have an interior; {detail}")
    return polytope
