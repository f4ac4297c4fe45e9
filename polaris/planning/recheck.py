"""The exact re-check: a plan's true motion, in continuous time, from its inputs alone.

Nothing here comes from the planning model. The path in a cell is cut into arcs; on each arc of
length h the distance to a moving facet is a smooth function of time, whose cubic Hermite interpolant
lies above its smallest Bezier coefficient and differs from it by at most ``h^4 / 384 sup |f''''|``.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from reach.numerics.linear import discretize, growth

from ..model.errors import NotCertified
from ..model.system import Array
from ..model.tolerances import ROUNDING
from .problem import KNOWN, Plan, PlanProblem, relative_gap
from .reference import Reference

ARCS = 8  # parts of a cell


@dataclass(frozen=True, eq=False)
class Recheck:
    """Result of re-checking a plan, clipped to its input limits and propagated exactly over K cells.

    `surplus` holds, per unsafe set, the certified lower bound [m] on ``normal p(t) - b(t) - margin`` over
    each cell for each facet, shape (cells, F); `goal` the relative violation of the goal and its name.
    """

    reference: Reference
    surplus: tuple[Array, ...]
    goal: tuple[float, str]


def recheck(problem: PlanProblem, nu: Array) -> Recheck:
    """Propagate inputs (K, m), clipped to the limits, exactly; bound every clearance over every cell."""
    system = problem.system
    nu = np.clip(nu, -problem.u_limit, problem.u_limit)
    reference = Reference.propagate(system, problem.delta, problem.x0, nu)
    coasting = reference.extend(problem.tail_cells)
    lows = path_bounds(problem, coasting)
    surplus = tuple(low - problem.required(i) for i, low in enumerate(lows))
    return Recheck(reference, surplus, problem.goal.violation(reference.chi[-1]))


def known_plan(reference: Reference, K: int, facets: np.ndarray) -> Plan:
    """Return the plan of K steps of a reference whose facets (cells, n_o) are known, and no more.

    It was found and certified before; what is not known of it is NaN.
    """
    nu, system, unknown = reference.nu[:K], reference.system, np.full((facets.shape[1], K), np.nan)
    delta_v = float(np.sum(np.abs(nu)) * reference.delta / system.mass)
    sides = facets[:K].T, facets[K:].T
    parts = reference.chi[: K + 1], nu, *sides, np.nan, unknown, unknown, delta_v
    return Plan(*parts, KNOWN, objective=np.nan, bound=np.nan, gap=np.nan)


def path_bounds(problem: PlanProblem, path: Reference) -> list[Array]:
    """Certified lower bounds [m] on the clearance from every facet over every cell, each (cells, F)."""
    system, arcs, h = problem.system, ARCS, problem.delta / ARCS
    A, B = system.A, system.B
    x = path.fine(arcs)  # (cells, arcs+1, n)
    u = path.nu[:, None, :]
    v, A3 = x @ A.T + u @ B.T, np.linalg.matrix_power(A, 3)
    # |x(t_j + s) | <= e^{|A| h} |x_j| + int e^{|A| s} |B u| elementwise
    _, forced = discretize(np.abs(A), np.abs(B), h)
    size = np.abs(x[:, :-1]) @ growth(A, h).T + np.abs(u) @ forced.T
    fourth = size @ np.abs(A3 @ A).T + np.abs(u) @ np.abs(A3 @ B).T  # (cells, arcs, n)
    lead, trail = x[:, :-1] + h / 3 * v[:, :-1], x[:, 1:] - h / 3 * v[:, 1:]
    points = np.stack([x[:, :-1], lead, trail, x[:, 1:]])  # (4, cells, arcs, n)
    share = ((np.arange(arcs) + np.arange(4)[:, None] / 3) / arcs)[:, None, :, None]
    reach = np.max(np.abs(points), axis=(0, 2))  # (cells, n)
    lows = []
    for i, body in enumerate(problem.unsafe):
        b = problem.offsets(i)
        offset = b[:, 0, None] * (1 - share) + b[:, 1, None] * share
        rows = body.rows(system)
        size = np.abs(rows).T
        low = np.min(points @ rows.T - offset, axis=0) - h**4 / 384 * (fourth @ size)
        slack = ROUNDING * (reach @ size + np.max(np.abs(b), axis=1))
        lows.append(np.min(low, axis=1) - slack)
    return lows


def certified(
    problem: PlanProblem, nu: Array, targets: Array, value: float, bound: float, status: str, **others: Any
) -> Plan:
    """Re-check inputs and make a `Plan` of them, with `others` for the rest; `NotCertified` if one fails."""
    K = problem.K
    check = recheck(problem, nu)
    shape = (len(problem.unsafe), problem.cells)
    surplus = np.reshape([s.max(axis=1) for s in check.surplus], shape)
    facets = np.reshape([s.argmax(axis=1) for s in check.surplus], shape).astype(int)
    if surplus.size and np.min(surplus) < 0:
        i, k = (int(at) for at in np.unravel_index(np.argmin(surplus), shape))
        place, margin = f"{problem.unsafe[i].name} in cell {k}", problem.required(i)[k].max()
        short = f"{-surplus[i, k]:.3g} m short of its margin ({margin:.3g} m)"
        raise NotCertified(f"plan not certified: the clearance from {place} is {short}")
    amount, name = check.goal
    if amount > 0:
        raise NotCertified(f"plan not certified: the goal is missed by {amount:.3g} of its scale: {name}")
    nu, extra = check.reference.nu, surplus[:, :K]
    return Plan(
        chi=check.reference.chi,
        nu=nu,
        facets=facets[:, :K],
        tail_facets=facets[:, K:],
        margin=float(np.min(extra[[not body.of_state for body in problem.unsafe]], initial=np.inf)),
        extra=extra,
        desired=targets,
        delta_v=float(np.sum(np.abs(nu)) * problem.delta / problem.system.mass),
        status=status,
        objective=float(value),
        bound=float(bound),
        gap=float(relative_gap(value, bound)),
        **others,
    )
