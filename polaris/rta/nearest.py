"""Small programs of `polaris.rta.projection` by a dual active-set method in loops, for numba to compile.

What it answers satisfies every row to `PRIMAL` and the conditions of optimality; whatever does not, also a
program without a solution, is left to the solver.
"""

import numpy as np
from numpy.typing import NDArray

from ..model.compiled import compiled
from ..model.system import Array

PRIMAL = 1e-11  # as in `polaris.rta.projection`

DESIRED, FILTERED, LEFT = 0, 1, -1
"""Status of an input: as in `polaris.rta.projection`, or left to the solver."""

Index = NDArray[np.int64]
Statuses = NDArray[np.int8]
Found = tuple[Array, Statuses, int]  # inputs, how they came about, and how many were left
Program = tuple[Array, Index, Array]
"""Rows by their entries that may be other than zero (T, w), the columns of these, and least values (T,)."""

MET = 1e-13  # violation of a row of length 1 at which the method stops


@compiled
def alone(G: Array, bounds: Array, row_index: Index, sign: Array, desired: Array, limit: float) -> Found:
    """Project each deputy's input (R, N, 3), clipped, on its own rows: `row_index` (N, m) of G (R, M, 3).

    `bounds` (2, R, M) are for a row's first deputy and for its second, whose `sign` (N, m) is negative; or
    (1, R, M) for both. Returned are the inputs, how they came about (R, N), and how many were left: those are
    `LEFT`, as clipped.
    """
    runs, deputies, count = desired.shape[0], desired.shape[1], row_index.shape[1]
    u, status, unsolved = np.empty_like(desired), np.zeros((runs, deputies), np.int8), 0
    rows, columns, least = np.empty((count + 6, 3)), np.empty((count + 6, 3), np.int64), np.empty(count + 6)
    for r in range(runs):
        for i in range(deputies):
            satisfied, filled = True, 0
            status[r, i] = DESIRED if _clip(desired[r, i], limit, u[r, i]) else FILTERED
            for k in range(count):
                m, value, span = row_index[i, k], 0.0, 0.0
                for j in range(3):
                    rows[filled, j] = sign[i, k] * G[r, m, j]
                    value += rows[filled, j] * u[r, i, j]
                    span += abs(rows[filled, j])
                least[filled] = bounds[0 if sign[i, k] > 0 else len(bounds) - 1, r, m]
                satisfied = satisfied and value >= least[filled]
                if not least[filled] <= -limit * span:  # the others hold for every admissible input
                    columns[filled] = 0, 1, 2
                    filled += 1
            if not satisfied:
                solved = _nearest((rows, columns, least), filled, u[r, i].copy(), limit, u[r, i])
                status[r, i], unsolved = (FILTERED, unsolved) if solved else (LEFT, unsolved + 1)
    return u, status, unsolved


@compiled
def coupled(G: Array, bound: Array, first: Index, second: Index, desired: Array, limit: float) -> Found:
    """Project the inputs of all deputies together: ``G (u_first - u_second) >= bound``; as `alone`."""
    runs, deputies, count = desired.shape[0], desired.shape[1], len(first)
    u, status, unsolved, size = np.empty_like(desired), np.zeros((runs, deputies), np.int8), 0, 3 * deputies
    for r in range(runs):
        for i in range(deputies):
            _clip(desired[r, i], limit, u[r, i])
        satisfied, relevant = True, np.zeros(count, np.bool_)
        for m in range(count):
            value = span = 0.0
            i, j = first[m], second[m]
            for k in range(3):
                value += G[r, m, k] * (u[r, i, k] - (u[r, j, k] if j >= 0 else 0.0))
                span += abs(G[r, m, k])
            satisfied = satisfied and value >= bound[r, m]
            relevant[m] = not bound[r, m] <= -limit * span * (2 if j >= 0 else 1)
        if not satisfied:
            chosen, solution = np.flatnonzero(relevant), np.empty(size)
            rows, least = np.zeros((len(chosen) + 2 * size, 6)), np.empty(len(chosen) + 2 * size)
            columns = np.empty(rows.shape, np.int64)
            for at in range(len(chosen)):
                m, least[at] = chosen[at], bound[r, chosen[at]]
                i, j = first[m], second[m]
                for k in range(3):
                    rows[at, k], columns[at, k] = G[r, m, k], 3 * i + k
                    rows[at, 3 + k], columns[at, 3 + k] = (-G[r, m, k] if j >= 0 else 0.0), 3 * max(j, 0) + k
            if not _nearest((rows, columns, least), len(chosen), u[r].copy().reshape(size), limit, solution):
                status[r], unsolved = LEFT, unsolved + 1
                continue
            u[r] = solution.reshape(deputies, 3)
        for i in range(deputies):
            same = (u[r, i] == desired[r, i]).all()
            status[r, i] = DESIRED if same else FILTERED
    return u, status, unsolved


@compiled
def _clip(desired: Array, limit: float, u: Array) -> bool:
    """Clip an input to the limits; whether that leaves it as it is."""
    same = True
    for k in range(3):
        u[k] = limit if desired[k] > limit else -limit if desired[k] < -limit else desired[k]  # nan stays
        same = same and u[k] == desired[k]
    return same


@compiled
def tight(G: Array, bound: Array, first: Index, second: Index, u: Array, within: float, full: float) -> Index:
    """Rows (of one run) that an input (N, 3) meets with equality, but for `within` times their size.

    Behind the rows are counted the deputies with an input of at least `full`.
    """
    indices, count = np.empty(len(first) + len(u), np.int64), 0
    for m in range(len(first)):
        gap, size = -bound[m], 0.0
        for k in range(3):
            gap += G[m, k] * (u[first[m], k] - (u[second[m], k] if second[m] >= 0 else 0.0))
            size += abs(G[m, k])
        if gap <= within * size:
            indices[count] = m
            count += 1
    for i in range(len(u)):
        if max(abs(u[i, 0]), abs(u[i, 1]), abs(u[i, 2])) >= full:
            indices[count] = len(first) + i
            count += 1
    return indices[:count]


@compiled
def _nearest(program: Program, count: int, desired: Array, limit: float, out: Array) -> bool:
    """Goldfarb and Idnani's method (1983); the limits are filled in behind the first `count` rows."""
    size, (rows, columns, least) = len(desired), program
    if not np.isfinite(desired).all():
        return False
    for m in range(count):
        length = np.sqrt((rows[m] * rows[m]).sum())
        if not (np.isfinite(length) and np.isfinite(least[m]) and length > 1e-100):
            return False
        least[m] /= length
        rows[m] /= length
    total = count + 2 * size
    for m in range(count, total):
        rows[m], columns[m], least[m] = 0.0, (m - count) // 2, -limit
        rows[m, 0] = 1.0 if (m - count) % 2 else -1.0
    u, active, rank = desired.copy(), np.empty(size, np.int64), 0
    force, factor = np.zeros(size), np.empty((size, size))
    for _ in range(20 * size + 20):
        entering, short = -1, MET
        for m in range(total):
            gap = least[m] - _dot(program, m, u)
            if gap > short:
                entering, short = m, gap
        if entering < 0:
            return _accepted(program, total, desired, limit, u, active[:rank], force, out)
        rank = _enter(program, entering, short, u, active, rank, force, factor)
        if rank < 0:
            return False
    return False


@compiled
def _dot(program: Program, m: int, vector: Array) -> float:
    value = 0.0
    for k in range(program[0].shape[1]):
        value += program[0][m, k] * vector[program[1][m, k]]
    return value


@compiled
def _add(program: Program, m: int, times: float, vector: Array) -> None:
    for k in range(program[0].shape[1]):
        vector[program[1][m, k]] += times * program[0][m, k]


@compiled
def _enter(
    program: Program,
    entering: int,
    short: float,
    u: Array,
    active: Index,
    rank: int,
    force: Array,
    factor: Array,
) -> int:
    """Take in a row missed by `short`, some may leave; how many are active, -1 if it cannot be met."""
    size, new = len(u), 0.0
    normal, share, step = np.zeros(size), np.empty(size), np.empty(size)
    _add(program, entering, 1.0, normal)
    while True:
        solved = _factored(program, normal, active, rank, factor)
        step[:] = normal
        for a in range(rank - 1, -1, -1):
            share[a] = solved[a]
            for b in range(a + 1, rank):
                share[a] -= factor[b, a] * share[b]
            share[a] /= factor[a, a]
            _add(program, active[a], -share[a], step)
        gain, leaves, move = (step * step).sum(), -1, np.inf
        for a in range(rank):
            if share[a] > 1e-12 and force[a] / share[a] < move:
                leaves, move = a, force[a] / share[a]
        full = short / gain if gain > 1e-12 and rank < size else np.inf
        length = min(move, full)
        if not length < 1e12:
            return -1
        force[:rank] -= length * share[:rank]
        new += length
        if full < np.inf:
            u += length * step
            short -= length * gain
        if full <= move:
            active[rank], force[rank], factor[rank, :rank] = entering, new, solved[:rank]
            factor[rank, rank] = np.sqrt(gain)
            return rank + 1
        rank -= 1
        active[leaves:rank], force[leaves:rank] = active[leaves + 1 : rank + 1], force[leaves + 1 : rank + 1]
        for a in range(leaves, rank):
            row = np.zeros(size)
            _add(program, active[a], 1.0, row)
            factor[a, :a] = _factored(program, row, active, a, factor)[:a]
            factor[a, a] = np.sqrt(max((row * row).sum() - (factor[a, :a] ** 2).sum(), 1e-30))


@compiled
def _factored(program: Program, vector: Array, active: Index, rank: int, factor: Array) -> Array:
    """Products of a vector with the active rows, forward through their factor."""
    solved = np.empty(len(vector))
    for a in range(rank):
        value = _dot(program, active[a], vector)
        for b in range(a):
            value -= factor[a, b] * solved[b]
        solved[a] = value / factor[a, a]
    return solved


@compiled
def _accepted(
    program: Program,
    total: int,
    desired: Array,
    limit: float,
    u: Array,
    active: Index,
    force: Array,
    out: Array,
) -> bool:
    """Write down the input that satisfies all rows: the desired one but for forces along active rows."""
    optimum, (_, _, least) = desired.copy(), program
    for a in range(len(active)):
        _add(program, active[a], force[a], optimum)
    for k in range(len(u)):
        if not abs(optimum[k] - u[k]) <= 1e-9 * (limit + abs(desired[k])):
            return False
        u[k] = min(max(u[k], -limit), limit)
    for m in range(total):
        if not least[m] - _dot(program, m, u) <= PRIMAL:
            return False
    for a in range(len(active)):
        if force[a] < -1e-12 or abs(least[active[a]] - _dot(program, active[a], u)) > 1e-9 * (1 + limit):
            return False
    out[:] = u
    return True
