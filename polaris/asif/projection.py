"""The quadratic program of an active set invariance filter (eq. 5): nearest input that satisfies all rows."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import daqp
import numpy as np
from numpy.typing import NDArray

from ..system import Array

PRIMAL = 1e-11
"""Violation [N] of a row of length 1 that the solver may leave."""

SHORTAGE_WEIGHT = 1e6
"""Weight of the squared shortage [N] against the squared deviation where no input satisfies all rows."""

DESIRED, FILTERED, SHORT, FAILED = range(4)
"""How an input came about: as desired; nearest that satisfies all rows; nearest that violates them least,
where none satisfies all; no input at all."""


@dataclass(frozen=True, eq=False)
class Projections:
    """Solutions of K programs.

    Attributes
    ----------
    u : ndarray, shape (K, v)
        Inputs [N]; nan where failed.
    status : ndarray of int, shape (K,)
        DESIRED, FILTERED, SHORT or FAILED.
    """

    u: Array
    status: NDArray[np.int8]


@cache
def _identity(size: int) -> Array:
    return np.eye(size)


def solve(G: Array, bound: Array, desired: Array, limit: float) -> tuple[Array, int]:
    """Project one input: ``min norm(u - desired)`` subject to ``G u >= bound``, ``|u_i| <= limit``.

    Parameters
    ----------
    G : ndarray, shape (M, v)
        Rows of length 1, or zero.
    bound : ndarray, shape (M,)
    desired : ndarray, shape (v,)
        [N]
    limit : float
        [N]

    Returns
    -------
    u : ndarray, shape (v,)
        [N]
    status : int
        FILTERED, SHORT or FAILED.
    """
    size = len(desired)
    lower = np.full(size + len(bound), -limit)
    lower[size:] = bound
    upper = np.full(size + len(bound), 1e30)
    upper[:size] = limit
    u, _, flag, _ = daqp.solve(_identity(size), -desired, G, upper, lower, primal_tol=PRIMAL)
    if flag > 0:
        return np.clip(u, -limit, limit), FILTERED
    # One more variable, the shortage s >= 0 [N] of the worst row.
    hessian = np.eye(size + 1)
    hessian[-1, -1] = SHORTAGE_WEIGHT
    rows = np.column_stack([G, np.ones(len(bound))])
    lower = np.concatenate([np.full(size, -limit), [0.0], bound])
    upper = np.concatenate([np.full(size, limit), np.full(1 + len(bound), 1e30)])
    u, _, flag, _ = daqp.solve(hessian, np.append(-desired, 0.0), rows, upper, lower, primal_tol=1e-9)
    if flag > 0:
        return np.clip(u[:-1], -limit, limit), SHORT
    return np.full(size, np.nan), FAILED


def project(G: Array, bound: Array, desired: Array, limit: float) -> Projections:
    """Project K inputs, each with its own M rows; exact, and in closed form where one row decides.

    Parameters
    ----------
    G : ndarray, shape (K, M, v)
    bound : ndarray, shape (K, M)
        ``G u >= bound``.
    desired : ndarray, shape (K, v)
        [N]
    limit : float
        ``|u_i| <= limit`` [N].
    """
    length = np.sqrt(np.einsum("kmv,kmv->km", G, G))
    reach = limit * np.abs(G).sum(axis=2)
    needed = bound > -reach  # the other rows hold for every admissible input
    scale = 1 / np.maximum(length, 1e-300)
    G, bound = G * scale[..., None], np.where(needed, bound * scale, -np.inf)
    u = np.clip(desired, -limit, limit)
    status = np.full(len(u), FILTERED, dtype=np.int8)
    left = np.einsum("kmv,kv->km", G, u) < bound
    status[~left.any(axis=1) & (u == desired).all(axis=1)] = DESIRED
    todo = np.flatnonzero(left.any(axis=1))
    if len(todo):
        todo = _one_row(G, bound, desired, limit, u, todo)
    for k in todo:
        rows = needed[k]
        u[k], status[k] = solve(G[k, rows], bound[k, rows], desired[k], limit)
    return Projections(u, status)


def _one_row(
    G: Array, bound: Array, desired: Array, limit: float, u: Array, todo: NDArray[np.intp]
) -> NDArray[np.intp]:
    """Project onto the row the desired input violates most; done where that satisfies all the others."""
    rows, want = G[todo], desired[todo]
    short = bound[todo] - np.einsum("kmv,kv->km", rows, want)
    worst = short.argmax(axis=1)
    every = np.arange(len(todo))
    nearest = want + short[every, worst, None] * rows[every, worst]
    gap = bound[todo] - np.einsum("kmv,kv->km", rows, nearest)
    gap[every, worst] = 0.0
    good = (np.abs(nearest) <= limit).all(axis=1) & (gap <= 0).all(axis=1)
    u[todo[good]] = nearest[good]
    return todo[~good]
