"""When commands take effect: the delay since the measurement they rest on, missed periods, clocks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .errors import ScenarioError


@dataclass(frozen=True)
class Timing:
    """What lies between a measurement and the thrust that answers it (docs/theory.md, Lemma 25).

    Controllers act on the state as it is predicted for the instant at which their command takes effect.

    Parameters
    ----------
    delay : float
        From a measurement until the command that rests on it takes effect [s].
    missed : int
        Periods in a row in which there may be no new measurement.
    clock : float
        How far the schedule's clock may be from that of the unsafe sets [s].
    measured : tuple of float
        Bounds on the errors of the measured states, before prediction.
    """

    delay: float = 0.0
    missed: int = 0
    clock: float = 0.0
    measured: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        sizes = (self.delay, self.missed, self.clock, *self.measured)
        if not all(np.isfinite(size) and size >= 0 for size in sizes):
            raise ScenarioError("timing", sizes, "must be finite numbers >= 0")

    @property
    def predicts(self) -> bool:
        """Whether controllers act on a prediction."""
        return self.delay > 0 or self.missed > 0
