"""Naive forward reachability: U flies if its reachable set over a while keeps clear.

The set is that of U's unclipped law about its clipped prediction, for every measured state within the error
bound and every disturbance. It does not ask whether S could still take over where that set ends.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...model.system import Array
from ...synthesis.controllers import AffineController
from ..decision_grid import DecisionGrid
from .simulation import HORIZON, LEAST, Simulation


class ForwardReachability(Simulation):
    """As `Simulation`, about whose flight it lays the reachable set."""

    key, name, place = "reachability", "Forward reachability of U", 10
    how = "U's reachable set over a share of the horizon keeps clear"
    option = replace(HORIZON, meaning="the same", default=f"0.2 of the flight, at least {LEAST} decisions")
    reasons = ("U's reachable set keeps clear", "U's reachable set touches an unsafe set")
    ahead = 0.2

    def __init__(self, grid: DecisionGrid, horizon: float | None = None) -> None:
        super().__init__(grid, horizon)
        self.spread = self._spread()

    def _spread(self) -> Array:
        """Support of the sets about the prediction along every facet, shape (count + 1, F)."""
        grid = self.grid
        law = grid.controllers[1]
        gain = law.gain if isinstance(law, AffineController) else np.zeros((grid.system.m, grid.system.n))
        flow = grid.tracking.feedback.flow(grid.system, gain, grid.tracking.delta)
        rows, out = grid.facets[0] @ grid.system.position, []
        added = np.zeros(len(rows))
        for _ in range(self.count + 1):
            out.append(np.abs(rows) @ grid.half_widths + added)
            for _ in range(self.stride):
                added = added + np.abs(rows @ flow.period_zonotope.G).sum(axis=1)
                rows = rows @ flow.phi
        return np.array(out)

    @property
    def reach(self) -> str:
        """Nothing where the set ends."""
        return (
            f"U's reachable set over {self.horizon:g} s; nothing says that S can still take over"
            " where that set ends, or once it touches an unsafe set"
        )
