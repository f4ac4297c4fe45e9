"""Thrusts that a flight computer asks of each thruster, by every kind of allocation."""

from itertools import combinations
from math import comb

import numpy as np
from scipy.optimize import linprog

from ..model.allocation import MIXES, PAIRS, PROGRAM, Allocation
from ..model.system import Array

MOST_BASES = 3000  # most choices of m thrusters that are tried before a linear program is solved
NEAR = 1e-11  # share of the limits of inputs that thrusts of the least 2-norm may miss them by
STEPS = 200  # most steps of Newton's method


def thrusts_of(allocation: Allocation, u: Array) -> Array:
    """Return the thrusts that make inputs (..., m) without a fault, shape (..., N).

    What is beyond the limits of the inputs is made in proportion.
    """
    excess = np.maximum(np.max(np.abs(u) / allocation.u_max, axis=-1, keepdims=True), 1.0)
    rows = (u / excess).reshape(-1, len(allocation.u_max))
    if allocation.kind == MIXES:
        f = np.maximum(rows, 0) @ allocation.mixes[0, 0] + np.maximum(-rows, 0) @ allocation.mixes[0, 1]
    elif allocation.kind == PAIRS:
        f = 2 * np.maximum(rows @ np.linalg.pinv(allocation.directions), 0.0)
    else:
        solve = _cheapest if allocation.kind == PROGRAM else _smallest
        f = solve(allocation.directions, allocation.limits, rows, allocation.u_max)
    return np.asarray(f.reshape(*u.shape[:-1], -1) * excess)


def _cheapest(directions: Array, limits: Array, u: Array, u_max: Array) -> Array:
    """Return the thrusts (R, N) of the least sum, each times the length of its direction, that make u (R, m).

    Without the limits m thrusters do; where these exceed a limit, or there are too many, a program is solved.
    """
    (N, m), lengths = directions.shape, np.linalg.norm(directions, axis=1)
    cost, thrusts = np.full(len(u), np.inf), np.zeros((len(u), N))
    for subset in combinations(range(N), m) if comb(N, m) <= MOST_BASES else ():
        chosen, D = list(subset), directions[list(subset)]
        if abs(np.linalg.det(D)) < 1e-9 * np.prod(lengths[chosen]):
            continue
        f = u @ np.linalg.inv(D)
        total = np.where(np.min(f, axis=1) >= -1e-12 * limits.max(), f @ lengths[chosen], np.inf)
        improved = np.flatnonzero(total < cost)
        cost[improved], thrusts[improved] = total[improved], 0.0
        thrusts[improved[:, None], chosen] = np.maximum(f[improved], 0.0)
    for row in np.flatnonzero(~np.isfinite(cost) | np.any(thrusts > limits, axis=1)):
        bounds = np.column_stack([0 * limits, limits])
        solved = linprog(lengths, A_eq=directions.T / u_max[:, None], b_eq=u[row] / u_max, bounds=bounds)
        thrusts[row] = solved.x
    return thrusts


def _smallest(directions: Array, limits: Array, u: Array, u_max: Array) -> Array:
    """Return the thrusts (R, N) of the least 2-norm that make u (R, m), by Newton's method for multipliers.

    Those of multipliers x are ``clip(directions x, 0, limits)``; x is where a convex function is least.
    """
    D, target = directions / u_max, u / u_max
    x, damping = np.zeros_like(target), 1e-3 * np.linalg.norm(D, 2) ** 2 * np.eye(D.shape[1])

    def value(x: Array, target: Array) -> Array:
        push = x @ D.T
        f = np.clip(push, 0.0, limits)
        return np.asarray(np.sum(f * (push - f / 2), axis=1) - np.sum(x * target, axis=1))

    for _ in range(STEPS):
        push = x @ D.T
        miss = np.clip(push, 0.0, limits) @ D - target
        rows = np.flatnonzero(np.abs(miss).max(axis=1) > NEAR)
        if not len(rows):
            break
        inside = ((push > -1e-15) & (push < limits))[rows].astype(float)
        size = np.minimum(np.abs(miss[rows]).max(axis=1), 1.0)[:, None, None]
        H = np.einsum("rn,ni,nj->rij", inside, D, D) + damping * size
        step, share = np.linalg.solve(H, -miss[rows][..., None])[..., 0], np.ones((len(rows), 1))
        slope = np.sum(step * miss[rows], axis=1)
        for _ in range(30):
            change = value(x[rows] + share * step, target[rows]) - value(x[rows], target[rows])
            share[change > 0.1 * share[:, 0] * slope + 1e-16] /= 2
        x[rows] += share * step
    return np.asarray(np.clip(x @ D.T, 0.0, limits))
