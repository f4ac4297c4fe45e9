"""Feedback bound: what S's feedback commands at most after a hand-over (docs/theory.md, Proposition 4)."""

from collections.abc import Callable

import numpy as np

from ...model.system import Array

ROUNDS = 60  # most rounds of a bound that grows with the errors which it allows
SETTLED, SPARE = 1e-4, 2e-3  # relative change at which it counts as settled, and what is added to it then
SLOWER = 1.5  # ratio of decay times: demand of sets that U leaves to that of a ball


def feedback_bound(
    norms: Array, level: Array, left: Array, u_max: Array, pushed: Callable[[Array], Array]
) -> Array:
    """Bound on what S's feedback commands so many periods after a hand-over, shape (settling + 2, m) [N].

    Any bound that does not grow would be sound, as long as the recoverable sets keep to it. This one falls as
    what errors demand that start with `level`, to what disturbances and the errors of the commands themselves
    demand for ever: each round allows for the errors of the one before. `norms` is what a ball of errors
    demands, period by period; `left` is added to the level and still left of it beyond the settling
    horizon; `pushed` bounds what the rows of the commands need under a profile, noise of estimates
    included.
    """
    ages, falls = np.arange(len(norms)), np.maximum.accumulate(norms[::-1])[::-1] / norms[0]
    shape = level * np.stack([np.interp(ages / SLOWER, ages, fall) for fall in falls.T], axis=1)
    bound = shape
    for _ in range(ROUNDS):
        more = pushed(bound)
        parts = np.maximum(shape + more[:-1], more[-1] + left)
        before, bound = bound, np.maximum.accumulate(parts[::-1])[::-1]
        if np.all(bound - before <= SETTLED * before) or np.any(bound[-1] > u_max):
            break
    return np.asarray(bound * (1 + SPARE))
