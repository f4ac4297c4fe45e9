"""One controller throughout, and the precomputed schedule: methods that look at no measurement."""

from __future__ import annotations

import numpy as np

from .method import Choice, Claim, Memoryless, Seen
from .scene import Scene


class Alone(Memoryless):
    """S or U from beginning to end.

    Parameters
    ----------
    scene : Scene
    mode : int
        0 is S.
    """

    reasons: tuple[str, ...] = ("flies alone",)
    delayed = False

    def __init__(self, scene: Scene, mode: int) -> None:
        super().__init__(scene)
        self.mode = mode
        self.key = "safety" if mode == 0 else "experimental"
        self.name = "S alone" if mode == 0 else f"U alone ({scene.controllers[mode].name})"

    @property
    def claim(self) -> Claim:
        """S is safe from all of Theta; U promises nothing."""
        safety = self.scene.schedule.safety
        if self.mode == 0:
            return Claim(safety.guarantee, safety.end.reason)
        return Claim("none", "nothing keeps the experimental controller away from unsafe sets")

    def decide(self, seen: Seen) -> Choice:
        """Always the same."""
        R = len(seen.estimate)
        return Choice(np.full(R, self.mode), np.full(R, np.nan), np.zeros(R, dtype=int))


class Precomputed(Memoryless):
    """The schedule of Algorithm 2: who flies when was decided, and proven, before the flight."""

    key = "schedule"
    name = "Polaris schedule"
    reasons: tuple[str, ...] = ("scheduled",)
    delayed = False

    @property
    def claim(self) -> Claim:
        """Theorem 2."""
        schedule = self.scene.schedule
        return Claim(schedule.guarantee, schedule.safety.end.reason)

    def decide(self, seen: Seen) -> Choice:
        """Look the mode up."""
        R, schedule = len(seen.estimate), self.scene.schedule
        step = seen.k * self.scene.nodes // self.scene.clearance.q
        mode, margin = int(schedule.modes[step]), float(schedule.margins[step])
        return Choice(np.full(R, mode), np.full(R, margin), np.zeros(R, dtype=int))
