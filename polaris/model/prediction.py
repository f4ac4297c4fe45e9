"""How far the state that flight software predicts may be from the true one; what instants and pulses add."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import expm

from reach.numerics.errors import ReachError
from reach.numerics.linear import discretize
from reach.tubes.flow import LinearFlow

from .errors import ScenarioError
from .system import Array, LinearSystem
from .timing import Timing

PARTS = 32
"""Parts of a prediction over each of which integrals are bounded by the trapezoid rule."""

ROUNDED = 1e-9
"""Relative round-off of a bound, upwards."""

AT_NODES = 1e-6
"""Share of what pulses displace at most within a billionth of a period of its ends, where it is nothing."""


def prediction_error(system: LinearSystem, estimate: Array, thruster: Array, tau: float) -> Array:
    """Bound on the error of the state predicted over tau [s] from an estimate, shape (n,).

    The prediction follows the model under the commands in force, which are known: what is left is the error
    of the estimate (n,) carried along, the disturbance, and errors of what is applied (m,), each at its
    worst (docs/theory.md, Lemma 25). Rounded upwards; the estimate itself for tau = 0.
    """
    if not tau > 0:
        return estimate
    E = system.error_map(thruster)
    flow = LinearFlow.continuous(system.A, system.D, system.w_max, tau / PARTS, E)
    pushed = flow.disturbance_support(np.eye(system.n), PARTS)[-1]
    carried = np.abs(np.linalg.matrix_power(flow.phi, PARTS)) @ estimate
    return np.asarray((carried + pushed) * (1 + ROUNDED))


def jitter_error(system: LinearSystem, jitter: float, h: float) -> tuple[float, Array]:
    """What commands add that take effect up to `jitter` [s] early or late, renewed every h [s].

    An error of every input [N], and a displacement (n,) that does not add up (docs/theory.md, Lemma 26):
    as much impulse at the same place is spread over a period about the instant.

    Raises
    ------
    ScenarioError
        If inputs that are linear in time cannot do that: too few of them for the states.
    """
    if not jitter > 0:
        return 0.0, np.zeros(system.n)
    A, B, m, reach = system.A, system.B, system.m, h / 2 + jitter
    inverse, over = _spreading(system, h, "timing.jitter_s", jitter), expm(np.abs(A) * reach) @ np.abs(B)
    shape = np.abs(inverse @ B) + jitter * np.abs(inverse @ A @ B)
    shape += jitter**2 / 2 * np.abs(inverse) @ np.abs(A) @ np.abs(A) @ over
    impulse = jitter * (2 * system.u_max + system.thrusters.error(system.u_max))
    spread = np.maximum((shape[:m] + shape[m:]) @ impulse, impulse / h) * (1 + ROUNDED)
    return float(spread.max()), np.asarray(over @ spread * reach * (1 + ROUNDED))


def pulse_error(system: LinearSystem, fired: Array, h: float) -> tuple[float, Array]:
    """What pulses of the thrust `fired` (m,) add to inputs that are held for h [s], of the same impulse.

    An error of every input [N], and a displacement (n,) within a period, none at its ends (docs/theory.md,
    Lemma 36). Errors of the thrusters hold for a period. Raises what `jitter_error` does.
    """
    A, B, m = system.A, system.B, system.m
    each = (fired * scale for scale in (h / 8, h**2 / 32, h**3 / 62))
    speed, way, lasting = (part + system.thrusters.part(part) for part in each)
    inverse = _spreading(system, h, "thrusters.pulse", "centred")
    growth, bent = expm(np.abs(A) * h), A @ A @ B
    shape = np.abs(inverse @ bent) + h / 2 * np.abs(inverse) @ np.abs(A) @ growth @ np.abs(bent)
    spread = (shape[:m] + shape[m:]) @ lasting * (1 + ROUNDED)
    within = np.abs(B) @ speed + np.abs(A @ B) @ way + h * growth @ (np.abs(bent) @ way + np.abs(B) @ spread)
    return float(spread.max()), np.asarray(within * (1 + ROUNDED))


def _spreading(system: LinearSystem, h: float, field: str, given: object) -> Array:
    """Which inputs, constant and linear in time over a period of h [s], move the state at its middle."""
    A, B, n = system.A, system.B, system.n
    block = np.zeros((3 * n, 3 * n))
    block[:n, :n], block[:n, n : 2 * n], block[n : 2 * n, 2 * n :] = -A, np.eye(n), np.eye(n)
    once, twice = (expm(block * h)[:n, i * n : (i + 1) * n] for i in (1, 2))
    moments = expm(A * h / 2) @ np.hstack([once @ B, (once - 2 / h * twice) @ B])
    if np.linalg.matrix_rank(moments) < n:
        rule = "is not covered for a system with fewer inputs than half its states, or states that none moves"
        raise ScenarioError(field, given, rule)
    return np.linalg.pinv(moments)


def predicting(system: LinearSystem, timing: Timing, period: float | None) -> LinearSystem:
    """The system whose controllers act on predictions, of every age that may occur, with jitter or pulses.

    Raises
    ------
    ScenarioError
        If the system is so unstable that nothing bounds a prediction.
    """
    h, exact = period or 0.0, system.thrusters
    bit, moved = jitter_error(system, timing.jitter, h)
    if timing.carried:
        held = discretize(np.abs(system.A), np.abs(system.B), h)[1].sum(axis=1) / h
        moved = moved + held * timing.carried * (1 + ROUNDED)
    known = system.navigation + moved
    if timing.fired:
        bit, within = pulse_error(system, np.array(timing.fired), h)
        off = abs(timing.delay - h * round(timing.delay / h)) > ROUNDED / 2 * h  # measured between nodes
        known = known + within * (1.0 if off else AT_NODES * bool(timing.delay))
        moved, timing = moved + within, replace(timing, pulsed=tuple(within.tolist()))
    measured, displaced = tuple(system.navigation.tolist()), tuple(moved.tolist())
    longer = 2 * timing.jitter / h * (1 + ROUNDED) if timing.jitter > 0 else 0.0
    timing = replace(timing, bit=exact.bit, longer=longer, measured=measured, displaced=displaced, period=h)
    system = replace(system, timing=timing, thrusters=replace(exact, bit=exact.bit + bit))
    worst, ages = system.thrusters.error(system.u_max), timing.delay + h * np.arange(timing.missed + 1)
    try:
        errors = [prediction_error(system, known, worst, age) for age in ages.tolist()]
    except ReachError as error:
        rule = f"is too long for this system, a prediction over {ages[-1]:g} s has no bound: {error}"
        raise ScenarioError("timing.delay_s", timing.delay, rule) from error
    return replace(system, estimate_error=np.max(errors, axis=0))
