"""Observer on board: estimates are made from measurements of some outputs, with a fixed gain."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import expm

from ..tracker.loop import Array, Channel, Loop


@dataclass(frozen=True, eq=False)
class Filter:
    """``x+ = x- + gain (y - measures x-)`` at every measurement, ``x-`` predicted under known commands.

    Attributes
    ----------
    measures : ndarray, shape (r, n)
    noise : ndarray, shape (r,)
        Bounds on the errors of what is measured.
    gain : ndarray, shape (n, r)
    """

    measures: Array
    noise: Array
    gain: Array

    def extend(self, loop: Loop) -> Loop:
        """Add the error of the estimate as a state, and the noise of the measurements as a channel."""
        n, first = loop.n, loop.N
        rest = np.eye(n) - self.gain @ self.measures
        loop = loop.with_states(
            np.hstack([-rest @ loop.shown, rest @ expm(loop.A * loop.h)]), known=loop.carry
        )
        now = dict(zip([(a, b) for a, b, _ in loop.enter], loop.shown_now, strict=True))
        loop = loop.entering(slice(first, first + n), lambda a, b: -rest @ now[a, b])
        sample = np.zeros((loop.N, len(self.noise)))
        sample[first : first + n] = self.gain
        offset = loop.offset_measured
        size = self.noise + np.abs(self.measures) @ offset
        loop = loop.with_channels(Channel("measurement", size, sample=sample))
        return replace(loop, navigated=offset)

    @property
    def assumption(self) -> str:
        """Sentence that is printed with the guarantee."""
        return f"navigation: measurements within {self.noise.tolist()} of their true values"
