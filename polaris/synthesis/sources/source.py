"""Source of uncertainty, as the loop of a craft and its simulation need it."""

from typing import Protocol, Self

from ...model.craft import Craft
from ..tracker.loop import Loop


class Source(Protocol):
    """One way in which a flight differs from its model."""

    @classmethod
    def from_system(cls, system: Craft, h: float) -> Self | None:
        """Return the source as a system declares it, its law renewed every h [s]; None where it does not."""

    def extend(self, loop: Loop) -> Loop:
        """Return the loop with the states and channels of this source."""


def remembers(system: Craft) -> bool:
    """Return True if delay and observer are states of the loop, False if a box stands for the estimate.

    A box it is where any of several patterns of measurements may be met, and where navigation of which only
    bounds are known may be lost.
    """
    timing, filtered = system.timing, system.observer is not None
    by_phase = timing.delay > 0 and system.error_by_step is not None and not filtered
    outage = any(not len(fault.thrust) for fault in system.transients) and not filtered
    return not (timing.missed or by_phase or outage)
