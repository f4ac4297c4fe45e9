"""How far the state that flight software predicts may be from the true one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from reach.tubes.flow import LinearFlow

from .errors import ScenarioError
from .system import Array, LinearSystem
from .timing import Timing

PARTS = 32
"""Parts of a prediction over each of which integrals are bounded by the trapezoid rule."""

ROUNDED = 1e-9
"""Relative round-off of a bound, upwards."""


def prediction_error(system: LinearSystem, estimate: Array, thruster: Array, tau: float) -> Array:
    """Bound on the error of the state predicted over tau [s] from an estimate, shape (n,).

    The prediction follows the model under the commands in force, which are known: what is left is the error
    of the estimate (n,) carried along, the disturbance, and errors of what is applied (m,), each at its
    worst (docs/theory.md, Lemma 25). Rounded upwards; the estimate itself for tau = 0.
    """
    if not tau > 0:
        return estimate
    E = system.error_map(thruster)
    flow = LinearFlow.continuous(system.A, system.D, system.w_max, tau / PARTS, E)
    pushed = flow.disturbance_support(np.eye(system.n), PARTS)[-1]
    carried = np.abs(np.linalg.matrix_power(flow.phi, PARTS)) @ estimate
    return np.asarray((carried + pushed) * (1 + ROUNDED))


def predicting(system: LinearSystem, timing: Timing, period: float | None) -> LinearSystem:
    """The system whose controllers act on predictions, of every age that may occur.

    Raises
    ------
    ScenarioError
        If the system is so unstable that nothing bounds a prediction.
    """
    if not timing.predicts:
        return replace(system, timing=timing)
    worst, ages = (
        system.thrusters.error(system.u_max),
        timing.delay + (period or 0.0) * np.arange(timing.missed + 1),
    )
    with np.errstate(over="ignore", invalid="ignore"):
        errors = [prediction_error(system, system.navigation, worst, age) for age in ages.tolist()]
    if not np.all(np.isfinite(errors)):
        rule = f"is too long for this system: a prediction over {ages[-1]:g} s has no bound"
        raise ScenarioError("timing.delay_s", timing.delay, rule)
    return replace(system, estimate_error=np.max(errors, axis=0), timing=timing)
