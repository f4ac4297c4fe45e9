"""How far the state that flight software predicts may be from the true one."""

from __future__ import annotations

import numpy as np

from reach.tubes.flow import LinearFlow

from .system import Array, LinearSystem

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
