"""Look-ahead: U flies if its undisturbed flight, or its reachable set, keeps clear for a while.

It does not ask whether S could still take over when that turns bad: this is what it is here to show.
"""

from functools import partial

import numpy as np

from ...model.checks import positive
from ...model.system import Array
from ...synthesis.controllers.controllers import AffineController
from ..decision_grid import DecisionGrid
from ..method import BUFFER, Choice, Method, Observation, Option, keep_clear

AHEAD = 0.2  # share of the flight that is looked ahead by default: chosen by ``benchmarks/comparison.py``
LEAST = 20  # decisions that are looked ahead at least

HORIZON = Option(
    "horizon",
    "how far it looks [s]",
    f"{AHEAD:g} of the flight, at least {LEAST} decisions",
    (0.05, 0.1, 0.2, 0.4),
    "of the duration",
    partial(positive, unit="s"),
)


class ForwardSimulation(Method):
    """Undisturbed flight of U from measured states, node by node.

    Parameters
    ----------
    grid : DecisionGrid
    horizon : float, optional
        Look-ahead [s]; default `AHEAD` of the flight's duration, at least `LEAST` decisions.
    buffer : float, optional
        See `Method`.
    """

    key, name, place, predicts = "simulation", "Look-ahead by simulation", 9, True
    how = "one undisturbed flight of U over a share of the horizon keeps clear"
    options = (HORIZON, keep_clear(0.2))
    apart = 0.2
    reasons = ("the predicted flight keeps clear", "the predicted flight enters an unsafe set")

    def __init__(self, grid: DecisionGrid, horizon: float | None = None, buffer: float | None = None) -> None:
        super().__init__(grid, buffer)
        default = max(AHEAD * grid.last * grid.h, LEAST * grid.period)
        self.horizon = default if horizon is None else HORIZON.check("horizon", horizon)
        self.settings["horizon"] = self.horizon
        self.count = max(int(np.ceil(self.horizon / grid.h)), 1)
        self.last = len(grid.own_references.get(1, grid.xi)) - 1
        self.spread: Array | None = None  # what sets about the prediction add, shape (count + 1, F)

    @property
    def reach(self) -> str:
        """Basis of a decision: one undisturbed flight of U; nothing is said beyond the horizon."""
        return (
            f"one undisturbed flight of U over {self.horizon:g} s; nothing says that S can still take over"
            " at its end, or under disturbances"
        )

    def decide(self, observed: Observation) -> Choice:
        """Predict, and look at the least distance [m]."""
        node, x = observed.k * self.grid.nodes, observed.estimate
        clearance = self._clearance(node, x, 0)
        for i in range(1, self.count + 1):
            if node == self.last:
                break
            x = self._step(node, x)
            node += 1
            clearance = np.minimum(clearance, self._clearance(node, x, i))
        return Choice.between(clearance > 0, clearance)

    def _step(self, node: int, x: Array) -> Array:
        """States a period later, the clipped command held."""
        Ad, Bd, _ = self.grid.discrete
        return np.asarray(x @ Ad.T + self.grid.clipped(1, node, x) @ Bd.T)

    def _clearance(self, node: int, x: Array, step: int) -> Array:
        """Distance to the nearest perceived unsafe set at a node, by its farthest facet, (R,)."""
        rows, offsets, _ = self.grid.facets
        out = x @ rows.T - offsets[node]
        return self.grid.nearest(out if self.spread is None else out - self.spread[step])


class ForwardReachability(ForwardSimulation):
    """U flies if its reachable set over a while keeps clear: naive, for S need not be able to take over.

    The set is that of U's unclipped law about its clipped prediction, for every measured state within the
    error bound, every disturbance and every error of estimates and thrusters. It does not ask whether S could
    still take over where that set ends.
    """

    key, name, place = "reachability", "Forward reachability of U", 10
    options = (HORIZON, BUFFER)
    apart = 0.0
    how = "U's reachable set over a share of the horizon keeps clear"
    reasons = ("U's reachable set keeps clear", "U's reachable set touches an unsafe set")

    def __init__(self, grid: DecisionGrid, horizon: float | None = None, buffer: float | None = None) -> None:
        super().__init__(grid, horizon, buffer)
        self.spread = self._spread()

    def _spread(self) -> Array:
        """Support of the sets about the prediction along every facet, shape (count + 1, F)."""
        grid = self.grid
        law = grid.controllers[1]
        gain = law.gain if isinstance(law, AffineController) else np.zeros((grid.system.m, grid.system.n))
        error = grid.system.input_error(gain, grid.system.u_max)
        flow = grid.tracking.feedback.flow(grid.system, gain, grid.tracking.delta, error)
        rows, out = grid.facets[0], []
        added = np.zeros(len(rows))
        for _ in range(self.count + 1):
            out.append(np.abs(rows) @ grid.half_widths + added)
            added = added + np.abs(rows @ flow.period_zonotope.G).sum(axis=1)
            rows = rows @ flow.phi
        return np.array(out)

    @property
    def reach(self) -> str:
        """Basis of a decision: U's reachable set; nothing is said where it ends."""
        return (
            f"U's reachable set over {self.horizon:g} s; nothing says that S can still take over"
            " where that set ends, or once it touches an unsafe set"
        )
