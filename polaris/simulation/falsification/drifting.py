"""Attacks on passive safety: all thrust stops in simulated runs, and the disturbance drives the drift."""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from reach.numerics.linear import powers

from ...model.system import Array, LinearSystem
from ...synthesis.passive import PassiveSafety
from ..run_metrics import Runs
from .claims import EXACT_M
from .violations import Failure

STOPS = 64  # instants at which thrust stops that are looked at in each batch of runs


def stopped(
    passive: PassiveSafety, runs: Runs, rng: np.random.Generator, stops: int = STOPS
) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
    """Runs, and nodes of steps that are clear, at which thrust stops, each (stops,)."""
    nodes, run = len(runs.inputs[0]) // len(runs.modes), rng.integers(0, len(runs.states), stops)
    steps = rng.choice(np.flatnonzero(passive.clear), stops)
    return run, np.asarray(steps * nodes + rng.integers(0, nodes + 1, stops))


def drifted(
    passive: PassiveSafety, runs: Runs, run: NDArray[np.int_], node: NDArray[np.int_]
) -> tuple[Failure | None, int]:
    """The worst violation of what is claimed of the drift after all thrust stops; and which run it is."""
    assert passive.least is not None
    margin = least_distances(passive, runs, run, node)
    stop, o = np.unravel_index(int(margin.argmin()), margin.shape)
    found = float(runs.times[node[stop]]), float(margin[stop, o]), passive.least
    broken = found[1] < passive.least - EXACT_M
    return Failure("drift", passive.flight.sets[o].name, *found) if broken else None, int(run[stop])


def least_distances(
    passive: PassiveSafety, runs: Runs, run: NDArray[np.int_], node: NDArray[np.int_]
) -> Array:
    """Least distance [m] of drifts from each unsafe set, thrust stopping at nodes of runs, (stops, sets).

    At every instant of the drift the disturbance has done all it can against the facet that keeps the drift
    furthest away.
    """
    flight, h = passive.flight, runs.times[1]
    out = np.empty((len(run), len(flight.sets)))
    ahead = np.arange(flight.abort.horizon / flight.delta * flight.parts + 1e-9) * flight.delta / flight.parts
    moved = powers(expm(flight.system.A * flight.delta / flight.parts), len(ahead) - 1)
    position = flight.system.position @ moved
    place = np.einsum("jdn,sn->sjd", position, runs.states[run, node])
    for o, item in enumerate(flight.sets):
        offsets = item.at(node[:, None] * h + ahead, flight.delta)
        pushed = _pushes(flight.system, item.normals, position, ahead)
        best = (place @ item.normals.T - offsets).argmax(axis=-1)
        hit = place + pushed[best, np.arange(len(ahead))]
        out[:, o] = (hit @ item.normals.T - offsets).max(axis=-1).min(axis=1)
    return out


def _pushes(system: LinearSystem, normals: Array, position: Array, ahead: Array) -> Array:
    """How far the disturbance takes the position against each normal by each instant, shape (F, J, d)."""
    kicks = position @ system.D
    ways = np.einsum("fd,jdp->fjp", normals, kicks)
    ways = ways / np.maximum(np.linalg.norm(ways, axis=-1, keepdims=True), 1e-300)
    rate = -system.w_max * np.einsum("jdp,fjp->fjd", kicks, ways)
    gained = (rate[:, 1:] + rate[:, :-1]) / 2 * np.diff(ahead)[:, None]
    return np.concatenate([np.zeros_like(rate[:, :1]), np.cumsum(gained, axis=1)], axis=1)
