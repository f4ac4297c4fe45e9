"""Simplex filters, explicit and implicit: the desired input as it is, or the backup; latched.

Both try the coming period before it is flown. In the explicit filter the desired input passes while the
state stays in the control-invariant set, ``h >= margin``; in the implicit one while, after the period, the
flight under the backup law stays in the allowable set for all time (`FlightCheck`). Otherwise the deputies
that the failing constraints concern are switched to the backup, and stay there (latched). A deputy returns
to its desired input when, for `dwell` seconds without a break, a period of it would have left every
constraint that concerns it at `release` or more. For guarantees see ``docs/inspection-theory.md``, section 6.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from ...model.checks import non_negative, whole
from ...model.system import Array
from ..backup.parking import Memoryless, Parking
from ..constraints.families import Families
from ..inspection import Inspection
from .decision import Backup
from .explicit import Centralized
from .flight_check import FlightCheck
from .latched import Latched
from .received import Received


class Guarded:
    """A backup made safe: a barrier filter about the thrust of a simpler one.

    Parameters
    ----------
    filtering : Centralized
    inner : Backup
        Its thrust is the desired input; where the program fails it is answered as it is.
    sun_start : float
        Sun angle at t = 0 [rad].
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
        self.first, self.second, self.labels = families.first, families.second, families.labels
        size = len(self.labels)
        super().__init__(q, backup, period, np.full(size, margin), np.full(size, release), dwell)
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
    inspection : Inspection
    law : Memoryless, optional
        The backup; default ``Parking(inspection)``. Its period is the filter's.
    horizon : float
        Longest backup flight until all deputies have settled [s].
    release_distance, release_speed : float
        Least values for handing back of distances [m] and of speeds [m/s] (phi9 to phi11: [m^2/s^2]).
    dwell : float
        [s]
    sun_start : float
        Sun angle at t = 0 [rad].
    without : collection of str
        Families of constraints left out.

    Attributes
    ----------
    latched : ndarray of bool, shape (N,)
    log : list of Switch
    """

    def __init__(
        self,
        inspection: Inspection,
        law: Memoryless | None = None,
        horizon: float = 600.0,
        release_distance: float = 2.0,
        release_speed: float = 0.02,
        dwell: float = 30.0,
        sun_start: float = 0.0,
        without: Collection[str] = (),
    ) -> None:
        law = Parking(inspection) if law is None else law
        self.check = FlightCheck(law, horizon, sun_start, without)
        rows = self.check.rows
        self.first, self.second, self.labels = rows.first, rows.second, rows.labels
        release = np.where(
            rows.is_speed,
            non_negative("release_speed", release_speed, "m/s"),
            non_negative("release_distance", release_distance, "m"),
        )
        super().__init__(inspection, law, law.period, np.zeros(len(release)), release, dwell)

    def _try(self, t: float, x: Array, u: Array) -> Array:
        return self.check(t, x, u)

    def _proves(self, got: Received, u: Array, good: bool) -> bool:
        return self.check.proves(got, u, good) or good
