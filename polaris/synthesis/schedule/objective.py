"""Objective of a schedule, by which the search for references with U in view compares schedules."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..safety.get_safety import Safety
from .rules import Prices, SwitchingRules
from .schedule import Schedule

Mask = NDArray[np.bool_]  # steps that S is meant to fly, shape (K,)
WORSE = 10.0  # how much more a step counts by which a schedule is worse than the printed one


def is_as_good(one: Schedule, other: Schedule, rules: SwitchingRules) -> bool:
    """Return True if a schedule keeps the rules, is safe as long and arrives wherever another one does."""
    first, second = (
        (each.keeps(rules), each.safety.end.until, each.approach.reached is True) for each in (one, other)
    )
    return all(a >= b for a, b in zip(first, second, strict=True))


@dataclass(frozen=True)
class Objective:
    """Objective of a schedule: the time of U, less velocity change and switches, as shares of the horizon.

    Less share than the printed algorithms' schedule, or without errors more velocity change, costs `WORSE`
    times the difference: it is hardly ever preferred. With errors velocity change counts at its price alone.
    """

    rules: SwitchingRules  # weights, prices and budget
    scale: float  # velocity change of S alone [m/s], the unit of the price of velocity change
    share: float  # time under U of the printed algorithms' schedule
    delta_v: float  # its velocity change [m/s]; inf with errors
    until: float  # instant [s] until which it is proven safe

    @classmethod
    def beside(cls, printed: Schedule, rules: SwitchingRules, alone: Safety) -> "Objective":
        """Build the objective of the schedules of one scene, in units of the spending of S `alone`."""
        problem = alone.problem
        largest = problem.K * problem.delta * float(problem.system.u_max.sum()) / problem.system.mass
        scale = max(alone.plan.delta_v, 1e-3 * largest)
        delta_v = printed.delta_v_middle if problem.system.ideal else np.inf
        return cls(rules, scale, printed.share(), delta_v, printed.safety.end.until)

    @property
    def prices(self) -> Prices:
        """Objective of a flight by itself, regardless of the printed algorithms."""
        return self.rules.prices(self.scale)

    def value(self, shares: Mapping[int, float], delta_v: float, switches: int) -> float:
        """Return the value by the prices, less a penalty for losses to the printed algorithms' schedule."""
        loss = max(self.share - sum(share for mode, share in shares.items() if mode), 0.0)
        extra = max(delta_v - self.delta_v, 0.0) / self.scale
        return self.prices(shares, delta_v, switches) - WORSE * (loss + extra)

    def __call__(self, schedule: Schedule) -> tuple[bool, bool, bool, float]:
        """Rank a schedule: the rules allow it, is safe as long as the printed one, arrives; its objective."""
        shares = {mode: schedule.share(mode) for mode in range(len(schedule.controllers))}
        value = self.value(shares, schedule.delta_v_middle, schedule.switches)
        lasts = schedule.safety.end.until >= self.until
        return schedule.keeps(self.rules), lasts, schedule.approach.reached is True, value

    def alone(self, schedule: Schedule, priced: bool) -> tuple[bool, bool, bool, float]:
        """Rank a schedule regardless of the printed one; without prices as the printed algorithms choose."""
        shares = {mode: schedule.share(mode) for mode in range(len(schedule.controllers))}
        costs = (schedule.delta_v_middle, schedule.switches) if priced else (0.0, 0)
        return *self(schedule)[:3], self.prices(shares, *costs)

    def allows(self, mask: Mask) -> bool:
        """Return True if S may fly just these steps, by the dwell time and the cap on switches."""
        edges = np.r_[0, np.flatnonzero(np.diff(mask)) + 1, len(mask)]
        switches = len(edges) - 2
        cap = self.rules.max_switches
        total = switches + (not mask[-1] and switches > 0)
        return bool(np.all(np.diff(edges)[:-1] >= self.rules.min_dwell)) and (cap is None or total <= cap)
