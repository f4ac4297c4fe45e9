"""Thrusters that apply what is commanded up to a share of it, and up to a fixed error."""

from dataclasses import dataclass

import numpy as np

from ...model.thrusters import Thrusters
from ..tracker.loop import Array, Channel, Loop


@dataclass(frozen=True)
class ThrusterErrors:
    """Errors of magnitude, direction and mass, which grow with the command, and of a dropped impulse bit."""

    errors: Thrusters
    carried: bool = False
    """An impulse bit is carried: commands of the others count by their sum (docs/theory.md, Lemma 6 (c))."""

    def share(self, u: Array) -> Array:
        """Return the part of the errors that grows with the commands u (..., m), shape (..., m)."""
        if not self.carried:
            return self.errors.part(u)
        others = np.abs(u).sum(axis=-1, keepdims=True) - np.abs(u)
        return np.asarray(self.errors.along * np.abs(u) + self.errors.across * others)

    def extend(self, loop: Loop) -> Loop:
        """Add one channel, whose sizes follow the bounds on the commands."""
        if self.errors.exact:
            return loop
        share = self.share if self.errors.proportional else None
        return loop.with_channels(
            Channel("thrusters", np.full(loop.m, self.errors.bit), rate=loop.B, share=share)
        )

    @property
    def assumption(self) -> str:
        """Sentence that is printed with the guarantee."""
        along, across, bit = self.errors.along, self.errors.across, self.errors.bit
        return f"thrusters: within {along:.3g} of the own command, {across:.3g} of the others, {bit:.3g} N"
