"""Least violation where no input satisfies all conditions: by rank, in each the largest shortage first.

Each rank's rows come as near to being met as the ranks before it allow. No row loses to one of a
later rank; rows that can be met together with all of their own rank and of the ranks before it are met.
"""

from dataclasses import dataclass

import daqp
import numpy as np
from numpy.typing import NDArray

from ..model.system import Array
from .vertex import STEPS, lowest

Flags = NDArray[np.bool_]

MET = 1e-9  # shortage, in parts of the limit, up to which a row of length 1 counts as met
SPARE = 1e-7  # by how much more than need be a row that cannot be met may be missed, in parts of the limit
SURE = 0.01
"""Multiplier from which a row is settled with its program's shortage; the largest one always is.

What settled rows are given may let a row of multiplier p be missed by ``SPARE / p`` less than it is."""

GAP = 1e-9  # a program counts as solved if its shortage is no more than this above what the multipliers prove
EXACT = 1e-12  # ... and no settled row is missed by more than this.


@dataclass(frozen=True, eq=False)
class _Least:
    """An input, its largest shortage, and the change of that by a unit of each row's need."""

    u: Array
    short: float
    multiplier: Array


def least_violation(
    G: Array, bound: Array, desired: Array, limit: float, rank: NDArray[np.intp]
) -> Array | None:
    """Nearest to the desired of the inputs that violate the rows least, lexicographically.

    Let ``s_m = max(bound_m - G_m u, 0)`` be the shortage of a row scaled to length 1, its bound taken as what
    full thrust gives where it asks for more. Among all admissible inputs those are found whose largest
    shortage in the first rank is least, among these those whose second largest is, and so on through the
    first rank, then through the next (a linear program each, at most one per row); of what remains the
    nearest to the desired input is taken (a quadratic one). The theory page says why the programs do that.

    To the following tolerances: ranks that can be met together are missed by no more than `MET`. No other
    shortage could be less by more than ``SPARE / max(SURE, 1 / (v + 1))`` (1e-5 of the limit, up to 33
    deputies) without another growing that counts more: of an earlier rank, or of its own and as large.

    Rows of G (M, v) have any length; those of zeros are left out, as no input changes them. A bound (M,) is
    infinite where nothing satisfies the row, which then asks for full thrust. Inputs and the limit are in N;
    the least rank counts first.

    None if a bound is no number, if anything else is not finite, if the limit is not positive, or if the
    programs ended without an answer.
    """
    finite = np.isfinite(G).all() and np.isfinite(desired).all() and not np.isnan(bound).any()
    if not finite or not 0 < limit < np.inf:
        return None
    relevant = G.any(axis=1) & (bound > -np.inf)
    with np.errstate(over="ignore", under="ignore"):
        size = np.abs(G[relevant]).max(axis=1, initial=0.0)
        G = G[relevant] / size[:, None]
        length = np.sqrt((G * G).sum(axis=1))
        G /= length[:, None]
        reach = np.abs(G).sum(axis=1)
        tightening = np.minimum(bound[relevant] / length / size / limit, reach * (1 - SPARE))
        target = np.clip(desired / limit, -1e6, 1e6)
    restrictive = tightening > -reach  # the others hold for every admissible input
    G, tightening, rank = G[restrictive], tightening[restrictive], rank[relevant][restrictive]
    # Should rounding leave a later program without a solution, once more without any.
    settled = _settled(G, tightening, rank, False) or _settled(G, tightening, rank, True)
    if settled is None:
        return None
    feasible, needs = settled
    return np.asarray(_nearest(G, needs, target, feasible) * limit)


def _settled(G: Array, tightening: Array, rank: NDArray[np.intp], exact: bool) -> tuple[Array, Array] | None:
    """An input, and the attainable value of each row: its need less its shortage and the tolerance."""
    needs, feasible = tightening.copy(), np.zeros(G.shape[1])
    done = np.zeros(len(tightening), dtype=bool)
    for level in np.unique(rank):
        unsettled = rank == level
        while unsettled.any():
            rows = done | unsettled
            answer = _largest_shortage(G[rows], needs[rows], unsettled[rows], exact)
            if answer is None:
                return None
            feasible, chosen, shortage = answer.u, unsettled, MET
            if answer.short > MET:
                shortage = answer.short + SPARE
                pull = np.zeros(len(tightening))
                pull[rows] = answer.multiplier
                chosen = unsettled & (pull >= min(SURE, float(pull[unsettled].max())))
            needs[chosen] -= shortage
            done, unsettled = done | chosen, unsettled & ~chosen
    return feasible, needs


def _largest_shortage(G: Array, tightening: Array, free: Flags, exact: bool) -> _Least | None:
    """Least s with ``G u >= need - s`` on free rows, 0 on others; multipliers prove how near solvers are."""
    if not exact:
        for solver in (_by_active_set, _by_vertices):
            answer = solver(G, tightening, free)
            if answer is None or not np.isfinite(answer[0]).all():
                continue
            least = _least(G, tightening, free, *answer)
            missed = (tightening - G @ least.u)[~free].max(initial=0.0)
            if missed <= EXACT and least.short - _proved(G, tightening, least.multiplier) <= GAP:
                return least
    vertex = lowest(G, tightening, free)
    return None if vertex is None else _least(G, tightening, free, *vertex)


def _by_active_set(G: Array, tightening: Array, free: Flags) -> tuple[Array, Array] | None:
    M, v = G.shape
    lower = np.concatenate([np.full(v, -1.0), [0.0], tightening])
    upper = np.concatenate([np.full(v, 1.0), np.full(1 + M, 1e30)])
    cost = np.zeros(v + 1)
    cost[-1] = 1.0
    quadratic, rows = np.zeros((v + 1, v + 1)), np.column_stack([G, free])
    settings = {"primal_tol": 1e-10, "eps_prox": 1.0, "eta_prox": 1e-9, "iter_limit": STEPS * (v + 1)}
    x, _, flag, info = daqp.solve(quadratic, cost, rows, upper, lower, **settings)
    return (x, -info["lam"][v + 1 :]) if flag > 0 else None


def _by_vertices(G: Array, tightening: Array, free: Flags) -> tuple[Array, Array] | None:
    return lowest(G, tightening, free, exact=False)


def _least(G: Array, tightening: Array, free: Flags, x: Array, multiplier: Array) -> _Least:
    u = np.clip(x[:-1], -1.0, 1.0)
    multiplier = np.maximum(multiplier, 0.0)
    total = float(multiplier[free].sum())
    multiplier = multiplier / total if total > 0.5 else np.zeros(len(tightening))  # 1 where s > 0
    return _Least(u, float((tightening - G @ u)[free].max(initial=0.0)), multiplier)


def _proved(G: Array, tightening: Array, multiplier: Array) -> float:
    """Return a lower bound on the largest shortage of all inputs: weak duality, whatever the multipliers."""
    return max(float(multiplier @ tightening - np.abs(multiplier @ G).sum()), 0.0)


def _nearest(G: Array, needs: Array, desired: Array, feasible: Array) -> Array:
    """The nearest input to the desired one that meets the rows: the solver's, or the last on the way."""
    M, v = G.shape
    lower = np.concatenate([np.full(v, -1.0), needs])
    upper = np.concatenate([np.full(v, 1.0), np.full(M, 1e30)])
    u, _, flag, _ = daqp.solve(np.eye(v), -desired, G, upper, lower, primal_tol=1e-10)
    u = np.clip(u if flag > 0 and np.isfinite(u).all() else desired, -1.0, 1.0)
    slack, rate = G @ feasible - needs, G @ (u - feasible)
    violated = slack + rate < -EXACT
    part = np.min((slack[violated] + EXACT).clip(0.0) / -rate[violated], initial=1.0)
    return np.asarray(feasible + part * (u - feasible))
