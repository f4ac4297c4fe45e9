"""What a schedule's proof promises at every instant: the margins that no run may go below."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import floor

import numpy as np
from numpy.typing import NDArray

from ...model.system import Array, LinearSystem
from ...model.timed_polytope import TimedPolytope
from ...synthesis.clearance import error_tube, facet_room
from ...synthesis.schedule import Schedule


@dataclass(frozen=True, eq=False)
class Claims:
    """Proven margins of one schedule, period by period.

    The limits are the timed polytopes, one each (margin in m: how far outside the best facet), and then
    the inputs, one each (margin in N: thrust left while S flies). S's flight after T is included with `tail`.
    """

    schedule: Schedule
    tail: bool

    @property
    def system(self) -> LinearSystem:
        """What flies."""
        return self.schedule.safety.problem.system

    @property
    def q(self) -> int:
        """Periods per cell."""
        return self.schedule.safety.clearance.q

    @property
    def h(self) -> float:
        """Length of a period [s]."""
        return self.schedule.safety.tracking.flow.h

    @property
    def cells(self) -> int:
        """Number of cells that are looked at."""
        safety = self.schedule.safety
        return safety.reference.cells if self.tail else safety.problem.K

    @property
    def unsafe(self) -> tuple[TimedPolytope, ...]:
        """The timed polytopes."""
        return self.schedule.safety.clearance.unsafe

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the limits."""
        return (*(u.name for u in self.unsafe), *self.system.input_names)

    @cached_property
    def modes(self) -> NDArray[np.int_]:
        """Mode of every cell, S after T."""
        return np.append(self.schedule.modes, np.zeros(self.cells - len(self.schedule.modes), dtype=int))

    @cached_property
    def offsets(self) -> list[tuple[Array, Array]]:
        """Offsets of every polytope at the beginning and the end of every period, (periods, F) each [m]."""
        fine = [u.fine(self.q)[: self.cells] for u in self.unsafe]
        return [(self._flat(part[:, :-1]), self._flat(part[:, 1:])) for part in fine]

    @cached_property
    def facets(self) -> list[Array]:
        """Lower bounds on the margin of every facet over each period, (periods, F) each [m]."""
        safety, out = self.schedule.safety, []
        for u in self.unsafe:
            room = facet_room(safety.tracking, safety.reference, u, self.q)[: self.cells]
            need, bow = self._needs(-u.normals @ self.system.position)
            left = room - need
            out.append(self._flat(np.minimum(left[:, :-1], left[:, 1:]) - bow))
        return out

    @cached_property
    def floor(self) -> Array:
        """Proven margin of every limit over each period, (periods, limits); -inf where there is none.

        While S flies no margin can be negative, whatever its tube shows: S took over from a recoverable set.
        """
        safety, m, o = self.schedule.safety, self.system.m, len(self.unsafe)
        gain = safety.tracking.gain
        need, bow = self._needs(np.vstack([gain, -gain]))
        nu = safety.reference.nu[: self.cells]
        room = np.tile(self.system.u_max, 2) + np.hstack([nu, -nu])
        left = np.min((room[:, None, :] - need).reshape(self.cells, self.q + 1, 2, m), axis=2)
        thrust = np.minimum(left[:, :-1], left[:, 1:]) - bow.reshape(self.cells, self.q, 2, m).max(axis=2)
        out = np.column_stack([*(part.max(axis=1) for part in self.facets), self._flat(thrust)])
        by_s = np.repeat(self.modes == 0, self.q)
        out[by_s] = np.maximum(out[by_s], 0.0)
        out[~by_s, o:] = -np.inf  # what U demands is limited by its own model alone
        return out if self.schedule.guarantee == "proved" else np.full(out.shape, -np.inf)

    def _flat(self, parts: Array) -> Array:
        """One row per period, out of (cells, q, columns)."""
        return parts.reshape(self.cells * self.q, -1)

    def _needs(self, rows: Array) -> tuple[Array, Array]:
        """Largest ``row e`` at the nodes (cells, q+1, r), and what may be added between (cells, q, r)."""
        safety, q = self.schedule.safety, self.q
        need = np.empty((self.cells, q + 1, len(rows)))
        bow = np.zeros((self.cells, q, len(rows)))
        for k, step in enumerate(self.schedule.steps):
            need[k] = step.tube.nodes.support(rows)
            bow[k] = step.tube.bow @ np.abs(rows).T
        K = len(self.schedule.steps)
        if self.cells > K:
            at_end = self.schedule.final.inflate(safety.clearance.jump)
            tube = error_tube(safety.tracking, at_end, rows).need
            lag = np.arange(self.cells - K)[:, None] * q + np.arange(q + 1)
            need[K:] = tube[np.minimum(lag, len(tube) - 1)]
        return need, bow

    def period_at(self, time: float) -> int:
        """Number of the period that holds an instant [s]."""
        return min(max(floor(time / self.h * (1 + 1e-12)), 0), self.cells * self.q - 1)
