"""Source of uncertainty: what the loop, the simulation and the printed assumptions need of it."""

from typing import Protocol

from ..tracker.loop import Loop


class Source(Protocol):
    """One way in which a flight differs from its model."""

    def extend(self, loop: Loop) -> Loop:
        """Return the loop with the states and channels of this source."""
        ...

    @property
    def assumption(self) -> str:
        """Sentence that is printed with the guarantee."""
        ...
