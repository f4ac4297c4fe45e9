"""The quadratic program of an active set invariance filter (eq. 5): nearest input that satisfies all rows."""

from dataclasses import dataclass
from math import isfinite

import daqp
import numpy as np
from numpy.typing import NDArray

from ..model.system import Array
from .priorities import least_violation

PRIMAL = 1e-11  # violation [N] of a row of length 1 that the solver may leave
FEW = 8  # up to so many independent programs go to the solver as one

DESIRED, FILTERED, SHORT, FAILED = range(4)
"""Status of an input: as desired; nearest that satisfies all rows; nearest that violates them least,
where none satisfies all (see `polaris.rta.priorities`); no input at all, as where a bound is no number or
a row or the desired input is not finite."""

Index = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Projections:
    """Solutions of K programs: inputs (K, ...) [N], nan where failed, and how each came about."""

    u: Array
    status: NDArray[np.int8]


def solve(
    G: Array, bound: Array, desired: Array, limit: float, rank: Index | None = None
) -> tuple[Array, int]:
    """Project one input: ``min norm(u - desired)`` subject to ``G u >= bound``, ``|u_i| <= limit``, all in N.

    Rows of G (M, v) have length 1, or are zero. Where no input satisfies all rows, the one that violates them
    least is found, by the rank (M,) of each (see `polaris.rta.priorities`); without ranks there is no answer
    then. Returned are the input (v,), nan if failed, and FILTERED, SHORT or FAILED.
    """
    size, rows = len(desired), len(bound)
    lower, upper = np.full(size + rows, -limit), np.full(size + rows, 1e30)
    lower[size:] = bound
    upper[:size] = limit
    u, _, flag, _ = daqp.solve(np.eye(size), -desired, G, upper, lower, primal_tol=PRIMAL)
    if flag > 0:
        return np.clip(u, -limit, limit), FILTERED
    least = None if rank is None else least_violation(G, bound, desired, limit, rank)
    return (np.full(size, np.nan), FAILED) if least is None else (least, SHORT)


def project(G: Array, bound: Array, desired: Array, limit: float, rank: Index | None = None) -> Projections:
    """Project K inputs (K, v), each with its own M rows.

    ``G u >= bound`` for G (K, M, v) and bound (K, M), ``|u_i| <= limit`` [N]; ranks (K, M) as in `solve`.
    """
    first = np.zeros(G.shape[1], dtype=np.intp)
    return project_coupled(G, bound, desired[:, None], limit, first, first - 1, rank, flat=True)


def project_coupled(
    G: Array,
    bound: Array,
    desired: Array,
    limit: float,
    first: Index,
    second: Index,
    rank: Index | None = None,
    flat: bool = False,
) -> Projections:
    """Project the inputs of K runs of N deputies: ``G (u_first - u_second) >= bound``.

    As `project`, with desired inputs (K, N, v); `first` and `second` (M,) are the deputies of a row, the
    second -1 where there is one only. `flat` drops the axis of deputies from the result (N is 1).
    """
    pair = second >= 0
    several = np.where(pair, 2.0, 1.0)
    span = limit * np.abs(G).sum(axis=2) * several
    refused = np.zeros(0, dtype=np.intp)
    if not isfinite(np.vdot(span, span) + np.vdot(bound, bound) + np.vdot(desired, desired)):  # look closer
        invalid = ~(np.isfinite(span) & ~np.isnan(bound)).all(axis=1) | ~np.isfinite(desired).all(axis=(1, 2))
        refused = np.flatnonzero(invalid)
        G, bound, desired, span = np.array(G), np.array(bound), np.array(desired), np.array(span)
        G[refused], bound[refused], desired[refused], span[refused] = 0.0, 0.0, 0.0, 0.0
    needed = bound > -span  # the others hold for every admissible input
    scale = 1 / np.maximum(np.sqrt(np.einsum("kmv,kmv->km", G, G) * several), 1e-100)
    G, bound = G * scale[..., None], np.where(needed, bound * scale, -np.inf)
    u = np.clip(desired, -limit, limit)
    status = np.full(len(u), FILTERED, dtype=np.int8)
    todo = np.arange(len(u))
    if flat and 1 < len(u) <= FEW:
        todo = _together(G, bound, desired, limit, needed, u)
    for k in todo:
        rows = np.flatnonzero(needed[k])  # only those that count
        which = first[rows], second[rows], None if rank is None else rank[k][rows]
        u[k], status[k] = _coupled(G[k][rows], bound[k][rows], desired[k], limit, *which)
    if len(refused):
        u[refused], status[refused] = np.nan, FAILED
    return Projections(u[:, 0] if flat else u, status)


def _coupled(
    G: Array, bound: Array, desired: Array, limit: float, first: Index, second: Index, rank: Index | None
) -> tuple[Array, int]:
    """Project the inputs of one run with the solver; they, shape (N, v), and its status."""
    N, v = desired.shape
    if N == 1:
        solution, status = solve(G, bound, desired[0], limit, rank)
        return solution[None], status
    wide = np.zeros((len(bound), N, v))
    pair = np.flatnonzero(second >= 0)
    wide[np.arange(len(bound)), first] = G
    wide[pair, second[pair]] = -G[pair]
    solution, status = solve(wide.reshape(-1, N * v), bound, desired.ravel(), limit, rank)
    return solution.reshape(N, v), status


def _together(G: Array, bound: Array, desired: Array, limit: float, needed: Array, u: Array) -> Index:
    """A few programs as one, which saves calls: solutions go into `u`; to do are none, or all."""
    run, row = np.nonzero(needed)
    second = np.full(len(run), -1, dtype=np.intp)
    solution, status = _coupled(G[run, row], bound[run, row], desired[:, 0], limit, run, second, None)
    if status != FILTERED:
        return np.arange(len(u))
    u[:, 0] = solution
    return np.arange(0)
