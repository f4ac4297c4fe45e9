"""The plant that a certificate speaks about, with exact entries."""

import math
from dataclasses import replace
from itertools import pairwise
from math import ceil

from flint import arb, arb_mat

from ..files.document import Document
from ..kernel.balls import (
    PRECISION,
    absolute,
    beside,
    exponential,
    identity,
    largest,
    magnitude,
    matrix,
    maxima,
    require,
    sums,
)
from ..kernel.motion import InputSet, Plant
from ..kernel.pulse_lead import Lead
from ..kernel.verdict import Rejected, Undecided
from .allocation import Nozzles

WHOLE = 1e-9  # share by which a delay may exceed a whole number of periods and count as one

MOST_BITS = 4096  # most bits that are added to follow a reference


def plant_of(document: Document) -> Plant:
    """Matrices with exact entries: in Hill's frame those of the mean motion, not their rounded values."""
    A, B, D = matrix(document.A), matrix(document.B), matrix(document.D)
    if document.system_kind == "clohessy_wiltshire":
        exact = _hill(document)
        for name, stored, derived in zip("ABD", (A, B, D), exact, strict=True):
            if (stored.nrows(), stored.ncols()) != (derived.nrows(), derived.ncols()):
                raise Rejected("system", f"{name} is not of the size it has in Hill's frame")
            for i, (x, y) in enumerate(zip(stored.entries(), derived.entries(), strict=True)):
                require("system", abs(y) * 1e-14 - abs(x - y), f"{name}, entry {i}: {x} is not {y}")
        A, B, D = exact
    h = arb(document.delta) / document.q
    u_max = [arb(x) for x in document.u_max]
    C, w_max = matrix(document.C), arb(document.w_max)
    jitter = arb(document.timing.get("jitter", 0.0)) + document.timing.get("edge", 0.0)
    delay, missed = document.timing.get("delay", 0.0), document.timing.get("missed", 0)
    latency = ceil(float((delay / h).mid()) * (1 - WHOLE)) + missed
    plant = Plant(A, B, D, C, u_max, w_max, h, document.q, jitter=jitter, carried=document.carried_impulse)
    plant = replace(plant, bits=document.prompt_bits)
    if (layout := Nozzles.from_document(document)) is not None:
        plant = replace(plant, shares=layout.shares, weights=layout.weights)
    else:
        along, across, _ = document.shares
        constant = document.same_shares and along < 1 and jitter == 0
        plant = replace(plant, along=along, across=across, constant=constant)
    bias = [InputSet.in_box(*_constant(D, document.bias))] if any(document.bias) else []
    plant = replace(plant, bias=bias, unmeasured=delay + missed * h)
    plant = _out_of_time(document, plant)
    if document.transients:
        return plant
    unseen = [(latency, plant.predicted)] * (latency > 0)
    return replace(plant, by_lag=unseen + [(latency + age, gain) for age, gain in older(document, plant)])


def _constant(D: arb_mat, bias: list[float]) -> tuple[arb_mat, list[arb]]:
    """Return columns of D with the bounds of their constants, those of 0 left out as weights do."""
    places = [i for i, x in enumerate(bias) if x]
    return matrix([[row[i] for i in places] for row in D.tolist()]), [arb(bias[i]) for i in places]


def older(document: Document, plant: Plant) -> list[tuple[int, arb_mat]]:
    """Return an observer's prediction errors per unit of thruster errors of so many periods ago, (n, k).

    As the certificate states them of estimates, carried over the age that makes each largest. Leads of
    pulses add nothing: they are among the observer's own errors at full thrust.
    """
    observer, delay = document.observer or {}, arb(document.timing.get("delay", 0.0))
    if "by_age" not in observer:
        return []
    ages = [delay + plant.h * j for j in range(document.timing.get("missed", 0) + 1)]
    gains = [absolute(exponential(plant.A, age)[0]).entries() for age in ages]
    carried = arb_mat(plant.A.nrows(), plant.A.nrows(), maxima(*gains))
    n, m = plant.B.nrows(), plant.B.ncols()
    leads = arb_mat(n, plant.entering.ncols() - m)
    each = (carried * (new - old) for new, old in pairwise(matrix(M) for M in observer["by_age"]))
    return [(age, beside(gain, leads)) for age, gain in zip(observer["ages"][1:], each, strict=True)]


def _out_of_time(document: Document, on_time: Plant) -> Plant:
    """Add input errors by jitter and pulses, and the impulses that jitter shifts (Lemma 6 (a))."""
    plant, jitter = replace(on_time, bits=document.bits, on_time=on_time), arb(on_time.jitter)
    if document.pulse_place:
        plant = replace(plant, lead=_lead(document, on_time))
    if jitter == 0:
        return plant
    top = [2 * arb(x) for x in document.pulse_thrust] or [
        x + 2 * plant.carried / plant.h for x in plant.u_max
    ]
    shifted = (jitter * (x + y) for x, y in zip(top, on_time.thruster_error(top), strict=True))
    plant = replace(plant, shifted=tuple(shifted))
    if not document.late:
        return plant
    share = 2 * jitter / plant.h
    if plant.shares:
        rows = enumerate(plant.shares)
        shares = [[(1 + share) * x + share * (i == j) for i, x in enumerate(row)] for j, row in rows]
        return replace(plant, shares=shares)
    return replace(plant, along=(1 + share) * plant.along + share, across=(1 + share) * plant.across)


def _lead(document: Document, plant: Plant) -> Lead:
    """Bound the leads of pulses: at most ``h/2 f g (1 - g)`` of one of thrust f that takes a share g."""
    m, half, layout = len(document.u_max), plant.h / 2, Nozzles.from_document(document)
    fired = [plant.h / 8 * x for x in document.pulse_thrust]
    if layout is None:
        rows = (identity(m) + plant.table).tolist()
        fixed = sums([sum(row, arb(0)) * plant.carried / plant.h for row in rows], map(arb, plant.bits))
    else:
        rows, size = layout.part_sums, plant.carried / (layout.max_carried(arb(1)) * plant.h)
        fixed = [
            x + size * y for x, y in zip(map(arb, plant.bits), layout.at_once(layout.sizes), strict=True)
        ]
    shares, fixed = [[half * x for x in row] for row in rows], [half * x for x in fixed]
    pairs = zip(sums(fired, plant.thruster_part(fired)), fixed, strict=True)
    return Lead(shares, fixed, [largest((x - y, arb(0))) for x, y in pairs])


def within_limits(document: Document, inputs: list[list[float]], claim: str, whose: str) -> None:
    """Check that inputs keep to the thrusters' limits."""
    for k, u in enumerate(inputs):
        for name, top, value in zip(document.input_names, document.u_max, u, strict=True):
            require(claim, arb(top) - abs(arb(value)), f"{name} of {whose} in step {k}")


def precision_for(document: Document) -> int:
    """Bits of the midpoints with which the reference can be followed to its end.

    Step by step every ball takes in the corners of the one before: its radius grows like the powers of
    ``|e^{A delta}|``, and the bits that are lost to that are added, up to `MOST_BITS`.
    """
    plant = plant_of(document)
    step = magnitude(exponential(plant.A, arb(document.delta))[0])
    growth = largest((step**document.longest).entries())
    bits = float(growth.log().mid()) / math.log(2) if growth.is_finite() and growth > 1 else 0.0
    if not (growth.is_finite() and bits <= MOST_BITS):
        raise Undecided("reference", f"it takes more than {MOST_BITS} bits to follow it to its end")
    return PRECISION + math.ceil(bits)


def _hill(document: Document) -> tuple[arb_mat, arb_mat, arb_mat]:
    """Clohessy-Wiltshire matrices of the stored mean motion and mass, exact."""
    if document.mean_motion is None:
        raise Rejected("system", "Hill's frame needs a mean motion")
    eta = arb(document.mean_motion)
    A, B, D = arb_mat(6, 6), arb_mat(6, 3), arb_mat(6, 3)
    for i in range(3):
        A[i, 3 + i], B[3 + i, i], D[3 + i, i] = 1, 1 / arb(document.mass), 1
    A[3, 0], A[3, 4], A[4, 3], A[5, 2] = 3 * eta * eta, 2 * eta, -2 * eta, -eta * eta
    return A, B, D
