"""The errors of an observer's estimates that come of given noise."""

import numpy as np

from ..model.timing import Array, Observer

PAST = 100
"""Periods before the start whose noise counts, where an observer has long been at work."""


def followed(
    observer: Observer, held: tuple[Array, Array, Array], times: tuple[int, int], w: Array, told: Array
) -> Array:
    """Errors (steps, R, n) of the estimates that commands rest on if an observer filters noise.

    Each measurement is off by its bound, with the sign of `told` (steps, R, n) in the step that uses it. The
    first estimate is off by its bounds, with the signs of `told` at first, or by the worst of past noise in
    that direction. Thrusters do what is commanded. Before the start nothing disturbs. What is `held` over a
    step has these effects; `times` are the steps of a period, and of the delay.
    """
    (Ad, _, Dd), (substeps, lag) = held, times
    pushes, found = w @ Dd.T, np.empty_like(told)
    error, left = np.sign(told[0]) * (0.0 if observer.initial is None else observer.initial), observer.gain
    for _ in range(PAST if observer.initial is None else 0):
        error = error + observer.noise * np.sign(told[0] @ left) @ left.T
        left = observer.rest @ np.linalg.matrix_power(Ad, substeps) @ left
    over, since = np.linalg.matrix_power(Ad, lag), np.zeros_like(error)  # what disturbs in the delay adds up
    for step in range(len(told)):
        if step:
            old = pushes[step - 1 - lag] if step > lag else 0 * error
            error, since = error @ Ad.T - old, since @ Ad.T - pushes[step - 1] + old @ over.T
        if step and step % substeps == 0:
            noise = observer.noise * np.sign(told[step] @ observer.measures.T)
            error = error @ observer.rest.T + noise @ observer.gain.T
        found[step] = error @ over.T + since
    return found
