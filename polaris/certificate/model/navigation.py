"""How far estimates may be off: as the scenario declares it, by phase of the flight, or an observer's."""

from dataclasses import dataclass, replace
from itertools import pairwise
from math import inf
from typing import Any

from flint import arb, arb_mat

from ..files.document import ROUNDED, Document
from ..kernel.balls import absolute, column, exponential, identity, largest, magnitude, matrix, require, sums
from ..kernel.motion import Motion, Plant, Push
from ..kernel.verdict import Rejected
from .allocation import per_axis
from .plants import plant_of
from .timing import displaced

PARTS = 4  # parts of a period over each of which integrals are bounded by the trapezoid rule

INSTANT = 1e-9  # share of a step by which instants may differ and count as one

ROUNDED_UP = 1e-8  # share by which bounds may be larger than the scenario's: what a program adds for rounding

FORGOTTEN, LONGEST = 1e-9, 4096
"""What of an observer's error counts as forgotten, as a share of itself, and the most periods for it."""


def measured_errors(document: Document, scenario: dict[str, Any]) -> list[list[float]]:
    """Bounds on the errors of the estimates, those of predictions apart, by step and from the last one on.

    One row where they do not depend on the step. The certificate states the largest of each state.
    """
    spec, stored = scenario.get("navigation", {}), document.measured or [0.0] * len(document.A)
    declared, timing = _declared(document, spec), scenario.get("timing", {})
    if (asked := spec.get("measurement")) is None:
        if document.observer is not None:
            raise Rejected("system", "the scenario has no observer")
        rows = _phased(document, spec.get("phases") or [], declared, timing)
        if not same_bounds(stored, [max(each) for each in zip(*rows, strict=True)]):
            raise Rejected("system", f"error of estimates: {stored} is not the scenario's")
        return rows
    if any(declared) or spec.get("phases") or "within_m" in spec:
        raise Rejected("system", "an observer's estimates are declared as well")
    if document.transients and timing.get("missed_periods", 0):  # as the scenario has them
        raise Rejected("system", "an observer that may miss periods, with faults isolated late")
    initial = _declared(document, asked.get("initial", {}))
    return _observed(document, asked, initial if any(initial) else [], timing.get("delay_s", 0.0))


def _declared(document: Document, spec: dict[str, Any]) -> list[float]:
    """Bounds that are declared for every state."""
    n, hill = len(document.A), document.mean_motion is not None
    wrong = ("state_error",) if hill else ("position_error_m", "velocity_error_m_s")
    if any(key in spec and spec[key] != 0.0 for key in wrong):
        raise Rejected("system", "errors of estimates are given for another kind of system")
    found: list[float] = _per_axis([spec.get(k, 0.0) for k in ("position_error_m", "velocity_error_m_s")])
    if not hill:
        found = spec.get("state_error", [0.0] * n)
    if len(found) != n:
        raise Rejected("system", "errors of estimates are not one for every state")
    turned = [float(x.upper()) for x in turned_by(document, spec)] + [0.0] * (n - 3)
    return [a + b if b else a for a, b in zip(found, turned, strict=True)] if any(turned) else found


def turned_by(document: Document, spec: dict[str, Any]) -> list[arb]:
    """Bound the position error by axis that errors of range and bearing cause in their box.

    The line of sight may have any direction that it has in the box.
    """
    off, angle = (arb(spec.get(key, 0.0)) for key in ("range_error_m", "bearing_error_deg"))
    if off == 0 and angle == 0:
        return [arb(0)] * 3
    if document.mean_motion is None or not angle < 90:
        raise Rejected("system", "errors of range and bearing are given for another kind of system")
    angle, half = angle * arb.pi() / 180, list(map(arb, per_axis(spec["within_m"], 3)))
    across = [sum((x * x for j, x in enumerate(half) if j != i), arb(0)).sqrt() for i in range(3)]
    return [off + (1 - angle.cos()) * x + angle.sin() * y for x, y in zip(half, across, strict=True)]


def same_bounds(stored: list[float], needed: list[float]) -> bool:
    """Return True if bounds are those needed, up to rounding."""
    pairs = zip(stored, needed, strict=True)
    return len(stored) == len(needed) and all(x <= y <= x * (1 + ROUNDED_UP) for y, x in pairs)


def _per_axis(parts: list[Any]) -> list[float]:
    return [x for part in parts for x in (part if isinstance(part, list) else [part] * 3)]


def _phased(
    document: Document, phases: list[dict[str, Any]], declared: list[float], timing: dict[str, Any]
) -> list[list[float]]:
    """The largest bounds of the phases that measurements of each step may come from."""
    if not phases:
        return [declared]
    begin = [0.0, *(phase["from_s"] for phase in phases)]
    if any(a >= b for a, b in pairwise(begin)):
        raise Rejected("system", "phases of the navigation must begin one after the other")
    bounds = [declared, *(_declared(document, phase) for phase in phases)]
    oldest = timing.get("delay_s", 0.0) + timing.get("missed_periods", 0) * arb(document.delta) / document.q
    ends, rows = [*begin[1:], inf], []
    for k in range(document.steps + 1):
        known = zip(bounds, begin, ends, strict=True)
        met = [bound for bound, a, b in known if holding(document, a, b, k, oldest)]
        rows.append([max(each) for each in zip(*met, strict=True)])
    return rows


def holding(document: Document, begins: float, ends: float, k: int, oldest: arb | float = 0.0) -> bool:
    """Whether a phase may be met in step k, or so long before; after the last step all have begun."""
    delta = arb(document.delta)
    begun = k == document.steps or not begins >= (k + 1) * delta - INSTANT * delta
    return begun and not ends <= k * delta - oldest + INSTANT * delta


def _observed(
    document: Document, spec: dict[str, Any], initial: list[float], delay: float
) -> list[list[float]]:
    """Errors of an observer with the gain that is stated, by step if its first errors are known."""
    n, stated = len(document.A), document.observer
    if stated is None:
        raise Rejected("system", "the certificate does not state the observer's gain")
    if document.mean_motion is None:
        measures, noise = spec.get("matrix", []), spec.get("error", [])
    else:
        turned = turned_by(document, spec)
        given = [spec.get("position_error_m", 0.0), *(spec[k] for k in ["velocity_error_m_s"] if k in spec)]
        noise = _per_axis(given)
        noise = [x + float(y.upper()) for x, y in zip(noise, turned, strict=False)] + noise[3:]
        measures = [[float(i == j) for j in range(n)] for i in range(len(noise))]
        if spec.get("constant_share", 0.0) and any(y > 0 for y in turned):
            raise Rejected("system", "errors that turn with the line of sight are not constant")
        if not all(x > 0 for x in noise) or {"matrix", "error"} & set(spec):
            raise Rejected("system", "the observer does not measure the position")
    share = spec.get("constant_share", 0.0)
    constant = [share * x for x in noise] if share else []
    observes = stated["measures"], stated.get("initial") or [], stated.get("constant") or []
    if observes != (measures, initial, constant) or not same_bounds(stated["noise"], noise):
        raise Rejected("system", "the observer is not the scenario's")
    plant, M, missed = plant_of(document), matrix(measures), document.timing.get("missed", 0)
    gains = [matrix(gain) for gain in (stated["gain"], *stated.get("after", ()))]
    if len(gains) != missed + 1:
        raise Rejected("system", f"the observer is not one of up to {missed} missed periods")
    if "settled" in stated and (missed or not initial):  # nothing below would verify it
        raise Rejected("system", "settled errors are stated apart from those of the observer's estimates")
    loop = (identity(n) - gains[0] * M) * exponential(plant.A, plant.h)[0]
    settled = (stated.get("settled") if initial and not missed else document.measured) or [0.0] * n
    noisy = column(sums(map(arb, noise), (absolute(M) * column(displaced(document, delay))).entries()))
    updates = [Update.of(plant, gain, M, loop, j) for j, gain in enumerate(gains)]
    _check_settled(plant, updates, (loop, noisy), (settled, (missed and initial) or [0.0] * n))
    if missed or not initial:
        return [settled]
    fading = _fading(loop, column(initial), document)
    rows = [[float(x.upper()) for x in sums(map(arb, settled), left)] for left in fading]
    for i, (bound, *most) in enumerate(zip(document.measured, *rows, strict=True)):
        spare = bound * arb(1 + ROUNDED) - max(most)
        require("system", spare, f"error of the observer's state {i}: {bound}")
    return rows


@dataclass(frozen=True, eq=False)
class Update:
    """What an observer does after some missed periods: what it leaves of errors, less what periods would."""

    gain: arb_mat
    rest: arb_mat
    other: arb_mat
    periods: int

    @classmethod
    def of(cls, plant: Plant, gain: arb_mat, M: arb_mat, loop: arb_mat, missed: int) -> "Update":
        """After so many missed periods."""
        n, count = plant.A.nrows(), missed + 1
        rest = identity(n) - gain * M
        other = rest * exponential(plant.A, plant.h * count)[0] - loop**count if missed else arb_mat(n, n)
        return cls(gain, rest, other, count)

    def adds(
        self, left: arb_mat, known: tuple[arb_mat, arb_mat], part: Motion, pushes: list[Push]
    ) -> list[arb]:
        """What it adds along rows, errors of measurements and earlier estimates being `known`.

        So does all that has pushed over its periods, each of `PARTS` parts.
        """
        come = magnitude(left * self.gain) * known[0] + magnitude(left * self.other) * known[1]
        pushed, _ = part.gains_over(left * self.rest, pushes, PARTS * self.periods)
        return [x.upper() for x in sums(come.entries(), pushed)]


def _check_settled(
    plant: Plant, updates: list[Update], filtering: tuple[arb_mat, arb_mat], bounds: tuple[list[float], ...]
) -> None:
    """Errors of an observer stay within bounds, by every pattern of updates.

    What an update and a period make of them is in `filtering`, with bounds on what is measured. The observer
    has long been at work, or its first errors are within the second of the bounds. Every way back into the
    past comes by one of as many periods in a row as there are kinds of updates.
    """
    (settled, first), (loop, noisy), known = bounds, filtering, column(bounds[0])
    part, errors = replace(plant, h=plant.h / PARTS).open, plant.thruster_error(plant.u_max)
    pushes = plant.disturbances(errors)
    left, passed, n = identity(len(settled)), 0, len(settled)
    come = [[arb(0)] * n for _ in range(LONGEST + len(updates) + 1)]

    def spare(age: int, since: arb_mat) -> list[arb]:
        known_since = (magnitude(left) * since).entries()
        return [b * arb(1 + ROUNDED) - x - y for b, x, y in zip(settled, come[age], known_since, strict=True)]

    for age in range(LONGEST):
        for i, x in enumerate(spare(age, column(first))):
            require("system", x, f"error of the observer's state {i}: {settled[i]}")
        for update in updates:
            to, more = age + update.periods, sums(come[age], update.adds(left, (noisy, known), part, pushes))
            come[to] = [largest(pair) for pair in zip(come[to], more, strict=True)]
        left = left * loop
        more, late = spare(age + 1, known), (magnitude(left) * known).entries()
        passed = passed + 1 if all(x >= 0 for x in more) else 0
        if passed == len(updates):
            return
        if not passed and all(x <= FORGOTTEN * bound for x, bound in zip(late, settled, strict=True)):
            break
    for i, x in enumerate(more):
        require("system", x, f"error of the observer's state {i}: {settled[i]}")


def _fading(loop: arb_mat, initial: arb_mat, document: Document) -> list[list[arb]]:
    """What first errors of an observer still add in each step, and ever after."""
    left, each, first = identity(loop.nrows()), [], document.steps * document.q
    for _ in range(first):
        each.append((magnitude(left) * initial).entries())
        left = left * loop
    q = document.q
    found = [list(map(largest, zip(*each[k * q : (k + 1) * q], strict=True))) for k in range(document.steps)]
    ever, turn = (magnitude(left) * initial).entries(), loop
    for _ in range(LONGEST):  # until so many periods make no more of what they begin with
        if all(x <= y for x, y in zip((magnitude(turn) * column(ever)).entries(), ever, strict=True)):
            return [*found, ever]
        left, turn = left * loop, turn * loop
        ever = [largest(pair) for pair in zip(ever, (magnitude(left) * initial).entries(), strict=True)]
    raise Rejected("system", "the observer does not forget its first errors")
