"""Observers, delays, missed periods and predictions flown for real: estimates are worked out on board."""

from math import isclose

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from ..model.craft import Array, Craft
from ..model.errors import ScenarioError
from ..model.estimates.prediction import add_pulses, prediction_error
from ..synthesis.sources.source import remembers
from .integration import Integrator

PAST = 100  # periods before the start whose noise counts, where an observer has long been at work


class Predicting(Integrator):
    """A flight whose controllers predict the state from measurements that are late.

    `eta` holds errors of predictions, each within its bound; scaled down they are those of measurements.
    Where a measurement would lie before the start, the prediction is off by them as they are. A delay is
    flown as the nearest whole number of steps of the integration.
    An observer, if there is one, filters measurements, each off by its bound, with the sign of `eta` there;
    before the start it has made its first estimate, and the model has held since.
    """

    ages: Array  # periods for which a prediction has had no new measurement, (nodes, R)
    late: Array | None  # by how many steps a command comes late, (nodes, R), where that is drawn
    error_share: Array  # largest errors of predictions so far, as shares of their bounds, (n,)
    filtered: Array  # an observer's estimates, (R, n), since how many periods without a measurement, (R,)
    since: NDArray[np.int_]
    measured: int  # and of which step they are

    drawn = False

    def begin(self, runs: int) -> None:
        """Begin; where nothing has been drawn, as many periods are missed as may be, and nothing is late."""
        super().begin(runs)
        if not self.drawn:
            self.prepare(runs, None)
        delay = self.system.timing.delay
        if self.code is not None and self.code.tables.seen and not isclose(self.lag * self.dt, delay):
            rule = f"must be of whole steps of {self.dt:g} s where flight code has the observer"
            raise ScenarioError("timing.delay_s", delay, rule)

    def prepare(self, runs: int, rng: np.random.Generator | None) -> None:
        """Draw which periods are missed: each with even chance, up to as many in a row as may be."""
        system, timing, self.thrusters = self.system, self.system.timing, self.system.on_time
        nodes = len(self.modes) * self.q
        self.lag, self.error_share = round(timing.delay / self.dt), np.zeros(system.n)
        self.drawn, each = rng is not None, np.arange(nodes)[:, None] % (timing.missed + 1)
        lost = each > 0 if rng is None else rng.random((nodes, runs)) < 0.5
        self.ages = np.zeros((nodes, runs))
        for node in range(1, nodes):
            older = self.ages[node - 1] + 1
            self.ages[node] = np.where(lost[node] & (older <= timing.missed), older, 0)
        # Every instant's measurement, and what is commanded from then on.
        self.readings, self.sent = (np.zeros((self.steps, runs, size)) for size in (system.n, system.m))
        self.late = None if rng is None else rng.choice([0.0, timing.jitter / self.dt], (nodes, runs))
        self.noise = self._noise() / np.maximum(self.estimate_bounds, 1e-300)
        self.measured = -1

    def error_bounds(self, system: Craft) -> Array:
        """Bounds on the errors of predictions in a step under any earlier commands, shape (n,)."""
        return system.navigation

    def _noise(self) -> Array:
        """Errors of measurements in every step, such that predictions keep to their bounds, (steps, 1, n)."""
        system, timing = self.system, self.system.timing
        if system.error_by_step is None or timing.instant:
            return self.estimate_bounds if timing.instant else system.measured + 0 * self.estimate_bounds
        age, worst = timing.delay + timing.missed * self.tracking.flow.h, system.thrusters.error(system.u_max)
        slack = self.estimate_bounds - prediction_error(system, np.zeros(system.n), worst, age)
        offset = add_pulses(timing, timing.period, system.state_offset_at_nodes)
        slack = np.clip(slack @ np.linalg.inv(np.abs(expm(system.A * age))).T - offset, 0.0, system.measured)
        noise, steps = slack, np.arange(len(slack)) + self.lag
        for late in range(timing.missed + 1):  # bounds are those of the steps that a measurement is used in
            used = np.minimum(steps + late * self.substeps, len(slack) - 1)
            noise = np.minimum(noise, slack[used])
        return np.asarray(noise)

    def _start_error(self, step: int, since: int) -> Array | float:
        """Error of an observer's estimate in a step, (R, n), carried from `since` to the start if earlier."""
        observer, A, h = self.system.observer, self.system.A, self.dt * self.substeps
        if self.eta is None or observer is None:
            return 0.0
        signs, gain, loop = np.sign(self.eta[0]), observer.gain, observer.rest @ expm(A * h)
        error = signs * (0.0 if observer.initial is None else observer.initial)
        for _ in range(PAST if observer.initial is None else 0):  # past updates
            noise = observer.errors(np.sign(self.eta[0] @ gain), np.sign(self.eta[0] @ observer.measures.T))
            error, gain = error + noise @ gain.T, loop @ gain
        transition = np.linalg.matrix_power(loop, -(-step // self.substeps))
        return np.asarray(error @ (expm(-A * min(since, 0) * self.dt) @ transition).T)

    def _before(self, step: int, start: int) -> Array:
        """Return an observer's estimates of the start, in a step whose measurement was made before it."""
        observer, carried = self.system.observer, expm(self.system.A * start * self.dt)
        assert observer is not None
        self.sample = self.readings[0] @ (observer.measures @ carried).T
        return np.asarray(self.readings[0] + self._start_error(step, start))

    def _observed(self, step: int, start: int) -> Array:
        """Return an observer's estimates (R, n) in a step from all it has measured up to `start`."""
        observer, (Ad, Bd, _) = self.system.observer, self.discrete
        assert observer is not None
        if self.measured < 0:
            before = self.substeps if step else 0
            self.filtered = self.readings[0] + self._start_error(step - before, start - before)
            self.measured, self.since = start - before, np.zeros(len(self.readings[0]), dtype=int)
        gains = np.array([observer.gain, *observer.after])
        while self.measured < start:
            for at in range(max(self.measured, 0), self.measured + self.substeps):
                self.filtered = self.filtered @ Ad.T + self.sent[at] @ Bd.T
            self.measured += self.substeps
            innovation = (self.readings[self.measured] - self.filtered) @ observer.measures.T
            if self.eta is not None and self.measured > 0:  # exact before, see `_begun`
                used = min(self.measured + self.lag, self.steps - 1)
                signs, first = (np.sign(self.eta[at] @ observer.measures.T) for at in (used, 0))
                at, box = max(self.measured, 0), np.zeros(len(observer.noise))
                if (sights := self.system.sights) is not None:  # which turn, whatever is constant of the rest
                    box[:3] = sights[min(at // self.steps_per_cell, len(sights) - 1), 2:]
                innovation = innovation + observer.errors(signs, first) - box * signs
                innovation = innovation + self.sensed(at, self.readings[self.measured], box * signs, box)
            missing = (self.ages[(self.measured + self.lag) // self.substeps] > 0) & (self.measured > 0)
            if self.faults is not None:
                missing |= self.faults.missing(np.full(len(missing), self.measured))
            self.sample = np.where(missing[:, None], np.nan, innovation + self.filtered @ observer.measures.T)
            gain = gains[np.minimum(self.since, len(gains) - 1)]
            update = np.einsum("rnm,rm->rn", gain, innovation)
            self.filtered = self.filtered + np.where(missing[:, None], 0.0, update)
            self.since = np.where(missing, self.since + 1, 0)
        return self.filtered

    def estimate(self, step: int, x: Array) -> Array:
        """Return the state as it is predicted from the last measurement under the commands since."""
        self.readings[step] = x
        predicted, ages = super().estimate(step, x).copy(), self.ages[step // self.substeps]
        bound = np.maximum(self.estimate_bounds[step, 0] + self.system.state_offset_at_nodes, 1e-300)
        Ad, Bd, _ = self.discrete
        measured_at = step - self.lag - ages * self.substeps
        missing = np.zeros(len(x), dtype=bool) if self.faults is None else self.faults.missing(measured_at)
        if self.faults is not None:
            ages = np.where(missing, ages + (measured_at - self.faults.begins) // self.substeps + 1, ages)
        if self.system.observer is not None:  # what it has not measured it predicts
            ages = np.zeros(len(x))
        for age in np.unique(ages).astype(int).tolist():
            start, runs = step - self.lag - age * self.substeps, ages == age
            if self.system.observer is not None:
                y = self._observed(step, start) if start >= 0 else self._before(step, start)
            elif start < 0:
                continue
            else:
                y = self.readings[start, runs]
                if self.eta is not None:
                    miss = self.noise[start] * self.eta[start, runs]
                    y = y + self.sensed(start, y, miss, self.noise[start, 0] * self.estimate_bounds[start, 0])
            for at in range(max(start, 0), step):
                y = y @ Ad.T + self.sent[at, runs] @ Bd.T
            within = np.abs(y - x[runs])[~missing[runs]] / bound
            self.error_share = np.maximum(self.error_share, np.max(within, axis=0, initial=0.0))
            predicted[runs] = y
        return np.asarray(predicted)

    def applied(self, raw: Array, step: int) -> Array:
        """Return the inputs made of commands, which are noted for predictions, too."""
        self.sent[step : step + self.substeps] = np.clip(raw, -self.system.u_max, self.system.u_max)
        return super().applied(raw, step)

    def lateness(self, step: int) -> Array:
        """Return the shares that were drawn, if any."""
        late = None if self.late is None else self.late[step // self.substeps, :, None]
        return super().lateness(step) if late is None or not step else late / self.substeps

    def move(self, k: int, step: int, x: Array, u: Array, w: Array) -> Array:
        """States a step later, with the measurement at its start noted."""
        at = k * self.steps_per_cell + step
        self.readings[at] = x[:, : self.system.n]
        return super().move(k, step, x, u, w)

    def _unclipped(self, *cell: object) -> None:
        """Return None: the command depends on more than the state."""


def flies(system: Craft) -> type[Integrator]:
    """Return the kind of flight that attacks fly.

    Observer and delay are flown as they are on board where they are states of the loop that is proven; else
    estimates are drawn from the box that stands for them, though an observer always filters.
    """
    on_board = system.observer is not None or (system.timing.delay > 0 and remembers(system))
    return Predicting if on_board else Integrator
