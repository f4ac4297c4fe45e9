"""Small programs of `polaris.rta.projection` by a dual active-set method in loops, for numba to compile.

What it answers satisfies every row to `PRIMAL` and the conditions of optimality; whatever does not, also a
program without a solution, is left to the solver.
"""

from __future__ import annotations

import numpy as np

from ..model.compiled import compiled
from ..model.system import Array

PRIMAL = 1e-11
"""As in `polaris.rta.projection`."""

DESIRED, FILTERED, LEFT = 0, 1, -1
"""How an input came about: as in `polaris.rta.projection`, or left to the solver."""

MET = 1e-13
"""Violation of a row of length 1 at which the method stops."""


@compiled
def alone(
    G: Array, bounds: Array, mine: Array, sign: Array, desired: Array, limit: float
) -> tuple[Array, Array, int]:
    """Project each deputy's input (R, N, 3) on its own rows: `mine` (N, m) of G (R, M, 3).

    `bounds` (2, R, M) are for a row's first deputy and for its second, whose `sign` (N, m) is negative.
    Returned are the inputs, how they came about (R, N), `LEFT` where they did not, and how many were left.
    """
    runs, deputies, count = desired.shape[0], desired.shape[1], mine.shape[1]
    u, status, left = np.empty(desired.shape), np.zeros((runs, deputies), np.int8), 0
    rows, least = np.empty((count + 6, 3)), np.empty(count + 6)
    for r in range(runs):
        for i in range(deputies):
            met, kept = True, 0
            status[r, i] = DESIRED if _clip(desired[r, i], limit, u[r, i]) else FILTERED
            for k in range(count):
                m, value, span = mine[i, k], 0.0, 0.0
                for j in range(3):
                    rows[kept, j] = sign[i, k] * G[r, m, j]
                    value += rows[kept, j] * u[r, i, j]
                    span += abs(rows[kept, j])
                least[kept] = bounds[0 if sign[i, k] > 0 else 1, r, m]
                met = met and value >= least[kept]
                if not least[kept] <= -limit * span:  # the others hold for every admissible input
                    kept += 1
            if not met:
                good = _nearest(rows, least, kept, desired[r, i], limit, u[r, i])
                status[r, i], left = (FILTERED, left) if good else (LEFT, left + 1)
    return u, status, left


@compiled
def coupled(
    G: Array, bound: Array, first: Array, second: Array, desired: Array, limit: float
) -> tuple[Array, Array, int]:
    """Project the inputs of all deputies together: ``G (u_first - u_second) >= bound``; as `alone`."""
    runs, deputies, count = desired.shape[0], desired.shape[1], len(first)
    u, status, left, size = np.empty(desired.shape), np.zeros((runs, deputies), np.int8), 0, 3 * deputies
    for r in range(runs):
        for i in range(deputies):
            _clip(desired[r, i], limit, u[r, i])
        met, asking = True, np.zeros(count, np.bool_)
        for m in range(count):
            value = span = 0.0
            i, j = first[m], second[m]
            for k in range(3):
                value += G[r, m, k] * (u[r, i, k] - (u[r, j, k] if j >= 0 else 0.0))
                span += abs(G[r, m, k])
            met = met and value >= bound[r, m]
            asking[m] = not bound[r, m] <= -limit * span * (2 if j >= 0 else 1)
        if not met:
            kept, found = np.flatnonzero(asking), np.empty(size)
            rows, least = np.zeros((len(kept) + 2 * size, size)), np.empty(len(kept) + 2 * size)
            for at in range(len(kept)):
                m, least[at] = kept[at], bound[r, kept[at]]
                i, j = first[m], second[m]
                for k in range(3):
                    rows[at, 3 * i + k] = G[r, m, k]
                    if j >= 0:
                        rows[at, 3 * j + k] = -G[r, m, k]
            if not _nearest(rows, least, len(kept), desired[r].copy().reshape(size), limit, found):
                status[r], left = LEFT, left + 1
                continue
            u[r] = found.reshape(deputies, 3)
        for i in range(deputies):
            same = (u[r, i] == desired[r, i]).all()
            status[r, i] = DESIRED if same else FILTERED
    return u, status, left


@compiled
def _clip(desired: Array, limit: float, u: Array) -> bool:
    """Clip an input to the limits; whether that leaves it as it is."""
    same = True
    for k in range(3):
        u[k] = min(max(desired[k], -limit), limit)
        same = same and u[k] == desired[k]
    return same


@compiled
def tight(
    G: Array, bound: Array, first: Array, second: Array, u: Array, within: float
) -> Array:
    """Rows (of one run) that an input (N, 3) meets with equality, but for `within` times their size."""
    found, count = np.empty(len(first), np.int64), 0
    for m in range(len(first)):
        gap, size = -bound[m], 0.0
        for k in range(3):
            gap += G[m, k] * (u[first[m], k] - (u[second[m], k] if second[m] >= 0 else 0.0))
            size += abs(G[m, k])
        if gap <= within * size:
            found[count] = m
            count += 1
    return found[:count]


@compiled
def _nearest(rows: Array, least: Array, count: int, desired: Array, limit: float, found: Array) -> bool:
    """Goldfarb and Idnani's method; the last 2 v of the rows are filled with the limits."""
    size, total = len(desired), count + 2 * len(desired)
    rows, least = rows[:total], least[:total]
    for k in range(size):
        if not np.isfinite(desired[k]):
            return False
    for m in range(count):
        length = 0.0
        for k in range(size):
            length += rows[m, k] ** 2
        length = np.sqrt(length)
        if not (np.isfinite(length) and np.isfinite(least[m]) and length > 1e-100):
            return False
        least[m] /= length
        for k in range(size):
            rows[m, k] /= length
    for m in range(count, total):
        k = m - count
        rows[m] = 0.0
        rows[m, k // 2], least[m] = 1.0 if k % 2 else -1.0, -limit
    u, active, held = desired.copy(), np.empty(size, np.int64), 0
    force, factor = np.zeros(size + 1), np.empty((size, size))
    for _ in range(20 * size + 20):
        entering, short = -1, MET
        for m in range(total):
            gap = least[m]
            for k in range(size):
                gap -= rows[m, k] * u[k]
            if gap > short:
                entering, short = m, gap
        if entering < 0:
            return _accepted(rows, least, desired, limit, u, active[:held], force, found)
        held = _enter(rows, entering, short, u, active, held, force, factor)
        if held < 0:
            return False
    return False


@compiled
def _enter(
    rows: Array, entering: int, short: float, u: Array, active: Array, held: int, force: Array, factor: Array
) -> int:
    """Take in a row that is missed by `short`; rows whose force would change its sign leave. -1 if it cannot."""
    size, new = len(u), 0.0
    share, step = np.empty(size), np.empty(size)
    while True:
        _shares(rows, entering, active, held, factor, share)
        for k in range(size):
            step[k] = rows[entering, k]
            for a in range(held):
                step[k] -= share[a] * rows[active[a], k]
        gain, leaves, move = 0.0, -1, np.inf
        for k in range(size):
            gain += step[k] * step[k]
        for a in range(held):
            if share[a] > 1e-12 and force[a] / share[a] < move:
                leaves, move = a, force[a] / share[a]
        full = short / gain if gain > 1e-12 and held < size else np.inf
        length = min(move, full)
        if not length < 1e12:
            return -1
        for a in range(held):
            force[a] -= length * share[a]
        new += length
        if full < np.inf:
            for k in range(size):
                u[k] += length * step[k]
            short -= length * gain
        if full <= move:
            active[held], force[held] = entering, new
            return held + 1
        for a in range(leaves, held - 1):
            active[a], force[a] = active[a + 1], force[a + 1]
        held -= 1


@compiled
def _dot(a: Array, b: Array) -> float:
    value = 0.0
    for k in range(len(a)):
        value += a[k] * b[k]
    return value


@compiled
def _shares(rows: Array, entering: int, active: Array, held: int, factor: Array, share: Array) -> None:
    """Least squares: the entering row as a sum of the active ones, by their Gram matrix's Cholesky factor."""
    for a in range(held):
        for b in range(a + 1):
            value = _dot(rows[active[a]], rows[active[b]])
            for c in range(b):
                value -= factor[a, c] * factor[b, c]
            factor[a, b] = np.sqrt(max(value, 1e-30)) if a == b else value / factor[b, b]
        value = _dot(rows[active[a]], rows[entering])
        for c in range(a):
            value -= factor[a, c] * share[c]
        share[a] = value / factor[a, a]
    for a in range(held - 1, -1, -1):
        for c in range(a + 1, held):
            share[a] -= factor[c, a] * share[c]
        share[a] /= factor[a, a]


@compiled
def _accepted(
    rows: Array, least: Array, desired: Array, limit: float, u: Array, active: Array, force: Array, found: Array
) -> bool:
    """Write down what satisfies all rows and is the desired input but for forces along active ones."""
    for k in range(len(u)):
        moved = desired[k]
        for a in range(len(active)):
            moved += force[a] * rows[active[a], k]
        if not abs(moved - u[k]) <= 1e-9 * (limit + abs(desired[k])):
            return False
        u[k] = min(max(u[k], -limit), limit)
    for m in range(len(rows)):
        gap = least[m] - _dot(rows[m], u)
        if not gap <= PRIMAL:
            return False
    for a in range(len(active)):
        gap = least[active[a]] - _dot(rows[active[a]], u)
        if force[a] < -1e-12 or abs(gap) > 1e-9 * (1 + limit):
            return False
    found[:] = u
    return True
