"""Valves that stick, and the spans of time in which nozzles are open."""

from dataclasses import dataclass

import numpy as np

EXACT = 1e-8
"""Instants closer than this count as equal [s]: Basilisk counts in nanoseconds."""


@dataclass(frozen=True)
class Stuck:
    """Valve stuck open or shut until it is isolated."""

    kind: str  # "stuck_on" or "stuck_off"
    nozzle: int
    begins: float  # [s]
    isolated: int  # tick at which that is done

    def windows(self, tick: int, h: float, on: np.ndarray) -> list[tuple[int, float, float]]:
        """Return nozzles and the spans [s] of a period in which they are open, commanded on-times (N,)."""
        spans = [(j, (h - each) / 2, (h + each) / 2) for j, each in enumerate(on.tolist()) if each > 0]
        first, last = max(self.begins - tick * h, 0.0), min((self.isolated - tick) * h, h)
        if first >= last:
            return spans
        others = [each for each in spans if each[0] != self.nozzle]
        openings = [(a, b) for j, a, b in spans if j == self.nozzle]
        openings = [part for a, b in openings for part in ((a, min(b, first)), (max(a, last), b))]
        openings += [(first, last)] * (self.kind == "stuck_on")
        return others + [(self.nozzle, a, b) for a, b in openings if b > a + EXACT]
