"""Furthest points of intersections: linear programs, round parts cut by their supporting planes."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from ..numerics.checks import Array
from ..numerics.errors import ReachError
from ..numerics.programs import maximise
from .distance import nearest, unit_sizes
from .lifted import lifted
from .polytope import HPolytope
from .zonotope import Zonotope

CUTS = 30
"""Supporting planes that a round part is given, one after the other, in the search along one direction."""

CLOSE = 1e-8
"""Distance from a round part, in sizes of the sets, at which the search ends."""

DEPTH = 1e-7
"""Depth of the centre, in sizes of the sets, below which an intersection counts as flat."""


class Search:
    """Furthest points of an intersection, and how their direction is split between the parts.

    Parameters
    ----------
    parts : tuple of sets
        At least one of them bounded.
    """

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
        self._asked = [p for p, flat in zip(parts, self.flat, strict=True) if flat is None or _is_rows(p)]
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
        blocks, offsets = [], []
        for part, flat, planes in zip(self.parts, self.flat, self.planes, strict=True):
            if flat is None:
                blocks.append((planes * size, np.zeros((len(planes), 0))))
                offsets.append(part.support(planes) - planes @ self.middle)
            elif _is_rows(part):
                blocks.append((flat.A, np.zeros((len(flat.A), flat.G.shape[1]))))
                offsets.append(flat.b)
            else:
                same, own = np.eye(n), flat.G / size[:, None]
                none = np.zeros((len(flat.A), n))
                shift = (flat.c - self.middle) / size
                blocks.append((np.vstack([same, -same, none]), np.vstack([-own, own, flat.A])))
                offsets.append(np.r_[shift, -shift, flat.b])
        A = np.hstack(
            [np.vstack([block[0] for block in blocks]), block_diag(*(block[1] for block in blocks))]
        )
        b = np.hstack(offsets)
        equal = np.hstack([self._equal(*one) for one in zip(self.parts, self.flat, self.planes, strict=True)])
        room = np.where(equal, 0.0, np.linalg.norm(A, axis=1))[:, None] * float(depth)
        A = np.vstack([np.hstack([A, room]), np.eye(A.shape[1] + 1)[-1:]])
        goal = (
            np.r_[np.zeros(A.shape[1] - 1), 1.0]
            if depth
            else np.r_[direction * size, np.zeros(A.shape[1] - n)]
        )
        found = maximise(goal, A, np.r_[b, 1.0])
        if not np.isfinite(found.value):
            raise ReachError("the intersection has no point, or none that was found")
        point = self.middle + size * found.point[:n]
        rows, at = [], 0
        for block, flat, part in zip(blocks, self.flat, self.parts, strict=True):
            weights = found.multipliers[at : at + len(block[0])]
            at += len(block[0])
            exact = part.A if flat is not None and _is_rows(part) else block[0] / size
            rows.append(weights @ exact)
        return point, np.array(rows), float(found.point[-1])

    def _equal(self, part: Any, flat: Any, planes: Array) -> NDArray[np.bool_]:
        """Which rows of a part say that two points are the same."""
        if flat is None:
            return np.zeros(len(planes), dtype=bool)
        if _is_rows(part):
            return np.zeros(len(flat.A), dtype=bool)
        return np.asarray(np.arange(2 * self.n + len(flat.A)) < 2 * self.n)

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


def _is_rows(part: Any) -> bool:
    """Whether a part is given by inequalities in the coordinates of the whole."""
    return isinstance(part, HPolytope)
