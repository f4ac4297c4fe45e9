"""The schedule of Algorithm 2: who flies when was decided, and proven, before the flight."""

from __future__ import annotations

import numpy as np

from ..method import Choice, Claim, Method, Seen


class Precomputed(Method):
    """Looks at no measurement."""

    key, name, place, proven = "schedule", "Polaris schedule", 2, True
    how = "decided before the flight, looks at nothing"
    reasons = ("scheduled",)
    delayed = False

    @property
    def reach(self) -> str:
        """What happens at the end."""
        return self.grid.schedule.safety.end.reason

    @property
    def claim(self) -> Claim:
        """Theorem 2."""
        return Claim(self.grid.schedule.guarantee, self.reach)

    def decide(self, seen: Seen) -> Choice:
        """Look the mode up."""
        R, schedule = len(seen.estimate), self.grid.schedule
        step = seen.k * self.grid.nodes // self.grid.clearance.q
        mode, margin = int(schedule.modes[step]), float(schedule.margins[step])
        return Choice(np.full(R, mode), np.full(R, margin), np.zeros(R, dtype=int))
