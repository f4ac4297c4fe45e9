"""Keep-in sets: corridors and line-of-sight cones, which the chaser must not leave."""

from abc import abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from reach.sets.zonotope import Zonotope

from ..errors import ScenarioError, quoted
from ..keys import Key, Positive, Real, Vector
from ..system import Array, LinearSystem
from ..tolerances import ROUNDING
from .obstacle import FACETS, NAME, Anchored, Faceted
from .shapes import PolytopeShape, Shape, _directed, _in_time
from .timed_polytope import TimedPolytope

FAR = 1000.0  # times as far out is a set in steps in which it does not hold

INSTANT = 1e-9  # share of a step by which instants may differ and count as one

MOST_CORNERS = 8192  # of a zonotope that is compared with a cone corner by corner


def during(
    begins: float | Array, ends: float, start: Array, step: float, before: float = 0.0
) -> NDArray[np.bool_]:
    """Return True for steps from `start` [s] that the span [begins, ends) meets, or met `before` earlier."""
    slack = INSTANT * step
    return np.asarray((begins < start + step - slack) & ~(ends <= start - before + slack))


@dataclass(frozen=True, eq=False)
class Outside:
    """The closed outside of a convex polytope."""

    inner: PolytopeShape

    def signed_distance(self, p: Array) -> Array:
        """Distance [m] to leaving the polytope; negative once outside it."""
        return -self.inner.signed_distance(p)

    def entry_time(self, p: Array, v: Array) -> Array:
        """First time [s] at which the ray leaves the polytope."""
        return self.inner.exit_time(p, v)

    def overlap(self, place: Zonotope) -> float:
        """Return how far [m] some point of a zonotope is beyond a facet."""
        return float(np.max(place.support(self.inner.H) - self.inner.b))


@dataclass(frozen=True, eq=False)
class OutsideCone:
    """The closed outside of a solid circular cone, cut at a length [m] along its axis (inf if not cut).

    The axis is a unit vector from the apex (the origin) into the cone, shape (d,) with d = 2 or 3; the half
    angle is in (0, pi/2) [rad].
    """

    axis: Array
    half_angle: float
    length: float

    @cached_property
    def _section(self) -> PolytopeShape:
        """The cone in the half plane of (along, across), mirrored."""
        s, c = np.sin(self.half_angle), np.cos(self.half_angle)
        H, b = [[-s, c], [-s, -c]], [0.0, 0.0]
        if np.isfinite(self.length):
            H, b = [*H, [1.0, 0.0]], [*b, self.length]
        return PolytopeShape(np.array(H), np.array(b))

    def _split(self, p: Array) -> tuple[Array, Array]:
        along = p @ self.axis
        return along, p - along[..., None] * self.axis

    def signed_distance(self, p: Array) -> Array:
        """Distance [m] to leaving the cone; negative once outside it. Exact in the plane of the axis."""
        along, across = self._split(np.asarray(p, dtype=float))
        return -self._section.signed_distance(np.stack([along, np.linalg.norm(across, axis=-1)], axis=-1))

    def entry_time(self, p: Array, v: Array) -> Array:
        """First time [s] at which the ray leaves the cone: the quadratic's first positive root."""
        p, v = np.broadcast_arrays(np.asarray(p, dtype=float), np.asarray(v, dtype=float))
        speed, way = _directed(v)
        (z, across), (rate, drift) = self._split(p), self._split(way)
        slope = np.tan(self.half_angle) ** 2
        a = np.sum(drift**2, axis=-1) - slope * rate**2
        half = np.sum(across * drift, axis=-1) - slope * z * rate
        c = np.minimum(np.sum(across**2, axis=-1) - slope * z**2, 0.0)  # < 0 strictly inside
        q = -(half + np.copysign(np.sqrt(np.maximum(half**2 - a * c, 0.0)), half))
        with np.errstate(divide="ignore", invalid="ignore"):
            roots = np.stack([q / a, c / q])
            end = np.where(rate > 0, (self.length - z) / rate, np.inf)
        roots[~(roots > 0)] = np.inf
        side = np.where(half**2 - a * c >= 0, roots.min(axis=0), np.inf)
        return np.where(self.signed_distance(p) <= 0, 0.0, _in_time(np.minimum(side, end), speed))

    def overlap(self, place: Zonotope) -> float:
        """Return how far [m] a zonotope's corner (if many, an end of its generators) is out of the cone."""
        few = 2 ** int(np.any(place.G != 0, axis=0).sum()) <= MOST_CORNERS
        ends = place.corners(MOST_CORNERS) if few else place.c + np.hstack([place.G, -place.G]).T
        return -float(self.signed_distance(ends).min())


class KeepIn(Anchored):
    """A set at rest that the chaser must stay inside; its outside is unsafe."""

    @property
    def path(self) -> str:
        """Beginning of error messages."""
        return f"keep_in[{quoted(self.name)}]"

    @property
    @abstractmethod
    def inside(self) -> PolytopeShape:
        """Polytope within the set, in absolute position."""

    @cached_property
    def drawn(self) -> PolytopeShape:
        """The polytope within."""
        return PolytopeShape(self.inside.H, self.inside.b - self.inside.H @ self.anchor)

    def timed_polytopes(self, system: LinearSystem, delta: float, cells: int) -> tuple[TimedPolytope, ...]:
        """One unsafe halfspace ``n p >= b`` per facet, named ``name[f]``."""
        self._check_cells(system, delta, cells, len(self.anchor))
        H, b = self.inside.H, self.inside.b
        limit = -b + ROUNDING * (np.abs(b) + np.abs(H) @ np.abs(self.anchor))
        return tuple(
            TimedPolytope(f"{self.name}[{f}]", -H[f : f + 1], np.full((cells, 2, 1), limit[f]), keep_in=True)
            for f in range(len(b))
        )


@dataclass(frozen=True, eq=False)
class KeepInPolytope(Faceted, KeepIn):
    """The chaser must stay where ``H p <= b``.

    Parameters
    ----------
    name : str
        Name.
    H : array_like, shape (F, d)
        Outward facet normals, of any length.
    b : array_like, shape (F,) [m]
        Offsets.
    begins, ends : float
        When it holds [s]; in proofs for whole steps, and `FAR` times as far out in all others.

    Notes
    -----
    H and b are scaled so that the rows of H have length 1.
    """

    begins: float = -np.inf
    ends: float = np.inf

    def timed_polytopes(self, system: LinearSystem, delta: float, cells: int) -> tuple[TimedPolytope, ...]:
        """As of all keep-in sets, in the steps in which it holds."""
        timed = super().timed_polytopes(system, delta, cells)
        holds = during(self.begins, self.ends, np.arange(cells, dtype=float) * delta, delta)
        if holds.all() and self.ends == np.inf:
            return timed
        static = all(limit < cells * delta for limit in (self.begins, self.ends) if limit != np.inf)
        factor = np.where(holds, 1.0, FAR)[:, None, None]
        return tuple(replace(one, offsets=one.offsets * factor, static=static) for one in timed)

    @property
    def span(self) -> tuple[float, float]:
        """From `begins` until `ends`."""
        return self.begins, self.ends

    def _inflated(self, radius: float) -> "KeepInPolytope":
        return replace(self, b=np.asarray(self.b) - radius)

    @property
    def inside(self) -> PolytopeShape:
        """The polytope."""
        return self.polytope

    @cached_property
    def shape(self) -> Shape:
        """Outside of the set."""
        return Outside(self.inside)


@dataclass(frozen=True, eq=False)
class KeepInCone(KeepIn):
    """A line-of-sight cone to stay inside; the planner uses a polyhedral cone inside.

    Parameters
    ----------
    name : str
        Name.
    apex : array_like, shape (d,), d = 2 or 3 [m]
        Apex.
    axis : array_like, shape (d,)
        Direction in which the cone opens.
    half_angle_rad : float [rad]
        Angle between axis and surface.
    facets : int
        Facets of the inner cone in space.
    length : float [m], optional
        Height at which the cone ends; by default endless.

    Notes
    -----
    The polytope inside has its edges on the true cone, so it is smaller: by ``1 - cos(pi/facets)``
    of the tangent of the half angle at most. In the plane it is exact.
    """

    name: Annotated[str, NAME]
    apex: Annotated[ArrayLike, Key("apex_m", "m", Vector, "axis")]
    axis: Annotated[ArrayLike, Key("axis", "-", Vector, "axis")]
    half_angle_rad: Annotated[float, Key("half_angle_deg", "deg", Annotated[Real, Field(ge=0.1, le=89)])]
    facets: Annotated[int, FACETS] = 12
    length: Annotated[float | None, Key("length_m", "m", Positive)] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.anchor) == 1:
            raise ScenarioError(f"{self.path}.apex", self.anchor.tolist(), "a cone needs 2 or 3 axes")
        axis = np.asarray(self.axis)
        if not np.any(axis):
            raise ScenarioError(f"{self.path}.axis", axis.tolist(), "must not be zero")
        object.__setattr__(self, "axis", _directed(axis)[1])

    def _inflated(self, radius: float) -> "KeepInCone":
        """The cone of the points at least the radius from its sides: its apex moves along the axis."""
        inwards = radius / np.sin(self.half_angle_rad)
        length = None if self.length is None else self.length - radius - inwards
        if length is not None and length <= 0:
            rule = f"must leave something of {self.path}, which is {self.length:g} m long"
            raise ScenarioError("chaser.radius_m", radius, rule)
        return replace(self, apex=self.anchor + inwards * np.asarray(self.axis), length=length)

    @property
    def anchor(self) -> Array:
        """The apex."""
        return np.asarray(self.apex)

    @cached_property
    def shape(self) -> Shape:
        """The outside of the true cone."""
        length = np.inf if self.length is None else float(self.length)
        return OutsideCone(np.asarray(self.axis), float(self.half_angle_rad), length)

    @cached_property
    def inside(self) -> PolytopeShape:
        """The inscribed cone, in absolute position."""
        axis = np.asarray(self.axis)
        aside = np.linalg.svd(axis[None])[2][1:]  # orthonormal, across the axis
        if len(self.anchor) == 2:
            outward, narrow = np.vstack([aside, -aside]), 1.0
        else:
            angle = 2 * np.pi * (np.arange(self.facets) + 0.5) / self.facets
            outward = np.outer(np.cos(angle), aside[0]) + np.outer(np.sin(angle), aside[1])
            narrow = float(np.cos(np.pi / self.facets))
        lean = np.tan(self.half_angle_rad) * narrow
        H = (outward - lean * axis) / np.hypot(1.0, lean)
        b = H @ self.anchor
        if self.length is not None:
            H, b = np.vstack([H, axis]), np.r_[b, axis @ self.anchor + self.length]
        return PolytopeShape(H, b)
