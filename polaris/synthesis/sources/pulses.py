"""Pulses that are not centred in their periods: they lead held inputs of the same impulse, or follow them."""

from dataclasses import dataclass

import numpy as np

from ...model.craft import Craft
from ...model.timing import Lead
from ..tracker.channel import Channel
from ..tracker.loop import Loop

PULSES = "pulses"  # name of the channel


@dataclass(frozen=True)
class PulseLead:
    """Mean impulse of a period by which pulses lead, in proportion to the command up to a bound (Lemma 6)."""

    lead: Lead

    @classmethod
    def from_system(cls, system: Craft, h: float) -> "PulseLead | None":
        """Return the lead of pulses that are not centred."""
        return None if system.timing.lead is None else cls(system.timing.lead)

    def extend(self, loop: Loop) -> Loop:
        """Add one channel, which moves the states by the rate ``A B`` times the lead."""
        rate, size = loop.A @ loop.B, np.array(self.lead.fixed)
        return loop.with_channels(Channel(PULSES, size, rate=rate, share=self.lead.part))
