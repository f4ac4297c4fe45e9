"""What gives way where no input satisfies all conditions: rank by rank, in each the largest shortage first.

Each rank's rows come as near to being met as the ranks before it leave room for. No row loses to one of a
later rank; rows that can be met together with all of their own rank and of the ranks before it are met.
"""

from __future__ import annotations

import daqp
import numpy as np
from numpy.typing import NDArray

from ..model.system import Array

Flags = NDArray[np.bool_]

MET = 1e-9
"""Shortage, in parts of the limit, up to which a row of length 1 counts as met."""

SPARE = 1e-7
"""By how much more than need be a row that cannot be met may be missed, in parts of the limit."""

STAGES = 40
"""Most linear programs per rank; after these what is left of the rank shares one shortage."""


def least_violation(
    G: Array, bound: Array, desired: Array, limit: float, rank: NDArray[np.intp]
) -> Array | None:
    """Nearest to the desired of the inputs that violate the rows least, lexicographically.

    Let ``s_m = max(bound_m - G_m u, 0)`` be a row's shortage, its bound taken as what full thrust gives where
    it asks for more. Among all admissible inputs those are found whose largest shortage in the first rank is
    least, among these those whose second largest is, and so on through the first rank, then through the next
    (a linear program each); of what remains the nearest to the desired input is taken (a quadratic one).
    The theory page says why the programs do that.

    Parameters
    ----------
    G : ndarray, shape (M, v)
        Rows of length 1; rows of zeros are left out, as no input changes them.
    bound : ndarray, shape (M,)
        ``G u >= bound`` [N]; infinite where nothing satisfies the row, which then asks for full thrust.
    desired : ndarray, shape (v,)
        [N]
    limit : float
        ``|u_i| <= limit`` [N].
    rank : ndarray of int, shape (M,)
        Least first.

    Returns
    -------
    ndarray, shape (v,), or None
        [N]; None if the solver failed.
    """
    kept = G.any(axis=1) & (bound > -np.inf)
    G, rank = G[kept], rank[kept]
    need = np.minimum(bound[kept] / limit, np.abs(G).sum(axis=1) * (1 - SPARE))
    wanted = np.clip(desired / limit, -1e6, 1e6)
    asked = need.copy()
    done = np.zeros(len(need), dtype=bool)
    found: Array | None = None
    for level in np.unique(rank):
        left = rank == level
        for stage in range(STAGES):
            answer = _largest_shortage(G[done | left], asked[done | left], left[done | left])
            if answer is None:
                break
            found, short, tight = answer
            if short <= MET:
                short, tight = 0.0, left[done | left]
            elif stage == STAGES - 1:
                tight = left[done | left]
            chosen = np.flatnonzero(done | left)[tight]
            asked[chosen] = need[chosen] - (short + SPARE if short > 0 else MET)
            done[chosen], left[chosen] = True, False
            if not left.any():
                break
    nearest = _nearest(G[done], asked[done], wanted)
    found = nearest if nearest is not None else found
    return None if found is None else np.asarray(np.clip(found, -1.0, 1.0) * limit)


def _largest_shortage(G: Array, need: Array, free: Flags) -> tuple[Array, float, Flags] | None:
    """Least s with ``G u >= need`` on the rows that are not free, ``G u >= need - s`` on the free ones.

    Returns
    -------
    tuple or None
        An input, s, and which rows (free ones) fall short by s whatever the input: those with a multiplier.
    """
    M, v = G.shape
    rows = np.column_stack([G, free])
    lower = np.concatenate([np.full(v, -1.0), [0.0], need])
    upper = np.concatenate([np.full(v, 1.0), np.full(1 + M, 1e30)])
    cost = np.zeros(v + 1)
    cost[-1] = 1.0
    x, _, flag, info = daqp.solve(
        np.zeros((v + 1, v + 1)), cost, rows, upper, lower, primal_tol=1e-10, eps_prox=1.0
    )
    if flag <= 0 or not np.isfinite(x).all():
        return None
    pull = np.where(free, np.abs(info["lam"][v + 1 :]), 0.0)
    tight = pull > 1e-6 * max(float(pull.max(initial=0.0)), 1e-6)
    if not tight.any():  # never in exact arithmetic where s > 0
        gap = np.where(free, rows @ x - need, np.inf)
        tight = gap <= gap.min() + MET
    return x[:v], float(x[v]), np.asarray(tight, dtype=bool)


def _nearest(G: Array, need: Array, desired: Array) -> Array | None:
    M, v = G.shape
    lower = np.concatenate([np.full(v, -1.0), need])
    upper = np.concatenate([np.full(v, 1.0), np.full(M, 1e30)])
    u, _, flag, _ = daqp.solve(np.eye(v), -desired, G, upper, lower, primal_tol=1e-10)
    return np.asarray(u) if flag > 0 and np.isfinite(u).all() else None
