"""Feedback bound: largest command of S's feedback after a hand-over (docs/theory.md, Proposition 4)."""

from collections.abc import Callable

import numpy as np

from ...model.system import Array

ROUNDS = 60  # most rounds of a bound that grows with the errors which it allows
SETTLED, SPARE = 1e-4, 2e-3  # relative change at which it counts as settled, and the share added to it then
SLOWER = 1.5  # ratio of decay times: demand of sets that U leaves to that of a ball


def feedback_bound(
    norms: Array, level: Array, tail: Array, u_max: Array, effect: Callable[[Array], Array]
) -> Array:
    """Bound on S's feedback in each period after a hand-over, shape (settling + 2, m) [N].

    Any bound that does not grow would be sound, as long as the recoverable sets keep to it. This one falls as
    the feedback of errors that start with `level`, to the level that disturbances and the commands' errors
    sustain: each round allows for the errors of the one before. `norms` is the feedback of a ball of errors,
    period by period; `tail` is added to the level and remains of it beyond the settling
    horizon; `effect` bounds the tightening of the rows of the commands under a feedback bound, estimate noise
    included.
    """
    ages, falls = np.arange(len(norms)), np.maximum.accumulate(norms[::-1])[::-1] / norms[0]
    shape = level * np.stack([np.interp(ages / SLOWER, ages, fall) for fall in falls.T], axis=1)
    bound = shape
    for _ in range(ROUNDS):
        tightening = effect(bound)
        parts = np.maximum(shape + tightening[:-1], tightening[-1] + tail)
        before, bound = bound, np.maximum.accumulate(parts[::-1])[::-1]
        if np.all(bound - before <= SETTLED * before) or np.any(bound[-1] > u_max):
            break
    return np.asarray(bound * (1 + SPARE))
