"""What delays and missed periods add to the errors of estimates: controllers act on predictions."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from flint import arb

from .balls import absolute, column, identity, largest, require, sums
from .document import Document
from .motion import Plant
from .plants import plant_of
from .verdict import Rejected

PARTS = 32
"""Parts of a prediction over each of which integrals are bounded by the trapezoid rule."""


def check_timing(document: Document, spec: dict[str, Any]) -> None:
    """Timing is the scenario's, and errors of estimates are no smaller than those of all predictions."""
    keys = {"delay": "delay_s", "missed": "missed_periods", "clock": "clock_error_s"}
    for key, name in keys.items():
        found, given = document.timing.get(key, 0), spec.get(name, 0)
        if found != given:
            raise Rejected("system", f"{name} is {found} in the certificate, {given} in the scenario")
    delay, missed = arb(spec.get("delay_s", 0)), spec.get("missed_periods", 0)
    if missed and not document.sampled:
        raise Rejected("system", "missed periods need a control period")
    stored, plant = document.estimate or [0.0] * len(document.A), plant_of(document)
    measured = document.measured or stored
    ages = [delay + plant.h * i for i in range(missed + 1)]
    least = [largest(each) for each in zip(*(_predicted(plant, measured, age) for age in ages), strict=True)]
    for i, (bound, needed) in enumerate(zip(stored, least, strict=True)):
        require("system", bound - needed, f"error of the prediction of state {i}: {bound}")


def _predicted(plant: Plant, measured: list[float], age: arb) -> list[arb]:
    """Bounds on the errors of states predicted over a time from measured ones."""
    if age == 0:
        return [arb(x) for x in measured]
    part = replace(plant, h=age / PARTS).open
    thrusters = plant.push(plant.thruster_error(plant.u_max))
    pushes = [plant.disturbance, *([thrusters] if thrusters else [])]
    rows, found = identity(len(measured)), [arb(0)] * len(measured)
    for _ in range(PARTS):
        found = sums(found, *(part.push_gain(rows, push) for push in pushes))
        rows = rows * part.phi
    return sums(found, (absolute(rows) * column(measured)).entries())
