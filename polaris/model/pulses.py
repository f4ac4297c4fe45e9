"""Pulses of thrust, and what they do to a craft beside inputs that are held (docs/theory.md, Lemma 6 (b))."""

from typing import Any

import numpy as np
from scipy.linalg import expm

from .craft import Craft
from .errors import ScenarioError
from .lead import Lead
from .system import Array

ROUNDED = 1e-9  # relative round-off of a bound, upwards

PLACES = {"": (8, 32, 62), "start": (4, 54, 96), "staggered": (4, 32, 62)}
"""By place of pulses, divisors of ``f h``, ``f h^2`` and ``f h^3`` that bound the impulse by which pulses of
thrust f differ from held inputs, its integral without the mean, and the integral of the size of that."""


def lead_of(system: Craft, h: float) -> Lead | None:
    """Return the leads of a craft's pulses with a period of h [s]; None if its pulses are centred.

    A pulse of thrust f that takes the share g of a period leads by at most ``h/2 f g (1 - g)``.
    """
    timing, errors, layout, m = system.timing, system.on_time, system.nozzles, system.m
    if not timing.placed:
        return None
    fired = np.array(timing.fired)
    if layout is None:
        shares = np.eye(m) + errors.table(m)
        fixed = shares.sum(axis=1) * timing.carried / h + errors.bit
    else:
        made = layout.allocation
        side = np.max(np.abs(made.directions) / made.lengths[:, None], axis=0)
        shares = (np.outer(side, layout.weights) + layout.bounds[:-1]) / (1 - layout.mass)
        left = layout.bit / h * layout.carried
        fixed = left * made.at_once(np.abs(made.directions)) + errors.bit
    most = h / 8 * (fired + errors.part(fired)) - h / 2 * fixed
    sizes = h / 2 * shares, h / 2 * fixed, np.maximum(most, 0.0)
    return Lead(*(_as_tuples(size * (1 + ROUNDED)) for size in sizes))


def _as_tuples(values: Array) -> tuple[Any, ...]:
    each = values.tolist()
    return tuple(tuple(row) if isinstance(row, list) else row for row in each)


def pulse_error(system: Craft, fired: Array, h: float) -> tuple[float, Array]:
    """Bound what pulses of the thrust `fired` (m,) add to inputs held for h [s], leads apart.

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
    each = (fired * (h**power / by) for power, by in enumerate(PLACES[system.timing.placed], 1))
    speed, way, lasting = (part + system.thrusters.part(part) for part in each)
    inverse = _spreading(system, h)
    growth, bent = expm(np.abs(A) * h), A @ A @ B
    shape = np.abs(inverse @ bent) + h / 2 * np.abs(inverse) @ np.abs(A) @ growth @ np.abs(bent)
    spread = (shape[:m] + shape[m:]) @ lasting * (1 + ROUNDED)
    within = np.abs(B) @ speed + np.abs(A @ B) @ way + h * growth @ (np.abs(bent) @ way + np.abs(B) @ spread)
    rounding = float(np.finfo(float).eps * fired.max())  # where next to nothing is left of larger numbers
    return float(spread.max()) + rounding, np.asarray(within * (1 + ROUNDED))


def _spreading(system: Craft, h: float) -> Array:
    """Which inputs, constant and linear in time over a period of h [s], move the state at its middle."""
    A, B, n = system.A, system.B, system.n
    block = np.zeros((3 * n, 3 * n))
    block[:n, :n], block[:n, n : 2 * n], block[n : 2 * n, 2 * n :] = -A, np.eye(n), np.eye(n)
    once, twice = (expm(block * h)[:n, i * n : (i + 1) * n] for i in (1, 2))
    moments = expm(A * h / 2) @ np.hstack([once @ B, (once - 2 / h * twice) @ B])
    if np.linalg.matrix_rank(moments) < n:
        rule = "is not covered for a system with fewer inputs than half its states, or states that none moves"
        raise ScenarioError("thrusters.pulse", system.timing.placed or "centred", rule)
    return np.linalg.pinv(moments)
