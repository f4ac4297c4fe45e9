"""Disturbances of simulated runs: random ones, and the worst case of a facet in closed form."""

from __future__ import annotations

from typing import Literal

import numpy as np
from scipy.linalg import expm

from .controllers import AffineController
from .integration import Integrator
from .system import Array

Disturbance = Literal["none", "random", "worst", "mixed"]


def disturbances(
    flight: Integrator, n: int, rng: np.random.Generator, kind: Disturbance
) -> tuple[Array, Array]:
    """Disturbances constant over each integration step, shape (steps, n, p), norm at most w_max.

    Also the direction, at time 0, in which the initial error of each worst-case run counts, (worst, n).
    """
    system, steps = flight.system, flight.steps
    w = np.zeros((steps, n, system.p))
    adjoint = np.zeros((0, system.n))
    if kind == "none" or system.w_max == 0:
        return w, adjoint
    worst = n if kind == "worst" else (n // 2 if kind == "mixed" else 0)
    if worst:
        w[:, :worst], adjoint = _worst_case(flight, worst, rng)
    count = n - worst
    if count:
        holds = rng.integers(1, max(2, flight.steps_per_cell * 4), count)
        for run in range(count):
            pieces = -(-steps // holds[run])
            raw = rng.normal(size=(pieces, system.p))
            raw /= np.maximum(np.linalg.norm(raw, axis=1, keepdims=True), 1e-300)
            raw *= np.where(rng.random((pieces, 1)) < 0.5, 1.0, rng.random((pieces, 1)))
            w[:, worst + run] = np.repeat(raw, holds[run], axis=0)[:steps] * system.w_max
    return w, adjoint


def _worst_case(flight: Integrator, n: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """``w(s) = w_max D' lambda(s) / norm``: the adjoint of one facet (or input) and instant per run.

    For an unsaturated linear loop this is the disturbance that takes the error furthest in that
    direction at that instant; under sampled feedback the continuous adjoint is used.
    """
    clearance, system = flight.schedule.safety.clearance, flight.system
    rows = [-u.normals @ system.position for u in clearance.unsafe] + [
        flight.tracking.gain,
        -flight.tracking.gain,
    ]
    flat = np.vstack(rows)
    targets = rng.integers(1, flight.steps + 1, n)
    adjoint = np.zeros((n, system.n))
    chosen = flat[rng.integers(0, len(flat), n)]
    back = {}
    for number in set(flight.modes.tolist()):
        controller = flight.schedule.controllers[number]
        gain = controller.gain if isinstance(controller, AffineController) else np.zeros((system.m, system.n))
        back[number] = expm((system.A - system.B @ gain) * flight.dt)
    w = np.zeros((flight.steps, n, system.p))
    for step in range(flight.steps - 1, -1, -1):
        starting = targets == step + 1
        adjoint[starting] = chosen[starting]
        direction = adjoint @ system.D
        size = np.sqrt(np.einsum("ij,ij->i", direction, direction))[:, None]
        w[step] = direction * (system.w_max / np.maximum(size, 1e-300))
        adjoint = adjoint @ back[int(flight.modes[step // flight.steps_per_cell])]
    return w, adjoint
