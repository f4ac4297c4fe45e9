"""Estimates of a navigation filter of which only the bounds on its errors are known."""

from dataclasses import dataclass, replace

from ..tracker.loop import Array, Channel, Loop


@dataclass(frozen=True, eq=False)
class Estimate:
    """Every estimate is within `error` (n,) of the state measured, however the difference changes."""

    error: Array

    def extend(self, loop: Loop) -> Loop:
        """Add one channel of noise, carried over the delay."""
        offset = loop.offset_measured
        loop = loop.with_channels(Channel("estimate", self.error + offset, noise=loop.carry))
        return replace(loop, navigated=offset)

    @property
    def assumption(self) -> str:
        """Sentence that is printed with the guarantee."""
        return f"navigation: estimates within {self.error.tolist()} of the true state"
