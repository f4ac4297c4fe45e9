"""Whatever the experimental controller or navigation hands over: S flies on, and the log says so."""

import io
import json

import numpy as np
import pytest

from polaris.model.untrusted import kind_of, numbers, real, sanitize
from polaris.rta.online.decision_log import DecisionLog, jsonable
from polaris.rta.online.estimate import Measurement
from polaris.rta.online.runtime import OnlineMonitor, replay_log
from polaris.rta.online.runtime_options import RuntimeOptions
from tests.polaris.rta import oddities
from tests.polaris.rta.streams import robot

FREE = RuntimeOptions(deadline=1e3, budget=1e3, latch=None, latch_conflicts=None)
NAMES = (*oddities.unreadable(2), *oddities.not_finite(2))


def odd(name, n):
    return {**oddities.unreadable(n), **oddities.not_finite(n)}[name]


def online(log=None, options=FREE):
    return OnlineMonitor(robot(), options, log)


def honest(k):
    scene = robot().grid
    return k * scene.period, Measurement(k * scene.period, scene.xi[k * scene.nodes].copy())


@pytest.mark.parametrize("name", NAMES)
def test_no_command_ends_the_flight(name):
    flight = online()
    assert flight.step(*honest(0)).mode == 1
    assert flight.command(lambda: odd(name, 2)) is None
    answer = flight.step(*honest(1))
    assert answer.mode == 0 and answer.reason.startswith("controller: the command is ")
    assert flight.step(*honest(2)).mode == 1


@pytest.mark.parametrize("which", range(len(oddities.ERRORS)))
def test_nothing_that_u_raises_ends_the_flight(which):
    flight, error = online(), oddities.ERRORS[which]
    assert flight.command(oddities.raising(error)) is None
    answer = flight.step(*honest(0))
    assert answer.mode == 0 and answer.reason.startswith("controller: raised ")
    assert kind_of(object.__new__(oddities.Unnamed)) == "Unnamed"


@pytest.mark.parametrize("clothes", oddities.readable([0.0, 0.0]))
def test_numbers_in_odd_clothes_are_commands(clothes):
    flight, limit = online(), robot().grid.system.u_max
    dressed = oddities.readable(np.array([0.25, -10.0]) * limit)[clothes]
    u = flight.command(lambda: dressed)
    assert type(u) is np.ndarray and u.tolist() == [0.25 * limit[0], -limit[1]]
    if isinstance(dressed, np.ndarray) and dressed.flags.writeable:
        np.ndarray.__setitem__(dressed, ..., np.nan)  # a command does not change after it was given
        assert np.isfinite(u).all()


def test_an_answer_that_is_worked_out_late_is_over_the_budget():
    clock = [0.0]

    class Lazy:
        def __array__(self, dtype=None, copy=None):
            clock[0] += 10.0
            return np.zeros(2)

    flight = OnlineMonitor(robot(), RuntimeOptions(deadline=1.0, budget=1.0), timer=lambda: clock[0])
    assert flight.command(Lazy) is None
    assert flight.step(*honest(0)).reason == "controller: over its time budget"


PLACES = ("now", "measurement", "stamp", "state", "half_widths", "applied", "reference", "number", "asked")


def told(place, value, k):
    now, measurement = honest(k)
    calls = {"now": now, "measurement": measurement}
    if place in ("now", "measurement", "applied", "reference", "number"):
        return {**calls, place: value}
    parts = {"stamp": now, "state": measurement.state, place: value}
    return calls if place == "asked" else {**calls, "measurement": Measurement(**parts)}


@pytest.mark.parametrize("name", NAMES)
def test_untrusted_values_never_raise(name):
    for n in (1, 2, 4):
        assert real(odd(name, n)) is None or name == "scalar" or n == 1
        json.dumps(jsonable(sanitize(odd(name, n))), allow_nan=False)
        array = numbers(odd(name, n), (n,))
        assert array is None or (name in oddities.not_finite(n) and not np.isfinite(array).all()), name


@pytest.mark.parametrize("place", PLACES)
def test_nothing_that_is_handed_in_ends_the_flight_and_the_log_says_what_it_was(place):
    out = io.StringIO()
    flight, answers, k = online(DecisionLog(out)), [], 0
    n = {"state": 4, "half_widths": 4}.get(place, 2)
    answers.append(flight.step(*honest(0)))
    for name in NAMES:
        value = odd(name, n)
        if value is None and place not in ("now", "stamp", "state", "measurement", "asked"):
            continue  # that is how nothing is handed in
        if place == "number" and name == "scalar":
            continue
        for second in (0, 1):  # the second one is honest
            k += 1
            if place == "asked" and not second:
                flight.resynchronise(value)
            calls = told("now" if second else place, honest(k)[0] if second else value, k)
            answers.append(flight.step(**calls))
        odd_one = answers[-2]
        if place in ("reference", "asked") and name == "scalar":
            continue  # a number is what belongs there
        assert odd_one.mode == 0 and odd_one.faults, name
        assert not {"monitor", "log"} & {fault.family for fault in odd_one.faults}, (name, odd_one)
    lines = [json.loads(line, parse_constant=pytest.fail) for line in out.getvalue().splitlines()]
    assert [line["reason"] for line in lines] == [answer.reason for answer in answers]
    second = replay_log(lines, robot(), FREE)
    assert [repr(answer) for answer in second] == [repr(answer) for answer in answers]
    assert answers[-1].mode == 1 or place in ("now", "number", "reference", "asked")


@pytest.mark.parametrize("clothes", oddities.readable(np.zeros(4)))
def test_measurements_in_odd_clothes_are_read_once(clothes):
    out, flights = io.StringIO(), []
    for log in (None, DecisionLog(out)):
        flight = online(log)
        dressed = []
        for k in range(5):
            now, measurement = honest(k)
            state = oddities.readable(measurement.state)[clothes]
            half = oddities.readable(np.full(4, 0.005))[clothes]
            dressed.append(flight.step(now, Measurement(now, state, half)))
        flights.append(dressed)
    plain_one = online()
    for k, answers in enumerate(zip(*flights, strict=True)):
        now, measurement = honest(k)
        expected = plain_one.step(now, Measurement(now, measurement.state, np.full(4, 0.005)))
        assert expected.mode == 1 and {repr(answer) for answer in answers} == {repr(expected)}
    records = [json.loads(line) for line in out.getvalue().splitlines()]
    assert [repr(answer) for answer in replay_log(records, robot(), FREE)] == list(map(repr, flights[0]))
