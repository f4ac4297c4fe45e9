"""Answers of the flight code, call by call, in double or single precision: the reference of the C text.

One call per control period. Whatever arrives, the answer is finite and within the limits, and S flies for
good once anything is wrong that the proof rests on.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf

from .text import FARTHEST, KEEP, Table, Tables, rounded

STATE, COMMAND, MISSED, CLOCK, LATCHED, REPEATED, ENDED, RANGE, CLIPPED, REFUSED = (1 << i for i in range(10))
PREDICTED = 1 << 10
"""Faults, as in the header."""

LATEST = 2**31 - 1
"""Largest number of a period."""
LASTING = STATE | COMMAND | MISSED | CLOCK  # S flies for good after these

LARGEST = {"double": 1.7976931348623157e308, "float": 3.4028234663852886e38}


@dataclass(frozen=True)
class Call:
    """Call of `FlightStep.step`: its arguments, and the flight that begins with it.

    `start` is 1 for a flight of the schedule, 2 for one of the online monitor that goes on at this period
    after S has flown, 0 for none.
    """

    start: int
    period: int
    state: tuple[float, ...]
    controller: int
    command: tuple[float, ...]
    measured: tuple[float, ...] = ()


@dataclass(frozen=True)
class FlightAnswer:
    """Mode that flies, faults, the command [N], and the share of the limits that it leaves."""

    mode: int
    fault: int
    command: tuple[float, ...]
    margin: float


class FlightStep:
    """State of the flight code between calls; `tables` are those of its precision."""

    def __init__(self, tables: Tables, precision: str = "double") -> None:
        self.tables, self.precision = tables, precision
        self.last, self.latched = -1, False
        self.state, self.unseen = list(tables.waypoints[0]), 0
        self.sent = [[0.0] * len(tables.limit) for _ in tables.later]
        self.answer = FlightAnswer(0, 0, (0.0,) * len(tables.limit), 1.0)

    def step(
        self,
        period: int,
        state: Sequence[float],
        controller: int,
        command: Sequence[float],
        measured: Sequence[float] = (),
    ) -> FlightAnswer:
        """Answer the call of a control period.

        Parameters
        ----------
        period : int
            Number of the control period, of 32 bits.
        state : sequence of float, shape (n,)
            Estimate at its start; with the observer the first one, which is read in the first call.
        controller : int
            Experimental controller whose command is handed over; 0 if there is none.
        command : sequence of float, shape (m,)
            Its command [N].
        measured : sequence of float, shape (o,)
            Measurement for the observer, if the code has it; NaN if there is none.
        """
        if period >= 0 and period == self.last:
            return replace(self.answer, fault=self.answer.fault | REPEATED)
        tables = self.tables
        inputs = state, command, measured
        state, command, measured = ([rounded(float(x), self.precision) for x in each] for each in inputs)
        fault = self.estimate(state, measured)
        if period < 0 or period < self.last:
            fault |= CLOCK
        elif period - 1 > self.last:
            fault |= MISSED
        self.last = period if period >= 0 else min(self.last + 1, LATEST)
        q, steps = len(tables.moved), len(tables.modes)
        cell, part = divmod(min(self.last, len(tables.waypoints) * q - 1), q)
        scheduled = tables.modes[cell] if cell < steps else 0
        if scheduled and (controller != scheduled or not self.finite(command)):
            fault |= COMMAND
        self.latched |= fault & LASTING > 0
        mode = 0 if self.latched else scheduled
        fault |= LATCHED * self.latched | ENDED * (self.last >= tables.covered)
        if not all(-bound <= x <= bound for x, bound in zip(self.state, tables.range, strict=True)):
            fault |= RANGE
        self.answer = self.clipped(command if mode else self.safety(cell, part, self.state), mode, fault)
        return self.answer

    def estimate(self, state: list[float], measured: list[float]) -> int:
        """Take in the estimate, or the observer's from a measurement; return its faults."""
        fault = 0
        if self.tables.seen and self.last >= 0:
            state = self.predicted()
            if plausible(measured):
                fault = RANGE * any(abs(y) > top for y, top in zip(measured, self.tables.heard, strict=True))
                state, self.unseen = self.corrected(state, measured), 0
            elif self.unseen < len(self.tables.updates) - 1:
                fault, self.unseen = PREDICTED, self.unseen + 1
            else:
                fault = STATE
        if plausible(state):
            self.state = state
            return fault
        return fault | STATE

    def predicted(self) -> list[float]:
        """Return the observer's state of now under the command that was applied."""
        tables, precision = self.tables, self.precision
        self.sent = [list(self.answer.command), *self.sent[:-1]]
        carried = (summed(0.0, row, self.state, precision) for row in tables.held)
        return [summed(x, row, self.sent[0], precision) for x, row in zip(carried, tables.force, strict=True)]

    def corrected(self, state: list[float], measured: list[float]) -> list[float]:
        """Return a predicted state after the update by a measurement."""
        tables, precision, innovation = self.tables, self.precision, list[float]()
        for o, y in enumerate(measured):
            y = summed(y, [-x for x in tables.seen[o]], state, precision)
            for rows, command in zip(tables.later, self.sent, strict=True):
                y = summed(y, rows[o], command, precision)
            innovation.append(y)
        pairs = zip(state, tables.updates[self.unseen], strict=True)
        return [summed(x, row, innovation, precision) for x, row in pairs]

    def finite(self, command: Sequence[float]) -> bool:
        """Return True if every entry is a number of the precision."""
        limit = LARGEST[self.precision]
        return all(-limit <= rounded(float(u), self.precision) <= limit for u in command)

    def gap(self, cell: int, part: int, state: Sequence[float]) -> list[float]:
        """Return the reference at a node less a state; the order of operations is that of the C."""
        tables, precision = self.tables, self.precision
        feed, gap = tables.feed[cell] if cell < len(tables.modes) else [], []
        for j, x in enumerate(state):
            terms = (tables.moved[part][j], tables.waypoints[cell]), (tables.pushed[part][j], feed)
            reference = 0.0
            for row, values in terms:
                reference = summed(reference, row, values, precision)
            gap.append(rounded(reference - x, precision))
        return gap

    def safety(self, cell: int, part: int, state: Sequence[float]) -> list[float]:
        """Return the command of S at a node of a cell, before clipping [N]."""
        tables, gap = self.tables, self.gap(cell, part, state)
        feed = tables.feed[cell] if cell < len(tables.modes) else [0.0] * len(tables.limit)
        return [summed(u, row, gap, self.precision) for u, row in zip(feed, tables.gain, strict=True)]

    def clipped(self, command: Sequence[float], mode: int, fault: int) -> FlightAnswer:
        """Return the answer with a command clipped to the limits."""
        margin, thrusts = inf, list[float]()
        for value, limit in zip(command, self.tables.limit, strict=True):
            thrusts.append(min(max(value, -limit), limit))
            fault |= CLIPPED * (thrusts[-1] != value)
            share = rounded(abs(thrusts[-1]) / limit, self.precision)
            margin = min(margin, rounded(1.0 - share, self.precision))
        return FlightAnswer(mode, fault, tuple(thrusts), min(margin, 1.0))


class OnlineStep:
    """State of the flight code between calls where the online monitor decides who flies.

    No number of a controller is told apart: whatever flies within the thrust limits, S can take over at the
    next node. Only numbers of periods that contradict each other end that for good.
    """

    def __init__(self, tables: Tables, precision: str = "double") -> None:
        self.tables, self.precision = tables, precision
        self.safe = FlightStep(tables, precision)
        self.flown, self.lost, self.answer = 0, False, self.safe.answer

    def step(
        self, period: int, state: Sequence[float], controller: int, command: Sequence[float]
    ) -> FlightAnswer:
        """Answer the call of a control period, as `FlightStep.step` does."""
        if period >= 0 and period == self.safe.last:
            return replace(self.answer, fault=self.answer.fault | REPEATED)
        answer = self.safe.step(period, state, 0, command)
        fault = answer.fault & ~(COMMAND | LATCHED)
        self.lost |= fault & (MISSED | CLOCK) > 0
        fault |= LATCHED * self.lost
        node, tables = self.safe.last, self.tables
        share = 1.0 if self.flown or node == 0 else rounded(KEEP, self.precision)
        self.flown = 0
        if controller > 0 and not self.safe.finite(command):
            fault |= COMMAND
        elif controller > 0 and not fault & ~CLIPPED:
            planned = node < len(tables.modes) * len(tables.moved)
            if planned and self.recoverable(node, self.safe.state, share):
                self.flown, fault = controller, 0
                thrusts = [rounded(float(u), self.precision) for u in command]
                answer = self.safe.clipped(thrusts, controller, fault)
                fault = answer.fault
            else:
                fault |= REFUSED
        self.answer = replace(answer, fault=fault)
        return self.answer

    def recoverable(self, node: int, state: Sequence[float], share: float) -> bool:
        """Return True if S can take over at the next node under any controller until then.

        A decision for U needs at most a share of the clearance at every limit; the first that fails ends it.
        """
        tables, precision, q = self.tables, self.precision, len(self.tables.moved)
        gap = self.safe.gap(*divmod(node, q), state)
        shares = [rounded(abs(x) / limit, precision) for x, limit in zip(gap, tables.apart, strict=True)]
        size = max(0.0, *shares)
        if size > 1.0:
            return False
        for lag, rows in enumerate(zip(tables.booked, tables.sized, strict=True)):
            tightenings = [summed(a, [b], [size], precision) for a, b in zip(*rows, strict=True)]
            cell, part = divmod(node + lag, q)
            values = [summed(0.0, row, gap, precision) for row in tables.rows]
            if not self._within(tables.clearance[cell], part, tightenings, values, share):
                return False
            if part == 0 and cell > 0:
                previous = tables.clearance[cell - 1][: tables.facets]
                if not self._within(previous, q, tightenings, values, share):
                    return False
            if lag == 0:
                gap = [summed(0.0, row, gap, precision) for row in tables.held]
                feed = tables.feed[cell]
                gap = [summed(x, row, feed, precision) for x, row in zip(gap, tables.force, strict=True)]
            else:
                gap = [summed(0.0, row, gap, precision) for row in tables.loop]
        return True

    def _within(
        self, clearance: Table, part: int, tightenings: Sequence[float], values: Sequence[float], share: float
    ) -> bool:
        precision = self.precision
        for sides, base, value in zip(clearance, tightenings, values, strict=False):
            for offset, slope, sign in ((0, 1, 1.0), (2, 3, -1.0)):
                limit = summed(sides[offset], [sides[slope]], [part], precision)
                tightening = rounded(base + sign * value, precision)
                if not (tightening <= limit and tightening <= rounded(share * limit, precision)):
                    return False
        return True


def plausible(values: Sequence[float]) -> bool:
    """Return True if all numbers are finite and not beyond the farthest."""
    return all(-FARTHEST <= x <= FARTHEST for x in values)


def summed(start: float, row: Sequence[float], values: Sequence[float], precision: str) -> float:
    """Return a number plus products, added one after the other, each operation rounded."""
    if precision == "double":
        for a, b in zip(row, values, strict=False):
            start += a * b
        return start
    for a, b in zip(row, values, strict=False):
        start = rounded(start + rounded(a * b, precision), precision)
    return start
