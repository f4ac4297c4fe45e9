"""Timed polytopes (Definition 2): what the planner, the recoverable sets and the checks all read."""

from dataclasses import dataclass

import numpy as np

from reach.short_repr import short_repr

from ..system import Array, LinearSystem


@short_repr
@dataclass(frozen=True, eq=False)
class TimedPolytope:
    """An over-approximation of one unsafe set in position and time, or in the whole state and time.

    At time ``t`` in cell k the set is ``{p : normals p <= b(t)}`` where b runs linearly from
    ``offsets[k, 0]`` at the start of the cell to ``offsets[k, 1]`` at its end. A point is certainly
    safe when one row reads ``normals[f] p > b_f(t)``. Sets `of_state` have the state for p.

    Attributes
    ----------
    name : str
        Of the unsafe set that it covers.
    normals : ndarray, shape (F, d), of states (F, n)
        Outward facet normals, the same at all times; unit vectors in position.
    offsets : ndarray, shape (cells, 2, F)
        Facet offsets [m] at the two ends of every cell.
    keep_in : bool
        True if this is one facet of a keep-in set (the unsafe side of one halfspace, F = 1).
    static : bool
        True if the offsets are the same at all times, now and for ever.
    of_state : bool
        True if the set lies in the state: normals are of states, offsets lengths by `state_lengths`.
    """

    name: str
    normals: Array
    offsets: Array
    keep_in: bool = False
    static: bool = True
    of_state: bool = False

    def rows(self, system: LinearSystem) -> Array:
        """Return the facet normals as rows of the state, shape (F, n)."""
        return self.normals if self.of_state else self.normals @ system.position

    @property
    def cells(self) -> int:
        """Number of time cells covered."""
        return len(self.offsets)

    def offsets_at(self, times: Array, delta: float) -> Array:
        """Offsets at times >= 0, cells of `delta` [s], shape (..., F); after the last cell on in its line."""
        cell = np.minimum((times / delta * (1 + 1e-12)).astype(int), self.cells - 1)
        s = (times / delta - cell)[..., None]
        return np.asarray(self.offsets[cell, 0] * (1 - s) + self.offsets[cell, 1] * s)

    def fine(self, q: int) -> Array:
        """Offsets at q equal parts of every cell, shape (cells, q+1, F)."""
        s = np.linspace(0.0, 1.0, q + 1)[None, :, None]
        return self.offsets[:, :1] * (1 - s) + self.offsets[:, 1:] * s
