"""The last gate: only what passes the exact re-check becomes a `Plan`."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..model.errors import NotCertified
from ..model.system import Array
from .problem import Plan, PlanProblem
from .recheck import Recheck, recheck


def certified(
    problem: PlanProblem,
    nu: Array,
    wanted: Array,
    value: float,
    bound: float,
    status: str,
    **found: Any,
) -> Plan:
    """Re-check inputs and make a `Plan` of them, with `found` for its remaining fields.

    Raises
    ------
    NotCertified
        If a clearance, a limit or the goal does not hold.
    """
    K = problem.K
    check = recheck(problem, nu)
    if problem.unsafe:
        best, facets = check.best()
    else:
        best, facets = np.zeros((0, problem.cells)), np.zeros((0, problem.cells), dtype=int)
    missing = require(problem, check, best)
    if missing:
        raise NotCertified(f"found but not certified: {missing}")
    nu = check.reference.nu
    extra: Array = best[:, :K]
    return Plan(
        chi=check.reference.chi,
        nu=nu,
        facets=np.asarray(facets[:, :K], dtype=int),
        tail_facets=np.asarray(facets[:, K:], dtype=int),
        margin=float(np.min(extra, initial=np.inf)),
        extra=extra,
        wanted=wanted,
        delta_v=float(np.sum(np.abs(nu)) * problem.delta / problem.system.mass),
        status=status,
        objective=float(value),
        bound=float(bound),
        gap=float(relative_gap(value, bound)),
        **found,
    )


def relative_gap(value: float, bound: float) -> float:
    """Relative distance of a value and its bound, infinite while either is missing."""
    if not (np.isfinite(value) and np.isfinite(bound)):
        return np.inf
    return abs(value - bound) / max(abs(value), 1e-9)


def require(problem: PlanProblem, check: Recheck, best: Array) -> str:
    """What a re-check finds wrong, or an empty string."""
    if best.size and np.min(best) < 0:
        i, k = np.unravel_index(np.argmin(best), best.shape)
        return (
            f"clearance from {problem.unsafe[i].name} in cell {k} is {-best[i, k]:.3g} m short of its margin "
            f"({problem.required(int(i))[k].max():.3g} m)"
        )
    amount, name = check.goal
    if amount > 0:
        return f"the goal is missed by {amount:.3g} of its scale: {name}"
    return ""
