"""References of their own that experimental controllers follow: those the scenario describes.

A `setpoint` and an `nmt` are worked out here anew. An `unaware` reference is a solver's plan: that it starts
where the scenario starts, obeys the dynamics, keeps to the input limits and ends in the goal is checked,
that no cheaper plan exists is not.
"""

from typing import Any

from flint import arb, arb_mat

from ..files.document import Document
from ..files.entries import Law
from ..kernel.balls import column, exponential, largest, magnitude, matrix, require
from ..kernel.motion import Plant
from ..kernel.verdict import Rejected
from .plants import plant_of, within_limits

SLACK = 1e-9  # rounding of a stored state or command, relative to the numbers that it is made from
EXPONENTIAL = 1e-14  # rounding of a matrix exponential, relative to the largest numbers it makes

GOAL_SLACK = 1e-5
"""By how much the goal may be missed, relative to its size. No claim of safety rests on the goal."""


def check_references(document: Document, law: Law, scenario: dict[str, Any], spec: dict[str, Any]) -> None:
    """Compare the reference of one affine controller with `spec`, the scenario's entry for it."""
    reference = spec.get("reference", {"kind": "shared"})
    kind: str = reference["kind"]
    if (law.states is None) != (kind == "shared"):
        raise Rejected("controllers", f"{law.name} must follow the reference of kind {kind}")
    if law.states is None or law.inputs is None:
        return
    if len(law.states) != document.steps + 1 or len(law.inputs) != document.steps:
        raise Rejected("controllers", f"the reference of {law.name} must cover the {document.steps} steps")
    if kind == "setpoint" and law.gain is None:
        moves = any(x != reference["state"] for x in law.states) or any(any(u) for u in law.inputs)
        if moves or any(
            not x.is_zero() for x in (plant_of(document).A * column(reference["state"])).entries()
        ):
            raise Rejected("controllers", f"the reference of {law.name} is not the state at rest")
        return
    if kind == "setpoint":
        _check_setpoint(document, law, reference["state"])
        return
    _check_dynamics(document, law, law.states, law.inputs)
    if kind == "nmt":
        if any(any(u) for u in law.inputs):
            raise Rejected("controllers", f"the natural motion of {law.name} must have no thrust")
        _check_start(law, law.states[0], _ellipse(document, reference))
    else:
        if law.states[0] != scenario["initial_set"]["center"]:
            text = f"the reference of {law.name} does not start where the scenario does"
            raise Rejected("controllers", text)
        within_limits(document, law.inputs, "controllers", f"{law.name}'s reference")
        last = law.states[document.steps]
        check_goal(scenario["goal"], document, last, "controllers", f"the reference of {law.name}")


def _check_dynamics(
    document: Document, law: Law, states: list[list[float]], inputs: list[list[float]]
) -> None:
    """Check that every step leads to the next state, up to rounding."""
    phi, push, _ = _step(document)
    for k, u in enumerate(inputs):
        x, v = column(states[k]), column(u)
        derived = (phi * x + push * v).entries()
        size = (magnitude(phi) * magnitude(x) + magnitude(push) * magnitude(v)).entries()
        widest = largest(size)  # a matrix exponential is as exact as its largest entries are large
        for i, (exact, stored) in enumerate(zip(derived, states[k + 1], strict=True)):
            witness = f"the reference of {law.name} leaves the dynamics in step {k}, state {i}"
            require("controllers", size[i] * SLACK + widest * EXPONENTIAL - abs(exact - stored), witness)


def _step(document: Document) -> tuple[arb_mat, arb_mat, Plant]:
    """``e^{A delta}``, ``int_0^delta e^{A s} ds B``, and the plant."""
    plant = plant_of(document)
    phi, gamma = exponential(plant.A, arb(document.delta))
    return phi, gamma * plant.B, plant


def _check_setpoint(document: Document, law: Law, state: list[float]) -> None:
    """Check that one state x and one input u keep themselves, ``u + K (x - y) = K (s - y)`` for all y.

    So the law is the feedback about the given state s. Both are measured by what they do to the command.
    """
    assert law.gain is not None and law.states is not None and law.inputs is not None
    if any(row != law.states[0] for row in law.states) or any(u != law.inputs[0] for u in law.inputs):
        raise Rejected("controllers", f"the reference of {law.name} is no single state")
    phi, push, plant = _step(document)
    K, x, s, u = matrix(law.gain), column(law.states[0]), column(state), column(law.inputs[0])
    gap = magnitude(u + K * (x - s))
    drift = magnitude(phi * x + push * u - x) + magnitude(plant.A * x + plant.B * u) * arb(document.delta)
    size = magnitude(K) * (magnitude(x) + magnitude(s))
    for name, value in (("is not what the state it heads for gives", gap), ("drifts", magnitude(K) * drift)):
        for i, (amount, scale) in enumerate(zip(value.entries(), size.entries(), strict=True)):
            witness = f"the reference of {law.name} {name} (input {i})"
            require("controllers", scale * SLACK - amount, witness)


def _check_start(law: Law, state: list[float], exact: arb_mat) -> None:
    size = max(float(x.mid()) for x in magnitude(exact).entries())
    for i, (stored, derived) in enumerate(zip(state, exact.entries(), strict=True)):
        allowed = (abs(derived) + (size if i < 3 else 0) * arb(1e-6)) * SLACK
        witness = f"the reference of {law.name} does not start on its ellipse (state {i})"
        require("controllers", allowed - abs(derived - stored), witness)


def _ellipse(document: Document, spec: dict[str, Any]) -> arb_mat:
    """State at t = 0 on an elliptical natural motion."""
    if document.mean_motion is None:
        raise Rejected("controllers", "a natural motion needs Hill's frame")
    eta, b, c = arb(document.mean_motion), arb(spec["semi_minor_m"]), arb(spec.get("cross_track_m", 0.0))
    psi = arb(spec.get("phase_rad", 0.0))
    zeta = psi + arb(spec.get("cross_phase_rad", 0.0))
    values = [b * psi.sin(), 2 * b * psi.cos(), c * zeta.sin()]
    values += [b * eta * psi.cos(), -2 * b * eta * psi.sin(), c * eta * zeta.cos()]
    return column(values)


def check_goal(spec: dict[str, Any], document: Document, x: list[float], claim: str, whose: str) -> None:
    """Check that a state lies in the scenario's goal; a claim, and whose state it is, are for messages."""
    terms, size = GOALS[spec["kind"]](document, x, spec)
    worst, name = max(terms)
    if not worst <= GOAL_SLACK * size:
        raise Rejected(claim, f"{whose} misses the goal ({name})", worst)


Misses = tuple[list[tuple[float, str]], float]
"""Distance of a state from a goal, by condition, and the goal's size."""


def _states(_: Document, x: list[float], spec: dict[str, Any]) -> Misses:
    middle, half = spec.get("center") or spec["state"], spec.get("half_widths") or [0.0] * len(x)
    rows = enumerate(zip(x, middle, half, strict=True))
    return [(abs(a - c) - h, f"state {i}") for i, (a, c, h) in rows], max(1.0, *(abs(c) for c in middle))


def _linear(document: Document, x: list[float], spec: dict[str, Any]) -> Misses:
    eta = _mean_motion(document)
    amplitude, along = spec["amplitude_max_m"], spec.get("along_track_m", 0.0)
    residuals = [x[0], x[1] - along, x[3] / eta, x[4] / eta]
    terms = [(abs(value), f"condition {i}") for i, value in enumerate(residuals)]
    return [*terms, ((x[2] ** 2 + (x[5] / eta) ** 2) ** 0.5 - amplitude, "amplitude")], max(amplitude, 1.0)


def _elliptical(document: Document, x: list[float], spec: dict[str, Any]) -> Misses:
    eta = _mean_motion(document)
    inner, outer = spec["inner_semi_minor_m"], spec["outer_semi_minor_m"]
    b = (x[0] ** 2 + x[1] ** 2 / 4) ** 0.5
    top = spec.get("cross_track_max_m", 0.0)
    return [
        (abs(x[4] / eta + 2 * x[0]), "v_y = -2 eta r_x"),
        (abs(x[3] / eta - x[1] / 2), "v_x = eta r_y / 2"),
        (b - outer, "outer ellipse"),
        (inner - b, "inner ellipse"),
        *((abs(value) - top, "cross-track") for value in (x[2], x[5] / eta)),
    ], outer


def _mean_motion(document: Document) -> float:
    if document.mean_motion is None:
        raise Rejected("goal", "a natural motion needs Hill's frame")
    return document.mean_motion


GOALS = {"stationary": _states, "box": _states, "linear_nmt": _linear, "elliptical_nmt": _elliptical}
"""By kind of goal, how far a state is from it; every kind that `scenario_keys` knows is here."""
