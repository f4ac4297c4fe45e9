"""Effects of delays, missed periods, jitter and pulses on other errors: controllers act on predictions."""

from dataclasses import replace
from math import floor
from typing import Any

from flint import arb, arb_mat

from ..files.document import ROUNDED, Document
from ..kernel.balls import (
    above,
    absolute,
    beside,
    column,
    identity,
    largest,
    matrix,
    require,
    row_sums,
    smallest,
    sums,
)
from ..kernel.motion import PARTS, Plant
from ..kernel.verdict import Rejected
from .allocation import Nozzles, per_axis
from .plants import older, plant_of

AT_NODES = arb(1e-6)
"""Share of what pulses displace at most within `NEAR` of a period's ends, where it is nothing."""

NEAR = 1e-9  # share of a period

PLACES = {"centred": (8, 32, 62), "start": (4, 54, 96), "staggered": (4, 32, 62)}
"""By place of pulses, divisors of bounds on the impulse by which they differ from held inputs, on its
integral without the mean, and on the integral of the size of that."""


def strengths(scenario: dict[str, Any]) -> list[arb]:
    """Return the shares of its thrust that a thruster may have, if it has any."""
    losses = [fault["share"] for fault in scenario.get("faults", []) if fault["kind"] == "loss"]
    return [arb(1), *(1 - arb(share) for share in losses)]


def require_whole(thrusters: dict[str, Any], impulses: list[arb]) -> None:
    """Refuse nearest multiples of a bit above the impulse of full thrust in a period, by impulses [N s]."""
    bit = thrusters.get("impulse_bit_N_s", 0.0)
    kinds = thrusters.get("remainder", "dropped"), thrusters.get("resolution", "bit")
    for impulse in impulses if bit > 0 and kinds == ("dropped", "bit") else []:
        nearest = floor(float((impulse / bit).mid()) + 0.5 + NEAR) * arb(bit)
        require("system", impulse * arb(1 + 2 * NEAR) - nearest, f"pulses of {nearest} N s in a period")


def check_timing(document: Document, scenario: dict[str, Any], measured: list[list[float]]) -> None:
    """Check that timing and pulses are the scenario's, and errors stated with them no less than they must be.

    `measured` bounds the errors of estimates by step, if there is more than one row.
    """
    spec, thrusters = scenario.get("timing", {}), scenario.get("thrusters", {})
    keys = {"delay": "delay_s", "jitter": "jitter_s", "missed": "missed_periods", "clock": "clock_error_s"}
    for key, name in keys.items():
        claimed, specified = document.timing.get(key, 0), spec.get(name, 0)
        if claimed != specified:
            raise Rejected("system", f"{name} is {claimed} in the certificate, {specified} in the scenario")
    delay, jitter, missed = (spec.get(keys[key], 0) for key in ("delay", "jitter", "missed"))
    plant, zeros = plant_of(document), [arb(0)] * len(document.u_max)
    stored = document.estimate or [0.0] * len(document.A)
    edges = [thrusters.get(name, 0.0) for name in ("rise_s", "fall_s")]
    if not 2 * (arb(jitter) + sum(map(arb, edges))) <= plant.h:
        raise Rejected(
            "system", "the control period must be at least twice the jitter, rise and fall included"
        )
    pulsed, system = thrusters.get("pulse", "held") != "held", scenario["system"]
    top = system["thrust_max_N" if system["kind"] == "clohessy_wiltshire" else "input_max"]
    fired = list(map(arb, per_axis(top, len(document.u_max)))) if pulsed else []
    placement = thrusters.get("pulse", "held")
    if document.pulse_place != (placement if placement in ("start", "staggered") else ""):
        raise Rejected("system", f"pulses are placed {document.pulse_place}, in the scenario {placement}")
    if placement == "staggered":  # each has the thrust of all together
        fired = [x * len(fired) for x in fired]
    if pulsed and (layout := Nozzles.from_document(document)) is not None:
        fired = layout.fired()
        if placement == "staggered":
            bit = arb(thrusters.get("impulse_bit_N_s", 0.0)) / plant.h
            bit *= 1 if thrusters.get("remainder", "dropped") == "carried" else 0.5
            share = layout.in_turn(document.u_max, bit) / smallest(strengths(scenario))
            require("system", 1 - share, f"pulses one after another take {share} periods")
    if pulsed and not (placement == "staggered" and "directions" in thrusters):
        tops = per_axis(top, len(document.u_max))
        if "directions" in thrusters:
            tops = per_axis(thrusters["thrust_max_N"], len(thrusters["directions"]))
        require_whole(thrusters, [x * y * plant.h for x in map(arb, tops) for y in strengths(scenario)])
    fine = thrusters.get("resolution", "bit") != "bit" and thrusters.get("impulse_bit_N_s", 0.0) > 0
    if document.timing.get("fine", False) != fine:
        raise Rejected("system", "sizes of impulses are not those of the scenario")
    if document.edge != max(edges) or (document.edge and not pulsed):
        raise Rejected("system", f"pulses rise or fall in {document.edge} s, not as in the scenario")
    if len(document.pulse_thrust) != len(fired):
        raise Rejected("system", f"pulses of {document.pulse_thrust} are not those of the scenario")
    for thrust, needed in zip(document.pulse_thrust, fired, strict=True):
        require("system", thrust - needed * (1 - ROUNDED), f"pulses of {thrust}")
    extra_error, intersample = (
        _pulses(plant, document.pulse_thrust, placement) if pulsed else (arb(0), [arb(0)] * len(stored))
    )
    share = 2 * arb(jitter) / plant.h * int(document.late)
    if plant.weights:  # thrusters make more than is commanded of what they have left
        extra_error += 2 * share * plant.carried / plant.h
    for bit_error, exact in zip(document.bits, document.prompt_bits, strict=True):
        slack = bit_error * arb(1 + ROUNDED) - (1 + share) * exact - extra_error
        require("system", slack, f"error of the thrusters: {bit_error}")
    offsets = sums(carry_offset(plant), (absolute(plant.B) * column(plant.shifted or zeros)).entries())
    for bounds, parts in ((document.at_nodes, offsets), (document.intersample_offset, intersample)):
        for i, (bound, needed) in enumerate(zip(bounds, parts, strict=True)):
            require("system", bound - needed, f"displacement of state {i}: {bound}")
    if (len(measured) > 1) != bool(document.error_by_step):
        raise Rejected("system", "only one of certificate and scenario has estimate errors by step")
    offset = state_offset(document, delay)
    carried = [_carried(plant, delay + plant.h * i, zeros) for i in range(missed + 1)]
    full = column(plant.thruster_part(plant.u_max))
    unseen = (sum((error_gain for _, error_gain in older(document, plant)), plant.predicted) * full).entries()
    command_error = by_command(document, column(full.entries()[: len(document.u_max)]))
    for row, bounds in zip(measured, document.error_by_step or [stored], strict=True):
        error = column(sums(map(arb, row), offset)) - command_error
        ages = [sums((gain * error).entries(), extra_error) for gain, extra_error in carried]
        required = sums(list(map(largest, zip(*ages, strict=True))), unseen)
        for i, (bound, needed) in enumerate(zip(bounds, required, strict=True)):
            slack = bound * arb(1 + ROUNDED) - needed
            require("system", slack, f"error of the prediction of state {i}: {bound}")


def by_command(document: Document, error: arb_mat) -> arb_mat:
    """Return the estimate error that thruster errors (m, 1) not older than the last of the ages cause."""
    by_age = [matrix(M) for M in (document.observer or {}).get("by_age") or ()]
    return (by_age[0] - by_age[-1]) * error if by_age else arb_mat(len(document.A), 1)


def state_offset(document: Document, delay: float) -> list[arb]:
    """Bound how far states may be displaced when they are measured, as the certificate has it."""
    periods = arb(delay) * document.q / arb(document.delta)
    at_node = abs(periods - (periods + arb(0.5)).mid().floor()) <= NEAR
    share = (AT_NODES if delay else arb(0)) if at_node else arb(1)  # measurements are those of nodes
    return [x + share * y for x, y in zip(document.at_nodes, document.intersample_offset, strict=True)]


def carry_offset(plant: Plant) -> list[arb]:
    """Bounds on how far impulses that are carried, and errors of them, displace states."""
    gain = replace(plant, A=absolute(plant.A)).open.gamma * absolute(plant.B) * (1 / plant.h)
    return row_sums((gain + absolute(plant.B) * plant.along) * plant.carried)


def carried_impulse(plant: Plant) -> arb:
    """Impulse that may be left from before at an instant, with its errors, of all inputs [N s]."""
    sides, longest = 2 if plant.weights else 1, 1 + 2 * arb(plant.jitter) / plant.h
    return sides * plant.B.ncols() * longest * plant.carried * (1 + arb(plant.without_delay.along))


def predicted(plant: Plant, errors: list[arb], age: arb) -> list[arb]:
    """Bounds on the errors of states predicted over a time from known ones."""
    gain, growth = _carried(plant, age, plant.u_max)
    return sums((gain * column(errors)).entries(), growth)


def _carried(plant: Plant, age: arb, tops: list[arb]) -> tuple[arb_mat, list[arb]]:
    """Return a prediction's gain on state errors, and the error it adds under commands up to `tops`."""
    n = plant.A.nrows()
    if age == 0:
        return identity(n), [arb(0)] * n
    pushes = plant.disturbances(plant.thruster_error(tops))
    error, rows = replace(plant, h=age / PARTS).open.gains_over(identity(n), pushes, PARTS)
    return absolute(rows), error


def _pulses(plant: Plant, fired: list[float], placed: str) -> tuple[arb, list[arb]]:
    """Errors of inputs by pulses, and displacements of states within a period: nothing at its ends."""
    A, B, h, m = plant.A, plant.B, plant.h, len(fired)
    inverse, growth, AAB = _spreading(plant), (absolute(A) * h).exp(), A * A * B
    each = ([x * (h**power / divisor) for x in fired] for power, divisor in enumerate(PLACES[placed], 1))
    impulse, integral, area = (column(sums(part, plant.without_delay.thruster_part(part))) for part in each)
    shape = absolute(inverse * AAB) + absolute(inverse) * absolute(A) * growth * absolute(AAB) * (h / 2)
    terms = (shape * area).entries()
    spread = column(sums(terms[:m], terms[m:]))
    within = absolute(B) * impulse + absolute(A * B) * integral
    within += growth * (absolute(AAB) * integral + absolute(B) * spread) * h
    return largest(spread.entries()), within.entries()


def _spreading(plant: Plant) -> arb_mat:
    """Inputs ``a + b s`` over a period that move the state at its middle, whichever way it is asked."""
    A, B, h, n = plant.A, plant.B, plant.h, plant.A.nrows()
    one, zero = identity(n), arb_mat(n, n)
    block = above(beside(-A, one, zero), beside(zero, zero, one), beside(zero, zero, zero)) * h
    rows = [row[n:] for row in block.exp().tolist()[:n]]
    single, double = (matrix([row[i * n : (i + 1) * n] for row in rows]) for i in (0, 1))
    moments = (A * (h / 2)).exp() * beside(single * B, (single - double * (2 / h)) * B)
    try:
        return moments.transpose() * (moments * moments.transpose()).inv()
    except ZeroDivisionError as error:
        raise Rejected("system", "pulses cannot be spread over a period in this system") from error
