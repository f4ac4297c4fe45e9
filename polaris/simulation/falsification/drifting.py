"""Attacks on passive safety: all thrust stops in simulated runs, and the disturbance drives the drift."""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from reach.numerics.linear import powers

from ...model.system import Array, LinearSystem
from ...synthesis.passive import PassiveSafety
from ..run_metrics import Runs

STOPS = 64  # instants at which thrust stops that are looked at in each batch of runs


def least_distances(
    passive: PassiveSafety, runs: Runs, nodes: int, rng: np.random.Generator, stops: int = STOPS
) -> tuple[Array, NDArray[np.int_], Array]:
    """Least distance of drifts from each unsafe set, thrust stopping at random nodes of clear steps.

    At every instant of the drift the disturbance has done all it can against the facet that keeps the drift
    furthest away. `nodes` is the number of periods per step. Distances (stops, sets) [m], inf without a step
    that is clear; of which run, and when thrust stops [s], each (stops,).
    """
    flight = passive.flight
    steps, h = np.flatnonzero(passive.clear), flight.delta / nodes
    run = rng.integers(0, len(runs.states), stops)
    out = np.full((stops, len(flight.sets)), np.inf)
    if not len(steps):
        return out, run, np.zeros(stops)
    node = rng.choice(steps, stops) * nodes + rng.integers(0, nodes + 1, stops)
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
    return out, run, np.asarray(node * h, dtype=float)


def _pushes(system: LinearSystem, normals: Array, position: Array, ahead: Array) -> Array:
    """How far the disturbance takes the position against each normal by each instant, shape (F, J, d)."""
    kicks = position @ system.D
    ways = np.einsum("fd,jdp->fjp", normals, kicks)
    ways = ways / np.maximum(np.linalg.norm(ways, axis=-1, keepdims=True), 1e-300)
    rate = -system.w_max * np.einsum("jdp,fjp->fjd", kicks, ways)
    gained = (rate[:, 1:] + rate[:, :-1]) / 2 * np.diff(ahead)[:, None]
    return np.concatenate([np.zeros_like(rate[:, :1]), np.cumsum(gained, axis=1)], axis=1)
