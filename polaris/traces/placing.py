"""Unsafe sets where they are at given times: what distances and times to collision are taken to."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from ..model.errors import ScenarioError
from ..model.shapes import Ball, Box, Polytope, Shape
from ..model.system import Array
from ..model.tolerances import ROUNDING
from .facets import facet_distance, facet_entry, turned, unit_rows
from .model import AnySet, BallTrace, PointTrace, PolytopeTrace
from .motion import between, interpolate, rates


class Placed(Protocol):
    """A set at N times."""

    @property
    def parts(self) -> tuple[Part, ...]:
        """Convex sets of which it is the union."""
        ...

    def signed_distance(self, p: Array) -> Array:
        """Distance [m] of positions (N, d), shape (N,)."""
        ...

    def entry_time(self, p: Array, v: Array) -> Array:
        """Seconds until straight rays from p (N, d) at v (N, d) enter, shape (N,)."""
        ...


class Part(Protocol):
    """A convex set at N times."""

    @property
    def centre(self) -> Array:
        """Origin of the shape [m], shape (N, d)."""
        ...

    @property
    def velocity(self) -> Array:
        """Its rate [m/s], shape (N, d)."""
        ...

    def shape(self, i: int) -> Shape:
        """The set at one time, relative to its centre."""
        ...


PartT = TypeVar("PartT")


class _Whole:
    """A set that is its own and only part."""

    @property
    def parts(self: PartT) -> tuple[PartT]:
        """See `Placed`."""
        return (self,)


@dataclass(frozen=True, eq=False)
class Rigid(_Whole):
    """A shape that only moves."""

    body: Shape
    centre: Array
    velocity: Array

    def signed_distance(self, p: Array) -> Array:
        """See `Placed`."""
        return self.body.signed_distance(p - self.centre)

    def entry_time(self, p: Array, v: Array) -> Array:
        """See `Placed`."""
        return self.body.entry_time(p - self.centre, v - self.velocity)

    def shape(self, i: int) -> Shape:
        """See `Placed`."""
        return self.body


@dataclass(frozen=True, eq=False)
class Swelling(_Whole):
    """A ball whose radius changes; at every instant it is taken to keep the radius of then."""

    radii: Array
    centre: Array
    velocity: Array

    def signed_distance(self, p: Array) -> Array:
        """See `Placed`."""
        return Ball(0.0).signed_distance(p - self.centre) - self.radii

    def entry_time(self, p: Array, v: Array) -> Array:
        """See `Placed`; lengths are scaled so that all radii are 1 (or 0)."""
        out = np.empty(len(p))
        for radius in (0.0, 1.0):
            rows = (self.radii > 0) == (radius > 0)
            scale = self.radii[rows, None] if radius else 1.0
            off, rate = (p - self.centre)[rows] / scale, (v - self.velocity)[rows] / scale
            out[rows] = Ball(radius).entry_time(off, rate)
        return out

    def shape(self, i: int) -> Shape:
        """See `Placed`."""
        return Ball(float(self.radii[i]))


@dataclass(frozen=True, eq=False)
class Faceted(_Whole):
    """A polytope whose facets change otherwise than by moving along; as they are at every instant.

    Attributes
    ----------
    H, b : ndarray, shapes (N or 1, F, d) and (N, F)
        Unit rows, relative to `centre`.
    """

    H: Array
    b: Array
    centre: Array
    velocity: Array

    def signed_distance(self, p: Array) -> Array:
        """See `Placed`."""
        return facet_distance(self.H, self.b, p - self.centre)

    def entry_time(self, p: Array, v: Array) -> Array:
        """See `Placed`."""
        return facet_entry(self.H, self.b, p - self.centre, v - self.velocity)

    def shape(self, i: int) -> Shape:
        """See `Placed`."""
        return Polytope(self.H[i if len(self.H) > 1 else 0], self.b[i])


@dataclass(frozen=True, eq=False)
class Either:
    """The union of what a set is at the stamps on either side, where its facets turn in between."""

    one: Faceted
    other: Faceted

    @property
    def parts(self) -> tuple[Faceted, Faceted]:
        """See `Placed`."""
        return self.one, self.other

    def signed_distance(self, p: Array) -> Array:
        """See `Placed`."""
        return np.minimum(self.one.signed_distance(p), self.other.signed_distance(p))

    def entry_time(self, p: Array, v: Array) -> Array:
        """See `Placed`."""
        return np.minimum(self.one.entry_time(p, v), self.other.entry_time(p, v))


def place(item: AnySet, t: Array, d: int) -> Placed:
    """The set at times t, shape (N,).

    Centres and sizes, and offsets of facets that do not turn, run linearly from stamp to stamp. Facets
    that turn are taken as they are at both stamps around. Before the first stamp and after the last the
    set is at rest there.

    Raises
    ------
    ScenarioError
        If the set has fewer than d axes, is a polytope with more, or is empty.
    """
    if item.d < d or (item.d > d and isinstance(item, PolytopeTrace)):
        raise ScenarioError(f"{item.where}.state_trace[0]", f"{item.d} axes", f"must have {d} (see --dims)")
    if isinstance(item, PolytopeTrace):
        return _place_polytope(item, t)
    rows = between(item.times, t)
    centre, velocity = _moved(item, item.centers[:, :d], t)
    if isinstance(item, PointTrace):
        return Rigid(Ball(0.0), centre, velocity)
    if isinstance(item, BallTrace):
        if np.all(item.radii == item.radii[0]):
            return Rigid(Ball(float(item.radii[0])), centre, velocity)
        return Swelling(interpolate(item.radii, rows), centre, velocity)
    half = item.lengths[:, :d] / 2
    if np.all(half == half[0]):
        return Rigid(Box.of(half[0]), centre, velocity)
    b = interpolate(half, rows)
    return Faceted(Box.of(half[0]).H[None], np.hstack([b, b]), centre, velocity)


def _moved(item: AnySet, centers: Array, t: Array) -> tuple[Array, Array]:
    """Centres (N, d) and rates, known or differences; at rest before the first stamp and after the last."""
    rows = between(item.times, t)
    known = item.velocities if isinstance(item, BallTrace) else None
    speeds = rates(item.times, centers) if known is None else known[:, : centers.shape[1]]
    centre = interpolate(centers, rows)
    if speeds is None:
        return centre, np.zeros_like(centre)
    away = (t < item.times[0]) | (t > item.times[-1])
    return centre, np.where(away[:, None], 0.0, interpolate(speeds, rows))


def _place_polytope(item: PolytopeTrace, t: Array) -> Placed:
    H, b = unit_rows(item.A, item.b)
    first = Polytope(H[0], b[0])
    if first.depth < 0:
        raise ScenarioError(
            f"{item.where}.state_trace[0]", item.b[0].tolist(), "A p <= b must hold somewhere"
        )
    local = b[0] - H[0] @ first.middle
    centers = np.einsum("mdf,mf->md", np.linalg.pinv(H), b - local)
    centre, velocity = _moved(item, centers, t)
    rest = b - np.einsum("mfd,md->mf", H, centers)
    _not_empty(item, H, rest)
    size = np.abs(b).max(axis=1) + np.abs(local).max()
    if len(H) == 1 and np.all(np.abs(rest - local).max(axis=1) <= ROUNDING * size):
        return Rigid(Polytope(H[0], local), centre, velocity)
    left, right, share = rows = between(item.times, t)
    if len(H) == 1:
        return Faceted(H, interpolate(rest, rows), centre, velocity)
    one, other = (Faceted(H[k], rest[k], centers[k], velocity) for k in (left, right))
    return one if np.array_equal(left, right) else Either(one, other)


def _not_empty(item: PolytopeTrace, H: Array, rest: Array) -> None:
    """Refuse a row that no point satisfies; most are cleared by the centre itself."""
    for row in np.flatnonzero(rest.min(axis=1) < 0):
        if Polytope(turned(H, int(row)), rest[row]).depth < 0:
            given = item.b[row].tolist()
            raise ScenarioError(f"{item.where}.state_trace[{row}]", given, "A p <= b must hold somewhere")
