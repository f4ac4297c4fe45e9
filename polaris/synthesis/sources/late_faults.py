"""Additions of wrong thrust to the loop state until it is isolated (docs/theory.md, Proposition 8)."""

from math import ceil

import numpy as np

from reach.numerics.linear import discretize, growth, powers

from ...model.craft import Array, Craft
from ...model.timing import WHOLE, Transient
from ...model.tolerances import ROUNDING
from ..tracker.channel import row_integral
from ..tracker.loop import Loop
from .source import remembers


def touched(seconds: float, h: float) -> int:
    """Return the largest number of periods of h [s] that a time [s] touches which ends at a node."""
    return ceil(seconds / h * (1 - WHOLE))


def wrong_thrust(system: Craft, fault: Transient, gain: Array, loop: Loop) -> Array:
    """Bound the effect of wrong thrust on the loop state until S flies, under any law, shape (J, N).

    One row for each kind of wrong thrust. Commands that are made without the thruster take effect as late as
    any do. Where a box stands for estimates, commands that do not know of it go on for as long as estimates
    are late.
    """
    lasts = fault.lasts + system.timing.jitter + system.timing.edge
    count = touched(lasts, loop.h)
    spans = [lasts - (count - 1) * loop.h] + [loop.h] * (count - 1)
    late = 0 if remembers(system) else _late(system, loop.h)
    added = _added(system, fault, loop, spans + [0.0] * late, gain)[count:].max(axis=0)
    if fault.after > 0:  # meanwhile nobody's answer counts
        longer = spans + [loop.h] * (touched(fault.after, loop.h) + _late(system, loop.h))
        added = np.maximum(added, _added(system, fault, loop, longer)[-1])
    return np.asarray(added)


def undetected(system: Craft, gain: Array, h: float) -> Array:
    """Bound the effect of wrong thrust on the states until predictions know of it, shape (n,)."""
    loop, spans = Loop.from_plant(system.A, system.B, h), [h] * _late(system, h)
    faults = (fault for fault in system.transients if len(fault.thrust))
    added = (_added(system, fault, loop, spans, gain)[-1].max(axis=0) for fault in faults)
    return np.asarray(np.max([np.zeros(system.n), *added], axis=0))


def _late(system: Craft, h: float) -> int:
    """Return the number of periods before a command in which additions may be unknown."""
    return touched(system.timing.delay, h) + system.timing.missed


def _added(
    system: Craft, fault: Transient, loop: Loop, spans: list[float], gain: Array | None = None
) -> Array:
    """Bound the effect of a fault on the loop state by the end of each period, shape (periods + 1, J, N).

    Parameters
    ----------
    spans : list of float
        For how long [s] thrust is wrong in each period, up to its end.
    gain : ndarray, shape (m, n), optional
        Of S. Every law answers with no more than the largest gain times its input, and with no more than
        twice the limits; a network also with its derivative, a black box with the limits alone. Without it
        nobody answers.
    """
    n, N, h, limits, wrong = loop.n, loop.N, loop.h, 2 * system.u_max, fault.wrong(system.thrusters)
    shares, lead = system.thrusters.table(loop.m).T, system.timing.lead  # errors of the answers
    led = None if lead is None else np.array(lead.shares).T
    steep = None if gain is None else np.maximum(fault.gains, np.abs(gain))
    if steep is not None and fault.networks is not None:
        steep = np.maximum(steep, fault.networks)
    rows = np.vstack([np.eye(N), loop.sensed]) @ powers(
        loop.close(np.zeros((loop.m, n))).open_transition, len(spans)
    )
    enter = {length: _entering(loop, rows, length, loop.B) for length in {h, *spans}}
    held_map, growths, within = np.abs(rows @ loop.held), growth(loop.A, h), _within(loop, loop.B)
    lead_maps = (
        None if led is None else (_entering(loop, rows, h, loop.A @ loop.B), _within(loop, loop.A @ loop.B))
    )
    nodes, bounds = np.zeros((len(spans) + 1, len(wrong), N + n)), np.zeros((len(spans) + 1, len(wrong), N))
    for i, length in enumerate(spans):
        answer = np.zeros_like(wrong)
        if i and steep is not None:
            answer = np.tile(limits, (len(wrong), 1))
            if not fault.boxes:
                answer = np.minimum(nodes[i, :, N:] @ steep.T, answer)
        error, push = answer @ shares, wrong * (length > 0)
        ages = slice(0, len(spans) - i)
        added = held_map[ages] @ answer.T + enter[h][ages] @ error.T + enter[length][ages] @ push.T
        plant = nodes[i, :, :n] @ growths.T + (answer + error + push) @ within.T
        if led is not None and lead_maps is not None:
            added = added + lead_maps[0][ages] @ (answer @ led).T
            plant = plant + answer @ led @ lead_maps[1].T
        nodes[i + 1 :] += added.transpose(0, 2, 1) * (1 + ROUNDING)
        bounds[i + 1] = nodes[i + 1, :, :N]
        bounds[i + 1, :, :n] = np.maximum(bounds[i + 1, :, :n], plant)  # at any instant of a period
    return bounds


def _entering(loop: Loop, rows: Array, length: float, M: Array) -> Array:
    """Bound the effect of unit rates M (n, m) in the last `length` [s] on rows (..., N), shape (..., m)."""
    added, begins = np.zeros((*rows.shape[:-1], loop.m)), loop.h - length
    for a, b, E in loop.enter:
        if b > begins:
            added += row_integral(rows @ E, loop.A, M, loop.h, (max(a, begins), b), False)
    return added


def _within(loop: Loop, M: Array) -> Array:
    """Bound the effect of unit rates M (n, m) on the plant's states within a period, shape (n, m)."""
    return discretize(np.abs(loop.A), np.abs(M), loop.h)[1] * (1 + ROUNDING)
