"""Differences between flights with an outage of navigation and without it (docs/theory.md, Proposition 8)."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from ...model.craft import Array, Craft
from ...model.estimates.observer import ObserverErrors
from ...model.estimates.prediction import prediction_error
from ...model.timing import Transient
from ...model.tolerances import ROUNDING
from ..tracker.channel import Channel
from ..tracker.loop import ClosedLoop
from ..tracker.period_sets import rates_added, sampled_added
from ..tracker.tightening import Tightening
from .late_faults import touched
from .observer import MEASUREMENT


@dataclass(frozen=True, eq=False)
class OutageDifference:
    """Difference of the loop states of two flights, after any number of periods up to some.

    Attributes
    ----------
    added : list of ndarray, shape (N, g)
        Generators that each further period adds to the difference.
    start : list of ndarray, shape (N, s)
        Generators of the effect of the states at the start, by the number of periods.
    """

    added: list[Array]
    start: list[Array]

    @classmethod
    def within(cls, box: Array) -> "OutageDifference":
        """Build a difference within a box, shape (N,)."""
        return cls([np.diag(box)], [np.zeros((len(box), 0))])

    def support(self, rows: Array) -> Array:
        """Return its support along rows (..., N), shape (...)."""
        total = largest = np.zeros(rows.shape[:-1])
        for added, start in zip(self.added, self.start, strict=True):
            total = total + np.abs(rows @ added).sum(axis=-1)
            largest = np.maximum(largest, total + np.abs(rows @ start).sum(axis=-1))
        return np.asarray(largest)


def outage_errors(
    system: Craft, fault: Transient, h: float, remainder: Callable[[Array, list[OutageDifference]], Array]
) -> Array:
    """Bound errors of predictions over a whole outage, and the rest of the first estimate error, (n,).

    S steers the prediction, exactly as a loop without disturbance, in which `remainder` of some rows and sets
    remains (`Tracking.difference_tightening`). Periods may be missed before and after.
    """
    timing, eye = system.timing, np.eye(system.n)
    measured = system.measured + system.state_offset
    age = fault.lasts + timing.delay + h * (2 * timing.missed + 1)
    error = prediction_error(system, measured, system.thrusters.error(system.u_max), age)
    carried = [np.abs(expm(system.A * h * i)) @ system.navigation for i in range(fault.missed + 1)]
    first = np.max(carried, axis=0)
    return np.asarray((error + remainder(eye, [OutageDifference.within(first)])[-1, :, 0]) * (1 + ROUNDING))


def unlearned(system: Craft, fault: Transient, limits: Tightening) -> Array:
    """Bound the state's change by estimates of an observer that misses an outage, shape (n,).

    They are compared with those it would have made if only as many periods had been missed as may be, with
    measurements as close to what it expects as their errors allow (docs/theory.md, Proposition 8 (c)).
    """
    observer, timing, (h, A) = system.observer, system.timing, (limits.closed.loop.h, system.A)
    assert observer is not None
    late, count, gains = timing.missed, limits.horizon, (observer.gain, *observer.after)
    measured, error = system.measured + system.state_offset, system.thrusters.error(system.u_max)
    expected = [prediction_error(system, measured, error, h * (j + 1)) for j in range(late + 1)]
    innovations = [np.abs(observer.measures) @ each for each in expected]
    pairs = list(zip(gains, innovations, strict=True))
    each = np.max([np.abs(L) @ np.maximum(y - observer.noise, 0.0) for L, y in pairs], axis=0)
    difference, missed = 0 * each, touched(fault.lasts, h) + 2 * late
    for _ in range(missed // (late + 1)):
        difference = np.abs(expm(A * h * (late + 1))) @ difference + each
    steps = [observer.rests[-1] @ expm(A * h * (j + 1)) for j in range(late + 1)]
    first = np.max([np.abs(step) @ difference for step in steps], axis=0)
    first = first + np.max([np.abs(L - gains[-1]) @ (y + observer.noise) for L, y in pairs], axis=0)
    settled = system.measured if observer.settled is None else observer.settled
    decay = ObserverErrors(system, observer, h).fading(first * (1 + ROUNDING), settled)
    decay = np.maximum.accumulate(decay[::-1])[::-1]
    ages = timing.delay + h * np.arange(late + 1)
    carried = np.max([np.abs(expm(A * age)) for age in ages.tolist()], axis=0)
    errors = np.vstack(
        [np.tile(np.maximum(decay[0], difference), (missed - late, 1)), decay[:1].repeat(late, axis=0), decay]
    )
    deviations = errors[np.minimum(np.arange(count), len(errors) - 1)] @ carried.T * (1 + ROUNDING)
    eye, channel = np.eye(system.n), Channel("outage", deviations[0], noise=np.eye(system.n))
    response = limits.response(channel, eye, eye)
    reached = response.at_nodes(deviations)[: count + 1].max(axis=0)
    total = np.linalg.solve(eye - np.abs(limits.transitions[count]), reached)
    return np.asarray((total + response.between @ deviations[0] + deviations[0]) * (1 + ROUNDING))


def unmade(
    closed: ClosedLoop, blind: ClosedLoop, u_max: Array, remembered: Array, count: int
) -> OutageDifference:
    """Return the difference that up to so many updates in a row make which an observer does not make.

    The other flight has the same disturbances and errors, and measures meanwhile as exactly as what is
    constant in its errors lets it. The loop is `blind` without updates, and other states than the tracking
    error are `remembered`, (N - n,).
    """
    channels = [each for each in closed.loop.channels if each.name != MEASUREMENT]
    sized = [(c, c.size if c.share is None else c.size + c.share(u_max)) for c in channels]
    once, other = (
        np.hstack([rates_added(each.loop, sized), sampled_added(each, sized)]) for each in (closed, blind)
    )
    for channel in closed.loop.channels:
        if channel.name == MEASUREMENT and channel.constant is not None:
            inexact = closed.sampled(channel) * np.maximum(2 * channel.constant - channel.size, 0.0)
            once, other = np.hstack([once, inexact]), np.hstack([other, 0 * inexact])
    first, second, difference = np.eye(closed.loop.N), np.eye(closed.loop.N), OutageDifference([], [])
    for _ in range(count):
        difference.added.append((second @ other - first @ once) * (1 + ROUNDING))
        first, second = closed.F @ first, blind.F @ second
        difference.start.append((second - first)[:, closed.loop.n :] * remembered * (1 + ROUNDING))
    return difference
