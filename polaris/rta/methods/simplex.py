"""Simplex, latched: the region where U flies is written down beforehand, or S is flown in prediction."""

from functools import cached_property

import numpy as np

from ...model.system import Array
from ..decision_grid import DecisionGrid
from ..method import Latched, Observation, keep_clear
from ..permission import ErrorMotion, Permission
from ..recovery import Recovery


class ExplicitSimplex(Latched):
    """U flies as long as all it can reach at its thrust limits lies in a ball inside the recoverable set.

    That is the largest one, in the tracker's norm, when the next decision takes effect.

    Raises
    ------
    NotCertified
        If the initial set is not inside the first recoverable set.
    """

    key, name, place, proven = "simplex_explicit", "Explicit simplex", 5, True
    how = "U flies in a ball inside the recoverable set; once it might be left, S flies for good"
    reach = "state estimate within its error bound, U within the thrust limits"

    def __init__(self, grid: DecisionGrid, buffer: float | None = None) -> None:
        super().__init__(grid, buffer)
        self.recovery = Recovery.certified(grid, self.grid)
        leg = ErrorMotion.any_thrust(self.recovery)
        self.prospect = Permission(self.recovery, leg if grid.delay else None, leg)

    @cached_property
    def radii(self) -> Array:
        """Radius of the ball at the moment after each decision, shape (D,)."""
        grid, recovery = self.grid, self.recovery
        demand = recovery.demand(np.zeros((grid.system.n, 1)))
        size = np.linalg.norm(demand.tall[:, : grid.system.n] @ grid.tracking.W_inverse, axis=1)
        slope = size * (1 + 1e-9) + demand.tall[:, grid.system.n]
        out = np.empty(grid.decisions)
        for k in range(grid.decisions):
            node = k * grid.nodes + grid.delay + grid.nodes
            if node > grid.last:
                out[k] = -np.inf
                continue
            slack = recovery.window(node) - demand.tall[:, -1]
            out[k] = min(float((slack / slope).min()), recovery.far(node))
        return out

    def margin(self, observed: Observation) -> Array:
        """Share of the radius left."""
        e = observed.estimate - self.grid.xi[observed.k * self.grid.nodes]
        radius = self.radii[observed.k]
        size = self.prospect.size(observed.k, e)
        slack = 1 - size / radius if radius > 0 else np.full(len(e), -np.inf)
        if self.prospect.inner:  # the ball is that of the last node; facets count at those before too
            slack = np.minimum(slack, 1 - self.prospect.share(observed.k, e)[0])
        return np.asarray(slack)


class ImplicitSimplex(Latched):
    """U flies as long as S's undisturbed flight from where U would be at the next decision keeps clear.

    Of the perceived unsafe sets, and within the thrust limits.
    """

    key, name, place, predicts = "simplex_implicit", "Implicit simplex", 6, True
    how = "undisturbed S is predicted from where U would be at the next decision; latched"
    options = (keep_clear(0.5),)
    apart = 0.5

    def __init__(self, grid: DecisionGrid, buffer: float | None = None) -> None:
        super().__init__(grid, buffer)
        grid = self.grid
        tracking, system = grid.tracking, grid.system
        facets, offsets, _ = grid.facets
        self.lags = len(tracking.transitions)
        self.facets = (facets @ tracking.transitions).reshape(-1, system.n).T.copy()
        self.thrust = (tracking.gain @ tracking.transitions).reshape(-1, system.n).T.copy()
        # Of the reference itself; beyond the end of the tail the last instant counts.
        pad = [(0, self.lags), (0, 0)]
        self.clear = np.pad(grid.xi @ facets.T - offsets, pad, mode="edge")
        self.mu = np.pad(grid.mu, [(0, self.lags + 1), (0, 0)])

    @property
    def reach(self) -> str:
        """Basis of a decision: one undisturbed flight of S."""
        return f"one undisturbed flight of S over {self.lags * self.grid.h:g} s; disturbances are ignored"

    def margin(self, observed: Observation) -> Array:
        """Least distance of the predicted flight [m]; -inf where S would ask for too much thrust."""
        grid, x = self.grid, observed.estimate
        node = observed.k * grid.nodes
        if node + grid.nodes + grid.delay > grid.last:
            return np.full(len(x), -np.inf)
        Ad, Bd, _ = grid.discrete
        for _ in range(grid.nodes + grid.delay):
            x = x @ Ad.T + grid.clipped(1, node, x) @ Bd.T
            node += 1
        e = x - grid.xi[node]
        window = slice(node, node + self.lags)
        clearance = grid.nearest((e @ self.facets).reshape(len(x), self.lags, -1) + self.clear[window])
        command = self.mu[window].reshape(-1) - e @ self.thrust
        strained = np.abs(command) > np.tile(grid.system.u_max, self.lags)
        return np.where(strained.any(axis=1), -np.inf, clearance.min(axis=1))
