"""How far simulated runs stay from every limit, between the nodes too."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...model.system import Array
from ..run_metrics import Runs
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
    """Least margins of runs.

    Attributes
    ----------
    margin : ndarray, shape (R, limits)
        Least margin [m, N] over the flight; inf where a limit was never looked at (inputs if S never flies).
    when : ndarray, shape (R, limits)
        At what time [s].
    below : ndarray, shape (R, limits)
        Largest amount by which a margin fell short of the proven one of its period; negative if none did.
    """

    margin: Array
    when: Array
    below: Array


def attained(claims: Claims, runs: Runs) -> Attained:
    """Measure runs against the limits of a schedule."""
    system, q = claims.schedule.safety.problem.system, claims.schedule.safety.clearance.q
    shape = len(runs.states), len(claims.names)
    out = Attained(np.full(shape, np.inf), np.zeros(shape), np.full(shape, -np.inf))
    p = (runs.states @ system.position.T).reshape(-1, system.d).T
    floor = claims.floor.reshape(-1, len(claims.names))
    smooth = not (np.any(system.position @ system.B) or np.any(system.position @ system.D))
    bow = _bow(claims, runs)[:, None] if smooth else None
    every = np.arange(shape[0])
    for o, u in enumerate(claims.unsafe):
        along = (u.normals @ p).reshape(-1, *runs.states.shape[:2])
        before, after = claims.edges(o)
        at = np.max(along[:, :, :-1] - before.T[:, None], axis=0)
        ends = np.minimum(at, np.max(along[:, :, 1:] - after.T[:, None], axis=0))
        best = np.argmin(ends, axis=1)
        out.margin[:, o] = ends[every, best]
        out.when[:, o] = runs.times[np.where(at[every, best] <= ends[every, best], best, best + 1)]
        out.below[:, o] = np.max(floor[:, o] - ends, axis=1)
        if bow is not None:
            few = min(LOOKED_AT, ends.shape[1])
            near = np.argpartition(ends, few - 1, axis=1)[:, :few]
            run, place = np.nonzero(np.take_along_axis(ends, near, axis=1) < out.margin[:, o, None] + bow)
            _closer(claims, runs, o, run, near[run, place], out)
    flown = np.flatnonzero(np.repeat(claims.modes == 0, q))
    if len(flown):
        inputs = slice(-system.m, None)
        out.margin[:, inputs], out.when[:, inputs], out.below[:, inputs] = _thrust(claims, runs, flown, floor)
    return out


def _bow(claims: Claims, runs: Runs) -> Array:
    """How far a path may bow away from its chords, by the accelerations seen, shape (R,)."""
    system, h = claims.schedule.safety.problem.system, claims.schedule.safety.tracking.flow.h
    change = np.abs(np.diff(runs.states @ system.velocity.T, axis=1)).max(axis=(1, 2))
    return np.asarray(2 * h / 8 * np.sqrt(system.d) * change)


def _closer(
    claims: Claims,
    runs: Runs,
    o: int,
    run: NDArray[np.intp],
    period: NDArray[np.intp],
    out: Attained,
) -> None:
    """Margins within some periods, along cubics through positions and velocities."""
    system, q = claims.schedule.safety.problem.system, claims.schedule.safety.clearance.q
    h = claims.schedule.safety.tracking.flow.h
    u = claims.unsafe[o]
    s = np.linspace(0, 1, PARTS + 1)[1:-1]
    ends = [runs.states[run, period + side] for side in (0, 1)]
    places = [(x @ system.position.T)[:, None] for x in ends]
    slopes = [(h * x @ system.velocity.T)[:, None] for x in ends]
    a, b = s[:, None], 1 - s[:, None]
    p = b**2 * ((1 + 2 * a) * places[0] + a * slopes[0]) + a**2 * ((3 - 2 * a) * places[1] - b * slopes[1])
    cell, node = np.divmod(period, q)
    left, right = (claims.offsets[o][cell, node + side][:, None] for side in (0, 1))
    margin = np.max(p @ u.normals.T - (b * left + a * right), axis=-1)
    best = np.argmin(margin, axis=1)
    least = margin[np.arange(len(margin)), best]
    order = np.argsort(-least)  # the least comes last and stays
    closer = order[least[order] < out.margin[run[order], o]]
    out.when[run[closer], o] = runs.times[period[closer]] + s[best[closer]] * h
    out.margin[run[closer], o] = least[closer]
    floor = claims.floor.reshape(-1, len(claims.names))[period, o]
    np.maximum.at(out.below[:, o], run, floor - least)


def _thrust(claims: Claims, runs: Runs, flown: NDArray[np.intp], floor: Array) -> tuple[Array, Array, Array]:
    """Thrust left at the nodes while S flies: least, when, and by how much less than proven."""
    safety = claims.schedule.safety
    q, system = safety.clearance.q, safety.problem.system
    xi = safety.clearance.nodes[: claims.cells, :-1].reshape(-1, system.n)[flown]
    mu = np.repeat(safety.reference.nu[: claims.cells], q, axis=0)[flown]
    raw = mu + (xi - runs.states[:, flown]) @ safety.tracking.gain.T
    left = system.u_max - np.abs(raw)
    best = np.argmin(left, axis=1)
    margin = np.take_along_axis(left, best[:, None], axis=1)[:, 0]
    short = np.max(floor[flown][:, -system.m :] - left, axis=1)
    return margin, runs.times[flown][best], short
