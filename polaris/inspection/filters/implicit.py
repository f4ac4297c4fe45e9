"""Implicit active set invariance filter: safety is that of the flight under a backup law.

Every constraint along that flight, and along the parking orbit on which it ends, gives a condition on the
present input (eq. 7); every answer is tried before it is given. What holds, and what does not, is in
``docs/inspection-theory.md``, section 6.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...model.checks import positive
from ...model.hill import free_flight
from ...model.system import Array
from ...rta.one_call import Answer, CallByCall, named
from ...rta.projection import FILTERED, solve
from ...rta.received import Received
from ..backup.law import BackupFlight, fly_backup, sensitivities
from ..backup.parking import Parking
from .flight_check import FlightCheck

SAMPLES = 40
"""Most samples along the flight for which there is a condition."""

ORBIT = 24
"""Samples along the parking orbit."""


class ImplicitASIF(CallByCall):
    """Nearest input under which the backup flight stays allowable; a `RunTimeFilter`.

    One filter for all deputies, who each fly their own backup; pairs are included.

    Parameters
    ----------
    check : FlightCheck
        Of the backup's flights; its period is the filter's.
    rate : float
        Strengthening ``alpha(g) = rate g`` [1/s].

    Notes
    -----
    ``status``: "desired", "filtered", "backup" (no input satisfies the conditions, or none that passes the
    trial), "coast" (no state known). ``margins`` are lower bounds over all time of every constraint along
    what will be flown if the backup takes over after the period.
    A deputy whose state is not known coasts, and its last good state is propagated for the others; without
    one its rows are left out. One without a desired input is asked to follow the backup.
    """

    def __init__(self, check: FlightCheck, rate: float = 0.1) -> None:
        self.check, self.law, self.inspection = check, check.law, check.inspection
        self.rate, inspection = positive("rate", rate, "1/s"), check.inspection
        super().__init__(inspection, self.law.period)
        times = np.linspace(0.0, 2 * np.pi / inspection.mean_motion, ORBIT, endpoint=False)
        self._times, self._orbit = times, free_flight(inspection.mean_motion, times)

    def conditions(self, t: float, x: Array, flight: BackupFlight) -> tuple[Array, Array, Array]:
        """Rows ``G u >= bound`` at the states x (N, 6) and t [s], for the backup's flight from there.

        G (S, M, N, 3) and bound (S, M), by sample (along the flight, then along the parking orbit) and
        constraint; and the constraints themselves, (S, M).
        """
        q, rows, law = self.inspection, self.check.rows, self.law
        slopes = sensitivities(law, flight.x)
        count = len(flight.x)
        chosen = np.unique(np.linspace(0, count - 1, min(count, SAMPLES)).round().astype(int))
        states, slopes_at = flight.x[chosen], slopes[chosen]
        at = t + law.period * chosen
        if isinstance(law, Parking):
            ends = law.ellipses.inside(flight.x[-1])
            turn = law.ellipses.inside_slope(flight.x[-1]) @ slopes[-1]
            states = np.concatenate([states, np.einsum("sij,nj->sni", self._orbit, ends)])
            slopes_at = np.concatenate([slopes_at, np.einsum("sij,njk->snik", self._orbit, turn)])
            at = np.concatenate([at, t + law.period * (count - 1) + self._times])
        phi = rows(states, q.sun_angle(at, self.check.sun_start))
        along = np.zeros((*phi.h.shape, q.deputies, 6))  # derivative by every deputy's present state
        every = np.arange(len(rows.first))
        along[:, every, rows.first] = np.einsum("smi,smij->smj", phi.gradient, slopes_at[:, rows.first])
        pair = np.flatnonzero(rows.second >= 0)
        along[:, pair, rows.second[pair]] = -np.einsum(
            "smi,smij->smj", phi.gradient[:, pair], slopes_at[:, rows.second[pair]]
        )
        drift = np.einsum("smni,ni->sm", along, x @ q.system.A.T) + phi.change
        return along[..., 3:] / q.mass, -drift - self.rate * phi.h, phi.h

    def _answer(self, got: Received) -> Answer:
        able, every = got.known & got.given, np.ones(len(got.u), dtype=bool)
        counted = got.counted(self.check.rows.first, self.check.rows.second)
        backup = np.where(got.known[:, None], self.law(got.t, got.x), 0.0)
        u, notes = self._filtered(got, np.where(able[:, None], got.u, backup), counted)
        tried = self.check(got.t, got.x, u)
        trouble = counted & ~(tried >= 0)
        on_backup = bool(trouble.any() or notes)
        active = tuple(np.array(self.check.rows.labels)[trouble].tolist())
        if trouble.any():
            notes.append("the backup flight after the filtered input would not stay allowable")
        if on_backup:
            u, tried = backup, self.check(got.t, got.x, backup)
        good = not (counted & ~(tried >= 0)).any()
        unproven = not self.check.proves(got, u, good) and not good
        if unproven:
            notes.append("the backup flight itself is not proven to stay allowable")
        intervened = ~able | got.clipped | (np.abs(u - got.u).max(axis=1) > 0)
        margins = named(self.check.rows.labels, tried, counted)
        none = every & (not got.known.any())
        return Answer(u, intervened, every & on_backup, none, margins, notes, active, unproven=unproven)

    def _filtered(self, got: Received, wanted: Array, counted: NDArray[np.bool_]) -> tuple[Array, list[str]]:
        """Solve the quadratic program; no notes if it has a solution."""
        limit = self.inspection.thrust_max
        flight = fly_backup(self.law, got.x, self.check.steps)
        G, bound, _ = self.conditions(got.t, got.x, flight)
        G = np.where(got.known[:, None], G, 0.0)[:, counted].reshape(-1, wanted.size)
        bound = bound[:, counted].ravel()
        length = np.sqrt((G * G).sum(axis=1))
        needed = bound > -limit * np.abs(G).sum(axis=1)
        G, bound, length = G[needed], bound[needed], np.maximum(length[needed], 1e-12)
        if not np.isfinite(G).all() or not np.isfinite(bound).all():
            return wanted, ["the conditions are not finite"]
        G, bound = G / length[:, None], bound / length
        if (G @ wanted.ravel() >= bound).all():
            return wanted, []
        found, how = solve(G, np.clip(bound, -1e6, 1e6), wanted.ravel(), limit)
        if how != FILTERED or not np.isfinite(found).all():
            return wanted, ["no input satisfies all conditions"]
        return np.where(got.known[:, None], found.reshape(wanted.shape), 0.0), []
