"""How far an observer's estimate may be off, and the gain with which that costs least."""

from __future__ import annotations

import numpy as np
from scipy.linalg import LinAlgError, expm, solve_discrete_are

from reach.numerics.errors import ReachError
from reach.numerics.linear import powers
from reach.tubes.flow import LinearFlow

from .errors import ScenarioError
from .system import Array, LinearSystem
from .timing import Observer

PARTS = 4
"""Parts of a period over each of which integrals are bounded by the trapezoid rule."""

ROUNDED = 1e-9
"""Relative round-off of a bound, upwards."""

TRUST = 4.0 ** np.arange(-6, 7)
"""Shares by which measurements are trusted less than their bounds say: the best of these gains is kept."""

LEFT_OVER, LONGEST = 1e-2, 4096
"""What of an error counts as forgotten, as a share of itself, and the most periods that may take."""

UNSEEN = 1e-6
"""Share of the thrust limits that is taken for unknown, so that every gain forgets."""


def pushed(
    system: LinearSystem, observer: Observer, h: float, moved: Array | None = None
) -> tuple[Array, Array, Array]:
    """What is left of an error k periods later, (P + 1, n, n), and all that has come in the first k, (P, n).

    And a bound on the latter for ever, (n,) (docs/theory.md, Proposition 40). `moved` bounds by how much
    states are displaced when they are measured.

    Raises
    ------
    ScenarioError
        If errors are not forgotten.
    """
    noise = observer.noise if moved is None else observer.noise + np.abs(observer.measures) @ moved
    E = system.error_map(system.thrusters.error(system.u_max))
    loop, count = observer.rest @ np.asarray(expm(system.A * h)), 1
    with np.errstate(over="ignore", invalid="ignore"):
        while not _radius(np.linalg.matrix_power(loop, count)) <= LEFT_OVER:
            if count >= LONGEST:
                rule = "leave errors of the estimate that no filter forgets"
                raise ScenarioError("navigation", observer.measures.tolist(), rule)
            count *= 2
    left = powers(loop, count)
    flow = LinearFlow.continuous(system.A, system.D, system.w_max, h / PARTS, E)
    rows = (left[:-1] @ observer.rest).reshape(-1, system.n)
    each = flow.disturbance_support(rows, PARTS)[-1].reshape(count, system.n)
    sums = np.cumsum(each + np.abs(left[:-1] @ observer.gain) @ noise, axis=0) * (1 + ROUNDED)
    ever = np.linalg.solve(np.eye(system.n) - np.abs(left[-1]), sums[-1])
    return left, sums, np.asarray(ever * (1 + ROUNDED))


def filtered(
    system: LinearSystem, observer: Observer, h: float, grid: tuple[int, int], moved: Array | None = None
) -> Array:
    """Bounds on the errors of an observer's estimates in each of K steps, and from then on, shape (K + 1, n).

    One row, shape (1, n), if it has been at work for long. `grid` are the steps K, and the periods in each.
    """
    left, sums, ever = pushed(system, observer, h, moved)
    if observer.initial is None:
        return ever[None]
    (K, q), count = grid, len(sums)
    carried = np.abs(powers(left[1], K * q + count)) @ observer.initial
    bounds = carried + np.vstack([0 * ever, sums, np.repeat(ever[None], K * q, axis=0)])
    late = np.maximum(bounds[K * q :].max(axis=0), ever)
    while np.any(late < (needed := sums[-1] + np.abs(left[-1]) @ late)):
        late = np.maximum(late, needed * (1 + ROUNDED))
    return np.array([*(bounds[k * q : (k + 1) * q].max(axis=0) for k in range(K)), late]) * (1 + ROUNDED)


def _radius(M: Array) -> float:
    """Spectral radius of the absolute values; not a number if they are none."""
    return float(np.max(np.abs(np.linalg.eigvals(np.abs(M))))) if np.all(np.isfinite(M)) else np.nan


def design(
    system: LinearSystem, measures: Array, noise: Array, h: float, weight: Array, initial: Array | None
) -> Observer:
    """The steady Kalman gain, of several trusts in the measurements, whose bounds cost least.

    `weight` (m, n) is what errors of the estimate are weighed by: the gain of the safety controller.

    Raises
    ------
    ScenarioError
        If measurements do not see a motion that the disturbance or thrusters excite.
    """
    unknown = np.hstack([system.D * system.w_max, system.B * system.thrusters.error(system.u_max)])
    unknown = np.hstack([unknown, system.B * (UNSEEN * system.u_max)])
    step, excited = expm(system.A * h), expm(system.A * h / 2) @ unknown * h
    best, least = None, np.inf
    for trust in TRUST:
        covariance = np.diag((noise * trust) ** 2)
        try:
            P = solve_discrete_are(step.T, measures.T, excited @ excited.T, covariance)
            gain = np.linalg.solve(measures @ P @ measures.T + covariance, measures @ P).T
            found = Observer(measures, noise, gain, initial)
            cost = float(np.sum(np.abs(weight) @ pushed(system, found, h)[2] / system.u_max))
        except (LinAlgError, ValueError, ReachError, ScenarioError):
            continue
        if cost < least:
            best, least = found, cost
    if best is None:
        rule = "must see every motion that does not decay: no filter of these measurements forgets its errors"
        raise ScenarioError("navigation", measures.tolist(), rule)
    return best
