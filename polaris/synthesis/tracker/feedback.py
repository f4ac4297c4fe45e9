"""The one clock of all feedback laws: nodes at which commands are renewed, and the period that is chosen."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from reach.numerics.errors import ReachError
from reach.tubes.flow import LinearFlow

from ...model.craft import Craft
from ...model.errors import ScenarioError
from ...model.system import Array, LinearSystem

MOST_NODES = 200  # most nodes per step where no control period is given; more: long runs


@dataclass(frozen=True)
class Feedback:
    """Clock of all feedback laws: commands are renewed at the nodes and held from node to node.

    Parameters
    ----------
    nodes_per_cell : int
        Number q of nodes per planning step; the control period is delta / q.
    """

    nodes_per_cell: int

    def flow(self, system: LinearSystem, gain: Array, delta: float, error: Array | float = 0.0) -> LinearFlow:
        """Error dynamics under ``u = mu + gain (xi - x)``, every input off by `error` at most."""
        h, E = delta / self.nodes_per_cell, Craft.from_system(system).error_map(np.asarray(error))
        return LinearFlow.sampled(system.A, system.B, gain, system.D, system.w_max, h, E)


def choose_feedback(
    system: LinearSystem, gains: Sequence[Array], delta: float, period: float | None
) -> Feedback:
    """Nodes per step: those of the control period if one is given, else fine enough for the fastest loop.

    A node every quarter of the fastest closed-loop time constant keeps intersample bounds below one per cent
    of the error. Nodes are doubled until the sampled loop of the first gain, S's, is stable and its motion
    within a period is bounded.
    """
    if period is not None:
        q = round(delta / period)
        if q < 1 or abs(q * period - delta) > 1e-9 * delta:
            raise ScenarioError("feedback.period_s", period, f"must divide the step of {delta:g} s")
        return Feedback(q)
    fastest = max(float(np.max(np.abs(np.linalg.eigvals(system.A - system.B @ gain)))) for gain in gains)
    q = int(np.clip(np.ceil(delta * fastest / 0.25), 2, MOST_NODES))
    while q < MOST_NODES and not _usable(Feedback(q), system, gains[0], delta):
        q = min(2 * q, MOST_NODES)
    return Feedback(q)


def _usable(feedback: Feedback, system: LinearSystem, gain: Array, delta: float) -> bool:
    """Return True if a loop is stable at its nodes and its motion between them is bounded."""
    try:
        flow = feedback.flow(system, gain, delta)
        finite = np.all(np.isfinite(flow.phi)) and np.all(np.isfinite(flow.growth))
        return bool(finite and np.max(np.abs(np.linalg.eigvals(flow.phi))) < 1)
    except ReachError:  # beyond floating point
        return False
