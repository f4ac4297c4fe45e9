"""Simplex filters, explicit and implicit: the desired input as it is, or the backup; latched.

Both try the coming period before it is flown. In the explicit filter the desired input passes while the
state stays in the control-invariant set, ``h >= margin``; in the implicit one while, after the period, the
flight under the backup law stays in the allowable set for all time (`FlightCheck`). Otherwise the deputies
that the failing constraints concern are switched to the backup, and stay there (latched). A deputy returns
to its desired input when, for `dwell` seconds without a break, a period of it would have left every
constraint that concerns it at `release` or more. For guarantees see ``docs/inspection-theory.md``, section 6.
"""

from __future__ import annotations

from abc import abstractmethod

import numpy as np
from numpy.typing import NDArray

from ...model.checks import non_negative, positive, whole
from ...model.errors import ScenarioError
from ...model.system import Array
from ...rta.one_call import Answer, Backup, CallByCall, Switch, named
from ...rta.received import Received
from ..backup.parking import Parking
from ..constraints.families import Families
from ..constraints.table import Table
from .explicit import Centralized
from .flight_check import FlightCheck


class Guarded:
    """A backup made safe: a barrier filter about the thrust of a simpler one.

    The inner one's thrust is the desired input; where the program fails it is answered as it is.
    """

    def __init__(self, filtering: Centralized, inner: Backup, sun_start: float = 0.0) -> None:
        self.filtering, self.inner, self.sun_start = filtering, inner, sun_start

    def __call__(self, t: float, x: Array) -> Array:
        """Thrust [N], shape (N, 3), within the limits, at finite states (N, 6)."""
        wanted = self.inner(t, x)
        sun = self.filtering.families.inspection.sun_angle([t], self.sun_start)
        u = self.filtering.batch(x[None], sun, wanted[None]).u[0]
        limit = self.filtering.families.inspection.thrust_max
        return np.clip(np.where(np.isfinite(u), u, wanted), -limit, limit)


class Latched(CallByCall):
    """Latching, handing back, the log, unknown states; what both filters share.

    A subclass tries thrusts on the constraints that are the rows; margin and release are in their units, one
    for all or of shape (M,). The period and the dwell are in seconds.
    """

    def __init__(
        self,
        rows: Table,
        backup: Backup,
        period: float,
        margin: Array | float,
        release: Array | float,
        dwell: float,
    ) -> None:
        self.rows, self.backup, self.period = rows, backup, positive("period", period, "s")
        self.inspection = rows.inspection
        super().__init__(rows.inspection, self.period)
        if np.any(release < margin):
            raise ScenarioError("release", float(np.min(release)), "must be at least the margin")
        self._margin, self._release = margin, release
        self.dwell = non_negative("dwell", dwell, "s")
        self.latched = np.zeros(self.inspection.deputies, dtype=bool)
        self.log: list[Switch] = []
        self._clear_since = np.full(self.inspection.deputies, np.nan)

    @abstractmethod
    def _try(self, t: float, x: Array, u: Array) -> Array:
        """Least value of each constraint if the thrust u (N, 3) is held for the coming period, shape (M,)."""

    def _proves(self, got: Received, u: Array, good: bool) -> bool:
        """Note the outcome; whether it is known to be safe, be it that the constraints hold (`good`)."""
        return good

    def _answer(self, got: Received) -> Answer:
        notes: list[str] = []
        counted, able = got.counted(self.rows.first, self.rows.second), got.known & got.given
        backup = np.where(got.known[:, None], self._backed_up(self.backup, got, notes), 0.0)
        if not got.steady:
            self._clear_since[:] = np.nan  # nothing has lasted across a break of the clock
        self._hand_back(got, able, backup, counted)
        u, value, active, proven = self._decide(got, able, backup, counted)
        if not proven:
            notes.append("the backup itself does not keep the constraints for certain")
        passed = able & ~self.latched
        none = np.full(len(u), not got.known.any())
        margins = named(self.rows.labels, value, counted)
        return Answer(u, ~passed | got.clipped, ~passed, none, margins, notes, active, unproven=not proven)

    def _decide(
        self, got: Received, able: NDArray[np.bool_], backup: Array, counted: NDArray[np.bool_]
    ) -> tuple[Array, Array, tuple[str, ...], bool]:
        """Switch deputies until the constraints hold, or all are on backup."""
        labels = self.rows.labels
        active: tuple[str, ...] = tuple(f"latched[{i}]" for i in np.flatnonzero(self.latched))
        while True:
            passed = able & ~self.latched
            u = np.where(passed[:, None], got.u, backup)
            value = self._try(got.t, got.x, u)
            bad = counted & ~(value >= self._margin)
            if not bad.any() or not passed.any():
                return u, value, active, self._proves(got, u, not bad.any())
            worst = int(np.flatnonzero(bad)[np.argmin((value - self._margin)[bad])])
            active += tuple(labels[k] for k in np.flatnonzero(bad))
            concerned = self._concerned(bad) & passed
            reason = f"{labels[worst]} would be {value[worst]:.3g}"
            self._switch(concerned if concerned.any() else passed, got.t, "backup", reason)

    def _hand_back(
        self, got: Received, able: NDArray[np.bool_], backup: Array, counted: NDArray[np.bool_]
    ) -> None:
        """Hand back deputies whose desired input has been acceptable for long enough."""
        clear = self.latched & able
        if clear.any():
            value = self._try(got.t, got.x, np.where(able[:, None], got.u, backup))
            clear &= ~self._concerned(counted & ~(value >= self._release))
        since = np.where(np.isnan(self._clear_since), got.t, self._clear_since)
        self._clear_since = np.where(clear, since, np.nan)
        reason = f"all constraints at their release for {self.dwell:g} s"
        self._switch(clear & (got.t - since >= self.dwell), got.t, "desired", reason)

    def _switch(self, who: NDArray[np.bool_], t: float, to: str, reason: str) -> None:
        """Switch some deputies (N,) to ``backup`` or back, and log it."""
        self.latched[who] = to == "backup"
        self._clear_since[who] = np.nan
        self.log += [Switch(t, int(i), to, reason) for i in np.flatnonzero(who)]

    def _concerned(self, chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Deputies of the chosen constraints, shape (N,)."""
        who = np.concatenate([self.rows.first[chosen], self.rows.second[chosen]])
        return np.isin(np.arange(self.inspection.deputies), who)


class ExplicitSimplex(Latched):
    """Passes the desired input while the state stays in the control-invariant set.

    Parameters
    ----------
    families : Families
        The constraints h1 to h11.
    backup : Backup, optional
        Default: ``Guarded(Centralized(families), Parking(...))``.
    period : float
        Time for which an answer is held [s].
    margin, release : float
        Least value of every h, in its unit, for passing and for handing back.
    dwell : float
        [s]
    sun_start : float
        Sun angle at t = 0 [rad].
    looks : int
        Instants in the coming period at which h is evaluated, evenly spaced, its end among them.

    Attributes
    ----------
    latched : ndarray of bool, shape (N,)
    log : list of Switch
    """

    def __init__(
        self,
        families: Families,
        backup: Backup | None = None,
        period: float = 1.0,
        margin: float = 0.0,
        release: float = 0.05,
        dwell: float = 30.0,
        sun_start: float = 0.0,
        looks: int = 2,
    ) -> None:
        q = families.inspection
        if backup is None:
            backup = Guarded(Centralized(families), Parking(q, period=period), sun_start)
        self.families, self.sun_start = families, sun_start
        super().__init__(families, backup, period, margin, release, dwell)
        self._parts = self.period * np.arange(1, whole("looks", looks, 1) + 1) / looks
        self._moves = [q.held(float(part)) for part in self._parts]

    def _try(self, t: float, x: Array, u: Array) -> Array:
        states = np.stack([x @ Phi.T + u @ Gamma.T for Phi, Gamma in self._moves])
        sun = self.inspection.sun_angle(t + self._parts, self.sun_start)
        return np.asarray(self.families(states, sun).h.min(axis=0))


class ImplicitSimplex(Latched):
    """Passes the desired input while the backup flight after it stays in the allowable set.

    Parameters
    ----------
    check : FlightCheck
        Of the flights under its law, which is the backup; its period is the filter's.
    release_distance, release_speed : float
        Least values for handing back of distances [m] and of speeds [m/s] (phi9 to phi11: [m^2/s^2]).
    dwell : float
        [s]

    Attributes
    ----------
    latched : ndarray of bool, shape (N,)
    log : list of Switch
    """

    def __init__(
        self,
        check: FlightCheck,
        release_distance: float = 2.0,
        release_speed: float = 0.02,
        dwell: float = 30.0,
    ) -> None:
        self.check, law = check, check.law
        release = np.where(
            check.rows.is_speed,
            non_negative("release_speed", release_speed, "m/s"),
            non_negative("release_distance", release_distance, "m"),
        )
        super().__init__(check.rows, law, law.period, 0.0, release, dwell)

    def _try(self, t: float, x: Array, u: Array) -> Array:
        return self.check(t, x, u)

    def _proves(self, got: Received, u: Array, good: bool) -> bool:
        return self.check.proves(got, u, good) or good
