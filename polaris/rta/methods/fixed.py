"""Methods that look at no measurement: one controller throughout, or the schedule of Algorithm 2."""

import numpy as np

from ...simulation.baselines import alone_key
from ..decision_grid import DecisionGrid
from ..method import Choice, Claim, Method, Observation


class SingleController(Method):
    """Method that looks at nothing: one controller flies throughout, unless a class says otherwise."""

    reasons = ("flies alone",)
    delayed = False
    mode: int

    @property
    def reach(self) -> str:
        """End condition of S, in words."""
        return self.grid.schedule.safety.end.reason

    def decide(self, observed: Observation) -> Choice:
        """Choose the one controller."""
        R = len(observed.estimate)
        return Choice(np.full(R, self.mode), np.full(R, np.nan), np.zeros(R, dtype=int))


class SafetyAlone(SingleController):
    """S throughout: safe from all of Theta."""

    key, name, place, mode, proven = "safety", "S alone", 0, 0, True
    how = "S flies throughout"

    @property
    def claim(self) -> Claim:
        """Claim of Algorithm 1."""
        return Claim("proved", self.reach)


class ExperimentalAlone(SingleController):
    """One experimental controller throughout, the preferred one by default."""

    key, name, place, mode = "experimental", "U alone", 1, 1
    how = "U flies throughout"
    reach = "nothing keeps the experimental controller away from unsafe sets"

    def __init__(self, grid: DecisionGrid, mode: int = 1) -> None:
        super().__init__(grid)
        self.mode, self.key = mode, alone_key(mode)
        self.name = f"U alone ({grid.controllers[mode].name})"


class PrecomputedSchedule(SingleController):
    """Method that flies the schedule, decided and proven before the flight."""

    key, name, place, proven = "schedule", "Polaris schedule", 2, True
    how = "decided before the flight, looks at nothing"
    reasons = ("scheduled",)

    @property
    def claim(self) -> Claim:
        """Theorem 2."""
        return Claim(self.grid.schedule.guarantee, self.reach)

    def decide(self, observed: Observation) -> Choice:
        """Look the mode up."""
        R, schedule = len(observed.estimate), self.grid.schedule
        step = observed.k * self.grid.nodes // self.grid.clearance.q
        mode, margin = int(schedule.modes[step]), float(schedule.margins[step])
        return Choice(np.full(R, mode), np.full(R, margin), np.zeros(R, dtype=int))
