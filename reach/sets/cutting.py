"""Furthest points of intersections: linear programs, round parts cut by their supporting planes."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from ..numerics.checks import Array
from ..numerics.errors import ReachError
from ..numerics.programs import maximise
from .distance import nearest, unit_sizes
from .polytope import HPolytope
from .separation import lifted
from .zonotope import Zonotope

CUTS = 30
"""Supporting planes that a round part is given, one after the other, in the search along one direction."""

CLOSE = 1e-8  # distance from a round part, in sizes of the sets, at which the search ends
DEPTH = 1e-7  # depth of the centre, in sizes of the sets, below which an intersection counts as flat


class Search:
    """Furthest points of an intersection, one part of which is bounded, and how their direction is split."""

    def __init__(self, parts: tuple[Any, ...]) -> None:
        self.parts, self.n = parts, parts[0].dim
        hulls = [
            part.interval_hull()
            for part in parts
            if not (isinstance(part, HPolytope) and not part.is_bounded)
        ]
        lo, hi = np.max([hull.lo for hull in hulls], axis=0), np.min([hull.hi for hull in hulls], axis=0)
        smallest = np.min([unit_sizes(hull.half_widths) for hull in hulls], axis=0)
        self.middle, half = (lo + hi) / 2, (hi - lo) / 2
        self.size = np.where(half > 1e-9 * smallest, half, smallest)
        self.flat = [lifted(part, self.middle, self.size) for part in parts]
        axes = np.vstack([np.eye(self.n), -np.eye(self.n)]) / self.size
        self.planes = [axes if flat is None else np.zeros((0, self.n)) for flat in self.flat]
        # Of other sets with flat faces the program itself gives the coefficients of a point.
        self._asked = [
            p for p, flat in zip(parts, self.flat, strict=True) if flat is None or isinstance(p, HPolytope)
        ]
        self._known: dict[bytes, tuple[Array, Array]] = {}

    def split(self, direction: Array) -> tuple[Array, Array]:
        """A furthest point (n,), and rows (k, n), one for each part, that sum to the direction."""
        key = direction.tobytes()
        if key not in self._known:
            if len(self._known) > 1024:
                self._known.clear()
            self._known[key] = self._cut(direction)[:2]
        return self._known[key]

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
        rows, own, offsets, inner = [], [], [], []
        for part, flat, planes in zip(self.parts, self.flat, self.planes, strict=True):
            if flat is None or isinstance(part, HPolytope):
                H, h = (planes, part.support(planes)) if flat is None else (part.A, part.b)
                rows.append(H)
                own.append(np.zeros((len(H), 0)))
                offsets.append(h - H @ self.middle)
                inner.append(np.ones(len(H)))
            else:  # two rows for every coordinate say that the points are the same
                same, G, shift = np.diag(1 / size), flat.G / size[:, None], (flat.c - self.middle) / size
                rows.append(np.vstack([same, -same, np.zeros((len(flat.A), n))]))
                own.append(np.vstack([-G, G, flat.A]))
                offsets.append(np.r_[shift, -shift, flat.b])
                inner.append(np.r_[np.zeros(2 * n), np.ones(len(flat.A))])
        A = np.hstack([np.vstack(rows) * size, block_diag(*own)])
        room = np.hstack(inner) * np.linalg.norm(A, axis=1) * float(depth)
        A = np.vstack([np.c_[A, room], np.eye(A.shape[1] + 1)[-1:]])
        goal = np.zeros(A.shape[1])
        goal[:n], goal[-1] = direction * size, float(depth)
        found = maximise(goal, A, np.r_[np.hstack(offsets), 1.0])
        if not np.isfinite(found.value):
            raise ReachError("the intersection has no point, or none that was found")
        ends = np.cumsum([len(part) for part in rows])
        split = [
            w @ part for w, part in zip(np.split(found.multipliers[: ends[-1]], ends[:-1]), rows, strict=True)
        ]
        return self.middle + size * found.point[:n], np.array(split), float(found.point[-1])

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
            if all(bool(part.contains(pulled, 1e-10)) for part in self._asked):
                return np.asarray(pulled)
        return np.full(self.n, np.nan)
