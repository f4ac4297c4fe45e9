"""Errors of estimates: as the scenario declares them, by phase of the flight, or an observer's."""

from itertools import pairwise
from math import inf
from typing import Any

from flint import arb

from ..files.document import ROUNDED, Document
from ..kernel.balls import require, sums
from ..kernel.verdict import Rejected
from .allocation import per_axis
from .craft.observer import ObserverErrors, settled_errors
from .plants import plant_of

INSTANT = 1e-9  # share of a step by which instants may differ and count as one

ROUNDED_UP = 1e-8  # share by which bounds may be larger than the scenario's: what a program adds for rounding


def measured_errors(document: Document, scenario: dict[str, Any]) -> list[list[float]]:
    """Bounds on the errors of the estimates, those of predictions apart, by step and from the last one on.

    One row where they do not depend on the step. The certificate states the largest of each state.
    """
    spec, stored = scenario.get("navigation", {}), document.measured_error or [0.0] * len(document.A)
    declared, timing = _declared(document, spec), scenario.get("timing", {})
    if (measurement := spec.get("measurement")) is None:
        if document.observer is not None:
            raise Rejected("system", "the scenario has no observer")
        rows = _phased(document, spec.get("phases") or [], declared, timing)
        if not same_bounds(stored, [max(each) for each in zip(*rows, strict=True)]):
            raise Rejected("system", f"error of estimates: {stored} is not the scenario's")
        return rows
    if any(declared) or spec.get("phases") or "within_m" in spec:
        raise Rejected("system", "bounds of estimates must be left out with an observer")
    pushing = any(fault.get("pushes") for fault in document.transients)
    if pushing and timing.get("missed_periods", 0):  # as the scenario has them
        raise Rejected("system", "missed periods and late thruster faults are not covered together")
    initial = _declared(document, measurement.get("initial", {}))
    return _observed(document, measurement, initial if any(initial) else [], timing.get("delay_s", 0.0))


def _declared(document: Document, spec: dict[str, Any]) -> list[float]:
    """Bounds that are declared for every state."""
    n, hill = len(document.A), document.mean_motion is not None
    other_keys = ("state_error",) if hill else ("position_error_m", "velocity_error_m_s")
    if any(key in spec and spec[key] != 0.0 for key in other_keys):
        raise Rejected("system", "estimate errors are of another kind of system")
    errors: list[float] = _per_axis([spec.get(k, 0.0) for k in ("position_error_m", "velocity_error_m_s")])
    if not hill:
        errors = spec.get("state_error", [0.0] * n)
    if len(errors) != n:
        raise Rejected("system", "estimate errors must be one number per state")
    from_sight = [float(x.upper()) for x in turned_by(document, spec)] + [0.0] * (n - 3)
    return [a + b if b else a for a, b in zip(errors, from_sight, strict=True)] if any(from_sight) else errors


def turned_by(document: Document, spec: dict[str, Any]) -> list[arb]:
    """Bound the position error by axis that errors of range and bearing cause in their box.

    The line of sight may have any direction that it has in the box.
    """
    range_error, angle = (arb(spec.get(key, 0.0)) for key in ("range_error_m", "bearing_error_deg"))
    if range_error == 0 and angle == 0:
        return [arb(0)] * 3
    if document.mean_motion is None or not angle < 90:
        raise Rejected("system", "range and bearing errors are of another kind of system")
    angle, half = angle * arb.pi() / 180, list(map(arb, per_axis(spec["within_m"], 3)))
    lateral = [sum((x * x for j, x in enumerate(half) if j != i), arb(0)).sqrt() for i in range(3)]
    return [range_error + (1 - angle.cos()) * x + angle.sin() * y for x, y in zip(half, lateral, strict=True)]


def same_bounds(stored: list[float], needed: list[float]) -> bool:
    """Return True if bounds are those needed, up to rounding."""
    pairs = zip(stored, needed, strict=True)
    return len(stored) == len(needed) and all(x <= y <= x * (1 + ROUNDED_UP) for y, x in pairs)


def _per_axis(parts: list[Any]) -> list[float]:
    return [x for part in parts for x in (part if isinstance(part, list) else [part] * 3)]


def _phased(
    document: Document, phases: list[dict[str, Any]], declared: list[float], timing: dict[str, Any]
) -> list[list[float]]:
    """Return the largest bounds of the phases that measurements of each step may come from."""
    if not phases:
        return [declared]
    begin = [0.0, *(phase["from_s"] for phase in phases)]
    if any(a >= b for a, b in pairwise(begin)):
        raise Rejected("system", "phases of the navigation must have increasing from_s")
    bounds = [declared, *(_declared(document, phase) for phase in phases)]
    oldest = timing.get("delay_s", 0.0) + timing.get("missed_periods", 0) * arb(document.delta) / document.q
    ends, rows = [*begin[1:], inf], []
    for k in range(document.steps + 1):
        intervals = zip(bounds, begin, ends, strict=True)
        active = [bound for bound, a, b in intervals if holding(document, a, b, k, oldest)]
        rows.append([max(each) for each in zip(*active, strict=True)])
    return rows


def holding(document: Document, begins: float, ends: float, k: int, oldest: arb | float = 0.0) -> bool:
    """Return True if a phase may be met in step k, or so long before; after the last step all have begun."""
    delta = arb(document.delta)
    started = k == document.steps or not begins >= (k + 1) * delta - INSTANT * delta
    return started and not ends <= k * delta - oldest + INSTANT * delta


def _observed(
    document: Document, spec: dict[str, Any], initial: list[float], delay: float
) -> list[list[float]]:
    """Errors of an observer with the gain that is stated, by step if its first errors are known."""
    n, observer = len(document.A), document.observer
    if observer is None:
        raise Rejected("system", "the certificate does not state the observer's gain")
    if document.mean_motion is None:
        measures, noise = spec.get("matrix", []), spec.get("error", [])
        fixed = noise
    else:
        from_sight = turned_by(document, spec)
        parts = [spec.get("position_error_m", 0.0), *(spec[k] for k in ["velocity_error_m_s"] if k in spec)]
        fixed = _per_axis(parts)
        noise = [x + float(y.upper()) for x, y in zip(fixed, from_sight, strict=False)] + fixed[3:]
        measures = [[float(i == j) for j in range(n)] for i in range(len(noise))]
        if not all(x > 0 for x in noise) or {"matrix", "error"} & set(spec):
            raise Rejected("system", "the observer does not measure the position")
    share = spec.get("constant_share", 0.0)
    constant = [share * x for x in fixed] if share else []  # lines of sight turn
    observes = observer["measures"], observer.get("initial") or [], observer.get("constant") or []
    if observes != (measures, initial, constant) or not same_bounds(observer["noise"], noise):
        raise Rejected("system", "the observer is not the scenario's")
    if ("settled" in observer) != bool(initial):
        raise Rejected("system", "settled errors are stated apart from those of the observer's estimates")
    filtering = ObserverErrors.from_document(document, plant_of(document))
    independent, settled = filtering.check_settled(document), settled_errors(document)
    if not initial:
        return [document.measured_error or [0.0] * n]
    fading = filtering.by_step(document, list(map(arb, initial)), independent)
    rows = [[float(x.upper()) for x in sums(settled, decay)] for decay in fading]
    for i, (bound, *needed) in enumerate(zip(document.measured_error, *rows, strict=True)):
        slack = bound * arb(1 + ROUNDED) - max(needed)
        require("system", slack, f"error of the observer's state {i}: {bound}")
    return rows
