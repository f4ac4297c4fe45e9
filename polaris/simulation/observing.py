"""An observer's errors under attack: which noise is worst, and the errors of estimates that come of noise."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..model.system import Array

if TYPE_CHECKING:
    from .integration import Integrator


PAST = 100
"""Periods before the start whose noise counts, where an observer has long been at work."""


def worst_errors(flight: Integrator, step: int, direction: Array, later: Array) -> tuple[Array, Array]:
    """Worst errors of estimates in a step along `direction` (R, p + n), in which disturbances and they count.

    Of an observer its noise, as `followed` reads it: `later` (R, n) is how much its error counts at the end
    of the step, returned with how much it does before, and counted in `direction`.
    """
    observer, known, (Ad, _, Dd), p = flight.system.observer, flight.known[step], flight.held, flight.system.p
    noted = direction[:, p:]
    if observer is None:
        return np.sign(noted) * known, later
    direction[:, :p] -= later @ Dd
    before = later @ Ad + noted
    if step % flight.substeps:
        return 0 * before, before
    way = np.sign(before @ observer.gain) @ np.linalg.pinv(observer.measures).T if step else before
    size = np.maximum(np.abs(way).max(axis=1, keepdims=True), 1e-300)
    return way / size * known.min(), before @ observer.rest


def followed(flight: Integrator, w: Array, told: Array) -> Array:
    """Errors (steps, R, n) of the estimates that commands rest on if an observer filters noise.

    Each measurement is off by its bound, with the sign of `told` (steps, R, n) in the step that uses it. The
    first estimate is off by its bounds, with the signs of `told` at first, or by the worst of past noise in
    that direction. Thrusters do what is commanded. Before the start nothing disturbs. A delay is the nearest
    whole number of steps.
    """
    system, (Ad, _, Dd), lag = flight.system, flight.held, round(flight.system.timing.delay / flight.dt)
    observer, pushes, found = system.observer, w @ Dd.T, np.empty_like(told)
    assert observer is not None
    error, left = np.sign(told[0]) * (0.0 if observer.initial is None else observer.initial), observer.gain
    for _ in range(PAST if observer.initial is None else 0):
        error = error + observer.noise * np.sign(told[0] @ left) @ left.T
        left = observer.rest @ np.linalg.matrix_power(Ad, flight.substeps) @ left
    over, since = np.linalg.matrix_power(Ad, lag), np.zeros_like(error)  # what disturbs in the delay adds up
    for step in range(len(told)):
        if step:
            old = pushes[step - 1 - lag] if step > lag else 0 * error
            error, since = error @ Ad.T - old, since @ Ad.T - pushes[step - 1] + old @ over.T
        if step and step % flight.substeps == 0:
            noise = observer.noise * np.sign(told[step] @ observer.measures.T)
            error = error @ observer.rest.T + noise @ observer.gain.T
        found[step] = error @ over.T + since
    return found
