"""How far estimates may be off: as the scenario declares it, by phase of the flight, or an observer's."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from flint import arb, arb_mat

from .balls import above, absolute, column, exponential, identity, largest, magnitude, matrix, require, sums
from .document import Document
from .motion import Plant
from .plants import plant_of
from .verdict import Rejected, Undecided

PARTS = 4
"""Parts of a period over each of which integrals are bounded by the trapezoid rule."""

INSTANT = 1e-9
"""Share of a step by which instants may differ and count as one."""

FORGOTTEN, LONGEST = 1e-10, 1 << 15
"""What of an error counts as forgotten, as a share of what has come since, and the most periods for it."""

ROUNDED = 1e-10
"""What is added to a bound that must hold for ever, as a share of it."""

Rows = list[list[arb]]


def measured_errors(document: Document, scenario: dict[str, Any]) -> Rows:
    """Bounds on the errors of the estimates, those of predictions apart, by step and from the last one on.

    One row where they do not depend on the step. The certificate states the largest of each state.
    """
    spec, stored = scenario.get("navigation", {}), document.measured or [0.0] * len(document.A)
    declared = _declared(document, spec)
    if (asked := spec.get("measurement")) is None:
        if document.observer is not None:
            raise Rejected("system", "the scenario has no observer")
        rows = _phased(document, spec, declared, scenario.get("timing", {}))
        if stored != [max(each) for each in zip(*rows, strict=True)]:
            raise Rejected(
                "system", f"error of estimates is {stored} in the certificate, not in the scenario"
            )
        return [[arb(x) for x in row] for row in rows]
    if any(declared) or spec.get("phases"):
        raise Rejected("system", "an observer's estimates are declared as well")
    if not document.sampled or scenario.get("timing", {}).get("missed_periods", 0):
        raise Rejected("system", "an observer needs a measurement in every control period")
    found = _observed(document, asked)
    for i, (bound, needed) in enumerate(zip(stored, map(largest, zip(*found, strict=True)), strict=True)):
        require("system", bound * arb(1 + 1e-12) - needed, f"error of the observer's state {i}: {bound}")
    return found if len(found) > 1 else [[arb(x) for x in stored]]


def _declared(document: Document, spec: dict[str, Any]) -> list[float]:
    """Bounds that are declared for every state."""
    n, hill = len(document.A), document.mean_motion is not None
    wrong = ("state_error",) if hill else ("position_error_m", "velocity_error_m_s")
    if any(key in spec and spec[key] != 0.0 for key in wrong):
        raise Rejected("system", "errors of estimates are given for another kind of system")
    if not hill:
        given = spec.get("state_error", [0.0] * n)
    else:
        axes = [spec.get(key, 0.0) for key in ("position_error_m", "velocity_error_m_s")]
        given = [x for part in axes for x in (part if isinstance(part, list) else [part] * 3)]
    if len(given) != n:
        raise Rejected("system", "errors of estimates are not one for every state")
    return [float(x) for x in given]


def _phased(
    document: Document, spec: dict[str, Any], declared: list[float], timing: dict[str, Any]
) -> list[list[float]]:
    """The largest bounds of the phases that measurements of each step may come from."""
    phases, delta = spec.get("phases") or [], arb(document.delta)
    if not phases:
        return [declared]
    begin, bounds = [0.0], [declared]
    for phase in phases:
        if not phase["from_s"] > begin[-1]:
            raise Rejected("system", "phases of the navigation must begin one after the other")
        begin.append(phase["from_s"])
        bounds.append(_declared(document, phase))
    oldest = timing.get("delay_s", 0.0) + timing.get("missed_periods", 0) * delta / document.q
    slack, rows = INSTANT * delta, []
    for k in range(document.steps + 1):
        first, last = k * delta - oldest + slack, (k + 1) * delta - slack
        met = [
            bound
            for i, bound in enumerate(bounds)
            if (k == document.steps or not begin[i] >= last) and not [*begin, arb("inf")][i + 1] <= first
        ]
        rows.append([max(each) for each in zip(*met, strict=True)])
    return rows


def _observed(document: Document, spec: dict[str, Any]) -> Rows:
    """Bounds on the errors of an observer's estimates, with the gain that the certificate states."""
    n, stated = len(document.A), document.observer
    if stated is None:
        raise Rejected("system", "the certificate does not state the observer's gain")
    if document.mean_motion is None:
        measures, noise = spec.get("matrix", []), spec.get("error", [])
    else:
        given = [spec[key] for key in ("position_error_m", "velocity_error_m_s") if key in spec]
        noise = [x for part in given for x in (part if isinstance(part, list) else [part] * 3)]
        measures = [[float(i == j) for j in range(n)] for i in range(len(noise))]
        if "position_error_m" not in spec or len(noise) > n or {"matrix", "error"} & set(spec):
            raise Rejected("system", "the observer does not measure the position")
    first = None if spec.get("initial") is None else _declared(document, spec["initial"])
    if (stated["measures"], stated["noise"], stated.get("initial")) != (measures, noise, first):
        raise Rejected("system", "the observer is not the scenario's")
    plant, M, L = plant_of(document), matrix(measures), matrix(stated["gain"])
    rest = identity(n) - L * M
    loop = rest * exponential(plant.A, plant.h)[0]
    v = sums(map(arb, noise), (absolute(M) * column(document.displaced)).entries())
    powers = [identity(n)]
    each: Rows = []
    while True:
        while len(powers) <= max(2 * len(each), 1):
            powers.append(powers[-1] * loop)
        each += _pushed(plant, powers[len(each) : len(powers) - 1], rest, L, v)
        total, last = sums(*each), magnitude(powers[-1])
        left = (last * column(total)).entries()
        c = largest(arb(0) if a.is_zero() else a / b for a, b in zip(left, total, strict=True))
        if c < FORGOTTEN:
            break
        if len(each) >= LONGEST:
            raise Undecided("system", "the observer does not forget errors")
    ever = [x / (1 - c) for x in total]
    return [ever] if first is None else _from_first(document, first, each, ever, powers)


def _pushed(plant: Plant, powers: list[arb_mat], rest: arb_mat, L: arb_mat, noise: list[arb]) -> Rows:
    """What disturbance, thrust and noise of one period add to the error so many periods later."""
    part, n = replace(plant, h=plant.h / PARTS).open, plant.A.nrows()
    thrusters = plant.push(plant.thruster_error(plant.u_max))
    rows = above(*(power * rest for power in powers))
    found = [x for power in powers for x in (magnitude(power * L) * column(noise)).entries()]
    for _ in range(PARTS):
        for push in (plant.disturbance, *([thrusters] if thrusters else [])):
            found = sums(found, part.push_gain(rows, push))
        rows = rows * part.phi
    return [[x.upper() for x in found[at : at + n]] for at in range(0, len(found), n)]


def _from_first(
    document: Document, first: list[float], each: Rows, ever: list[arb], powers: list[arb_mat]
) -> Rows:
    """The same by step where the first estimate is off by no more than so much."""
    K, q, count = document.steps, document.q, len(each)
    powers, bounds, come = list(powers), [], [arb(0)] * len(ever)
    for node in range(K * q + count + 1):
        if node >= len(powers):
            powers.append(powers[-1] * powers[1])
        carried = (magnitude(powers[node]) * column(first)).entries()
        bounds.append(sums(carried, come if node <= count else ever))
        come = sums(come, each[node]) if node < count else come
    late = [largest(x) * (1 + ROUNDED) for x in zip(ever, *bounds[K * q :], strict=True)]
    needed = sums(sums(*each), (magnitude(powers[count]) * column(late)).entries())
    if not all(a >= b for a, b in zip(late, needed, strict=True)):
        raise Undecided("system", "the observer's first error is not forgotten")
    steps = [list(map(largest, zip(*bounds[k * q : (k + 1) * q], strict=True))) for k in range(K)]
    return [*steps, late]
