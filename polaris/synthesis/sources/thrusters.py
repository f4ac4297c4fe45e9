"""Thrusters that apply a command up to a share of it, and up to a fixed error."""

from dataclasses import dataclass

import numpy as np

from ...model.craft import Craft
from ...model.thrusters import Thrusters
from ..tracker.channel import Channel
from ..tracker.loop import Loop

THRUSTERS = "thrusters"  # name of the channel


@dataclass(frozen=True)
class ThrusterErrors:
    """Errors of magnitude, direction and mass, which grow with the command, and of a dropped impulse bit."""

    errors: Thrusters

    @classmethod
    def from_system(cls, system: Craft, h: float) -> "ThrusterErrors | None":
        """Return the errors of thrusters, with the effect of jitter and pulses on each input."""
        return None if system.thrusters.exact else cls(system.thrusters)

    def extend(self, loop: Loop) -> Loop:
        """Add one channel, whose sizes follow the bounds on the commands."""
        size, share = np.full(loop.m, self.errors.bit), self.errors.part if self.errors.proportional else None
        return loop.with_channels(Channel(THRUSTERS, size, rate=loop.B, share=share))
