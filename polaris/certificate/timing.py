"""What delays, missed periods and jitter add to other errors: controllers act on predictions."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from flint import arb, arb_mat

from .balls import above, absolute, beside, column, identity, largest, matrix, require, sums
from .document import Document
from .motion import Plant
from .plants import plant_of
from .verdict import Rejected

PARTS = 32
"""Parts of a prediction over each of which integrals are bounded by the trapezoid rule."""

ROUNDED = 1e-12
"""Rounding of a difference of stored numbers, relative to the larger."""


def check_timing(document: Document, spec: dict[str, Any], measured: list[list[float]]) -> None:
    """Timing is the scenario's, and what it adds to other errors no smaller than it must be.

    `measured` bounds the errors of estimates by step, if there is more than one row.
    """
    keys = {"delay": "delay_s", "jitter": "jitter_s", "missed": "missed_periods", "clock": "clock_error_s"}
    for key, name in keys.items():
        found, given = document.timing.get(key, 0), spec.get(name, 0)
        if found != given:
            raise Rejected("system", f"{name} is {found} in the certificate, {given} in the scenario")
    delay, jitter, missed = (spec.get(keys[key], 0) for key in ("delay", "jitter", "missed"))
    plant, stored = plant_of(document), document.estimate or [0.0] * len(document.A)
    if (missed or jitter) and not (document.sampled and 2 * arb(jitter) <= plant.h):
        raise Rejected("system", "missed periods and jitter need a control period, at least twice the jitter")
    exact, booked = document.prompt_thrusters, document.thrusters[2] if document.thrusters else 0.0
    bit, box = _jitter(plant) if jitter else (arb(0), [arb(0)] * len(stored))
    require("system", booked * arb(1 + ROUNDED) - exact[2] - bit, f"error of the thrusters: {booked}")
    for i, (bound, needed) in enumerate(zip(document.displaced, box, strict=True)):
        require("system", bound - needed, f"displacement of state {i} by jitter: {bound}")
    if (len(measured) > 1) != bool(document.error_by_step):
        raise Rejected("system", "errors of estimates are not by step in both certificate and scenario")
    carried = [_carried(plant, delay + plant.h * i) for i in range(missed + 1)]
    for row, bounds in zip(measured, document.error_by_step or [stored], strict=True):
        known = column(sums(map(arb, row), map(arb, document.displaced)))
        ages = [sums((over * known).entries(), more) for over, more in carried]
        least = map(largest, zip(*ages, strict=True))
        for i, (bound, needed) in enumerate(zip(bounds, least, strict=True)):
            spare = bound * arb(1 + ROUNDED) - needed
            require("system", spare, f"error of the prediction of state {i}: {bound}")


def _carried(plant: Plant, age: arb) -> tuple[arb_mat, list[arb]]:
    """What a prediction over a time makes of errors of the states it starts from, and what it adds."""
    n = plant.A.nrows()
    if age == 0:
        return identity(n), [arb(0)] * n
    part, thrusters = replace(plant, h=age / PARTS).open, plant.push(plant.thruster_error(plant.u_max))
    pushes = [plant.disturbance, *([thrusters] if thrusters else [])]
    rows, found = identity(n), [arb(0)] * n
    for _ in range(PARTS):
        found = sums(found, *(part.push_gain(rows, push) for push in pushes))
        rows = rows * part.phi
    return absolute(rows), found


def _jitter(plant: Plant) -> tuple[arb, list[arb]]:
    """What instants add that are off: an error of every input, and bounds on what states are displaced by.

    The impulse of a command that is early or late is that of an input ``a + b s`` over a period about it.
    """
    A, B, h, n, m = plant.A, plant.B, plant.h, plant.A.nrows(), len(plant.u_max)
    one, zero, jitter, reach = identity(n), arb_mat(n, n), arb(plant.jitter), h / 2 + plant.jitter
    block = above(beside(-A, one, zero), beside(zero, zero, one), beside(zero, zero, zero)) * h
    rows = [row[n:] for row in block.exp().tolist()[:n]]
    once, twice = (matrix([row[i * n : (i + 1) * n] for row in rows]) for i in (0, 1))
    moments = (A * (h / 2)).exp() * beside(once * B, (once - twice * (2 / h)) * B)
    try:
        inverse = moments.transpose() * (moments * moments.transpose()).inv()
    except ZeroDivisionError as error:
        raise Rejected("system", "jitter cannot be spread over a period in this system") from error
    over = (absolute(A) * reach).exp() * absolute(B)
    shape = absolute(inverse * B) + absolute(inverse * A * B) * jitter
    shape += absolute(inverse) * absolute(A) * absolute(A) * over * (jitter**2 / 2)
    worst = replace(plant, thrusters=plant.prompt).thruster_error(plant.u_max)
    impulse = [jitter * (2 * u + e) for u, e in zip(plant.u_max, worst, strict=True)]
    both = (shape * column(impulse)).entries()
    spread = [largest((a + b, i / h)) for a, b, i in zip(both[:m], both[m:], impulse, strict=True)]
    return largest(spread), (over * column(spread) * reach).entries()
