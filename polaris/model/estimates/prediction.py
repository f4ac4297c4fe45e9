"""Bounds on errors of the state that flight software predicts, and on those by instants and pulses."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import expm

from reach.numerics.errors import ReachError
from reach.tubes.flow import LinearFlow

from ..craft import Array, Craft, lead_of
from ..errors import ScenarioError
from ..timing import WHOLE, Timing
from .observer import observing

PARTS = 32  # parts of a prediction over each of which integrals are bounded by the trapezoid rule

ROUNDED = 1e-9  # relative round-off of a bound, upwards

AT_NODES = 1e-6
"""Share of what pulses displace at most within a billionth of a period of its ends, where it is nothing."""

PLACES = {"": (8, 32, 62), "start": (4, 54, 96), "staggered": (4, 32, 62)}
"""By place of pulses, divisors of ``f h``, ``f h^2`` and ``f h^3`` that bound the impulse by which pulses of
thrust f differ from held inputs, its integral without the mean, and the integral of the size of that."""


def prediction_error(system: Craft, estimate: Array, thruster: Array, tau: float) -> Array:
    """Bound on the error of the state predicted over tau [s] from an estimate, shape (n,).

    The prediction follows the model under the commands in force, which are known: what is left is the error
    of the estimate (n,) carried along, the disturbance, and errors of what is applied (m,), each at its
    worst (docs/theory.md, Proposition 7 (a)). Rounded upwards; the estimate itself for tau = 0.
    """
    if not tau > 0:
        return estimate
    E = system.error_map(thruster)
    flow = LinearFlow.continuous(system.A, system.D, system.w_max, tau / PARTS, E)
    forced = flow.disturbance_support(np.eye(system.n), PARTS)[-1]
    carried = np.abs(np.linalg.matrix_power(flow.phi, PARTS)) @ estimate
    return np.asarray((carried + forced) * (1 + ROUNDED))


def prediction_gains(system: Craft, tau: float) -> Array:
    """Bound the error of a prediction over tau [s] per unit of the errors `entering`, shape (n, k)."""
    if not tau > 0:
        return np.zeros(system.entering.shape)
    flow = LinearFlow.continuous(system.A, system.D, system.w_max, tau / PARTS)
    gains = flow.input_gains(np.eye(system.n), system.entering, PARTS).sum(axis=0)
    return np.asarray(gains * (1 + 10 * ROUNDED))


def pulse_error(system: Craft, fired: Array, h: float) -> tuple[float, Array]:
    """Bound the errors of inputs held for h [s] by pulses of the thrust `fired` (m,), leads apart.

    Errors of the thrusters hold for a period.

    Returns
    -------
    error : float
        Of every input [N].
    within : ndarray, shape (n,)
        Displacement within a period, none at its ends.

    Raises
    ------
    ScenarioError
        If inputs that are linear in time cannot do that: too few of them for the states.
    """
    A, B, m = system.A, system.B, system.m
    each = (fired * (h**power / by) for power, by in enumerate(PLACES[system.timing.pulse_place], 1))
    push, path, abs_path = (part + system.thrusters.part(part) for part in each)
    inverse = _spreading(system, h)
    growth, AAB = expm(np.abs(A) * h), A @ A @ B
    shape = np.abs(inverse @ AAB) + h / 2 * np.abs(inverse) @ np.abs(A) @ growth @ np.abs(AAB)
    spread = (shape[:m] + shape[m:]) @ abs_path * (1 + ROUNDED)
    within = np.abs(B) @ push + np.abs(A @ B) @ path + h * growth @ (np.abs(AAB) @ path + np.abs(B) @ spread)
    rounding = float(np.finfo(float).eps * fired.max())  # where next to nothing is left of larger numbers
    return float(spread.max()) + rounding, np.asarray(within * (1 + ROUNDED))


def _spreading(system: Craft, h: float) -> Array:
    """Return the map from a change of the state in mid-period to inputs, constant and linear over h [s]."""
    A, B, n = system.A, system.B, system.n
    block = np.zeros((3 * n, 3 * n))
    block[:n, :n], block[:n, n : 2 * n], block[n : 2 * n, 2 * n :] = -A, np.eye(n), np.eye(n)
    once, twice = (expm(block * h)[:n, i * n : (i + 1) * n] for i in (1, 2))
    moments = expm(A * h / 2) @ np.hstack([once @ B, (once - 2 / h * twice) @ B])
    if np.linalg.matrix_rank(moments) < n:
        rule = "must be 'held', as the inputs are fewer than half the states, or do not move all states"
        raise ScenarioError("thrusters.pulse", system.timing.pulse_place or "centred", rule)
    return np.linalg.pinv(moments)


def add_pulses(timing: Timing, h: float, offset: Array) -> Array:
    """Add to displacements at nodes (n,) those by pulses of periods of h [s] when states are measured."""
    mid = abs(timing.delay - h * round(timing.delay / h)) > ROUNDED / 2 * h
    return np.asarray(
        offset + (1.0 if mid else AT_NODES * bool(timing.delay)) * np.array(timing.intersample_offset or 0.0)
    )


def predicting(system: Craft, timing: Timing, period: float | None) -> Craft:
    """The system whose controllers act on predictions, of every age that may occur, with jitter or pulses.

    Raises
    ------
    ScenarioError
        If the system is so unstable that nothing bounds a prediction.
    """
    h, exact = period or 0.0, system.thrusters
    jitter = 0.0 if timing.pulse_thrust or not timing.jitter else 2 * timing.jitter / h
    layout = None if system.nozzles is None else system.m
    thrusters, timing = exact.stretched(jitter, layout), replace(timing, on_time=exact, period=h)
    if jitter and layout:  # which make more than is commanded of what they have left
        thrusters = thrusters.raised(2 * jitter * timing.carried_impulse / h * (1 + ROUNDED))
    system = replace(system, timing=timing, thrusters=thrusters)
    measured_offset = state_offset = system.carry_offset + np.abs(system.B) @ system.shifted * (1 + ROUNDED)
    if timing.pulse_thrust:
        pulse_bit, within = pulse_error(system, np.array(timing.pulse_thrust), h)
        timing = replace(timing, intersample_offset=tuple(within.tolist()), lead=lead_of(system, h))
        measured_offset, state_offset = add_pulses(timing, h, state_offset), state_offset + within
        system = replace(system, thrusters=exact.raised(pulse_bit))
    timing = replace(timing, state_offset=tuple(state_offset.tolist()))
    system = replace(system, timing=timing)
    if system.observer is not None:  # of the motion under inputs that are held
        system = observing(system, system.observer, h, measured_offset)
    steps = system.navigation[None] if system.error_by_step is None else system.error_by_step
    timing = replace(timing, measured_error=tuple(np.max(steps, axis=0).tolist()))
    least, ages = system.thrusters.error(0 * system.u_max), timing.delay + h * np.arange(timing.missed + 1)
    hidden = int(np.ceil((ages[-1] / h) * (1 - WHOLE))) if h > 0 else 0
    older, full = _older(system, ages.tolist()), system.proportional_errors(system.u_max)
    steps = steps - (0.0 if system.observer is None else system.observer.by_command(full[: system.m]))
    starts, of_step = np.unique(steps + measured_offset, axis=0, return_inverse=True)
    idle = system if timing.lead is None else replace(system, timing=replace(timing, lead=timing.lead.least))
    try:
        errors = [[prediction_error(idle, each, least, age) for each in starts] for age in ages.tolist()]
        unseen = prediction_gains(system, ages[-1])
    except ReachError as error:
        rule = f"must be shorter: a prediction of this system over {ages[-1]:g} s has no bound ({error})"
        raise ScenarioError("timing.delay_s", timing.delay, rule) from error
    layers = [(hidden, unseen)] * (hidden > 0) + [(hidden + age, added) for age, added in older]
    bounds = np.max(errors, axis=0) + sum(added @ full for _, added in layers)
    nested = tuple((age, tuple(map(tuple, added.tolist()))) for age, added in layers)
    system = replace(system, timing=replace(timing, by_lag=nested))
    by_step = None if len(steps) == 1 else bounds[of_step.ravel()]
    return replace(system, estimate_error=np.max(bounds, axis=0), error_by_step=by_step)


def _older(system: Craft, ages: Sequence[float]) -> list[tuple[int, Array]]:
    """Return errors of an observer's predictions per thruster error of so many periods back, (n, k).

    By a unit of each thruster error, predicted over the one of some ages [s] that makes it largest.
    Leads of pulses add nothing: they are among the observer's own errors at full thrust.
    """
    if system.observer is None or system.observer.by_age is None:
        return []
    observer = system.observer
    carried = np.max([np.abs(expm(system.A * age)) for age in ages], axis=0) * (1 + ROUNDED)
    leads = np.zeros((system.n, system.entering.shape[1] - system.m))
    layers = zip(observer.ages[1:], observer.fallen, strict=True)
    return [(age, np.hstack([carried @ added, leads])) for age, added in layers]
