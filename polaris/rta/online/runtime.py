"""The online monitor in flight: one call per decision that never raises, and always has an answer.

The monitor proves that U may fly if the measured state is within its error bound and the decision is made in
time. Here that is made sure of as far as it can be: measurements, clock, the experimental controller and the
monitor itself are checked, and whatever is wrong with one of them, S flies. The page "Online monitor" of the
documentation says why the proof survives, and what cannot be caught.
"""

import time
from collections.abc import Callable, Iterable
from math import inf, isfinite
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ...model.system import Array
from ...model.untrusted import Unreadable, kind_of, sanitize
from ..filter_input import commanded
from ..methods.monitor import Monitor
from ..methods.on_board import MonitorOnBoard
from .decision_clock import DecisionClock
from .decision_log import DecisionLog, jsonable, restored
from .estimate import Measurement
from .observer import MeasurementCheck
from .runtime_options import FlightFault, OnlineDecision, RuntimeOptions


class _CallArguments(NamedTuple):
    """Arguments of one call, as they are used and logged."""

    now: Any
    measurement: Any
    applied: Any
    reference: Any
    number: Any
    resynchronised: Any


class OnlineMonitor:
    """The online monitor behind checks of everything that it is told.

    Parameters
    ----------
    monitor : Monitor or MonitorOnBoard
        The second decides with the tables of flight code, to the last bit as the code does on the states
        and periods that pass the checks. The checks themselves are not part of the code.
    options : RuntimeOptions, optional
    log : DecisionLog, optional
    timer : callable
        Monotonic wall clock [s] by which budgets are measured.

    Raises
    ------
    ScenarioError
        If an option does not fit the scene.
    """

    def __init__(
        self,
        monitor: Monitor | MonitorOnBoard,
        options: RuntimeOptions | None = None,
        log: DecisionLog | None = None,
        timer: Callable[[], float] = time.perf_counter,
    ) -> None:
        self.monitor, self.grid = monitor, monitor.grid
        self.options = options or RuntimeOptions()
        self.limits = self.options.limits(self.grid)
        self._log, self._timer = log, timer
        self.clock = DecisionClock(self.grid.period, self.limits.tolerance, self.limits.drift)
        self.observer = MeasurementCheck(
            self.grid, self.limits, self.options.farthest, self.options.reacquire
        )
        self._faults: list[FlightFault] = []  # of U, since the last step
        self._active, self._dwelt, self._strikes = 0, self.options.min_dwell, 0
        self._unwritten: list[FlightFault] = []  # of the log
        self._latch: list[FlightFault] = []  # why S flies for good
        self._asked: object = None

    def command(self, law: Callable[..., Any], *arguments: Any) -> Array | None:
        """Command of U, clipped to the limits [N]; None if it is at fault, and S must fly at once.

        Nothing that U raises gets through, ``SystemExit`` and ``KeyboardInterrupt`` included: an interrupt
        from the keyboard during a call counts as a fault of U. Reading what it returns belongs to the call,
        and to its time budget.
        """
        start, limit = self._timer(), self.grid.system.u_max
        u, fault = commanded(law, arguments, limit.shape, BaseException)
        if not fault and self._timer() - start > self.limits.budget:
            fault = "over its time budget"
        if u is None or fault:
            self._faults.append(FlightFault("controller", fault))
            return None
        return np.asarray(np.clip(u, -limit, limit))

    def resynchronise(self, now: float) -> None:
        """Set the clock's reading at the next call [s], after it was found wrong."""
        self._asked = Unreadable(kind_of(now)) if now is None else sanitize(now)

    def step(
        self,
        now: float,
        measurement: Measurement | None = None,
        applied: ArrayLike | None = None,
        reference: float | None = None,
        number: int | None = None,
    ) -> OnlineDecision:
        """Decide who flies from the moment of effect on; never raises on any input.

        Every argument is read once, at the beginning; what it was is logged.

        Parameters
        ----------
        now : float
            The clock [s], counted from the start of the plan.
        measurement : Measurement or None
            The newest there is, not newer than the decision's instant; with ``[timing]`` the state predicted
            for that instant. One with an earlier stamp is predicted here, under any thrust.
        applied : array_like, shape (m,) or (2, m), optional
            Input since the instant of the last call: held, or its least and largest values [N]. By
            default nothing but the limits is known.
        reference : float, optional
            Second clock [s], from any origin; in all calls or in none.
        number : int, optional
            Number of this decision, counted by something else than the clock; missed ones count. Without it
            and without a second clock a missed call cannot be told from a clock that was set: S flies then,
            until `resynchronise`.
        """
        start = self._timer()
        call = _CallArguments(
            sanitize(now),
            Measurement.sanitize(measurement),
            sanitize(applied),
            sanitize(reference),
            sanitize(number),
            self._asked,
        )
        self._asked = None
        u_faults, self._faults = self._faults, []
        self._strikes += len(u_faults)
        faults = [*u_faults]
        k, mode, margin, reason = -1, 0, np.nan, ""
        try:
            k, mode, margin, reason = self._decide(call, faults)
        except Exception as error:  # whatever is wrong with the monitor itself, S flies
            self._own_fault(f"raised {type(error).__name__}", faults)
        deadline = self.limits.deadline
        if self.grid.latency and k >= 0:  # nor beyond the moment of effect
            deadline = min(deadline, k * self.grid.period + self.grid.latency - float(call.now))
        if self._timer() - start > deadline:
            self._own_fault("deadline missed", faults)
        answer = self._answer(k, mode, margin, reason, faults)
        if self._log is not None:
            self._record(self._log, answer, u_faults, call)
        return answer

    def _own_fault(self, text: str, faults: list[FlightFault]) -> None:
        self._strikes += 1
        faults.insert(0, FlightFault("monitor", text))

    def _decide(self, call: _CallArguments, faults: list[FlightFault]) -> tuple[int, int, float, str]:
        if call.resynchronised is not None:
            if isinstance(call.resynchronised, float) and isfinite(call.resynchronised):
                self.clock.resynchronise(call.resynchronised)
            else:
                faults.append(FlightFault("clock", "asked to resynchronise to no finite number"))
        k, fault = self.clock.read(call.now, call.reference, call.number)
        if fault is not None:
            faults.append(fault)
        before = self._active  # after missed decisions too: more than S, which flew, is allowed for
        if self.clock.missed and before:  # the permission ended, and S took over
            self._dwelt, self._active = self.clock.missed, 0
        self.observer.note_inputs(call.applied, faults)
        state = None if k is None else self.observer.observe(call.measurement, k * self.grid.period, faults)
        self._latched(faults)
        if k is None or state is None:
            return -1 if k is None else k, 0, np.nan, ""
        if k >= self.grid.decisions:
            return k, 0, np.nan, "the plan has ended"
        mode, margin, reason = self.monitor.explained(k, state, before)
        if mode and not self._active and self._dwelt < self.options.min_dwell:
            faults.append(
                FlightFault("rule", f"dwell: {self._dwelt} of {self.options.min_dwell} decisions in S")
            )
        return k, mode, margin, reason

    def _latched(self, faults: list[FlightFault]) -> None:
        o, agreed, conflicts = self.options, self.observer.agreed, self.observer.conflicts
        if not self._latch and o.latch is not None and self._strikes >= o.latch:
            self._latch.append(FlightFault("rule", f"latched: {self._strikes} faults of U or of the monitor"))
        if not self._latch and o.latch_conflicts is not None and conflicts >= o.latch_conflicts:
            self._latch.append(FlightFault("rule", f"latched: {conflicts} conflicts between measurements"))
        faults += self._latch
        if agreed < o.reacquire:
            faults.append(FlightFault("rule", f"re-acquiring: {agreed} of {o.reacquire} measurements agree"))

    def _answer(
        self, k: int, mode: int, margin: float, reason: str, faults: list[FlightFault]
    ) -> OnlineDecision:
        until, blocking = -np.inf, [fault for fault in faults if not fault.harmless]
        mode = 0 if blocking else mode
        if mode:
            until, self._dwelt = (k + 1) * self.grid.period + self.grid.latency, self.options.min_dwell
        else:
            self._dwelt = 1 if self._active else self._dwelt + 1
        self._active = mode
        if blocking:
            reason = str(blocking[0])
        unwritten, self._unwritten = self._unwritten, []
        return OnlineDecision(k, mode, margin, until, reason, (*faults, *unwritten))

    def _record(
        self, log: DecisionLog, answer: OnlineDecision, u_faults: list[FlightFault], call: _CallArguments
    ) -> None:
        try:
            record = {
                "k": answer.k,
                "mode": answer.mode,
                "margin": jsonable(answer.margin),
                "reason": answer.reason,
                "faults": [str(fault) for fault in answer.faults],
                "controller": [fault.text for fault in u_faults],
            }
            record |= {name: jsonable(value) for name, value in call._asdict().items()}
            log.write(record)
        except Exception:  # whatever is wrong with a log must not end the flight
            self._unwritten.append(FlightFault("log", "the line before could not be written"))


LATE = "monitor: deadline missed"


def replay_log(
    records: Iterable[dict[str, Any]],
    monitor: Monitor | MonitorOnBoard,
    options: RuntimeOptions | None = None,
) -> list[OnlineDecision]:
    """Feed the logged inputs to a new runtime with the same options.

    The answers are those of the flight, bit for bit, missed deadlines and faults of U included: the log
    says where they were.

    Parameters
    ----------
    records : iterable of dict
        As `polaris.rta.online.decision_log.read_log` gives them, from the first decision on.
    monitor : Monitor or MonitorOnBoard
    options : RuntimeOptions, optional
    """
    entries = list(records)
    # Read at the beginning and at the end of every step.
    wall = (end for one in entries for end in (0.0, inf if LATE in one["faults"] else 0.0))
    online, answers = OnlineMonitor(monitor, options, timer=wall.__next__), []
    for record in entries:
        if record["resynchronised"] is not None:
            online.resynchronise(restored(record["resynchronised"]))
        online._faults += [FlightFault("controller", text) for text in record["controller"]]
        answers.append(online.step(*(restored(record.get(name)) for name in _CallArguments._fields[:-1])))
    return answers
