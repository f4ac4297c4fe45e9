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

MET = 1e-13
"""Violation of a row of length 1 at which the method stops."""


@compiled
def alone(G: Array, bound: Array, mine: Array, sign: Array, desired: Array, limit: float, u: Array) -> Array:
    """Project each deputy's input (R, N, 3) on its own rows; answers are written into u.

    Rows `mine` (N, m) of G (R, M, 3) times `sign` (N, m), bounds (R, N, m). Returned is what became of each,
    (R, N): whether it had to be changed, 2 where it is left to do.
    """
    runs, deputies, count = desired.shape[0], desired.shape[1], mine.shape[1]
    done = np.zeros((runs, deputies), np.int8)
    rows, least = np.empty((count + 6, 3)), np.empty(count + 6)
    for r in range(runs):
        for i in range(deputies):
            met, kept = True, 0
            for k in range(count):
                value, span = 0.0, 0.0
                for j in range(3):
                    rows[kept, j] = sign[i, k] * G[r, mine[i, k], j]
                    value += rows[kept, j] * u[r, i, j]
                    span += abs(rows[kept, j])
                least[kept] = bound[r, i, k]
                met = met and value >= least[kept]
                if not least[kept] <= -limit * span:  # the others hold for every admissible input
                    kept += 1
            if not met:
                done[r, i] = 1 if _nearest(rows, least, kept, desired[r, i], limit, u[r, i]) else 2
    return done


@compiled
def coupled(G: Array, bound: Array, first: Array, second: Array, desired: Array, limit: float, u: Array) -> Array:
    """Project the inputs of all deputies together: ``G (u_first - u_second) >= bound``; as `alone`, (R,)."""
    runs, deputies, count = desired.shape[0], desired.shape[1], len(first)
    done = np.zeros(runs, np.int8)
    for r in range(runs):
        met, asking = True, 0
        for m in range(count):
            value = span = 0.0
            i, j = first[m], second[m]
            for k in range(3):
                value += G[r, m, k] * (u[r, i, k] - (u[r, j, k] if j >= 0 else 0.0))
                span += abs(G[r, m, k])
            met = met and value >= bound[r, m]
            asking += not bound[r, m] <= -limit * span * (2 if j >= 0 else 1)
        if met:
            continue
        size = 3 * deputies
        rows, least, kept = np.zeros((asking + 2 * size, size)), np.empty(asking + 2 * size), 0
        for m in range(count):
            i, j = first[m], second[m]
            span = abs(G[r, m, 0]) + abs(G[r, m, 1]) + abs(G[r, m, 2])
            if bound[r, m] <= -limit * span * (2 if j >= 0 else 1):
                continue  # holds for every admissible input
            for k in range(3):
                rows[kept, 3 * i + k] = G[r, m, k]
                if j >= 0:
                    rows[kept, 3 * j + k] = -G[r, m, k]
            least[kept] = bound[r, m]
            kept += 1
        found = np.empty(size)
        done[r] = 1 if _nearest(rows, least, kept, desired[r].ravel(), limit, found) else 2
        if done[r] == 1:
            u[r] = found.reshape(deputies, 3)
    return done


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
