"""Filters that answer call by call, in the flight of a scenario: a batch of one run."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...model.system import Array
from ...rta.one_call import RunTimeFilter
from ...rta.projection import DESIRED, FAILED, FILTERED, SHORT
from ..constraints.families import Families
from .explicit import Filtered

BACKUP, UNPROVEN = FAILED + 1, FAILED + 2
"""How an input came about, beside those of `polaris.rta.projection`: the backup controller gave it; it did,
and not even that is known to keep the constraints."""


class OneFlight:
    """One flight under a `RunTimeFilter`, which is asked at the start of every period.

    Parameters
    ----------
    start : callable
        Makes the filter for an angle of the sun at t = 0 [rad].
    families : Families
        The barriers whose values are recorded.
    period : float
        [s]
    """

    def __init__(self, start: Callable[[float], RunTimeFilter], families: Families, period: float) -> None:
        self.start, self.families, self.period = start, families, period
        self.filter, self._calls = start(0.0), 0

    def batch(self, x: Array, sun: Array, desired: Array) -> Filtered:
        """Filter inputs of shape (1, N, 3) at states (1, N, 6) and the sun angle (1,) [rad]."""
        if not self._calls:
            self.filter = self.start(float(sun[0]))
        decision = self.filter.filter(self._calls * self.period, x[0], desired[0])
        self._calls += 1
        short = SHORT if decision.status == "short" else FILTERED
        status = np.where(decision.intervened, np.where(decision.on_backup, BACKUP, short), DESIRED)
        if decision.unproven:
            status[:] = UNPROVEN
        return Filtered(decision.u[None], status[None].astype(np.int8), self.families(x, sun))
