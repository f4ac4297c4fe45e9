"""Impulse bit whose remainder is carried to the next period."""

from dataclasses import dataclass, replace

import numpy as np

from ..tracker.loop import Channel, Loop


@dataclass(frozen=True)
class CarriedImpulse:
    """Impulses are multiples of a bit; what is left of a command, at most `bit` [N s], adds to the next one.

    Attributes
    ----------
    bit : float
        Impulse bit [N s].
    along, across : float
        Errors of magnitude and direction (`polaris.model.thrusters.Thrusters`). They act on what is made, not
        on what is commanded: the difference moves the plant as a carried impulse times `share` does
        (docs/theory.md, Lemma 6 (c)).
    """

    bit: float
    along: float = 0.0
    across: float = 0.0

    def share(self, m: int) -> float:
        """Share of a carried impulse by which errors of what is made exceed those of what is commanded."""
        return self.along + self.across * (m - 1)

    def extend(self, loop: Loop) -> Loop:
        """Add the remainder as a state, and its next value as a channel."""
        m, h, first, B = loop.m, loop.h, loop.N, loop.B
        loop = loop.with_states(np.zeros((m, first + m)), applied=np.eye(m) / h)
        sample = np.zeros((loop.N, m))
        sample[first:] = np.eye(m)
        size, more = np.full(m, self.bit), np.full(m, self.bit * self.share(m))
        carried = Channel("carried impulse", size, sample=sample, push=-np.eye(m) / h)
        if self.share(m) == 0:
            return loop.with_channels(carried)
        away = np.abs(B) @ more
        loop = loop.with_channels(carried, Channel("carried impulse", more, rate=loop.A @ B))
        return replace(loop, offset=loop.offset + away, offset_at_nodes=loop.offset_at_nodes + away)

    @property
    def assumption(self) -> str:
        """Sentence that is printed with the guarantee."""
        return f"thrusters: impulses are multiples of {self.bit:g} N s, the remainder is carried"
