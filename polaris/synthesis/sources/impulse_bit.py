"""Impulse bit whose remainder is carried to the next period (docs/theory.md, Lemma 6 (c))."""

from dataclasses import dataclass, replace

import numpy as np

from ...model.craft import Craft
from ..tracker.channel import Channel
from ..tracker.loop import Array, Loop
from .source import remembers


@dataclass(frozen=True)
class CarriedImpulse:
    """Impulses are multiples of a bit; the rest of a command, at most `bit` [N s], adds to the next one.

    Errors of magnitude act on the impulse made, not on the command: the difference moves the plant as a
    carried impulse times `along` does.
    """

    bit: float
    along: float = 0.0

    @classmethod
    def from_system(cls, system: Craft, h: float) -> "CarriedImpulse | None":
        """Return the carried impulse where the loop remembers it."""
        carried = system.timing.carried_impulse
        return cls(carried, system.thrusters.along) if carried and remembers(system) else None

    def extend(self, loop: Loop) -> Loop:
        """Add the remainder as a state, and its next value as a channel."""
        m, h, first, B = loop.m, loop.h, loop.N, loop.B
        loop = loop.with_states(np.zeros((m, first + m)), applied=np.eye(m) / h)
        sample = np.zeros((loop.N, m))
        sample[first:] = np.eye(m)
        size, error = np.full(m, self.bit), np.full(m, self.bit * self.along)
        carried = Channel("carried impulse", size, sample=sample, push=-np.eye(m) / h)
        if self.along == 0:
            return loop.with_channels(carried)
        offset = np.abs(B) @ error
        loop = loop.with_channels(carried, Channel("carried impulse", error, rate=loop.A @ B))
        return replace(loop, offset=loop.offset + offset, offset_at_nodes=loop.offset_at_nodes + offset)


@dataclass(frozen=True, eq=False)
class ImpulseDrift:
    """Rates of the states by jitter, and by carried impulses where the loop has none, as columns (n, k)."""

    drift: Array

    @classmethod
    def from_system(cls, system: Craft, h: float) -> "ImpulseDrift | None":
        """Return the drift, carried impulses included where a box stands for the estimate."""
        drift = system.shifting if remembers(system) else system.impulse_rates
        return cls(drift) if drift.size else None

    def extend(self, loop: Loop) -> Loop:
        """Add one channel."""
        return loop.with_channels(Channel("impulse drift", np.ones(self.drift.shape[1]), rate=self.drift))
