"""Table of rows carried back through a closed loop: what each needs at every lag after a hand-over."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from reach.sets.zonotope import Zonotope

from ...model.tolerances import ROUNDING
from ..tracker.loop import Array
from ..tracker.tightening import Tightening


@dataclass(frozen=True, eq=False)
class RowTable:
    """Rows of the loop state, with the tightening of each at every lag.

    Parameters
    ----------
    tightening : Tightening
    plant : ndarray, shape (r, n)
        Rows of the tracking error, whose limits hold between nodes too.
    commands : ndarray, shape (s, N)
        Rows of the loop state whose limits hold at nodes.
    bound : ndarray, shape (m,) or (N + 2, m), optional
        Bound on the commands (`Tightening.from_rest`).
    """

    tightening: Tightening
    plant: Array
    commands: Array
    bound: Array | None = None

    @cached_property
    def rows(self) -> Array:
        """All rows of the loop state, shape (r + s, N)."""
        loop = self.tightening.closed.loop
        padded = np.zeros((len(self.plant), loop.N))
        padded[:, : loop.n] = self.plant
        return np.vstack([padded, self.commands])

    @cached_property
    def carried(self) -> Array:
        """``rows F^l`` for l = 0 ... N + 1, shape (N + 2, r + s, N)."""
        return self.tightening.carried(self.rows)

    @cached_property
    def _between(self) -> tuple[Array, Array]:
        first = None if self.bound is None else np.atleast_2d(self.bound)[0]
        fixed, per_size = self.tightening.between(self.plant, first)
        nodes = len(self.commands)
        offset = self.tightening.closed.loop.offset
        fixed = np.concatenate([fixed + np.abs(self.plant) @ offset, np.zeros(nodes)])
        return fixed, np.hstack([per_size, np.zeros((len(per_size), nodes))])

    @cached_property
    def fixed(self) -> Array:
        """Need of each row whatever the errors at the hand-over, shape (N + 3, r + s).

        Entry l belongs to node l after the hand-over. Between two nodes a row is at most the chord of their
        entries; the last entry holds for every later time.
        """
        return np.asarray(self.tightening.from_rest(self.rows, self.bound) + self._between[0])

    @property
    def per_size(self) -> Array:
        """Intersample bound per unit of the norm at the hand-over, shape (N + 2, r + s)."""
        return self._between[1]

    @cached_property
    def beyond(self) -> Array:
        """Need per unit of the norm at the hand-over at any lag beyond N, shape (r + s,)."""
        return np.asarray(self.tightening.remainder(self.rows) + self.per_size.max(axis=0))

    def size(self, errors: Zonotope) -> Array:
        """Return the norm ``max |z_i| / v_i`` of sets of loop states."""
        return np.asarray((errors.extent / self.tightening.v).max(axis=-1) * (1 + ROUNDING))

    def need(self, errors: Zonotope) -> Array:
        """Return what the rows need from one set of loop states on, shape (N + 3, r + s)."""
        size = float(self.size(errors))
        centre = self.carried @ errors.c
        spread = np.abs(self.carried @ errors.G).sum(axis=-1)
        within = centre + spread + ROUNDING * (np.abs(centre) + spread) + self.per_size * size
        return np.vstack([within, self.beyond * size]) + self.fixed
