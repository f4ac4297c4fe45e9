"""One deputy flown into its fuel limit: what the paper's Fig. 9 shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter

import numpy as np
from numpy.typing import ArrayLike

from ...model.checks import positive, vector
from ...model.errors import ScenarioError
from ...model.system import Array
from ..backup.backup_flight import fly_backup
from ..backup.parking import Law, Parking
from ..filters.fuel import FuelLimit
from ..inspection import Inspection
from .primary import LQR, Phases, Primary

ENDED = 1e-4
"""A predicted flight is followed until no more than this share of the thrust limit will be used."""


@dataclass(frozen=True, eq=False)
class Prediction:
    """A backup flight as it was predicted at some instant and, unless it is the last, not flown.

    Attributes
    ----------
    t : ndarray, shape (J+1,)
        [s]
    x : ndarray, shape (J+1, 6)
        [m, m/s]
    delta_v : ndarray, shape (J+1,)
        Spent by then, from the run's start [m/s].
    """

    t: Array
    x: Array
    delta_v: Array


@dataclass(frozen=True, eq=False)
class FuelRun:
    """A flight of one deputy under `polaris.inspection.filters.fuel.FuelLimit`.

    Attributes
    ----------
    inspection : Inspection
    t : ndarray, shape (K+1,)
        [s]
    x : ndarray, shape (K+1, 6)
        States in Hill's frame [m, m/s].
    u, desired : ndarray, shape (K, 3)
        Applied and desired thrust [N], held over each period.
    delta_v : ndarray, shape (K+1,)
        Spent by each instant [m/s] (eq. 25); ``phi12 = inspection.delta_v_max - delta_v``.
    latched_at : float or None
        When the backup took over [s]; None if it never did.
    reason : str or None
        Why.
    predictions : tuple of Prediction
        Backup flights from the instants asked for, and from that of the switch.
    exhausted : bool
        Thrust was cut because no fuel was left: the limit held, the parking orbit may not be reached.
    slowest_decision, median_decision : float
        Time of the decisions that predicted a flight, those before the switch [s].
    """

    inspection: Inspection
    t: Array
    x: Array
    u: Array
    desired: Array
    delta_v: Array
    latched_at: float | None
    reason: str | None
    predictions: tuple[Prediction, ...]
    exhausted: bool
    slowest_decision: float
    median_decision: float


def wasteful(inspection: Inspection, distance: float = 400.0, swing: float = 400.0) -> Primary:
    """Aggressive LQR that uses as much fuel as it can: outwards to a distance [m] and back, without end.

    Parameters
    ----------
    inspection : Inspection
    distance : float
        Outer target [m]; the inner is a quarter of it.
    swing : float
        Time between the changes of target [s].
    """
    inner, outer = LQR(inspection, distance / 4), LQR(inspection, distance)
    starts = np.arange(0.0, 20_000.0, positive("swing", swing, "s"))
    return Phases(starts.tolist(), [inner if k % 2 == 0 else outer for k in range(len(starts))])


def fly_fuel_limit(
    inspection: Inspection,
    primary: Primary,
    x0: ArrayLike,
    duration: float = 7000.0,
    period: float = 1.0,
    law: Law | None = None,
    keep_clear: bool = True,
    spent: float = 0.0,
    predict_at: Sequence[float] = (),
) -> FuelRun:
    """Fly one deputy under the fuel limit (Fig. 9).

    Parameters
    ----------
    inspection : Inspection
        Of one deputy.
    primary : Primary
        To keep the other constraints until the switch, hand over one whose output is a barrier filter's.
    x0 : array_like, shape (6,)
        Initial state [m, m/s].
    duration, period : float
        [s]; the period must divide the duration.
    law : Law, optional
        Backup law of the same period; default ``Parking``. ``Tracker`` is the paper's.
    keep_clear : bool
        See `polaris.inspection.filters.fuel.FuelLimit`.
    spent : float
        Spent before the start [m/s].
    predict_at : sequence of float
        Instants [s] before the switch at which a backup flight is kept for the figure.
    """
    q = inspection
    if q.deputies != 1:
        raise ScenarioError("deputies", q.deputies, "must be 1")
    count = int(np.rint(positive("duration", duration, "s") / positive("period", period, "s")))
    if count < 1 or not np.isclose(count * period, duration, rtol=1e-9):
        raise ScenarioError("period", period, f"must divide the duration {duration:g} s")
    law = Parking(q, period=period) if law is None else law
    if law.period != period:
        raise ScenarioError("period", period, f"must be the backup law's, {law.period:g} s")
    filtering = FuelLimit(q, law, keep_clear, spent=spent)
    Phi, Gamma = law.motion
    x = np.empty((count + 1, 6))
    x[0] = vector("x0", x0, 6)
    u, desired, delta_v = np.empty((count, 3)), np.empty((count, 3)), np.empty(count + 1)
    delta_v[0] = spent
    times, exhausted, asked = [], False, sorted(predict_at)
    kept: list[Prediction] = []
    latched_at: float | None = None
    for k in range(count):
        t = k * period
        desired[k] = primary(t, x[None, k : k + 1])[0, 0]
        begin = perf_counter()
        decision = filtering.filter(t, x[k : k + 1], desired[k : k + 1])
        if latched_at is None:
            times.append(perf_counter() - begin)
        if latched_at is None and (filtering.latched[0] or (asked and t >= asked[0])):
            kept.append(_predict(law, t, x[k], delta_v[k], filtering.steps))
            asked = [instant for instant in asked if instant > t]
            latched_at = t if filtering.latched[0] else None
        exhausted = exhausted or "phi12[0]" in decision.active
        u[k] = decision.u[0]
        x[k + 1] = Phi @ x[k] + Gamma @ u[k]
        delta_v[k + 1] = filtering.spent[0]
    return FuelRun(
        q,
        np.asarray(np.arange(count + 1) * period, dtype=float),
        x,
        u,
        desired,
        delta_v,
        latched_at,
        filtering.log[0].reason if filtering.log else None,
        tuple(kept),
        exhausted,
        max(times),
        float(np.median(times)),
    )


def _predict(law: Law, t: float, x: Array, spent: float, steps: int) -> Prediction:
    state = x[None]
    flight = fly_backup(law, state, law.start(state), steps, ENDED)
    each = np.abs(flight.u).sum(axis=(1, 2)) * law.period / law.inspection.mass
    instants = np.asarray(t + np.arange(len(flight.x)) * law.period, dtype=float)
    return Prediction(instants, flight.x[:, 0], spent + np.append(0.0, np.cumsum(each)))
