"""Disturbance: an acceleration, or another rate of the states, arbitrary or constant in a flight."""

from dataclasses import dataclass

import numpy as np

from ...model.craft import Craft
from ..tracker.channel import Channel
from ..tracker.loop import Array, Loop


@dataclass(frozen=True, eq=False)
class Disturbance:
    """Measurable ``w`` with ``norm(w, 2) <= w_max`` that enters ``x' = ... + D w``."""

    D: Array
    w_max: float

    @classmethod
    def from_system(cls, system: Craft, h: float) -> "Disturbance":
        """Return the disturbance, which there always is."""
        return cls(system.D, system.w_max)

    def extend(self, loop: Loop) -> Loop:
        """Add one channel."""
        return loop.with_channels(Channel("disturbance", np.array([self.w_max]), rate=self.D, ball=True))


@dataclass(frozen=True, eq=False)
class Bias:
    """Constant rate of the states: columns of `rates` (n, k), each times an unknown share of at most one."""

    rates: Array

    @classmethod
    def from_system(cls, system: Craft, h: float) -> "Bias | None":
        """Return the bias of the disturbance, if one is declared."""
        return cls(system.biases) if system.biases.size else None

    def extend(self, loop: Loop) -> Loop:
        """Add one channel."""
        one = np.ones(self.rates.shape[1])
        return loop.with_channels(Channel("bias", one, rate=self.rates, constant=one))
