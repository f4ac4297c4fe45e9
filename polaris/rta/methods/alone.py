"""One controller from beginning to end."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ..decision_grid import DecisionGrid
from ..method import Choice, Claim, Method, Seen


class Alone(Method):
    """A controller that nothing relieves."""

    reasons = ("flies alone",)
    delayed = False
    mode: ClassVar[int]

    def decide(self, seen: Seen) -> Choice:
        """Always the same."""
        R = len(seen.estimate)
        return Choice(np.full(R, self.mode), np.full(R, np.nan), np.zeros(R, dtype=int))


class SafetyAlone(Alone):
    """S throughout: safe from all of Theta."""

    key, name, place, mode, proven = "safety", "S alone", 0, 0, True
    how = "S flies throughout"

    @property
    def reach(self) -> str:
        """What happens at the end."""
        return self.grid.schedule.safety.end.reason

    @property
    def claim(self) -> Claim:
        """That of Algorithm 1."""
        return Claim(self.grid.schedule.safety.guarantee, self.reach)


class ExperimentalAlone(Alone):
    """The preferred experimental controller throughout."""

    key, name, place, mode = "experimental", "U alone", 1, 1
    how = "U flies throughout"
    reach = "nothing keeps the experimental controller away from unsafe sets"

    def __init__(self, grid: DecisionGrid) -> None:
        super().__init__(grid)
        self.name = f"U alone ({grid.controllers[1].name})"
