"""Estimates of a navigation filter of which only the bounds on its errors are known."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from ...model.craft import Craft
from ...model.estimates.prediction import add_pulses
from ..tracker.channel import Channel, Share
from ..tracker.loop import Array, Loop
from .source import remembers


@dataclass(frozen=True, eq=False)
class Estimate:
    """Error of every estimate within `error` (n,) of the state measured, however the difference changes.

    Errors of thrusters, a `share` of commands (..., m) to (..., k), add `by_lag` (n, k)
    times their size of so many periods before, by their number.
    """

    error: Array
    share: Share | None = None
    by_lag: Mapping[int, Array] = field(default_factory=dict)

    @classmethod
    def from_system(cls, system: Craft, h: float) -> "Estimate | None":
        """Return the box of estimates as they are measured, or as a whole where the loop has no states."""
        timing, steps = system.timing, system.error_by_step
        base = system if steps is None else system.with_estimate_error(np.min(steps, axis=0))
        if not remembers(system):
            least = base.estimate_bound(np.zeros(base.m))
            if np.any(base.estimate_bound(base.u_max) != least):
                return cls(least, base.proportional_errors, base.by_lag)
            return cls(least) if np.any(least) else None
        if system.observer is not None or not np.any(base.navigation):
            return None
        if timing.delay > 0:
            return cls(system.measured + state_offset(system, h))
        return cls(np.maximum(base.navigation - system.carry_offset, 0.0))

    def extend(self, loop: Loop) -> Loop:
        """Add one channel of noise, carried over the delay, and one for each number of periods."""
        offset = loop.offset_measured
        channels = [Channel("estimate", self.error + offset, noise=loop.carry)]
        for lag, added in self.by_lag.items():
            share = partial(self._share, added=added)
            channels.append(Channel("estimate", 0 * self.error, noise=loop.carry, share=share, lag=lag))
        return replace(loop.with_channels(*channels), navigated=offset)

    def _share(self, u: Array, added: Array) -> Array:
        """Return the part of estimate errors that grows with commands u (..., m), shape (..., n)."""
        assert self.share is not None
        return np.asarray(self.share(u) @ added.T)


def state_offset(system: Craft, h: float) -> Array:
    """Bounds on the state offset by jitter and pulses at the time of measurement, shape (n,)."""
    return add_pulses(system.timing, h, system.state_offset_at_nodes - system.carry_offset)


def step_errors(system: Craft) -> Array:
    """Bounds on the estimate errors of each step and ever after, beside the loop's own, (K + 1, n)."""
    if system.error_by_step is None or (remembers(system) and system.observer is not None):
        return np.zeros((1, system.n))  # first errors of an observer are states of the loop
    return np.asarray(system.error_by_step - system.error_by_step.min(axis=0))
