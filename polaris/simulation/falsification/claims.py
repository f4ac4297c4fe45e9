"""What a schedule's proof promises at every instant: the margins that no run may go below."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from reach.sets.zonotope import Zonotope

from ...model.system import Array
from ...model.timed_polytope import TimedPolytope
from ...synthesis.clearance import error_tube, facet_room
from ...synthesis.schedule import Schedule


@dataclass(frozen=True, eq=False)
class Claims:
    """Proven margins of one schedule, period by period.

    The limits are the timed polytopes, one each (margin in m: how far outside the best facet), and then
    the inputs, one each (margin in N: thrust left while S flies).

    Attributes
    ----------
    schedule : Schedule
    tail : bool
        Whether S's flight after T is included.
    """

    schedule: Schedule
    tail: bool

    @property
    def cells(self) -> int:
        """Number of cells that are looked at."""
        safety = self.schedule.safety
        return safety.reference.cells if self.tail else safety.problem.K

    @property
    def proved(self) -> bool:
        """Whether anything is claimed at all."""
        return self.schedule.guarantee == "proved"

    @property
    def unsafe(self) -> tuple[TimedPolytope, ...]:
        """The timed polytopes."""
        return self.schedule.safety.clearance.unsafe

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the limits."""
        return (*(u.name for u in self.unsafe), *self.schedule.safety.problem.system.input_names)

    @cached_property
    def modes(self) -> NDArray[np.int_]:
        """Mode of every cell, S after T."""
        return np.append(self.schedule.modes, np.zeros(self.cells - len(self.schedule.modes), dtype=int))

    @cached_property
    def offsets(self) -> list[Array]:
        """Offsets of every polytope at the nodes of every cell, (cells, q+1, F) each [m]."""
        q = self.schedule.safety.clearance.q
        return [u.fine(q)[: self.cells] for u in self.unsafe]

    def edges(self, unsafe: int) -> tuple[Array, Array]:
        """Offsets of a polytope at the beginning and the end of every period, (periods, F) each [m]."""
        offsets = self.offsets[unsafe]
        facets = offsets.shape[-1]
        return offsets[:, :-1].reshape(-1, facets), offsets[:, 1:].reshape(-1, facets)

    @cached_property
    def facets(self) -> list[Array]:
        """Lower bounds on the margin of every facet over each period, (cells, q, F) each [m]."""
        safety = self.schedule.safety
        out = []
        for u in self.unsafe:
            rows = -u.normals @ safety.problem.system.position
            room = facet_room(safety.tracking, safety.reference, u, safety.clearance.q)[: self.cells]
            need, bow = self._needs(rows)
            left = room - need
            out.append(np.minimum(left[:, :-1], left[:, 1:]) - bow)
        return out

    @cached_property
    def floor(self) -> Array:
        """Proven margin of every limit over each period, (cells, q, limits); -inf where there is none.

        While S flies no margin can be negative, whatever its tube shows: S took over from a recoverable set.
        """
        safety = self.schedule.safety
        q, system = safety.clearance.q, safety.problem.system
        parts = [part.max(axis=2) for part in self.facets]
        gain = safety.tracking.gain
        need, bow = self._needs(np.vstack([gain, -gain]))
        nu = safety.reference.nu[: self.cells]
        room = np.tile(system.u_max, 2) + np.hstack([nu, -nu])
        left = np.min((room[:, None, :] - need).reshape(self.cells, q + 1, 2, system.m), axis=2)
        thrust = np.minimum(left[:, :-1], left[:, 1:]) - np.max(bow.reshape(self.cells, q, 2, -1), axis=2)
        floor = np.concatenate([np.stack(parts, axis=-1), thrust], axis=-1)
        under_s = (self.modes == 0)[:, None, None]
        floor = np.where(under_s, np.maximum(floor, 0.0), floor)
        floor[self.modes != 0, :, len(parts) :] = -np.inf  # what U demands is limited by its own model alone
        return floor if self.proved else np.full(floor.shape, -np.inf)

    def _needs(self, rows: Array) -> tuple[Array, Array]:
        """Largest ``row e`` at the nodes (cells, q+1, r), and what may be added between (cells, q, r)."""
        safety = self.schedule.safety
        K, q = safety.problem.K, safety.clearance.q
        need = np.empty((self.cells, q + 1, len(rows)))
        bow = np.zeros((self.cells, q, len(rows)))
        for k, step in enumerate(self.schedule.steps):
            need[k] = support(step.tube.nodes, rows)
            bow[k] = step.tube.bow @ np.abs(rows).T
        if self.cells > K:
            at_end = self.schedule.final.inflate(safety.clearance.jump)
            tube = error_tube(safety.tracking, at_end, rows).need
            lag = np.arange(self.cells - K)[:, None] * q + np.arange(q + 1)
            need[K:] = tube[np.minimum(lag, len(tube) - 1)]
        return need, bow

    def period_at(self, time: Array) -> NDArray[np.int_]:
        """Number of the period that holds instants [s]."""
        h, last = self.schedule.safety.tracking.flow.h, self.cells * self.schedule.safety.clearance.q - 1
        return np.asarray(np.clip(np.floor(time / h * (1 + 1e-12)).astype(int), 0, last))


def support(nodes: Zonotope, rows: Array) -> Array:
    """Support of a stack of zonotopes along rows, shape (nodes, r)."""
    return np.asarray(nodes.c @ rows.T + np.abs(rows @ nodes.G).sum(axis=-1))
