"""Observer on board: estimates are made from measurements of some outputs, with a fixed gain."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import expm

from ...model.craft import Craft
from ...model.timing import Observer
from ..tracker.loop import Array, Channel, Loop
from .estimate import displaced
from .source import remembers

MEASUREMENT = "measurement"  # name of the channel


@dataclass(frozen=True, eq=False)
class Filter:
    """Observer whose error, within `settled` (n,), is a state; it sees states displaced by `away` (n,)."""

    observer: Observer
    away: Array
    settled: Array | None = None

    @classmethod
    def of(cls, system: Craft, h: float) -> "Filter | None":
        """Return the observer where the loop remembers it."""
        seen = system.observer
        if seen is None or not remembers(system):
            return None
        settled = system.measured if seen.settled is None else seen.settled
        return cls(seen, displaced(system, h), settled + system.carried_away)  # it sees states with that

    def extend(self, loop: Loop) -> Loop:
        """Add the error of the estimate as a state, and the noise of the measurements as a channel."""
        n, first, rest, measures = loop.n, loop.N, self.observer.rest, np.abs(self.observer.measures)
        loop = loop.with_states(
            np.hstack([-rest @ loop.shown, rest @ expm(loop.A * loop.h)]), known=loop.carry
        )
        now = dict(zip([(a, b) for a, b, _ in loop.enter], loop.shown_now, strict=True))
        loop = loop.entering(slice(first, first + n), lambda a, b: -rest @ now[a, b])
        sample = np.zeros((loop.N, len(measures)))
        sample[first : first + n] = self.observer.gain
        offset = loop.offset_measured
        size = self.observer.noise + measures @ self.away + measures @ offset
        loop = loop.with_channels(Channel(MEASUREMENT, size, sample=sample))
        return replace(loop, navigated=offset, settled=self.settled)


def observed(loop: Loop, system: Craft) -> tuple[Loop, Array]:
    """Return the loop with what each update adds to the estimate through the gain, and its rows, (r, N + r).

    It is the difference between what is measured and what was expected.
    """
    seen, n, N = system.observer, loop.n, loop.N
    assert seen is not None
    count = len(seen.measures)
    own = loop.shown.copy()
    own[:, N - n :] -= expm(loop.A * loop.h)
    now = dict(zip([(a, b) for a, b, _ in loop.enter], loop.shown_now, strict=True))
    loop = loop.with_states(np.hstack([seen.measures @ own, np.zeros((count, count))]))
    loop = loop.entering(slice(N, N + count), lambda a, b: seen.measures @ now[a, b])
    for i, channel in enumerate(loop.channels):
        if channel.name == MEASUREMENT and channel.sample is not None:
            sample = np.vstack([channel.sample[:N], np.eye(count)])
            channels = (*loop.channels[:i], replace(channel, sample=sample), *loop.channels[i + 1 :])
            loop = replace(loop, channels=channels)
    return loop, np.eye(loop.N)[N:]
