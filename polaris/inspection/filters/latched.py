"""Latched switching between the desired input and a backup: what the two simplex filters have in common."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np
from numpy.typing import NDArray

from ...model.checks import non_negative, positive
from ...model.errors import ScenarioError
from ...model.system import Array
from ..inspection import Inspection
from .decision import Answer, Backup, CallByCall, Switch, named
from .received import Received


class Latched(CallByCall):
    """Latching, handing back, the log, unknown states; see `polaris.inspection.filters.simplex`.

    A subclass provides the constraints: `first`, `second`, `labels`, and `_try`.
    """

    first: NDArray[np.intp]
    second: NDArray[np.intp]
    labels: tuple[str, ...]

    def __init__(
        self,
        inspection: Inspection,
        backup: Backup,
        period: float,
        margin: Array,
        release: Array,
        dwell: float,
    ) -> None:
        self.backup, self.period = backup, positive("period", period, "s")
        super().__init__(inspection, self.period)
        if (release < margin).any():
            raise ScenarioError("release", float(release.min()), "must be at least the margin")
        self._margin, self._release = margin, release
        self.dwell = non_negative("dwell", dwell, "s")
        self.latched = np.zeros(inspection.deputies, dtype=bool)
        self.log: list[Switch] = []
        self._clear_since = np.full(inspection.deputies, np.nan)

    @abstractmethod
    def _try(self, t: float, x: Array, u: Array) -> Array:
        """Least value of each constraint if the thrust u (N, 3) is held for the coming period, shape (M,)."""

    def _answer(self, got: Received) -> Answer:
        notes: list[str] = []
        counted, able = got.counted(self.first, self.second), got.known & got.given
        backup = np.where(got.known[:, None], self._backed_up(self.backup, got, notes), 0.0)
        if not got.steady:
            self._clear_since[:] = np.nan  # nothing has lasted across a break of the clock
        self._hand_back(got, able, backup, counted)
        u, value, active, proven = self._decide(got, able, backup, counted)
        if not proven:
            notes.append("the backup itself does not keep the constraints for certain")
        passed = able & ~self.latched
        none = np.full(len(u), not got.known.any())
        margins = named(self.labels, value, counted)
        return Answer(u, ~passed | got.clipped, ~passed, none, margins, notes, active, unproven=not proven)

    def _decide(
        self, got: Received, able: NDArray[np.bool_], backup: Array, counted: NDArray[np.bool_]
    ) -> tuple[Array, Array, tuple[str, ...], bool]:
        """Switch deputies until the constraints hold, or all are on backup."""
        active: tuple[str, ...] = tuple(f"latched[{i}]" for i in np.flatnonzero(self.latched))
        while True:
            passed = able & ~self.latched
            u = np.where(passed[:, None], got.u, backup)
            value = self._try(got.t, got.x, u)
            bad = counted & ~(value >= self._margin)
            if not bad.any() or not passed.any():
                return u, value, active, self._proves(got, u, not bad.any())
            worst = int(np.flatnonzero(bad)[np.argmin((value - self._margin)[bad])])
            active += tuple(self.labels[k] for k in np.flatnonzero(bad))
            concerned = self._concerned(bad) & passed
            reason = f"{self.labels[worst]} would be {value[worst]:.3g}"
            for i in np.flatnonzero(concerned if concerned.any() else passed):
                self.latched[i] = True
                self._clear_since[i] = np.nan
                self.log.append(Switch(got.t, int(i), "backup", reason))

    def _proves(self, got: Received, u: Array, good: bool) -> bool:
        """Note the outcome; whether it is known to be safe, be it that the constraints hold (`good`)."""
        return good

    def _hand_back(
        self, got: Received, able: NDArray[np.bool_], backup: Array, counted: NDArray[np.bool_]
    ) -> None:
        """Hand back deputies whose desired input has been acceptable for long enough."""
        asking = self.latched & able
        self._clear_since[~asking] = np.nan
        if not asking.any():
            return
        wish = np.where(able[:, None], got.u, backup)
        clear = asking & ~self._concerned(counted & ~(self._try(got.t, got.x, wish) >= self._release))
        self._clear_since[~clear] = np.nan
        begun = np.isnan(self._clear_since)
        self._clear_since = np.where(clear & begun, got.t, self._clear_since)
        for i in np.flatnonzero(clear & (got.t - self._clear_since >= self.dwell)):
            self.latched[i] = False
            self._clear_since[i] = np.nan
            reason = f"all constraints at their release for {self.dwell:g} s"
            self.log.append(Switch(got.t, int(i), "desired", reason))

    def _concerned(self, chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Deputies of the chosen constraints, shape (N,)."""
        out = np.zeros(self.inspection.deputies, dtype=bool)
        out[self.first[chosen]] = True
        out[self.second[chosen & (self.second >= 0)]] = True
        return out
