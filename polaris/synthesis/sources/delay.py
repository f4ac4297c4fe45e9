"""Delay between a measurement and the command that rests on it."""

from dataclasses import dataclass, replace
from functools import partial
from math import ceil

import numpy as np
from scipy.linalg import expm

from ...model.craft import Craft
from ..tracker.loop import Array, Loop
from .source import remembers

WHOLE = 1e-9  # share of a period by which a delay may differ from a whole number of periods and count as one


@dataclass(frozen=True)
class Delay:
    """Commands rest on the state of `seconds` before, predicted under the commands in force since.

    The prediction does not know the additions to the plant meanwhile. The loop remembers these additions:
    one state vector per period under way, and one more per period where the delay is no whole number of
    periods, because a measurement within a period shows the additions before it.
    """

    seconds: float

    @classmethod
    def from_system(cls, system: Craft, h: float) -> "Delay | None":
        """Return the delay where the loop remembers it."""
        return cls(system.timing.delay) if system.timing.delay > 0 and remembers(system) else None

    def extend(self, loop: Loop) -> Loop:
        """Add the delay line."""
        n, h, A = loop.n, loop.h, loop.A
        if loop.navigated is not None:
            raise ValueError("a delay must be added before navigation, whose errors it carries")
        periods = max(ceil(self.seconds / h - WHOLE), 1)
        late = self.seconds - (periods - 1) * h  # the last part of a period, which its measurement misses
        whole = late >= h * (1 - WHOLE)
        late = h if whole else late
        period_map = expm(A * h)
        lines = []  # first state of each line, and the part of a period it remembers
        if not whole:
            loop = loop.split(h - late)
        for early in [False] if whole else [False, True]:
            ages, first = periods - early, loop.N
            for age in range(ages):
                transition = np.zeros((n, loop.N + n))
                if age:
                    transition[:, loop.N - n : loop.N] = period_map
                loop = loop.with_states(transition, sensed=-np.eye(n))
                if age == 0:
                    change = partial(_part, instant=h - late, early=early, n=n)
                    loop = loop.entering(slice(first, first + n), change)
            lines.append((first, ages))
        shown = np.zeros((n, loop.N))
        first, ages = lines[0]
        last = first + (ages - 1) * n
        shown[:, last : last + n] = expm(A * (h - late)) @ np.linalg.matrix_power(expm(-A * h), ages - 1)
        now = [np.zeros((n, n)) for _ in loop.enter]
        if not whole:
            first, ages = lines[1]
            back = expm(-A * late)
            if ages:
                last = first + (ages - 1) * n
                shown[:, last : last + n] = back @ np.linalg.matrix_power(expm(-A * h), ages - 1)
            else:
                now = [back if b <= h - late * (1 - WHOLE) else 0 * back for _, b, _ in loop.enter]
        return replace(loop, carry=expm(A * self.seconds) @ loop.carry, shown=shown, shown_now=tuple(now))


def _part(start: float, end: float, instant: float, early: bool, n: int) -> Array:
    """Map of additions in a part of the period into a line that remembers one side of an instant."""
    before = (start + end) / 2 < instant
    return np.eye(n) if before == early else np.zeros((n, n))
