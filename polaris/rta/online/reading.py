"""Checks of single measurements, before they are compared with earlier ones."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...model.foreign import numbers, real
from ...model.system import Array
from ..decision_grid import DecisionGrid
from .estimate import Measurement
from .faults import Fault, largest


class Reading(NamedTuple):
    """A measurement whose form is in order: finite, of the right shape, in time."""

    stamp: float
    state: Array
    half_widths: Array


class Reader:
    """What may be used of measurements that arrive.

    Parameters
    ----------
    grid : DecisionGrid
    max_age : float
        Oldest measurement that may be used [s].
    farthest : float
        Entries beyond this are taken for faults.
    same : float
        Stamps closer than this are equal [s].
    """

    def __init__(self, grid: DecisionGrid, max_age: float, farthest: float, same: float) -> None:
        self.grid, self.max_age, self.farthest, self.same = grid, max_age, farthest, same
        self._shape = (grid.system.n,)
        self._half = grid.half_widths
        self._half_list = self._half.tolist()
        self._newest = -np.inf
        self._state = b""

    def read(self, measurement: object, instant: float) -> Reading | Fault:
        """Check a measurement at the instant of a decision [s]; a good one is remembered."""
        if not isinstance(measurement, Measurement):
            if measurement is None:
                return Fault("measurement", "missing")
            return Fault("measurement", "malformed: not a measurement")
        stamp = real(measurement.stamp)
        x = numbers(measurement.state, self._shape)
        if stamp is None or x is None:
            return Fault("measurement", f"malformed: the {'stamp' if stamp is None else 'state'}")
        wrong = self._in_time(stamp, instant)
        if wrong is not None:
            return wrong
        size = largest(x.tolist())
        if size != size:
            return Fault("measurement", "the state is not finite")
        if size > self.farthest:
            return Fault("measurement", f"absurd: an entry beyond {self.farthest:g}")
        half = self._half
        if measurement.half_widths is not None:
            given = self._bound(measurement.half_widths)
            if isinstance(given, Fault):
                return given
            half = given
        contents = x.tobytes()
        repeated, self._newest, self._state = contents == self._state, stamp, contents
        if repeated:
            return Fault("measurement", "frozen: the same state as before with a new stamp")
        return Reading(stamp, x, half)

    def _in_time(self, stamp: float, instant: float) -> Fault | None:
        age = instant - stamp
        if age - age != 0.0:
            return Fault("measurement", "the stamp is not finite")
        if age < -self.same:
            return Fault("measurement", "future: newer than the decision's instant")
        if stamp <= self._newest + self.same:
            what = "duplicated" if stamp >= self._newest - self.same else "reordered"
            return Fault("measurement", f"{what}: not newer than the last one, so missing")
        if age > self.max_age:
            return Fault("measurement", f"stale: {age:.6g} s old")
        return None

    def _bound(self, value: object) -> Array | Fault:
        half = numbers(value, self._shape)
        if half is None:
            return Fault("measurement", "malformed: the half widths")
        for given, most in zip(half.tolist(), self._half_list, strict=True):
            if not 0 <= given <= most:  # also for nan
                return Fault("measurement", "half widths: not between zero and the scene's")
        return half
