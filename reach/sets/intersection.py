"""Intersections of sets of any kinds: exact by inequalities where all have them, else kept unevaluated."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from ..numerics.checks import Array
from ..numerics.errors import ReachError
from ..numerics.programs import maximise
from ..numerics.rounding import gamma
from .convex import weighed
from .interval import Interval
from .lazy import CompositeSet
from .polytope import HPolytope
from .relations.distance import nearest, unit_sizes
from .zonotope import Zonotope

CUTS = 30
"""Supporting planes that a round part is given, one after the other, in the search along one direction."""

CLOSE = 1e-8  # distance from a round part, in sizes of the sets, at which the search ends
DEPTH = 1e-7  # depth of the centre, in sizes of the sets, below which an intersection counts as flat


class Intersection(CompositeSet):
    """``{x : x in X_i for all i}``, kept unevaluated.

    Its support is an upper bound: any way to write ``d = d_1 + ... + d_k`` bounds it by the sum of the
    supports of the parts, and the split is sought by linear programs in which round parts are cut by
    their supporting planes. For parts with flat faces it is exact to rounding, with round ones mostly
    to 1e-8 of the size. A point that `support_vector` returns is as close to all parts as that.

    Parameters
    ----------
    parts : tuple of sets of this library
        Single sets of one dimension, at least one of them bounded.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        if not np.all(np.isfinite(self.extent)):
            raise ReachError("one part of an intersection that is not a polytope must be bounded")

    @cached_property
    def extent(self) -> Array:
        """Elementwise bound on the points, before rounding, shape (n,)."""
        return np.asarray(np.min([part.extent for part in self.parts], axis=0))

    @cached_property
    def proved_empty(self) -> bool:
        """True if it is proved that no point is in all parts."""
        from .relations.pairs import disjoint, intersect

        if any(getattr(part, "is_empty", False) and part.proved_empty for part in self.parts):
            return True
        first = self.parts[0]
        for k, part in enumerate(self.parts[1:], 1):
            if disjoint(first, part).holds:
                return True
            first = intersect(first, part) if k + 1 < len(self.parts) else first
        return False

    @property
    def is_empty(self) -> bool:
        """True if it is proved that no point is in all parts; see `proved_empty`."""
        return self.proved_empty

    @cached_property
    def _search(self) -> FurthestSearch:
        return FurthestSearch(self.parts)

    @property
    def center(self) -> Array:
        """A point deep in the set, shape (n,), to the accuracy of the search."""
        self._refuse_empty()
        return np.asarray(self._search.inner[0])

    def _refuse_empty(self) -> None:
        if self.is_empty:
            raise ReachError("the intersection is empty")

    def _support(self, D: Array) -> Array:
        """An upper bound."""
        return self._rounded_support(D, 1)

    def _rounded_support(self, D: Array, sign: int) -> Array:
        """Up: a bound by splitting each direction. Down: at a point that passes the parts' tests, or -inf."""
        self._refuse_empty()
        rows = D.reshape(-1, self.dim)
        if sign > 0:
            return np.array([self._bound(d, self._search.split(d)[1]) for d in rows]).reshape(D.shape[:-1])
        values = np.array([float(d @ self._search.inside(d)) for d in rows])
        allowance = weighed(rows, 1e-9 * self.interval_hull().half_widths + gamma(self.dim) * self.extent)
        return np.nan_to_num(values - allowance, nan=-np.inf).reshape(D.shape[:-1])

    def _bound(self, d: Array, split: Array) -> float:
        """Sum of the supports of the parts along a split of d; its rounding weighed with the whole."""
        bound = min(float(part.support_up(d)) for part in self.parts)
        total, allowance = 0.0, np.abs(d - split.sum(axis=0)) + gamma(len(split)) * np.abs(split).sum(axis=0)
        for part, row in zip(self.parts, split, strict=True):
            total += float(part.support_up(row)) if row.any() else 0.0
        total += float(weighed(allowance, self.extent)) + gamma(len(split)) * abs(total)
        return min(bound, total) if np.isfinite(total) else bound

    def _furthest(self, D: Array) -> Array:
        """Points pulled inside where that is possible."""
        self._refuse_empty()
        out = []
        for d in D.reshape(-1, self.dim):
            point = self._search.inside(d)
            out.append(point if np.all(np.isfinite(point)) else self._search.split(d)[0])
        return np.array(out).reshape(D.shape)

    def interval_hull(self) -> Interval:
        """Box around the set, rounded outwards."""
        return self._hull

    @cached_property
    def _hull(self) -> Interval:
        return super().interval_hull()

    def _holds(self, x: Array, slack: float) -> NDArray[np.bool_]:
        return np.asarray(np.all([part.contains(x, slack) for part in self.parts], axis=0))


class FurthestSearch:
    """Furthest points of an intersection, one part of which is bounded, and how their direction is split."""

    def __init__(self, parts: tuple[Any, ...]) -> None:
        self.parts, self.n = parts, parts[0].dim
        hulls = [part.interval_hull() for part in parts if getattr(part, "is_bounded", True)]
        lo, hi = np.max([hull.lo for hull in hulls], axis=0), np.min([hull.hi for hull in hulls], axis=0)
        smallest = np.min([unit_sizes(hull.half_widths) for hull in hulls], axis=0)
        self.middle, half = (lo + hi) / 2, (hi - lo) / 2
        self.size = np.where(half > 1e-9 * smallest, half, smallest)
        from .relations.separation import lifted

        self.flat = [lifted(part, self.middle, self.size) for part in parts]
        axes = np.vstack([np.eye(self.n), -np.eye(self.n)]) / self.size
        self.planes = [axes if flat is None else np.zeros((0, self.n)) for flat in self.flat]
        # Of other sets with flat faces the program itself gives the coefficients of a point.
        both = zip(parts, self.flat, strict=True)
        self._exact = [part for part, flat in both if flat is None or isinstance(part, HPolytope)]
        self._cache: dict[bytes, tuple[Array, Array]] = {}

    def split(self, direction: Array) -> tuple[Array, Array]:
        """A furthest point (n,), and rows (k, n), one for each part, that sum to the direction."""
        key = direction.tobytes()
        if key not in self._cache:
            if len(self._cache) > 1024:
                self._cache.clear()
            self._cache[key] = self._cut(direction)[:2]
        return self._cache[key]

    def _cut(self, direction: Array, depth: bool = False) -> tuple[Array, Array, float]:
        for _ in range(CUTS):
            point, rows, value = self._solve(direction, depth)
            missed = False
            for j, (part, flat) in enumerate(zip(self.parts, self.flat, strict=True)):
                if flat is not None:
                    continue
                near = nearest(Zonotope.point(point), part, self.size)
                if near.least > CLOSE:
                    plane = -near.direction / np.linalg.norm(near.direction * self.size)
                    self.planes[j] = np.vstack([self.planes[j], plane])
                    missed = True
            if not missed:
                break
        return point, rows, value

    def _solve(self, direction: Array, depth: bool) -> tuple[Array, Array, float]:
        """One linear program in ``(x - middle) / size``, the parts' own coordinates, and a depth."""
        n, size = self.n, self.size
        rows, lifted_rows, offsets, inner = [], [], [], []
        for part, flat, planes in zip(self.parts, self.flat, self.planes, strict=True):
            if flat is None or isinstance(part, HPolytope):
                H, h = (planes, part.support(planes)) if flat is None else (part.A, part.b)
                rows.append(H)
                lifted_rows.append(np.zeros((len(H), 0)))
                offsets.append(h - H @ self.middle)
                inner.append(np.ones(len(H)))
            else:  # two rows for every coordinate say that the points are the same
                axes, G, shift = np.diag(1 / size), flat.G / size[:, None], (flat.c - self.middle) / size
                rows.append(np.vstack([axes, -axes, np.zeros((len(flat.A), n))]))
                lifted_rows.append(np.vstack([-G, G, flat.A]))
                offsets.append(np.r_[shift, -shift, flat.b])
                inner.append(np.r_[np.zeros(2 * n), np.ones(len(flat.A))])
        A = np.hstack([np.vstack(rows) * size, block_diag(*lifted_rows)])
        depths = np.hstack(inner) * np.linalg.norm(A, axis=1) * float(depth)
        A = np.vstack([np.c_[A, depths], np.eye(A.shape[1] + 1)[-1:]])
        goal = np.zeros(A.shape[1])
        goal[:n], goal[-1] = direction * size, float(depth)
        optimum = maximise(goal, A, np.r_[np.hstack(offsets), 1.0])
        if not np.isfinite(optimum.value):
            raise ReachError("the intersection has no point, or none that was found")
        ends = np.cumsum([len(part) for part in rows])
        weights = np.split(optimum.multipliers[: ends[-1]], ends[:-1])
        split = [w @ part for w, part in zip(weights, rows, strict=True)]
        return self.middle + size * optimum.point[:n], np.array(split), float(optimum.point[-1])

    @cached_property
    def inner(self) -> tuple[Array, float]:
        """A point deep in all parts, shape (n,), and about how deep, in their sizes."""
        point, _, value = self._cut(np.zeros(self.n), depth=True)
        return point, value

    def inside(self, direction: Array) -> Array:
        """A furthest point, pulled in so far that it passes the parts' own test; nan if there is none."""
        middle, deep = self.inner
        if not deep > DEPTH:
            return np.full(self.n, np.nan)
        point = self.split(direction)[0]
        for share in (1e-8, 1e-6, 1e-4):
            pulled = point + min(share / deep, 1.0) * (middle - point)
            if all(bool(part.contains(pulled, 1e-10)) for part in self._exact):
                return np.asarray(pulled)
        return np.full(self.n, np.nan)
