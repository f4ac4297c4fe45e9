"""Filtered flights of many runs at once: exact motion, thrust held for a control period."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from time import perf_counter
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from reach.short_repr import short_repr

from ...model.checks import positive, whole
from ...model.errors import ScenarioError
from ...model.system import Array
from ...rta.one_call import RunTimeFilter
from ...rta.projection import DESIRED, FAILED, FILTERED, SHORT
from ..backup.tube import Uncertainty
from ..constraints.families import Families
from ..filters.explicit import Filtered
from ..inspection import Inspection
from ..vectors import length
from .primary import NoInput, Primary

BACKUP, UNPROVEN = FAILED + 1, FAILED + 2
"""Status of an input, beside those of `polaris.rta.projection`: the backup controller gave it; it did,
and not even that is known to keep the constraints."""


class BatchFilter(Protocol):
    """A filter of R runs at once, as `Centralized` or `Decentralized`, and the constraints that it keeps."""

    families: Families

    def batch(self, x: Array, sun: Array, desired: Array) -> Filtered:
        """Filter inputs of shape (R, N, 3) at states (R, N, 6) and sun angles (R,) [rad]."""


class OneFlight:
    """One flight under a `RunTimeFilter`, made for the sun at its start [rad] and asked every period [s].

    A `BatchFilter` of one run; `families` are the barriers whose values are recorded.
    """

    def __init__(self, start: Callable[[float], RunTimeFilter], families: Families, period: float) -> None:
        self.start, self.families, self.period = start, families, period
        self.filter, self._calls = start(0.0), 0

    def batch(self, x: Array, sun: Array, desired: Array) -> Filtered:
        """Filter inputs of shape (1, N, 3) at states (1, N, 6) and the sun angle (1,) [rad]."""
        if not self._calls:
            self.filter = self.start(float(sun[0]))
        decision = self.filter.filter(self._calls * self.period, x[0], desired[0])
        self._calls += 1
        short = SHORT if decision.status == "short" else FILTERED
        status = np.where(decision.intervened, np.where(decision.on_backup, BACKUP, short), DESIRED)
        if decision.unproven:
            status[:] = UNPROVEN
        return Filtered(decision.u[None], status[None].astype(np.int8), self.families(x, sun))


class SampledErrors:
    """Errors at the edge of their bounds, drawn anew for each period; the same ones for the same seed."""

    def __init__(self, unknown: Uncertainty, inspection: Inspection, seed: int = 0) -> None:
        self.unknown, self.inspection, self._rng = unknown, inspection, np.random.default_rng(seed)

    def _signs(self, shape: tuple[int, ...]) -> Array:
        return self._rng.choice([-1.0, 1.0], shape)

    def estimated(self, x: Array) -> Array:
        """Return the estimates that navigation makes of states (..., 6)."""
        return np.asarray(x + self.unknown.estimate * self._signs(x.shape))

    def acting(self, u: Array) -> Array:
        """Return the force [N] of a period for commanded thrust (..., 3), with errors and the disturbance."""
        q, direction = self.inspection, self._rng.normal(size=u.shape)
        push = self.unknown.disturbance * q.mass * direction / length(direction)[..., None]
        return np.asarray(u + self.unknown.thrusters.error(u) * self._signs(u.shape) + push)


@short_repr
@dataclass(frozen=True, eq=False)
class FlightBatch:
    """R flights of N deputies that are to be flown.

    Parameters
    ----------
    inspection : Inspection
    x : ndarray, shape (R, N, 6)
        Initial states.
    sun : ndarray, shape (R,)
        Sun angles at the start [rad].
    duration, period : float
        Of each flight and of one control period [s]; the period must divide the duration.
    primary : Primary
        By default nobody wants any thrust.
    errors : SampledErrors, optional
        Of estimates, which filter and primary controller act on, of thrusters and of the model.
    """

    inspection: Inspection
    x: Array
    sun: Array
    duration: float = 500.0
    period: float = 1.0
    primary: Primary = field(default_factory=NoInput)
    errors: SampledErrors | None = None


@dataclass(frozen=True, eq=False)
class BatchStep:
    """Control period k of a batch, from t [s] on, as observers see it.

    States x (R, N, 6) and sun angles (R,) [rad] are those at its start. Where the program failed, the
    filtered input is replaced by no thrust. `after` has the states at evenly spaced instants of the period,
    its end among them, shape (B+1, R, N, 6); `seconds` is the wall time of the filter.
    """

    k: int
    t: float
    x: Array
    sun: Array
    desired: Array
    filtered: Filtered
    after: Array
    seconds: float


Observer = Callable[[BatchStep], None]


def whole_periods(duration: float, period: float) -> int:
    """Periods [s] in a duration [s]; a ScenarioError if that is no whole number."""
    count = int(np.rint(positive("duration", duration, "s") / positive("period", period, "s")))
    if not np.isclose(count * period, duration, rtol=1e-9) or count < 1:
        raise ScenarioError("period", period, f"must divide the duration {duration:g} s")
    return count


def fly(flights: FlightBatch, filtering: BatchFilter, *observers: Observer, between: int = 1) -> Array:
    """Fly all runs at once.

    Parameters
    ----------
    flights : FlightBatch
    filtering : BatchFilter
    *observers : callable
        Called with every `BatchStep`, in order.
    between : int
        Instants inside each period handed to the observers.

    Returns
    -------
    ndarray, shape (R, N, 6)
        Final states.
    """
    q, period, x = flights.inspection, flights.period, flights.x
    count, parts = whole_periods(flights.duration, period), whole("between", between, 0) + 1
    moves = [q.discretize(period * (b + 1) / parts) for b in range(parts)]
    for k in range(count):
        t = k * period
        sun, x_hat = q.sun_angle(t, flights.sun), x if flights.errors is None else flights.errors.estimated(x)
        desired = flights.primary(t, x_hat)
        invalid = np.asarray(~np.isfinite(desired).all(axis=2))
        start = perf_counter()
        filtered = filtering.batch(x_hat, sun, np.where(invalid[..., None], 0.0, desired))
        seconds = perf_counter() - start
        filtered.u[filtered.status == FAILED] = 0.0
        filtered.status[invalid] = FAILED
        if flights.errors is not None:
            filtered = replace(filtered, u=flights.errors.acting(filtered.u))
        after = np.stack([x @ Phi.T + filtered.u @ Gamma.T for Phi, Gamma in moves])
        for observe in observers:
            observe(BatchStep(k, t, x, sun, desired, filtered, after, seconds))
        x = after[-1]
    return x


@short_repr
@dataclass(frozen=True, eq=False)
class InspectionRun:
    """One flight of N deputies, with everything that figures show.

    Attributes
    ----------
    inspection : Inspection
    t : ndarray, shape (K+1,)
        Instants at which the filter was asked [s], and the end.
    x : ndarray, shape (K+1, N, 6)
        States.
    sun : ndarray, shape (K+1,)
        Sun angle [rad].
    u, desired : ndarray, shape (K, N, 3)
        Applied (with the errors that act, if any) and desired thrust [N].
    status : ndarray of int, shape (K, N)
        See `polaris.rta.projection`.
    h : ndarray, shape (K, M)
        Values of the barriers, in the order of `Families.family`.
    seconds : ndarray, shape (K,)
        Wall time of the filter in each period [s]; empty if read from files.
    """

    inspection: Inspection
    t: Array
    x: Array
    sun: Array
    u: Array
    desired: Array
    status: NDArray[np.int8]
    h: Array
    seconds: Array = field(default_factory=lambda: np.empty(0))

    @property
    def delta_v(self) -> Array:
        """Spent velocity change of each deputy [m/s] (eq. 25), shape (K+1, N)."""
        steps = np.abs(self.u).sum(axis=2) / self.inspection.mass * np.diff(self.t)[:, None]
        return np.concatenate([np.zeros((1, steps.shape[1])), np.cumsum(steps, axis=0)])


SMALL = 0.02  # share of the thrust limit below which thrust has no sign


def smoothness(u: Array, t: Array, limit: float) -> dict[str, float]:
    """Return the smoothness of thrust (K, N, 3) [N], held from t (K+1,) [s], per deputy, axis and minute.

    ``switches`` of the sign from one period to the next, and ``variation``, the sum of the changes [N].
    """
    u = np.clip(u, -limit, limit)
    signs = np.sign(np.where(np.abs(u) > SMALL * limit, u, 0.0))
    minutes = float(t[-1] - t[0]) / 60
    switches = (signs[1:] * signs[:-1] < 0).sum(axis=0).mean()
    return {
        "switches": float(switches) / minutes,
        "variation": float(np.abs(np.diff(u, axis=0)).sum(axis=0).mean()) / minutes,
    }


def fly_one(flights: FlightBatch, filtering: BatchFilter, *observers: Observer) -> InspectionRun:
    """Fly one run (R = 1) and keep all of it; further observers are as in `fly`."""
    recorder = RunRecorder(flights)
    fly(flights, filtering, recorder, *observers, between=0)
    return recorder.flight()


class RunRecorder:
    """Observer of `fly` that keeps one run of a batch in full, by its number."""

    def __init__(self, flights: FlightBatch, run: int = 0) -> None:
        self.flights, self.run = flights, run
        self.steps: list[tuple[Array, ...]] = []

    def __call__(self, step: BatchStep) -> None:
        """Take in one control period."""
        arrays = (step.x, step.filtered.u, step.desired, step.filtered.status, step.filtered.rows.h)
        parts = (values[self.run].copy() for values in arrays)
        self.steps.append((np.array(step.t), np.array(step.seconds), *parts))
        self.last = step.after[-1, self.run]

    def flight(self) -> InspectionRun:
        """The run."""
        t, seconds, x, u, desired, status, h = (np.stack(values) for values in zip(*self.steps, strict=True))
        t, q = np.append(t, self.flights.duration), self.flights.inspection
        sun = q.sun_angle(t, float(self.flights.sun[self.run]))
        return InspectionRun(q, t, np.concatenate([x, self.last[None]]), sun, u, desired, status, h, seconds)
