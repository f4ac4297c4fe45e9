"""Clearance that S needs wherever an experimental controller may hand over to it, for the planner to keep."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from reach.sets.zonotope import Zonotope

from ...model.scene.timed_polytope import TimedPolytope
from ...model.system import Array
from ...planning.reference import Reference
from ..controllers.controllers import Controller
from ..safety.clearance import TubeRows, facet_room
from ..safety.demand import Scheduled
from ..tracker.tracking import Tracking


@dataclass(frozen=True, eq=False)
class HandOvers:
    """What S needs along the facets of all unsafe sets after hand-overs, cell by cell.

    A planner may keep any clearance: what is proven along its path does not rest on it.

    Parameters
    ----------
    tracking : Tracking
        S, and what is known of its error.
    unsafe : tuple of TimedPolytope
        Sets to keep clear of, each with F facets.
    K : int
        Number of planned cells.
    """

    tracking: Tracking
    unsafe: tuple[TimedPolytope, ...]
    K: int

    @cached_property
    def _rows(self) -> list[TubeRows]:
        position = self.tracking.system.position
        return [TubeRows(self.tracking, -body.normals @ position) for body in self.unsafe]

    def since(self, handed: Zonotope) -> list[Array]:
        """Return what S needs in each cell after it took over a set of errors, one (K, F) per unsafe set."""
        q = self.tracking.feedback.nodes_per_cell
        return [rows.tube(handed).over_cells(self.K, q) for rows in self._rows]

    def tables(self, handed: Sequence[Zonotope]) -> list[Array]:
        """Stack `since` of several sets, one (sets, K, F) per unsafe set."""
        return [np.array(each) for each in zip(*map(self.since, handed), strict=True)]

    def caused(self, reference: Reference) -> list[Array]:
        """Return what errors by the time of the flight along a reference need, one (K, F) per unsafe set."""
        if not self.tracking.varies:
            return [np.zeros((self.K, len(body.normals))) for body in self.unsafe]
        found = Scheduled(self.tracking, reference, reference.cells)
        return [found.along(rows.whole).max(axis=1)[: self.K] for rows in self._rows]

    def along(self, reference: Reference, handed: Mapping[int, Zonotope]) -> list[tuple[Array, Array]]:
        """Return what S needs along a reference, and how much the best facet of each cell lacks of it.

        Parameters
        ----------
        reference : Reference
        handed : mapping
            Sets of errors by the cell at whose start S may take over.

        Returns
        -------
        list of tuple
            Per unsafe set the need (K, F) and the lack (K, 1) [m].
        """
        found, tables = [], dict(zip(handed, map(self.since, handed.values()), strict=True))
        for i, (body, need) in enumerate(zip(self.unsafe, self.caused(reference), strict=True)):
            most = np.zeros_like(need)
            for k, table in tables.items():
                most[k:] = np.maximum(most[k:], table[i][: self.K - k])
            room = facet_room(self.tracking, reference, body, self.tracking.feedback.nodes_per_cell)
            lack = (most + need - room.min(axis=1)[: self.K]).min(axis=1, keepdims=True)
            found.append((most + need, np.maximum(lack, 0.0)))
        return found


def flown(laws: Sequence[Controller], start: Zonotope) -> list[Zonotope]:
    """Return the sets of errors at the start of every step and after the last one, one law flying each."""
    found = [start]
    for k, law in enumerate(laws):
        found.append(law.fly(found[-1], k).end)
    return found
