"""Errors of an observer's estimates by every pattern of missed periods, and gains that keep them small.

What enters adds up: bounds on responses to single sources add to a bound on the response to all of them
(docs/theory.md, Proposition 7 (c)).
"""

from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NoReturn

import numpy as np
from scipy.linalg import expm, solve_discrete_are

from reach.numerics.linear import powers
from reach.tubes.flow import LinearFlow

from ..craft import Array, Craft
from ..errors import ScenarioError
from ..timing import Observer

IN_PERIOD = 4  # parts of a control period over each of which integrals are bounded by the trapezoid rule

ROUNDED = 1e-9  # relative round-off of a bound, upwards

SCATTER = 0.4
"""Share of their bounds by which measurements scatter in the design of a gain; any gain is sound."""

ROUNDS, SPARE = 100, 1e-3
"""Most rounds until a bound holds that allows for the errors which it causes, and the enlargement by each."""

LEFT_OVER, LONGEST = 1e-3, 4096
"""Share of an error that counts as forgotten, and the most periods that may take."""

SHARES, CALM = (1.0, 0.3, 0.1, 0.05, 0.03), 0.02
"""Shares of the thrust for whose errors gains are designed, and the one at which S flies once settled."""

UNSEEN = 1e-6, 1e-4, 1e-3, 1e-2, 1e-1
"""Shares of the thrust limits that are taken for unknown: the first one whose gain forgets soon enough."""

FOLLOWED, LITTLE = 400, 0.01
"""Most periods for which the rest of errors is followed, and the share that may be left then.

With more periods the checker takes longer; with a larger share more of errors of thrusters counts for ever.
"""

FALLS = 0.6, 0.25, 0.08, 0.02
"""Shares of errors of thrusters that are left at the ages at which they are stated."""


@dataclass(frozen=True, eq=False)
class ObserverErrors:
    """Errors of the estimates of an observer with updates every h [s], or fewer where periods are missed."""

    system: Craft
    observer: Observer
    h: float

    @cached_property
    def _forgetting(self) -> tuple[Array, Array, int]:
        """Return the map of errors over a period, and bounds on those over so many periods."""
        system, observer = self.system, self.observer
        loop, count = observer.rest @ np.asarray(expm(system.A * self.h)), 1
        while True:
            with np.errstate(over="ignore", invalid="ignore"):
                last = np.abs(np.linalg.matrix_power(loop, count))
            if np.all(np.isfinite(last)) and np.max(np.abs(np.linalg.eigvals(last))) <= LEFT_OVER:
                return loop, last, count
            if count >= LONGEST or not np.all(np.isfinite(last)):
                rule = "must make all errors of the estimate decay; measure more of the state"
                raise ScenarioError("navigation.measurement", observer.measures.tolist(), rule)
            count *= 2

    @property
    def count(self) -> int:
        """Periods after which an error counts as forgotten."""
        return self._forgetting[2]

    @cached_property
    def error_maps(self) -> Array:
        """Maps of an error over so many periods, shape (count + kinds of updates, n, n)."""
        return powers(self._forgetting[0], self.count + len(self.observer.after))

    @cached_property
    def other_maps(self) -> list[Array]:
        """Maps by which an update adds to errors so many periods later, periods apart, by its kind."""
        loop, maps = self._forgetting[0], [0 * self.error_maps]
        for j, rest in enumerate(self.observer.rests[1:], 2):
            other = rest @ expm(self.system.A * self.h * j) - np.linalg.matrix_power(loop, j)
            maps.append(np.abs(self.error_maps @ other))
        return maps

    def added(self, noise: Array, w_max: float, E: Array | None) -> list[Array]:
        """Bounds on the error an update adds so many periods later, by its kind, (count + kinds, n) each.

        By errors of measurements up to `noise` (r,), by the disturbance, and by rates in a box of columns E.
        """
        system, observer, bounds = self.system, self.observer, list[Array]()
        flow = LinearFlow.continuous(system.A, system.D, w_max, self.h / IN_PERIOD, E)
        for j, (gain, rest) in enumerate(zip((observer.gain, *observer.after), observer.rests, strict=True)):
            forced = flow.disturbance_support(
                (self.error_maps @ rest).reshape(-1, system.n), IN_PERIOD * (j + 1)
            )[-1]
            bounds.append(forced.reshape(self.error_maps.shape[:2]) + np.abs(self.error_maps @ gain) @ noise)
        return bounds

    def _summed(self, added: list[Array], prior: Array) -> Array:
        """Bound errors that updates add in the worst pattern, by periods, first ones in `prior`, (., n)."""
        kinds, count = len(self.other_maps), self.count
        sums = np.zeros((count + kinds, self.system.n))
        each = [increase + extra @ prior for increase, extra in zip(added, self.other_maps, strict=True)]
        for age in range(count):
            for j, increase in enumerate(each):
                sums[age + j + 1] = np.maximum(sums[age + j + 1], sums[age] + increase[age])
        return sums

    def largest(self, added: list[Array]) -> Array:
        """Bound errors under those that updates add, long after the start, shape (n,).

        Just after a measurement, with every pattern of missed periods that may be.

        Raises
        ------
        ScenarioError
            If errors are not forgotten.
        """
        last, kinds = self._forgetting[1], len(added)

        def worst(prior: Array) -> Array:
            """Errors if those so many periods before were within `prior`, by the worst pattern."""
            sums = self._summed(added, prior)
            sums[self.count :] += np.abs(self.error_maps[self.count :]) @ prior
            return np.asarray(np.max(sums[self.count * (kinds == 1) :], axis=0) * (1 + ROUNDED))

        alone = np.linalg.solve(np.eye(self.system.n) - last, worst(np.zeros(self.system.n)))
        bound = np.asarray(alone * (1 + ROUNDED))
        for _ in range(ROUNDS if kinds > 1 else 0):
            if np.all((enlarged := worst(bound)) <= bound):
                return np.asarray(bound)
            bound = np.maximum(bound, enlarged * (1 + SPARE))
        if kinds > 1:
            self._refuse()
        return np.asarray(bound)

    def _refuse(self) -> NoReturn:
        missed = len(self.observer.after)
        raise ScenarioError("timing.missed_periods", missed, "must be fewer for errors to decay")

    def bounds_after(self, first: Array, periods: int, added: list[Array]) -> Array:
        """Bound errors so many periods after they were within `first` (n,), shape (periods + 1, n).

        Just after an update, by every pattern of missed periods, if updates add `added`.
        """
        bounds = np.abs(powers(self._forgetting[0], periods)) @ first * (1 + ROUNDED)
        for age in range(1, periods + 1):
            before = bounds[:age][::-1, :, None]  # at once, one period before, ...
            each = [(extra[: age - j] @ before[j:])[..., 0] for j, extra in enumerate(self.other_maps[:age])]
            sums = np.zeros((age + 1, len(first)))
            for at in range(age):
                for j, increase in enumerate(each[: age - at]):
                    np.maximum(sums[at + j + 1], sums[at] + added[j][at] + increase[at], out=sums[at + j + 1])
            bounds[age] += sums[age] * (1 + ROUNDED)
        return bounds

    def rest_bounds(self, settled: Array) -> Array:
        """Bound the rest of `settled` errors, (n,) positive, until it is small, (near + late + 1, n).

        With `late` periods that may be missed. Raises what `largest` does.
        """
        late, zeros = len(self.observer.after), [0 * self.error_maps[..., 0]] * len(self.other_maps)
        bounds = self.bounds_after(settled, min(self.count, FOLLOWED) + late, zeros)  # late ones may follow
        shares = np.max(bounds / settled, axis=1)
        shares = np.max([shares[j : len(shares) - late + j] for j in range(late + 1)], axis=0)
        if not shares[-1] < 1:
            self._refuse()
        near = int(np.argmax(shares <= LITTLE)) if shares[-1] <= LITTLE else len(shares) - 1
        return bounds[: near + late + 1]

    def fading(self, first: Array, settled: Array) -> Array:
        """Bound the rest of errors within `first` (n,) so many periods later, and ever after.

        Shape (near + 2, n). By every pattern of missed periods; errors added meanwhile are apart. See
        `usual`.
        """
        usual, zeros = self.rest_bounds(settled), [0 * self.error_maps[..., 0]] * len(self.other_maps)
        near = len(usual) - 1 - len(self.observer.after)
        bounds = self.bounds_after(first, len(usual) - 1, zeros)
        share = np.max(bounds[near:] / settled)
        return np.vstack([bounds[: near + 1], share * usual.max(axis=0) * (1 + ROUNDED)])

    def _fading_always_measured(self, first: Array, periods: int) -> Array:
        """Bound the rest without missed periods, so many periods later and ever after, (periods + 2, n)."""
        loop, last, count = self._forgetting
        remainder = np.abs(powers(loop, periods + count)) @ first * (1 + ROUNDED)
        tail = np.linalg.solve(np.eye(len(first)) - last, remainder[periods:].max(axis=0)) * (1 + ROUNDED)
        return np.vstack([remainder[: periods + 1], tail])

    def alone(self, offset: Array | float = 0.0) -> list[Array]:
        """Return the errors that updates add if nothing is commanded, see `added`.

        `offset` (n,) bounds by how much states are displaced when they are measured.
        """
        system, observer = self.system, self.observer
        noise = observer.noise + np.abs(observer.measures) @ np.broadcast_to(offset, (system.n,))
        return self.added(noise, system.w_max, system.error_map(system.thrusters.error(0 * system.u_max)))

    def parts(self, offset: Array | float = 0.0) -> tuple[Array, Array]:
        """Bound errors of estimates by all of `alone`, (n,), and by a unit of errors of thrusters, (n, m).

        Long after the start. Raises what `largest` does.
        """
        total = self.largest(self.alone(offset))
        if not self.system.thrusters.proportional:
            return total, np.zeros((self.system.n, self.system.m))
        zeros = 0 * self.observer.noise
        units = [self.largest(self.added(zeros, 0.0, column[:, None])) for column in self.system.B.T]
        return total, np.column_stack(units)

    def by_age(self, settled: Array, units: Array, size: Array) -> tuple[tuple[int, ...], Array]:
        """Return ages, and gains of thruster errors of so many periods ago or more, (ages, n, m).

        `units` (n, m) is what errors of any age make of estimates, those of a size (m,) telling which ages
        matter; `settled` (n,) is all.
        """
        late = len(self.observer.after)
        remainder = np.stack([self.fading(column, settled) for column in units.T], axis=-1)
        remainder = np.minimum(np.maximum.accumulate(remainder[::-1])[::-1], units)
        shares = (remainder @ size / np.maximum(units @ size, 1e-300)).max(axis=1)
        begins = sorted({int(np.argmax(shares <= share)) for share in FALLS if shares[-1] <= share} - {0})
        ages = (0, *(begin + late for begin in begins))  # the first update since may be so much later
        return ages, np.array([units, *remainder[begins]])

    def by_step(self, settled: Array, alone: Array, offset: Array | float) -> Array:
        """Bound the part of first errors beyond `settled` ones (n,) in every step and ever after, (K + 1, n).

        Of all estimates that commands in a step may rest on; less than nothing where first errors are smaller
        than those that are `alone`, without errors by commands.
        """
        (steps, periods), first = self.observer.horizon, np.asarray(self.observer.initial)
        late, total = len(self.observer.after), steps * periods
        if late:
            decay = self.fading(first, settled)
            joint = self.bounds_after(first, len(decay) - 2, self.alone(offset)) - alone
            decay[:-1] = np.minimum(decay[:-1], joint)
        else:
            decay = self._fading_always_measured(first, total)
        nodes = np.maximum(np.arange(total)[:, None] - np.arange(late + 1), 0)
        bounds = decay[np.minimum(nodes, len(decay) - 1)].max(axis=1).reshape(steps, periods, -1).max(axis=1)
        return np.vstack([bounds, decay[min(max(total - late, 0), len(decay) - 1) :].max(axis=0)])


def observing(system: Craft, observer: Observer, h: float, offset: Array | float = 0.0) -> Craft:
    """Return the system whose estimates are those of an observer; `offset` as for `ObserverErrors.alone`."""
    filtering, observer = ObserverErrors(system, observer, h), replace(observer, ages=(), by_age=None)
    alone, units = filtering.parts(offset)
    size = system.thrusters.part(system.u_max)
    error = (alone + units @ size) * (1 + ROUNDED)
    if observer.after:
        observer = replace(observer, followed=len(filtering.rest_bounds(error)) - 1 - len(observer.after))
        if np.any(units):
            ages, by_age = filtering.by_age(error, units, size)
            observer = replace(observer, ages=ages, by_age=by_age)
    if observer.initial is None:
        return replace(system, observer=observer, estimate_error=error)
    fade = filtering.by_step(error, alone, offset)
    return replace(system, observer=replace(observer, settled=error, fading=fade), error_by_step=error + fade)


def design(
    system: Craft, measures: Array, noise: Array, h: float, missed: int = 0, boxed: bool = False
) -> Observer:
    """Design the observer of measurements (r, n) off by `noise` (r,) at most, with a steady Kalman gain.

    Of gains made for shares of the thrust it takes the one with the least product of errors of all states
    nearly without thrust; if `boxed`, those at full thrust count too, as a box for what was commanded stands
    for the estimate then. After some of up to `missed` periods without any
    measurement, either the gain that does at once what it would have done in each of them, or the Kalman
    gain of then: whichever leaves smaller errors.

    Raises
    ------
    ScenarioError
        If measurements do not see a motion that does not decay.
    """
    first, *others = SHARES if system.thrusters.proportional else SHARES[:1]
    designs = [_designed(system, measures, noise, h, missed, first)]
    for share in others:
        with suppress(ScenarioError):
            designs.append(_designed(system, measures, noise, h, missed, share))
    if len(designs) == 1:
        return designs[0]
    each = [ObserverErrors(system, one, h).parts() for one in designs]
    full = system.thrusters.part(system.u_max)
    parts = [full * CALM, *[full] * boxed]
    sizes = np.array([[alone + units @ part for part in parts] for alone, units in each])
    return designs[int(np.argmin(np.log(np.maximum(sizes, 1e-300)).sum(axis=(1, 2))))]


def _designed(system: Craft, measures: Array, noise: Array, h: float, missed: int, share: float) -> Observer:
    """Design an observer for errors of thrusters under a share of their limits, which forgets in time."""
    for unseen in UNSEEN:
        observer = _design(system, measures, noise, h, missed, share, unseen)
        filtering = ObserverErrors(system, observer, h)
        with suppress(ScenarioError):
            if not missed or len(filtering.rest_bounds(_size(system, observer, h))):
                break
    return observer


def _design(
    system: Craft, measures: Array, noise: Array, h: float, missed: int, share: float, unseen: float
) -> Observer:
    """Make an observer for errors of thrusters under a share of their limits, and a share that is unknown."""
    unknown = np.hstack([system.D * system.w_max, system.B * system.thrusters.error(share * system.u_max)])
    unknown = np.hstack([unknown, system.B * (unseen * system.u_max)])
    step, excited = expm(system.A * h), expm(system.A * h / 2) @ unknown * h
    covariance = np.diag((noise * SCATTER) ** 2)
    try:
        P = solve_discrete_are(step.T, measures.T, excited @ excited.T, covariance)
        steady = Observer(measures, noise, _kalman(P, measures, covariance))
    except (np.linalg.LinAlgError, ValueError) as error:
        rule = f"must observe every mode that does not decay: there is no steady Kalman gain ({error})"
        raise ScenarioError("navigation.measurement", measures.tolist(), rule) from error
    if not missed:
        return steady
    loop, prompt, later = steady.rest @ step, [], []
    for j in range(2, missed + 2):
        P = step @ P @ step.T + excited @ excited.T
        later.append(_kalman(P, measures, covariance))
        combined = np.eye(system.n) - np.linalg.matrix_power(loop, j) @ expm(-system.A * h * j)
        prompt.append(combined @ np.linalg.pinv(measures))
    steady_size, candidates = _size(system, steady, h), list[tuple[float, Observer]]()
    for gains in (prompt, later):
        observer = replace(steady, after=tuple(gains))
        with suppress(ScenarioError):
            size = _size(system, observer, h) / np.maximum(steady_size, 1e-300)
            candidates.append((float(size.sum()), observer))
    return min(candidates, key=lambda each: each[0])[1] if candidates else observer


def _kalman(P: Array, measures: Array, covariance: Array) -> Array:
    """The gain of a Kalman filter with covariances of the prediction and of the measurement."""
    return np.asarray(np.linalg.solve(measures @ P @ measures.T + covariance, measures @ P).T)


def _size(system: Craft, observer: Observer, h: float) -> Array:
    """Bound errors of estimates under commands up to the limits of the thrusters, shape (n,)."""
    alone, units = ObserverErrors(system, observer, h).parts()
    return np.asarray(alone + units @ system.thrusters.part(system.u_max))
