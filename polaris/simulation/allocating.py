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


def thrusts_of(made: Allocation, u: Array) -> Array:
    """Return the thrusts that make inputs (..., m) without a fault, shape (..., N).

    What is beyond the limits of the inputs is made in proportion.
    """
    beyond = np.maximum(np.max(np.abs(u) / made.u_max, axis=-1, keepdims=True), 1.0)
    rows = (u / beyond).reshape(-1, len(made.u_max))
    if made.kind == MIXES:
        f = np.maximum(rows, 0) @ made.mixes[0, 0] + np.maximum(-rows, 0) @ made.mixes[0, 1]
    elif made.kind == PAIRS:
        f = 2 * np.maximum(rows @ np.linalg.pinv(made.directions), 0.0)
    else:
        solve = _cheapest if made.kind == PROGRAM else _smallest
        f = solve(made.directions, made.limits, rows, made.u_max)
    return np.asarray(f.reshape(*u.shape[:-1], -1) * beyond)


def _cheapest(directions: Array, limits: Array, u: Array, u_max: Array) -> Array:
    """Return the thrusts (R, N) of the least sum, each times the length of its direction, that make u (R, m).

    Without the limits m thrusters do; where these exceed a limit, or there are too many, a program is solved.
    """
    (N, m), lengths = directions.shape, np.linalg.norm(directions, axis=1)
    cost, thrusts = np.full(len(u), np.inf), np.zeros((len(u), N))
    for some in combinations(range(N), m) if comb(N, m) <= MOST_BASES else ():
        chosen, D = list(some), directions[list(some)]
        if abs(np.linalg.det(D)) < 1e-9 * np.prod(lengths[chosen]):
            continue
        f = u @ np.linalg.inv(D)
        spent = np.where(np.min(f, axis=1) >= -1e-12 * limits.max(), f @ lengths[chosen], np.inf)
        better = np.flatnonzero(spent < cost)
        cost[better], thrusts[better] = spent[better], 0.0
        thrusts[better[:, None], chosen] = np.maximum(f[better], 0.0)
    for row in np.flatnonzero(~np.isfinite(cost) | np.any(thrusts > limits, axis=1)):
        bounds = np.column_stack([0 * limits, limits])
        solved = linprog(lengths, A_eq=directions.T / u_max[:, None], b_eq=u[row] / u_max, bounds=bounds)
        thrusts[row] = solved.x
    return thrusts


def _smallest(directions: Array, limits: Array, u: Array, u_max: Array) -> Array:
    """Return the thrusts (R, N) of the least 2-norm that make u (R, m), by Newton's method for multipliers.

    Those of multipliers x are ``clip(directions x, 0, limits)``; x is where a convex function is least.
    """
    D, wanted = directions / u_max, u / u_max
    x, whole = np.zeros_like(wanted), 1e-3 * np.linalg.norm(D, 2) ** 2 * np.eye(D.shape[1])

    def value(x: Array, wanted: Array) -> Array:
        push = x @ D.T
        f = np.clip(push, 0.0, limits)
        return np.asarray(np.sum(f * (push - f / 2), axis=1) - np.sum(x * wanted, axis=1))

    for _ in range(STEPS):
        push = x @ D.T
        off = np.clip(push, 0.0, limits) @ D - wanted
        rows = np.flatnonzero(np.abs(off).max(axis=1) > NEAR)
        if not len(rows):
            break
        inside = ((push > -1e-15) & (push < limits))[rows].astype(float)
        size = np.minimum(np.abs(off[rows]).max(axis=1), 1.0)[:, None, None]
        H = np.einsum("rn,ni,nj->rij", inside, D, D) + whole * size
        step, share = np.linalg.solve(H, -off[rows][..., None])[..., 0], np.ones((len(rows), 1))
        slope = np.sum(step * off[rows], axis=1)
        for _ in range(30):
            less = value(x[rows] + share * step, wanted[rows]) - value(x[rows], wanted[rows])
            share[less > 0.1 * share[:, 0] * slope + 1e-16] /= 2
        x[rows] += share * step
    return np.asarray(np.clip(x @ D.T, 0.0, limits))
