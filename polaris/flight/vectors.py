"""Calls of the flight code, regular and hostile: inputs of its self-test and of the tests."""

from collections.abc import Iterator
from dataclasses import replace
from math import inf, nan

import numpy as np

from ..certificate.code.answers import LATEST, Call, FlightStep
from ..certificate.code.text import FARTHEST, Tables
from ..model.system import Array

TINY, HUGE = (0.0, -0.0, 5e-324, 1e-310), (1e300, -1e300, inf, -inf, nan)
SPECIAL = *TINY, FARTHEST, -FARTHEST, 1.0000001 * FARTHEST, *HUGE
"""Numbers that estimates and commands may turn out to be."""
PERIODS = (-(2**31), -1, 0, LATEST)
FLIGHT = 12  # calls of a flight on average
FLIGHTS = 60  # of the self-test


def calls(tables: Tables, flights: int, seed: int) -> Iterator[Call]:
    """Calls of many flights from anywhere; two thirds of the calls are regular.

    What fails else: an entry of the state or of the command, U, the number of the period. Half of the flights
    are of the online monitor, where the tables have one.
    """
    rng, q = np.random.default_rng(seed), len(tables.moved)
    last, waypoints = len(tables.waypoints) * q + 2 * q, np.array(tables.waypoints)
    reach, limit = np.array(tables.range), np.array(tables.limit)
    flight_step, box, C = FlightStep(tables), np.array(tables.apart), np.array(tables.seen)
    for flight in range(flights):
        start = 2 if tables.rows and flight // 2 % 2 else 1
        period = 0 if flight % 2 else int(rng.integers(0, last))
        count = FLIGHT if flight % 3 else 2 * q
        for place in range(count):
            cell = min(max(period, 0) // q, len(waypoints) - 1)
            spread = rng.uniform(-1, 1, len(reach)) * 10.0 ** rng.uniform(-6, 0.3)
            state = waypoints[cell] + spread * reach
            if start == 2:  # about the reference at the node
                state = np.array(flight_step.gap(cell, period % q, [0.0] * len(reach)))
                state += spread * box * (1 + place % 3)
            command = rng.uniform(-1.2, 1.2, len(limit)) * limit
            mode = tables.modes[cell] if cell < len(tables.modes) else 0
            mode = int(place % 5 < 4) if start == 2 else mode  # S may fly in between
            fault = rng.integers(0, 12) if place and flight % 3 else 99  # every third flight is regular
            measured = C @ state if tables.seen else state
            call = _call(rng, 0 if place else start, period, state, mode, command, int(fault))
            yield _measured(rng, call, measured) if tables.seen else call
            period += 1 if fault != 4 else int(rng.integers(-3, 6))
            period = PERIODS[0] if call.period == LATEST else max(period, PERIODS[0])  # the counter wraps


def _measured(rng: np.random.Generator, call: Call, measured: Array) -> Call:
    """Return a call with a measurement, of which one in eight is odd or missing."""
    if rng.integers(0, 8) == 0:
        measured[rng.integers(0, len(measured))] = rng.choice([*SPECIAL, nan, nan])
    return replace(call, measured=tuple(measured.tolist()))


def _call(
    rng: np.random.Generator, start: int, period: int, state: Array, mode: int, command: Array, fault: int
) -> Call:
    if fault == 0:
        state[rng.integers(0, len(state))] = rng.choice(SPECIAL)
    elif fault == 1:
        command[rng.integers(0, len(command))] = rng.choice(SPECIAL)
    elif fault == 2:
        mode = int(rng.choice([0, mode + 1, -1, 2**31 - 1]))
    elif fault == 3:
        period = int(rng.choice(PERIODS))
    return Call(start, period, tuple(state.tolist()), mode, tuple(command.tolist()))
