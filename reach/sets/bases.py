"""Maxima over a polytope along many directions: bases found once serve every direction in their cone."""

from __future__ import annotations

from fractions import Fraction
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..numerics.checks import Array
from ..numerics.programs import Maximum, maximise
from ..numerics.rounding import mixture

EXACT_MOST = 24  # largest dimension in which inequalities are mixed without rounding
MOST_BASES = 4096  # bases kept
INSIDE = 1e-11  # a multiplier above minus this, rows scaled alike, counts as not negative
OUTSIDE = 1e-10  # a vertex may break a row by this share of the sizes of its terms
FEW = 4  # directions up to which each is one linear program
ENTRIES = 2_000_000  # numbers handled at once


class Bases:
    """Vertices of ``{A x <= b}``, each with n rows that meet in it and the inverse of these.

    A direction that is a mixture of the n rows with weights >= 0 attains its maximum there, and the
    weights are the multipliers of the linear program. Nothing is proved here: what the multipliers
    prove is re-checked by weak duality.
    """

    def __init__(self, A: Array, b: Array) -> None:
        self.A, self.b, n = A, b, A.shape[1]
        self.columns = np.abs(A).max(axis=0, initial=0.0)
        self.columns = np.where(self.columns > 0, self.columns, 1.0)
        self.norms = np.linalg.norm(A / self.columns, axis=1)
        self.rows = A / self.columns / self.norms[:, None]
        self.members = np.zeros((0, n), dtype=np.intp)
        self.inverses, self.points = np.zeros((0, n, n)), np.zeros((0, n))
        self.program = lru_cache(1024)(lambda direction: maximise(np.frombuffer(direction), A, b))

    def answers(self, D: Array) -> tuple[Array, Array, Array]:
        """Values (...), points (..., n) and multipliers (..., m) of the largest along directions (..., n)."""
        rows, shape = D.reshape(-1, D.shape[-1]), D.shape[:-1]
        if len(rows) > FEW:
            values, points, multipliers = self.maxima(rows)
        else:
            solved = [self.program(d.tobytes()) for d in rows]
            values = np.array([one.value for one in solved])
            points = np.array([one.point for one in solved])
            multipliers = np.array([one.multipliers for one in solved])
        return values.reshape(shape), points.reshape(D.shape), multipliers.reshape((*shape, len(self.b)))

    def _add(self, members: NDArray[np.intp]) -> None:
        """Keep the bases that have a well-conditioned inverse."""
        if not len(members):
            return
        squares = self.rows[members]
        sizes = np.linalg.svd(squares, compute_uv=False)
        good = sizes[:, -1] > 1e-9 * sizes[:, 0]
        members, squares = members[good], squares[good]
        inverses = np.linalg.inv(squares)
        offsets = (self.b / self.norms)[members]
        points = (inverses @ offsets[..., None])[..., 0] / self.columns
        beyond = (points * self.columns) @ self.rows.T - self.b / self.norms
        grain = np.abs(points * self.columns) @ np.abs(self.rows).T + np.abs(self.b) / self.norms
        good = np.all(beyond <= OUTSIDE * grain, axis=1)
        members, inverses, points = members[good], inverses[good], points[good]
        self.members = np.vstack([self.members, members])
        self.inverses = np.concatenate([self.inverses, inverses])
        self.points = np.vstack([self.points, points])

    def maxima(self, D: Array) -> tuple[Array, Array, Array]:
        """Values (r,), points (r, n), multipliers (r, m) along rows; an unknown cone costs a program."""
        r, (m, n) = len(D), self.A.shape
        values, points, multipliers = np.full(r, np.nan), np.full((r, n), np.nan), np.zeros((r, m))
        scaled = D / self.columns
        sizes = np.abs(scaled).max(axis=1, initial=0.0)
        scaled = scaled / np.where(sizes > 0, sizes, 1.0)[:, None]
        pending, tried = np.arange(r), 0
        while len(pending):
            untried, count = self.inverses[tried:], len(self.members)
            span = max(1, ENTRIES // max(len(untried) * n, 1))
            for chunk in np.split(pending, range(span, len(pending), span)) if len(untried) else ():
                # Where many facets meet in one vertex, another basis of it has the direction in its cone.
                weights = np.einsum("rn,fnk->rfk", scaled[chunk], untried)
                best = weights.min(axis=2).argmax(axis=1)
                weights = weights[np.arange(len(chunk)), best]
                good = weights.min(axis=1) >= -INSIDE * np.abs(weights).max(axis=1)
                solved, basis, weights = chunk[good], tried + best[good], np.maximum(weights[good], 0.0)
                points[solved] = self.points[basis]
                values[solved] = (D[solved] * points[solved]).sum(axis=1)
                rows = self.members[basis]
                multipliers[solved[:, None], rows] = weights * sizes[solved, None] / self.norms[rows]
            pending, tried = pending[np.isnan(values[pending])], count
            if len(pending):
                at, pending = pending[0], pending[1:]
                maximum = self.program(D[at].tobytes())
                values[at], points[at], multipliers[at] = maximum.value, maximum.point, maximum.multipliers
                if np.isfinite(maximum.value) and count < MOST_BASES:
                    self._add(self.basis(maximum))
        return values, points, multipliers

    def basis(self, maximum: Maximum) -> NDArray[np.intp]:
        """N independent rows that meet in the solution of a linear program, those with multipliers first."""
        n = self.A.shape[1]
        gap = self.b / self.norms - self.rows @ (maximum.point * self.columns)
        room = 1e-9 * (np.abs(self.b) / self.norms + np.abs(self.rows) @ np.abs(maximum.point * self.columns))
        used = maximum.multipliers * self.norms
        order = np.lexsort((gap, -used))
        picked: list[int] = []
        frame = np.zeros((0, n))
        for i in order[(used[order] > 0) | (gap[order] <= room[order])]:
            residual = self.rows[i] - (frame @ self.rows[i]) @ frame
            length = float(np.linalg.norm(residual))
            if length > 1e-7:
                picked, frame = [*picked, int(i)], np.vstack([frame, residual / length])
            if len(picked) == n:
                return np.asarray([picked], dtype=np.intp)
        return np.zeros((0, n), dtype=np.intp)

    def proves(self, row: Array, offset: float) -> bool:
        """Return True if rows, mixed without rounding, show ``row . x <= offset`` for all points (Farkas)."""
        if self.A.shape[1] > EXACT_MOST:
            return False
        if np.any(np.all(row == self.A, axis=1) & (self.b <= offset)):
            return True
        maximum = self.program(np.asarray(row, dtype=float).tobytes())
        if not np.isfinite(maximum.value):
            return False
        for used in (*self.basis(maximum), np.flatnonzero(maximum.multipliers > 0)):
            level = mixed_level(self.A[used], self.b[used], row) if len(used) <= self.A.shape[1] else None
            if level is not None and level <= Fraction(offset):
                return True
        return False


def mixed_level(rows: Array, levels: Array, target: Array) -> Fraction | None:
    """Level of the mixture of rows, with weights >= 0 and without rounding, that is a target row."""
    weights = mixture(rows, target)
    if weights is None or min(weights, default=0) < 0:
        return None
    return sum((w * Fraction(b) for w, b in zip(weights, levels, strict=True)), Fraction(0))
