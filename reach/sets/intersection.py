"""Intersections of sets of any kinds: exact by inequalities where all have them, else kept unevaluated."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..numerics.checks import Array
from ..numerics.errors import ReachError
from ..numerics.rounding import gamma
from .convex import weighed
from .interval import Interval
from .lazy import OfParts


class Intersection(OfParts):
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
        """Whether it is proved that there is no point in all parts."""
        from .pairs import disjoint, intersect

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
        """Whether no point is in all parts, as far as that is proved."""
        return self.proved_empty

    @cached_property
    def _search(self) -> Any:
        from .cutting import Search

        return Search(self.parts)

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
        return self._booked(D, 1)

    def _booked(self, D: Array, way: int) -> Array:
        """Up: a bound by splitting each direction. Down: at a point that passes the parts' tests, or -inf."""
        self._refuse_empty()
        rows = D.reshape(-1, self.dim)
        if way > 0:
            return np.array([self._bound(d, self._search.split(d)[1]) for d in rows]).reshape(D.shape[:-1])
        values = np.array([float(d @ self._search.inside(d)) for d in rows])
        booked = weighed(rows, 1e-9 * self.interval_hull().half_widths + gamma(self.dim) * self.extent)
        return np.nan_to_num(values - booked, nan=-np.inf).reshape(D.shape[:-1])

    def _bound(self, d: Array, split: Array) -> float:
        """Sum of the supports of the parts along a split of d; its rounding weighed with the whole."""
        best = min(float(part.support_up(d)) for part in self.parts)
        total, booked = 0.0, np.abs(d - split.sum(axis=0)) + gamma(len(split)) * np.abs(split).sum(axis=0)
        for part, row in zip(self.parts, split, strict=True):
            total += float(part.support_up(row)) if row.any() else 0.0
        total += float(weighed(booked, self.extent)) + gamma(len(split)) * abs(total)
        return min(best, total) if np.isfinite(total) else best

    def _furthest(self, D: Array) -> Array:
        """Points pulled in where there is room."""
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
