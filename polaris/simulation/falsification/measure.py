"""How far simulated runs stay from every limit, between the nodes too."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...model.system import Array
from ..run_metrics import Runs, cubic
from .claims import Claims

PARTS = 8
"""Parts of a period in which it is looked at closely."""

LOOKED_AT = 4
"""Periods of each run, those with the least margins at their ends, that are looked at so closely."""

EXACT_M = 1e-3
"""Length [m] by which simulated margins may fall short of proven ones: the integration's error."""

EXACT_INPUT = 1e-6
"""The same for inputs, as a share of their limits."""


@dataclass(frozen=True, eq=False)
class Attained:
    """Of R runs and every limit the least margin [m, N], when [s], and how far below what is proven.

    The margin is inf where a limit was never looked at (inputs if S never flies); `below` is the largest
    amount by which a margin fell short of the proven one of its period, negative if none did.
    """

    margin: Array
    when: Array
    below: Array


def attained(claims: Claims, runs: Runs) -> Attained:
    """Measure runs against the limits of a schedule."""
    system, shape = claims.system, (len(runs.states), len(claims.names))
    out = Attained(np.full(shape, np.inf), np.zeros(shape), np.full(shape, -np.inf))
    p = (runs.states @ system.position.T).reshape(-1, system.d).T
    smooth = not (np.any(system.position @ system.B) or np.any(system.position @ system.D))
    # How far a path may bow away from its chords, by the accelerations seen.
    change = np.abs(np.diff(runs.states @ system.velocity.T, axis=1)).max(axis=(1, 2), keepdims=True)[:, 0]
    bow = 2 * claims.h / 8 * np.sqrt(system.d) * change
    every = np.arange(shape[0])
    for o, u in enumerate(claims.unsafe):
        along = (u.normals @ p).reshape(-1, *runs.states.shape[:2])
        before, after = claims.offsets[o]
        at = np.max(along[:, :, :-1] - before.T[:, None], axis=0)
        ends = np.minimum(at, np.max(along[:, :, 1:] - after.T[:, None], axis=0))
        best = np.argmin(ends, axis=1)
        out.margin[:, o] = ends[every, best]
        out.when[:, o] = runs.times[np.where(at[every, best] <= ends[every, best], best, best + 1)]
        out.below[:, o] = np.max(claims.floor[:, o] - ends, axis=1)
        if smooth:
            few = min(LOOKED_AT, ends.shape[1])
            near = np.argpartition(ends, few - 1, axis=1)[:, :few]
            run, place = np.nonzero(np.take_along_axis(ends, near, axis=1) < out.margin[:, o, None] + bow)
            _look_closer(claims, runs, o, run, near[run, place], out)
    flown = np.flatnonzero(np.repeat(claims.modes == 0, claims.q))
    if len(flown):
        _measure_thrust(claims, runs, flown, out)
    return out


def _look_closer(
    claims: Claims, runs: Runs, o: int, run: NDArray[np.intp], period: NDArray[np.intp], out: Attained
) -> None:
    """Margins within some periods, along cubics through positions and velocities."""
    system, h, u = claims.system, claims.h, claims.unsafe[o]
    s = np.linspace(0, 1, PARTS + 1)[1:-1, None]
    ends = [runs.states[run, period + side][:, None] for side in (0, 1)]
    (a, b), (da, db) = ([part @ x.T for part in ends] for x in (system.position, h * system.velocity))
    p = cubic(a, b, da, db, s)
    left, right = (offsets[period][:, None] for offsets in claims.offsets[o])
    margin = np.max(p @ u.normals.T - ((1 - s) * left + s * right), axis=-1)
    best = np.argmin(margin, axis=1)
    least = margin[np.arange(len(margin)), best]
    order = np.argsort(-least)  # the least comes last and stays
    closer = order[least[order] < out.margin[run[order], o]]
    out.when[run[closer], o] = runs.times[period[closer]] + s[best[closer], 0] * h
    out.margin[run[closer], o] = least[closer]
    np.maximum.at(out.below[:, o], run, claims.floor[period, o] - least)


def _measure_thrust(claims: Claims, runs: Runs, flown: NDArray[np.intp], out: Attained) -> None:
    """Thrust left at the nodes of the periods that S flies."""
    safety, system = claims.schedule.safety, claims.system
    xi = safety.clearance.nodes[: claims.cells, :-1].reshape(-1, system.n)[flown]
    mu = np.repeat(safety.reference.nu[: claims.cells], claims.q, axis=0)[flown]
    left = system.u_max - np.abs(mu + (xi - runs.states[:, flown]) @ safety.tracking.gain.T)
    inputs = slice(len(claims.unsafe), None)
    out.margin[:, inputs] = left.min(axis=1)
    out.when[:, inputs] = runs.times[flown][np.argmin(left, axis=1)]
    out.below[:, inputs] = np.max(claims.floor[flown, inputs] - left, axis=1)
