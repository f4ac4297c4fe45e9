"""The fuel limit: a latched switching filter (eq. 39) that keeps enough fuel to reach a parking orbit.

Fuel is counted as ``delta_v = integral (|F_x| + |F_y| + |F_z|) / m dt`` (eq. 25); thrust is held for a
period, so that the integral is a sum. With b(x) an upper bound on all that the backup law ever spends from
the state x, and x' the state after a period D of the desired input u, that input passes only if

    spent + norm_1(u) D / m + b(x') <= delta_v_max.                                              (*)

Why this keeps the limit is proven in ``docs/inspection-theory.md``, section 7.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...model.errors import ScenarioError
from ...model.system import Array
from ...rta.filter_input import FilterInput, listed
from ...rta.one_call import CallByCall, RawDecision, Switch
from ..backup.tracker import BackupFlight, BackupTracker, fly_backup, periods


class FuelLimit(CallByCall):
    """Switching filter for the fuel limit; follows `RunTimeFilter`.

    Each deputy is on its own. The desired input passes as long as, after one period of it, the backup law
    can still reach and keep a parking orbit within the limit; otherwise the backup takes over, for good.

    Parameters
    ----------
    law : BackupTracker
        Backup law. Its period is the filter's: call it once per period.
    keep_clear : bool
        The predicted flight must also keep away from the chief; the printed condition has fuel only.
    horizon : float
        Longest backup flight that is predicted [s]; one that has not settled by then does not count.
    spent : array_like, shape (N,) or float
        Spent before the first call [m/s].

    Attributes
    ----------
    spent : ndarray, shape (N,)
        Delta-v of all inputs answered so far [m/s], each held for one period.
    latched : ndarray of bool, shape (N,)
    log : list of Switch
    predicted : BackupFlight or None
        The flight on which the last decision rests: of all deputies, from the end of the coming period.

    Notes
    -----
    What each answer of `filter` says: ``status`` is "desired", "filtered" (clipped to the thrust limits),
    "backup" if any deputy is on backup, "coast" if none thrusts because states are unknown or fuel is
    exhausted. ``margins`` hold ``phi12[i]``, the fuel left [m/s], and ``reserve[i]``, what is left of it
    after the coming period and the backup flight (nan once latched).

    A deputy whose state is not known coasts. One without a desired input is on backup for that period.
    Call once per period: a late call is counted with its fuel, recorded, and starts the backup law anew.
    Beyond the proof are late calls and unknown states; the limit itself is kept through the last rule.
    """

    def __init__(
        self, law: BackupTracker, keep_clear: bool = True, horizon: float = 3000.0, spent: ArrayLike = 0.0
    ) -> None:
        q = law.inspection
        self.inspection, self.law, self.keep_clear = q, law, keep_clear
        self.steps = periods(horizon, self.law.period)
        before = np.asarray(spent, dtype=float)
        if before.shape not in ((), (q.deputies,)) or not (np.isfinite(before) & (before >= 0)).all():
            raise ScenarioError("spent", spent, f"must be one or {q.deputies} finite numbers >= 0 [m/s]")
        self.spent = np.array(np.broadcast_to(before, (q.deputies,)))
        self.latched = np.zeros(q.deputies, dtype=bool)
        self.log: list[Switch] = []
        self.predicted: BackupFlight | None = None
        super().__init__(q, self.law.period)
        self._on_backup, self._memory = np.zeros(q.deputies, dtype=bool), law.start(np.zeros((q.deputies, 6)))
        self._due = np.inf
        self._applied = np.zeros((q.deputies, 3))

    def _answer(self, call: FilterInput) -> RawDecision:
        q, valid = self.inspection, call.known & call.given
        self._count_delay(call.t)
        reserve = np.full(len(call.x), np.nan)
        unlatched = np.flatnonzero(~self.latched & valid)
        if len(unlatched):
            reserve[unlatched], reasons = self._look_ahead(call, unlatched)
            for i, reason in zip(unlatched, reasons, strict=True):
                if reason:
                    self.latched[i] = True
                    self.log.append(Switch(call.t, int(i), "backup", reason))
        u = self._thrust(call)
        allowed = self._affordable(u)
        exhausted = (allowed < 1) & call.known
        self._applied = u = u * allowed[:, None]
        self.spent = self.spent + np.abs(u).sum(axis=1) * self.law.period / q.mass
        latched = ~valid | self.latched
        margins = {f"phi12[{i}]": float(q.delta_v_max - self.spent[i]) for i in range(q.deputies)}
        margins |= {f"reserve[{i}]": float(reserve[i]) for i in range(q.deputies)}
        active = tuple(f"latched[{i}]" for i in np.flatnonzero(self.latched))
        active += tuple(f"phi12[{i}]" for i in np.flatnonzero(exhausted))
        notes = [f"fuel exhausted: deputy {listed(exhausted)}"] if exhausted.any() else []
        intervened = latched | call.clipped | exhausted
        return RawDecision(u, intervened, latched, exhausted | ~call.known, margins, notes, active)

    def _look_ahead(self, call: FilterInput, deputies: NDArray[np.intp]) -> tuple[Array, list[str]]:
        """Condition (*) for some: reserves [m/s], and why the backup must take over ('' if it need not)."""
        q, D = self.inspection, self.law.period
        Phi, Gamma = self.law.motion
        x, u = call.x[deputies], call.u[deputies]
        after = x @ Phi.T + u @ Gamma.T
        flight = self.predicted = fly_backup(self.law, after, self.steps)
        cost = np.abs(u).sum(axis=1) * D / q.mass
        reserve = q.delta_v_max - self.spent[deputies] - cost - flight.delta_v(q.mass, D)
        nearest = clearance(flight, x, self.law) if self.keep_clear else np.full(len(x), np.inf)
        reasons, coming_flight = [], "the backup flight after this period"
        for surplus, gap, settled in zip(reserve, nearest, flight.outlook.settled, strict=True):
            if not settled:
                reasons.append("the backup flight does not settle within the horizon")
            elif surplus < 0:
                reasons.append(f"fuel: {coming_flight} would exceed the limit by {-surplus:.3g} m/s")
            elif gap < 0:
                reasons.append(f"chief: {coming_flight} would come {-gap:.3g} m too near")
            else:
                reasons.append("")
        return reserve, reasons

    def _count_delay(self, t: float) -> None:
        """Fuel of the time [s] by which this call is late; an early one was counted in full."""
        D = self.law.period
        late = t - self._due if self._due < np.inf else 0.0
        if late > 0:
            self.spent = self.spent + np.abs(self._applied).sum(axis=1) * late / self.inspection.mass
        if abs(late) > 1e-6 * D:
            self._on_backup = np.zeros_like(self._on_backup)
        self._due = t + D

    def _thrust(self, call: FilterInput) -> Array:
        """Desired, backup, or none where the state is not known."""
        passed = call.known & call.given & ~self.latched
        backed = call.known & ~passed
        memory = np.where(self._on_backup[:, None], self._memory, self.law.start(call.x))
        backup, self._memory = self.law.thrust(call.x, memory)
        self._on_backup = backed  # of the others, the backup takes over anew when it is needed next
        return np.where(passed[:, None], call.u, np.where(backed[:, None], backup, 0.0))

    def _affordable(self, u: Array) -> Array:
        """Share of a thrust that the fuel allows, shape (N,)."""
        q = self.inspection
        cost = np.abs(u).sum(axis=1) * self.law.period / q.mass
        remaining = np.maximum(q.delta_v_max - self.spent, 0.0) * (1 - 1e-12)
        return np.where(cost > remaining, remaining / np.where(cost > 0, cost, 1.0), 1.0)


def clearance(flight: BackupFlight, x: Array, law: BackupTracker) -> Array:
    """Lower bound on the distance from the chief, less the separation [m], over all time; shape (N,).

    From the states x (N, 6) through one period of thrust, along the flight after it, and
    for ever after. Between two samples a position is at least ``(r_k + r_{k+1} - length) / 2`` away, where
    the path's length is at most the period times the larger speed at its ends and half of what the
    acceleration adds.
    """
    q, period = law.inspection, law.period
    states = np.concatenate([x[None], flight.x])
    distance = np.linalg.norm(states[..., :3], axis=-1)
    speed = np.linalg.norm(states[..., 3:], axis=-1)
    fastest = np.maximum(speed[1:], speed[:-1])
    farthest = np.maximum(distance[1:], distance[:-1])
    n = q.mean_motion
    # Relative acceleration of free motion at most 3 n^2 r + 2 n v; a tenth more for its change meanwhile.
    push = np.sqrt(3) * q.thrust_max / q.mass + 1.1 * (3 * n**2 * farthest + 2 * n * fastest)
    length = period * (fastest + push * period / 2)
    between = (distance[1:] + distance[:-1] - length) / 2
    return np.asarray(np.minimum(between.min(axis=0), flight.outlook.distance) - q.separation)
