"""Tightening by S's errors wherever an experimental controller may hand over to it, for the planner."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from reach.sets.zonotope import Zonotope

from ...model.scene.timed_polytope import TimedPolytope
from ...model.system import Array
from ...planning.reference import Reference
from ..controllers.controllers import AffineController, Controller, propagate_states
from ..safety.carried_rows import CarriedRows
from ..safety.clearance import facet_clearance
from ..safety.feedforward import Feedforward
from ..tracker.tracking import Tracking


@dataclass(frozen=True, eq=False)
class HandOvers:
    """S's tightening along the facets of all unsafe sets after hand-overs, cell by cell.

    A planner may keep any clearance: no proof along its path rests on it.

    Parameters
    ----------
    tracking : Tracking
        S, and the bounds on its error.
    unsafe : tuple of TimedPolytope
        Sets to keep clear of, each with F facets.
    K : int
        Number of planned cells.
    """

    tracking: Tracking
    unsafe: tuple[TimedPolytope, ...]
    K: int

    @cached_property
    def _rows(self) -> CarriedRows:
        normals = [-body.rows(self.tracking.system) for body in self.unsafe]
        return CarriedRows.from_tracking(
            self.tracking, np.vstack([*normals, np.zeros((0, self.tracking.system.n))])
        )

    def _by_set(self, tightenings: Array) -> list[Array]:
        ends = np.cumsum([len(body.normals) for body in self.unsafe])
        return np.split(tightenings, ends[:-1], axis=-1) if self.unsafe else []

    @cached_property
    def _lags(self) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
        """Nodes at both ends and in the middle of each cell, and which of them each cell has, (K, 3)."""
        q, last = self.tracking.feedback.nodes_per_cell, self.tracking.settling + 1
        cell_nodes = np.arange(self.K)[:, None] * q + np.array([0, q // 2, q])
        nodes, index = np.unique(np.minimum(cell_nodes, last), return_inverse=True)
        return nodes, np.asarray(index).reshape(self.K, 3)

    def since(self, errors: Zonotope) -> list[Array]:
        """Return S's tightening in each cell after taking over a set of errors, one (K, F) per unsafe set."""
        nodes, index = self._lags
        return self._by_set(self._rows.from_set(errors, nodes)[index].max(axis=1))

    def tables(self, sets: Sequence[Zonotope]) -> list[Array]:
        """Stack `since` of several sets, one (sets, K, F) per unsafe set."""
        return [np.array(each) for each in zip(*map(self.since, sets), strict=True)]

    def feedforward(self, reference: Reference) -> list[Array]:
        """Return the feedforward tightening along a reference, one (K, F) per unsafe set."""
        tightenings = Feedforward(self.tracking, reference, reference.cells).response(self._rows.rows)
        return self._by_set(tightenings.max(axis=1)[: self.K])

    def tighten(self, reference: Reference, sets: Mapping[int, Zonotope]) -> list[tuple[Array, Array]]:
        """Return S's tightening along a reference, and the lack of clearance at the best facet of each cell.

        Parameters
        ----------
        reference : Reference
        sets : mapping
            Sets of errors by the cell at whose start S may take over.

        Returns
        -------
        list of tuple
            Per unsafe set the tightening (K, F) and the lack (K, 1) [m].
        """
        pairs, tables = [], dict(zip(sets, map(self.since, sets.values()), strict=True))
        for i, (body, tightening) in enumerate(zip(self.unsafe, self.feedforward(reference), strict=True)):
            largest = np.zeros_like(tightening)
            for k, table in tables.items():
                largest[k:] = np.maximum(largest[k:], table[i][: self.K - k])
            clearance = facet_clearance(self.tracking, reference, body)
            shortfall = (largest + tightening - clearance.min(axis=1)[: self.K]).min(axis=1, keepdims=True)
            pairs.append((largest + tightening, np.maximum(shortfall, 0.0)))
        return pairs


def reached_sets(
    laws: Sequence[Controller], start: Zonotope, s: AffineController, past_sets: Sequence[Zonotope] = ()
) -> list[Zonotope]:
    """Return the loop states at the start of every step and after the last one, one law flying each.

    `s` is the safety controller; `past_sets` are the sets after the first steps, if these have been flown.
    """
    sets = [start, *past_sets]
    for k in range(len(past_sets), len(laws)):
        sets.append(propagate_states(laws[k], sets[-1], k, s).end)
    return sets
