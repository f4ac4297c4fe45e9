"""Does a backup flight stay in the allowable set? Along the flight, between its samples, and for ever after.

Constraints: phi1 to phi6 and phi9 to phi11 of all deputies and pairs. phi7 and phi8 (passively safe)
are not among them: under a backup law thrusters are assumed to work.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from ...model.hill import free_flight
from ...model.system import Array
from ...rta.received import Received
from ..backup.law import Memoryless, Outlook, fly_backup, periods
from ..constraints.allowable_set import AllowableRows
from ..enmt import semi_axes
from ..vectors import length

PHASES = 360
"""Instants at which a parking orbit is looked at over one revolution."""

SHARE = 0.02
"""Share of the thrust limit below which a flight is taken to have arrived on its parking orbit."""


class FlightCheck:
    """Fly the backup law and bound every constraint from below, for all time.

    Parameters
    ----------
    law : Memoryless
        As `Parking`. Its period is that of the filter which asks.
    horizon : float
        Longest flight until all have settled [s].
    sun_start : float
        Sun angle at t = 0 [rad].
    without : collection of str
        Families of constraints left out.
    """

    def __init__(
        self, law: Memoryless, horizon: float = 600.0, sun_start: float = 0.0, without: Collection[str] = ()
    ) -> None:
        q = law.inspection
        self.law, self.inspection, self.rows = law, q, AllowableRows(q, without)
        self.sun_start, self.steps = sun_start, periods(horizon, law.period)
        self._due, self._proven = np.nan, np.zeros((q.deputies, 6))
        self._times = np.linspace(0.0, 2 * np.pi / q.mean_motion, PHASES + 1)
        self._orbit = free_flight(q.mean_motion, self._times)

    def __call__(self, t: float, x: Array, u: Array | None = None) -> Array:
        """Lower bounds of all constraints over all time, in their units, shape (M,).

        From states (N, 6) at t [s], with a period of the thrust u first, if given; -inf for deputies that
        have not settled within the horizon.
        """
        law, q = self.law, self.inspection
        first = x if u is None else x @ law.motion[0].T + u @ law.motion[1].T
        flight = fly_backup(law, first, self.steps, SHARE)
        states = flight.x if u is None else np.concatenate([x[None], flight.x])
        at = t + law.period * np.arange(len(states))
        value = self.rows(states, q.sun_angle(at, self.sun_start)).h
        margin = value.min(axis=0)
        push = np.sqrt(3) * q.thrust_max / q.mass
        if len(states) > 1:
            margin = np.minimum(margin, self.rows.between(value, states, law.period, push).min(axis=0))
        return np.asarray(np.minimum(margin, self.parked(float(at[-1]), flight.outlook)))

    def proves(self, got: Received, u: Array, good: bool) -> bool:
        """Note what the thrust u (N, 3) leads to; whether the flight after it is proven to stay allowable.

        It is if all states are known and its bounds are good. It also is if it is the rest of one that was
        proven: the bounds are not sharp, and those of a rest may come out lower than those of the whole. A
        rest is known by the deputies being where that flight has them, at the time for which it has them
        there, but for rounding.
        """
        due = abs(got.t - self._due) <= 1e-6 * self.law.period
        rest = due and bool((np.abs(got.x - self._proven) <= 1e-9 * (1 + np.abs(got.x))).all())
        proven = bool(got.known.all()) and (good or rest)
        Phi, Gamma = self.law.motion
        self._due = got.t + self.law.period if proven else np.nan
        self._proven = got.x @ Phi.T + u @ Gamma.T
        return proven

    def parked(self, t: float, outlook: Outlook) -> Array:
        """Lower bounds for ever after the flight has settled at t [s], shape (M,).

        The parking orbit and the sun return to the same after one revolution. Over it the constraints are
        bounded between `PHASES` instants, and lowered by how far a deputy may be from the orbit.
        """
        q, rows = self.inspection, self.rows
        orbit = np.einsum("sij,nj->sni", self._orbit, outlook.ellipse)
        # Free flight returns exactly for these states; rounding and the drift of a state that is not
        # quite on an eNMT are far below a millimetre.
        value = rows(orbit, q.sun_angle(t + self._times, self.sun_start)).h
        least = rows.between(value, orbit, float(self._times[1]), 0.0).min(axis=0)
        # Distances are never below the semi-minor axis, of one orbit or of the difference of two.
        semi_minor = semi_axes(rows.relative(outlook.ellipse), q.mean_motion)[0]
        radius = np.where(rows.second >= 0, q.deputy_separation, q.separation)
        outside = rows.among("chief_separation", "deputy_separation")
        least = np.where(outside, np.maximum(least, semi_minor - radius), least)
        stray = outlook.strays[rows.first] + np.where(rows.second >= 0, outlook.strays[rows.second], 0.0)
        slip = outlook.slips[rows.first]
        lost = np.where(rows.among("speed"), slip + q.nu_1 * stray, stray)
        speed = length(orbit[..., 3:]).max(axis=0)[rows.first]
        with np.errstate(invalid="ignore"):
            lost = np.where(rows.among("velocity"), slip * (2 * speed + slip), lost)
        settled = np.isfinite(lost)
        return np.asarray(np.where(settled, least - np.where(settled, lost, 0.0), -np.inf))
