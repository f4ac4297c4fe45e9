"""How far simulated runs stay from every limit, between the nodes too."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..simulation import Runs
from ..system import Array
from .claims import Claims

PARTS = 8
"""Parts of a period in which it is looked at closely."""

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
    R = len(runs.states)
    system, q = claims.schedule.safety.problem.system, claims.schedule.safety.clearance.q
    inputs = system.m
    shape = R, len(claims.names)
    out = Attained(np.full(shape, np.inf), np.zeros(shape), np.full(shape, -np.inf))
    p = runs.states @ system.position.T
    per_cell = np.arange(claims.cells)[:, None] * q + np.arange(q + 1)
    floor = claims.floor.reshape(-1, len(claims.names))
    smooth = not (np.any(system.position @ system.B) or np.any(system.position @ system.D))
    bow = _bow(claims, runs) if smooth else None
    for o, u in enumerate(claims.unsafe):
        along = p @ u.normals.T
        at = np.max(along[:, per_cell] - claims.offsets[o], axis=-1)  # (R, cells, q+1)
        ends = np.minimum(at[..., :-1], at[..., 1:]).reshape(R, -1)
        _take(out, o, ends, at.reshape(R, claims.cells, q + 1), runs, q)
        out.below[:, o] = np.max(floor[:, o] - ends, axis=1)
        if bow is None:
            continue
        run, period = np.nonzero(ends - bow < out.margin[:, o, None])
        if len(run):
            _closer(claims, runs, o, run, period, out)
    flown = np.flatnonzero(np.repeat(claims.modes == 0, q))
    if len(flown):
        out.margin[:, -inputs:], out.when[:, -inputs:], short = _thrust(claims, runs, flown, floor)
        out.below[:, -inputs:] = short
    return out


def _take(out: Attained, o: int, ends: Array, at: Array, runs: Runs, q: int) -> None:
    """Least margin at the nodes, and when."""
    flat = at.reshape(len(at), -1)
    best = np.argmin(flat, axis=1)
    out.margin[:, o] = flat[np.arange(len(flat)), best]
    cell, node = np.divmod(best, q + 1)
    out.when[:, o] = runs.times[cell * q + node]


def _bow(claims: Claims, runs: Runs) -> Array:
    """How far a path may bow away from its chords, by the accelerations seen, shape (R, periods)."""
    system, h = claims.schedule.safety.problem.system, claims.schedule.safety.tracking.flow.h
    v = runs.states @ system.velocity.T
    change = np.linalg.norm(np.diff(v, axis=1), axis=-1)
    spread = np.maximum(np.pad(change, ((0, 0), (1, 0)))[:, :-1], change)
    return np.asarray(h / 8 * np.maximum(spread, np.pad(change, ((0, 0), (0, 1)))[:, 1:]))


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
