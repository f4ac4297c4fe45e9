"""Answers of the flight code, call by call, in double or single precision: the reference of the C text.

One call per control period. Whatever arrives, the answer is finite and within the limits, and S flies for
good once anything is wrong that the proof rests on.
"""

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from math import inf, isfinite, nan

from .text import FARTHEST, Tables, literal, rounded, template

STATE, COMMAND, MISSED, CLOCK, LATCHED, REPEATED, ENDED, RANGE, CLIPPED = (1 << i for i in range(9))
"""Faults, as in the header."""

LARGEST = {"double": 1.7976931348623157e308, "float": 3.4028234663852886e38}


@dataclass(frozen=True)
class Call:
    """One call: whether a flight begins with it, and what `FlightStep.step` is handed."""

    start: bool
    period: int
    state: tuple[float, ...]
    controller: int
    command: tuple[float, ...]


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
        self.state = list(tables.waypoints[0])
        self.answer = FlightAnswer(0, 0, (0.0,) * len(tables.limit), 1.0)

    def step(
        self, period: int, state: Sequence[float], controller: int, command: Sequence[float]
    ) -> FlightAnswer:
        """Answer the call of a control period.

        Parameters
        ----------
        period : int
            Number of the control period, of 32 bits.
        state : sequence of float, shape (n,)
            Estimate at its start.
        controller : int
            Experimental controller whose command is handed over; 0 if there is none.
        command : sequence of float, shape (m,)
            Its command [N].
        """
        if period >= 0 and period == self.last:
            return replace(self.answer, fault=self.answer.fault | REPEATED)
        tables, fault = self.tables, 0
        state, command = ([rounded(float(x), self.precision) for x in each] for each in (state, command))
        if period < 0 or period < self.last:
            fault |= CLOCK
        elif period - 1 > self.last:
            fault |= MISSED
        self.last = max(period, 0)
        if all(-FARTHEST <= x <= FARTHEST for x in state):
            self.state = state
        else:
            fault |= STATE
        q, steps = len(tables.moved), len(tables.modes)
        cell, part = divmod(min(self.last, len(tables.waypoints) * q - 1), q)
        scheduled = tables.modes[cell] if cell < steps else 0
        finite = all(-LARGEST[self.precision] <= u <= LARGEST[self.precision] for u in command)
        if scheduled and (controller != scheduled or not finite):
            fault |= COMMAND
        self.latched |= fault > 0
        mode = 0 if self.latched else scheduled
        fault |= LATCHED * self.latched | ENDED * (self.last >= tables.covered)
        if not all(-bound <= x <= bound for x, bound in zip(self.state, tables.range, strict=True)):
            fault |= RANGE
        self.answer = self._clipped(command if mode else self.safety(cell, part, self.state), mode, fault)
        return self.answer

    def safety(self, cell: int, part: int, state: Sequence[float]) -> list[float]:
        """Command of S at a node of a cell, before clipping [N]; the order of operations is that of the C."""
        tables, precision = self.tables, self.precision
        feed = tables.feed[cell] if cell < len(tables.modes) else []
        command = list(feed) or [0.0] * len(tables.limit)
        for j, x in enumerate(state):
            reference = 0.0
            for row, values in ((tables.moved, tables.waypoints[cell]), (tables.pushed, feed)):
                for a, b in zip(row[part][j], values, strict=False):
                    reference = rounded(reference + rounded(a * b, precision), precision)
            error = rounded(reference - x, precision)
            for i, row in enumerate(tables.gain):
                command[i] = rounded(command[i] + rounded(row[j] * error, precision), precision)
        return command

    def _clipped(self, command: Sequence[float], mode: int, fault: int) -> FlightAnswer:
        margin, kept = inf, list[float]()
        for value, limit in zip(command, self.tables.limit, strict=True):
            kept.append(min(max(value, -limit), limit))
            fault |= CLIPPED * (kept[-1] != value)
            share = rounded(abs(kept[-1]) / limit, self.precision)
            margin = min(margin, rounded(1.0 - share, self.precision))
        return FlightAnswer(mode, fault, tuple(kept), min(margin, 1.0))


# -- the self-test program --------------------------------------------------------------------------

LEAST = "(-2147483647 - 1)"  # of 32 bits, as C99 writes it
ODD = {"NAN": nan, "INFINITY": inf, "-INFINITY": -inf}
VECTOR = re.compile(r"\{([01]), \{(-?\d+|\(-2147483647 - 1\)), (-?\d+), \{(.*?)\}, \{(.*?)\}\}", re.ASCII)


def answered(tables: Tables, precision: str, given: Iterable[Call]) -> Iterator[tuple[Call, FlightAnswer]]:
    """Every call with the answer that is expected."""
    flown = FlightStep(tables, precision)
    for call in given:
        if call.start:
            flown = FlightStep(tables, precision)
        yield call, flown.step(call.period, call.state, call.controller, call.command)


def selftest(tables: Tables, prefix: str, precision: str, given: Iterable[Call]) -> str:
    """Return the text of a program that compares the answers to some calls with the expected ones."""
    rows = []
    for call, answer in answered(tables, precision, given):
        state, command, kept = (
            ", ".join(_number(x, prefix, precision) for x in values)
            for values in (call.state, call.command, answer.command)
        )
        period = LEAST if call.period == -(2**31) else call.period
        margin = _number(answer.margin, prefix, precision)
        rows.append(
            f"{{{int(call.start)}, {{{period}, {call.controller}, {{{state}}}, {{{command}}}}},\n"
            f" {{{answer.mode}, {answer.fault}U, {{{kept}}}, {margin}}}}}"
        )
    body = "static const vector vectors[] = {\n" + ",\n".join(rows) + "};"
    return template("selftest.c").replace("@PREFIX@", prefix).replace("@VECTORS@", body)


def _number(x: float, prefix: str, precision: str) -> str:
    x = rounded(x, precision)
    if isfinite(x):
        return literal(x, precision)
    return f"({prefix}_real){'NAN' if x != x else 'INFINITY' if x > 0 else '-INFINITY'}"


def calls_of(text: str, prefix: str) -> list[Call]:
    """Read the calls of a self-test program back; `ValueError` where one cannot be read."""

    def values(given: str) -> tuple[float, ...]:
        known = (one.removeprefix(f"({prefix}_real)") for one in given.split(", "))
        return tuple(ODD[one] if one in ODD else float.fromhex(one.rstrip("f")) for one in known)

    return [
        Call(start == "1", -(2**31) if period == LEAST else int(period), values(x), int(who), values(u))
        for start, period, who, x, u in VECTOR.findall(text)
    ]
