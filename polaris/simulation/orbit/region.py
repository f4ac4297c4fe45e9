"""The states that a mission visits, as boxes per step: the domain of the bound on the model error."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from reach.numerics.linear import growth, powers
from reach.sets.zonotope import Zonotope

from ...model.scene.satellite import SatelliteObstacle
from ...model.system import Array, LinearSystem
from ...synthesis.safety.carried_rows import error_tube
from ...synthesis.safety.get_safety import Safety
from ...synthesis.schedule.schedule import Schedule
from ...synthesis.tracker.intersample import at_nodes


@dataclass(frozen=True, eq=False)
class Region:
    """Boxes (N, 6) [m, m/s] of states in Hill's frame, who is there, and since when [s], for N stretches."""

    names: tuple[str, ...]
    start: Array
    lower: Array
    upper: Array

    @classmethod
    def join(cls, parts: Sequence["Region"]) -> "Region":
        """All boxes of several regions."""
        return cls(
            tuple(name for part in parts for name in part.names),
            np.concatenate([part.start for part in parts]),
            np.concatenate([part.lower for part in parts]),
            np.concatenate([part.upper for part in parts]),
        )

    @property
    def extent(self) -> tuple[Array, Array, Array]:
        """Bounds on ``|r_x|``, ``norm(r)`` [m] and ``norm(v)`` [m/s] in every box."""
        far = np.maximum(np.abs(self.lower), np.abs(self.upper))
        return far[:, 0], np.linalg.norm(far[:, :3], axis=1), np.linalg.norm(far[:, 3:], axis=1)


def visited(schedule: Schedule) -> Region:
    """Return the region that the claims about a schedule cover.

    The tubes of the schedule, of S alone from the whole initial set, and of S after T along the
    coasting tail.
    """
    safety = schedule.safety
    K, delta = safety.problem.K, safety.problem.delta
    curve = _curve(safety)
    lower, upper = [], []
    for k, step in enumerate(schedule.steps):
        intersample = at_nodes(step.tube.intersample) + at_nodes(curve[k])
        middle = safety.clearance.nodes[k] + step.tube.nodes.c
        width = step.tube.nodes.half_widths + intersample + safety.problem.system.state_offset
        lower.append((middle - width).min(axis=0))
        upper.append((middle + width).max(axis=0))
    names = tuple(schedule.controllers[int(mode)].name for mode in schedule.modes)
    scheduled = Region(names, _times(0, K, delta), np.array(lower), np.array(upper))
    under_s = _under_s(safety, safety.start, 0, curve)
    parts = [scheduled, under_s]
    if safety.reference.cells > K:
        at_end = safety.clearance.after_jump(schedule.final)
        parts.append(_under_s(safety, at_end, K, curve))
    return Region.join(parts)


def _curve(safety: Safety) -> Array:
    """Intersample bound of the reference, shape (cells, q, n)."""
    rates = safety.reference.rates(safety.clearance.nodes)
    return np.asarray(safety.tracking.flow.h**2 / 8 * rates @ np.abs(safety.problem.system.A).T)


def _under_s(safety: Safety, start: Zonotope, first: int, curve: Array) -> Region:
    """Return the reference from a cell on, with S's tube from a set of errors there; later turns included."""
    tracking, q = safety.tracking, safety.clearance.q
    cells = safety.reference.cells - first
    eye = np.eye(tracking.system.n)
    tube = error_tube(tracking, start, np.vstack([eye, -eye]))
    tightening = np.maximum(tube.over_cells(cells, q), tube.tightening[-1])
    tightening = tightening + safety.clearance.scheduled(tube.table.rows)[first:].max(axis=1)
    nodes, intersample = safety.clearance.nodes[first:], curve[first:].max(axis=1)
    n, tightening = tracking.system.n, tightening + np.tile(tracking.system.state_offset, 2)
    return Region(
        ("safety",) * cells,
        _times(first, cells, tracking.delta),
        nodes.min(axis=1) - intersample - tightening[:, n:],
        nodes.max(axis=1) + intersample + tightening[:, :n],
    )


def satellite_region(satellite: SatelliteObstacle, system: LinearSystem, delta: float, cells: int) -> Region:
    """Return the region where another satellite may be, by the knowledge of it, for so many cells."""
    carried = powers(expm(system.A * delta), cells - 1)
    middle = carried @ np.asarray(satellite.state)
    exp_bound = growth(system.A, delta)
    # What an acceleration adds by the end of a cell, then carried on: summed over the cells passed.
    push = (
        delta
        * exp_bound
        @ sum((np.abs(M).sum(axis=1) * bound for M, bound in satellite.pushes(system)), np.zeros(system.n))
    )
    added = np.abs(carried) @ push
    reached = np.concatenate([np.zeros((1, system.n)), np.cumsum(added, axis=0)[:-1]])
    width = np.abs(carried) @ np.asarray(satellite.state_half_widths) + reached
    drift = (np.abs(middle) + width) @ (exp_bound - np.eye(system.n)).T + push
    names = (satellite.name,) * cells
    return Region(names, _times(0, cells, delta), middle - width - drift, middle + width + drift)


def _times(first: int, cells: int, delta: float) -> Array:
    """Start of each of some cells [s]."""
    return np.asarray((first + np.arange(cells)) * delta, dtype=float)
