"""Check of measurements as they arrive: a state that decisions may rest on, or a fault."""

from math import isfinite
from typing import NamedTuple

import numpy as np

from ...model.system import Array
from ...model.tolerances import TIME
from ...model.untrusted import numbers, real
from ..decision_grid import DecisionGrid
from .estimate import BoxFilter, BoxMotion, Measurement
from .runtime_options import Durations, FlightFault


class CheckedMeasurement(NamedTuple):
    """A measurement whose form is in order: finite, of the right shape, in time."""

    stamp: float
    state: Array
    half_widths: Array


class MeasurementCheck:
    """Checks every measurement by itself and against all earlier ones.

    Entries of the state beyond `farthest` are taken for faults. After a conflict so many measurements as are
    `trusted` must agree; at the start the initial set vouches for them.
    """

    def __init__(self, grid: DecisionGrid, limits: Durations, farthest: float, trusted: int) -> None:
        self.grid = grid
        self._tol = TIME * grid.period
        outage = any(not len(fault.thrust) for fault in grid.system.transients)  # then no older one counts
        self._max_age, self._farthest = self._tol if outage else limits.max_age, farthest
        self._shape = (grid.system.n,)
        self._newest, self._state = -np.inf, b""  # of the good ones
        theta = grid.schedule.safety.problem.initial_set
        half = np.abs(theta.G).sum(axis=1)
        motion = BoxMotion(grid.system, grid.period, limits.memory + self._tol)
        for duration in (0.0, grid.period):  # worked out before the flight
            motion.over(duration)
        self.filter = BoxFilter(motion, theta.c - half, theta.c + half)
        self.agreed = self._enough = trusted
        self.conflicts = 0  # since so many agreed
        self._called = 0.0

    def note_inputs(self, applied: object, faults: list[FlightFault]) -> None:
        """Take note of the input since the last call, (m,) or (2, m) [N]; None if it is not known."""
        fresh = self.filter.t >= self._called - self._tol
        self._called = np.inf  # not known, unless `observe` is told
        m, limit = self.grid.system.m, self.grid.system.u_max * (1 + TIME)
        constant = numbers(applied, (m,))
        bounds = numbers(applied, (2, m)) if constant is None else np.array([constant, constant])
        if bounds is not None:
            rising = np.array([-limit, *bounds, limit])
            bounds = bounds if (rising[:-1] <= rising[1:]).all() else None
        if applied is not None and bounds is None:
            faults.append(FlightFault("measurement", "malformed: the applied input"))
        self.filter.note_commands(bounds, fresh)

    def observe(self, measurement: object, instant: float, faults: list[FlightFault]) -> Array | None:
        """State at a decision's instant [s], within the scene's half widths of the truth; else None.

        What is wrong is added to the faults. After a conflict there is a state, which may have lied.
        """
        self._called = instant
        reading = self._read(measurement, instant)
        if isinstance(reading, str):
            faults.append(FlightFault("measurement", reading))
            return None
        self._compare(reading, faults)
        age = instant - reading.stamp
        if age <= self._tol:
            return reading.state
        # Only the measurement's own error bound counts here: an earlier one may have lied.
        low, high = self.filter.ahead(reading.state, reading.half_widths, age)
        if not (high - low <= 2 * self.grid.half_widths).all():
            faults.append(
                FlightFault("measurement", f"late: {age:.6g} s old, too old to tell the state by now")
            )
            return None
        return np.asarray((low + high) / 2)

    def _compare(self, reading: CheckedMeasurement, faults: list[FlightFault]) -> None:
        stamp = max(reading.stamp, self.filter.t)
        if stamp > reading.stamp + self._tol:  # only before the first accepted one
            faults.append(FlightFault("measurement", "late: from before the start of the plan"))
        elif not self.filter.reaches(stamp):
            faults.append(
                FlightFault("estimate", "nothing to compare with: the last measurement is too long ago")
            )
            self.filter.restart(*reading)
            self.agreed = 1
        else:
            conflict = self.filter.cut(stamp, reading.state, reading.half_widths)
            if conflict < 0:
                self.agreed += 1
                self.conflicts *= self.agreed < self._enough
                return
            name = self.grid.system.state_names[conflict]
            faults.append(FlightFault("estimate", f"conflict: {name} contradicts earlier measurements"))
            self.conflicts, self.agreed = self.conflicts + 1, 0  # the box stays: what lied is not let in

    def _read(self, measurement: object, instant: float) -> CheckedMeasurement | str:
        """A measurement at a decision's instant [s], remembered if its form is in order; or its fault."""
        if not isinstance(measurement, Measurement):
            return "missing" if measurement is None else "malformed: not a measurement"
        stamp, x = real(measurement.stamp), numbers(measurement.state, self._shape)
        if stamp is None or x is None:
            return f"malformed: the {'stamp' if stamp is None else 'state'}"
        age = instant - stamp
        if not isfinite(age):
            return "the stamp is not finite"
        if age < -self._tol:
            return "future: newer than the decision's instant"
        if stamp <= self._newest + self._tol:
            fault = "duplicated" if stamp >= self._newest - self._tol else "reordered"
            return f"{fault}: not newer than the last one, so missing"
        if age > self._max_age:
            return f"stale: {age:.6g} s old"
        if not np.isfinite(x).all():
            return "the state is not finite"
        if np.abs(x).max() > self._farthest:
            return f"absurd: an entry beyond {self._farthest:g}"
        half, offset = self.grid.half_widths, np.zeros(self._shape)
        if measurement.half_widths is not None:
            half_widths = numbers(measurement.half_widths, self._shape)
            if half_widths is None:
                return "malformed: the half widths"
            half, offset = half_widths, self.grid.system.state_offset  # jitter displaces what is measured
        if not ((half >= 0) & (half + offset <= self.grid.half_widths)).all():  # also for nan
            return "half widths: not between zero and the scene's"
        half = half + offset
        if age > self._tol:  # pulses displace what is measured between nodes
            half = half + np.array(self.grid.system.timing.intersample_offset or 0.0)
        contents = x.tobytes()
        repeated, self._newest, self._state = contents == self._state, stamp, contents
        if repeated:
            return "frozen: the same state as before with a new stamp"
        return CheckedMeasurement(stamp, x, half)
