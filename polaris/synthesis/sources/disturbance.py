"""Disturbance: an acceleration, or any other rate of the states, within a ball at every instant."""

from dataclasses import dataclass

import numpy as np

from ..tracker.loop import Array, Channel, Loop


@dataclass(frozen=True, eq=False)
class Disturbance:
    """Measurable ``w`` with ``norm(w, 2) <= w_max`` that enters ``x' = ... + D w``."""

    D: Array
    w_max: float

    def extend(self, loop: Loop) -> Loop:
        """Add one channel."""
        return loop.with_channels(Channel("disturbance", np.array([self.w_max]), rate=self.D, ball=True))

    @property
    def assumption(self) -> str:
        """Sentence that is printed with the guarantee."""
        return f"disturbance: at most {self.w_max:g} in the 2-norm at every instant, however it changes"
