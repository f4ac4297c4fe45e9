"""One deputy flown into its fuel limit: what the paper's Fig. 9 shows."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from time import perf_counter

import numpy as np
from numpy.typing import ArrayLike

from reach.short_repr import short_repr

from ...model.checks import vector
from ...model.errors import ScenarioError
from ...model.system import Array
from ..backup.tracker import BackupTracker, fly_backup
from ..filters.fuel import FuelLimit
from ..inspection import Inspection
from .primary import Primary
from .simulation import whole_periods

ENDED = 1e-4  # a predicted flight is followed until no more than this share of the thrust limit will be used


@dataclass(frozen=True, eq=False)
class Prediction:
    """A backup flight as it was predicted at some instant and, unless it is the last, not flown.

    Instants t (J+1,) [s], states x (J+1, 6), and delta_v (J+1,) spent by then, from the run's start [m/s].
    """

    t: Array
    x: Array
    delta_v: Array


@short_repr
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
        Time at which the backup took over [s]; None if it never did.
    predictions : tuple of Prediction
        Backup flights from the instants asked for, and from that of the switch.
    reason : str or None
        Reason why it did; not known of a run read from files, nor what follows.
    exhausted : bool
        Thrust was cut because no fuel was left: the limit held, the parking orbit may not be reached.
    seconds : ndarray
        Wall time of each decision that predicted a flight, those before the switch [s].
    """

    inspection: Inspection
    t: Array
    x: Array
    u: Array
    desired: Array
    delta_v: Array
    latched_at: float | None
    predictions: tuple[Prediction, ...]
    reason: str | None = None
    exhausted: bool = False
    seconds: Array = field(default_factory=lambda: np.empty(0))


def fly_fuel_limit(
    filtering: FuelLimit,
    primary: Primary,
    x0: ArrayLike,
    duration: float = 7000.0,
    predict_at: Sequence[float] = (),
) -> FuelRun:
    """Fly one deputy under the fuel limit (Fig. 9).

    Parameters
    ----------
    filtering : FuelLimit
        For one deputy; its backup law's period is the flight's.
    primary : Primary
        To keep the other constraints until the switch, hand over one whose output is a barrier filter's.
    x0 : array_like, shape (6,)
        Initial state [m, m/s].
    duration : float
        [s]; the period must divide it.
    predict_at : sequence of float
        Instants [s] before the switch at which a backup flight is kept for the figure.
    """
    q, law = filtering.inspection, filtering.law
    if q.deputies != 1:
        raise ScenarioError("deputies", q.deputies, "must be 1")
    count, (Phi, Gamma) = whole_periods(duration, law.period), law.motion
    t = np.asarray(np.arange(count + 1) * law.period, dtype=float)
    x, u, desired = np.empty((count + 1, 6)), np.empty((count, 3)), np.empty((count, 3))
    x[0], delta_v = vector("x0", x0, 6), np.empty(count + 1)
    delta_v[0] = filtering.spent[0]
    instants, exhausted = sorted(predict_at), False
    times: list[float] = []
    flights: list[Prediction] = []
    for k in range(count):
        desired[k], before = primary(t[k], x[None, k : k + 1])[0, 0], bool(filtering.latched[0])
        begin = perf_counter()
        decision = filtering.filter(t[k], x[k : k + 1], desired[k : k + 1])
        if not before:
            times.append(perf_counter() - begin)
        if not before and (filtering.latched[0] or (instants and t[k] >= instants[0])):
            flights.append(_predict(law, t[k], x[k], delta_v[k], filtering.steps))
            instants = [instant for instant in instants if instant > t[k]]
        exhausted = exhausted or "phi12[0]" in decision.active
        u[k] = decision.u[0]
        x[k + 1] = Phi @ x[k] + Gamma @ u[k]
        delta_v[k + 1] = filtering.spent[0]
    t_latch, reason = (filtering.log[0].t, filtering.log[0].reason) if filtering.log else (None, None)
    return FuelRun(q, t, x, u, desired, delta_v, t_latch, tuple(flights), reason, exhausted, np.array(times))


def _predict(law: BackupTracker, t: float, x: Array, delta_v: float, steps: int) -> Prediction:
    flight = fly_backup(law, x[None], steps, ENDED)
    each = np.abs(flight.u).sum(axis=(1, 2)) * law.period / law.inspection.mass
    instants = np.asarray(t + np.arange(len(flight.x)) * law.period, dtype=float)
    return Prediction(instants, flight.x[:, 0], delta_v + np.append(0.0, np.cumsum(each)))
