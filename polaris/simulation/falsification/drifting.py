"""Attacks on passive safety: all thrust stops in simulated runs, and the disturbance drives the drift."""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from reach.numerics.linear import powers

from ...model.system import Array, LinearSystem
from ...synthesis.safety.passive import PassiveSafety
from ..run_metrics import Runs
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
) -> tuple[Failure, int]:
    """Return the drift that comes closest to an unsafe set, thrust stopping at nodes of runs; and its run.

    At every instant of the drift the disturbance has done all it can against the facet that keeps the drift
    furthest away. A margin that is not below the proven one is no violation.
    """
    flight, h = passive.flight, runs.times[1]
    out = np.empty((len(run), len(flight.sets)))
    times = np.arange(flight.abort.horizon / flight.delta * flight.parts + 1e-9) * flight.delta / flight.parts
    transitions = powers(expm(flight.system.A * flight.delta / flight.parts), len(times) - 1)
    place = np.einsum("jin,sn->sji", transitions, runs.states[run, node])
    for o, item in enumerate(flight.sets):
        offsets = item.offsets_at(node[:, None] * h + times, flight.delta)
        rows = item.rows(flight.system)
        pushes = _pushes(flight.system, rows, transitions, times)
        facet = (place @ rows.T - offsets).argmax(axis=-1)
        hit = place + pushes[facet, np.arange(len(times))]
        out[:, o] = (hit @ rows.T - offsets).max(axis=-1).min(axis=1)
    stop, set_index = np.unravel_index(int(out.argmin()), out.shape)
    values = float(runs.times[node[stop]]), float(out.min()), passive.least or 0.0
    return Failure("drift", flight.sets[set_index].name, *values), int(run[stop])


def _pushes(system: LinearSystem, rows: Array, transitions: Array, times: Array) -> Array:
    """Return the largest displacement along each row by disturbance and constant, (F, J, n)."""
    kicks = transitions @ system.D
    ways = np.einsum("fi,jip->fjp", rows, kicks)
    ways = ways / np.maximum(np.linalg.norm(ways, axis=-1, keepdims=True), 1e-300)
    rate = -system.w_max * np.einsum("jip,fjp->jfi", kicks, ways)
    forced, constant = _integrated(rate, times), _integrated(transitions @ system.biases, times)
    signs = np.sign(np.einsum("fi,jic->jfc", rows, constant))
    return np.asarray((forced - np.einsum("jfc,jic->jfi", signs, constant)).swapaxes(0, 1))


def _integrated(rate: Array, times: Array) -> Array:
    """Integral of rates (J, ...) until each instant, by the trapezoid rule."""
    increments = ((rate[1:] + rate[:-1]).T / 2 * np.diff(times)).T
    return np.concatenate([np.zeros_like(rate[:1]), np.cumsum(increments, axis=0)])
