"""What can go wrong in flight: families of faults, and calls of U that cannot end the flight."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ...model.system import Array
from ..received import commanded

FAMILIES = ("clock", "missed", "measurement", "estimate", "controller", "monitor", "log", "rule")
"""Where faults come from; ``rule``: no fault of its own, but S is kept (dwell, latch, re-acquisition)."""

HARMLESS = ("missed", "log")
"""Families that do not keep U from flying: what they tell of is over, and no premise of the proof."""


class Fault(NamedTuple):
    """One fault: of one of `FAMILIES`, and a text that begins alike for the same kind of fault."""

    family: str
    text: str

    def __str__(self) -> str:
        return f"{self.family}: {self.text}"

    @property
    def harmless(self) -> bool:
        """Whether U may fly all the same."""
        return self.family in HARMLESS


class Guard:
    """Calls U, within a budget of wall time [s], checks its command, and collects its faults."""

    def __init__(self, u_max: Array, budget: float, timer: Callable[[], float]) -> None:
        self.u_max, self._budget, self._timer = u_max, budget, timer
        self.faults: list[Fault] = []

    def command(self, law: Callable[..., Any], *arguments: Any) -> Array | None:
        """Command of U, clipped to the limits [N]; None if it is at fault, and S must fly at once.

        Nothing that U raises gets through, ``SystemExit`` and ``KeyboardInterrupt`` included: an interrupt
        from the keyboard during a call counts as a fault of U. Reading what it returns belongs to the call,
        and to its time budget.
        """
        begun = self._timer()
        u, wrong = commanded(law, arguments, self.u_max.shape, BaseException)
        late = self._timer() - begun > self._budget  # an answer may be worked out only when it is read
        if u is None or wrong:
            return self._refused(wrong)
        if late:
            return self._refused("over its time budget")
        return np.asarray(np.clip(u, -self.u_max, self.u_max))

    def _refused(self, text: str) -> Array | None:
        self.faults.append(Fault("controller", text))
        return None

    def taken(self) -> list[Fault]:
        """The faults since the last time."""
        found, self.faults = self.faults, []
        return found
