"""Observer on board: estimates are made from measurements of some outputs, with a fixed gain."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import expm

from ...model.craft import Craft
from ...model.timing import Observer
from ..tracker.channel import Channel
from ..tracker.loop import Array, Loop
from .estimate import state_offset
from .source import remembers

MEASUREMENT = "measurement"  # name of the channel


@dataclass(frozen=True, eq=False)
class Filter:
    """Observer whose error, within `settled` (n,), is a state; it sees states displaced by `offset` (n,)."""

    observer: Observer
    offset: Array
    settled: Array | None = None

    @classmethod
    def from_system(cls, system: Craft, h: float) -> "Filter | None":
        """Return the observer where the loop remembers it."""
        observer = system.observer
        if observer is None or not remembers(system):
            return None
        error = system.measured if observer.settled is None else observer.settled
        return cls(observer, state_offset(system, h), error + system.carry_offset)  # it sees states with that

    def extend(self, loop: Loop) -> Loop:
        """Add the error of the estimate as a state, and the noise of the measurements as a channel."""
        n, first, rest, measures = loop.n, loop.N, self.observer.rest, np.abs(self.observer.measures)
        loop = loop.with_states(
            np.hstack([-rest @ loop.shown, rest @ expm(loop.A * loop.h)]), sensed=loop.carry
        )
        shown_now = dict(zip([(a, b) for a, b, _ in loop.enter], loop.shown_now, strict=True))
        loop = loop.entering(slice(first, first + n), lambda a, b: -rest @ shown_now[a, b])
        sample = np.zeros((loop.N, len(measures)))
        sample[first : first + n] = self.observer.gain
        offset = loop.offset_measured
        size = self.observer.noise + measures @ self.offset + measures @ offset
        loop = loop.with_channels(Channel(MEASUREMENT, size, sample=sample, constant=self.observer.constant))
        return replace(loop, navigated=offset, settled=self.settled)
