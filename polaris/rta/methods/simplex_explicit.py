"""Explicit simplex: the region is written down beforehand, a ball of the tracker's norm per instant; latched.

U flies as long as everything it can reach until the next decision takes effect, at its thrust limits, lies in
the largest ball inside the recoverable set there.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from ...model.system import Array
from ..decision_grid import DecisionGrid
from ..method import Latched, Seen
from ..prospect import Leg, Prospect
from ..recovery import Recovery


class ExplicitSimplex(Latched):
    """The switch.

    Raises
    ------
    NotCertified
        If the initial set is not inside the first recoverable set.
    """

    key, name, place, proven = "simplex_explicit", "Explicit simplex", 5, True
    how = (
        "a ball of the tracker's norm inside the recoverable set, written down per instant; once it might be"
        " left, S flies for good"
    )
    reach = "state estimate within its error bound, U within the thrust limits"

    def __init__(self, grid: DecisionGrid) -> None:
        super().__init__(grid)
        self.recovery = Recovery.certified(grid)
        leg = Leg.any_thrust(self.recovery)
        self.prospect = Prospect(self.recovery, leg if grid.delay else None, leg)

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
            left = recovery.window(node) - demand.tall[:, -1]
            out[k] = min(float((left / slope).min()), recovery.far(node))
        return out

    def margin(self, seen: Seen) -> Array:
        """Share of the radius left."""
        e = seen.estimate - self.grid.xi[seen.k * self.grid.nodes]
        radius = self.radii[seen.k]
        size = self.prospect.size(seen.k, e)
        left = 1 - size / radius if radius > 0 else np.full(len(e), -np.inf)
        if self.prospect.inner:  # the ball is that of the last node; facets count at those before too
            left = np.minimum(left, 1 - self.prospect.share(seen.k, e)[0])
        return np.asarray(left)
