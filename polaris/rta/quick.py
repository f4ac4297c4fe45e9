"""What a `Prospect` says of one error, quickly: fixed buffers, matrices laid out for one product each.

The arithmetic is that of `Prospect.share`, up to the order of sums; see there for what it means.
"""

from __future__ import annotations

from math import hypot, inf

import numpy as np

from ..model.system import Array
from .prospect import Prospect


class QuickProspect:
    """One prospect, asked about one error at a time; not for several threads at once.

    Parameters
    ----------
    prospect : Prospect

    Attributes
    ----------
    holds : bool
        Whether the law of the controller holds throughout, at the last call of `share`.
    """

    def __init__(self, prospect: Prospect) -> None:
        self.prospect, grid = prospect, prospect.grid
        recovery, demand = prospect.recovery, prospect.demand
        n, self._c, self._delay, self._last = grid.system.n, grid.nodes, grid.delay, grid.last
        self._r, self._near, self._count = len(recovery.rows), demand.near, len(demand.tall)
        self._stack, self._known = prospect.stack, prospect.known
        self._near_rows = np.ascontiguousarray(demand.tall[: self._near].T)
        self._far_rows = np.ascontiguousarray(demand.tall[self._near :].T)
        self._base, self._slope, self._radius = demand.base, demand.slope, prospect.radius
        self._reciprocals, self._taken = recovery.reciprocals, recovery.taken
        self._beyond = recovery.far_shares.tolist()
        self._norms = [(i, i + n) for i in range(n, prospect.commands, n)]
        self._n, self._commands, command = n, prospect.commands, prospect.command
        rooms = [] if command is None else zip(command.room.tolist(), command.per_size.tolist(), strict=True)
        self._rooms = list(rooms)
        self._moved, self._vector = np.empty(self._stack.shape[1]), np.ones(n + 2)
        self._need, self._rest = np.empty(self._near), np.empty(self._count - self._near)
        self._lay_out_inner()
        self.holds = True
        self._where = self._end = -1

    def _lay_out_inner(self) -> None:
        """The facets at the nodes in between: one matrix, one row of constants per decision."""
        p, o = self.prospect, len(self.prospect.recovery.bow)
        self._inner = len(p.inner) * o
        self._inner_rows = np.zeros((self._n, 0))
        if not self._inner:
            return
        rows, known, size = [], [], []
        starts = np.arange(len(self._known)) * self._c
        for stage, demand in zip(p.inner, p.inner_demand, strict=True):
            facets = demand.tall[:o]
            rows.append(facets[:, : self._n] @ stage.M)
            known.append(stage.offset[starts] @ facets[:, : self._n].T + facets[:, -1])
            size.append(facets[:, -2])
        nodes = starts[:, None] + self._delay + 1 + np.arange(len(p.inner))
        nodes = np.minimum(nodes, len(self._reciprocals) // self._r - 1)  # later ones are never asked for
        by_node = self._reciprocals.reshape(-1, self._r)[:, :o]
        self._inner_rows = np.ascontiguousarray(np.vstack(rows).T)
        self._inner_known, self._inner_size = np.hstack(known), np.concatenate(size)
        self._inner_reciprocals = by_node[nodes].reshape(len(starts), -1)
        self._inner_need, self._inner_book = np.empty(self._inner), np.empty(self._inner)

    def share(self, k: int, e: Array) -> float:
        """Share of the room that an error (n,) at decision k needs; not worked out unless the law `holds`."""
        first = k * self._c + self._delay
        self._end = end = first + self._c
        self.holds, self._where = True, -1
        if end > self._last:
            return inf
        moved = np.dot(e, self._stack, out=self._moved)
        np.add(moved, self._known[k], out=moved)
        values = moved.tolist()
        size = max([hypot(*values[i:j]) for i, j in self._norms]) + self._radius
        for value, (room, per_size) in zip(values[self._commands :], self._rooms, strict=True):
            if not abs(value) <= room - size * per_size:
                self.holds = False
                return inf
        vector = self._vector
        vector[: self._n], vector[self._n] = moved[: self._n], size
        at, near = end * self._r, self._near
        need = np.dot(vector, self._near_rows, out=self._need)
        np.multiply(need, self._reciprocals[at : at + near], out=need)
        np.add(need, self._taken[at : at + near], out=need)
        self._where = where = int(need.argmax())
        share = float(need[where])
        beyond = max([base + slope * size for base, slope in self._beyond[end]])
        if beyond > share:
            share, self._where = beyond, -1
        later = self._base + self._slope * size
        if later > 1:
            rest = np.dot(vector, self._far_rows, out=self._rest)
            np.multiply(rest, self._reciprocals[at + near : at + self._count], out=rest)
            np.add(rest, self._taken[at + near : at + self._count], out=rest)
            later, where = 0.0, int(rest.argmax()) if len(rest) else 0
            if len(rest) and rest[where] > share:
                self._where, later = near + where, float(rest[where])
        share = max(share, later)
        return max(share, self._inner_share(k, e, size, share)) if self._inner else share

    def _inner_share(self, k: int, e: Array, size: float, share: float) -> float:
        need = np.dot(e, self._inner_rows, out=self._inner_need)
        np.multiply(self._inner_size, size, out=self._inner_book)
        np.add(need, self._inner_book, out=need)
        np.add(need, self._inner_known[k], out=need)
        np.multiply(need, self._inner_reciprocals[k], out=need)
        where = int(need.argmax())
        if need[where] > share:
            j, row = divmod(where, self._inner // len(self.prospect.inner))
            self._where = row + (j + 1 - self._c) * self._r  # before the end
        return float(need[where])

    def limit(self) -> str:
        """Which limit was the tightest at the last call of `share`, and when S would meet it."""
        if self._end > self._last:
            return "the end of the plan"
        if self._where == -1:
            return "limits beyond the loop's memory"
        lag, row = divmod(self._where, self._r)
        node = self._end + lag
        return f"{self.prospect.recovery._names[row]} at t = {node * self.prospect.grid.h:g} s"
