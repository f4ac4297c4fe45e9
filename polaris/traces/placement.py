"""Unsafe sets where they are at given times: what distances and times to collision are taken to."""

from dataclasses import dataclass

import daqp
import numpy as np

from ..model.errors import ScenarioError
from ..model.scene.obstacle import entry_while_holding
from ..model.scene.shapes import BallShape, BoxShape, PolytopeShape, Shape
from ..model.system import Array
from ..model.tolerances import ROUNDING
from .model import AnySet, BallTrace, PointTrace, PolytopeTrace
from .settings import between, interpolate, rates


@dataclass(frozen=True, eq=False)
class MovingBall:
    """A ball about 0 whose radius changes; at every instant it is taken to keep the radius of then."""

    radii: Array

    def signed_distance(self, p: Array) -> Array:
        """Distance [m] of positions (N, d), one per time."""
        return BallShape(0.0).signed_distance(p) - self.radii

    def entry_time(self, p: Array, v: Array) -> Array:
        """Seconds until straight rays enter; lengths are scaled so that all radii are 1 (or 0)."""
        out = np.empty(len(p))
        for radius in (0.0, 1.0):
            rows = (self.radii > 0) == (radius > 0)
            scale = self.radii[rows, None] if radius else 1.0
            out[rows] = BallShape(radius).entry_time(p[rows] / scale, v[rows] / scale)
        return out

    def shape_at(self, i: int) -> Shape:
        """The ball at one time."""
        return BallShape(float(self.radii[i]))


@dataclass(frozen=True, eq=False)
class MovingPolytope:
    """A polytope ``H p <= b`` whose facets differ from sample to sample; as they are at every instant."""

    H: Array  # unit rows, shape (N or 1, F, d)
    b: Array  # shape (N, F)

    def signed_distance(self, p: Array) -> Array:
        """Distance [m] of positions (N, d), one per time."""
        worst = np.max(np.einsum("nfd,nd->nf", self._rows(p), p) - self.b, axis=1)
        distance = np.linalg.norm(self.to_nearest(p), axis=1)
        return np.asarray(np.where(worst > 0, np.maximum(distance, worst), worst))

    def to_nearest(self, p: Array) -> Array:
        """Lines (N, d) from positions to the nearest points, 0 inside: one quadratic program each."""
        lines, rows = np.zeros_like(p), self._rows(p)
        slack = self.b - np.einsum("nfd,nd->nf", rows, p)
        scale = np.maximum(-slack.min(axis=1), 0.0)  # in units of the most that a facet is missed by
        none, free = np.zeros(p.shape[1]), np.full(rows.shape[1], -1e30)
        for i in np.flatnonzero(scale):
            top = np.minimum(slack[i] / scale[i], 1e30)
            lines[i] = scale[i] * daqp.solve(np.eye(len(none)), none, rows[i].copy(), top, free)[0]
        return lines

    def _rows(self, p: Array) -> Array:
        return np.broadcast_to(self.H, (len(p), *self.H.shape[1:]))

    def entry_time(self, p: Array, v: Array) -> Array:
        """Seconds until straight rays enter; in the coordinates ``H p`` all facets are the same."""
        reach, rate = (np.einsum("nfd,nd->nf", self._rows(p), x) for x in (p, v))
        return PolytopeShape(np.eye(self.H.shape[1]), self.b).entry_time(reach, rate)

    def shape_at(self, i: int) -> PolytopeShape:
        """The polytope at one time."""
        return PolytopeShape(self.H[i if len(self.H) > 1 else 0], self.b[i])


@dataclass(frozen=True, eq=False)
class UnsafePart:
    """A convex set at N times."""

    body: Shape | MovingBall | MovingPolytope  # relative to its centre; a shape does not change
    centre: Array  # [m], shape (N, d)
    velocity: Array  # [m/s], shape (N, d)

    @property
    def rigid(self) -> bool:
        """Return True if the set moves without changing its shape."""
        return not isinstance(self.body, (MovingBall, MovingPolytope))

    def shape(self, i: int) -> Shape:
        """The set at one time, relative to its centre."""
        return self.body.shape_at(i) if isinstance(self.body, (MovingBall, MovingPolytope)) else self.body


@dataclass(frozen=True, eq=False)
class PlacedParts:
    """A set at N times: the union of convex parts."""

    parts: tuple[UnsafePart, ...]
    times: Array  # [s], shape (N,)
    span: tuple[float, float]  # when it holds [s], as of obstacles

    def signed_distance(self, p: Array) -> Array:
        """Distance [m] of positions (N, d), shape (N,), whether it holds or not."""
        return np.asarray(np.min([part.body.signed_distance(p - part.centre) for part in self.parts], axis=0))

    def entry_time(self, p: Array, v: Array) -> Array:
        """Seconds until straight rays from p (N, d) at v (N, d) are inside while it holds, shape (N,)."""
        rays = ((part.body.entry_time, p - part.centre, v - part.velocity) for part in self.parts)
        return np.asarray(np.min([entry_while_holding(self.span, self.times, *ray) for ray in rays], axis=0))


def place(item: AnySet, t: Array, d: int) -> PlacedParts:
    """The set at times t (N,): centres, sizes, offsets run linearly, at rest before and after all stamps.

    Facets that turn are taken as at both stamps around. Sets of other axes and empty ones are refused.
    """
    if item.d < d or (item.d > d and isinstance(item, PolytopeTrace)):
        raise ScenarioError(f"{item.where}.state_trace[0]", f"{item.d} axes", f"must have {d} (see --dims)")
    if isinstance(item, PolytopeTrace):
        return PlacedParts(_place_polytope(item, t), t, item.span)
    rows = between(item.times, t)
    body: Shape | MovingBall | MovingPolytope = BallShape(0.0)
    if isinstance(item, BallTrace):
        steady = np.all(item.radii == item.radii[0])
        body = BallShape(float(item.radii[0])) if steady else MovingBall(interpolate(item.radii, rows))
    elif not isinstance(item, PointTrace):
        half = item.lengths[:, :d] / 2
        body = BoxShape.from_half_widths(half[0])
        if not np.all(half == half[0]):
            b = interpolate(half, rows)
            body = MovingPolytope(body.H[None], np.hstack([b, b]))
    return PlacedParts((UnsafePart(body, *_centre_motion(item, item.centers[:, :d], t)),), t, item.span)


def _centre_motion(item: AnySet, centers: Array, t: Array) -> tuple[Array, Array]:
    """Centres (N, d) and rates, known or differences; at rest before the first stamp and after the last."""
    rows = between(item.times, t)
    velocities = item.velocities if isinstance(item, BallTrace) else None
    speeds = rates(item.times, centers) if velocities is None else velocities[:, : centers.shape[1]]
    centre = interpolate(centers, rows)
    if speeds is None:
        return centre, np.zeros_like(centre)
    outside = (t < item.times[0]) | (t > item.times[-1])
    return centre, np.where(outside[:, None], 0.0, interpolate(speeds, rows))


def _place_polytope(item: PolytopeTrace, t: Array) -> tuple[UnsafePart, ...]:
    H, b = unit_rows(item.A, item.b)
    local = b[0] - H[0] @ PolytopeShape(H[0], b[0]).middle
    centers = np.einsum("mdf,mf->md", np.linalg.pinv(H), b - local)
    centre, velocity = _centre_motion(item, centers, t)
    slack = b - np.einsum("mfd,md->mf", H, centers)
    for row in np.flatnonzero(slack.min(axis=1) < 0):  # most are cleared by the centre itself
        if MovingPolytope(H, slack).shape_at(int(row)).depth < 0:
            offsets = item.b[row].tolist()
            raise ScenarioError(f"{item.where}.state_trace[{row}]", offsets, "A p <= b must hold somewhere")
    size = np.abs(b).max(axis=1) + np.abs(local).max()
    if len(H) == 1 and np.all(np.abs(slack - local).max(axis=1) <= ROUNDING * size):
        return (UnsafePart(PolytopeShape(H[0], local), centre, velocity),)
    left, right, _ = rows = between(item.times, t)
    if len(H) == 1:
        return (UnsafePart(MovingPolytope(H, interpolate(slack, rows)), centre, velocity),)
    # Where facets turn in between: the union of what the set is at the stamps on either side.
    sides = (left,) if np.array_equal(left, right) else (left, right)
    return tuple(UnsafePart(MovingPolytope(H[k], slack[k]), centers[k], velocity) for k in sides)


def unit_rows(A: Array, b: Array) -> tuple[Array, Array]:
    """Rows ``A p <= b`` scaled to unit length; shapes (M or 1, F, d) and (M, F)."""
    peak = np.abs(A).max(axis=-1, keepdims=True)
    length = np.linalg.norm(A / peak, axis=-1, keepdims=True)
    return A / peak / length, b / (peak * length)[..., 0]
