"""Implicit simplex: S is flown, in prediction, from where U would be at the next decision; latched.

U flies as long as that undisturbed flight keeps clear of the perceived unsafe sets and within the thrust
limits.
"""

from __future__ import annotations

import numpy as np

from ...model.system import Array
from ..decision_grid import DecisionGrid
from ..method import Latched, Seen


class ImplicitSimplex(Latched):
    """The switch."""

    key, name, place = "simplex_implicit", "Implicit simplex", 6
    how = "S is predicted, undisturbed, from where U would be at the next decision; latched"

    def __init__(self, grid: DecisionGrid) -> None:
        super().__init__(grid)
        tracking, system = grid.tracking, grid.system
        normals, offsets, _ = grid.facets
        self.lags = len(tracking.transitions)
        facets = normals @ system.position
        self.facets = (facets @ tracking.transitions).reshape(-1, system.n).T.copy()
        self.thrust = (tracking.gain @ tracking.transitions).reshape(-1, system.n).T.copy()
        # Of the reference itself; beyond the end of the tail the last instant counts.
        pad = [(0, self.lags), (0, 0)]
        self.clear = np.pad(grid.xi @ facets.T - offsets, pad, mode="edge")
        self.mu = np.pad(grid.mu, [(0, self.lags + 1), (0, 0)])

    @property
    def reach(self) -> str:
        """One undisturbed flight per decision."""
        return f"one undisturbed flight of S over {self.lags * self.grid.h:g} s; disturbances are ignored"

    def margin(self, seen: Seen) -> Array:
        """Least distance of the predicted flight [m]; -inf where S would ask for too much thrust."""
        grid, x = self.grid, seen.estimate
        node = seen.k * grid.nodes
        if node + grid.nodes + grid.delay > grid.last:
            return np.full(len(x), -np.inf)
        Ad, Bd, _ = grid.held
        for _ in range(grid.nodes + grid.delay):
            x = x @ Ad.T + grid.clipped(1, node, x) @ Bd.T
            node += 1
        e = x - grid.xi[node]
        window = slice(node, node + self.lags)
        room = grid.nearest((e @ self.facets).reshape(len(x), self.lags, -1) + self.clear[window])
        command = self.mu[window].reshape(-1) - e @ self.thrust
        strained = np.abs(command) > np.tile(grid.system.u_max, self.lags)
        return np.where(strained.any(axis=1), -np.inf, room.min(axis=1))
