"""Number of the decision at which a call is made, by time: recoverable sets are indexed by it."""

from math import floor, isfinite

from ...model.untrusted import real
from .runtime_options import FlightFault

MOST = 1e9  # numbers of decisions beyond this are none


class DecisionClock:
    """Readings of a clock, believed only where a second opinion agrees.

    The second opinion is another clock; or the decision's number as the caller counts it, decisions that
    were missed included; or, without either, the number of calls: then each should come one period after
    the last, and a call that was missed cannot be told from a clock that was set. It is compared over the
    whole time since the first reading, or since the last `resynchronise`, so that no sequence of small steps
    goes unnoticed. A reading that agrees again is believed again; a clock that was set never does, until
    `resynchronise` says so.

    Decisions are one period [s] apart and may be called so much earlier or later than their instants as the
    tolerance says [s]; both clocks may differ by the drift [s].
    """

    def __init__(self, period: float, tolerance: float, drift: float) -> None:
        self.period, self.tolerance, self.drift = period, tolerance, drift
        self.k = -1  # of the last decision
        self.missed = 0  # decisions between the last one and the one before
        self._calls = 0
        self._offset: float | None = None  # of the clock from its reference
        self._asked: float | None = None

    def resynchronise(self, now: float) -> None:
        """Believe this reading [s] at the next call, despite any earlier belief.

        The next reading may be up to the tolerance and the drift away from it.
        """
        self._asked = now

    def read(
        self, now: object, reference: object = None, number: object = None
    ) -> tuple[int | None, FlightFault | None]:
        """Number of the decision, if it is known, and the clock's fault.

        The clock [s], the second clock [s] from any origin, and the number as the caller counts it.
        """
        self.missed = 0
        self._calls += 1
        if number is not None:
            counted = real(number)
            if counted is None or not counted.is_integer() or not 0 <= counted < MOST:
                return None, FlightFault("clock", "the decision's number is not a whole number")
            self._calls = int(counted) + 1
        time, other = real(now), self._calls * self.period if reference is None else real(reference)
        if time is None or not isfinite(time):
            return None, FlightFault("clock", "the reading is not a finite number")
        if other is None or not isfinite(other):
            return None, FlightFault("clock", "the second clock's reading is not a finite number")
        k = floor((time + self.tolerance) / self.period)
        if self._asked is not None and abs(time - self._asked) <= self.tolerance + self.drift:
            self._offset, self._asked, self.k = time - other, None, k - 1
        if self._offset is None:
            # Without a second clock the plan begins with the first call, or with the decision numbered 0.
            self._offset = time - other if reference is not None else -self.period
        difference = time - other - self._offset
        if not abs(difference) <= (self.drift if reference is not None else self.tolerance):
            side = "ahead of" if difference > 0 else "behind"
            against = "the number of calls" if number is None else "the decision's number"
            against = against if reference is None else "the second clock"
            return None, FlightFault("clock", f"the reading is {abs(difference):.6g} s {side} {against}")
        if reference is not None and number is not None and k + 1 != self._calls:
            return None, FlightFault("clock", f"called for decision {self._calls - 1} at decision {k}")
        return self._place(k, time - k * self.period)

    def _place(self, k: int, late: float) -> tuple[int | None, FlightFault | None]:
        before, self.k = self.k, max(k, self.k)
        if late > self.tolerance:
            return None, FlightFault("clock", f"called {late:.6g} s after decision {k}")
        if k < 0:
            return None, FlightFault("clock", "called before the start of the plan")
        if k <= before:
            return None, FlightFault("clock", f"called again for decision {k}")
        if before >= 0 and k > before + 1:
            self.missed = k - before - 1
            return k, FlightFault("missed", f"{self.missed} decisions before decision {k}")
        return k, None
