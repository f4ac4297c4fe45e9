"""Disturbance: an acceleration, or any other rate of the states, within a ball at every instant."""

from dataclasses import dataclass

import numpy as np

from ...model.craft import Craft
from ..tracker.loop import Array, Channel, Loop


@dataclass(frozen=True, eq=False)
class Disturbance:
    """Measurable ``w`` with ``norm(w, 2) <= w_max`` that enters ``x' = ... + D w``."""

    D: Array
    w_max: float

    @classmethod
    def of(cls, system: Craft, h: float) -> "Disturbance":
        """Return the disturbance, which there always is."""
        return cls(system.D, system.w_max)

    def extend(self, loop: Loop) -> Loop:
        """Add one channel."""
        return loop.with_channels(Channel("disturbance", np.array([self.w_max]), rate=self.D, ball=True))
