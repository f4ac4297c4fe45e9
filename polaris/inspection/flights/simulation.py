"""Filtered flights of many runs at once: exact motion, thrust held for a control period."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ...model.checks import positive, whole
from ...model.errors import ScenarioError
from ...model.system import Array
from ...rta.projection import FAILED
from ..filters.explicit import Filtered
from ..inspection import Inspection
from .primary import Primary


class BatchFilter(Protocol):
    """A filter of R runs at once: `Centralized` or `Decentralized`."""

    def batch(self, x: Array, sun: Array, desired: Array) -> Filtered:
        """Filter inputs of shape (R, N, 3) at states (R, N, 6) and sun angles (R,) [rad]."""
        ...


@dataclass(frozen=True, eq=False)
class Step:
    """One control period of a batch, as observers see it.

    Attributes
    ----------
    k : int
        Index of the period.
    t : float
        Its start [s].
    x : ndarray, shape (R, N, 6)
        States at the start.
    sun : ndarray, shape (R,)
        Sun angles at the start [rad].
    desired : ndarray, shape (R, N, 3)
        [N]
    filtered : Filtered
        Where the program failed, its input is replaced by no thrust.
    between : ndarray, shape (B, R, N, 6)
        States at instants strictly inside the period, evenly spaced.
    """

    k: int
    t: float
    x: Array
    sun: Array
    desired: Array
    filtered: Filtered
    between: Array


def whole_periods(duration: float, period: float) -> int:
    """Periods [s] in a duration [s]; a ScenarioError if that is no whole number."""
    count = int(np.rint(positive("duration", duration, "s") / positive("period", period, "s")))
    if not np.isclose(count * period, duration, rtol=1e-9) or count < 1:
        raise ScenarioError("period", period, f"must divide the duration {duration:g} s")
    return count


def fly(
    inspection: Inspection,
    filtering: BatchFilter,
    primary: Primary,
    x: Array,
    sun: Array,
    duration: float,
    period: float = 1.0,
    between: int = 1,
    observe: Callable[[Step], None] = lambda step: None,
) -> Array:
    """Fly R runs of N deputies.

    Parameters
    ----------
    inspection : Inspection
    filtering : BatchFilter
    primary : Primary
    x : ndarray, shape (R, N, 6)
        Initial states.
    sun : ndarray, shape (R,)
        Sun angles at the start [rad].
    duration, period : float
        Of the flight and of one control period [s]; the period must divide the duration.
    between : int
        Instants inside each period handed to the observer.
    observe : callable
        Called once per period, in order.

    Returns
    -------
    ndarray, shape (R, N, 6)
        Final states.
    """
    count = whole_periods(duration, period)
    parts = whole("between", between, 0) + 1
    moves = [inspection.held(period * (b + 1) / parts) for b in range(parts)]
    for k in range(count):
        t = k * period
        angles = inspection.sun_angle(t, sun)
        desired = primary(t, x)
        lost = np.asarray(~np.isfinite(desired).all(axis=2))
        filtered = filtering.batch(x, angles, np.where(lost[..., None], 0.0, desired))
        u = filtered.u
        failed = filtered.status == FAILED
        if failed.any():
            u[failed] = 0.0
        filtered.status[lost] = FAILED
        after = np.stack([x @ Phi.T + u @ Gamma.T for Phi, Gamma in moves])
        observe(Step(k, t, x, angles, desired, filtered, after[:-1]))
        x = after[-1]
    return x


@dataclass(frozen=True, eq=False)
class InspectionRun:
    """One flight of N deputies, with everything that figures show.

    Attributes
    ----------
    inspection : Inspection
    t : ndarray, shape (K+1,)
        Instants at which the filter was asked [s], and the end.
    x : ndarray, shape (K+1, N, 6)
        States.
    sun : ndarray, shape (K+1,)
        Sun angle [rad].
    u, desired : ndarray, shape (K, N, 3)
        Applied and desired thrust [N].
    status : ndarray of int, shape (K, N)
        See `polaris.rta.projection`.
    h : ndarray, shape (K, M)
        Values of the barriers, in the order of `Families.family`.
    """

    inspection: Inspection
    t: Array
    x: Array
    sun: Array
    u: Array
    desired: Array
    status: NDArray[np.int8]
    h: Array

    @property
    def delta_v(self) -> Array:
        """Spent velocity change of each deputy [m/s] (eq. 25), shape (K+1, N)."""
        steps = np.abs(self.u).sum(axis=2) / self.inspection.mass * np.diff(self.t)[:, None]
        return np.concatenate([np.zeros((1, steps.shape[1])), np.cumsum(steps, axis=0)])


def fly_one(
    inspection: Inspection,
    filtering: BatchFilter,
    primary: Primary,
    x: Array,
    sun: float,
    duration: float,
    period: float = 1.0,
) -> InspectionRun:
    """Fly one run and keep all of it; arguments as in `fly`, x of shape (N, 6)."""
    kept = Kept(0)
    fly(inspection, filtering, primary, x[None], np.array([sun]), duration, period, 0, kept)
    return kept.flight(inspection, sun, duration, period)


class Kept:
    """Observer of `fly` that keeps one run of a batch in full.

    Parameters
    ----------
    run : int
        Its number in the batch.
    """

    def __init__(self, run: int) -> None:
        self.run = run
        self.steps: list[tuple[Array, ...]] = []

    def __call__(self, step: Step) -> None:
        """Take in one control period."""
        given = (step.x, step.filtered.u, step.desired, step.filtered.status, step.filtered.rows.h)
        self.steps.append((np.array(step.t), *(values[self.run].copy() for values in given)))
        self.last = step

    def flight(self, inspection: Inspection, sun: float, duration: float, period: float) -> InspectionRun:
        """The run, from the angle of the sun at its start [rad]; arguments else as in `fly`."""
        t, x, u, desired, status, h = (np.stack(values) for values in zip(*self.steps, strict=True))
        Phi, Gamma = inspection.held(period)
        final = self.last.x @ Phi.T + self.last.filtered.u @ Gamma.T  # as `fly` moves the whole batch
        t = np.append(t, duration)
        x = np.concatenate([x, final[None, self.run]])
        return InspectionRun(inspection, t, x, inspection.sun_angle(t, sun), u, desired, status, h)
