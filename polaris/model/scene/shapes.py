"""Convex shapes in position space: exact Euclidean signed distance, and when a straight ray enters.

Distances are positive outside a shape and negative inside (penetration depth). All shapes are
closed: touching counts as entering, and round-off in that decision errs towards "enters".
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import ClassVar, Protocol

import numpy as np

from reach.sets.zonotope import Zonotope

from ..errors import ScenarioError
from ..system import Array
from ..tolerances import ROUNDING

FLAT = 1e-3  # least length [m] to which the clearance inside a polytope is compared
CHUNK = 200_000  # numbers held at once while distances and times to a polytope are computed


class Shape(Protocol):
    """Interface of a shape for the metrics (positions relative to its origin)."""

    def signed_distance(self, p: Array) -> Array:
        """Distance [m] of points (..., d), shape (...,)."""

    def entry_time(self, p: Array, v: Array) -> Array:
        """First time [s] at which ``p + s v``, s >= 0, is in the shape: 0 if inside, inf if never."""

    def overlap(self, place: Zonotope) -> float:
        """Largest depth [m] to which some point of a zonotope is in the shape; negative if none is."""


def _directed(v: Array) -> tuple[Array, Array]:
    """Speed (...,) and unit direction (..., d); direction 0 where the speed is 0."""
    peak = np.abs(v).max(axis=-1, keepdims=True)
    scaled = np.divide(v, peak, out=np.zeros_like(v), where=peak > 0)
    length = np.linalg.norm(scaled, axis=-1, keepdims=True)
    return (peak * length)[..., 0], np.divide(scaled, length, out=np.zeros_like(v), where=length > 0)


def _in_time(path: Array, speed: Array) -> Array:
    """Time [s] to cover a path length [m]; inf where the length is inf or the speed is 0."""
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        return np.where((path < np.inf) & (speed > 0), path / speed, np.inf)


def in_parts(measure: Callable[..., Array], width: int, *vectors: Array, most: int = CHUNK) -> Array:
    """Measure stacks of vectors (..., d), so many at a time that `most` numbers are held, shape (...)."""
    stacks = [np.asarray(one, dtype=float) for one in vectors]
    shape = np.broadcast_shapes(*(one.shape[:-1] for one in stacks))
    flat = [np.broadcast_to(one, shape + one.shape[-1:]).reshape(-1, one.shape[-1]) for one in stacks]
    step, out = max(1, most // width), np.empty(len(flat[0]))
    for i in range(0, len(out), step):
        out[i : i + step] = measure(*(one[i : i + step] for one in flat))
    return out.reshape(shape)


@dataclass(frozen=True, eq=False)
class BallShape:
    """``norm(p) <= radius`` [m]."""

    radius: float
    bounded: ClassVar[bool] = True

    def signed_distance(self, p: Array) -> Array:
        """Distance [m] of points (..., d)."""
        return np.asarray(np.linalg.norm(p, axis=-1) - self.radius)

    def entry_time(self, p: Array, v: Array) -> Array:
        """First time [s] on the ray, from the quadratic in its geometric form."""
        p, v = np.broadcast_arrays(np.asarray(p, dtype=float), np.asarray(v, dtype=float))
        speed, way = _directed(v)
        nearest = -np.sum(p * way, axis=-1)
        miss = np.linalg.norm(p + nearest[..., None] * way, axis=-1)
        slack = ROUNDING * (self.radius + np.linalg.norm(p, axis=-1))
        half_chord = np.sqrt(np.maximum(self.radius - miss, 0.0) * (self.radius + miss))
        hit = (miss <= self.radius + slack) & (nearest > 0)
        time = _in_time(np.where(hit, np.maximum(nearest - half_chord, 0.0), np.inf), speed)
        return np.where(self.signed_distance(p) <= 0, 0.0, time)

    def overlap(self, place: Zonotope) -> float:
        """Depth [m] of the point of a zonotope that is nearest to the centre."""
        from scipy.optimize import lsq_linear

        spans, nearest = place.G[:, np.any(place.G != 0, axis=0)], place.c
        if spans.shape[1]:
            nearest = nearest + spans @ lsq_linear(spans, -place.c, bounds=(-1, 1), tol=1e-12).x
        return self.radius - float(np.linalg.norm(nearest))


@dataclass(frozen=True, eq=False)
class PolytopeShape:
    """``H p <= b`` with unit rows, shapes (F, d) and (F,); need not be bounded."""

    H: Array
    b: Array

    @property
    def d(self) -> int:
        """Dimension of position space."""
        return int(self.H.shape[1])

    def signed_distance(self, p: Array) -> Array:
        """Exact Euclidean distance [m] of points (..., d).

        Inside, the depth is the smallest slack. Outside, the dual of the projection is
        ``dist^2 = max r_S' (H_S H_S')^-1 r_S`` over sets S of at most d independent facets with
        multipliers >= 0, where ``r = H p - b``. Every such S gives a lower bound, so that a set
        lost to round-off can only make a distance too small.
        """
        widest = max((index.size for index, _ in self._faces), default=1)
        return in_parts(self._distance, max(widest, len(self.b)), p)

    def _distance(self, p: Array) -> Array:
        r = p @ self.H.T - self.b
        largest = np.asarray(r.max(axis=1))
        outside = largest > 0
        largest[outside] = self._outside(r[outside], largest[outside])
        return largest

    def _outside(self, r: Array, bound: Array) -> Array:
        # Two facets or more matter only where two are violated or the pair bends outwards; testing
        # all faces is as fast as sorting the points first.
        square = bound**2
        for index, inverse in self._faces:
            residuals = r[:, index]
            multipliers = np.einsum("cij,ncj->nci", inverse, residuals)
            value = np.einsum("nci,nci->nc", multipliers, residuals)
            value[np.any(multipliers < 0, axis=-1)] = 0.0
            square = np.maximum(square, value.max(axis=1))
        return np.asarray(np.sqrt(square))

    @cached_property
    def _faces(self) -> list[tuple[Array, Array]]:
        """Sets of s = 2 ... d facets that meet on the polytope, with ``(H_S H_S')^-1``.

        Every non-empty face holds a minimal face, so subsets of what is active there are enough.
        """
        corners, tolerance = self._minimal_faces
        active = np.abs(corners @ self.H.T - self.b) <= 100 * tolerance
        subsets: dict[int, set[tuple[int, ...]]] = {s: set() for s in range(2, self.d + 1)}
        for row in active:
            rows = [int(i) for i in np.flatnonzero(row)]
            for s, sets in subsets.items():
                sets.update(combinations(rows, s))
        faces = []
        for sets in filter(None, subsets.values()):
            index = np.array(sorted(sets))
            gram = np.einsum("cid,cjd->cij", self.H[index], self.H[index])
            independent = np.linalg.eigvalsh(gram)[:, 0] > 1e-11
            if np.any(independent):
                faces.append((index[independent], np.linalg.inv(gram[independent])))
        return faces

    @cached_property
    def _minimal_faces(self) -> tuple[Array, float]:
        """One point on every minimal face (the vertices, if it has any), and the tolerance used [m]."""
        _, values, basis = np.linalg.svd(self.H, full_matrices=False)
        rank = int(np.sum(values > 1e-10))
        rows = self.H @ basis[:rank].T
        gap = self.b - self.H @ self.middle
        tolerance = 1e-10 * max(float(np.abs(gap).max()), float(np.abs(self.b).max()) * 1e-4)
        index = np.array(list(combinations(range(len(self.b)), rank)))
        index = index[np.linalg.svd(rows[index], compute_uv=False)[:, -1] > 1e-7]
        points = np.linalg.solve(rows[index], gap[index][..., None])[..., 0]
        inside = [np.all(part @ rows.T <= gap + tolerance, axis=1) for part in np.array_split(points, 16)]
        return points[np.concatenate(inside)] @ basis[:rank] + self.middle, tolerance

    @cached_property
    def middle(self) -> Array:
        """Centre of a largest inscribed ball, if unbounded of one as wide as the offsets or `FLAT`, (d,)."""
        return self._largest_ball[0]

    @property
    def depth(self) -> float:
        """Radius [m] of that ball; -inf if the polytope is empty."""
        return self._largest_ball[1]

    @cached_property
    def _largest_ball(self) -> tuple[Array, float]:
        from scipy.optimize import linprog

        scale = float(max(np.abs(self.b).max(), FLAT))  # the facets of a wedge may all pass the origin
        cost = np.r_[np.zeros(self.d), -1.0]
        rows = np.c_[self.H, np.ones(len(self.b))]
        bounds = [(None, None)] * self.d + [(None, 1.0)]
        solved = linprog(cost, A_ub=rows, b_ub=self.b / scale, bounds=bounds, method="highs")
        if solved.status != 0:
            return np.zeros(self.d), -np.inf
        return np.asarray(solved.x[:-1] * scale), float(solved.x[-1] * scale)

    @cached_property
    def bounded(self) -> bool:
        """True if it is bounded: the normals positively span the space."""
        from scipy.optimize import linprog

        if np.linalg.matrix_rank(self.H, tol=1e-10) < self.d:
            return False
        count = len(self.b)
        solved = linprog(np.ones(count), A_eq=self.H.T, b_eq=np.zeros(self.d), bounds=[(1, None)] * count)
        return bool(solved.status == 0)

    def vertices(self) -> Array:
        """Vertices of a bounded set, shape (V, d), counter-clockwise in the plane."""
        if not self.bounded:
            raise ScenarioError("polytope", self.H.tolist(), "must be bounded to be drawn")
        points, tolerance = self._minimal_faces
        distinct: list[Array] = []
        for point in points:
            if all(np.abs(point - other).max() > 10 * tolerance for other in distinct):
                distinct.append(point)
        corners = np.array(distinct).reshape(-1, self.d)
        if self.d == 2:
            centred = corners - corners.mean(axis=0)
            corners = corners[np.argsort(np.arctan2(centred[:, 1], centred[:, 0]))]
        return corners

    def _rates(self, p: Array, v: Array, b: Array) -> tuple[Array, Array, Array, Array]:
        speed, way = _directed(v)
        rate = way @ self.H.T
        rate[np.abs(rate) <= ROUNDING] = 0.0
        reach = p @ self.H.T
        return speed, rate, b - reach, ROUNDING * (np.abs(b) + np.linalg.norm(p, axis=-1)[..., None])

    def entry_time(self, p: Array, v: Array) -> Array:
        """First time [s] on the ray, by clipping it against every facet; offsets may differ by ray."""
        return in_parts(self._entry, len(self.H), p, v, self.b)

    def _entry(self, p: Array, v: Array, b: Array) -> Array:
        speed, rate, gap, slack = self._rates(p, v, b)
        with np.errstate(divide="ignore", invalid="ignore"):
            first = np.where(rate < 0, gap / rate, -np.inf).max(axis=-1)
            eased = np.where(rate < 0, (gap + slack) / rate, -np.inf).max(axis=-1)
            last = np.where(rate > 0, (gap + slack) / rate, np.inf).min(axis=-1)
        never = np.any((rate == 0) & (gap + slack < 0), axis=-1)
        hit = ~never & (np.maximum(eased, 0.0) <= last)
        time = _in_time(np.where(hit, np.maximum(first, 0.0), np.inf), speed)
        return np.where(np.all(gap >= 0, axis=-1), 0.0, time)

    def exit_time(self, p: Array, v: Array) -> Array:
        """First time [s] at which the ray touches the boundary from inside; 0 if outside, inf if never."""
        return in_parts(self._exit, len(self.H), p, v, self.b)

    def _exit(self, p: Array, v: Array, b: Array) -> Array:
        speed, rate, gap, _ = self._rates(p, v, b)
        with np.errstate(divide="ignore", invalid="ignore"):
            last = np.where(rate > 0, gap / rate, np.inf).min(axis=-1)
        return np.where(np.any(gap <= 0, axis=-1), 0.0, _in_time(last, speed))

    def overlap(self, place: Zonotope) -> float:
        """Depth [m] of the deepest point of a zonotope; if all are outside, the widest gap at a facet."""
        from scipy.optimize import linprog

        gap = float(np.max(-place.support(-self.H) - self.b))  # one facet has all of it beyond
        if gap > 0:
            return -gap
        g, clearance = place.order_count, self.b - self.H @ place.c
        if g == 0:
            return float(np.min(clearance))
        rows = np.hstack([self.H @ place.G, np.ones((len(self.H), 1))])
        solved = linprog(np.r_[np.zeros(g), -1.0], rows, clearance, bounds=[(-1, 1)] * g + [(None, None)])
        return float(-solved.fun) if solved.status == 0 else -np.inf


@dataclass(frozen=True, eq=False)
class BoxShape(PolytopeShape):
    """Axis-aligned box about the origin, distances in closed form."""

    @classmethod
    def from_half_widths(cls, half_widths: Array) -> "BoxShape":
        """Return the box with half widths [m], shape (d,)."""
        eye = np.eye(len(half_widths))
        return cls(np.vstack([eye, -eye]), np.r_[half_widths, half_widths])

    def signed_distance(self, p: Array) -> Array:
        """Distance [m] of points (..., d)."""
        beyond = np.abs(p) - self.b[: self.d]
        outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=-1)
        return np.asarray(outside + np.minimum(beyond.max(axis=-1), 0.0))
