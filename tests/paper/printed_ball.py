"""Recoverable balls of eq. 12 as printed: the thrust limits are left out, so they are unsound."""

from dataclasses import dataclass

import numpy as np

from polaris.synthesis.safety.ball_sets import BallSets


@dataclass(frozen=True, eq=False)
class PrintedBall(BallSets):
    """One ball for all time, from the smallest room of the unsafe sets alone."""

    @property
    def _clearance(self):
        clearance = self.clearance.limits.available.min(axis=0)
        clearance[:, self.clearance.limits.facets :] = np.inf
        return clearance

    def _decayed(self, count):
        return np.ones(count)  # max exp(-beta (tau - t)) over tau >= t, by which eq. 12 divides

    @property
    def _radii(self):
        return np.full(len(self.allowed), self.allowed.min())


def take_printed_balls(monkeypatch):
    """Let the synthesis take the printed balls for recoverable sets, whatever the scenario asks for."""
    monkeypatch.setattr(
        "polaris.synthesis.safety.get_safety.get_recover",
        lambda kind, clearance, bounds: PrintedBall(clearance, bounds),
    )
