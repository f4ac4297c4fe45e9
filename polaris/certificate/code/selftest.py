"""Self-test program of the flight code: calls with their expected answers, written and read back."""

import re
from collections.abc import Iterable, Iterator
from math import inf, isfinite, nan

from .answers import Call, FlightAnswer, FlightStep, OnlineStep
from .text import Tables, literal, rounded, template

LEAST = "(-2147483647 - 1)"  # of 32 bits, as C99 writes it
ODD = {"NAN": nan, "INFINITY": inf, "-INFINITY": -inf}
NUMBERS = r", \{(.*?)\}"
VECTOR = re.compile(
    rf"\{{([012]), \{{(-?\d+|\(-2147483647 - 1\)), (-?\d+){NUMBERS}(?:{NUMBERS})?{NUMBERS}\}},", re.ASCII
)


def answered(tables: Tables, precision: str, calls: Iterable[Call]) -> Iterator[tuple[Call, FlightAnswer]]:
    """Yield each call with the answer that is expected."""
    code: FlightStep | OnlineStep = FlightStep(tables, precision)
    for call in calls:
        if call.start == 1:
            code = FlightStep(tables, precision)
        if call.start == 2:
            code = OnlineStep(tables, precision)
            code.safe.last = call.period - 1
        measured = (call.measured,) if tables.seen else ()
        yield call, code.step(call.period, call.state, call.controller, call.command, *measured)


def selftest(tables: Tables, prefix: str, precision: str, calls: Iterable[Call]) -> str:
    """Return the text of a program that compares the answers to some calls with the expected ones."""
    rows = []
    for call, answer in answered(tables, precision, calls):
        state, command, expected, measured = (
            ", ".join(_number(x, prefix, precision) for x in values)
            for values in (call.state, call.command, answer.command, call.measured)
        )
        state += "}, {" * bool(measured) + measured
        period = LEAST if call.period == -(2**31) else call.period
        margin = _number(answer.margin, prefix, precision)
        rows.append(
            f"{{{int(call.start)}, {{{period}, {call.controller}, {{{state}}}, {{{command}}}}},\n"
            f" {{{answer.mode}, {answer.fault}U, {{{expected}}}, {margin}}}}}"
        )
    body = "static const vector vectors[] = {\n" + ",\n".join(rows) + "};"
    text = template("selftest.c").replace("@PREFIX@", prefix).replace("@GUARD@", prefix.upper())
    return text.replace("@VECTORS@", body)


def _number(x: float, prefix: str, precision: str) -> str:
    x = rounded(x, precision)
    if isfinite(x):
        return literal(x, precision)
    return f"({prefix}_real){'NAN' if x != x else 'INFINITY' if x > 0 else '-INFINITY'}"


def calls_of(text: str, prefix: str) -> list[Call]:
    """Read the calls of a self-test program back; `ValueError` where one cannot be read."""

    def values(listing: str) -> tuple[float, ...]:
        literals = (one.removeprefix(f"({prefix}_real)") for one in listing.split(", "))
        return tuple(ODD[one] if one in ODD else float.fromhex(one.rstrip("f")) for one in literals)

    return [
        Call(
            int(start),
            -(2**31) if period == LEAST else int(period),
            values(x),
            int(controller),
            values(u),
            values(y) if y else (),
        )
        for start, period, controller, x, y, u in VECTOR.findall(text)
    ]
